"""Table 1 and figure 11 of the ASME paper: supports of a part, found by random searches.

Trajectories are generated from the first column, p1*, with the camera's error, so that the true
parameters are known. A set of parameters counts as good as p1* if its trajectories of the two
identification tests are within one pixel of those of p1*.

Figure 11 is the convergence of two searches from random vertices on the paper's tests 3 and 4. Its
table has the best vertex after each step, its error, and the size of the simplex, which the paper
uses as uncertainty. The figure is not legible in the copy at hand; its title is "Convergence of
Support Points".

Source: ASME 2006 paper on meso-scale manipulation, eqs. 3-4, table 1, figure 11 and "Parameter
estimation".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration import MultiStart, NelderMead
from fixel.calibration.direct_search import NelderMeadSearch
from fixel.calibration.objective import Comparer, RootMeanSquare, combined_errors
from fixel.calibration.optimiser import MultiStartSearch, feasible_points
from fixel.calibration.result import Solution, find_solutions
from fixel.calibration.study import at_points, box_of, run_study
from fixel.calibration.target import Target
from fixel.model.space import ParameterSpace, Unknown
from fixel.model.support import triangle_shares
from fixel.replay.base import Row
from fixel.sampling.published import PART_LENGTH, PART_WIDTH
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.rollouts import RolloutCase
from fixel.testing.scenes import box, micro_push
from fixel.typing import FloatArray
from reproductions.charts.convergence import BestSoFar, convergence_figure
from reproductions.charts.pictures import clusters_figure
from reproductions.result import Reproduction, RunOptions
from reproductions.support_features import SupportFeatures, support_features

# Column p1* of table 1 with decimal points restored: friction of probe and plane, support points.
P1: Final = (0.666, 0.757, 411.3e-6, -563.3e-6, -409.1e-6, 605.9e-6, -273.2e-6, -102.1e-6)
P2: Final = (0.536, 0.013, -412.4e-6, 794.0e-6, -217.8e-6, 774.5e-6, 278.8e-6, -538.8e-6)
TRUTH: Final = np.array(P1[2:]).reshape(3, 2)
OUTLINE: Final = box(PART_WIDTH, PART_LENGTH).outline
CORNERS: Final = tuple(f"support_{k}_{axis}" for k in (1, 2, 3) for axis in "xy")

IDENTIFICATION: Final = (3, 4)
HELD_OUT: Final = (8,)
ALL: Final = tuple(range(1, 9))

FRAME_RATE: Final = 30.0  # [1/s]
PIXEL: Final = 5.3e-6  # [m], largest error of a position
ANGLE_ERROR: Final = 0.005  # [rad], largest error of an angle; hard to read in the paper
LENGTH: Final = 0.5 * PART_LENGTH  # [m], L of the objective; the paper gives no value

# Gaps that separate clusters: mean radius, principal radii [m] and angle [rad].
FEATURE_SCALE: Final = np.array([40e-6, 40e-6, 60e-6, math.radians(6.0)])


class Sets(NamedTuple):
    """k parameter sets with their errors, best first."""

    point: FloatArray  # (k, 8)
    error: FloatArray  # (k,) F on the identification tests, noisy data [mm]
    apart: FloatArray  # (k,) F from the exact trajectories of p1*, the same tests [mm]
    held_out: FloatArray  # (k,) the same for test 8
    everywhere: FloatArray  # (k,) the same for all eight tests
    features: SupportFeatures


def run_table_1(options: RunOptions) -> Reproduction:
    """Search from random starts, cluster sets as good as p1*, and vary the plane's friction.

    With `quick`, it runs four short searches.
    """
    starts, evaluations, wide = (4, 600, 0) if options.quick else (24, 3000, 6)
    noisy, exact = simulate_targets(seed=1), simulate_targets(seed=None)
    options.progress(1, 5, "trajectories from p1*")
    search = run_searches(comparer_of(noisy, IDENTIFICATION), starts, evaluations)
    options.progress(2, 5, f"{starts} searches, {search.evaluations} evaluations")
    sets = evaluate_sets(search, noisy, exact)
    floor = float(objective(comparer_of(noisy, IDENTIFICATION), np.array([P1]))[0])
    good = sets.apart <= 1e3 * PIXEL
    clusters = cluster_sets(sets, good)
    options.progress(3, 5, f"{int(good.sum())} sets as good as p1*, {len(clusters)} clusters")
    plane = plane_friction(exact)
    options.progress(4, 5, "friction of the plane")
    from_all = _from_all(noisy, exact, wide, evaluations)
    options.progress(5, 5, "all eight tests for identification")
    rows = [_set_row(sets, k, bool(good[k])) for k in range(len(sets.error))]
    cluster_rows = [_cluster_row(cluster, sets, np.flatnonzero(good)) for cluster in clusters]
    return Reproduction(
        tables={
            "table_1": _table_1(exact),
            "sets": rows,
            "clusters": cluster_rows,
            "plane_friction": plane,
            "from_all_tests": from_all,
        },
        conclusions=_conclusions(floor, sets, good, cluster_rows, plane, from_all),
        settings={
            "starts": starts,
            "evaluations": search.evaluations,
            "identification_tests": list(IDENTIFICATION),
            "held_out_test": list(HELD_OUT),
            "pixel_um": 1e6 * PIXEL,
            "angle_error_rad": ANGLE_ERROR,
            "length_um": 1e6 * LENGTH,
            "error_of_p1_um": 1e3 * floor,
            "quick": options.quick,
        },
        figure=partial(
            clusters_figure, OUTLINE, TRUTH, _clusters(clusters, sets, np.flatnonzero(good))
        ),
    )


def space() -> ParameterSpace:
    """Parameter space: friction of probe and plane, and three support points in the part."""
    half = {"x": 0.5 * PART_WIDTH, "y": 0.5 * PART_LENGTH}
    corners = [
        Unknown(
            name=name,
            low=-half[name[-1]],
            high=half[name[-1]],
            nominal=0.6 * way * half[name[-1]],
        )
        for name, way in zip(CORNERS, (1, -1, -1, -1, 0, 1), strict=True)
    ]
    return ParameterSpace(
        unknowns=(
            Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=0.5),
            # At exactly 0 nothing resists the part, and quasi-static motion is undetermined.
            Unknown(name="mu_support", low=1e-3, high=1.0, nominal=0.5),
            *corners,
        )
    )


def simulate_targets(seed: int | None) -> dict[int, Target]:
    """Simulate the eight pushes with p1*, with the camera's errors; exact if `seed` is None."""
    draw = np.random.default_rng(seed)
    found = {}
    for test in ALL:
        scene = micro_push(test, "p1")
        n = round(scene.duration * FRAME_RATE)
        case = RolloutCase(scene, np.arange(1, n + 1) / FRAME_RATE)
        pose = Ensemble([case]).simulate(np.zeros(1, np.int64), {}).pose[0]
        if seed is not None:
            pose = pose + draw.uniform(-1.0, 1.0, pose.shape) * (PIXEL, PIXEL, ANGLE_ERROR)
        found[test] = Target(f"asme/{test}", {"test": float(test)}, case, pose)
    return found


