"""Bundles lose nothing on the way, and nothing in them is believed unseen."""

import hashlib
import math
import shutil
import stat
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from tests.database.records import HERE, experiment, path
from tests.database.triggers import without_triggers

from fixel.database import rows
from fixel.database.bundle import export_bundle, import_bundle
from fixel.database.bundle_file import LIMITS
from fixel.database.query import ALL_EXPERIMENTS
from fixel.database.store import Store
from fixel.errors import InvalidInput, StoreRefused
from fixel.model import Channel, Flag, Parameters
from fixel.model.records import (
    CalibrationRecord,
    Estimate,
    Evaluations,
    FilterParameters,
    FilterRecord,
    Member,
    SimulationRecord,
)
from fixel.model.selection import ExperimentQuery

NOTHING_NEW = {
    "analyses": 0,
    "experiments": 0,
    "parameters": 0,
    "simulations": 0,
    "calibrations": 0,
    "filter_parameters": 0,
    "filter_runs": 0,
    "flags": 0,
    "outdated": 0,
    "replaced": 0,
}


def fill(store):
    """A bit of everything there can be."""
    video = rows.keep(b"film" * 1000, store.media)
    a = store.add_experiment(experiment(flags=[Flag("late", "by 2 s")], video=video)).id
    store.add_experiment(experiment("fixed"))
    b = store.add_experiment(experiment("fixed", contact_mode="110")).id
    bare = experiment(
        "Ünïcode", dataset="sim", real=False, simulated_by="me", scene=None, pusher=None,
        channels=(), conditions={}, effective=None, height=None, contact_mode="",
    )  # fmt: skip
    c = store.add_experiment(bare).id
    long = store.add_experiment(experiment("long", trajectory=path(40_000))).id
    store.flag([b], Flag("by-hand", "odd"))
    store.unflag([a], "late")
    store.flag([a], Flag("late", "by 3 s", fault=False))
    gone = store.add_experiment(experiment("gone")).id
    store.delete([gone])
    p = Parameters(mu_support=0.3, tripod_radius=0.02)
    for number in (a, long):
        store.add_simulation(
            SimulationRecord(
                experiment_id=number, parameters=p, provenance=HERE, trajectory=path(4),
                pusher=path(3), method={"step": 0.01, "n": 3}, error_mm2=math.inf,
            )
        )  # fmt: skip
    tried = Evaluations(
        names=("mu_support",), values=[[0.1], [0.3]], error=[math.inf, 2.0], reasons=("x", "")
    )
    for members in ((Member(a, 1.0, 2.0), Member(c, 0.5, 3.0)), (Member(gone, 1.0, 2.0),)):
        store.add_calibration(
            CalibrationRecord(
                name="best",
                parameters=p,
                members=members,
                provenance=HERE,
                evaluations=tried,
                estimates=(Estimate(label="mu_support", unit="-", value=0.3, low=0.2),),
            )
        )
    f = store.add_filter_parameters(
        FilterParameters(name="pf", is_particle_filter=True, provenance=HERE, values={"n": 100})
    )
    store.add_filter_run(
        FilterRecord(
            experiment_id=a, filter_parameters_id=f, provenance=HERE, trajectory=path(),
            uses_tactile=True, occlusion=(0.2, 0.4), estimate_names=("mu",),
            estimates=np.ones((5, 1)),
        )
    )  # fmt: skip


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A small bundle, made once; not to be changed."""
    folder = tmp_path_factory.mktemp("exported")
    with Store(f"sqlite:///{folder}/one.db", folder / "one") as one:
        one.upgrade()
        one.add_experiment(experiment())
        export_bundle(one, folder / "one.zip")
    return folder / "one.zip"


@pytest.fixture
def bundle(exported, tmp_path):
    """A copy of the small bundle, and an empty store of its own."""
    shutil.copy(exported, tmp_path / "one.zip")
    with Store(f"sqlite:///{tmp_path}/two.db", tmp_path / "two") as two:
        two.upgrade()
        yield tmp_path / "one.zip", two


def members_of(path):
    with zipfile.ZipFile(path) as archive:
        return {info.filename: archive.read(info) for info in archive.infolist()}


def write(path, members, packing=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", packing) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def edited(path, *statements):
    """Return the members of a bundle after statements on its database."""
    members = members_of(path)
    file = path.with_name("edited.db")
    file.write_bytes(members["experiments.db"])
    with without_triggers(file) as raw:
        for statement in statements:
            raw.execute(statement)
    return members | {"experiments.db": file.read_bytes()}


def refused(path, store, words, **more):
    with pytest.raises(InvalidInput, match=words):
        import_bundle(path, store, **more)
    assert store.experiments(ALL_EXPERIMENTS).total == 0


def test_round_trip_loses_nothing(store, tmp_path):
    fill(store)
    exported, left_out = export_bundle(store, tmp_path / "a.zip")
    assert exported == {
        "experiments": 5, "parameters": 1, "simulations": 2, "calibrations": 1,
        "filter_parameters": 1, "filter_runs": 1, "analyses": 0, "flagged": 1, "replaced": 1,
    }  # fmt: skip
    assert left_out == {"calibrations": 1, "deleted": 1}
    with Store(f"sqlite:///{tmp_path}/other.db", tmp_path / "other") as other:
        other.upgrade()
        other.add_experiment(experiment("in the way"))  # so that ids differ
        counts = import_bundle(tmp_path / "a.zip", other)
        assert counts["experiments"] == 5
        assert (counts["simulations"], counts["filter_runs"]) == (2, 1)
        theirs = [s.id for s in other.experiments(ALL_EXPERIMENTS).rows][1:]
        ours = [s.id for s in store.experiments(ALL_EXPERIMENTS).rows]
        assert theirs != ours
        for a, b in zip(ours, theirs, strict=True):
            assert store.experiment(a) == other.experiment(b)
            one, two = store.simulations(a), other.simulations(b)
            for k, m in zip(one, two, strict=True):
                assert replace(store.simulation(k), experiment_id=b) == other.simulation(m)
        assert store.flags() == other.flags()
        assert other.experiments(ExperimentQuery(marks=("simulated",))).total == 1
        assert store.calibration(1).evaluations == other.calibration(1).evaluations
        assert [m.experiment_id for m in other.calibration(1).members] == [theirs[0], theirs[3]]
        video = other.experiment(theirs[0]).video
        assert rows.fetch(video, other.media) == b"film" * 1000


def test_both_ways_give_the_same_bytes(store, tmp_path):
    with Store(f"sqlite:///{tmp_path}/first.db", tmp_path / "first") as first:
        first.upgrade()
        fill(first)
        export_bundle(first, tmp_path / "a.zip")
    import_bundle(tmp_path / "a.zip", store)
    export_bundle(store, tmp_path / "b.zip")
    a, b = members_of(tmp_path / "a.zip"), members_of(tmp_path / "b.zip")
    assert a.keys() == b.keys()
    assert [name for name in a if a[name] != b[name]] == []
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_again_adds_nothing(store, tmp_path):
    fill(store)
    export_bundle(store, tmp_path / "a.zip")
    assert import_bundle(tmp_path / "a.zip", store) == NOTHING_NEW | {"known": 5}


def test_one_dataset_takes_along_what_is_its_own(store, tmp_path):
    fill(store)
    exported, left_out = export_bundle(store, tmp_path / "a.zip", dataset="sim")
    assert (exported["experiments"], exported["filter_parameters"]) == (1, 0)
    assert left_out["calibrations"] == 1


def test_what_is_newer_here_stays_on_top(store, tmp_path):
    newer = experiment(contact_mode="110")
    with Store(f"sqlite:///{tmp_path}/o.db", tmp_path / "o") as other:
        other.upgrade()
        for each in (experiment(), newer):
            other.add_experiment(each)
        export_bundle(other, tmp_path / "a.zip")
    here = store.add_experiment(newer).id
    counts = import_bundle(tmp_path / "a.zip", store)
    assert (counts["known"], counts["outdated"]) == (1, 1)
    assert [s.id for s in store.experiments().rows] == [here]


def test_experiments_of_the_same_name_that_are_replaced_are_counted(store, tmp_path):
    """Two versions of one experiment in the bundle replace the one of the project once."""
    with Store(f"sqlite:///{tmp_path}/o.db", tmp_path / "o") as other:
        other.upgrade()
        for each in (experiment(contact_mode="010"), experiment(contact_mode="110"),
                     experiment("another")):  # fmt: skip
            other.add_experiment(each)
        export_bundle(other, tmp_path / "a.zip")
    store.add_experiment(experiment())
    assert import_bundle(tmp_path / "a.zip", store)["replaced"] == 1
    assert import_bundle(tmp_path / "a.zip", store) == NOTHING_NEW | {"known": 3}


def test_notes_come_along_once_and_stay_deleted(store, tmp_path):
    number = store.add_experiment(experiment()).id
    store.annotate([number], "slipped early")
    store.delete_notes(store.annotate([number], "wrong"))
    file = tmp_path / "with-notes.zip"
    export_bundle(store, file)
    with Store(f"sqlite:///{tmp_path / 'other.db'}", tmp_path / "other-media") as other:
        other.upgrade()
        for _ in range(2):
            import_bundle(file, other)
            assert [note.text for note in other.notes(1)] == ["slipped early"]
        assert other.notes(1)[0].created == store.notes(number)[0].created
        other.delete_notes([1])
        import_bundle(file, other)
        assert other.notes(1) == []


def test_a_flag_found_elsewhere_comes_along_once(store, tmp_path):
    with Store(f"sqlite:///{tmp_path}/o.db", tmp_path / "o") as other:
        other.upgrade()
        other.flag([other.add_experiment(experiment()).id], Flag("late"))
        export_bundle(other, tmp_path / "a.zip")
    store.add_experiment(experiment())
    assert import_bundle(tmp_path / "a.zip", store)["flags"] == 1
    assert import_bundle(tmp_path / "a.zip", store)["flags"] == 0
    assert store.flags() == {"late": 1}


def test_interrupted_it_goes_on_where_it_was(store, tmp_path):
    fill(store)
    export_bundle(store, tmp_path / "a.zip")

    def stop(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with Store(f"sqlite:///{tmp_path}/o.db", tmp_path / "o") as other:
        other.upgrade()
        with pytest.raises(KeyboardInterrupt):
            import_bundle(tmp_path / "a.zip", other, progress=stop)
        assert other.experiments(ALL_EXPERIMENTS).total == 2
        counts = import_bundle(tmp_path / "a.zip", other)
        assert (counts["known"], counts["experiments"], counts["simulations"]) == (2, 3, 2)


def test_a_lost_video_leaves_no_file(store, tmp_path):
    store.add_experiment(experiment(video="0" * 64))
    with pytest.raises(StoreRefused, match="is missing"):
        export_bundle(store, tmp_path / "a.zip")
    assert not list(tmp_path.glob("*.zip"))


def test_numbers_that_pack_too_well_are_stored(store, tmp_path):
    time = np.arange(200_000.0)
    still = Channel(name="f", time=0.0 * time, columns=("f_n",), values=0.0 * time[:, None])
    store.add_experiment(experiment(channels=(still,)))
    export_bundle(store, tmp_path / "a.zip")
    assert import_bundle(tmp_path / "a.zip", store)["known"] == 1


@pytest.mark.parametrize("name", [
    "../evil",
    "/etc/passwd",
    "C:\\evil",
    "media/../../x",
    "setup.py",
    f"media/00/{'1' * 64}",
    "x/",
])  # fmt: skip
def test_names_that_are_no_members(bundle, name):
    path, store = bundle
    write(path, members_of(path) | {name: b"x"})
    refused(path, store, "only members of a bundle")


def test_a_link(bundle):
    path, store = bundle
    members, name = members_of(path), "experiments.db"
    with zipfile.ZipFile(path, "w") as archive:
        for each, data in members.items():
            info = zipfile.ZipInfo(each)
            if each == name:
                info.external_attr = (stat.S_IFLNK | 0o777) << 16
            archive.writestr(info, data)
    refused(path, store, "link")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_member_twice(bundle):
    path, store = bundle
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("experiments.db", b"")
    refused(path, store, "a repeated member")


def test_bombs(bundle):
    path, store = bundle
    members = members_of(path)
    refused(path, store, "larger content", limits=LIMITS._replace(total=1000))
    refused(path, store, "members", limits=LIMITS._replace(members=0))
    refused(path, store, "fit in memory", limits=LIMITS._replace(in_memory=100))
    zeros = bytes(5_000_000)
    digest = hashlib.sha256(zeros).hexdigest()
    write(path, members | {f"media/{digest[:2]}/{digest}": zeros})
    refused(path, store, "compressed to less than")


def test_a_size_that_lies(bundle):
    path, store = bundle
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        size = archive.getinfo("experiments.db").file_size
    at = data.rindex(b"experiments.db") - 46 + 24  # of the central directory
    assert int.from_bytes(data[at : at + 4], "little") == size
    data[at : at + 4] = (size // 2).to_bytes(4, "little")
    path.write_bytes(data)
    refused(path, store, "damaged|changed|than its header states")


def test_damage(bundle):
    path, store = bundle
    whole = path.read_bytes()
    members = members_of(path)
    for keep in (0, 100, len(whole) // 2, len(whole) - 5):
        path.write_bytes(whole[:keep])
        refused(path, store, "found")
    path.write_bytes(whole[:200] + bytes([whole[200] ^ 1]) + whole[201:])
    refused(path, store, "damaged|changed")
    write(path, {n: d for n, d in members.items() if n != "experiments.db"})
    refused(path, store, "no experiments.db|no central directory|found")
    write(path, members | {f"media/00/{'0' * 64}": b"x"})
    refused(path, store, "changed")
    pages = bytearray(members["experiments.db"])
    pages[4096 * 3 : 4096 * 6] = bytes(4096 * 3)
    write(path, members | {"experiments.db": bytes(pages)})
    refused(path, store, "found")
    write(path, members | {"experiments.db": b"no database" * 1000})
    refused(path, store, "not a SQLite database")
    write(path, {"a": b""})
    refused(path, store, "only members")
    path.unlink()
    refused(path, store, "no such file")


def test_another_version(bundle):
    path, store = bundle
    write(path, edited(path, "UPDATE alembic_version SET version_num = '9999'"))
    refused(path, store, "schema 9999.*newer")
    write(path, {"manifest.json": b"{}", "experiments.jsonl": b""})
    refused(path, store, "before the first release.*export it again")


@pytest.mark.parametrize("change", [
    "DELETE FROM series",
    "UPDATE series SET n_row = n_row + 1",
    "UPDATE series SET columns = '[1]'",
    "UPDATE series SET media_sha256 = '../../x', data = NULL",
    f"UPDATE series SET media_sha256 = '{'0' * 64}', data = NULL",
    "UPDATE experiment SET is_real = 0",
    "UPDATE experiment SET is_real = 7",
    "UPDATE experiment SET contact_mode = 'x'",
    """UPDATE experiment SET scene = '{"bodies": []}'""",
    """UPDATE experiment SET conditions = '{"a": [1]}'""",
    f"UPDATE experiment SET conditions = '{'[' * 100_000}'",
    f"UPDATE experiment SET seed = {2**70}",
    "UPDATE experiment SET video_sha256 = '../../x'",
    f"UPDATE experiment SET video_sha256 = '{'0' * 64}'",
    "UPDATE experiment SET name = ''",
    f"UPDATE experiment SET name = '{'x' * 500}'",
    "UPDATE experiment SET duration_s = 'long'",
    "UPDATE experiment SET effective_start_s = 2.0",
    "ALTER TABLE experiment ADD COLUMN n TEXT",
    "ALTER TABLE experiment DROP COLUMN n_frame",
    "ALTER TABLE experiment ADD COLUMN n AS (1)",
    "DROP TABLE filter_run",
    "CREATE VIEW evil AS SELECT 1",
    "CREATE VIRTUAL TABLE evil USING fts5(a)",
    "CREATE INDEX evil ON flag (hex(zeroblob(400000000)))",
    "CREATE INDEX evil ON flag (name) WHERE detail LIKE '%a%a%a%a%b'",
    """UPDATE experiment SET conditions = '{"a": NaN}'""",
    "INSERT INTO flag VALUES (1, 1, 'Not a name', '', 0, '2026', NULL)",
    "INSERT INTO flag VALUES (1, 7, 'late', '', 0, '2026', NULL)",
])  # fmt: skip
def test_records_that_cannot_be(bundle, change):
    path, store = bundle
    write(path, edited(path, "PRAGMA foreign_keys = OFF", change))
    refused(path, store, "found")
    assert list(path.parent.glob(".bundle-*")) == []


def test_checks_of_a_bundle_are_not_evaluated(bundle):
    path, store = bundle
    table = "UPDATE sqlite_master SET sql = replace(sql, 'CONSTRAINT pk_note', "
    check = "'CONSTRAINT evil CHECK (length(hex(zeroblob(400000000))) > 0), CONSTRAINT pk_note') "
    where = "WHERE name = 'note'"
    write(path, edited(path, "PRAGMA writable_schema = ON", table + check + where))
    refused(path, store, "the table 'note', which no project has")


def test_long_texts_are_rejected_before_they_are_read(bundle):
    path, store = bundle
    small = LIMITS._replace(text=1000)
    write(path, edited(path, f'UPDATE experiment SET conditions = \'{{"a": "{"x" * 2000}"}}\''))
    refused(path, store, "a value of experiment.conditions", limits=small)


def test_triggers_of_a_bundle_do_nothing(bundle):
    path, store = bundle
    trigger = "CREATE TRIGGER evil AFTER INSERT ON experiment BEGIN DELETE FROM flag; END"
    write(path, edited(path, trigger))
    assert import_bundle(path, store)["experiments"] == 1
