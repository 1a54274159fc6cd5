"""Folders of strangers: jobs with links and keys, modules next to them, and names in terminals."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import sys
from collections.abc import Callable
from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import Any

import pytest
from tests.fixtures import calibration_record, project_of, refused
from tests.jobs.helpers import await_true
from typer.testing import CliRunner

from fixel.cli.main import app, run
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.jobs import link
from fixel.jobs.folder import RunSettings, write_run
from fixel.jobs.worker_process import WorkerProcess
from fixel.testing.pushes import example_pushes
from fixel.testing.toy_work import MAKER
from fixel.web.views.calibration_views import load_detail
from fixel.workflows import jobs
from fixel.workflows.capabilities import CAPABILITIES, prepare, prepare_in
from fixel.workflows.installation import _compiled

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


# --- folders of jobs ------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform == "win32", reason="links need a permission there")
@pytest.mark.parametrize("name", [
    "log.txt", "journal", "journal.lock", "result", "inputs/a", "late", "workers", "workers/x.log",
])  # fmt: skip
def test_a_job_with_a_link_is_refused(name: str, tmp_path: Path) -> None:
    """A run would write, empty or delete what the link leads to, and a packed job would have it."""
    job, precious = job_in(tmp_path / "job"), tmp_path / "own"
    precious.mkdir()
    thesis = precious / "thesis.txt"
    thesis.write_text("ten pages")
    path = job / name
    path.unlink(missing_ok=True)
    path.parent.mkdir(exist_ok=True)
    path.symlink_to(precious if name in ("late", "workers") else thesis)
    steps: list[Callable[[], Any]] = [
        lambda: jobs.arrange(job),
        lambda: jobs.run_here(job),
        lambda: jobs.pack(job, tmp_path / "packed.zip"),
        lambda: list(jobs.log_lines(job)),
        lambda: jobs.cancel(job),
    ]
    for step in steps:
        refused(step, match="found a link")
    assert jobs.readable_status(job).state == "unreadable"
    assert [*precious.iterdir()] == [thesis]
    assert thesis.read_text() == "ten pages"


@pytest.mark.skipif(sys.platform == "win32", reason="several workers need Linux or macOS")
def test_the_key_of_a_foreign_folder_is_replaced(tmp_path: Path) -> None:
    pytest.importorskip("cryptography")
    tls = tmp_path / "tls"
    tls.mkdir()
    tls.chmod(0o777)
    known = {}
    for name in ("key.pem", "certificate.pem"):
        (tls / name).write_text(f"{name} of a stranger")
        known[name] = (tls / name).stat().st_ino
    link.make_tls(tmp_path)
    for name in known:
        assert "stranger" not in (tls / name).read_text()
        assert (tls / name).stat().st_mode & 0o777 == 0o600
    assert tls.stat().st_mode & 0o777 == 0o700
    first = (tls / "key.pem").read_text()
    link.make_tls(tmp_path)
    assert (tls / "key.pem").read_text() != first


def test_a_job_writes_no_file_outside_its_project(tmp_path: Path) -> None:
    project = project_of(tmp_path / "lab", example_pushes(2, duration=0.3))
    mine = tmp_path / "own.fixel"
    mine.write_text("mine")
    capability = CAPABILITIES["table-map"]
    request = capability.request({"out": mine})
    refused(prepare, capability, request, project, match="in the folder of the project")
    job = project.folder / "jobs" / "foreign"
    prepare_in(job, capability, request, {})  # as a stranger could
    refused(jobs.run_here, job, match="in the folder of the project")
    assert mine.read_text() == "mine"
    inside = capability.request({"out": project.folder / "own.fixel"})
    assert prepare(capability, inside, project).is_dir()


# --- settings of a project ------------------------------------------------------------------------


@pytest.mark.parametrize("url", [
    "sqlite:///file:{outside}?uri=true", "sqlite:///file:..%2foutside.db?uri=true",
    "sqlite:///experiments.db?uri=true", "sqlite:///%2e%2e/outside.db", "sqlite://@/{outside}",
    "duckdb:///{outside}", "mysql://host/name",
])  # fmt: skip
def test_settings_name_no_file_outside_by_another_spelling(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A URI, or the file of another kind of database, in a project that the user works in."""
    lab, outside = tmp_path / "lab", tmp_path / "outside.db"
    Project.create(lab)
    (lab / "fixel.yaml").write_text(f"name: lab\ndatabase: {url.format(outside=outside)!r}\n")
    monkeypatch.chdir(lab)
    for place in (Path(), lab):
        with pytest.raises(Exception, match=r"database: found|is not a database URL"):
            Project(place).upgrade()
    assert not outside.exists()


