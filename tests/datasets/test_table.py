"""Your own tables: roles, units, guesses and refusals."""

import gzip
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.datasets.recordings import table_file
from tests.fixtures import refused

import fixel
from fixel.datasets import IMPORTERS
from fixel.errors import InvalidInput

CSV = IMPORTERS["csv"]


def plan_of(tmp_path, text, **options):
    return CSV.read(table_file(tmp_path / "run 7.csv", text), **options)


def experiment_of(tmp_path, text, **options):
    (experiment,) = plan_of(tmp_path, text, **options).experiments()
    return experiment


def test_units_come_from_the_header(tmp_path):
    experiment = experiment_of(
        tmp_path,
        "time_ms,x_mm,y_cm,theta_deg,pusher_x_um,pusher_y_m,force_x_n,touch_bool,gap_mm,surface\n"
        "100,10,2,90,5000,1,3.5,true,2,felt\n"
        "200,11,2,91,5000,1,,0,3,felt\n",
    )

    assert experiment.key == "csv/run 7"
    assert experiment.trajectory.time == pytest.approx([0.0, 0.1])
    assert experiment.trajectory.pose[0] == pytest.approx([0.01, 0.02, math.pi / 2])
    assert experiment.pusher.pose[0] == pytest.approx([0.005, 1.0, 0.0])
    force, readings, tactile = experiment.channels
    assert (force.columns, tactile.columns) == (("force_x_n",), ("touch_bool",))
    assert np.isnan(force.values[1, 0])
    assert tactile.values.tolist() == [[1.0], [0.0]]
    assert readings.columns == ("gap_m",)
    assert readings.values[:, 0] == pytest.approx([0.002, 0.003])
    assert experiment.conditions == {"surface": "felt"}
    assert experiment.flags == ()
    assert experiment.real


def test_headers_of_spreadsheets(tmp_path):
    experiment = experiment_of(tmp_path, "\ufeffTime [s],X (mm), Y/mm,Angle (deg)\n0,1,2,180\n")
    assert experiment.trajectory.pose[0] == pytest.approx([0.001, 0.002, math.pi])


def test_the_motion_of_the_object_is_stated(tmp_path):
    """The first sentence about a table states a motion: it shows metres taken for millimetres."""
    rows = "0,0,0,170\n0.5,0.003,0,180\n1.0,0.003,-0.004,-178\n"
    first, *_ = plan_of(tmp_path, f"time_s,x_mm,y_mm,theta_deg\n{rows}").understood
    assert first.endswith("The object moves 0.005 mm and turns 12 degrees.")


def test_guesses_are_stated_and_flagged(tmp_path):
    plan = plan_of(tmp_path, "t,x,y,theta\n0,120,3,178\n33,121,3,-179\n66,122,3,-176\n")

    guesses = [sentence for sentence in plan.understood if sentence.startswith("Guess")]
    assert guesses == [
        "Guess: t has no unit and typical steps of 33; ms is assumed.",
        "Guess: x has no unit and values up to 122; mm is assumed.",
        "Guess: y has no unit and others of its kind are in mm; mm is assumed.",
        "Guess: theta has no unit and values up to 179; degrees is assumed.",
    ]
    (experiment,) = plan.experiments()
    assert [flag.name for flag in experiment.flags] == ["guessed-units"]
    assert experiment.trajectory.time == pytest.approx([0.0, 0.033, 0.066])
    assert np.degrees(experiment.trajectory.pose[:, 2]) == pytest.approx([178, 181, 184])


@pytest.mark.parametrize("change", [3, 2, None])
def test_rows_that_may_be_several_experiments_are_a_guess(tmp_path, change):
    times = [0.0, 0.1, 0.2, 60.0, 60.1, 60.2]
    push = ["a" if change is None or row < change else "b" for row in range(6)]
    rows = [f"{t},{name},1,2,3" for t, name in zip(times, push, strict=True)]
    plan = plan_of(tmp_path, "\n".join(["time_s,push,x_mm,y_mm,theta_deg", *rows]))
    guesses = [line for line in plan.understood if line.startswith("Guess: all rows are one")]
    assert len(guesses) == (change == 3)
    assert all("split_by='push'" in guess for guess in guesses)


def test_small_values_are_metres_and_radians(tmp_path):
    experiment = experiment_of(tmp_path, "t,x,y,theta\n0,0.1,0.2,3.0\n0.1,0.1,0.2,3.1\n")
    assert experiment.trajectory.pose[0].tolist() == [0.1, 0.2, 3.0]


