"""Maps of uneven tables, against the tables that made the pushes and dense linear algebra."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel.calibration.target import target_of
from fixel.errors import InvalidInput
from fixel.parts import table_fit
from fixel.parts.fit import NAMES, PartPushes, PartValues
from fixel.parts.table_map import BoardShift, MapJudgement, by_part
from fixel.testing.pushes import example_parts, example_pushes, uneven_board

BUMPS = 0.8


@dataclass(frozen=True)
class SimpleModel:
    """Fits as those of a part model."""

    fits: tuple[PartValues, ...]


@pytest.fixture(scope="module")
def every():
    return example_parts(3, 54, uneven=BUMPS)


@pytest.fixture(scope="module")
def pushes(every):
    return [one for one in every if int(one.name[-2:]) <= 36]


@pytest.fixture(scope="module")
def table(pushes):
    return fixel.table_map(pushes, progress=False)


def test_the_map_resembles_the_table_that_made_the_pushes(table):
    assert table.weight > 0.0
    grid = table.load_map
    n_y, n_x = grid.log_load.shape
    y, x = np.meshgrid(np.arange(n_y), np.arange(n_x), indexing="ij")
    place = grid.origin + grid.cell * np.stack((x, y), axis=-1)
    seen = table.deviation < 0.7
    assert seen.sum() > 100
    plane = np.column_stack((np.ones(seen.sum()), place[seen]))

    def flat(heights):
        return heights - plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]

    true = flat(uneven_board(BUMPS).at(place[seen]))
    other = flat(uneven_board(BUMPS, seed=6).at(place[seen]))
    found = flat(grid.log_load[seen])
    # Nodes of the table are 50 mm apart and independent: parts of 100 mm do not feel each of them.
    assert np.corrcoef(true, found)[0, 1] > 0.4
    assert abs(np.corrcoef(other, found)[0, 1]) < 0.3


def test_errors_of_new_pushes_fall(table, every):
    new = [one for one in every if int(one.name[-2:]) > 36]
    assert not {one.key for one in new} & set(table.experiments)
    measured = np.array([one.trajectory.pose[-1] for one in new])
    ends = table.predict(new)
    bare = replace(
        table, load_map=replace(table.load_map, log_load=0.0 * table.load_map.log_load),
        own={name: own._replace(balanced=0.0 * own.balanced, free=0.0 * own.free)
             for name, own in table.own.items()},
    ).predict(new)  # fmt: skip

    def error(found):
        return np.hypot(*(found - measured)[:, :2].T).mean()

    assert error(ends) < 0.8 * error(bare)
    changed = [replace(own, trajectory=replace(own.trajectory, pose=own.trajectory.pose * [[1], [0]]
               )) for own in new[:1]]  # fmt: skip
    np.testing.assert_array_equal(table.predict(changed)[0], ends[0])


def test_a_flat_table_gets_no_map():
    flat = fixel.table_map(example_parts(3, 16, seed=4), progress=False)
    assert flat.weight == 0.0
    assert not flat.load_map.log_load.any()
    assert "not used" in repr(flat)


def test_another_table_and_another_laboratory_are_refused(table, pushes):
    other = replace(pushes[0], conditions={**pushes[0].conditions, "surface": "desk"})
    refused(table.on, other, match="surface=desk")
    refused(table.on, replace(pushes[0], dataset="elsewhere"), match="world coordinates")
    refused(fixel.table_map, [*pushes[:6], other], progress=False, match="one table")
    stranger = replace(pushes[0], conditions={**pushes[0].conditions, "part": "part-9"})
    refused(table.predict, [stranger], match="part-9")


def test_parts_on_three_points_are_refused():
    pushes = [replace(one, conditions={"part": "a", "surface": "b"}) for one in example_pushes(4)]
    with pytest.raises(InvalidInput, match="three points"):
        fixel.table_map(pushes, {"a": {"mu_pusher": 0.25}}, progress=False)


def test_calibrations_of_another_type_are_refused(pushes):
    problem = refused(fixel.table_map, pushes, 5, match="the type int")
    assert problem.where == "calibrations"


def test_known_conditions_are_the_same_for_a_check_and_a_map(pushes):
    """Each list has the conditions that experiments state, in alphabetical order."""
    known = ", ".join(sorted({name for own in pushes for name in own.conditions}))
    for call in (fixel.table_check, fixel.table_map):
        problem = refused(call, pushes, part="TYPO")
        assert (problem.where, problem.expected) == ("part", f"one of {known}")


def test_scenes_and_experiments_stand_on_the_table(table, pushes):
    scene = table.on(pushes[0]).scene
    assert scene.plane.load_map == table.load_map
    assert table.on(pushes[0].scene) == scene
    assert table.unseen(pushes[0]) == ""
    body = scene.bodies[0]
    away = replace(
        scene, bodies=(replace(body, pose=body.pose + np.array([3.0, 0.0, 0.0])),), pushers=()
    )
    assert "none of the" in table.unseen(away)


def test_without_anything_of_its_own_a_part_is_predicted_as_its_scene_on_the_table(table, pushes):
    some = pushes[:4]
    own = {name: one._replace(value=0.0 * one.value, balanced=0.0 * one.balanced,
                              free=0.0 * one.free) for name, one in table.own.items()}  # fmt: skip
    ends = replace(table, own=own).predict(some)
    values = table.values["part-1"]
    uneven = PartPushes([target_of(table.on(push)) for push in some])
    flat = PartPushes([target_of(push) for push in some])
    given = {name: np.full(len(some), x) for name, x in values.items()}
    every = np.arange(len(some))
    np.testing.assert_allclose(uneven.simulate(every, given)[0], ends, atol=1e-9)
    assert np.abs(flat.simulate(every, given)[0] - ends).max() > 1e-4


def test_friction_and_shift_of_other_parts_are_corrected_towards_the_truth(pushes):
    # Friction at the pusher is between 0.2 and 0.3 here.
    wrong = {f"part-{k}": {"mu_pusher": 0.45, "pressure_xy": 0.5} for k in (1, 2, 3)}
    table = fixel.table_map(pushes, wrong, progress=False)
    assert table.weight > 0.0
    assert (np.array([table.pusher[name] for name in wrong])[:, 0] < 0.0).all()
    values = np.arange(float(len(NAMES)))
    fits = tuple(PartValues(name, on, values) for on in ("board", "desk") for name in wrong)
    model = SimpleModel(fits=fits)
    changed = table.corrected(model).fits
    at = [NAMES.index(name) for name in ("mu_pusher", "registration_x", "registration_y")]
    for before, after in zip(fits, changed, strict=True):
        expected = values.copy()
        expected[at] += table.pusher[before.part] if before.surface == "board" else 0.0
        np.testing.assert_array_equal(after.values, expected)
        np.testing.assert_array_equal(before.values, values)
    assert not replace(table, pusher={}).corrected(model).fits[0].values[0]


def test_a_saved_map_is_the_same(table, tmp_path):
    again = fixel.load(table.save(tmp_path / "table.fixel"))
    assert repr(again) == repr(table)
    np.testing.assert_equal(again.pusher, table.pusher)
    np.testing.assert_array_equal(again.load_map.log_load, table.load_map.log_load)
    np.testing.assert_array_equal(again.deviation, table.deviation)


def test_derivatives_by_loads_are_those_of_the_engine(pushes):
    group = by_part(pushes, "part")["part-1"]
    part = table_fit.StandingPart(group, {"mu_pusher": 0.25})
    case = part._ensemble.cases[0]
    values = {f"load_{k + 1}": float(x) for k, x in enumerate(part.loads[0])}
    values["mu_pusher"] = 0.25
    names = ["load_1", "load_4", "load_7"]
    run = fixel.simulate(case.scene, values, motion="quasistatic", derivatives=names)
    for name in names:
        k = int(name[5:]) - 1
        exact = run.derivatives[name] * values[name] * (1.0, 1.0, 35e-3)
        # The steps are wide, because ends are rough functions of loads.
        largest = np.abs(part.by_load[0]).max()
        np.testing.assert_allclose(part.by_load[0, :, k], exact, atol=0.1 * largest)


def test_the_fit_is_that_of_dense_linear_algebra():
    rng = np.random.default_rng(1)
    n, p, m = 6, 5, 4
    pose = rng.normal(0.0, 0.03, (n, 3))
    rows = table_fit.MapRows(
        rng.normal(size=(n, 3, m)), rng.normal(size=(n, 3, p)), rng.normal(size=(n, 3, p)),
        rng.normal(size=(n, 3, len(table_fit.CORRECTED))), pose, 1e-3 * rng.normal(size=(n, 3)),
        np.ones(n, bool),
    )  # fmt: skip
    fit = table_fit.fit_table([rows])
    a, b, c = (x.reshape(3 * n, -1) for x in (rows.by_map, rows.by_balanced, rows.by_value))
    own = table_fit.OWN_DEVIATION**2 * b @ b.T + c @ c.T
    # The noise that the fit has settled at follows from its answer: left = noise * force.
    force = fit.force[0].reshape(-1)
    left = rows.residual.reshape(-1) - a @ fit.mean - own @ force
    noise = np.linalg.norm(left.reshape(n, 3), axis=1) / np.linalg.norm(force.reshape(n, 3), axis=1)
    total = a @ a.T + own + np.diag(np.repeat(noise, 3))
    mean = a.T @ np.linalg.solve(total, rows.residual.reshape(-1))
    np.testing.assert_allclose(fit.mean, mean, rtol=1e-6)
    spread = np.eye(m) - a.T @ np.linalg.solve(total, a)
    np.testing.assert_allclose(fit.factor @ fit.factor.T, spread, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(fit.without(0), 0.0)


def test_what_is_a_parts_own_is_a_gaussian_process_over_poses():
    rng = np.random.default_rng(2)
    n, p = 5, 4
    pose = rng.normal(0.0, 0.04, (n, 3))
    rows = table_fit.MapRows(
        np.zeros((n, 3, 2)), rng.normal(size=(n, 3, p)), rng.normal(size=(n, 3, p)),
        np.zeros((n, 3, len(table_fit.CORRECTED))), pose, 1e-2 * rng.normal(size=(n, 3)),
        np.ones(n, bool),
    )  # fmt: skip
    own = table_fit.own_fit(rows, np.zeros(2))
    at = rng.normal(0.0, 0.04, (3, 3))
    load, friction = own.changes(at)
    force = table_fit.fit_table([rows._replace(by_map=rows.by_map[:, :, :0])], by_pose=True).force[
        0
    ]
    for k in range(3):
        expected_load, expected_friction = np.zeros(p), np.zeros(p)
        for j in range(n):
            d2 = ((at[k, :2] - pose[j, :2]) ** 2).sum() / 0.03**2
            turn = (2 * np.sin(0.5 * (at[k, 2] - pose[j, 2])) / 0.5) ** 2
            near = np.exp(-0.5 * (d2 + turn))
            expected_load += (table_fit.OWN_DEVIATION**2 + table_fit.POSE_DEVIATION**2 * near) * (
                rows.by_balanced[j].T @ force[j])  # fmt: skip
            expected_friction += (
                table_fit.FRICTION_DEVIATION**2 * near * (rows.by_load[j].T @ force[j])
            )
        np.testing.assert_allclose(load[k], expected_load)
        np.testing.assert_allclose(friction[k], expected_friction)


def test_three_noisy_pushes_teach_hardly_more_than_with_known_noise():
    rng = np.random.default_rng(3)
    n, p, q, noise = 3, 8, len(table_fit.CORRECTED), 2e-3
    learned, best = [], []
    for _ in range(60):
        slope = 3e-3 * rng.normal(size=(2 * n, 3, p))
        rows = table_fit.MapRows(
            np.zeros((2 * n, 3, 0)), 0.0 * slope, slope, np.zeros((2 * n, 3, q)),
            np.zeros((2 * n, 3)), noise * rng.normal(size=(2 * n, 3)), np.ones(2 * n, bool),
        )  # fmt: skip
        own = table_fit.own_fit(rows.rows(np.arange(n)), np.zeros(0))
        change = own.changes(rows.pose[n:])[0]
        learned.append(np.einsum("nip,np->ni", slope[n:], change))
        # Loads explain nothing here; the best answer knows how large the noise is.
        seen = slope[:n].reshape(3 * n, p)
        prior = (table_fit.OWN_DEVIATION**2 + table_fit.POSE_DEVIATION**2) * np.eye(p)
        total = seen @ prior @ seen.T + noise**2 * np.eye(3 * n)
        loads = prior @ seen.T @ np.linalg.solve(total, rows.residual[:n].reshape(-1))
        best.append(slope[n:] @ loads)
    assert np.mean(np.square(learned)) < 1.3 * np.mean(np.square(best))


def test_weights_interpolate_linear_fields_exactly():
    rng = np.random.default_rng(0)
    grid = table_fit.MapGrid.over(rng.uniform(-0.1, 0.2, (50, 2)))
    n_y, n_x = grid.shape
    y, x = np.meshgrid(np.arange(n_y), np.arange(n_x), indexing="ij")
    field = (2.0 * x - 3.0 * y).ravel()
    places = rng.uniform(-0.1, 0.2, (20, 2))
    node = (places - grid.origin) / grid.cell
    np.testing.assert_allclose(grid.weights(places) @ field, 2.0 * node[:, 0] - 3.0 * node[:, 1])
    np.testing.assert_allclose(grid.levelled(field, places), 0.0, atol=1e-9)
    # Neighbours are as alike as the prior says, and nodes far apart are not.
    covariance = grid.root @ grid.root.T
    assert covariance[0, 1] == pytest.approx(np.exp(-0.5 * (grid.cell / 0.05) ** 2), abs=0.02)
    assert abs(covariance[0, -1]) < 0.02


def test_the_gain_counts_parts_equally():
    part = ("a",) * 9 + ("b",)
    before = np.ones((10, 2))
    after = before - np.array([[0.1, 0.0]] * 9 + [[0.5, 0.0]])
    mean, low, high = MapJudgement("part", part, before, after).gain()
    assert mean[0] == pytest.approx(-0.3)
    assert low[0] == pytest.approx(-0.5)
    assert high[0] == pytest.approx(-0.1)


def test_a_motion_is_noticed_beyond_three_deviations():
    seen = BoardShift(np.array([5e-3, 0.0, 0.0]), np.array([1e-3, 1e-3, 0.01]), 80)
    assert seen.noticed
    assert "has moved: x +5.0 +- 2.0 mm" in repr(seen)
    assert not seen._replace(shift=seen.shift / 2).noticed
