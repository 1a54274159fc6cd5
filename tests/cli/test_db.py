"""`fixel db`: what is printed, what is left behind, exit codes."""

import json
import shutil
import sqlite3
from functools import partial

import pytest
from tests.cli.shell import invoked
from tests.fixtures import bare_experiment, project_of, refused

from fixel.cli import db
from fixel.database.project import VARIABLE, Project
from fixel.errors import StoreRefused

call = partial(invoked, db.app)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    return project_of(tmp_path / "my lab", map(bare_experiment, "abc")).folder


def test_upgrade_that_has_nothing_to_do(folder):
    code, out = call("upgrade", folder)
    assert code == 0
    assert out.splitlines() == [
        "The database already has schema 0005.",
        "",
        f"Next: fixel db check '{folder}'",
    ]


def test_upgrade_of_an_empty_database(folder):
    for file in folder.glob("experiments.db*"):
        file.unlink()
    code, out = call("upgrade", folder, "--json")
    assert (code, json.loads(out)) == (0, {"before": None, "after": "0005"})


def test_the_current_folder_is_the_default(folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert call("upgrade")[1].splitlines()[-1] == "Next: fixel db check"
    assert call("check")[0] == 0
    assert call("backup", "copy.db")[0] == 0


def test_check(folder):
    code, out = call("check", folder)
    assert code == 0
    assert out.splitlines() == [
        "sqlite, schema 0005",
        "table       rows",
        "experiment     3",
        "series         3",
        "media files: 0",
        "",
        "No errors: everything could be read.",
        "",
        f"Next: fixel db backup backup.db '{folder}'",
    ]


def test_check_of_a_damaged_file(folder):
    file = folder / "experiments.db"
    with sqlite3.connect(file) as raw:
        raw.execute("PRAGMA journal_mode = DELETE")
    raw.close()
    data = bytearray(file.read_bytes())
    data[8192:] = b"\xff" * (len(data) - 8192)
    file.write_bytes(data)

    code, out = call("check", folder)
    assert code == 1
    assert "1 error\n" in out
    assert out.splitlines()[-1] == (
        "Next: replace experiments.db with a backup, which fixel db backup wrote"
    )
    with pytest.raises(StoreRefused, match="list the errors: fixel db check"):
        call("backup", folder.parent / "copy.db", folder)
    assert not list(folder.parent.glob("*copy*"))


def test_check_of_what_is_no_database(folder):
    for file in folder.glob("experiments.db*"):
        file.unlink()
    (folder / "experiments.db").write_bytes(b"no database" * 1000)
    code, out = call("check", folder, "--json")
    (trouble,) = json.loads(out)["troubles"]
    assert code == 1
    assert trouble["sentence"].endswith("is not a SQLite database")


def test_a_backup_reads_back_while_another_process_writes(folder, tmp_path):
    copy = tmp_path / "copy.db"
    with Project(folder).store() as store:
        store.add_experiment(bare_experiment("d"))  # still in the journal of the database
        code, out = call("backup", copy, folder)
        store.add_experiment(bare_experiment("e"))
    assert code == 0
    assert out.splitlines()[-1] == f"Next: cp -rn '{folder}/media' {copy}.media"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["copy.db", "my lab"]

    for file in folder.glob("experiments.db*"):
        file.unlink()
    shutil.copyfile(copy, folder / "experiments.db")
    assert json.loads(call("check", folder, "--json")[1])["counts"]["experiment"] == 4
    with Project(folder).store() as store:
        assert [s.name for s in store.experiments().rows] == ["a", "b", "c", "d"]
        assert store.add_experiment(bare_experiment("f")).new


def test_a_backup_takes_the_place_of_the_one_before(folder, tmp_path):
    copy = tmp_path / "copy.db"
    copy.write_bytes(b"notes")
    refused(call, "backup", copy, folder, match="a new name, or an earlier backup")
    assert copy.read_bytes() == b"notes"

    copy.unlink()
    assert [call("backup", copy, folder)[1].split()[0] for _ in range(2)] == ["wrote", "replaced"]
    answer = json.loads(call("backup", copy, folder, "--json")[1])
    assert answer["file"] == str(copy)
    assert answer["size"] == copy.stat().st_size
    assert len(answer["sha256"]) == 64
    assert answer["media"] == str(folder / "media")


def test_a_backup_onto_itself(folder):
    refused(call, "backup", folder / "experiments.db", folder, match="found the database itself")
    assert call("check", folder)[0] == 0


def test_a_backup_into_no_folder(folder, tmp_path):
    refused(call, "backup", tmp_path / "no" / "copy.db", folder, match="found no folder")


def test_a_backup_of_a_server(folder, tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, "postgresql+psycopg://me:s3cret@lab.example:5433/pushes")
    with pytest.raises(StoreRefused) as refused:
        call("backup", tmp_path / "a copy", folder)
    assert "s3cret" not in str(refused.value)
    assert refused.value.hint == (
        f"run: pg_dump --format=custom '--file={tmp_path}/a copy' "
        "postgresql://me@lab.example:5433/pushes"
    )


@pytest.mark.parametrize("command", [["upgrade"], ["check"], ["backup", "copy.db"]])
def test_no_project(command, tmp_path):
    with pytest.raises(
        StoreRefused, match=r"is not a fixel project .no fixel.yaml.; make one with: fixel new"
    ):
        call(*command, tmp_path)


@pytest.mark.parametrize("command", [["check"], ["backup", "copy.db"]])
def test_no_database_file(folder, command):
    for file in folder.glob("experiments.db*"):
        file.unlink()
    with pytest.raises(StoreRefused, match="there is no database"):
        call(*command, folder)
    assert not list(folder.glob("experiments.db*"))
