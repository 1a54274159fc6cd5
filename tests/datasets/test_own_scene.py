"""Scenes for your own tables, and units judged by the motion; pushes in closed form."""

import math

import numpy as np
import pytest
import yaml
from tests.closed_form import SIDE, push, table_text
from tests.datasets.recordings import table_file
from tests.fixtures import refused

from fixel.datasets import IMPORTERS
from fixel.datasets.own_scene import template_text

CSV = IMPORTERS["csv"]
HALF = SIDE / 2
DEGREE = math.degrees(1.0)
SQUARE = (
    f"{{polygon: [[-{HALF}, -{HALF}], [{HALF}, -{HALF}], [{HALF}, {HALF}], [-{HALF}, {HALF}]]}}"
)


def table(tmp_path, *, header=None, turn=DEGREE, scale=1e3, **how):
    """A table of a push, its columns scaled by factors of the test's own."""
    time, pose, tip = push(0.15, 0.02, **how)
    rows = np.column_stack((time, scale * pose[:, :2], turn * pose[:, 2], scale * tip))
    text = (header or "time_s,x_mm,y_mm,theta_deg,tip_x_mm,tip_y_mm") + "\n"
    text += "".join(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows)
    return table_file(tmp_path / "run.csv", text)


def filled(tmp_path, source, **replaced):
    """The template of a table's scene with its placeholders filled in."""
    (experiment,) = CSV.read(source).experiments()
    text = template_text(experiment, source.name)
    shapes = replaced.get("shapes", (SQUARE, "{disk: 0.005}"))
    for shape in shapes:
        text = text.replace("shape: FILL_IN", f"shape: {shape}", 1)
    text = text.replace("mass: FILL_IN", "mass: 0.5")
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return path


def test_a_filled_template_makes_a_scene_from_table_and_file(tmp_path):
    source = table(tmp_path, angle=0.3)
    scene = filled(tmp_path, source)
    (experiment,) = CSV.read(source, scene=str(scene)).experiments()
    time, pose, tip = push(0.15, 0.02, angle=0.3)
    assert experiment.scene.bodies[0].pose == pytest.approx(pose[0], abs=1e-8)
    path = experiment.scene.pushers[0].drive.waypoints
    assert path[:, 1:3] == pytest.approx(tip, abs=1e-8)
    assert experiment.scene.duration == pytest.approx(time[-1])
    assert "no-scene" not in {flag.name for flag in experiment.flags}


def test_a_scene_may_leave_out_what_the_table_has(tmp_path):
    source = table(tmp_path, angle=0.3)
    scene = filled(tmp_path, source)
    (whole,) = CSV.read(source, scene=str(scene)).experiments()
    content = yaml.safe_load(scene.read_text())
    del content["duration"], content["bodies"][0]["pose"], content["pushers"][0]["drive"]
    scene.write_text(yaml.safe_dump(content))
    (experiment,) = CSV.read(source, scene=str(scene)).experiments()
    assert experiment.scene == whole.scene

    table_alone = tmp_path / "alone.csv"  # nothing states how the pusher moves
    table_alone.write_text("time_s,x_mm,y_mm,theta_deg\n0,0,0,0\n1,1,0,0\n")
    refused(CSV.read, table_alone, scene=str(scene), match=r"pushers\[0\].drive is missing")


def test_an_object_that_moves_without_its_pusher_is_remarked(tmp_path):
    time, pose, tip = push(0.15, 0.02)
    noise = np.random.default_rng(5).normal(0.0, 2e-4, (500, 2))
    rest = np.tile(pose[-1], (500, 1))
    rest[:, :2] += noise  # steps of noise add up to 0.14 m
    back = tip[-1] - [0.05, 0.0] * np.linspace(0.0, 1.0, 500)[:, None]
    scene = filled(tmp_path, table(tmp_path))
    for lift, far in ((0.0, False), (0.2, True)):
        rest[250:, 1] += lift  # by hand, after the pusher has gone back
        rows = np.column_stack(
            (
                np.append(time, time[-1] + 0.02 * np.arange(1, 501)),
                1e3 * np.vstack((pose, rest))[:, :2],
                DEGREE * np.append(pose[:, 2], rest[:, 2]),
                1e3 * np.vstack((tip, back)),
            )
        )
        text = "time_s,x_mm,y_mm,theta_deg,tip_x_mm,tip_y_mm\n"
        text += "".join(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows)
        plan = CSV.read(table_file(tmp_path / "lifted.csv", text), scene=str(scene))
        (experiment,) = plan.experiments()
        found = [flag for flag in experiment.flags if flag.name == "moved-alone"]
        assert [flag.fault for flag in found] == [False] * far
        assert ("was it lifted" in str(plan.understood)) == far
        assert all(float(flag.detail.split()[0]) == pytest.approx(200, abs=2) for flag in found)


