"""The pages of jobs and of the system, and what is below them."""

import sqlite3
from pathlib import Path

import pytest
from tests.jobs.helpers import await_true as until
from tests.web.bench import Bench

from fixel.jobs import folder as files
from fixel.jobs.folder import JobState
from fixel.testing.toy_work import MAKER
from fixel.web.api import system
from fixel.web.security import WORD_HEADER
from fixel.web.views import job_list
from fixel.web.words import size
from fixel.workflows import jobs

pytestmark = pytest.mark.system


class JobsBench(Bench):
    def get(self, path):
        answer = self.client.get(f"/api/v1{path}")
        assert answer.status_code < 500
        return answer

    def post(self, path):
        return super().post(f"/api/v1{path}")

    def job(self, name, **options):
        folder = self.folder / "jobs" / name
        return folder, jobs.prepare_job(folder, maker=MAKER, options=options)


@pytest.fixture(scope="module")
def bench(project):
    made = JobsBench(project)
    yield made
    made.close()


# --- jobs -------------------------------------------------------------------------------------


def test_names_are_compared_and_never_paths(bench):
    bench.job("first <b>one & %2e")
    assert bench.get("/jobs/first%20%3Cb%3Eone%20%26%20%252e").json()["job"]["state"] == "queued"
    for name in ("..%2f..", "%2e%2e", "first", "first%20%3Cb%3Eone%2Fx", "%00", "a" * 300):
        assert bench.get(f"/jobs/{name}").status_code in (404, 422), name
        assert bench.post(f"/jobs/{name}/resume").status_code in (404, 405, 422), name


def test_from_the_queue_to_the_end(bench):
    folder, _ = bench.job("toy", rounds=300, chunks=8, sleep_s=0.05)
    assert bench.get("/jobs/toy").json()["job"]["can_resume"]
    begun = bench.post("/jobs/toy/resume")
    assert begun.status_code == 200
    assert not begun.json()["job"]["can_resume"]
    again = bench.post("/jobs/toy/resume")
    assert (again.status_code, again.json()["status"]) == (409, 409)
    until(lambda: bench.get("/jobs/toy").json()["job"]["done"] > 0)
    log = bench.get("/jobs/toy/log?lines=5").json()
    assert any("running" in line for line in log["lines"])
    ended = bench.post("/jobs/toy/cancel").json()["job"]
    assert ended["state"] == "cancelled"
    assert ended["kept"] > 0
    assert ended["can_resume"]
    assert "fixel jobs resume" in ended["command"]
    assert files.coordinator_of(folder) is None


def test_only_so_many_run_at_once_whatever_they_are(bench, monkeypatch):
    monkeypatch.setattr(job_list, "MAX_AT_ONCE", 1)
    bench.job("long", rounds=300, chunks=8, sleep_s=0.05)
    bench.job("other")
    assert bench.post("/jobs/long/resume").status_code == 200
    try:
        for address, body in (("/jobs/other/resume", None), ("/run/domain", {"axes": ["shape"]})):
            refused = bench.client.request(
                "POST", f"/api/v1{address}", headers={WORD_HEADER: bench.gate.word}, json=body
            )
            assert refused.status_code == 409
            assert "running" in refused.json()["sentence"]
    finally:
        bench.post("/jobs/long/cancel")
    assert bench.post("/jobs/other/resume").status_code == 200
    bench.post("/jobs/other/cancel")


def test_lost_and_repeated_work_is_counted(bench):
    folder, _ = bench.job("lost")
    said = JobState(state="running", done=3, total=9, deaths=2, again=4, host="node1", pid=7)
    files.write_status(folder, said)
    workers = folder / "workers"
    workers.mkdir()
    (workers / "local-7-1-1.json").write_text('{"host": "node1", "pid": 9}')
    (workers / "local-7-1-2.log").touch()
    (workers / "scheduler.log").touch()
    (workers / "slurm-3.refused").write_text("has another fixel")
    found = bench.get("/jobs/lost").json()
    assert found["job"]["state"] == "lost"
    assert (found["job"]["deaths"], found["job"]["again"]) == (2, 4)
    assert found["job"]["can_resume"]
    states = {worker["name"]: worker["state"] for worker in found["workers"]}
    assert states == {"slurm-3": "refused", "local-7-1-1": "ended", "local-7-1-2": "ended"}
    cancelled = bench.post("/jobs/lost/cancel").json()["job"]
    assert cancelled["state"] == "cancelled"


