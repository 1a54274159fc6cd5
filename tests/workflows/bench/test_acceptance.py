"""The check of a bench by hand, at small numbers; the tests of the loop compare it with a truth."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import fixel
from fixel.errors import InvalidInput
from fixel.sampling import thesis_plan
from fixel.workflows.bench import acceptance
from fixel.workflows.bench.acceptance import BenchFigure, BenchRun, figure_table, measure_bench


def overlay_with(distance, angle):
    return SimpleNamespace(tolerance=SimpleNamespace(distance=distance, angle=angle))


def test_a_figure_is_good_up_to_what_is_needed():
    assert BenchFigure("a", 1e-3, 1e-3, "mm", "").verdict == "good"
    assert BenchFigure("a", -2e-3, 1e-3, "mm", "").verdict == "too large"
    assert BenchFigure("a", None, 1e-3, "mm", "").verdict == "not measured"
    table = figure_table([BenchFigure("a", 0.5, 1.0, "deg", "b")])
    assert table.rows[0] == ("a", "28.648 deg", "57.296 deg", "good", "b")


def test_placement_and_scatter_of_three_runs():
    first, other = thesis_plan().experiments[:2]
    here = first.scene.bodies[0].pose

    def run(row, start, end):
        poses = np.array([here + np.array([*start, 0.0]), here + np.array([*end, 0.0])])
        return BenchRun(row, first.scene, SimpleNamespace(trajectory=SimpleNamespace(pose=poses)))

    runs = [
        run(first, (3e-4, 4e-4), (0.050, 0.0)),
        run(first, (0.0, 0.0), (0.052, 0.0)),
        run(other, (0.0, 5e-4), (0.090, 0.0)),  # no other like it
    ]
    error, scatter = acceptance._experiments(runs, overlay_with(1e-3, 0.02))
    assert error.value == pytest.approx(math.sqrt(2 * 25e-8 / 3))
    assert scatter.value == pytest.approx(math.sqrt(2.0) * 1e-3)
    assert (error.verdict, scatter.verdict) == ("good", "too large")
    assert [own.value for own in acceptance._experiments([], overlay_with(1e-3, 0.02))] == [
        None
    ] * 2


@pytest.mark.parametrize("delay", [0.0, 0.07])
def test_the_delay_of_the_board_from_a_part_that_moves_against_a_fixel(delay):
    """A square of 40 mm moves at 20 mm/s; its side meets a peg of 5 mm at x = 35 mm after 0.5 s."""
    square = fixel.Body("part", fixel.Polygon.rectangle(0.04, 0.04), mass=0.1)
    peg = fixel.Fixel("peg", fixel.Disk(0.005), pose=(0.035, 0.0, 0.0), friction=0.2)
    far = fixel.Fixel("far", fixel.Disk(0.005), pose=(0.5, 0.0, 0.0), friction=0.2)
    scene = fixel.Scene(square, fixels=(peg, far))
    rng = np.random.default_rng(3)
    found = []
    for _ in range(40):
        time = np.arange(30) / 30.0 + rng.uniform(0.0, 1.0 / 30.0)
        x = np.minimum(0.02 * time, 0.01) + rng.normal(0.0, 5e-5, 30)
        poses = np.column_stack([x, rng.normal(0.0, 5e-5, 30), rng.normal(0.0, 1e-3, 30)])
        read = time + rng.uniform(0.0, 0.01, 30)
        touched = np.column_stack([read > 0.5 + delay, np.zeros(30)]).astype(float)
        touched[rng.integers(1, 10)] = 1.0  # a false report, long before
        channel = SimpleNamespace(time=read, values=touched)
        path = SimpleNamespace(time=time, pose=poses)
        experiment = SimpleNamespace(trajectory=path, channel={"tactile": channel}.get)
        found += acceptance.contact_delays(BenchRun(None, scene, experiment))
    assert len(found) == 40  # the peg far away was never touched
    assert np.median(found) == pytest.approx(delay, abs=5e-3)


def test_a_part_that_is_not_seen_is_refused():
    scene = thesis_plan().experiments[0].scene
    unseen = SimpleNamespace(name="object", measured=None)
    overlay = SimpleNamespace(scene=scene, look=lambda frame: SimpleNamespace(parts=[unseen]))
    frame = SimpleNamespace(time=0.0)
    devices = SimpleNamespace()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(acceptance, "_frames", lambda devices, n: [frame] * n)
        with pytest.raises(InvalidInput, match="part"):
            measure_bench(devices, overlay, [], lambda *how: None)


def test_a_part_at_half_a_turn_has_the_noise_of_its_angle(monkeypatch):
    rng, seen = np.random.default_rng(2), []
    angles = iter(math.pi + rng.permutation(np.linspace(-2e-3, 2e-3, 60)))
    scene = thesis_plan().experiments[0].scene

    def look(frame):
        angle = math.remainder(next(angles), 2.0 * math.pi)
        pose = np.array([0.1, 0.0, angle])
        return SimpleNamespace(parts=[SimpleNamespace(name="object", measured=pose)])

    overlay = SimpleNamespace(scene=scene, look=look, tolerance=overlay_with(1e-3, 0.1).tolerance)
    devices = SimpleNamespace(way_to=lambda scene, part: seen.append(part) or [])
    frames = [SimpleNamespace(time=0.1 * k) for k in range(60)]
    monkeypatch.setattr(acceptance, "_frames", lambda devices, n: frames)
    monkeypatch.setattr(acceptance, "_drive", lambda *given: ())
    monkeypatch.setattr(acceptance, "_board", lambda *given: ())
    figures = measure_bench(devices, overlay, [], lambda *how: None)
    (angle,) = (own.value for own in figures if own.name == "camera noise, angle")
    assert angle == pytest.approx(4e-3 / math.sqrt(12.0), rel=0.05)  # of an even distribution
    assert math.cos(seen[0][2]) < -0.99999
