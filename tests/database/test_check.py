"""`workflows.database.check` on both engines: what is wrong is found and named."""

import pytest
import sqlalchemy as sa
from tests.database import importing

from fixel.database import project, rows
from fixel.database.engine import writing
from fixel.database.project import Project
from fixel.errors import StoreRefused


@pytest.fixture
def folder(store, url, tmp_path, monkeypatch):
    """A project with three experiments, the first of which has a file."""
    monkeypatch.setattr(rows, "MEDIA_BYTES", importing.SMALL_MEDIA_BYTES)
    monkeypatch.setenv(project.VARIABLE, url)
    (tmp_path / project.SETTINGS).write_text("name: lab\n")
    for k in range(3):
        store.add_experiment(importing.experiment(0, k))
    return tmp_path


def media_of(folder):
    (file,) = (folder / "media").glob("??/*")
    return file


def spoil(store, table, statement):
    """Change what is frozen, as a program other than fixel could, and leave no trace of it."""
    definitions = {
        "sqlite": "SELECT name, sql FROM sqlite_master WHERE type = 'trigger' AND tbl_name = :t",
        "postgresql": "SELECT tgname, pg_get_triggerdef(oid) FROM pg_trigger"
        " WHERE NOT tgisinternal AND tgrelid = CAST(:t AS regclass)",
    }
    with writing(store._engine) as connection:
        on = "" if store._engine.dialect.name == "sqlite" else f" ON {table}"
        text = sa.text(definitions[store._engine.dialect.name])
        triggers = connection.execute(text, {"t": table}).all()
        for name, _ in triggers:
            connection.execute(sa.text(f"DROP TRIGGER {name}{on}"))
        connection.execute(sa.text(statement))
        for _, definition in triggers:
            connection.exec_driver_sql(definition)


def only_trouble(folder):
    (trouble,) = Project(folder).check().troubles
    return trouble


def test_nothing_wrong(store, folder):
    found = Project(folder).check()
    assert found.troubles == ()
    assert (found.engine, found.version) == (store._engine.dialect.name, "0005")
    assert (found.counts["experiment"], found.counts["series"], found.counts["flag"]) == (3, 6, 3)
    assert (found.media_files, found.unused_files) == (1, 0)


@pytest.mark.parametrize("content", ["[]", "{}", '{"kind": 3}', "no JSON"])
def test_a_stored_result_that_cannot_be_read(folder, content):
    path = folder / "analyses" / "domain-1" / "analysis.json"
    path.parent.mkdir(parents=True)
    path.write_text(content)
    where, sentence, hint = only_trouble(folder)
    assert where == "results"
    assert sentence.startswith(f"{path} cannot be read")
    assert hint == f"delete the folder {path.parent} and run the analysis again"


def test_a_media_file_that_is_gone(folder):
    media_of(folder).unlink()
    where, sentence, hint = only_trouble(folder)
    assert where == "experiment 1, series 'object'"
    assert sentence.endswith("is missing")
    assert hint == "restore it from a backup of the media folder"


def test_a_media_file_that_changed(folder):
    media_of(folder).write_bytes(b"other")
    assert only_trouble(folder).sentence.endswith("has changed")


def test_a_changed_file_without_an_owner(folder):
    stray = folder / "media" / "ab" / ("ab" + "0" * 62)
    stray.parent.mkdir(exist_ok=True)
    stray.write_bytes(b"x")
    assert only_trouble(folder).where == f"file {stray}"
    assert Project(folder).check().unused_files == 1


def test_what_a_killed_writer_left_is_no_trouble(folder):
    media_of(folder).with_name(".half.123").write_bytes(b"x")
    assert Project(folder).check().troubles == ()


@pytest.mark.parametrize(("table", "statement", "where", "sentence"), [
    ("series", "UPDATE series SET n_row = 3 WHERE owner_id = 2 AND place = 1",
     "experiment 2, series 'channel force'", "has 32 bytes instead of 48"),
    ("series", "UPDATE series SET owner_id = 77 WHERE owner_id = 2 AND place = 1",
     "experiment 77, series 'channel force'", "its record is missing"),
    ("series", "DELETE FROM series WHERE owner_id = 2 AND place = 0", "experiment 2",
     "the trajectory of its object is incomplete"),
    ("experiment", "UPDATE experiment SET n_frame = 7 WHERE id = 3", "experiment 3",
     "the trajectory of its object is incomplete"),
])  # fmt: skip
def test_rows_that_were_changed(store, folder, table, statement, where, sentence):
    spoil(store, table, statement)
    assert Project(folder).check().troubles[0][:2] == (where, sentence)


def test_a_video_that_is_gone(store, folder):
    digest = "ab" * 32
    spoil(store, "experiment", f"UPDATE experiment SET video_sha256 = '{digest}' WHERE id = 2")
    where, sentence, _ = only_trouble(folder)
    assert where == "experiment 2"
    assert sentence.startswith("its video ")


def test_a_row_without_what_it_names(store, folder):
    if store._engine.dialect.name != "sqlite":
        pytest.skip("PostgreSQL refuses it, whoever asks")
    with writing(store._engine) as connection:
        connection.exec_driver_sql("PRAGMA defer_foreign_keys = ON")
        raw = connection.connection.dbapi_connection
        raw.execute("ROLLBACK")  # the next setting is only heard between transactions
        raw.execute("PRAGMA foreign_keys = OFF")
        raw.execute("DROP TRIGGER flag_frozen")
        raw.execute("UPDATE flag SET experiment_id = 99 WHERE id = 1")
        raw.execute("PRAGMA foreign_keys = ON")
        raw.execute("BEGIN")
    found = [trouble[:2] for trouble in Project(folder).check().troubles]
    assert ("flag", "1 row of flag without their experiment_id") in found


def test_a_server_makes_its_own_backups(store, folder):
    if store._engine.dialect.name == "sqlite":
        assert Project(folder).backup(folder / "b.db").size > 0
        return
    with pytest.raises(StoreRefused, match=r"run: pg_dump --format=custom --file=\S+b\.db"):
        Project(folder).backup(folder / "b.db")
    assert not (folder / "b.db").exists()
