"""What the machine refuses is a sentence: full disks, read-only ones, names that are too long."""

import contextlib
import errno
import os
import re
import shutil
import sqlite3
import subprocess
import time
from urllib.parse import urlencode

import pytest
from tests.cli.shell import fixel
from tests.fixtures import project_of, refused
from tests.web.bench import HERE, Bench

from fixel import FixelError, InvalidInput, Project, SimulatedTestbed, StoreRefused, compare, report
from fixel.cli.main import run
from fixel.formats.scene_file import scene_file_from_dict
from fixel.io.document import parse_json
from fixel.sampling import thesis_plan
from fixel.workflows.analysis import Analysis, store_analysis

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab") / "lab"
    project_of(folder, SimulatedTestbed(seed=1).run(thesis_plan().experiments[:2]))
    return folder


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 3 MB of its own; skipped where none may be made."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no file system can be made here")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.fixture
def lab(small_disk, laboratory):
    return shutil.copytree(laboratory, small_disk / "lab")


def protect(place):
    subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)


def fill(place, left_kb):
    """Leave so much room."""
    status = os.statvfs(place)
    free = status.f_bavail * status.f_frsize
    (place / "fill").write_bytes(bytes(max(0, free - 1024 * left_kb)))


# --- any command ----------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES, errno.ENAMETOOLONG])
def test_what_the_machine_refuses_is_a_sentence(capsys, monkeypatch, number):
    def refuse(*_, **__):
        raise OSError(number, os.strerror(number), "some/file")

    monkeypatch.setattr(Project, "__init__", refuse)
    code, _, err = fixel(capsys, "list", "--project", "lab")
    assert code == 1
    assert err.startswith(f"fixel: some/file: {os.strerror(number).lower()}")
    assert "Traceback" not in err


def test_a_mistake_of_ours_is_not_hidden(monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EBADF, "bad")

    monkeypatch.setattr(Project, "__init__", refuse)
    with pytest.raises(OSError, match="bad"):
        run(["list", "--project", "lab"])


# --- disks ----------------------------------------------------------------------------------------


def test_calibrate_on_a_full_disk(small_disk, laboratory, capsys):
    """Whichever file is the first without room: the database, the job's folder or one in it."""
    lab, left_kb, code = small_disk / "lab", 0, 1
    while code:
        shutil.copytree(laboratory, lab)
        fill(small_disk, left_kb)
        code, _, err = fixel(capsys, "calibrate", "--all", "--project", lab, "--prepare")
        if code:
            assert code in (1, 2), err
            assert "no space left on device" in err or "is full" in err
            assert err.count("\n") < 3
        shutil.rmtree(lab)
        (small_disk / "fill").unlink()
        left_kb += 4  # a page
    assert left_kb > 36


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_a_chart_on_a_full_disk(small_disk, laboratory, capsys, ending):
    fill(small_disk, 4)
    chart = small_disk / f"chart.{ending}"
    code, _, err = fixel(capsys, "show", 1, "--project", laboratory, "--plot", chart)
    assert (code, err.count("\n")) == (2, 1), err
    assert "no space left on device), but fixel needs free space on the disk" in err
    assert [path.name for path in small_disk.iterdir()] == ["fill"]


def test_a_command_that_fails_leaves_no_folder_for_charts(laboratory, capsys, tmp_path):
    charts = tmp_path / "new" / "charts"
    options = ("--threshold-mm", 4, "--by", "shoe_size", "--plot", charts)
    code, out, _ = fixel(capsys, "domain", "--project", laboratory, *options)
    assert (code, out) == (2, "")
    assert list(tmp_path.iterdir()) == []


def test_a_report_on_a_full_disk_leaves_no_folder(small_disk, laboratory, lab):
    found = compare(Project(laboratory).experiments(), progress=False)
    before = sorted(lab.iterdir())
    fill(small_disk, 0)
    refused(report, found, small_disk / "new" / "report", match="free space on the disk")
    analysis = Analysis(kind="compare", title="", question={}, headline=())
    refused(store_analysis, Project(lab), analysis, match="free space on the disk")
    assert sorted(lab.iterdir()) == before
    assert sorted(path.name for path in small_disk.iterdir()) == ["fill", "lab"]


def test_calibrate_where_jobs_cannot_be_written(small_disk, lab, capsys):
    (lab / "jobs").mkdir(exist_ok=True)
    protect(small_disk)
    code, _, err = fixel(capsys, "calibrate", "--all", "--project", lab)
    assert code in (1, 2)
    assert "read-only" in err
    assert "Traceback" not in err


def test_a_project_on_a_disk_that_cannot_be_written(small_disk, lab, capsys):
    """Burnt on a disc or mounted read-only, without the file that readers share with writers."""
    for left in lab.glob("experiments.db-*"):
        left.unlink()
    protect(small_disk)
    code, out, err = fixel(capsys, "list", "--project", lab)
    assert (code, err) == (0, "")
    assert "2" in out
    assert fixel(capsys, "db", "check", lab)[0] == 0
    with Project(lab).store() as store:
        assert store.experiment(1).trajectory.time.size > 1
        with pytest.raises(StoreRefused, match="read-only"):
            store.delete([1])


