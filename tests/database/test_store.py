"""Promises of `Store` on both engines."""

import dataclasses
import math
import multiprocessing
import os
import time

import pytest
import sqlalchemy as sa
from tests.database.records import HERE, experiment, path, simulation
from tests.fixtures import calibration_record, refused

from fixel.database import schema
from fixel.database.store import Store
from fixel.errors import NotStored, StoreRefused
from fixel.model import Experiment, Flag, Parameters, Provenance, records
from fixel.model.selection import Bound, ExperimentQuery


def stored(store, *experiments):
    return [store.add_experiment(each).id for each in experiments]


def same_but_for_time(a, b):
    created = dataclasses.replace(a.provenance, created=b.provenance.created)
    return dataclasses.replace(a, provenance=created) == b


def test_round_trip_of_everything(store):
    given = experiment(flags=[Flag("late", "by 2 s")])
    (number,) = stored(store, given)
    found = store.experiment(number)
    assert same_but_for_time(given, found)
    assert found.provenance.created
    assert found.trajectory.time.tobytes() == given.trajectory.time.tobytes()


def test_least_there_can_be(store):
    bare = Experiment(
        dataset="x", name="0", real=False, simulated_by="me", provenance=HERE, trajectory=path(1)
    )
    assert same_but_for_time(bare, store.experiment(stored(store, bare)[0]))


def test_the_same_again_adds_nothing(store):
    first = store.add_experiment(experiment())
    again = store.add_experiment(experiment(provenance=Provenance(version="9")))
    assert first.new
    assert not again.new
    assert again.id == first.id
    assert store.experiments().total == 1


def test_a_correction_takes_the_place(store):
    old, new = stored(store, experiment(), experiment(contact_mode="110"))
    assert (store.replacement(old), store.replacement(new)) == (new, None)
    assert [s.id for s in store.experiments().rows] == [new]
    assert store.experiments(ExperimentQuery(marks=("replaced",))).total == 2
    assert store.experiment(old).contact_mode == "010"
    store.delete([new])
    assert store.replacement(old) is None
    assert [s.id for s in store.experiments().rows] == [old]


def test_flagged_rows_are_left_out_and_counted(store):
    good, bad = stored(store, experiment("1"), experiment("2", flags=[Flag("misregistered")]))
    listing = store.experiments()
    assert [s.id for s in listing.rows] == [good]
    assert (listing.total, listing.left_out) == (1, 1)
    assert store.experiments(ExperimentQuery(include_faulty=True)).total == 2
    assert store.experiment_ids(ExperimentQuery(flags=("misregistered",))) == [bad]
    assert store.flags() == {"misregistered": 1}
    store.unflag([bad], "misregistered")
    assert store.experiments().total == 2
    store.flag([good], Flag("by-hand", "looked odd"))
    assert [s.id for s in store.experiments().rows] == [bad]
    assert store.experiment(good).flags == (Flag("by-hand", "looked odd"),)


def test_deletion_is_soft(store):
    (number,) = stored(store, experiment())
    store.delete([number])
    assert store.experiments().total == 0
    assert store.experiments(ExperimentQuery(marks=("deleted",))).total == 1
    store.delete([number], back=True)
    assert store.experiments().total == 1


FILTERS = [
    (ExperimentQuery(dataset="lab"), ["a_1", "b%2"]),
    (ExperimentQuery(name="a*"), ["a_1"]),
    (ExperimentQuery(name="a_*"), ["a_1"]),
    (ExperimentQuery(name="axx*"), []),
    (ExperimentQuery(name="*%2"), ["b%2"]),
    (ExperimentQuery(marks=("simulated",)), ["c"]),
    (ExperimentQuery(bounds=(Bound("contacts", "=", "110"),)), ["b%2"]),
    (ExperimentQuery(bounds=(Bound("surface", "=", "abs"),)), ["b%2"]),
    (ExperimentQuery(bounds=(Bound("speed_m_s", "=", 0.02),)), ["a_1", "c"]),
    (ExperimentQuery(bounds=(Bound("speed_m_s", "=", 0.02),), marks=("real",)), ["a_1"]),
]


