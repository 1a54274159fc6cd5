"""The public function against its parts, and what it refuses."""

import math

import numpy as np
import pytest
from tests.uncertainty.forks import fork

import fixel
from fixel.errors import InvalidInput
from fixel.testing.scenes import micro_push
from fixel.uncertainty.starts import ASME, StartError
from fixel.workflows.analysis import load_analyses
from fixel.workflows.sensitivity.run import sensitivity

SMALL = StartError(x=3e-4, y=3e-4, theta=math.radians(0.5), kind="uniform")
QUIET = {"progress": False, "threads": 1}


def test_a_fork_bifurcates_and_says_so():
    found = sensitivity(fork(), SMALL, samples=60, motion="quasistatic", **QUIET)
    assert found.flag == "bifurcates"
    assert "bifurcates" in repr(found)
    assert "2 separate outcomes" in repr(found)
    data = found.to_dict()
    assert len(data["end_x"]) == 60
    assert set(data["outcome"]) == {0, 1}
    # Outcomes are the two sides of the fixel.
    side = np.sign(np.array(data["end_y"]))
    assert len({(o, s) for o, s in zip(data["outcome"], side, strict=True)}) == 2


def test_reports_of_progress_end_at_the_number_of_starts():
    seen = []
    sensitivity(micro_push(1), ASME, samples=50, progress=seen.append, threads=1)
    assert (seen[-1].done, seen[-1].total) == (51, 51)


def test_wrong_input_is_refused():
    with pytest.raises(InvalidInput, match="at least 50"):
        sensitivity(micro_push(1), ASME, samples=20, **QUIET)
    with pytest.raises(InvalidInput, match="motion"):
        sensitivity(micro_push(1), ASME, motion="slow", **QUIET)
    with pytest.raises(InvalidInput, match="a scene file or an Experiment"):
        sensitivity(42, ASME, **QUIET)
    with pytest.raises(InvalidInput, match="mu_pusher"):
        sensitivity(micro_push(1), ASME, {"mu_pushr": 0.2}, **QUIET)


def test_a_project_stores_a_sensitivity_and_refuses_what_no_command_stores(tmp_path, monkeypatch):
    monkeypatch.setattr("fixel.workflows.analysis.write_picture", lambda *_: [])
    lab = fixel.Project.create(tmp_path / "lab")
    found = sensitivity(micro_push(1), ASME, samples=50, **QUIET)
    kept = lab.add(found)
    (stored,) = load_analyses(lab, "sensitivity")
    assert kept.folder == stored.folder
    (push,) = stored.analysis.numbers["pushes"]
    assert push["flag"] == found.flag
    assert lab.add(found).folder == kept.folder
    assert lab.add(sensitivity(micro_push(2), ASME, samples=50, **QUIET)).folder != kept.folder
    with pytest.raises(InvalidInput, match=r"Prediction, which projects do not store.*\.save"):
        lab.add(found.prediction)
