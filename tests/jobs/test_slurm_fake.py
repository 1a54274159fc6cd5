"""Known answer T17: what real clusters do to those who submit, on a SLURM of paper."""

import os
import time
from importlib.util import find_spec

import pytest
from tests.fixtures import refused
from tests.jobs.fake_slurm import VARIABLE, FakeSlurm

from fixel.errors import JobRefused
from fixel.jobs import link, pool as slurm
from fixel.jobs.pool import SlurmPool, require_slurm
from fixel.jobs.site import Site, trust_site

pytestmark = pytest.mark.system

if find_spec("dask_jobqueue") is None:  # importing it would change what Ctrl-C does
    pytest.skip("dask-jobqueue is not installed", allow_module_level=True)

NAME = "fixel-0123456789ab"
# In the words of the real ones.
BUSY = "sbatch: error: Slurm temporarily unable to accept job, sleeping and retrying"
LIMIT = (
    "sbatch: error: QOSMaxSubmitJobPerUserLimit Batch job submission failed: Job violates policy"
)
TIMED_OUT = "sbatch: error: Batch job submission failed: Socket timed out on send/recv operation"
NO_PARTITION = "sbatch: error: invalid partition specified: nowhere"


@pytest.fixture
def fake(tmp_path, monkeypatch):
    folder = tmp_path / "commands"
    folder.mkdir()
    monkeypatch.setenv(VARIABLE, str(folder))
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return FakeSlurm(folder)


@pytest.fixture
def folder(tmp_path, fake):
    folder = tmp_path / "job"
    (folder / "workers").mkdir(parents=True)
    return folder


@pytest.fixture
def said():
    return []


@pytest.fixture
def pool(folder, said):
    return make_pool(folder, said)


def make_pool(folder, said, size=2, **site):
    site = Site(**{"submit_interval_s": 0.0, "max_jobs": 4} | site)
    return SlurmPool(folder, size, site, NAME, notify=said.append, poll_s=0.0, back_off_s=0.01)


def steps(pool, n=3):
    for _ in range(n):
        pool.keep()
        time.sleep(0.03)


def join(folder, number):
    link.record_joined(folder, f"slurm-{number}", "node")


@pytest.mark.parametrize("plan", [
    [],
    [f"lie {TIMED_OUT}"],  # accepted all the same
    ["say 101;cluster"],
    ["say sbatch: lua: welcome\n101"],
])  # fmt: skip
def test_as_many_as_wanted_and_no_more(fake, pool, plan):
    fake.set(plan=plan)
    steps(pool, 8)
    assert fake.active() == [101, 102]
    assert pool.note == ""


@pytest.mark.parametrize("words", ["", "Submitted!", "sbatch: lua: welcome\nnothing"])
def test_an_answer_without_a_number_is_trouble_not_a_crash(fake, pool, words):
    fake.set(plan=[f"say {words}"])
    steps(pool, 8)
    assert len(fake.active()) == 2


def test_never_more_than_the_site_allows(fake, folder, said):
    steps(make_pool(folder, said, size=9))
    assert fake.active() == [101, 102, 103, 104]


LINES = {
    "directives": ["--qos=long"],
    "prologue": ["module load python"],
    "python": "/opt/my python/bin/python",
}


