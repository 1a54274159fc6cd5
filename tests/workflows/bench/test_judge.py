"""Reasons to repeat an attempt, at a laboratory whose faults are known."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import short_plan
from tests.workflows.bench.test_loop import bench  # noqa: F401

from fixel.formats.recording import RecordingHeader, RecordingWriter
from fixel.model import Trajectory
from fixel.testbed.simulated import SimulatedTestbed
from fixel.vision.frame import Frame
from fixel.workflows.acquisition.overlay import Tolerance
from fixel.workflows.bench import devices
from fixel.workflows.bench.judge import _reasons
from fixel.workflows.bench.run import open_bench


def reasons(bench, monkeypatch, **faults):  # noqa: F811
    """Reasons of the first attempt of each row at a laboratory with these faults."""
    project, plan = bench
    monkeypatch.setattr(devices, "HIDDEN", faults.get("hidden", slice(0)))
    monkeypatch.setattr(devices, "OVERLOAD", faults.get("overload", slice(0)))
    with open_bench(project, plan, emulated=True, auto=True, fit=("mu_support",)) as loop:
        loop.run()
        first = [own for own in loop.campaign.attempts.values() if own.number == 1]
        again = [own for own in loop.campaign.attempts.values() if own.number == 2]
    return [own.reasons for own in first], again


@pytest.mark.system
@pytest.mark.parametrize(
    ("fault", "reason"), [("overload", "overload"), ("hidden", "was not seen for")]
)
def test_a_fault_is_noticed_and_the_row_repeated(fault, reason, bench, monkeypatch):  # noqa: F811
    first, again = reasons(bench, monkeypatch, **{fault: slice(1)})
    assert any(reason in found for found in first[0])
    assert first[1] == ()
    assert [own.state for own in again] == ["accepted"]


def test_a_part_that_is_hidden_until_the_end_is_noticed(tmp_path):
    row = short_plan().experiments[0]
    (experiment,) = SimulatedTestbed(seed=1).run([row])
    track, loose = experiment.trajectory, Tolerance(distance=1.0, angle=1.0)
    with RecordingWriter(tmp_path / "film", RecordingHeader(size=(64, 48))) as film:
        for time in track.time:
            film.write(Frame(time, np.zeros((48, 64, 3), np.uint8)))

    def unseen(seen):
        part = Trajectory(time=track.time[seen], pose=track.pose[seen])
        own = replace(experiment, trajectory=part)
        return any("not seen" in why for why in _reasons(own, row.scene, tmp_path / "film", loose))

    middle = 0.5 * track.time[-1]
    assert not unseen(track.time >= 0.0)
    assert unseen(track.time < middle)
    assert unseen(track.time > middle)
