"""What a simulation leaves behind, and its summary as the file format promises it."""

import json

import numpy as np
import pytest

from fixel.simulation import simulate
from fixel.simulation.result import CONTACT_FIELDS
from fixel.testing.scenes import STALL_FORCE, grasp, sliding_block

# Keys that other programs read; they stay as they are, new ones may be added.
PROMISED = {
    "status", "duration", "steps", "max_residual", "wall_time_s", "final", "pushers", "touching",
}  # fmt: skip
ADDED = {"fallbacks", "method"}


def test_summary_of_a_run_that_converged():
    run = simulate(grasp())
    answer = json.loads(json.dumps(run.summary()))
    assert set(answer) == PROMISED | ADDED
    assert answer["status"] == "converged"
    assert answer["duration"] == 11.0
    assert set(answer["final"]) == {"object", "actuator"}
    assert len(answer["final"]["object"]) == 3
    assert set(answer["pushers"]) == {"actuator"}
    trace = answer["pushers"]["actuator"]
    assert set(trace) == {"travel", "force", "stalled"}
    assert trace["stalled"] is True
    assert trace["force"] == pytest.approx(STALL_FORCE)
    # Where it stalls it may go on by the tolerance of a step, 1.3 um, and give way again.
    assert trace["travel"] == pytest.approx(answer["final"]["actuator"][0], abs=3e-6)
    assert ["object", "actuator"] in answer["touching"]
    assert answer["wall_time_s"] > 0.0


def test_summary_of_a_run_that_stopped():
    answer = simulate(grasp(force_limit=None)).summary()
    assert set(answer) == PROMISED | ADDED | {"stopped_at", "advice"}
    assert answer["status"] == "jammed"
    assert answer["stopped_at"] == answer["duration"] < 11.0


def test_contact_table():
    run = simulate(grasp(), output_interval=0.5)
    contacts = run.contacts
    assert contacts.dtype == CONTACT_FIELDS
    assert run.names == ("object", "actuator", "fixel-1", "fixel-2", "fixel-3")
    assert set(np.unique(contacts["body"])) == {0}
    assert set(contacts["time"]) <= set(run.time)
    # Normals point from the obstacle into the body: the head pushes along +x, pegs push back.
    head = contacts[(contacts["other"] == 1) & (contacts["time"] > 9.0)]
    pegs = contacts[(contacts["other"] > 1) & (contacts["time"] > 9.0)]
    assert (head["normal"][:, 0] > 0.5).all()
    assert (pegs["normal"][:, 0] < 0.0).all()
    # In the end nothing moves: contact forces balance, but for what the plane holds.
    last = contacts[contacts["time"] == run.time[-1]]
    tangent = np.column_stack((-last["normal"][:, 1], last["normal"][:, 0]))
    force = last["normal_force"][:, None] * last["normal"]
    force = force + last["tangential_force"][:, None] * tangent
    assert np.hypot(*force.sum(axis=0)) <= 0.25 * 0.15 * 9.81 + 1e-6


def test_touching_names_the_pairs_of_the_last_sample():
    assert simulate(sliding_block()).touching == []
    assert ("object", "actuator") in simulate(grasp()).touching


def test_no_pushers_no_traces():
    run = simulate(sliding_block())
    assert run.pushers == {}
    assert run.summary()["pushers"] == {}
    assert len(run.contacts) == 0