def test_placeholders_that_are_left_are_named_all_together(tmp_path):
    source = table(tmp_path)
    scene = filled(tmp_path, source, shapes=())
    refusal = refused(CSV.read, source, scene=str(scene))
    assert refusal.where == f"{scene}: bodies[0].shape"
    assert "FILL_IN" in str(refusal)
    assert "disk" in refusal.expected
    assert "pushers[0].shape" in refusal.hint


@pytest.mark.parametrize(("header", "turn", "scale", "complaint"), [
    # Degrees, radians and metres that the header calls something else.
    ("time_s,x_mm,y_mm,theta_rad,tip_x_mm,tip_y_mm", DEGREE, 1e3, "angle_unit=deg"),
    (None, 1.0, 1e3, "angle_unit=rad"),
    ("time_s,x_m,y_m,theta_deg,tip_x_m,tip_y_m", DEGREE, 1e3, "a motion of 33 m"),
])  # fmt: skip
def test_units_in_which_nothing_moves_so_are_refused(tmp_path, header, turn, scale, complaint):
    right = table(tmp_path)
    scene = filled(tmp_path, right)
    wrong = table(tmp_path, header=header, turn=turn, scale=scale)
    refused(CSV.read, wrong, scene=str(scene), match=complaint)


def turning(tmp_path, title, step, n, dx=1.0):
    """A table of a part that turns by one step from row to row, each 0.1 s later."""
    rows = "".join(f"{0.1 * k:g},{dx * k:g},0,{step * k:g}\n" for k in range(n))
    return table_file(tmp_path / "run.csv", f"time_s,x_mm,y_mm,{title}\n" + rows)


def test_a_turn_of_143_degrees_in_a_tenth_of_a_second_is_refused(tmp_path):
    """Without a pusher or a scene: 1.43 degrees in 0.1 s, times 100 under the wrong header."""
    source = turning(tmp_path, "theta_rad", 2.5, 20)
    refused(CSV.read, source, match=r"turns 143 degrees in 0\.1 s.*angle_unit=deg")
    (experiment,) = CSV.read(source, angle_unit="deg").experiments()
    assert experiment.trajectory.pose[-1, 2] == pytest.approx(math.radians(2.5 * 19))


@pytest.mark.parametrize("title", ["theta", "theta_deg"])
def test_a_stated_unit_that_makes_a_part_spin_is_refused(tmp_path, title):
    """21.7 degrees in 20 s, read as radians: 1243 degrees, though at 1.1 rad/s only."""
    source = turning(tmp_path, title, -21.7 / 200, 201, dx=0.1)
    refusal = refused(CSV.read, source, angle_unit="rad")
    assert refusal.found == "an object that turns 1243 degrees"
    assert "likely in degrees: set angle_unit=deg" in refusal.hint
    (experiment,) = CSV.read(source, angle_unit="deg").experiments()
    assert experiment.trajectory.pose[-1, 2] == pytest.approx(math.radians(-21.7))


def test_a_part_that_turns_several_times_is_read_if_header_and_option_agree(tmp_path):
    source = turning(tmp_path, "theta_rad", 0.9, 30)
    refused(CSV.read, source, match="if it is in radians, end its title with _rad")
    (experiment,) = CSV.read(source, angle_unit="rad").experiments()
    assert experiment.trajectory.pose[-1, 2] == pytest.approx(0.9 * 29)
    assert "doubtful-angles" in {flag.name for flag in experiment.flags}


def test_two_turns_in_degrees_or_wrapped_radians_need_no_second_statement(tmp_path):
    turned = [0.03 * k for k in range(420)]  # two turns at 0.3 rad/s
    wrapped = [math.remainder(angle, 2.0 * math.pi) for angle in turned]
    for title, angles in (("theta_deg", map(math.degrees, turned)), ("theta_rad", wrapped)):
        rows = "".join(f"{0.1 * k:g},{k},0,{angle:.9g}\n" for k, angle in enumerate(angles))
        source = table_file(tmp_path / "run.csv", f"time_s,x_mm,y_mm,{title}\n" + rows)
        (experiment,) = CSV.read(source).experiments()
        assert experiment.trajectory.pose[-1, 2] == pytest.approx(turned[-1])
        assert "doubtful-angles" not in {flag.name for flag in experiment.flags}