@pytest.mark.parametrize("name", ["media", "analyses", "jobs", "cache", "bench/one", "jobs/one"])
def test_a_project_with_links_to_elsewhere_is_opened_only_if_it_is_trusted(
    name: str, tmp_path: Path
) -> None:
    lab = Project.create(tmp_path / "lab").folder
    here, there, other = lab / "own", tmp_path / "precious", tmp_path / "other"
    path = lab / name
    for folder in (here, there, other, path.parent):
        folder.mkdir(exist_ok=True)
    with contextlib.suppress(FileNotFoundError):
        path.rmdir()
    path.symlink_to(here)
    Project(lab)
    for target in (there, other):
        path.unlink()
        path.symlink_to(target)
        refused(Project, lab, match=f"leads to {target}, by the link {name}")
        assert CliRunner().invoke(app, ["trust", str(lab)]).exit_code == 0
        Project(lab)
    assert CliRunner().invoke(app, ["trust", str(lab), "--remove"]).exit_code == 0
    refused(Project, lab, match=r"run: fixel trust")


def test_a_server_of_foreign_settings_is_not_contacted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server may request the password of the user, which drivers find in their files."""
    lab = Project.create(tmp_path / "lab").folder
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)
        url = f"postgresql+psycopg://me:secret@127.0.0.1:{server.getsockname()[1]}/name"
        (lab / "fixel.yaml").write_text(f"name: lab\ndatabase: {url}\n")
        answer = CliRunner().invoke(app, ["list", "--project", str(lab)])
        assert isinstance(answer.exception, InvalidInput)
        assert "leads to the database postgresql+psycopg://127.0.0.1:" in str(answer.exception)
        with pytest.raises(TimeoutError):
            server.accept()
    answer = CliRunner().invoke(app, ["trust", str(lab)])
    assert "secret" not in answer.output
    assert Project(lab).url == url
    (lab / "fixel.yaml").write_text(f"name: lab\ndatabase: {url}/other\n")
    monkeypatch.setenv("FIXEL_DATABASE", "sqlite:///mine.db")  # the server is not used
    Project(lab)
    monkeypatch.delenv("FIXEL_DATABASE")
    refused(Project, lab, match="name/other")


# --- commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("stored", "shown"), [
    ("fixel domain --project 'a b' --fit 2", "fixel domain --project 'a b' --fit 2"),
    ("fixel compare 1 --engine mujoco:step=0.001", "fixel compare 1 --engine mujoco:step=0.001"),
    ("fixel domain; rm x", "fixel 'domain;' rm x"),
    ("fixel list $(rm x)", "fixel list '$(rm' 'x)'"),
    ("fixel calibrate --site a --site b --name c", "fixel calibrate --name c"),
    ("rm x", ""),
    ("fixel trust ./mine", ""),
    ("fixel compare 1 --engine /bin/sh:-c,ls", ""),
    ("fixel compare 1 --motion=/bin/sh", ""),
    ("fixel 'list", ""),
])  # fmt: skip
def test_a_stored_command_that_a_user_may_paste_runs_nothing_else(
    stored: str, shown: str, tmp_path: Path
) -> None:
    lab = project_of(tmp_path / "lab", example_pushes(1, duration=0.3))
    analysis = lab.folder / "analyses" / "foreign" / "analysis.json"
    analysis.parent.mkdir(parents=True)
    content = {"kind": "domain", "title": "Domain", "question": {}, "headline": ["one"]}
    analysis.write_text(json.dumps(content | {"command": stored}))
    with lab.store() as store:
        record = calibration_record({1: 1.0}, {"mu_pusher": 0.2})
        origin = replace(record.provenance, command=stored)
        number = store.add_calibration(replace(record, provenance=origin))
        assert load_detail(lab, store, number).command == shown
    assert lab.analyses[0].analysis.command == shown


# --- terminals ------------------------------------------------------------------------------------


def test_no_control_sequence_of_a_file_reaches_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = project_of(tmp_path / "lab", example_pushes(1, duration=0.3)).folder
    job = job_in(lab / "jobs" / "one")
    (job / "state.json").write_text('{"state": "failed", "reason": "\\u001b]0;mine\\u0007\\u202e"}')
    (job / "log.txt").write_text(SEQUENCE)
    (tmp_path / "table.csv").write_text(f"time_s,x_mm,{SEQUENCE}\n1,2,3\n")
    commands = (
        ["jobs", "status", str(lab)],
        ["jobs", "status", str(job)],
        ["jobs", "logs", str(job)],
        ["import", str(tmp_path / "table.csv"), "--project", str(lab)],
    )
    for words in commands:
        with pytest.raises(SystemExit):
            run(words)
        said = "".join(capsys.readouterr())
        assert r"\x1b]0;mine\x07" in said
        assert not {"\x1b", "\x07", "\u202e"} & {*said}