def test_the_script_says_what_the_template_says(fake, folder, said, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    pool = make_pool(
        folder,
        said,
        size=1,
        queue="gpu",
        account="lab",
        walltime="1-00:00:00",
        cores=3,
        memory="5 GB",
        **LINES,
    )
    refused(pool.keep, match="lines in the folder of the job")
    trust_site(Site(**LINES))  # as `fixel jobs submit --site` does
    steps(pool, 5)
    script = fake["jobs"]["101"]["script"].splitlines()
    for line in (
        "#SBATCH -p gpu",
        "#SBATCH -A lab",
        "#SBATCH -t 1-00:00:00",
        "#SBATCH --cpus-per-task=3",
        "#SBATCH --mem=5G",
        "#SBATCH --qos=long",
        "module load python",
    ):
        assert line in script, line
    assert script[-1].startswith("exec '/opt/my python/bin/python' -P -m fixel.jobs.worker ")
    for words in (
        "--name slurm-$SLURM_JOB_ID",
        "--threads 3",
        "--lifetime-s=86280",
        str(folder.resolve()),
    ):
        assert words in script[-1], words
    assert not any("key" in line for line in script)


def test_directives_can_be_left_out(fake, folder, said):
    make_pool(folder, said, skip_directives=["--mem"]).keep()
    assert "--mem" not in fake["jobs"]["101"]["script"]


def test_throttled_submission_is_tried_again_later_and_later(fake, pool, said):
    fake.set(plan=[f"fail {BUSY}"] * 3)
    steps(pool, 2)
    assert "temporarily unable to accept job" in pool.note
    steps(pool, 12)
    assert fake.active() == [101, 102]
    assert pool.note == ""
    gaps = [b - a for a, b in zip(fake["calls"], fake["calls"][1:], strict=False)]
    assert all(gap >= least for gap, least in zip(gaps, (0.01, 0.02, 0.04), strict=False))


def test_a_limit_of_the_site_is_lived_with(fake, pool):
    fake.set(plan=["ok", *[f"fail {LIMIT}"] * 50])
    steps(pool, 10)
    assert fake.active() == [101]
    assert "QOSMaxSubmitJobPerUserLimit" in pool.note


def test_submissions_keep_their_distance(fake, folder, said):
    pool = make_pool(folder, said, size=3, submit_interval_s=0.2)
    begun = time.monotonic()
    while len(fake.active()) < 3:
        pool.keep()
        assert time.monotonic() < begun + 60.0
    gaps = [b - a for a, b in zip(fake["calls"], fake["calls"][1:], strict=False)]
    assert min(gaps) > 0.2


def test_a_wrong_template_is_refused_at_once(fake, pool):
    fake.set(plan=[f"fail {NO_PARTITION}"])
    with pytest.raises(JobRefused, match="invalid partition specified: nowhere; correct the site"):
        pool.keep()
    assert len(fake["calls"]) == 1


@pytest.mark.parametrize("end", ["PREEMPTED", "NODE_FAIL", "TIMEOUT", "CANCELLED", "FAILED"])
def test_a_worker_that_ends_is_replaced(fake, folder, pool, said, end):
    steps(pool)
    for number in fake.active():
        join(folder, number)
    fake.job(101, state=end)
    steps(pool)
    assert fake.active() == [102, 103]
    assert f"worker 101 has ended: {end.lower()}" in said


@pytest.mark.parametrize("end", ["PREEMPTED", "NODE_FAIL", "BOOT_FAIL"])
def test_bad_luck_before_the_start_is_not_held_against_a_template(fake, pool, end):
    for _ in range(6):
        steps(pool, 2)
        fake.job(fake.active()[0], state=end)
    steps(pool, 2)
    assert len(fake.active()) == 2


def test_a_worker_that_never_starts_is_waited_for_and_said(fake, pool):
    fake.set(state="PENDING")
    steps(pool, 8)
    assert fake.active() == [101, 102]
    assert pool.note == "2 jobs are waiting in the queue (Priority)"


def test_a_requeued_job_is_the_same_worker(fake, folder, pool):
    steps(pool)
    fake.job(101, state="REQUEUED")
    steps(pool)
    fake.job(101, state="PENDING", reason="BeginTime")
    steps(pool)
    assert fake.active() == [101, 102]


def test_workers_that_fail_before_they_join_end_the_job_with_their_words(fake, folder, pool):
    for _ in range(3):
        steps(pool, 2)
        number = fake.active()[0]
        (folder / "workers" / f"{NAME}-{number}.err").write_text("bash: module: not found\n")
        fake.job(number, state="FAILED")
    with pytest.raises(JobRefused) as refused:
        pool.keep()
    assert str(refused.value).endswith("output of the last one:\nbash: module: not found")


def test_workers_cancelled_before_they_start_are_not_submitted_for_ever(fake, pool):
    fake.set(state="PENDING")
    for _ in range(3):
        steps(pool, 2)
        fake.job(fake.active()[0], state="CANCELLED")
    with pytest.raises(JobRefused, match="3 workers were cancelled before they started"):
        pool.keep()


def test_while_squeue_does_not_answer_nothing_is_submitted(fake, pool, said):
    steps(pool)
    fake.set(down=True)
    steps(pool, 5)
    assert "Unable to contact slurm controller" in pool.note
    assert len(said) == 3  # two submissions, and the trouble once
    fake.set(down=False)
    steps(pool)
    assert fake.active() == [101, 102]


def test_a_job_that_is_not_listed_yet_counts(fake, pool, monkeypatch):
    monkeypatch.setattr(slurm, "listed_jobs", lambda name: [])
    steps(pool, 5)
    assert fake.active() == [101, 102]
    monkeypatch.setattr(slurm, "UNSEEN_S", 0.0)
    steps(pool, 2)
    assert len(fake.active()) > 2


def test_workers_of_an_interrupted_session_are_taken_over(fake, folder, said):
    steps(make_pool(folder, said))
    fake.job(101, state="FAILED")  # between two looks
    fake.job(7, state="RUNNING", reason="None", name="somebody-else")
    steps(make_pool(folder, said))
    assert fake.active() == [7, 102, 103]


def test_the_end_cancels_its_own_jobs_alone(fake, pool):
    fake.job(7, state="RUNNING", reason="None", name="somebody-else")
    steps(pool)
    pool.close()
    assert fake.active() == [7]


def test_an_end_that_cannot_cancel_says_so(fake, pool, said):
    steps(pool)
    fake.set(stuck=True)
    pool.close()
    assert "could not be cancelled and will end by themselves" in said[-1]


def test_without_slurm_it_says_where_to_run(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    refused(require_slurm, match="found no command sbatch")
    with pytest.raises(slurm.SlurmError, match="sbatch is not installed"):
        slurm.submit(tmp_path / "script")


def test_a_command_that_hangs_is_given_up(fake, folder, monkeypatch):
    (fake.folder / "squeue").write_text("#!/bin/sh\nexec sleep 60\n")
    monkeypatch.setattr(slurm, "COMMAND_S", 0.1)
    with pytest.raises(slurm.SlurmError, match="timed out"):
        slurm.listed_jobs(NAME)
