"""A job from its folder: undisturbed, killed, stopped, refused."""

import json
import shutil
import signal

import pytest
from tests.fixtures import refused
from tests.jobs.chaos import KINDS, storm, storm_at_random
from tests.jobs.helpers import LOCAL_2, await_true, blocks_written, kill, names_in, processes, start
from tests.jobs.kinds import THESIS, assert_as_undisturbed, toy_job

from fixel.errors import InvalidInput, JobRefused
from fixel.io.journal import Journal
from fixel.jobs import folder as files
from fixel.jobs.coordinator import coordinate
from fixel.jobs.folder import RunSettings
from fixel.testing.toy_work import MAKER
from fixel.workflows.jobs import prepare_job, status_of

pytestmark = pytest.mark.system

OPTIONS = {"rounds": 3, "chunks": 6}


def test_a_job_in_one_process(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS)
    seen, said = [], []
    assert coordinate(folder, progress=seen.append, notify=said.append).state == "done"
    assert said == ["preparing", "running", "collecting", "done"]
    assert seen[-1].done == seen[-1].total == 18
    assert_as_undisturbed(folder, **OPTIONS)
    assert [line.split()[1] for line in (folder / "log.txt").read_text().splitlines()] == said


def test_killed_in_one_process_it_goes_on_to_the_same_bits(tmp_path):
    options = OPTIONS | {"sleep_s": 0.05}
    folder = toy_job(tmp_path / "job", **options)
    storm(folder, ["coordinator"] * 3, seed=1, between_s=(0.0, 0.2))
    assert_as_undisturbed(folder, **options)


def test_one_kill_of_each_kind_among_processes_of_this_machine(tmp_path):
    pytest.importorskip("distributed")
    options = OPTIONS | {"chunks": 12, "sleep_s": 0.1}
    folder = toy_job(tmp_path / "job", LOCAL_2, **options)
    assert storm(folder, KINDS, seed=2, between_s=(0.0, 0.1)) == 3
    assert_as_undisturbed(folder, **options)


@pytest.mark.slow
def test_a_hundred_kills_among_processes_of_this_machine(tmp_path):
    """Known answer T15: nothing lost, nothing twice, the same bits."""
    pytest.importorskip("distributed")
    options = {"rounds": 4, "chunks": 150, "sleep_s": 0.2}
    folder = toy_job(tmp_path / "job", LOCAL_2, **options)
    storm_at_random(folder, 100)
    assert_as_undisturbed(folder, **options)


@pytest.mark.soak
def test_a_hundred_kills_of_a_calibration_among_processes_of_this_machine(tmp_path):
    pytest.importorskip("distributed")
    folder = THESIS.prepare(tmp_path / "lab", LOCAL_2)
    storm_at_random(folder, 100)
    THESIS.assert_as_undisturbed(folder)


def test_everything_killed_at_once(tmp_path):
    pytest.importorskip("distributed")
    options = OPTIONS | {"sleep_s": 0.1}
    folder = toy_job(tmp_path / "job", LOCAL_2, **options)
    coordinator = start(folder)
    await_true(lambda: names_in(folder), "an answer")
    for kind in ("coordinator", "scheduler", "worker"):
        for pid in processes(folder, kind):
            kill(pid)
    coordinator.wait()
    known = set(names_in(folder))
    assert files.read_status(folder).state == "running"  # its last word; no process runs it
    assert files.coordinator_of(folder) is None
    assert coordinate(folder).state == "done"
    assert known <= set(names_in(folder))
    assert_as_undisturbed(folder, **options)


def test_a_coordinator_that_dies_takes_its_processes_with_it(tmp_path):
    pytest.importorskip("distributed")
    folder = toy_job(tmp_path / "job", LOCAL_2, **OPTIONS | {"sleep_s": 1.0})
    coordinator = start(folder)
    await_true(lambda: len(processes(folder, "worker")) == 2, "two workers")
    coordinator.kill()
    coordinator.wait()
    for kind in ("worker", "scheduler"):
        await_true(lambda kind=kind: not processes(folder, kind), f"no {kind}", 10.0)


def test_ctrl_c_and_sigterm_stop_and_keep_what_is_finished(tmp_path):
    options = OPTIONS | {"sleep_s": 0.1}
    folder = toy_job(tmp_path / "job", **options)
    for how in (signal.SIGINT, signal.SIGTERM):
        known = len(names_in(folder))
        coordinator = start(folder)
        await_true(lambda known=known: len(names_in(folder)) > known + 1, "answers")
        coordinator.send_signal(how)
        assert coordinator.wait(60) == 130
        assert files.read_status(folder).state == "stopped"
    assert coordinate(folder).state == "done"
    assert_as_undisturbed(folder, **options)


def test_two_coordinators_of_one_job(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS | {"sleep_s": 0.2})
    first = start(folder)
    await_true(lambda: names_in(folder), "an answer")
    with pytest.raises(JobRefused, match=f"in use by process {first.pid}"):
        coordinate(folder)
    assert files.read_status(folder).state == "running"
    assert first.wait(60) == 0


