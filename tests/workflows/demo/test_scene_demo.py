"""The tour: the grasp visibly turns, travels, meets two fixels, seats, and holds."""

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.formats import load_scene
from fixel.simulation import simulate
from fixel.workflows.demo.scene_demo import example_names, example_text, motion_events, run_demo


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fixel.drawing.animation.RATE", 3)  # a film of few pictures
        return run_demo(tmp_path_factory.mktemp("demo") / "new" / "folder")


@pytest.mark.system
def test_files_are_left_behind(demo):
    assert set(demo.files) == {"scene", "plot", "animate", "trajectory"}
    assert all(path.stat().st_size > 500 for path in demo.files.values())
    assert demo.files["scene"].read_text() == example_text("grasp")


@pytest.mark.system
def test_the_story_is_complete_and_in_order(demo):
    times = [event.time for event in demo.events]
    values = " | ".join(event.text for event in demo.events)

    assert times == sorted(times)
    for part in (
        "actuator touches object",
        "face to face",
        "object meets fixel-1",
        "object meets fixel-2",
        "after sliding along it",
        "seated on fixel-1 and fixel-2; the drive stalls at 34.3 N",
        "drift since the stall",
    ):
        assert part in values


@pytest.mark.system
def test_the_first_touch_is_where_geometry_says(demo):
    """0.7768071 s, by bisection of the distance between head and square."""
    touch = next(event for event in demo.events if "touches" in event.text)

    # At 13.5 mm/s the step before ends a tenth of its tolerance of 1.3 um early.
    assert touch.time == pytest.approx(0.7768071, abs=2e-5)


@pytest.mark.system
def test_the_grasp_turns_both_ways_and_holds_still(demo):
    run = demo.simulation
    angle = np.degrees(run.pose["object"][:, 2])
    held = run.pose["object"][run.time > 8.0]

    assert angle[0] == pytest.approx(22.5)
    assert np.abs(angle).min() < 0.1
    assert angle[-1] < -5.0
    assert np.ptp(held[:, :2], axis=0).max() < 1e-9
    assert bool(run.pushers["actuator"].stalled[-1])


def test_a_folder_that_cannot_be_made_is_a_sentence(tmp_path):
    (tmp_path / "file").write_text("")

    with pytest.raises(InvalidInput, match="fixel needs a folder to write to"):
        run_demo(tmp_path / "file" / "below")


@pytest.mark.parametrize("name", example_names())
def test_every_example_can_be_simulated_and_described(name, tmp_path):
    path = tmp_path / f"{name}.yaml"
    path.write_text(example_text(name))

    run = simulate(load_scene(path).scene)

    assert run.converged
    assert motion_events(run)