def test_filters(store):
    stored(
        store,
        experiment("a_1"),
        experiment("b%2", contact_mode="110", conditions={"surface": "abs", "speed_m_s": 0.01}),
        experiment("c", dataset="bench", real=False, simulated_by="me"),
    )
    for query, names in FILTERS:
        assert [s.name for s in store.experiments(query).rows] == names, query


def test_pages(store):
    ids = stored(store, *(experiment(str(k)) for k in range(5)))
    page = store.experiments(ExperimentQuery(limit=2, offset=2))
    assert [s.id for s in page.rows] == ids[2:4]
    assert page.total == 5
    assert store.datasets() == {"lab": 5}


def test_found_by_id_and_name(store):
    one, two = stored(store, experiment("one"), experiment("two", dataset="bench"))
    assert store.find(str(one)) == one
    assert store.find("two") == two
    assert store.find("lab/one") == one
    stored(store, experiment("two"))
    with pytest.raises(NotStored, match="2 have that name"):
        store.find("two")
    refused(store.find, str(10**30), match="too large for")
    with pytest.raises(NotStored, match="fixel list"):
        store.find("lab/three")
    with pytest.raises(NotStored, match="experiment 99"):
        store.experiment(99)


def test_finished_records_cannot_change(store, url):
    (number,) = stored(store, experiment(flags=[Flag("late")]))
    engine = sa.create_engine(url)
    for statement in (
        sa.update(schema.experiment).values(contact_mode="111"),
        sa.update(schema.series).values(n_row=1),
        sa.update(schema.flag).values(detail="no"),
        sa.delete(schema.series),
        sa.delete(schema.experiment),
    ):
        with (
            engine.connect() as connection,
            pytest.raises(sa.exc.DBAPIError, match="cannot change"),
        ):
            connection.execute(statement)
    engine.dispose()
    assert store.experiment(number).contact_mode == "010"


def test_long_series_are_files_named_by_content(store, tmp_path):
    long = experiment(trajectory=path(50_000), scene=None, contact_mode="", object_name="object")
    (number,) = stored(store, long)
    files = [p for p in (tmp_path / "media").rglob("*") if p.is_file()]
    assert len(files) == 1
    assert store.experiment(number).trajectory == long.trajectory
    files[0].write_bytes(b"something else")
    with pytest.raises(StoreRefused, match="has changed"):
        store.experiment(number)
    files[0].unlink()
    with pytest.raises(StoreRefused, match="is missing"):
        store.experiment(number)


def test_videos_are_kept_by_content(store, tmp_path):
    film = tmp_path / "run.mkv"
    film.write_bytes(b"frames")
    name = store.add_video(film)
    assert store.add_video(film) == name
    with_film, without = stored(store, experiment("1", video=name), experiment("2"))
    assert store.video(with_film).read_bytes() == b"frames"
    assert store.video(without) is None
    refused(store.add_video, tmp_path / "none.mkv", match="a file to read")


def test_what_killed_programs_left_unfinished_is_removed_after_a_day(store, tmp_path):
    film = tmp_path / "run.mkv"
    film.write_bytes(b"frames")
    folder = store.media / "ab"
    folder.mkdir(parents=True)
    whole, old, new = (folder / name for name in ("ab" * 32, ".left.1", ".left.2"))
    for file, days in (whole, 9.0), (old, 1.1), (new, 0.9):
        file.write_bytes(b"part")
        os.utime(file, (time.time() - 86400.0 * days,) * 2)
    store.add_video(film)
    assert sorted(folder.iterdir()) == [new, whole]