def comparer_of(targets: dict[int, Target], tests: Sequence[int]) -> Comparer:
    """Create the comparer of given tests, with the errors of the paper [mm]."""
    error = RootMeanSquare(angle_scale=LENGTH)
    return Comparer([targets[test] for test in tests], space(), error)


def objective(comparer: Comparer, points: FloatArray) -> FloatArray:
    """Compute the paper's objective F (k,) at points (k, n_free) [mm]."""
    study = at_points(range(len(comparer.targets)), points)
    errors, _ = run_study(study, lambda ask: comparer.errors(ask.which, ask.points))
    return combined_errors(errors, "mean")


def run_searches(
    comparer: Comparer, starts: int, evaluations: int, seed: int = 3
) -> MultiStartSearch:
    """Run Nelder-Mead from nine random feasible vertices, several times, as in the paper."""
    optimiser = MultiStart(
        optimiser=NelderMead(
            random_simplex=True, size=1e-3, restarts=2, max_evaluations=evaluations
        ),
        starts=starts,
    )
    search = optimiser.start(box_of(space()), seed, comparer.feasible)
    while not search.done:
        search.tell(objective(comparer, search.ask()))
    return search


def evaluate_sets(
    search: MultiStartSearch, noisy: dict[int, Target], exact: dict[int, Target]
) -> Sets:
    """Best parameter set of each search, with its errors, best first."""
    ends = [one.best for one in search.searches if math.isfinite(one.best.error)]
    ends.sort(key=lambda best: best.error)
    points = np.array([best.point for best in ends])
    return Sets(
        points,
        objective(comparer_of(noisy, IDENTIFICATION), points),
        objective(comparer_of(exact, IDENTIFICATION), points),
        objective(comparer_of(exact, HELD_OUT), points),
        objective(comparer_of(exact, ALL), points),
        features_of(points),
    )


def features_of(points: FloatArray) -> SupportFeatures:
    """Features of the supports in parameter sets (k, 8)."""
    corners = points[:, 2:].reshape(-1, 3, 2)
    return support_features(corners, np.maximum(triangle_shares(corners), 0.0))


