"""Processes and servers that die, disks that are full: records are whole or absent, and a refusal
names the reason and a remedy."""

import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy import event
from tests.database import importing, server
from tests.jobs.helpers import await_true
from tests.processes import line_of

from fixel.database import engine, rows
from fixel.database.query import ALL_EXPERIMENTS
from fixel.database.store import Store
from fixel.errors import StoreRefused
from fixel.model.selection import ExperimentQuery

pytestmark = pytest.mark.system

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _files_for_short_series(monkeypatch):
    monkeypatch.setattr(rows, "MEDIA_BYTES", importing.SMALL_MEDIA_BYTES)


# --- a process that is killed -------------------------------------------------------------------


def kill_while_importing(url, media, batch, chance):
    """Kill an import at a random moment; returns the experiments it had said were there."""
    arguments = [sys.executable, HERE / "importing.py", url, media, str(batch)]
    moment = chance.randrange(importing.N)
    with subprocess.Popen(
        arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert line_of(process) == "ready\n"
        said = [line_of(process).strip() for _ in range(moment)]
        time.sleep(chance.uniform(0.0, 0.01))  # anywhere within the next few
        process.kill()
        said += process.stdout.read().split()
    assert process.returncode == -9
    return [int(k) for k in said]


def whole(store, batch):
    """Numbers of the experiments of a batch; each must be as it was sent."""
    listing = store.experiments(
        ExperimentQuery(dataset=f"batch-{batch}", include_faulty=True, marks=("replaced",))
    )
    for summary in listing.rows:
        assert store.experiment(summary.id) == importing.experiment(batch, int(summary.name))
    found = [int(summary.name) for summary in listing.rows]
    assert len(found) == len(set(found))
    return set(found)


def add_all(store, batch):
    return [store.add_experiment(importing.experiment(batch, k)) for k in range(importing.N)]


def killed_often(store, url, media, n, seed=1):
    chance = random.Random(seed)
    for batch in range(n):
        said = kill_while_importing(url, media, batch, chance)
        # A server may still be busy with what a dead process asked for last.
        with engine.writing(store._engine):
            pass
        there = whole(store, batch)
        assert there >= set(said)  # durable: what was said to be there is there
        assert len(there) <= len(said) + 1
        again = add_all(store, batch)
        assert sum(added.new for added in again) == importing.N - len(there)
        assert whole(store, batch) == set(range(importing.N))


def test_kills(store, url, tmp_path):
    killed_often(store, url, tmp_path / "media", 3)
    assert store.experiments(ALL_EXPERIMENTS).total == 3 * importing.N


@pytest.mark.slow
def test_a_hundred_kills(store, url, tmp_path):
    killed_often(store, url, tmp_path / "media", 100, seed=2)


# --- a server that is killed --------------------------------------------------------------------

SENT = "before_cursor_execute"


@contextlib.contextmanager
def at(store, moment, then, start=""):
    """Do something once, right before a commit, or before a statement with this start is sent."""
    pending = [then]

    def look(connection, cursor=None, statement="", *_):
        if pending and statement.startswith(start):
            pending.pop()()

    event.listen(store._engine, moment, look)
    yield
    event.remove(store._engine, moment, look)
    assert not pending


def moments(store, die):
    yield "before", contextlib.ExitStack(), die
    yield "first row", at(store, SENT, die, "INSERT INTO experiment"), None
    yield "last row", at(store, SENT, die, "INSERT INTO flag"), None
    yield "commit", at(store, "commit", die), None


def test_a_server_that_is_killed_during_an_import(tmp_path):
    if server.binaries() is None:
        pytest.skip("no PostgreSQL on this machine")
    with server.running() as own, Store(own.url, tmp_path / "media") as store:
        store.upgrade()
        for batch, (_, during, first) in enumerate(moments(store, own.kill)):
            for k in range(5):
                store.add_experiment(importing.experiment(batch, k))
            if first is not None:
                first()
            with during, pytest.raises(StoreRefused, match="no connection to") as refused:
                add_all_from(store, batch, 5)
            assert "password" not in str(refused.value)
            assert refused.value.hint == "check that the server runs"
            with pytest.raises(StoreRefused, match="no connection to"):
                store.experiments()
            own.start()
            assert whole(store, batch) in ({*range(5)}, {*range(6)})
            add_all(store, batch)
            assert whole(store, batch) == set(range(importing.N))


def add_all_from(store, batch, first):
    for k in range(first, importing.N):
        store.add_experiment(importing.experiment(batch, k))


TESTS = """
import importlib.util, sys, time
spec = importlib.util.spec_from_file_location("server", sys.argv[1])
server = importlib.util.module_from_spec(spec)
spec.loader.exec_module(server)
with server.running() as own:
    print(own.process.pid, own.folder, flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_server_ends_with_the_tests_that_use_it(number):
    if server.binaries() is None:
        pytest.skip("no PostgreSQL on this machine")
    arguments = [sys.executable, "-c", TESTS, str(HERE / "server.py")]
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as tests:
        pid, folder = line_of(tests).split()
        os.kill(int(pid), 0)
        tests.send_signal(number)
    await_true(lambda: not (Path(folder).exists() or is_running(int(pid))))


def is_running(pid):
    """Whether a process runs; one that only waits to be collected does not."""
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return state.stdout.strip()[:1] not in ("", "Z")


# --- what stands in the way of a file -----------------------------------------------------------


@pytest.fixture
def file(tmp_path):
    return tmp_path / "experiments.db"


@pytest.fixture
def filled(file, tmp_path):
    """A database with one experiment, closed."""
    with Store(f"sqlite:///{file}", tmp_path / "media") as store:
        store.upgrade()
        store.add_experiment(importing.experiment(0, 1))
    return file


def store_of(file):
    return Store(f"sqlite:///{file}", file.parent / "media")


def refusal(act, *arguments):
    with pytest.raises(StoreRefused) as refused:
        act(*arguments)
    assert refused.value.reason
    return refused.value.reason, refused.value.hint


def still_one(file):
    with store_of(file) as store:
        assert whole(store, 0) == {1}
    with contextlib.closing(sqlite3.connect(file)) as raw:
        assert raw.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert raw.execute("SELECT count(*) FROM series").fetchone() == (2,)


@contextlib.contextmanager
def no_permission():
    """Drop the rights of root, to whom nothing is read-only."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def open_folder():
    # tmp_path lies in a folder that only its owner may enter.
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)
        os.chmod(folder, 0o755)


