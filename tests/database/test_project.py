"""Projects as Python opens them: filters, results, and the same numbers as the commands."""

import json
import shutil
from dataclasses import replace
from functools import cache

import pytest
from tests.cli.shell import fixel as run
from tests.fixtures import refused

import fixel
from fixel.database import rows
from fixel.errors import NotStored, StoreRefused
from fixel.model import Flag, Trajectory

KEYS = ("example/00", "example/01", "example/02")
example = cache(fixel.datasets.example)


@pytest.fixture
def lab(tmp_path):
    made = fixel.Project.create(tmp_path / "my lab")
    pushes = list(example()[:3])
    pushes[1] = pushes[1].flagged(Flag("late", "by 0.2 s"))
    assert made.add(pushes, progress=False)[:3] == (3, 0, 1)
    return made


def test_opening_creates_nothing(tmp_path):
    for place in ("nothing here", "sqlite:///" + str(tmp_path / "nothing.db")):
        with pytest.raises(StoreRefused, match="fixel new"):
            fixel.Project(place if "://" in place else tmp_path / place)
    assert list(tmp_path.iterdir()) == []
    refused(fixel.Project, "postgresql+psycopg://somebody@nowhere/lab", match="media: found none")


def test_a_url_opens_the_same_project(lab):
    same = fixel.Project(f"sqlite:///{lab.folder / 'experiments.db'}")
    assert same.experiments(flagged=True) == lab.experiments(flagged=True)
    assert same.experiment("example/02") == lab.experiment(3)


def test_experiments_are_added_once(lab):
    assert lab.add(example()[0], progress=False)[:2] == (0, 1)
    corrected = replace(lab.experiment("00"), conditions={"surface": "felt"})
    assert lab.add(corrected, progress=False).new == 1
    assert lab.experiments("surface=felt").keys == ("example/00",)
    for wrong in (3, ["example/00"]):
        refused(lab.add, wrong, match="needs experiments, or a result")


def test_filters_are_those_of_the_command(lab, capsys):
    for words, flagged in (
        ((), False),
        (("surface=abs", "turned<0"), False),
        (("flag:late",), False),
        (("plywood duration>=3",), True),
    ):
        where = [word for one in words for word in ("--where", one)]
        more = ["--all"] if flagged else []
        code, out, _ = run(capsys, "list", *where, *more, "--project", lab.folder, "--json")
        assert code == 0
        listed = [f"{e['dataset']}/{e['name']}" for e in json.loads(out)["experiments"]]
        assert list(lab.experiments(*words, flagged=flagged).keys) == listed
    farthest = lab.experiments(flagged=True, sort="moved", descending=True, limit=1)
    moved = lab.experiments(flagged=True).to_dict()["moved"]
    assert farthest.to_dict()["moved"] == [max(moved)]
    assert lab.experiments("flagged").keys == ("example/01",)
    for text in ("surface=plywod", "surfce!=abs", "dataset:exmple"):
        refused(lab.experiments, text, match="did you mean")


def test_printing_reads_no_series(lab, monkeypatch):
    def refuse(*_):
        raise AssertionError("a series was read")

    monkeypatch.setattr(rows, "read_all", refuse)
    found = lab.experiments(flagged=True)
    assert repr(found).splitlines()[0].startswith("Experiments: 3 of dataset 'example'")
    assert "example/00" in found._repr_html_()
    assert found.where("surface=abs").split(1)[0].keys
    assert found.to_arrow().num_rows == 3
    assert "3" in repr(lab)
    with pytest.raises(AssertionError, match="a series was read"):
        found[0]


def test_stored_experiments_equal_those_added(lab):
    for own, added in zip(lab.experiments(flagged=True), example(), strict=False):
        assert own.trajectory == added.trajectory
        assert own.scene == added.scene


def test_errors_of_a_project_can_be_filtered(lab):
    for key in KEYS:
        stored = lab.experiment(key)
        record = fixel.compare(stored, progress=False).rows[0].run
        with lab.store() as store:
            store.add_simulation(record.record(store.find(key)))
    by_hand = {
        row.run.experiment.key: row.error_mm
        for row in fixel.compare(lab.experiments(flagged=True), progress=False).rows
    }
    limit = sum(sorted(by_hand.values())[1:3]) / 2.0  # between two errors
    found = lab.experiments(f"error>{limit}", flagged=True)
    assert list(found.keys) == [key for key in KEYS if by_hand[key] > limit]
    assert found.keys == lab.experiments(flagged=True).where(f"error>{limit}").keys
    assert "error [mm]" in repr(found)