def cluster_sets(sets: Sets, good: np.ndarray) -> tuple[Solution, ...]:
    """Cluster good sets by the features that affect pushes: radii, and angle of the larger one."""
    own = sets.features
    angle = np.mod(own.angle, math.pi)  # the angles that occur do not wrap in this range
    table = np.column_stack((own.mean_radius, own.radii, angle))[good]
    if not len(table):
        return ()
    return find_solutions(table, sets.apart[good], FEATURE_SCALE, threshold=1e3, distance=1.0)


def _from_all(
    noisy: dict[int, Target], exact: dict[int, Target], starts: int, evaluations: int
) -> list[Row]:
    """Rows of sets found on all eight tests; good if within a pixel on all of them."""
    if not starts:
        return []
    sets = evaluate_sets(run_searches(comparer_of(noisy, ALL), starts, evaluations), noisy, exact)
    order = np.argsort(sets.everywhere, kind="stable").tolist()
    return [_set_row(sets, k, bool(sets.everywhere[k] <= 1e3 * PIXEL)) for k in order]


def plane_friction(exact: dict[int, Target]) -> list[Row]:
    """F of p1* on all tests with other friction of the plane, which quasi-static motion ignores."""
    comparer = comparer_of(exact, ALL)
    values = np.array([0.001, 0.013, 0.1, 0.5, 0.757, 1.0])
    points = np.tile(P1, (len(values), 1))
    points[:, 1] = values
    return [
        {"mu_support": float(mu), "f_um": float(1e3 * error)}
        for mu, error in zip(values, objective(comparer, points), strict=True)
    ]


# --- tables and sentences -------------------------------------------------------------------


def _shape(features: SupportFeatures, k: int) -> Row:
    return {
        "mean_radius_um": float(1e6 * features.mean_radius[k]),
        "principal_radii_um": np.round(1e6 * features.radii[k], 1).tolist(),
        "axis_deg": float(np.degrees(np.mod(features.angle[k], math.pi))),
        "shares": np.round(features.share[k], 3).tolist(),
    }


def _table_1(exact: dict[int, Target]) -> list[Row]:
    points = np.array([P1, P2])
    features = features_of(points)
    errors = objective(comparer_of(exact, ALL), points)
    return [
        {"set": name, "f_all_um": float(1e3 * errors[k]), **_shape(features, k)}
        for k, name in enumerate(("p1*", "p2*"))
    ]


def _set_row(sets: Sets, k: int, good: bool) -> Row:
    return {
        "good": good,
        "f_um": float(1e3 * sets.error[k]),
        "from_p1_um": float(1e3 * sets.apart[k]),
        "held_out_um": float(1e3 * sets.held_out[k]),
        "all_um": float(1e3 * sets.everywhere[k]),
        "mu_pusher": float(sets.point[k, 0]),
        "mu_support": float(sets.point[k, 1]),
        "points_um": np.round(1e6 * sets.point[k, 2:].reshape(3, 2), 1).tolist(),
        **_shape(sets.features, k),
    }


def _cluster_row(cluster: Solution, sets: Sets, rows: np.ndarray) -> Row:
    own = rows[cluster.members]
    best = int(own[0])
    return {
        "sets": cluster.size,
        "from_p1_um": float(1e3 * sets.apart[best]),
        "held_out_um": np.round(1e3 * np.sort(sets.held_out[own])[[0, -1]], 1).tolist(),
        "all_um": np.round(1e3 * np.sort(sets.everywhere[own])[[0, -1]], 1).tolist(),
        "mean_radius_um": np.round(1e6 * np.array([cluster.low[0], cluster.high[0]])).tolist(),
        "larger_radius_um": np.round(1e6 * np.array([cluster.low[1], cluster.high[1]])).tolist(),
        "smaller_radius_um": np.round(1e6 * np.array([cluster.low[2], cluster.high[2]])).tolist(),
        "axis_deg": np.round(np.degrees([cluster.low[3], cluster.high[3]]), 1).tolist(),
        "mu_pusher": np.round(np.sort(sets.point[own, 0])[[0, -1]], 3).tolist(),
        "mu_support": np.round(np.sort(sets.point[own, 1])[[0, -1]], 3).tolist(),
    }


