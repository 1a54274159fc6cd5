"""Databases spoiled in many ways: `fixel db check` finds each, says where, and never breaks off.

The damage is done with the bytes of the file and with plain SQL, past all that fixel refuses.
"""

import contextlib
import shutil
import sqlite3

import numpy as np
import pytest
from tests.database.triggers import without_triggers
from tests.fixtures import bare_experiment
from tests.laboratories import trusted_laboratory

from fixel.database.project import Project
from fixel.errors import FixelError, StoreRefused
from fixel.model import Channel, Trajectory


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A project with experiments, simulations, a calibration and a long series; not to change."""
    folder = tmp_path_factory.mktemp("whole") / "my_lab"
    trusted_laboratory(folder)
    time = np.linspace(0.0, 1.0, 50_000)
    track = Trajectory(time=time, pose=np.zeros((len(time), 3)))
    force = Channel(name="force", time=[0.0, 1.0], columns=("fx_n",), values=[[1], [2]])
    with Project(folder).store() as store:
        store.add_experiment(bare_experiment("1", trajectory=track, channels=(force,)))
    with contextlib.closing(sqlite3.connect(folder / "experiments.db")) as raw:
        raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    assert any((folder / "media").glob("??/*"))
    return folder


@pytest.fixture
def folder(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "lab")
    return tmp_path / "lab"


def behind(folder, *statements):
    """Run SQL with no trigger and no foreign key in its way; the triggers are there afterwards."""
    with without_triggers(folder / "experiments.db") as raw:
        raw.execute("PRAGMA writable_schema = ON")
        for statement in statements:
            raw.execute(statement)


ROWS = {
    "a value of an experiment": "UPDATE experiment SET object_height_m = 0.5 WHERE id = 4",
    "its name": "UPDATE experiment SET name = 'other' WHERE id = 4",
    "whether it is real": "UPDATE experiment SET is_real = 1 - is_real WHERE id = 4",
    "its conditions": "UPDATE experiment SET conditions = '{\"speed_m_s\": 9.0}' WHERE id = 4",
    "no JSON": "UPDATE experiment SET conditions = '{' WHERE id = 4",
    "its scene": "UPDATE experiment SET scene = replace(scene, '0.1', '0.2') WHERE id = 4",
    "no scene": "UPDATE experiment SET scene = NULL WHERE id = 4",
    "its start": "UPDATE experiment SET start_x_m = start_x_m + 1e-6 WHERE id = 4",
    "its duration": "UPDATE experiment SET duration_s = 99 WHERE id = 4",
    "its checksum": "UPDATE experiment SET content_sha256 = 'x' WHERE id = 4",
    "a row less": "DELETE FROM experiment WHERE id = 4",
    "another geometry": "UPDATE experiment SET object_geometry_id = pusher_geometry_id"
    " WHERE id = 4",
    "a geometry that is none": "UPDATE experiment SET object_geometry_id = 99 WHERE id = 4",
    "a geometry changed": "UPDATE object_pusher_geometry SET height_m = 7 WHERE id = 1",
    "numbers of a path": "UPDATE series SET data = zeroblob(length(data)) WHERE owner_id = 4"
    " AND owner = 'experiment' AND place = 0",
    "a byte less": "UPDATE series SET data = substr(data, 2) WHERE id = 7",
    "text for numbers": "UPDATE series SET data = 'hello' WHERE id = 7",
    "columns": "UPDATE series SET columns = '[\"time_s\"]' WHERE id = 7",
    "series of another": "UPDATE series SET data = (SELECT data FROM series WHERE id = 4)"
    " WHERE id = 7",
    "a series less": "DELETE FROM series WHERE owner = 'experiment' AND owner_id = 4 AND place > 0",
    "an owner that is none": "UPDATE series SET owner = 'nobody' WHERE id = 7",
    "a file that is none": f"UPDATE series SET media_sha256 = '{'a' * 64}' WHERE media_sha256 > ''",
    "a flag it came with": "UPDATE experiment SET n_import_flag = 5 WHERE id = 4",
    "a parameter": "UPDATE system_parameters SET mu_pusher = 0.9 WHERE id = 1",
    "path of a simulation": "UPDATE series SET data = zeroblob(length(data)) WHERE"
    " owner = 'simulation' AND place = 0 AND owner_id = 1",
    "a simulation of nothing": "UPDATE simulation SET experiment_id = 999 WHERE id = 1",
    "a sum of errors": "UPDATE calibration SET sum_error_mm2 = 1e-3",
    "an error of a member": "UPDATE calibration_member SET error_mm2 = 2 * error_mm2 + 1",
    "a member less": "DELETE FROM calibration_member WHERE place = 0",
    "evaluations": "DELETE FROM series WHERE owner = 'calibration'",
    "estimates": "UPDATE calibration SET estimates = '[{\"a\": 1}]'",
}
SCHEMA = {
    "a table less": ("DROP TABLE note",),
    "the table of series": ("DROP TABLE series",),
    "all tables but one": ("DROP TABLE calibration_member", "DROP TABLE calibration"),
    "a column of another name": ("ALTER TABLE experiment RENAME COLUMN conditions TO conditioned",),
    "a column less": ("ALTER TABLE simulation DROP COLUMN status",),
    "no version": ("DROP TABLE alembic_version",),
    "an empty version": ("DELETE FROM alembic_version",),
    "two versions": ("INSERT INTO alembic_version VALUES ('0002')",),
    "an unknown version": ("UPDATE alembic_version SET version_num = 'x'",),
    "an index less": ("DROP INDEX ix_flag_experiment_id",),
    "a view for a table": ("ALTER TABLE note RENAME TO n", "CREATE VIEW note AS SELECT * FROM n"),
    "no schema": ("DELETE FROM sqlite_master WHERE name = 'experiment'",),
    "a schema that is none": ("UPDATE sqlite_master SET sql = 'x' WHERE name = 'series'",),
}


def found(folder):
    """Troubles, or the refusal that somebody gets."""
    try:
        return Project(folder).check().troubles
    except FixelError as refused:
        return (refused,)


def test_the_whole_one_is_whole(whole):
    assert found(whole) == ()


@pytest.mark.parametrize("what", ROWS)
def test_rows_that_changed_behind_the_triggers(folder, what):
    behind(folder, ROWS[what])
    assert found(folder), what


@pytest.mark.parametrize("what", SCHEMA)
def test_a_schema_that_is_not_ours(folder, what):
    with contextlib.suppress(sqlite3.Error):  # of triggers that cannot be put back
        behind(folder, *SCHEMA[what])
    assert found(folder), what


@pytest.mark.parametrize("weaker", ["DROP TRIGGER series_kept", "DROP TRIGGER experiment_frozen"])
def test_a_trigger_less(folder, weaker):
    with contextlib.closing(sqlite3.connect(folder / "experiments.db")) as raw:
        raw.execute(weaker)
        raw.commit()
    (trouble,) = found(folder)
    assert trouble.sentence.startswith("its rows are not protected")


def test_a_trigger_that_does_nothing(folder):
    with contextlib.closing(sqlite3.connect(folder / "experiments.db")) as raw:
        raw.execute("DROP TRIGGER series_kept")
        raw.execute("CREATE TRIGGER series_kept BEFORE DELETE ON series BEGIN SELECT 1; END")
        raw.commit()
    assert found(folder)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["truncated", "zeroed", "exchanged", "noise"])
def test_pages_that_changed(folder, kind, seed):
    """Damage to pages is found, or it spoiled nothing that is stored."""
    file = folder / "experiments.db"
    data, rng = bytearray(file.read_bytes()), np.random.default_rng(seed)
    size = int.from_bytes(data[16:18], "big")
    n = len(data) // size
    here, there = (int(k) * size for k in rng.choice(np.arange(1, n), 2, replace=False))
    if kind == "truncated":
        del data[here:]
    elif kind == "zeroed":
        data[here : here + size] = bytes(size)
    elif kind == "exchanged":
        one, other = data[here : here + size], data[there : there + size]
        data[here : here + size], data[there : there + size] = other, one
    else:
        at = here + int(rng.integers(size - 64))
        data[at : at + 64] = rng.bytes(64)
    before = held(file)
    file.write_bytes(data)
    # What a simulation computed has no checksum: noise in it that leaves a path is not seen.
    assert found(folder) or held(file) == before


def held(file):
    """Rows of experiments, parameters and calibrations, read without fixel."""
    queries = (
        "SELECT * FROM series WHERE owner <> 'simulation'",
        "SELECT content_sha256, scene, conditions, name, start_x_m, end_x_m FROM experiment",
        "SELECT id, mu_pusher, others FROM system_parameters",
        "SELECT mean_error_mm2, n_member FROM calibration",
        "SELECT * FROM calibration_member",
    )
    with contextlib.closing(sqlite3.connect(file)) as raw:
        raw.text_factory = bytes
        return [raw.execute(query).fetchall() for query in queries]


@pytest.mark.parametrize(
    "value", ["n_frame = 'many'", "end_x_m = 'left'", "name = x'ff'", "conditions = '['"]
)
def test_a_spoiled_row_of_the_table_is_named(folder, value):
    behind(folder, f"UPDATE experiment SET {value} WHERE id = 4")
    with pytest.raises(StoreRefused, match="fixel db check") as refused:
        str(Project(folder).experiments())
    assert value.startswith("name") or "experiment 4 is damaged" in str(refused.value)


def test_what_is_spoiled_is_named_where_it_is_touched(folder):
    """Damaged records are refused in a sentence where they are read."""
    behind(
        folder, ROWS["no JSON"], ROWS["a byte less"], ROWS["columns"].replace("id = 7", "id = 25")
    )
    named = []
    with Project(folder).store() as store:
        for number in range(1, 32):
            try:
                store.experiment(number)
            except FixelError as refused:
                named.append(str(refused))
    assert len(named) == 3
    assert all("is damaged" in one and "fixel db check" in one for one in named)