def test_unknown_units_are_named(tmp_path):
    plan = plan_of(tmp_path, "time_s,x_ells,y_ells\n0,1,2\n1,2,2\n")
    assert any("x_ells has the unknown unit 'ells'" in line for line in plan.understood)
    assert any("There is no angle of the object" in line for line in plan.understood)


@pytest.mark.parametrize("names", ["q{}", "quat_{}", "Orientation.{}", "pose/orientation/{}"])
@pytest.mark.parametrize("upside_down", [False, True])
def test_quaternions_are_angles(tmp_path, names, upside_down):
    turns = Rotation.from_rotvec([(0.0, 0.0, turn) for turn in (0.1, 2.0, 3.5)])
    turns = turns * Rotation.from_rotvec((np.pi if upside_down else 0.0, 0.0, 0.0))
    rows = [f"{k},{k},2,{','.join(map(str, q))}" for k, q in enumerate(turns.as_quat())]
    header = ",".join(["time_s", "x_mm", "y_mm", *(names.format(part) for part in "xyzw")])
    plan = plan_of(tmp_path, "\n".join([header, *rows]))
    (experiment,) = plan.experiments()
    assert experiment.trajectory.theta == pytest.approx([0.1, 2.0, 3.5])
    assert not experiment.flags
    assert any("The angle of the object is that of the quaternion" in s for s in plan.understood)


def test_z_and_w_are_enough_and_an_angle_goes_first(tmp_path):
    turned = ",pusher_x_mm,pusher_y_mm,pusher_qz,pusher_qw\n0,1,2,90,0,0,0.6,0.8\n"
    experiment = experiment_of(tmp_path, "time_s,x_mm,y_mm,theta_deg" + turned)
    assert experiment.pusher.theta == pytest.approx([2 * np.arctan2(0.6, 0.8)])
    both = experiment_of(tmp_path, "time_s,x_mm,y_mm,theta_deg,qz,qw\n0,1,2,90,0,1\n")
    assert both.trajectory.theta == pytest.approx([np.pi / 2])


@pytest.mark.parametrize(("quaternion", "complaint"), [
    ("0,0,0,0", "row 1, column qx and qy and qz and qw: found a quaternion whose norm is not 1"),
    ("0,0.7071,0,0.7071", "found an x axis that points out of the plane"),
])  # fmt: skip
def test_wrong_quaternions_are_refused(tmp_path, quaternion, complaint):
    text = f"time_s,x_mm,y_mm,qx,qy,qz,qw\n0,1,2,{quaternion}\n"
    refused(plan_of, tmp_path, text, match=complaint)


@pytest.mark.parametrize("title", ["time_ns", "timestamp"])
def test_nanoseconds_since_1970_are_times(tmp_path, title):
    epoch = 1_700_000_000_000_000_000
    rows = [f"{epoch + 50_000_000 * k},{k},0,{100 * k}" for k in range(3)]
    text = "\n".join([f"{title},x_inch,y_inch,theta_mrad", *rows])
    track = experiment_of(tmp_path, text).trajectory
    assert track.time == pytest.approx([0.0, 0.05, 0.1], abs=1e-6)
    assert track.x == pytest.approx([0.0, 0.0254, 0.0508])
    assert track.theta == pytest.approx([0.0, 0.1, 0.2])


def test_options_go_before_guesses(tmp_path):
    text = "t,x,y,theta\n0,100,3,7\n5,101,3,8\n"
    experiment = experiment_of(
        tmp_path, text, time_unit="s", length_unit="cm", angle_unit="rad", object_name="brick",
        name="first", simulated_by="somebody's code",
    )  # fmt: skip

    assert experiment.trajectory.time[1] == 5.0
    assert experiment.trajectory.pose[0] == pytest.approx([1.0, 0.03, 7.0])
    assert (experiment.object_name, experiment.name) == ("brick", "first")
    assert not experiment.real
    assert experiment.flags == ()


def test_blank_poses_are_left_out_and_flagged(tmp_path):
    experiment = experiment_of(tmp_path, "t_s,x_m,y_m,theta_rad\n0,0,0,0\n1,,0,0\n2,1,0,0\n")
    assert experiment.trajectory.time.tolist() == [0.0, 2.0]
    (flag,) = experiment.flags
    assert (flag.name, flag.detail) == (
        "missing-poses", "no pose of the object in 1 of 3 rows",
    )  # fmt: skip


