"""A campaign on a real SLURM on this machine, and on one whose processes are killed."""

import random
import subprocess
import time

import pytest
from tests.jobs.chaos import KINDS, storm
from tests.jobs.helpers import (
    assert_as_undisturbed,
    await_true,
    names_in,
    processes,
    start,
    toy_job,
)

from fixel.jobs import folder as files
from fixel.jobs.folder import Run
from fixel.jobs.site import Site
from fixel.jobs.slurm import cancel, listed
from fixel.workflows import jobs

pytestmark = pytest.mark.cluster

pytest.importorskip("dask_jobqueue")

SITE = Site(
    queue="main",
    walltime="00:10:00",
    memory="500 MB",
    max_jobs=3,
    submit_interval_s=0.0,
    skip_directives=["--mem"],  # memory is not divided among the nodes of the test
)
OPTIONS = {"rounds": 3, "chunks": 12, "sleep_s": 0.1}
# Under the load of other tests a heartbeat may be late.
RUN = Run(workers=2, site=SITE, lease_s=60.0)


@pytest.fixture
def folder(slurm, tmp_path):
    folder = toy_job(tmp_path / "job", RUN, **OPTIONS)
    yield folder
    cancel(label(folder))


def label(folder):
    return files.read_job(folder).label


def on_slurm(folder):
    return sorted(job.id for job in listed(label(folder)) if job.active)


def test_a_campaign(folder):
    seen = []
    status = jobs.run_here(folder, seen.append)
    assert status.state == "done"
    assert max(progress.workers for progress in seen) == 2
    assert_as_undisturbed(folder, **OPTIONS)
    await_true(lambda: not on_slurm(folder), "SLURM to end the workers")


def test_one_kill_of_each_kind(folder):
    assert storm(folder, KINDS, seed=3, between_s=(0.0, 0.1)) == 3
    assert_as_undisturbed(folder, **OPTIONS)


def test_workers_outlive_the_coordinator_and_are_taken_over(folder):
    coordinator = start(folder)
    await_true(lambda: len(on_slurm(folder)) == 2 and names_in(folder), "two workers at work")
    before = on_slurm(folder)
    coordinator.kill()
    coordinator.wait()
    status = jobs.status_of(folder)
    assert (status.state, status.kept) == ("lost", len(names_in(folder)))
    time.sleep(1.0)
    assert on_slurm(folder) == before
    assert jobs.run_here(folder).state == "done"
    assert max(map(int, (job.id for job in listed(label(folder))))) == int(before[-1])
    assert_as_undisturbed(folder, **OPTIONS)


def test_a_worker_cancelled_from_outside_is_replaced(folder):
    coordinator = start(folder)
    await_true(lambda: len(on_slurm(folder)) == 2 and names_in(folder), "two workers at work")
    subprocess.run(["scancel", on_slurm(folder)[0]], check=True)
    assert coordinator.wait(120) == 0
    assert_as_undisturbed(folder, **OPTIONS)


def test_the_coordinator_as_a_job_and_cancelled(folder):
    jobs.run_on_slurm(folder)
    await_true(lambda: names_in(folder), "an answer")
    assert jobs.status_of(folder).state == "running"
    assert jobs.cancel(folder).state == "cancelled"
    await_true(lambda: not on_slurm(folder), "SLURM to end the workers")
    assert not processes(folder, "worker")
    jobs.arrange(folder)
    assert jobs.run_here(folder).state == "done"
    assert_as_undisturbed(folder, **OPTIONS)


@pytest.mark.slow
def test_workers_end_before_their_walltime_and_are_replaced(slurm, tmp_path):
    options = OPTIONS | {"chunks": 40, "sleep_s": 0.4}
    run = RUN.model_copy(update={"site": SITE.model_copy(update={"walltime": "00:00:10"})})
    folder = toy_job(tmp_path / "job", run, **options)
    assert jobs.run_here(folder).state == "done"
    log = (folder / "log.txt").read_text()
    assert log.count("has ended: completed") >= 2
    assert "died with" not in log
    assert_as_undisturbed(folder, **options)


@pytest.mark.slow
def test_twenty_kills(slurm, tmp_path):
    kill_at_random(tmp_path / "job", 20, {"rounds": 3, "chunks": 60, "sleep_s": 0.2})


@pytest.mark.soak
def test_a_hundred_kills(slurm, tmp_path):
    """Known answer T15: nothing lost, nothing twice, the same bits."""
    kill_at_random(tmp_path / "job", 100, {"rounds": 4, "chunks": 200, "sleep_s": 0.2})


def kill_at_random(path, n, options):
    folder = toy_job(path, RUN, **options)
    generator = random.Random(n)
    try:
        assert storm(folder, [generator.choice(KINDS) for _ in range(n)], seed=n) == n
        assert_as_undisturbed(folder, **options)
    finally:
        cancel(label(folder))
