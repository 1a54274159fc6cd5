"""The pages of jobs and of the system, and what is below them."""

import sqlite3
from pathlib import Path

import pytest
from tests.jobs.helpers import await_true as until

from fixel.jobs import folder as files
from fixel.jobs.folder import JobState
from fixel.testing.toy_work import MAKER
from fixel.web.api import system
from fixel.web.values import size
from fixel.web.views import job_list
from fixel.workflows import jobs

pytestmark = pytest.mark.system


def job(bench, name, **options):
    """Prepare a job of toy work; return its folder."""
    folder = bench.folder / "jobs" / name
    jobs.prepare_job(folder, maker=MAKER, options=options)
    return folder


# --- jobs -------------------------------------------------------------------------------------


def test_names_are_compared_and_never_paths(bench):
    job(bench, "first <b>one & %2e")
    assert bench.get("/jobs/first%20%3Cb%3Eone%20%26%20%252e")["job"]["state"] == "queued"
    for name in ("..%2f..", "%2e%2e", "first", "first%20%3Cb%3Eone%2Fx", "%00", "a" * 300):
        assert bench.client.get(f"/api/v1/jobs/{name}").status_code in (404, 422), name
        assert bench.send(f"/jobs/{name}/resume", None).status_code in (404, 405, 422), name


def test_from_the_queue_to_the_end(bench):
    folder = job(bench, "toy", rounds=300, chunks=8, sleep_s=0.05)
    assert bench.get("/jobs/toy")["job"]["can_resume"]
    assert not bench.post("/jobs/toy/resume")["job"]["can_resume"]
    assert bench.post("/jobs/toy/resume", status=409)["status"] == 409
    until(lambda: bench.get("/jobs/toy")["job"]["done"] > 0)
    assert any("running" in line for line in bench.get("/jobs/toy/log?lines=5")["lines"])
    ended = bench.post("/jobs/toy/cancel")["job"]
    assert ended["state"] == "cancelled"
    assert ended["kept"] > 0
    assert ended["can_resume"]
    assert "fixel jobs resume" in ended["command"]
    assert files.coordinator_of(folder) is None


def test_only_so_many_run_at_once_whatever_they_are(bench, monkeypatch):
    monkeypatch.setattr(job_list, "MAX_AT_ONCE", 1)
    job(bench, "long", rounds=300, chunks=8, sleep_s=0.05)
    job(bench, "other")
    bench.post("/jobs/long/resume")
    try:
        for address, body in (("/jobs/other/resume", None), ("/run/domain", {"axes": ["shape"]})):
            assert "running" in bench.post(address, body, 409)["sentence"]
    finally:
        bench.post("/jobs/long/cancel")
    bench.post("/jobs/other/resume")
    bench.post("/jobs/other/cancel")


def test_lost_and_repeated_work_is_counted(bench):
    folder = job(bench, "lost")
    said = JobState(state="running", done=3, total=9, deaths=2, again=4, host="node1", pid=7)
    files.write_status(folder, said)
    workers = folder / "workers"
    workers.mkdir()
    (workers / "local-7-1-1.json").write_text('{"host": "node1", "pid": 9}')
    (workers / "local-7-1-2.log").touch()
    (workers / "scheduler.log").touch()
    (workers / "slurm-3.refused").write_text("has another fixel")
    found = bench.get("/jobs/lost")
    assert found["job"]["state"] == "lost"
    assert (found["job"]["deaths"], found["job"]["again"]) == (2, 4)
    assert found["job"]["can_resume"]
    states = {worker["name"]: worker["state"] for worker in found["workers"]}
    assert states == {"slurm-3": "refused", "local-7-1-1": "ended", "local-7-1-2": "ended"}
    assert bench.post("/jobs/lost/cancel")["job"]["state"] == "cancelled"


def test_what_another_program_wrote_there_is_shown_as_such(bench):
    strange = bench.folder / "jobs" / "strange"
    strange.mkdir(parents=True)
    (strange / "job.json").write_text("{")
    found = next(job for job in bench.get("/jobs")["jobs"] if job["name"] == "strange")
    assert found["state"] == "unreadable"
    assert found["reason"]
    assert bench.get("/jobs/strange/log") == {"lines": [], "whole": True}
    bench.post("/jobs/strange/cancel", status=422)


