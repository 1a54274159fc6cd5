"""Motions made ready to be shown."""

from dataclasses import replace

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.model import Disk
from fixel.model.shape import placed
from fixel.sampling import thesis_plan
from fixel.simulation import simulate
from fixel.simulation.geometry import gap
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.scenes import grasp
from fixel.web.views.motion_views import (
    _continuous,
    animation_of_experiment,
    animation_of_scene,
    contacts_of,
    measured_motion,
    simulated_motion,
    things_of,
)

SAMPLES = 440  # as a page shows a run of this length
CARRIED = 3e-4  # [m]: half a sample at the speed of the pusher, and what slides within a step
MAX_STEP = 5e-3  # [m] of the pusher


@pytest.fixture(scope="module")
def simulation():
    scene = grasp()
    return simulate(scene, output_interval=scene.duration / SAMPLES)


@pytest.fixture(scope="module")
def story(simulation):
    return animation_of_scene(simulation.scene, [simulated_motion(simulation)], "a grasp")


def test_contact_points_lie_between_the_two_at_every_sample(simulation, story):
    motion = story.motions[0]
    contacts = motion.contacts
    assert len(contacts.sample) > SAMPLES
    assert (np.diff(contacts.sample) >= 0).all()
    point, apart = Disk(1e-6), []
    for sample, pair, place in list(
        zip(contacts.sample, contacts.pair, contacts.point, strict=True)
    )[::5]:
        for k in pair:
            thing = story.things[k]
            pose = motion.pose[thing.name][sample] if thing.name in motion.pose else thing.pose
            apart.append(abs(gap(point, (*place, 0.0), thing.shape, pose).distance))
    # A step in which two meet has its force from its start on, where they are still apart.
    assert np.quantile(apart, 0.9) < CARRIED
    assert max(apart) < MAX_STEP


def test_forces_are_those_of_the_simulation_and_push_the_part_away(simulation, story):
    contacts = story.motions[0].contacts
    rows = simulation.contacts
    size = np.hypot(rows["normal_force"], rows["tangential_force"])
    assert np.hypot(*contacts.force.T) == pytest.approx(size, abs=1e-12)
    first = rows["body"] == 0
    assert first.any()
    assert (np.sum(contacts.force[first] * rows["normal"][first], axis=1) >= -1e-9).all()


def test_the_box_holds_everything_at_all_times(story):
    x0, y0, x1, y1 = story.box
    motion = story.motions[0]
    for thing in story.things:
        for pose in motion.pose.get(thing.name, [thing.pose]):
            outline = placed(thing.shape.outline, pose)
            assert (outline >= (x0, y0)).all()
            assert (outline <= (x1, y1)).all()


def test_things_have_roles_in_the_order_of_the_scenes_names(simulation):
    things = things_of(simulation.scene, "object")
    assert [thing.name for thing in things] == list(simulation.scene.names)
    assert [thing.role for thing in things] == ["object", "pusher", "fixel", "fixel", "fixel"]


def test_a_simulation_without_contacts_has_none(simulation):
    assert len(contacts_of(simulation, 0).sample) == 0


def test_angles_are_continuous():
    pose = np.zeros((40, 3))
    pose[:, 2] = np.mod(np.linspace(0.0, 9.0, 40) + np.pi, 2 * np.pi) - np.pi
    assert np.abs(np.diff(_continuous(pose)[:, 2])).max() < 0.3


def test_an_experiment_without_a_drawing_is_refused():

    experiment = next(iter(SimulatedTestbed(seed=1).run(thesis_plan().experiments[:1])))
    motion = measured_motion(experiment)
    assert motion.kind == "measured"
    assert motion.touch.names == ["fixel 1", "fixel 2", "fixel 3"]
    assert set(motion.pose) == {"object", experiment.scene.pushers[0].name}
    with pytest.raises(InvalidInput, match="no scene"):
        animation_of_experiment(replace(experiment, scene=None, contact_mode=""), [])