def test_another_fixel_goes_on_only_on_request(tmp_path, monkeypatch):
    folder = toy_job(tmp_path / "job", **OPTIONS)
    monkeypatch.setattr("fixel.jobs.coordinator.stamp", lambda: "9.9.9+0123456789abcdef")
    with pytest.raises(
        JobRefused, match=r"begun by fixel .*, and this is fixel 9\.9\.9"
    ) as refused:
        coordinate(folder)
    assert "--accept-version" in str(refused.value)
    assert files.read_status(folder).state == "failed"
    assert names_in(folder) == []
    files.write_run(folder, RunSettings(stamp="9.9.9+0123456789abcdef"))
    assert coordinate(folder).state == "done"


def test_changed_inputs_are_refused(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS)
    (folder / "inputs" / "offset").write_text("0.32")
    with pytest.raises(JobRefused, match="are not those with which the job was prepared"):
        coordinate(folder)


def test_a_damaged_journal_costs_what_is_damaged(tmp_path):
    folder = toy_job(tmp_path / "job", **OPTIONS)
    coordinate(folder)
    before = (folder / files.RESULT).read_bytes()
    path = folder / files.JOURNAL
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    said = []
    coordinate(folder, notify=said.append)
    assert any("damaged in 1 place;" in sentence for sentence in said)
    assert (folder / files.RESULT).read_bytes() == before
    assert blocks_written(folder) == 19  # the damaged one, and it once more


def test_a_process_that_dies_while_it_drops_answers_has_ended_its_job(tmp_path, monkeypatch):
    """Otherwise the job would be resumed without the answers that its result came from."""
    folder = toy_job(tmp_path / "job", **OPTIONS)
    drop = Journal.drop

    def drop_and_die(journal, larger_than):
        drop(journal, larger_than)
        raise KeyboardInterrupt

    monkeypatch.setattr(Journal, "drop", drop_and_die)
    monkeypatch.setattr("fixel.jobs.coordinator.LARGE", 0)
    with pytest.raises(KeyboardInterrupt):
        coordinate(folder)
    assert names_in(folder) == []
    status = status_of(folder)
    assert (status.state, status.done, status.kept) == ("done", 18, 0)
    assert (folder / files.RESULT).is_file()


def test_a_work_that_raises_is_a_failed_job_with_a_reason(tmp_path):
    folder = toy_job(tmp_path / "job", rounds="many")
    with pytest.raises(ValueError, match="many"):
        coordinate(folder)
    status = files.read_status(folder)
    assert (status.state, status.reason.split(":")[0]) == ("failed", "ValueError")
    assert "Traceback" in (folder / "log.txt").read_text()


@pytest.mark.parametrize(
    "left",
    [(".inputs.ab12/one",), ("state.json", ".inputs.ab12/one"), ("state.json", "inputs/one")],
)
def test_what_a_crash_left_before_there_was_a_job_is_removed(tmp_path, left):
    folder = tmp_path / "job"
    for name in left:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("{}")
    prepare_job(folder, maker=MAKER, inputs={"two": b"2"})
    assert [path.name for path in (folder / "inputs").iterdir()] == ["two"]
    assert files.read_status(folder).state == "queued"


def test_inputs_alone_are_somebodys_own(tmp_path):
    (tmp_path / "job" / "inputs").mkdir(parents=True)
    refused(prepare_job, tmp_path / "job", maker=MAKER, match="fixel needs a new folder")


def test_a_folder_is_prepared_whole_or_not_at_all(tmp_path):
    for maker in ("os:system", "toy:nothing"):
        refused(prepare_job, tmp_path / "job", maker=maker, match="function of a job")
    for name in ("../up", "", ".hidden", "a/b"):
        with pytest.raises(InvalidInput, match="fixel needs a plain file name"):
            prepare_job(tmp_path / "job", maker=MAKER, inputs={name: b""})
    assert not (tmp_path / "job" / "job.json").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    refused(prepare_job, tmp_path / "other", maker=MAKER, match="fixel needs a new folder")
    prepare_job(tmp_path / "job", maker=MAKER, inputs={"copy": tmp_path / "other" / "file"})
    assert sorted(p.name for p in (tmp_path / "job").iterdir()) == [
        "inputs", "job.json", "journal.lock", "state.json",
    ]  # fmt: skip


def test_a_folder_that_another_process_prepares_is_left_alone(tmp_path, monkeypatch):
    folder, copy = tmp_path / "job", shutil.copyfile

    def meanwhile(source, target):
        with pytest.raises(JobRefused, match="in use by process"):
            prepare_job(folder, maker=MAKER)
        copy(source, target)

    (tmp_path / "file").write_bytes(b"1")
    monkeypatch.setattr("fixel.jobs.folder.shutil.copyfile", meanwhile)
    job = prepare_job(folder, maker=MAKER, inputs={"one": tmp_path / "file"})
    assert files.inputs_digest(folder / "inputs") == job.inputs_sha256
    assert files.read_job(folder) == job
    refused(prepare_job, folder, maker=MAKER, match="fixel needs a new folder")


@pytest.mark.parametrize(("file", "change"), [
    ("job.json", {"surprise": 1}),
    ("job.json", {"label": "fixel-$(touch x)"}),
    ("run.json", {"workers": -1}),
    ("run.json", {"site": {"queue": "a b"}}),
])  # fmt: skip
def test_files_that_say_what_they_should_not(tmp_path, file, change):
    folder = toy_job(tmp_path / "job", RunSettings(), **OPTIONS)
    content = json.loads((folder / file).read_text())
    (folder / file).write_text(json.dumps(content | change))
    refused(coordinate, folder, match=file)
