"""Comparison of engines on made-up pushes of known parameters, and on real ones."""

from dataclasses import replace

import numpy as np
import pytest
from reproductions import engines
from reproductions.run import reproduce
from reproductions.tripod_pushes import TripodPush
from tests.reproductions.test_cmu_tripod import MU, scene
from tests.reproductions.test_mit_push import made_up

from fixel.calibration.target import Target
from fixel.datasets.mit_push import read_mit_pushes
from fixel.errors import DatasetMissing
from fixel.model import SupportPoints, UniformPressure
from fixel.simulation.rollouts import RolloutCase, ensemble_of

TWO = {
    "fixel": engines.SETTINGS["fixel"],
    "pymunk": engines.SETTINGS["pymunk"]._replace(motion="pymunk:step=0.02"),
}


@pytest.mark.system
def test_engines_are_compared_and_a_second_run_simulates_nothing(tmp_path, monkeypatch):
    pytest.importorskip("pymunk")
    monkeypatch.setattr(engines, "SETTINGS", TWO | {"Drake": engines.SETTINGS["Drake"]})
    monkeypatch.setattr(engines, "QUICK", 8)
    monkeypatch.setattr(engines, "RESAMPLES", 200)
    data = read_mit_pushes(made_up(tmp_path / "mit_push_endpoints", 40))

    answer = reproduce("engines", tmp_path, out=tmp_path / "out", quick=True)

    rows = {(row["engine"], row["condition"]): row for row in answer.tables["overall"]}
    assert [name for name, _ in rows] == [engines.STILL, *2 * ["fixel"], *3 * ["pymunk"]]
    assert all(row["failures"] == 0 and row["held_out"] == 16 for row in rows.values())
    moved = 1e3 * np.hypot(*(data.end - data.start)[:, :2].T)
    assert rows[engines.STILL, ""]["mean_mm"] == pytest.approx(moved.mean(), rel=0.2)
    shipped, calibrated = rows["fixel", engines.SHIPPED], rows["fixel", engines.CALIBRATED]
    assert calibrated["mean_mm"] < 0.6 * shipped["mean_mm"]
    assert calibrated["more_mm"] == 0.0
    other = rows["pymunk", engines.CALIBRATED]
    assert other["mean_mm"] < rows["pymunk", engines.SHIPPED]["mean_mm"]
    assert other["more_mm"] == pytest.approx(other["mean_mm"] - calibrated["mean_mm"])
    assert other["more_mm_95"][0] <= other["more_mm"] <= other["more_mm_95"][1]
    assert sum(row["held_out"] for row in answer.tables["groups"]) == 16 * len(rows)

    monkeypatch.setattr(engines, "ensemble_of", None)
    again = reproduce("engines", tmp_path, out=tmp_path / "out", quick=True)
    assert again.tables == answer.tables


def test_a_push_that_an_engine_cannot_finish_counts_as_one_that_did_not_move(tmp_path):
    cases = engines.mit_cases(made_up(tmp_path, 30), quick=True)
    engine = engines._Engine(cases, engines.SETTINGS["fixel"])
    some = cases.members[0].held_out

    def simulate(which, values):
        good = np.arange(len(which)) > 0
        return engines.Ends(
            np.full((len(which), 3), np.nan) + np.where(good, 1.0, 0.0)[:, None], good
        )

    engine.simulate = simulate
    found = engine.ends(some, {})

    assert found.pose[0].tolist() == cases.start[some[0]].tolist()
    assert found.good.tolist() == [False, *[True] * (len(some) - 1)]


def tripod_pushes():
    """Pushes of a block on two surfaces, each on three points and on its face."""
    made = []
    for surface, mu in MU.items():
        for support in ("3pts3", "patch"):
            for k, place in enumerate((-0.95, -0.4, 0.1, 0.4, 0.95)):
                block = scene(place, 0.3 * (-1) ** k, mu)
                case = RolloutCase(block, np.array([block.duration]))
                end = ensemble_of([case]).simulate(np.zeros(1, int), {}).pose[0]
                if support == "patch":
                    body = replace(block.bodies[0], support=UniformPressure(friction=mu))
                    case = RolloutCase(replace(block, bodies=(body,)), case.times)
                conditions = {"surface": surface, "support": support}
                target = Target(f"{surface}/{support}/{k}", conditions, case, end)
                made.append(TripodPush(target, np.zeros((1, 2))))
    return made


def test_training_pushes_of_cmu_share_neither_surface_nor_support_with_held_out_ones(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(engines, "read_pushes", lambda folder: tripod_pushes())
    monkeypatch.setattr(engines, "SETTINGS", {"fixel": engines.SETTINGS["fixel"]})
    monkeypatch.setattr(engines, "RESAMPLES", 200)
    cases = engines.cmu_cases(tmp_path, quick=False)

    def groups(places):
        found = [cases.cases[k].scene.bodies[0].support for k in places.tolist()]
        assert all(isinstance(own, SupportPoints) for own in found)
        return {(own.friction, len(own.points) == 3) for own in found}

    assert len(cases.members) == 4
    for member in cases.members:
        own = (MU[member.key[0]], member.key[1] == "3pts3")
        other = (next(mu for mu in MU.values() if mu != own[0]), not own[1])
        assert groups(member.held_out) == {own}
        assert groups(member.train) == {other}
        assert (len(member.train), len(member.held_out)) == (3, 2)

    (tmp_path / "cmu_tripod_push").mkdir()
    answer = reproduce("engines", tmp_path)
    still, shipped, calibrated = answer.tables["overall"]
    assert shipped["data"] == "CMU"
    assert calibrated["held_out"] == 8
    exact = [row for row in answer.tables["groups"] if row["shape"] == "3pts3"]
    errors = [row["mean_mm"] for row in exact if row["condition"] == engines.SHIPPED]
    assert max(errors) < 0.01 < still["mean_mm"]
    with pytest.raises(DatasetMissing, match="cmu_tripod_push"):
        reproduce("engines", tmp_path / "elsewhere")


def test_own_parameters_start_as_shipped():
    setting = engines.Setting("mujoco:step=0.004", ("timeconst", "impratio"))
    timeconst, impratio = engines.own_beliefs(setting)
    assert (timeconst.name, impratio.name) == ("mujoco.timeconst", "mujoco.impratio")
    assert np.exp([timeconst.mean, impratio.mean]) == pytest.approx([0.02, 1.0])
    assert np.exp([impratio.low, impratio.high]) == pytest.approx([1.0, 100.0])


def test_the_interval_of_a_difference_is_that_of_groups():
    group = np.repeat([0, 1, 2, 3], 50)
    more = np.array([0.0, 0.0, 1.0, 1.0])[group]
    mean, low, high = engines._difference(more, group)
    assert mean == 0.5
    # Four groups of two values: the mean of four draws is 0 or 1 in one case of 16 each.
    assert (low, high) == (0.0, 1.0)


@pytest.mark.slow
def test_calibration_makes_fixel_better_on_real_pushes(data_root, monkeypatch):
    monkeypatch.setattr(engines, "SETTINGS", {"fixel": engines.SETTINGS["fixel"]})
    monkeypatch.setattr(engines, "HELD_OUT", 84)
    monkeypatch.setattr(engines, "LEFT_OUT", {"ellip2"})
    folder = data_root / "mit_push_endpoints"
    still, shipped, calibrated = reproduce("engines", folder).tables["overall"]
    assert shipped["held_out"] >= 1000
    assert calibrated["mean_mm"] < 0.9 * shipped["mean_mm"] < 0.5 * still["mean_mm"]
