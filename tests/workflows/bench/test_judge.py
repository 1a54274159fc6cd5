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


@pytest.mark.system
@pytest.mark.usefixtures("small_laboratory")
def test_faults_are_noticed_and_their_rows_repeated(bench, monkeypatch):  # noqa: F811
    project, plan = bench
    monkeypatch.setattr(devices, "OVERLOAD", slice(1))
    monkeypatch.setattr(devices, "HIDDEN", slice(1, 2))
    with open_bench(project, plan, emulated=True, auto=True, fit=("mu_support",)) as loop:
        loop.run()
        attempts = list(loop.campaign.attempts.values())
    first, again = ([own for own in attempts if own.number == n] for n in (1, 2))
    for own, reason in zip(first, ("overload", "was not seen for"), strict=True):
        assert any(reason in found for found in own.reasons)
    assert [(own.state, own.reasons) for own in again] == [("accepted", ())] * 2


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