def test_what_another_program_wrote_there_is_shown_as_such(bench):
    strange = bench.folder / "jobs" / "strange"
    strange.mkdir(parents=True)
    (strange / "job.json").write_text("{")
    found = next(job for job in bench.get("/jobs").json()["jobs"] if job["name"] == "strange")
    assert found["state"] == "unreadable"
    assert found["reason"]
    assert bench.get("/jobs/strange/log").json() == {"lines": [], "whole": True}
    assert bench.post("/jobs/strange/cancel").status_code == 422


def test_long_logs_are_shown_by_their_ends(bench):
    folder, _ = bench.job("talkative")
    (folder / "log.txt").write_bytes(b"\xff\x1b[31m" + b"word\n" * 200_000 + b"last\n")
    log = bench.get("/jobs/talkative/log?lines=3").json()
    assert log == {"lines": ["word", "word", "last"], "whole": False}


def test_the_pages_open(bench):
    page = bench.client.get("/jobs")
    assert page.status_code == 200
    page = bench.client.get("/system").text
    assert "pending migrations" in page
    assert "numba" in page


# --- the system -------------------------------------------------------------------------------


def test_what_is_gone_while_it_is_counted_is_not_counted(bench, monkeypatch):
    media, real = bench.context.project.media, Path.glob
    before = system.disk_status(bench.context.project)
    gone = media / "ab" / ".ab12.temporary"
    monkeypatch.setattr(Path, "glob", lambda path, what: [gone, *real(path, what)])
    assert system.disk_status(bench.context.project).media_files == before.media_files


def test_versions_database_and_room(bench):
    known = bench.get("/system").json()
    assert known["versions"]["fixel"]
    assert known["database"]["engine"] == "sqlite"
    assert known["database"]["schema_version"] == known["database"]["newest"]
    assert known["database"]["pending"] == []
    assert known["database"]["size_bytes"] > 100_000
    assert known["disk"]["free_bytes"] > 0


def test_passwords_are_not_shown(monkeypatch, project):
    assert ":***@" in system.sa.make_url("postgresql://lab:hush@server/x").render_as_string()


def test_a_backup_is_made_and_fetched(bench, tmp_path):
    made = bench.post("/system/backups").json()
    one, two = made["backup"], bench.post("/system/backups").json()["backup"]
    assert one["name"] != two["name"]
    names = [backup["name"] for backup in bench.get("/system").json()["backups"]]
    assert names[:2] == [two["name"], one["name"]]
    answer = bench.get(f"/system/backups/{one['name']}")
    assert "attachment" in answer.headers["content-disposition"]
    copy = tmp_path / "copy.db"
    copy.write_bytes(answer.content)
    with sqlite3.connect(copy) as connection:
        assert connection.execute("SELECT count(*) FROM experiment").fetchone() == (30,)
    connection.close()


@pytest.mark.parametrize("name", ["..%2f..%2ffixel.yaml", "%2e%2e", "experiments.db", ".x.db"])
def test_nothing_else_is_fetched(bench, name):
    (bench.folder / "backups").mkdir(exist_ok=True)
    (bench.folder / "backups" / ".x.db").touch()
    link = bench.folder / "backups" / "experiments-20000101-000000.db"
    if not link.is_symlink():
        link.symlink_to(bench.folder / "fixel.yaml")
    assert bench.get(f"/system/backups/{name}").status_code == 404
    assert bench.get(f"/system/backups/{link.name}").status_code == 404


def test_the_check_says_what_is_wrong(bench):
    found = bench.post("/system/check").json()
    assert found["ok"]
    assert found["counts"]["experiment"] == 30


def test_the_self_test_runs_beside_the_server(bench, monkeypatch):
    answer = {
        "passed": False,
        "max_residual": 1e-12,
        "seconds": 1.5,
        "checks": [{"name": "grasp", "passed": False, "detail": "no", "residual": None}],
    }
    monkeypatch.setattr(system, "self_tested", lambda: answer)
    found = bench.post("/system/self-test").json()
    assert not found["passed"]
    assert found["checks"][0]["detail"] == "no"


@pytest.mark.slow
def test_the_self_test_itself():
    assert system.self_tested()["passed"]


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0, "0 byte"),
        (999, "999 byte"),
        (1000, "1 kB"),
        (2_345_678, "2.35 MB"),
        (None, "stored on a server"),
    ],
)
def test_sizes_for_people(number, text):
    assert size(number) == text
