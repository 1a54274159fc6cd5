"""Folders of strangers: jobs with links and keys, modules next to them, and names in terminals."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from math import sqrt
from pathlib import Path
from typing import Any

import pytest
from tests.fixtures import project_of
from tests.jobs.helpers import await_true

from fixel.cli.main import run
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.jobs import link
from fixel.jobs.folder import RunSettings, write_run
from fixel.jobs.worker_process import WorkerProcess
from fixel.testing.pushes import example_pushes
from fixel.testing.toy_work import MAKER
from fixel.workflows import jobs
from fixel.workflows.capabilities import CAPABILITIES, prepare, prepare_in
from fixel.workflows.compilation import _compiled

SEQUENCE = "\x1b]0;mine\x07"  # changes the title of a terminal


def job_in(folder: Path) -> Path:
    options = {"rounds": 1, "chunks": 2}
    jobs.prepare_job(folder, maker=MAKER, inputs={"a": b"x"}, options=options)
    return folder


# --- modules in the folder where the user works ---------------------------------------------------


def start_job(folder: Path) -> None:
    job = job_in(folder / "job")
    write_run(job, RunSettings(workers=1))
    jobs.run_detached(job)
    await_true(lambda: jobs.status_of(job).ended, "the job to end")
    assert jobs.status_of(job).state == "done"


def call_process(folder: Path) -> None:
    with WorkerProcess(sqrt, limit=30.0) as root:
        assert root.call(9.0) == 3.0


def compile_nothing(folder: Path) -> None:
    assert "unknown" in _compiled("unknown").problem


@pytest.mark.system
@pytest.mark.parametrize("start", [start_job, call_process, compile_nothing])
def test_no_process_imports_a_module_of_the_folder_that_it_starts_in(
    start: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder of a stranger has `numpy.py` and others, and the user works in it."""
    if start is start_job:
        pytest.importorskip("distributed")
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    mark = tmp_path / "mark"
    for name in ("numpy", "signal", "struct", "yaml"):
        (tmp_path / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').close()\n")
    monkeypatch.chdir(tmp_path)
    start(tmp_path)
    assert not mark.exists()
    assert "PYTHONSAFEPATH" not in os.environ