def test_times_since_1970_keep_their_digits(tmp_path):
    rows = "".join(f"{1_700_000_000_000_000 + 4000 * k},0,0,0\n" for k in range(3))
    experiment = experiment_of(tmp_path, "time_us,x_m,y_m,theta_rad\n" + rows)
    assert experiment.trajectory.time == pytest.approx([0.0, 0.004, 0.008], abs=1e-12)


def test_a_compressed_table(tmp_path):
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(b"t_s,x_m,y_m,theta_rad\n0,1,0,0\n"))
    (experiment,) = CSV.read(path).experiments()
    assert experiment.name == "run"
    assert experiment.provenance.source == "run.csv.gz"


@pytest.mark.parametrize(("text", "complaint"), [
    ("t_s,x_m,y_m\n0,0,0\n0,0,0\n", "row 2: found t = 0 s after 0 s"),
    ("t_s,x_m,y_m\n0,0,0\n2,0,0\n1,0,0\n", "row 3: found t = 1 s after 2 s"),
    ("t_s,x_m,y_m\n0,nan,0\n", "row 1, column x_m is 'nan'"),
    ("t_s,x_m,y_m\n0,1e30,0\n", "row 1, column x_m is '1e30'"),
    ("t_s,x_m,y_m\n,0,0\n", "column t_s is ''"),
    ("t_s,x_m\n0,0\n", "a column for y; name columns"),
    ("t_s,x_m,y_m,pusher_x_m\n0,0,0,0\n", "a column for pusher_y"),
    ("t_s,x_m,x_mm,y_m\n0,0,0,0\n", "found 'x_m' and 'x_mm'"),
    ("t_s,x_m,x_m,y_m\n0,0,0,0\n", "header: found 'x_m' twice"),
    ("t_s,x_deg,y_m\n0,0,0\n", "column x_deg: found a unit of angle"),
    ('t_s,x_m,y_m\n"0,5",0,0\n', "is '0,5', but must be a finite number; write a decimal point"),
    ("t_s;x_m;y_m\n0;1.000,5;0\n", "is '1.000,5', but must be a finite number"),
    ("t_s,x_m,y_m,touch_bool\n0,0,0,2\n", "column touch_bool is '2'"),
    ("t_s,x_m,y_m\n0,,\n", "no pose of the object"),
    ("t_s,x_m,y_m\n0,0\n", "2 cells, but fixel needs 3"),
    ("t_s,x_m,y_m\n", "a header without rows"),
    ("", "an empty file"),
])  # fmt: skip
def test_wrong_tables_are_refused(text, complaint, tmp_path):
    refused(plan_of, tmp_path, text, match=complaint)