def test_a_read_only_file(open_folder):
    file = open_folder / "experiments.db"
    with store_of(file) as store:
        store.upgrade()
        store.add_experiment(importing.experiment(0, 1))
    file.chmod(0o444)
    open_folder.chmod(0o555)
    with no_permission(), store_of(file) as store:
        reason, hint = refusal(store.add_experiment, importing.experiment(0, 2))
        refusal(store.upgrade)
    assert reason == f"sqlite:///{file} is read-only"
    assert hint == "make the file and its folder writable"
    open_folder.chmod(0o755)
    file.chmod(0o644)
    still_one(file)


@pytest.mark.parametrize("missing", [True, False])
def test_a_folder_that_is_missing_or_read_only(open_folder, missing):
    folder = open_folder / "lab"
    if not missing:
        folder.mkdir(mode=0o555)
    with no_permission(), store_of(folder / "experiments.db") as store:
        reason, hint = refusal(store.upgrade)
    assert reason.endswith("cannot be opened")
    assert hint == "check that its folder exists and may be written to"
    assert not list(open_folder.rglob("*.db*"))


def test_locked_by_another_process(filled, monkeypatch):
    monkeypatch.setattr(engine, "WAIT_S", 0.05)
    with (
        contextlib.closing(sqlite3.connect(filled, isolation_level=None)) as other,
        store_of(filled) as store,
    ):
        other.execute("BEGIN IMMEDIATE")
        reason, hint = refusal(store.add_experiment, importing.experiment(0, 2))
        assert whole(store, 0) == {1}  # readers do not wait
        other.execute("ROLLBACK")
        assert store.add_experiment(importing.experiment(0, 1)).new is False
    assert reason.endswith("is locked by another process for more than 0.05 s")
    assert hint == "wait until it has finished, or find it with: fuser FILE"
    still_one(filled)


def test_a_server_locked_by_another_process(store, monkeypatch):
    if store._engine.dialect.name != "postgresql":
        pytest.skip("of PostgreSQL")
    monkeypatch.setattr(engine, "WAIT_S", 0.05)
    with engine.writing(store._engine):
        reason, hint = refusal(store.add_experiment, importing.experiment(0, 2))
    assert "is locked by another process" in reason
    assert hint == "wait until it has finished"
    assert store.experiments().total == 0


def test_a_full_disk(filled):
    with store_of(filled) as store:

        @event.listens_for(store._engine, "begin")
        def no_more_pages(connection):
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar()
            connection.exec_driver_sql(f"PRAGMA max_page_count = {pages}")

        reason, hint = refusal(add_all, store, 0)
        there = whole(store, 0)
    assert reason == f"the disk of sqlite:///{filled} is full"
    assert hint == "free disk space, then repeat the command"
    with store_of(filled) as store:
        assert whole(store, 0) == there
        assert sum(added.new for added in add_all(store, 0)) == importing.N - len(there)