@pytest.mark.parametrize("title", ["theta_deg", "theta_rad"])
@pytest.mark.parametrize("turns", [[2] * 20, [0, 2] * 10, [3, -1, 0, 5] * 5])
def test_jumps_by_whole_turns_do_not_count_as_motion(tmp_path, title, turns):
    """A tracker may add any number of turns to an angle, and another one in the next frame."""
    turned = 0.02 * np.arange(40)
    jumps = 2.0 * math.pi * np.concatenate((np.zeros(20), turns))
    unit = math.degrees(1.0) if title == "theta_deg" else 1.0
    rows = np.column_stack(
        (0.1 * np.arange(40), np.arange(40), 0 * turned, unit * (turned + jumps))
    )
    text = "".join(",".join(f"{value:.9g}" for value in row) + "\n" for row in rows)
    source = table_file(tmp_path / "run.csv", f"time_s,x_mm,y_mm,{title}\n{text}")
    (experiment,) = CSV.read(source).experiments()
    np.testing.assert_allclose(experiment.trajectory.pose[:, 2], turned, atol=1e-6)
    assert "doubtful-angles" not in {flag.name for flag in experiment.flags}


def test_a_spin_in_degrees_is_not_called_radians(tmp_path):
    """Radians would make it 57 times as fast."""
    refusal = refused(CSV.read, turning(tmp_path, "theta_deg", 54.0, 20))
    assert refusal.found == "an object that turns 54 degrees in 0.1 s"
    assert refusal.hint.startswith("check angles and times; if it is in degrees")


def test_right_units_of_many_pushes_are_accepted(tmp_path):
    for mu in (0.02, 0.15, 0.6):
        for offset in (-0.035, 0.002, 0.03):
            for unit, turn in (("deg", math.degrees(1.0)), ("rad", 1.0)):
                time, pose, tip = push(mu, offset, duration=3.0, rate=20.0)
                rows = np.column_stack((time, pose[:, :2], turn * pose[:, 2], tip))
                text = f"time_s,x_m,y_m,theta_{unit},tip_x_m,tip_y_m\n"
                text += "".join(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows)
                (read,) = CSV.read(table_file(tmp_path / "run.csv", text)).experiments()
                assert read.trajectory.pose[:, 2] == pytest.approx(pose[:, 2], abs=1e-8)


def test_a_pusher_that_cannot_be_there_is_refused(tmp_path):
    scene = filled(tmp_path, table(tmp_path))
    time, pose, tip = push(0.15, 0.02)
    for shift, complaint in ((-0.02, "20 mm inside the object at the start"), (2.0, "stays 1")):
        moved = pose + np.array([shift, 0.0, 0.0])
        source = table_file(tmp_path / "run.csv", table_text(time, moved, tip))
        refused(CSV.read, source, scene=str(scene), match=complaint)


def test_a_table_without_angles_has_no_scene_of_a_polygon(tmp_path):
    scene = filled(tmp_path, table(tmp_path))
    source = table(tmp_path, header="time_s,x_mm,y_mm,spin,tip_x_mm,tip_y_mm")
    refusal = refused(CSV.read, source, scene=str(scene), match="no angle of 'object'")
    assert refusal.where == "run.csv"
    round_part = filled(tmp_path, source, shapes=("{disk: 0.05}", "{disk: 0.005}"))
    (experiment,) = CSV.read(source, scene=str(round_part)).experiments()
    assert experiment.scene is not None


def test_a_scene_belongs_to_a_table_and_holds_its_object(tmp_path):
    source = table(tmp_path)
    scene = filled(tmp_path, source)
    refused(CSV.read, source, scene=str(scene), object_name="crate", match="the object 'crate'")
    scene.write_text(scene.read_text().partition("pushers:")[0])
    refused(CSV.read, source, scene=str(scene), match="0 pushers")


def test_one_row_of_poses_has_no_motion_of_a_pusher(tmp_path):
    source = table(tmp_path)
    scene = filled(tmp_path, source)
    source.write_text("\n".join(source.read_text().splitlines()[:2]) + "\n")
    of_file = {"scene": str(scene), "match": r"mine\.yaml and the table.* one row of poses"}
    refused(lambda **options: CSV.read(source, **options).experiments(), **of_file)
    (alone,) = CSV.read(source).experiments()
    assert len(alone.trajectory.time) == 1