def test_simulations_calibrations_and_filters(store):
    one, two = stored(store, experiment("1"), experiment("2"))
    simulation = records.SimulationRecord(
        experiment_id=one,
        parameters=Parameters(mu_support=0.3, tripod_radius=0.04),
        provenance=HERE,
        trajectory=path(3),
        pusher=path(4),
        method={"motion": "dynamic", "step_s": 0.01},
        status="jammed",
        contact_mode="111",
        error_mm2=2.5,
    )
    number = store.add_simulation(simulation)
    assert same_but_for_time(simulation, store.simulation(number))
    assert store.simulations(one) == [number]

    tried = records.Evaluations(
        names=("mu_support", "tripod_radius"),
        values=[[0.3, 0.04], [0.2, 0.05]],
        error=[1.0, math.inf],
        unit="mm",
        reasons=("", "jammed at 2 s"),
    )
    calibration = records.CalibrationRecord(
        name="both",
        parameters=simulation.parameters,
        members=(records.Member(one, 1.0, 3.0), records.Member(two, 0.5, 1.0)),
        provenance=HERE,
        method={"optimiser": "pattern-search"},
        evaluations=tried,
        estimates=(
            records.Estimate(label="mu_support", unit="-", value=0.3, verdict="not identified"),
            records.Estimate(label="tripod_radius", unit="m", value=0.04, low=0.03, high=0.05),
        ),
    )
    number = store.add_calibration(calibration)
    assert store.calibrations() == [number]
    found = store.calibration(number)
    assert same_but_for_time(calibration, found)
    summaries = store.calibration_summaries()
    assert list(summaries) == [number]
    assert same_but_for_time(dataclasses.replace(calibration, evaluations=None), summaries[number])
    assert (found.mean_error_mm2, found.sum_error_mm2, found.max_error_mm2) == (2.0, 4.0, 3.0)

    settings = records.FilterParameters(
        name="p", is_particle_filter=True, provenance=HERE, values={"particles": 500.0}
    )
    settings_id = store.add_filter_parameters(settings)
    assert same_but_for_time(settings, store.filter_parameters(settings_id))
    run = records.FilterRecord(
        experiment_id=one,
        filter_parameters_id=settings_id,
        provenance=HERE,
        trajectory=path(3),
        uses_tactile=True,
        occlusion=(0.2, 0.4),
        estimate_names=("mu_support",),
        estimates=[[0.1], [0.2], [0.3]],
    )
    assert same_but_for_time(run, store.filter_run(store.add_filter_run(run)))


def add_results(place):
    """Add simulations, filter runs and calibrations; return their ids."""
    with Store(*place) as store:
        settings = records.FilterParameters(name="f", is_particle_filter=True, provenance=HERE)
        run = records.FilterRecord(
            experiment_id=1, filter_parameters_id=store.add_filter_parameters(settings),
            provenance=HERE, trajectory=path(), uses_tactile=True,
        )  # fmt: skip
        made = [calibration_record({1: k}, {"mu_pusher": 0.1 * k}) for k in range(1, 6)]
        return [
            [store.add_simulation(simulation(1, float(k))) for k in range(20)],
            [
                store.add_filter_run(dataclasses.replace(run, contact_mode=str(k % 3)))
                for k in range(6)
            ],
            store.add_calibrations(made, lambda own: own.members),
        ]


def test_two_processes_store_results_once(store, url):
    stored(store, experiment())
    alone = multiprocessing.get_context("spawn")
    place = url, store.media
    with alone.Pool(2, alone.Barrier(2).wait) as both:
        first, second = both.map(add_results, [place, place], chunksize=1)
    assert first == second == add_results(place)
    simulations, runs, calibrations = first
    assert simulations == store.simulations(1) == list(range(1, 21))
    assert (runs, calibrations) == ([1, 2, 3] * 2, [1, 2, 3, 4, 5])
    assert (store._ids(schema.filter_parameters), store.calibrations()) == ([1], calibrations)


def test_a_failure_half_way_leaves_nothing(store, monkeypatch):
    def fail(*_):
        raise RuntimeError("power cut")

    monkeypatch.setattr("fixel.database.marks.flag_row", fail)
    with pytest.raises(RuntimeError):
        store.add_experiment(experiment(flags=[Flag("late")]))
    monkeypatch.undo()
    assert store.experiments(ExperimentQuery(include_faulty=True)).total == 0
    assert store.add_experiment(experiment(flags=[Flag("late")])).new


def test_two_stores_see_each_other(store, url, tmp_path):
    with Store(url, tmp_path / "media") as other:
        (number,) = stored(other, experiment())
        assert store.experiment(number).name == "1"
        assert not store.add_experiment(experiment()).new
