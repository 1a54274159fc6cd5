"""Folders of demos that another version of fixel began."""

from pathlib import Path

import pytest

from fixel.jobs import folder as jobs
from fixel.testing.toy_work import MAKER
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
