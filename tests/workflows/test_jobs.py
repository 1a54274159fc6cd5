"""Jobs from the outside: states, cancelling, copying, what is refused before anything starts."""

import os
import zipfile

import pytest
from tests.fixtures import refused
from tests.jobs.helpers import await_true, names_in, processes, start
from tests.jobs.kinds import assert_as_undisturbed, toy_job

from fixel.errors import InvalidInput, JobRefused
from fixel.jobs import folder as files
from fixel.jobs.folder import RunSettings
from fixel.jobs.site import Site
from fixel.workflows import jobs

OPTIONS = {"rounds": 2, "chunks": 6}
SLOW = OPTIONS | {"sleep_s": 0.1}


@pytest.mark.system
def test_the_states_of_a_life(tmp_path):
    folder = toy_job(tmp_path / "job", **SLOW)
    assert jobs.status_of(folder).state == "queued"
    coordinator = start(folder)
    await_true(lambda: names_in(folder), "an answer")
    await_true(lambda: jobs.status_of(folder).state == "running", "it to say so")
    coordinator.kill()
    coordinator.wait()
    lost = jobs.status_of(folder)
    assert (lost.state, lost.ended) == ("lost", True)
    assert lost.kept == len(names_in(folder)) > 0
    done = jobs.run_here(folder)
    assert (done.state, done.kept, done.done) == ("done", 12, 12)
    assert_as_undisturbed(folder, **SLOW)


@pytest.mark.system
def test_a_detached_job_outlives_who_started_it(tmp_path):
    folder = toy_job(tmp_path / "job", **SLOW)
    jobs.arrange(folder)
    assert jobs.run_detached(folder).state in ("queued", "preparing", "running")
    with pytest.raises(JobRefused, match="is being run by process"):
        jobs.arrange(folder)
    with pytest.raises(JobRefused, match="is being run by process"):
        jobs.pack(folder, tmp_path / "job.zip")
    await_true(lambda: jobs.status_of(folder).state == "done", "it to end")
    assert_as_undisturbed(folder, **SLOW)


@pytest.mark.system
def test_cancelled_with_its_workers_and_gone_on_with(tmp_path):
    pytest.importorskip("distributed")
    folder = toy_job(tmp_path / "job", RunSettings(workers=1), **SLOW)
    coordinator = start(folder)
    await_true(lambda: names_in(folder), "an answer")
    assert jobs.cancel(folder).state == "cancelled"
    assert coordinator.wait(60) == 0
    assert not processes(folder, "worker")
    assert jobs.cancel(folder).state == "cancelled"  # again: nothing to do
    jobs.arrange(folder, workers=0)
    assert jobs.run_here(folder).state == "done"
    assert jobs.cancel(folder).state == "done"
    assert_as_undisturbed(folder, **SLOW)


def test_how_a_job_is_run_is_kept_for_the_next_time(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS)
    assert jobs.arrange(folder, workers=0, lease_s=12.0).lease_s == 12.0
    assert files.read_run(folder).lease_s == 12.0
    assert jobs.arrange(folder) == files.read_run(folder)


def test_what_is_missing_is_said_before_anything_starts(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    folder = toy_job(tmp_path / "job", **OPTIONS)
    refused(jobs.arrange, folder, site=Site(interface="nowhere0"), match="interface is 'nowhere0'")
    monkeypatch.setenv("PATH", str(tmp_path))
    refused(jobs.arrange, folder, site=Site(), match="found no command sbatch")
    with pytest.raises(
        InvalidInput, match="coordinator: found slurm, but fixel needs a site template"
    ):
        jobs.run_on_slurm(folder)
    monkeypatch.setattr("fixel.jobs.link.find_spec", lambda name: None)
    with pytest.raises(JobRefused, match=r'pip install "fixel\[cluster\]"'):
        jobs.arrange(folder, workers=2)
    assert not (folder / "run.json").exists()


def test_jobs_of_a_project(tmp_path):
    assert jobs.jobs_in(tmp_path) == []
    for name in ("one", "two"):
        toy_job(tmp_path / "jobs" / name, **OPTIONS)
    (tmp_path / "jobs" / "no job").mkdir()
    assert {job.folder.rsplit(os.sep, 1)[1] for job in jobs.jobs_in(tmp_path)} == {"one", "two"}


@pytest.mark.system
def test_packed_half_way_and_unpacked_elsewhere_it_goes_on(tmp_path):
    folder = toy_job(tmp_path / "job", **SLOW)
    coordinator = start(folder)
    await_true(lambda: len(names_in(folder)) > 3, "answers")
    coordinator.kill()
    coordinator.wait()
    (folder / "tls").mkdir()
    (folder / "tls" / "key.pem").write_text("secret")
    assert jobs.pack(folder, tmp_path / "job.zip") == (tmp_path / "job.zip").stat().st_size
    with zipfile.ZipFile(tmp_path / "job.zip") as archive:
        assert not [name for name in archive.namelist() if "key" in name or "lock" in name]
    copy = tmp_path / "elsewhere" / "copy"
    assert jobs.unpack(tmp_path / "job.zip", copy).kept == len(names_in(folder)) > 3
    assert jobs.run_here(copy).state == "done"
    assert_as_undisturbed(copy, **SLOW)


@pytest.mark.parametrize("names", [
    ["job.json", "../up"],
    ["job.json", "/etc/file"],
    ["job.json", "inputs/../../up"],
    ["job.json", "inputs/a/b"],
    ["job.json", "inputs/.hidden"],
    ["job.json", "tls/key.pem"],
    ["job.json", "inputs\\up"],
    ["journal"],
])  # fmt: skip
def test_a_zip_that_is_no_packed_job(tmp_path, names):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name in names:
            archive.writestr(name, "{}")
    refused(jobs.unpack, tmp_path / "a.zip", tmp_path / "copy", match="fixel needs a packed job")
    assert not (tmp_path / "copy").exists()


def test_a_file_that_is_no_zip(tmp_path):
    (tmp_path / "a.zip").write_text("no zip")
    for file in ("a.zip", "absent.zip"):
        refused(jobs.unpack, tmp_path / file, tmp_path / "copy", match="fixel needs a packed job")


@pytest.mark.system
def test_the_log_from_beginning_to_end(tmp_path):
    folder = toy_job(tmp_path / "job", **SLOW)
    assert list(jobs.log_lines(folder)) == []
    coordinator = start(folder)
    await_true(lambda: files.coordinator_of(folder), "it to start")
    words = [line.split()[1] for line in jobs.log_lines(folder, follow=True)]
    assert words == ["preparing", "running", "collecting", "done"]
    assert coordinator.wait(60) == 0
