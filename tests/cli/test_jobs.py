"""`fixel jobs`: what is printed, what is left behind, exit codes."""

import json
import os
import signal
import subprocess
import sys
from functools import partial

import pytest
import yaml
from tests.cli.shell import invoked, output, refusal
from tests.jobs.helpers import await_true, names_in, start
from tests.jobs.kinds import toy_job

from fixel.cli import jobs
from fixel.cli.screen import job_bar
from fixel.errors import InvalidInput
from fixel.jobs.site import load_site
from fixel.jobs.work import JobProgress

OPTIONS = {"rounds": 2, "chunks": 4}
call = partial(invoked, jobs.app)


@pytest.fixture
def folder(tmp_path):
    return toy_job(tmp_path / "jobs" / "my toy", **OPTIONS)


@pytest.fixture(autouse=True)
def _own_sigterm():
    """A command takes SIGTERM over; the tests' own handling comes back."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def test_a_job_to_its_end(folder):
    code, out = call("submit", folder)
    assert code == 0
    assert out.splitlines() == [
        f"{folder} is done; 8 of 8 chunks",
        f"the result is in {folder}/result",
    ]
    again = call("submit", folder)
    assert again == (code, out)  # done is done
    assert call("logs", folder)[1].splitlines()[-1].endswith(" done")


def test_as_json(folder):
    answer = json.loads(call("submit", folder, "--json")[1])
    assert (answer["state"], answer["done"], answer["total"], answer["kept"]) == ("done", 8, 8, 8)
    listing = json.loads(call("status", folder, folder.parent.parent, "--json")[1])
    assert listing == {"jobs": [answer, answer]}
    assert json.loads(call("cancel", folder, "--json")[1])["state"] == "done"


def test_status_of_a_project(folder, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, out = call("status")
    assert code == 0
    assert out.splitlines() == [
        "job          state   done  of  failed  workers  rate [1/s]  left",
        "jobs/my toy  queued     0   ?       0        0           0",
        "",
        "Next: fixel jobs submit 'jobs/my toy'",
    ]
    monkeypatch.chdir(folder)
    assert call("status")[1].splitlines()[-1] == "Next: fixel jobs submit ."


@pytest.mark.system
def test_a_lost_job_says_what_is_kept_and_what_goes_on(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS | {"sleep_s": 0.3})
    coordinator = start(folder)
    await_true(lambda: names_in(folder), "an answer")
    coordinator.kill()
    coordinator.wait()
    out = call("status", folder)[1]
    assert " lost " in out
    kept = len(names_in(folder))
    assert out.splitlines()[-2:] == [
        f"The process that ran {folder} has died. {kept} chunks are stored; "
        "resume continues from them.",
        f"Next: fixel jobs resume {folder}",
    ]
    assert call("resume", folder)[0] == 0


@pytest.mark.system
def test_detached_and_cancelled(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS | {"sleep_s": 0.5})
    code, out = call("submit", folder, "--detach")
    assert code == 0
    assert out.splitlines()[-1] == f"Next: fixel jobs logs -f {folder}"
    out = call("cancel", folder)[1]
    assert f"{folder} is cancelled" in out
    assert out.splitlines()[-1] == f"Next: fixel jobs resume {folder}"


@pytest.mark.system
def test_ctrl_c_says_how_to_go_on(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS | {"sleep_s": 0.2})
    script = "from fixel.cli.main import run; run()"
    command = [sys.executable, "-c", script, "jobs", "submit", str(folder)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ)
    await_true(lambda: names_in(folder), "an answer")
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert f"Resume with: fixel jobs resume {folder}" in said
    assert "Traceback" not in said
    assert call("resume", folder)[1].splitlines()[0] == f"{folder} is done; 8 of 8 chunks"


def test_the_status_of_a_folder_that_does_not_exist_is_refused(tmp_path, capsys):
    said = refusal(capsys, "jobs", "status", tmp_path / "none")
    assert f"{tmp_path / 'none'}: found no job" in said
    assert "fixel jobs status --project FOLDER" in said
    listed = output(capsys, "jobs", "status", tmp_path)
    assert listed.splitlines()[0] == "no jobs in this folder"


def test_failed_chunks_are_counted(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS, faulty=["r0-c1"])
    assert "8 of 8 chunks, 1 of them failed" in call("submit", folder)[1]


def test_the_template_can_be_read(tmp_path):
    code, out = call("site")
    (tmp_path / "site.yaml").write_text(out)
    assert code == 0
    assert load_site(tmp_path / "site.yaml").cores == 4
    assert "#" in out
    assert yaml.safe_load(out)["interface"] == "ib0"


def test_packed_and_unpacked(folder, tmp_path):
    call("submit", folder)
    code, out = call("pack", folder, tmp_path / "toy.zip")
    assert code == 0
    assert out.splitlines()[-1] == f"Next: fixel jobs unpack {tmp_path}/toy.zip toy-job"
    out = call("unpack", tmp_path / "toy.zip", tmp_path / "copy")[1]
    assert out.splitlines()[0] == f"{tmp_path}/copy is done; 8 of 8 chunks"


@pytest.mark.parametrize("name", ["submit", "resume", "cancel", "logs", "status"])
def test_a_folder_that_is_no_job(name, tmp_path):
    (tmp_path / "job.json").touch() if name == "status" else None
    with pytest.raises(InvalidInput):
        call(name, tmp_path)


def test_a_place_that_is_none(folder):
    with pytest.raises(InvalidInput, match=r"--coordinator is 'there', .* 'here' or 'slurm'"):
        call("submit", folder, "--coordinator", "there")


def _progress(**changes):
    usual = {
        "done": 18, "total": 18, "failed": 0, "rate": 0.5, "left_s": None, "note": "search",
        "workers": 1,
    }  # fmt: skip
    return JobProgress(**(usual | changes))


@pytest.fixture
def show_on(monkeypatch):
    """The bar of a terminal, or of a file."""

    def show(terminal):
        monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
        return job_bar()

    return show


def test_the_bar_is_empty_while_the_total_is_unknown(capsys, show_on):
    show_on(True)(_progress())
    said = capsys.readouterr().err
    assert "#" not in said
    assert "18 chunks done" in said
    assert "\n" not in said


def test_the_bar_is_full_at_the_end_alone(capsys, show_on):
    show = show_on(True)
    show(_progress(share=0.99, left_s=2.0))
    said = capsys.readouterr().err
    assert "#." in said
    assert "99 %" in said
    assert "about 2 s left" in said
    show(_progress(share=1.0))
    said = capsys.readouterr().err
    assert ".]" not in said
    assert said.endswith("\n")


def test_without_a_terminal_there_is_a_line_every_half_minute(capsys, show_on, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    show = show_on(False)
    assert show is not None
    for _ in range(181):
        show(_progress(left_s=9.0))
        now[0] += 0.5
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert lines[0] == "18 chunks done, search, 0.5/s, about 9 s left"


def test_no_command_is_proposed_for_a_folder_that_cannot_be_read(folder):
    (folder / "job.json").write_text("{")
    code, out = call("status", "--project", folder.parents[1])
    assert code == 0
    assert "unreadable" in out
    assert "Next:" not in out