@pytest.mark.parametrize("start", ["", "\ufeff"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(("separator", "point"), [(",", "."), (";", "."), (";", ","), ("\t", ",")])
def test_tables_of_spreadsheets_of_all_countries_are_alike(tmp_path, start, end, separator, point):
    """Marks of the encoding, ends of lines, separators and decimal commas change nothing."""
    rows = [["run", "t_s", "x_mm", "y_mm"], ["a,1"] * 4, ["a,1"] * 4]
    for row, numbers in zip(rows[1:], (("0", "-1.5", "2e-1"), ("0.5", ".25", "3")), strict=True):
        row[1:] = [number.replace(".", point) for number in numbers]
        row[0] = "a"
    path = tmp_path / "own.csv"
    path.write_bytes((start + end.join(map(separator.join, rows)) + end).encode())
    (own,) = fixel.read_experiments(path, split_by="run", progress=False)
    assert own.trajectory.time.tolist() == [0.0, 0.5]
    assert own.trajectory.pose[:, :2] == pytest.approx(
        np.array([[-1.5e-3, 2e-4], [2.5e-4, 3e-3]]), abs=0.0, rel=1e-15
    )


def test_the_place_of_an_error_is_the_row_of_the_file(tmp_path):
    rows = [f"{run},{t},0,0" for run in "abc" for t in (0, 1)]
    rows[3] = "b,x,0,0"
    plan = plan_of(tmp_path, "run,t_s,x_m,y_m\n" + "\n".join(rows) + "\n", split_by="run")
    (problem,) = plan.problems.values()
    assert str(problem).startswith("run 7.csv, row 4, column t_s (run b) is 'x'")


def test_a_misspelt_angle_is_named(tmp_path):
    plan = plan_of(tmp_path, "t_s,x_m,y_m,teta_deg\n0,0,0,1\n1,0,0,2\n")
    assert any("Is it 'teta_deg'?" in sentence for sentence in plan.understood)


def test_wrong_options_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"length_unit is 'ell', but must be one of m, mm"):
        plan_of(tmp_path, "t_s,x,y\n0,0,0\n", length_unit="ell")
    refused(plan_of, tmp_path, "t_s,x_m,y_m\n0,0,0\n", name=3, match="option name")


def test_inches_next_to_millimetres_are_inches(tmp_path):
    text = "time_s,x_in,y_in,pusher_x_mm,pusher_y_mm\n0,2,1,0,0\n1,3,1,1,0\n"
    experiment = experiment_of(tmp_path, text)
    assert experiment.trajectory.x == pytest.approx([0.0508, 0.0762])
    assert experiment.trajectory.y == pytest.approx([0.0254, 0.0254])
    assert [flag.name for flag in experiment.flags] == ["guessed-units", "no-angle"]


@pytest.mark.parametrize("title", ["x [px]", "x_px", "X (pix)"])
def test_pixels_are_no_lengths(tmp_path, title):
    text = f"time_s,{title},y_mm,theta_deg\n0,200,1,0\n1,201,1,0\n"
    refused(plan_of, tmp_path, text, match="found pixels")
    known = experiment_of(tmp_path, text, length_unit="mm")
    assert known.trajectory.x == pytest.approx([0.2, 0.201])
    other = experiment_of(tmp_path, text.replace("theta_deg", "x_mm"))
    assert other.trajectory.x == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("first", ["s,mm,cm,deg", "[s],(mm),cm,Deg"])
def test_a_first_row_of_units_counts_as_those_of_the_header(tmp_path, first):
    """The row was skipped as an experiment of one row, and 90 degrees were taken for radians."""
    text = f"time,x,y,theta\n{first}\n0,10,2,90\n1,12,2,91\n"
    table = plan_of(tmp_path, text)
    (experiment,) = table.experiments()

    assert experiment.trajectory.pose[0] == pytest.approx([0.010, 0.020, math.pi / 2])
    assert "The first row has units, which count as those of the header." in table.understood
    assert experiment.flags == ()  # nothing is a guess


@pytest.mark.parametrize("cell", ["", "-", "name"])
def test_a_row_of_units_is_no_experiment_of_a_split_table(tmp_path, cell):
    text = f"push,time,x,y\n{cell},s,mm,mm\na,0,1,2\na,1,2,2\nb,0,1,2\nb,1,3,2\n"
    table = plan_of(tmp_path, text, split_by="push")

    assert [own.name for own in table.experiments()] == ["a", "b"]
    assert table.problems == {}


def test_sentences_that_differ_in_numbers_are_one_with_their_ranges(tmp_path):
    text = "push,time_s,x_mm,y_mm\n"
    for push, n in (("a", 9), ("b", 4), ("c", 12)):
        text += "".join(f"{push},{k},{k},0\n" for k in range(n)) + f"{push},{n},,\n"
    understood = plan_of(tmp_path, text, split_by="push").understood

    assert understood[0] == "3 experiments, one for each value of 'push'."
    expected = "There is no pose of the object in 1 of 5 to 13 rows; its trajectory has the others."
    assert expected in understood
    assert not any("1 of 3" in sentence for sentence in understood)


def test_numbers_in_names_of_columns_are_no_ranges(tmp_path):
    text = "push,time_s,x_mm,y_mm,2,3\n" + "".join(
        f"{push},{k},{k},0,{k},{k}\n" for push in "ab" for k in range(3)
    )
    understood = plan_of(tmp_path, text, split_by="push").understood

    assert {"'2' has no unit and is skipped.", "'3' has no unit and is skipped."} <= {*understood}


def test_a_row_of_units_that_contradicts_the_header_is_refused(tmp_path):
    text = "time_s,x_mm,y_mm\ns,cm,mm\n0,1,2\n1,2,2\n"
    problem = refused(plan_of, tmp_path, text)
    assert problem.where == "run 7.csv, row 1, column x_mm"


def test_errors_below_a_row_of_units_have_the_row_of_the_file(tmp_path):
    problem = refused(plan_of, tmp_path, "time,x,y\ns,mm,mm\n0,1,2\n1,far,2\n")
    assert "row 3, column x" in str(problem)