def test_changes_that_only_a_writer_can_bring_in_are_not_left_out(small_disk, lab, capsys):
    with contextlib.closing(sqlite3.connect(lab / "experiments.db")) as raw:
        raw.execute("UPDATE experiment SET deleted_at_utc = '2026' WHERE id = 1")
        raw.commit()
        copy = small_disk / "copy"
        copy.mkdir()
        for name in ("experiments.db", "experiments.db-wal", "fixel.yaml"):
            shutil.copy(lab / name, copy / name)
    assert (copy / "experiments.db-wal").stat().st_size > 0
    protect(small_disk)
    code, _, err = fixel(capsys, "list", "--project", copy)
    assert code == 1
    assert "newest changes" in err


# --- fixel new ------------------------------------------------------------------------------------


def test_new_on_a_full_disk_can_be_repeated(small_disk, capsys):
    fill(small_disk, 40)
    lab = small_disk / "lab"
    code, _, err = fixel(capsys, "new", lab)
    assert code in (1, 2)
    assert "full" in err or "no space" in err
    assert not lab.exists()
    (small_disk / "fill").unlink()
    assert fixel(capsys, "new", lab)[0] == 0


@pytest.mark.parametrize(
    "moment", ["fixel.database.schema.upgrade", "fixel.database.project.write_whole"]
)
def test_a_new_that_failed_leaves_nothing(tmp_path, monkeypatch, moment):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(moment, full)
        with pytest.raises(FixelError, match="no space left"):
            Project.create(tmp_path / "lab")
    assert not (tmp_path / "lab").exists()
    Project.create(tmp_path / "lab").store().close()


def test_a_new_that_was_killed_can_be_repeated(tmp_path):
    Project.create(tmp_path / "lab")
    for left in ({}, {"experiments.db": b""}):
        (tmp_path / "lab" / "fixel.yaml").unlink()
        for name, content in left.items():
            (tmp_path / "lab" / name).write_bytes(content)
        Project.create(tmp_path / "lab")
        with Project(tmp_path / "lab").store() as store:
            assert store.datasets() == {}


def test_a_database_that_holds_something_is_not_taken(laboratory, tmp_path):
    shutil.copytree(laboratory, tmp_path / "lab")
    (tmp_path / "lab" / "fixel.yaml").unlink()
    before = (tmp_path / "lab" / "experiments.db").read_bytes()
    refused(Project.create, tmp_path / "lab", match="other files")
    assert (tmp_path / "lab" / "experiments.db").read_bytes() == before


@pytest.mark.parametrize("name", ["x" * 200, "x" * 250, "\u00e4" * 120, "x" * 300])
def test_long_names(tmp_path, capsys, name):
    code, _, err = fixel(capsys, "new", tmp_path / name)
    assert code == (1 if len(name) == 300 else 0), err
    assert "Traceback" not in err
    if not code:
        assert name.startswith(Project(tmp_path / name).settings.name)


# --- documents ------------------------------------------------------------------------------------


def test_many_keys_cost_no_more_than_reading_them():
    """Each step of a scene's way is linear; counted in calls, since nothing here is timed."""
    many = {f"k{i}": i for i in range(120_000)}
    with pytest.raises(InvalidInput, match="found 120000 keys, but fixel needs at most 1000"):
        scene_file_from_dict({"fixel": 1, **dict(list(many.items())[:-1])})


def test_a_key_twice_among_many_is_found_at_once():
    pairs = ",".join(f'"k{i}": 1' for i in range(120_000))
    begun = time.process_time()
    refused(parse_json, f'{{{pairs}, "k119999": 2}}', "a.json", match="'k119999' twice")
    assert time.process_time() - begun < 20.0  # it was minutes: each key compared with all


def test_a_database_on_a_full_disk_is_not_called_damaged(small_disk, lab, capsys):
    fill(small_disk, 0)
    for target in (lab / "backup.db", lab.parent.parent / "backup.db"):
        code, _, err = fixel(capsys, "db", "backup", str(target), "--project", str(lab))
        if code:
            assert "full" in err
            assert "free disk space" in err
        assert "damaged" not in err


def test_a_form_on_a_full_disk_is_answered_with_a_sentence(small_disk, lab):
    bench = Bench(lab)
    form = bench.client.get("/run/sensitivity").text
    word = re.search(r'name="fixel-word" value="([^"]+)"', form)[1]
    sent = {"content-type": "application/x-www-form-urlencoded", "origin": HERE}
    body = urlencode({"fixel-word": word, "experiments": "1"}).encode()
    fill(small_disk, 0)
    answer = bench.client.request("POST", "/run/sensitivity", sent, content=body)
    bench.close()
    assert answer.status_code == 409
    assert "free disk space" in answer.text