def test_the_rest_is_what_commands_do(lab, tmp_path, capsys):
    assert lab.check().troubles == ()
    assert lab.backup(tmp_path / "copy.db").size > 0
    assert lab.upgrade().after == lab.check().version
    assert (dict(lab.calibrations), list(lab.analyses), list(lab.jobs)) == ({}, [], [])
    done = lab.export(tmp_path / "all.zip", progress=False)
    words = ("export", tmp_path / "again.zip", "--project", lab.folder, "--json")
    assert json.loads(run(capsys, *words)[1])["counts"] == done.counts
    assert (tmp_path / "again.zip").read_bytes() == (tmp_path / "all.zip").read_bytes()
    with pytest.raises(NotStored, match="did you mean 'example/00'"):
        lab.experiment("exmple/00")


def test_a_calibration_is_stored(lab):
    fit = lab.calibrate("surface=abs", {"mu_pusher": (0, 1)}, verdicts=False, progress=False)
    (record,) = lab.calibrations.values()
    assert record.parameters["mu_pusher"] == fit["mu_pusher"]
    assert [member.experiment_id for member in record.members] == [1, 3]
    table = fixel.compare(lab.experiments(flagged=True), fit, progress=False)
    uses = {row.run.experiment.key: row.use for row in table.of("calibrated")}
    assert uses == {KEYS[0]: "fitted", KEYS[1]: "held out", KEYS[2]: "fitted"}


def shortened(push):
    """The first half second after the tip has moved, in a tenth of the computing time."""
    track, tip = (
        Trajectory(time=own.time[:16], pose=own.pose[:16]) for own in (push.trajectory, push.pusher)
    )
    scene = replace(push.scene, duration=float(track.time[-1]))
    return replace(push, trajectory=track, pusher=tip, scene=scene)


def test_a_map_is_stored_with_its_evidence(tmp_path, monkeypatch):
    monkeypatch.setattr("fixel.workflows.domain.report._pictures", lambda *_: [])  # slow
    lab = fixel.Project.create(tmp_path / "lab")
    lab.add([shortened(push) for push in example().where("surface=abs")[:6]], progress=False)
    lab.calibrate("", {"mu_pusher": (0, 1)}, verdicts=False, progress=False)
    options = {"axes": ["contact_offset_m"], "threshold": 1e-3, "folds": 2}
    found = lab.map_domain("surface=abs", **options, progress=False)
    (kept,) = lab.analyses
    assert kept.arrays["error_mm2"].tolist() == found.evidence.error_mm2.tolist()


def test_sequences_load_from_the_project_that_is_there_now(tmp_path, monkeypatch):
    """Projects of one relative name in two folders, and one that replaces another."""
    one, other = example()[:2]
    chosen = []
    for name, push in (("a", one), ("b", other)):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        fixel.Project.create("lab").add(push, progress=False)
        chosen.append(fixel.Project("lab").experiments())
        assert chosen[-1][0].key == push.key
    monkeypatch.chdir(tmp_path)
    assert [found[0].key for found in chosen] == [one.key, other.key]
    shutil.rmtree(tmp_path / "b" / "lab")
    fixel.Project.create("b/lab").add(one, progress=False)
    assert fixel.Project("b/lab").experiments()[0].key == one.key


@pytest.mark.parametrize("name", ["what?", "50%20x", "x?uri=true"])
def test_the_database_is_in_the_folder_of_any_name(name, tmp_path):
    fixel.Project.create(tmp_path / name).add(example()[0], progress=False)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name / "experiments.db").is_file()
    assert fixel.Project(tmp_path / name).experiments()[0].key == "example/00"


def test_a_name_that_two_experiments_have_is_refused_with_their_ids(lab):
    """An undo can restore an experiment after another one has taken its name."""
    with lab.store() as store:
        store.delete([1])
        lab.add(replace(example()[0], conditions={"surface": "felt"}), progress=False)
        store.delete([1], back=True)
    with pytest.raises(NotStored, match="write one of id:1, id:4"):
        lab.experiment("00")
    assert lab.experiment("id:4").conditions == {"surface": "felt"}


def test_a_number_beyond_those_of_ids_is_refused(lab):
    refused(lab.experiment, "9" * 30, match="too large for")
