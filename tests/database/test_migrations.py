"""One line of versions, from nothing and from every known version to the tables of today."""

import shutil
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from tests.database import importing

from fixel.database import migrations, schema
from fixel.database.engine import reading, writing
from fixel.database.schema import METADATA
from fixel.database.store import Store
from fixel.errors import StoreRefused

ASSETS = Path(__file__).with_name("assets")
# A file with a few records of every version that was ever released; `make_asset` wrote the newest.
KEPT = sorted(ASSETS.glob("schema-*.db"))
OLD = [file for file in KEPT if file.stem < f"schema-{schema.versions()[0]}"]


def make_asset():
    """Keep a file of today's version: to be called once, when a version is released."""
    file = ASSETS / f"schema-{schema.newest()}.db"
    file.parent.mkdir(exist_ok=True)
    with Store(f"sqlite:///{file}", ASSETS / "media") as store:
        store.upgrade()
        for k in (1, 2):
            store.add_experiment(importing.experiment(0, k))
        store.delete([2])
        with writing(store._engine) as connection:
            connection.execute(sa.text("UPDATE flag SET deleted_at_utc = '2026' WHERE id = 2"))
    with sa.create_engine(f"sqlite:///{file}").connect() as connection:
        connection.exec_driver_sql("PRAGMA journal_mode = DELETE")


def left_to_do(store):
    """Differences of the tables of a database from those of the program."""
    with reading(store._engine) as connection:
        context = MigrationContext.configure(
            connection, opts={"compare_type": True, "compare_server_default": True}
        )
        return compare_metadata(context, METADATA)


def triggers(store):
    question = (
        "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        if store._engine.dialect.name == "sqlite"
        else "SELECT tgname FROM pg_trigger WHERE NOT tgisinternal"
    )
    with reading(store._engine) as connection:
        return set(connection.scalars(sa.text(question)))


def test_one_line_of_versions():
    scripts = ScriptDirectory(str(schema.MIGRATIONS))
    assert scripts.get_heads() == [schema.newest()]
    assert len(scripts.get_bases()) == 1
    known = [script.revision for script in scripts.walk_revisions()]
    assert schema.versions() == tuple(reversed(known))


def test_from_nothing_it_is_the_tables_of_the_program(url, tmp_path):
    with Store(url, tmp_path) as store:
        assert store.upgrade() == (None, schema.newest())
        assert left_to_do(store) == []
        store.check_version()


def test_one_version_after_the_other_is_the_same(url, tmp_path):
    with Store(url, tmp_path) as store:
        before = None
        for version in schema.versions():
            assert store.upgrade(version) == (before, version)
            before = version
        assert left_to_do(store) == []


@pytest.mark.parametrize("file", [f for f in KEPT if f not in OLD], ids=lambda file: file.stem)
def test_every_version_has_the_columns_of_its_file(file, tmp_path):
    def columns(path):
        look = sa.inspect(sa.create_engine(f"sqlite:///{path}"))
        return {t: {c["name"] for c in look.get_columns(t)} for t in look.get_table_names()}

    with Store(f"sqlite:///{tmp_path}/made.db", tmp_path) as store:
        store.upgrade(file.stem.removeprefix("schema-"))
    assert columns(tmp_path / "made.db") == columns(file)


def test_again_changes_nothing(store):
    before = triggers(store)
    assert store.upgrade() == (schema.newest(), schema.newest())
    assert triggers(store) == before


def test_what_is_written_once_is_frozen(store):
    frozen = set(METADATA.tables)
    expected = {f"{table}_{how}" for table in frozen for how in ("frozen", "kept")}
    assert triggers(store) == expected


def test_every_version_has_a_file():
    known = schema.versions()
    assert [file.stem for file in KEPT if file not in OLD] == [f"schema-{v}" for v in known]


@pytest.mark.parametrize("file", OLD, ids=lambda file: file.stem)
def test_a_file_from_before_the_first_release_is_refused(file, tmp_path):
    copy = tmp_path / "experiments.db"
    shutil.copyfile(file, copy)
    with Store(f"sqlite:///{copy}", tmp_path / "media") as store:
        for call in (store.check_version, store.upgrade):
            with pytest.raises(StoreRefused, match="before the first release") as refused:
                call()
            assert "import the experiments again" in refused.value.hint
        assert tables_of(store) >= {"experiment", "flag"}


@pytest.mark.parametrize("file", [f for f in KEPT if f not in OLD], ids=lambda file: file.stem)
def test_a_file_of_every_version_upgrades_and_reads_back(file, tmp_path):
    copy = tmp_path / "experiments.db"
    shutil.copyfile(file, copy)
    with Store(f"sqlite:///{copy}", tmp_path / "media") as store:
        assert store.upgrade() == (file.stem.removeprefix("schema-"), schema.newest())
        assert left_to_do(store) == []
        assert [s.key for s in store.experiments().rows] == ["batch-0/1"]
        found = store.experiment(1)
        assert found.conditions == {"surface": "plywood", "speed_m_s": 0.02}
        assert [flag.detail for flag in found.flags] == ["by 1 s"]
        assert found.scene.bodies[0].name == found.object_name
        assert len(found.trajectory.time) == 20
        assert found.channels[0].values.shape == (2, 1)
        # What was imported before the upgrade is known after it.
        assert not store.add_experiment(found).new
        with pytest.raises(StoreRefused, match="finished records cannot change"):
            change(store)


def change(store):
    with writing(store._engine) as connection:
        connection.execute(sa.text("UPDATE experiment SET name = 'other'"))


# --- a migration that fails ---------------------------------------------------------------------


def tables_of(store):
    with reading(store._engine) as connection:
        return set(sa.inspect(connection).get_table_names())


def test_a_first_version_that_fails_leaves_nothing(url, tmp_path, monkeypatch):
    done = []

    def freeze(table):
        if len(done) == 4:
            raise RuntimeError("power cut")
        done.append(table)

    with Store(url, tmp_path) as store:
        with monkeypatch.context() as patch:
            patch.setattr(migrations, "freeze", freeze)
            with pytest.raises(RuntimeError, match="power cut"):
                store.upgrade()
        assert len(done) == 4
        assert tables_of(store) == set()
        assert store.upgrade() == (None, schema.newest())
        assert left_to_do(store) == []


BROKEN = """
import sqlalchemy as sa
from alembic import op

revision = "9001"
down_revision = "{newest}"


def upgrade():
    op.create_table("later", sa.Column("id", sa.Integer(), primary_key=True))
    op.add_column("experiment", sa.Column("mood", sa.Text()))
    op.execute("INSERT INTO later (id) VALUES (1)")
    op.execute("INSERT INTO later (id) VALUES (1)")
"""


def test_a_later_version_that_fails_leaves_the_one_before(store, tmp_path, monkeypatch):
    number = store.add_experiment(importing.experiment(0, 1)).id
    folder = tmp_path / "migrations"
    shutil.copytree(schema.MIGRATIONS, folder)
    (folder / "versions" / "m9001_broken.py").write_text(BROKEN.format(newest=schema.newest()))
    before = tables_of(store)
    with monkeypatch.context() as patch:
        patch.setattr(schema, "MIGRATIONS", folder)
        with pytest.raises(StoreRefused, match=r"(?i)unique"):
            store.upgrade()
    assert tables_of(store) == before
    assert left_to_do(store) == []
    store.check_version()
    assert store.experiment(number) == importing.experiment(0, 1)