def _conclusions(
    floor: float,
    sets: Sets,
    good: np.ndarray,
    clusters: list[Row],
    plane: list[Row],
    from_all: list[Row],
) -> list[str]:
    n = int(good.sum())
    spread = max(row["f_um"] for row in plane) - min(row["f_um"] for row in plane)
    sentences = [
        f"{n} of {len(good)} searches end within a pixel of the trajectories of p1*; the best has F"
        f" = {1e3 * sets.error[0]:.2f} um, p1* itself {1e3 * floor:.2f} um: the camera's error.",
    ]
    if n:
        radius = 1e6 * sets.features.mean_radius[good]
        sentences.append(
            f"They are {len(clusters)} clusters of supports. Mean radius {radius.min():.0f} to"
            f" {radius.max():.0f} um, 695 for p1*; on the held-out test"
            f" {1e3 * sets.held_out[good].min():.1f} to {1e3 * sets.held_out[good].max():.1f} um"
            f" off, on all eight {1e3 * sets.everywhere[good].min():.1f} to"
            f" {1e3 * sets.everywhere[good].max():.1f}."
        )
    sentences.append(
        "mu_support is not identified: without inertia the support forces scale with it and the"
        f" motion does not; from 0.001 to 1 F changes by {spread:.1g} um."
    )
    near = [row for row in from_all if row["good"]]
    if near:
        radius = sorted(row["mean_radius_um"] for row in near)
        friction = sorted(row["mu_pusher"] for row in near)
        sentences.append(
            f"Identified from all eight tests, {len(near)} of {len(from_all)} searches end within a"
            f" pixel on all of them: mean radius {radius[0]:.0f} to {radius[-1]:.0f} um, mu_pusher"
            f" {friction[0]:.2f} to {friction[-1]:.2f}."
        )
    return sentences


def _clusters(
    clusters: Sequence[Solution], sets: Sets, rows: np.ndarray
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Points and shares of the first clusters, by their labels in the figure."""
    drawn = {}
    for number, cluster in enumerate(clusters[:5], 1):
        own = rows[cluster.members]
        radius = 1e6 * sets.features.mean_radius[own].mean()
        label = f"{number}: {cluster.size} found, {radius:.0f} µm"
        drawn[label] = sets.point[own, 2:].reshape(-1, 3, 2), sets.features.share[own]
    return drawn


# --- figure 11 ------------------------------------------------------------------------------

SEARCHES: Final = 2  # number of searches in the figure
SEED: Final = 3


def run_figure_11(options: RunOptions) -> Reproduction:
    """Run two searches from random vertices until their simplex is small.

    With `quick`, the searches are short.
    """
    evaluations = 300 if options.quick else 3000
    targets = simulate_targets(seed=1)
    comparer = comparer_of(targets, IDENTIFICATION)
    feasible = comparer.feasible
    region = box_of(space())
    starts = feasible_points(region, SEARCHES, SEED, feasible)
    descents = []
    for k, start in enumerate(starts):
        descent = NelderMead(random_simplex=True, size=1e-3, max_evaluations=evaluations)
        search = descent.start(region._replace(start=start), SEED + k, feasible)
        steps: list[tuple[int, float, float, tuple[float, ...]]] = []
        while not search.done:
            search.tell(objective(comparer, search.ask()))
            point, error = search.best
            steps.append((search.evaluations, error, search.size, tuple(point.tolist())))
        descents.append(_descent(k + 1, steps, search))
        options.progress(k + 1, SEARCHES, f"search {k + 1}: {search.reason}")
    return Reproduction(
        tables={"convergence": [row for one in descents for row in _rows(one)]},
        conclusions=[_sentence(one) for one in descents],
        settings={
            "searches": SEARCHES,
            "seed": SEED,
            "evaluations": [int(one.evaluations[-1]) for one in descents],
            "identification_tests": list(IDENTIFICATION),
            "quick": options.quick,
        },
        figure=partial(convergence_figure, OUTLINE, TRUTH, descents),
    )


def _descent(
    number: int,
    steps: list[tuple[int, float, float, tuple[float, ...]]],
    search: NelderMeadSearch,
) -> BestSoFar:
    evaluations, errors, sizes, points = zip(*steps, strict=True)
    return BestSoFar(
        f"search {number}",
        np.array(evaluations),
        np.array(errors),
        np.array(sizes),
        np.array(points)[:, 2:].reshape(-1, 3, 2),
        np.array(search.best.point[:2]),
    )


def _rows(one: BestSoFar) -> list[Row]:
    return [
        {
            "search": one.label,
            "evaluations": int(evaluations),
            "f_um": float(1e3 * error),
            "simplex_size": float(size),
            "points_um": np.round(1e6 * points, 1).tolist(),
        }
        for evaluations, error, size, points in zip(
            one.evaluations, one.error, one.size, one.points, strict=True
        )
    ]


def _sentence(one: BestSoFar) -> str:
    ends = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in 1e6 * one.points[-1])
    return (
        f"{one.label}: F {1e3 * one.error[0]:.1f} -> {1e3 * one.error[-1]:.2f} um in"
        f" {one.evaluations[-1]} evaluations, the simplex {one.size[0]:.2g} -> {one.size[-1]:.2g}"
        f" scales; support points {ends} um, mu_pusher {one.friction[0]:.3f}, mu_support"
        f" {one.friction[1]:.3f}."
    )