CHECK_ON_A_FULL_DISK = """
import resource, signal, sys
from fixel.database.project import Project
project = Project(sys.argv[1])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
print(*(one.sentence + "|" + one.hint for one in project.check().troubles), sep="\\n")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="of systems that limit the sizes of files")
def test_a_check_on_a_full_disk_does_not_advise_to_replace_the_database(filled, tmp_path):
    (tmp_path / "fixel.yaml").write_text("name: lab\n")
    arguments = [sys.executable, "-c", CHECK_ON_A_FULL_DISK, str(tmp_path)]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=60, check=True)
    (line,) = done.stdout.splitlines()
    reason, hint = line.split("|")
    assert reason == f"the disk of sqlite:///{filled} fails or is full: disk I/O error"
    assert hint == "free disk space or check the disk, then repeat the command"


def test_no_database(file):
    file.write_bytes(b"time_s,x_m\n" * 1000)
    before = file.read_bytes()
    for act in ("upgrade", "check_version", "experiments"):
        with store_of(file) as store:
            reason, hint = refusal(getattr(store, act))
            assert reason == f"sqlite:///{file} is not a SQLite database"
            assert hint == "replace it with a backup, which fixel db backup wrote"
    assert file.read_bytes() == before


def test_a_damaged_database(filled):
    with contextlib.closing(sqlite3.connect(filled)) as raw:
        raw.execute("PRAGMA journal_mode = DELETE")
    data = bytearray(filled.read_bytes())
    data[4096:] = b"\xff" * (len(data) - 4096)
    filled.write_bytes(data)
    with store_of(filled) as store:
        reason, hint = refusal(store.experiments)
    assert reason == f"sqlite:///{filled} is damaged"
    assert hint == "list the errors: fixel db check"


def test_a_schema_that_is_newer(store):
    store.add_experiment(importing.experiment(0, 1))
    with engine.writing(store._engine) as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = '9999'"))
    for act in (store.check_version, store.upgrade):
        reason, hint = refusal(act)
        assert "has schema 9999, newer than schema 0005" in reason
        assert hint == "install the version of fixel that wrote it, or a newer one"
    assert whole(store, 0) == {1}


def test_a_database_without_tables(url, tmp_path):
    with Store(url, tmp_path / "media") as store:
        reason, hint = refusal(store.check_version)
        assert "is empty" in reason
        assert hint == "run: fixel db upgrade"
        for act, *arguments in (
            (store.experiments,),
            (store.experiment, 1),
            (store.add_experiment, importing.experiment(0, 1)),
        ):
            reason, hint = refusal(act, *arguments)
            assert reason.endswith("has no tables yet")
            assert hint == "run: fixel db upgrade"
        assert store.upgrade() == (None, "0005")


def test_a_database_and_a_user_that_are_not_there(postgres, tmp_path):
    there = sa.make_url(postgres.url)
    for change, word, help_ in (
        ({"database": "nowhere"}, "nowhere", "create the database"),
        ({"username": "stranger", "password": "s3cret"}, "stranger", "check user and password"),
    ):
        url = there.set(**change).render_as_string(hide_password=False)
        with Store(url, tmp_path / "media") as store:
            reason, hint = refusal(store.experiments)
        assert word in reason
        assert "s3cret" not in reason
        assert hint.startswith(help_)


MOUNTS = """\
/dev/sda1 / ext4 rw 0 0
server:/home /home nfs4 rw 0 0
/dev/sdb1 /home/local ext4 rw 0 0
//nas/lab /mnt/the\\040lab cifs rw 0 0
"""


@pytest.mark.parametrize(
    ("path", "kind"), [("/home/me/e.db", "nfs4"), ("/mnt/the lab/e.db", "cifs")]
)
def test_a_network_file_system(path, kind):
    reason, hint = refusal(engine.check_local, Path(path), MOUNTS)
    assert f"network file system ({kind})" in reason
    assert "local disk" in hint


@pytest.mark.parametrize("path", ["/e.db", "/homes/e.db", "/home/local/e.db", "/mnt/the/e.db"])
def test_a_local_file_system(path):
    engine.check_local(Path(path), MOUNTS)


@pytest.mark.parametrize("url", ["no url", "oracle+nothing://x"])
def test_no_url(url, tmp_path):
    _, hint = refusal(Store, url, tmp_path)
    assert hint.startswith("write sqlite:///FILE or postgresql+psycopg://")


def test_a_media_folder_that_cannot_be_written_to(tmp_path):
    media = tmp_path / "media"
    media.write_text("a file where the folder should be", encoding="utf-8")
    with pytest.raises(StoreRefused, match="cannot be written to"):
        rows.keep(b"0" * 10, media)


def test_a_database_of_somebody_else_is_left_alone(tmp_path):
    path = tmp_path / "theirs.db"
    with contextlib.closing(sqlite3.connect(path)) as theirs:
        theirs.execute("CREATE TABLE bookmarks (url TEXT)")
        theirs.commit()
    with (
        Store(f"sqlite:///{path}", tmp_path / "media") as store,
        pytest.raises(StoreRefused, match="do not belong to fixel"),
    ):
        store.upgrade()
