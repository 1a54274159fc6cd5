"""Folders of demos that another version of fixel began."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from fixel.jobs import folder as jobs
from fixel.model.records import Estimate, estimate_table
from fixel.testing.toy_work import MAKER
from fixel.workflows.demo import laboratory_demo
from fixel.workflows.demo.laboratory_demo import own_folder


def test_a_demo_of_another_version_gets_a_folder_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, said = tmp_path / "laboratory-1", []
    assert own_folder(begun, said.append) == begun
    jobs.prepare(begun / "project" / "jobs" / "one", maker=MAKER)
    assert own_folder(begun, said.append) == begun
    assert said == []
    monkeypatch.setattr("fixel.workflows.demo.laboratory_demo.stamp", lambda: "9.0+0123456789ab")
    own = tmp_path / "laboratory-1-456789ab"
    assert own_folder(begun, said.append) == own
    assert said == [f"another version of fixel began {begun}; using {own}"]


def test_truths_are_next_to_the_values_and_intervals_of_the_calibration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The demo wrote "open to 0.703" where all else states "at most 0.7033"."""
    estimates = [
        Estimate(
            label="tripod_radius",
            value=0.04999,
            unit="m",
            low=0.04214,
            high=0.05785,
            verdict="effective",
        ),
        Estimate(label="mu_fixel", value=0.1, unit="-", low=None, high=0.7033, verdict="at most"),
    ]
    record = SimpleNamespace(estimates=estimates, members=[])
    store = SimpleNamespace(calibration=lambda number: record)
    project = SimpleNamespace(store=lambda: nullcontext(store))
    monkeypatch.setattr(laboratory_demo, "true_mean", lambda label, experiments: 0.149)
    rows = laboratory_demo._compared_with_truth(project, 1).rows

    usual = estimate_table(estimates, 0.95).rows
    for own, other in zip(rows, usual, strict=True):
        assert (own[1], own[2], own[4]) == (other[1].strip(), *other[2:])
    assert rows[1][2:4] == ("at most 0.7033", "0.149")
