"""A campaign on a real SLURM on this machine, and on one whose processes are killed."""

import subprocess
import time
from contextlib import contextmanager
from importlib.util import find_spec

import pytest
from tests.jobs.chaos import KINDS, storm, storm_at_random
from tests.jobs.helpers import await_true, await_while_running, names_in, processes, start
from tests.jobs.kinds import QUICK, THESIS, Toy, assert_as_undisturbed

from fixel.jobs import folder as files
from fixel.jobs.folder import RunSettings
from fixel.jobs.pool import cancel, listed_jobs
from fixel.jobs.site import Site
from fixel.workflows import jobs

pytestmark = pytest.mark.cluster

if find_spec("dask_jobqueue") is None:  # importing it would change what Ctrl-C does
    pytest.skip("dask-jobqueue is not installed", allow_module_level=True)

SITE = Site(
    queue="main",
    walltime="00:10:00",
    memory="500 MB",
    max_jobs=3,
    submit_interval_s=0.0,
    skip_directives=["--mem"],  # memory is not divided among the nodes of the test
)
OPTIONS = {"rounds": 3, "chunks": 12, "sleep_s": 0.1}
# So long that it still runs when a busy machine gets round to looking at it.
LONGER = Toy(**OPTIONS | {"sleep_s": 0.5})
# Under the load of other tests a heartbeat may be late.
RUN = RunSettings(workers=2, site=SITE, lease_s=60.0)


@pytest.fixture
def folder(slurm, tmp_path):
    with prepared(Toy(**OPTIONS), tmp_path / "job") as folder:
        yield folder


@contextmanager
def prepared(kind, path, run=RUN):
    """A job of a kind, none of whose workers is left in the queue afterwards."""
    folder = kind.prepare(path, run)
    try:
        yield folder
    finally:
        cancel(label(folder))


def label(folder):
    return files.read_job(folder).label


def on_slurm(folder):
    return sorted(int(job.id) for job in listed_jobs(label(folder)) if job.active)


def two_at_work(folder, coordinator):
    """Numbers of two workers that wait or run, once there is an answer."""

    def found():
        return bool(names_in(folder)) and len(on_slurm(folder)) == 2

    await_while_running(coordinator, folder, found, "two workers at work")
    return on_slurm(folder)


def test_a_job(folder):
    seen = []
    assert jobs.run_here(folder, seen.append).state == "done"
    assert max(progress.workers for progress in seen) == 2
    assert_as_undisturbed(folder, **OPTIONS)
    await_true(lambda: not on_slurm(folder), "SLURM to end the workers")


def test_a_calibration_with_one_kill_of_each_kind(slurm, tmp_path):
    """Known answer T15, small."""
    with prepared(QUICK, tmp_path / "lab") as folder:
        assert storm(folder, KINDS, seed=3, between_s=(0.0, 0.1)) == 3
        QUICK.assert_as_undisturbed(folder)


def test_workers_outlive_the_coordinator_and_are_taken_over(slurm, tmp_path):
    with prepared(LONGER, tmp_path / "job") as folder:
        coordinator = start(folder)
        before = two_at_work(folder, coordinator)
        coordinator.kill()
        coordinator.wait()
        status = jobs.status_of(folder)
        assert (status.state, status.kept) == ("lost", len(names_in(folder)))
        time.sleep(1.0)
        assert on_slurm(folder) == before
        assert jobs.run_here(folder).state == "done"
        assert sorted(int(job.id) for job in listed_jobs(label(folder))) == before
        LONGER.assert_as_undisturbed(folder)


def test_a_worker_cancelled_from_outside_is_replaced(slurm, tmp_path):
    with prepared(LONGER, tmp_path / "job") as folder:
        coordinator = start(folder)
        subprocess.run(["scancel", str(two_at_work(folder, coordinator)[0])], check=True)
        assert coordinator.wait(120) == 0
        assert len(listed_jobs(label(folder))) == 3
        LONGER.assert_as_undisturbed(folder)


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
    toy = Toy(**OPTIONS | {"chunks": 40, "sleep_s": 0.4})
    run = RUN.model_copy(update={"site": SITE.model_copy(update={"walltime": "00:00:10"})})
    with prepared(toy, tmp_path / "job", run) as folder:
        assert jobs.run_here(folder).state == "done"
        log = (folder / "log.txt").read_text()
        assert log.count("has ended: completed") >= 2
        assert "died while computing" not in log
        toy.assert_as_undisturbed(folder)


@pytest.mark.slow
def test_twenty_kills(slurm, tmp_path):
    toy = Toy(rounds=3, chunks=60, sleep_s=0.2)
    with prepared(toy, tmp_path / "job") as folder:
        storm_at_random(folder, 20)
        toy.assert_as_undisturbed(folder)


@pytest.mark.soak
def test_a_calibration_with_a_hundred_kills(slurm, tmp_path):
    """Known answer T15: nothing lost, nothing twice, the same bits."""
    with prepared(THESIS, tmp_path / "lab") as folder:
        storm_at_random(folder, 100)
        THESIS.assert_as_undisturbed(folder)