def test_long_logs_are_shown_by_their_ends(bench):
    folder = job(bench, "talkative")
    (folder / "log.txt").write_bytes(b"\xff\x1b[31m" + b"word\n" * 200_000 + b"last\n")
    log = bench.get("/jobs/talkative/log?lines=3")
    assert log == {"lines": ["word", "word", "last"], "whole": False}


# --- the system -------------------------------------------------------------------------------


def test_what_is_gone_while_it_is_counted_is_not_counted(bench, monkeypatch):
    media, real = bench.context.project.media, Path.glob
    before = system.disk_status(bench.context.project)
    gone = media / "ab" / ".ab12.temporary"
    monkeypatch.setattr(Path, "glob", lambda path, what: [gone, *real(path, what)])
    assert system.disk_status(bench.context.project).media_files == before.media_files


def test_versions_database_and_room(bench):
    known = bench.get("/system")
    assert known["versions"]["fixel"]
    assert known["database"]["engine"] == "sqlite"
    assert known["database"]["schema_version"] == known["database"]["newest"]
    assert known["database"]["pending"] == []
    assert known["database"]["size_bytes"] > 100_000
    assert known["disk"]["free_bytes"] > 0


def test_passwords_are_not_shown(monkeypatch, project):
    assert ":***@" in system.sa.make_url("postgresql://lab:hush@server/x").render_as_string()


def test_a_backup_is_made_and_fetched(bench, tmp_path):
    made = bench.post("/system/backups")
    one, two = made["backup"], bench.post("/system/backups")["backup"]
    assert one["name"] != two["name"]
    names = [backup["name"] for backup in bench.get("/system")["backups"]]
    assert names[:2] == [two["name"], one["name"]]
    answer = bench.client.get(f"/api/v1/system/backups/{one['name']}")
    assert "attachment" in answer.headers["content-disposition"]
    copy = tmp_path / "copy.db"
    copy.write_bytes(answer.content)
    with sqlite3.connect(copy) as connection:
        assert connection.execute("SELECT count(*) FROM experiment").fetchone() == (30,)
    connection.close()


def test_no_backup_of_a_deleted_project(bench, monkeypatch):
    monkeypatch.setattr(system, "BACKUPS", "gone/backups")
    answer = bench.post("/system/backups", status=422)
    assert "a folder in an existing project" in answer["sentence"]


@pytest.mark.parametrize("name", ["..%2f..%2ffixel.yaml", "%2e%2e", "experiments.db", ".x.db"])
def test_nothing_else_is_fetched(bench, name):
    (bench.folder / "backups").mkdir(exist_ok=True)
    (bench.folder / "backups" / ".x.db").touch()
    link = bench.folder / "backups" / "experiments-20000101-000000.db"
    if not link.is_symlink():
        link.symlink_to(bench.folder / "fixel.yaml")
    bench.get(f"/system/backups/{name}", 404)
    bench.get(f"/system/backups/{link.name}", 404)


def test_the_check_says_what_is_wrong(bench):
    found = bench.post("/system/check")
    assert found["ok"]
    assert found["counts"]["experiment"] == 30


def test_the_self_test_runs_in_its_own_process(bench, monkeypatch):
    answer = {
        "passed": False,
        "max_residual": 1e-12,
        "seconds": 1.5,
        "checks": [{"name": "grasp", "passed": False, "detail": "no", "residual": None}],
    }
    monkeypatch.setattr(system, "self_tested", lambda: answer)
    found = bench.post("/system/self-test")
    assert not found["passed"]
    assert found["checks"][0]["detail"] == "no"


@pytest.mark.slow
def test_the_self_test_itself():
    assert system.self_tested()["passed"]


def test_sizes_for_people():
    numbers = (0, 999, 1000, 2_345_678, None)
    texts = ["0 byte", "999 byte", "1 kB", "2.35 MB", "stored on a server"]
    assert [size(number) for number in numbers] == texts
