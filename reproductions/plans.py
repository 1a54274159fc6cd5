"""Choices among real pushes by their success probability, stated before and checked afterwards.

The probability is that of the belief with which `fixel.plan` judges pushes after a calibration.

The held-out pushes of a plate on a surface are the actions to choose from. A goal is the predicted
motion of a random training push, displaced at random: it depends on no measured motion of a
held-out push. A method chooses one push for each goal; the recorded motion decides. A goal is
feasible if at least one recorded motion meets it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fixel.model import wrapped
from fixel.replay.base import Row
from fixel.simulation.vary import composed, inverted
from fixel.typing import BoolArray, FloatArray
from reproductions.charts.plans import plans_figure
from reproductions.mit_push import PUBLISHED
from reproductions.predicted_pushes import (
    PARAMETERS,
    REPEATS,
    TRAIN,
    GroupPrediction,
    predict_group,
)
from reproductions.protocols import BenchmarkData, calibrated_bench
from reproductions.pushes import Key, PushGroup
from reproductions.residuals import in_object
from reproductions.result import Reproduction, RunOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEEDS: Final = 1  # random splits
GOALS: Final = 150  # per group and split
# Largest displacement of a goal from a prediction [m, rad].
SHAKE: Final = (3e-3, np.radians(3.0))
# Tolerances of the goals: position [mm], angle [deg].
TOLERANCES: Final = ((2.0, 2.0), (3.0, 3.0), (5.0, 5.0))
ACT: Final = 0.9  # stated probability from which a cautious planner acts
BINS: Final = 10
FIFTHS: Final = 5
METHODS: Final = {
    "probability": "largest success probability",
    "calibrated": "nearest calibrated prediction",
    "published": "nearest prediction of the published simulator",
    "nominal": "nearest uncalibrated prediction",
    "neighbours": "nearest mean of 4 similar training pushes",
    "neighbour": "nearest similar training push",
}
PAIRS: Final = (3.0, 3.0)  # tolerance of the goals of two pushes [mm, deg]
NEAR: Final = 16  # pushes, or pairs of them, that are compared by their probabilities
SEEN: Final = 32  # draws of the first push for which a second one is chosen


class Actions(NamedTuple):
    """Held-out pushes of one group, and how each method predicts them."""

    group: GroupPrediction
    predicted: dict[str, FloatArray]  # (m, 3) motions by method [m, m, rad]
    goals: FloatArray  # (k, 3) [m, m, rad]


class Choices(NamedTuple):
    """Choices of one method for the goals of one group."""

    key: Key
    success: BoolArray  # (k,)
    feasible: BoolArray  # (k,)
    stated: FloatArray  # (k,) stated probability of the chosen push


class Pairs(NamedTuple):
    """Two pushes for each goal of one group: stated probabilities and successes."""

    key: Key
    blind: FloatArray  # (k,) stated for two pushes
    looked: FloatArray  # (k,) stated with a look between them
    blind_met: FloatArray  # (k,) 1 where the recorded motions meet the goal
    looked_met: FloatArray  # (k,)


def run(options: RunOptions) -> Reproduction:
    """Choose among held-out pushes, and compare stated probabilities with recorded motions.

    With `quick`, it uses three plates with 60 pushes each, and rough fits.
    """
    bench = calibrated_bench(options, SEEDS)
    bench.total = len(bench.rows) * bench.request.seeds
    rows: dict[str, list[Row]] = {"choices": [], "stated": [], "reliability": [], "coverage": []}
    actions, pairs = [], []
    for seed in range(bench.request.seeds):
        for k, key in enumerate(bench.rows):
            own = predict_group(bench, key, bench.splits(key)[seed], seed)
            actions.append(_actions(bench, own, [seed, k]))
            pairs.append(chosen_pairs(own, np.random.default_rng([seed, k, 2])))
            bench.advance(f"split {seed + 1}, {' '.join(key)}")
    _judge(rows, actions)
    rows["coverage"] = _coverage_rows([own.group for own in actions])
    rows["pairs"] = _pair_rows(pairs)
    return Reproduction(
        tables=rows,
        conclusions=_conclusions(rows),
        settings={
            "seeds": bench.request.seeds,
            "goals": GOALS,
            "calibrated_to": TRAIN,
            "parameters": {name: list(ends) for name, ends in PARAMETERS.items()},
            "methods": METHODS,
            "quick": options.quick,
        },
        figure=_figure(rows),
    )


# --- choices --------------------------------------------------------------------------------------


def _actions(bench: BenchmarkData, own: GroupPrediction, seed: Sequence[int]) -> Actions:
    group = bench.group(own.held_out.key)
    rows = own.held_out.rows
    published = bench.data.published.get(PUBLISHED)
    ends = {"nominal": np.where(group.nominal.good[:, None], group.nominal.end, np.nan)}
    if published is not None:
        ends["published"] = published[group.rows]
    motions = {name: _motions(group, end) for name, end in ends.items()}
    predicted = {"calibrated": own.held_out.predicted}
    predicted |= {name: motion[rows] for name, motion in motions.items()}
    predicted["neighbour"] = _of_neighbours(group, own, 1)
    predicted["neighbours"] = _of_neighbours(group, own, 4)
    sources = [own.train.predicted, *(motion[own.train.rows] for motion in motions.values())]
    return Actions(own, predicted, goals_of(sources, GOALS, np.random.default_rng(seed)))


def goals_of(sources: Sequence[FloatArray], n: int, rng: np.random.Generator) -> FloatArray:
    """Return goals (n, 3): predicted motions of random training pushes, displaced at random.

    Parameters
    ----------
    sources : sequence of (m, 3) float64
        Predictions of the same pushes by several simulators, which take turns. Those of the first
        are finite, and replace missing ones.
    """
    chosen = rng.integers(len(sources[0]), size=n)
    goals = np.stack([sources[k % len(sources)][row] for k, row in enumerate(chosen.tolist())])
    goals = np.where(np.isfinite(goals).all(axis=1)[:, None], goals, sources[0][chosen])
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    radius = SHAKE[0] * np.sqrt(rng.uniform(size=n))
    turn = SHAKE[1] * rng.uniform(-1.0, 1.0, n)
    return np.asarray(
        goals + np.column_stack((radius * np.cos(angle), radius * np.sin(angle), turn))
    )


def off_goal(motions: FloatArray, goal: FloatArray, tolerance: tuple[float, float]) -> FloatArray:
    """Return distances (..., 2) from a goal in tolerances: of position, and of angle."""
    off = motions - goal
    position = np.hypot(off[..., 0], off[..., 1]) / (1e-3 * tolerance[0])
    return np.stack((position, np.abs(wrapped(off[..., 2])) / np.radians(tolerance[1])), axis=-1)


def choose(actions: Actions, tolerance: tuple[float, float]) -> dict[str, Choices]:
    """Choose a push for every goal, by every method."""
    held = actions.group.held_out
    hit = np.array(
        [(off_goal(held.measured, goal, tolerance) <= 1.0).all(axis=-1) for goal in actions.goals]
    )
    # A draw without a simulation meets no goal. One half of the draws selects a push, and the other
    # states its probability, which would be too high after a selection.
    halves = np.arange(held.draws.shape[1]) // REPEATS % 2
    chance = [
        np.array(
            [
                (off_goal(held.draws[:, halves == half], goal, tolerance) <= 1.0)
                .all(axis=-1)
                .mean(axis=-1)
                for goal in actions.goals
            ]
        )
        for half in (0, 1)
    ]
    found = {}
    for name, motion in actions.predicted.items():
        off = np.array([off_goal(motion, goal, tolerance) for goal in actions.goals])
        away = np.nan_to_num(np.hypot(off[..., 0], off[..., 1]), nan=np.inf)
        found[name] = away.argmin(axis=1)
        if name == "calibrated":  # decides among equal probabilities
            found["probability"] = (chance[0] - 1e-9 * np.minimum(away, 1e6)).argmax(axis=1)
    at = np.arange(len(actions.goals))
    return {
        name: Choices(held.key, hit[at, own], np.asarray(hit.any(axis=1)), chance[1][at, own])
        for name, own in found.items()
    }


def chosen_pairs(own: GroupPrediction, rng: np.random.Generator) -> Pairs:
    """Choose two held-out pushes for each goal, blind and with a look between them.

    Goals are the predicted motions of two training pushes, displaced. The recorded motion of the
    second push is assumed to be the same in the frame of the part wherever the first one left it.
    """
    held, train = own.held_out, own.train.predicted
    both = composed(train[rng.permutation(len(train))], train)
    n, goals = len(held.rows), goals_of([both], GOALS, rng)
    pairs = composed(held.predicted[:, None], held.predicted[None]).reshape(-1, 3)
    every, single = cKDTree(_scaled(pairs)), cKDTree(_scaled(held.predicted))
    found = []
    for goal in goals:
        near = every.query(_scaled(goal), k=NEAR)[1]
        first, second = near // n, near % n
        order = rng.permutation(held.draws.shape[1])
        ends = composed(held.draws[first], held.draws[second][:, order])
        best, blind = _likeliest(ends, goal)
        i, j = first[best], second[best]
        met = [_met(composed(held.measured[i], held.measured[j]), goal)]
        left = composed(inverted(held.draws[i][:: held.draws.shape[1] // SEEN]), goal)
        stated = []
        for wanted in (*left, composed(inverted(held.measured[i]), goal)):
            near = single.query(_scaled(wanted), k=NEAR)[1]
            best, chance = _likeliest(held.draws[near], wanted)
            stated.append(chance)
        met.append(_met(held.measured[near[best]], wanted))
        found.append((blind, float(np.mean(stated[:-1])), *met))
    return Pairs(held.key, *np.array(found, np.float64).T)


def _likeliest(draws: FloatArray, goal: FloatArray) -> tuple[int, float]:
    """Return the push whose draws (m, n, 3) most often meet a goal by one half of them, and the
    probability by the other half."""
    met, halves = _met(draws, goal), np.arange(draws.shape[1]) // REPEATS % 2
    best = int(met[:, halves == 0].mean(axis=1).argmax())
    return best, float(met[best, halves == 1].mean())


def _met(motions: FloatArray, goal: FloatArray) -> BoolArray:
    return np.asarray((off_goal(motions, goal, PAIRS) <= 1.0).all(axis=-1))


def _scaled(motions: FloatArray) -> FloatArray:
    """Return motions in tolerances."""
    return motions / (1e-3 * PAIRS[0], 1e-3 * PAIRS[0], np.radians(PAIRS[1]))


def _motions(group: PushGroup, end: FloatArray) -> FloatArray:
    off = end - group.start
    off[:, 2] = wrapped(off[:, 2])
    return in_object(group, np.arange(len(group)), off)


def _of_neighbours(group: PushGroup, own: GroupPrediction, n: int) -> FloatArray:
    """Return mean measured motions (m, 3) of the n most similar training pushes."""
    everyone, flat = np.arange(len(group)), np.zeros(len(group))
    tip = group.tip_start - group.start[:, :2]
    way = group.tip_end - group.tip_start
    way /= np.hypot(*way.T)[:, None]
    place = [in_object(group, everyone, np.column_stack((a, flat)))[:, :2] for a in (tip, way)]
    table = np.column_stack((place[0] / np.sqrt(group.shape.unit_inertia), place[1]))
    known = _motions(group, group.end)[own.train.rows]
    near = cKDTree(table[own.train.rows]).query(table[own.held_out.rows], k=[*range(1, n + 1)])[1]
    return np.asarray(known[near].mean(axis=1))


# --- tables ---------------------------------------------------------------------------------------


def _judge(rows: dict[str, list[Row]], actions: Sequence[Actions]) -> None:
    for tolerance in TOLERANCES:
        chosen = [choose(own, tolerance) for own in actions]
        head: Row = {"mm": tolerance[0], "deg": tolerance[1]}
        for name in METHODS:
            own = [c[name] for c in chosen if name in c]
            if own:
                rows["choices"].append({**head, "method": name, **_success(own)})
        own = [c["probability"] for c in chosen]
        rows["stated"].append({**head, **_stated(own)})
        rows["reliability"] += [{**head, **row} for row in _reliability(own)]


def _success(chosen: Sequence[Choices]) -> Row:
    """Return the share of feasible goals that were met, with its standard error over groups."""
    feasible = np.concatenate([own.feasible for own in chosen])
    groups = [own.success[own.feasible].astype(float) for own in chosen if own.feasible.any()]
    every = np.concatenate([np.zeros(0), *groups])
    by_key = {key: [g for o in chosen if o.key == key for g in o.success[o.feasible].tolist()]
              for key in {own.key for own in chosen}}  # fmt: skip
    return {
        "goals": len(feasible),
        "feasible": round(float(feasible.mean()), 4),
        "success": _share(every),
        "standard_error": round(_error(groups), 4),
        "worst_group": min((_share(own) for own in by_key.values() if len(own) >= 20), default=0.0),
    }


def _share(values: Sequence[float] | FloatArray) -> float:
    return round(float(np.mean(values)), 4) if len(values) else 0.0


def _error(groups: Sequence[FloatArray]) -> float:
    """Return the standard error of a mean whose groups are independent, and not their members."""
    if len(groups) < 2:
        return 0.0
    mean = np.concatenate(groups).mean()
    sums = np.array([np.sum(own - mean) for own in groups])
    total, n = sum(len(own) for own in groups), len(groups)
    return float(np.sqrt(np.sum(sums**2) * n / (n - 1)) / total)


def _stated(chosen: Sequence[Choices]) -> Row:
    """Compare stated probabilities of the chosen pushes with their successes."""
    stated = np.concatenate([own.stated for own in chosen])
    success = np.concatenate([own.success for own in chosen]).astype(float)
    acted = stated >= ACT
    rows = _reliability(chosen)
    gap = sum(row["goals"] * abs(row["stated"] - row["held"]) for row in rows) / len(stated)
    keys = list(dict.fromkeys(own.key for own in chosen))
    by_key = [
        np.concatenate([own.stated - own.success for own in chosen if own.key == key]).mean()
        for key in keys
    ]
    of_acted = [own.success[own.stated >= ACT].astype(float) for own in chosen]
    return {
        "stated": _share(stated),
        "held": _share(success),
        "calibration_error": round(float(gap), 4),
        "brier": round(float(np.mean((stated - success) ** 2)), 4),
        "group_gap_low": round(float(min(by_key)), 3),
        "group_gap_high": round(float(max(by_key)), 3),
        "acts_on": _share(acted.astype(float)),
        "stated_acting": _share(stated[acted]),
        "held_acting": _share(success[acted]),
        "held_acting_standard_error": round(_error([own for own in of_acted if len(own)]), 4),
    }


def _reliability(chosen: Sequence[Choices]) -> list[Row]:
    stated = np.concatenate([own.stated for own in chosen])
    success = np.concatenate([own.success for own in chosen])
    place = np.minimum((stated * BINS).astype(int), BINS - 1)
    return [
        {
            "bin": k / BINS,
            "goals": int((place == k).sum()),
            "stated": _share(stated[place == k]),
            "held": _share(success[place == k]),
        }
        for k in range(BINS)
        if (place == k).any()
    ]


def _coverage_rows(groups: Sequence[GroupPrediction]) -> list[Row]:
    """Return the coverage of 90 % intervals in every fifth of predicted motion and rotation."""
    held = [own.held_out for own in groups]
    inside = np.concatenate([own.inside() for own in held])
    width = np.concatenate([own.half_widths() for own in held])
    moved, turned = (np.concatenate([getattr(o, x) for o in held]) for x in ("moved", "turned"))
    keys = list(dict.fromkeys(own.key for own in held))
    place = np.concatenate([np.full(len(own.rows), keys.index(own.key)) for own in held])
    parts = [("all", np.zeros(len(inside), int)), ("group", place)]
    parts[1:1] = [("motion", _fifth(moved)), ("rotation", _fifth(turned))]
    rows: list[Row] = []
    for by, label in parts:
        for k in range(int(label.max()) + 1):
            own = label == k
            rows.append(
                {
                    "by": by,
                    "part": " ".join(keys[k]) if by == "group" else str(k + 1),
                    "from_mm": round(1e3 * float(moved[own].min()), 1),
                    "to_mm": round(1e3 * float(moved[own].max()), 1),
                    "from_deg": round(float(np.degrees(turned[own].min())), 1),
                    "to_deg": round(float(np.degrees(turned[own].max())), 1),
                    "held_out": int(own.sum()),
                    **{f"{c}_held": _share(inside[own, j]) for j, c in enumerate("xy")},
                    "angle_held": _share(inside[own, 2]),
                    "half_width_mm": round(1e3 * float(np.median(width[own, :2])), 2),
                    "half_width_deg": round(float(np.degrees(np.median(width[own, 2]))), 2),
                }
            )
    return rows


def _fifth(values: FloatArray) -> np.ndarray:
    edges = np.quantile(values, np.arange(1, FIFTHS) / FIFTHS)
    return np.searchsorted(edges, values, side="right")


def _pair_rows(pairs: Sequence[Pairs]) -> list[Row]:
    """Compare stated and held success of two pushes, blind and with a look between them."""
    return [
        {
            "pushes": name,
            "goals": sum(len(own.blind) for own in pairs),
            "stated": _share(np.concatenate([getattr(own, stated) for own in pairs])),
            "held": _share(np.concatenate([getattr(own, met) for own in pairs])),
            "standard_error": round(_error([getattr(own, met) for own in pairs]), 4),
        }
        for name, stated, met in (
            ("two, blind", "blind", "blind_met"),
            ("two, the second chosen after a look", "looked", "looked_met"),
        )
    ]


def _conclusions(rows: dict[str, list[Row]]) -> list[str]:
    sentences = []
    for row in rows["stated"]:
        best = {own["method"]: own for own in rows["choices"] if own["mm"] == row["mm"]}
        ours, next_best = best["probability"], best["calibrated"]
        sentences.append(
            f"{row['mm']:g} mm and {row['deg']:g} deg: the largest probability meets"
            f" {100 * ours['success']:.1f} % of the feasible goals, the nearest prediction"
            f" {100 * next_best['success']:.1f} %. Calibration error"
            f" {row['calibration_error']:.3f}; {100 * row['acts_on']:.0f} % of the goals have a"
            f" stated probability of at least {ACT:g}, of which {100 * row['held_acting']:.1f} %"
            " are met."
        )
    held = [
        row[f"{name}_held"]
        for row in rows["coverage"]
        if row["by"] in ("motion", "rotation")
        for name in ("x", "y", "angle")
    ]
    return [
        *sentences,
        f"90 % intervals hold {100 * min(held):.1f} to {100 * max(held):.1f} % in every fifth of"
        " predicted motion and rotation.",
        *(
            f"Pushes: {row['pushes']}: stated {row['stated']:.3f}, held {row['held']:.3f}."
            for row in rows["pairs"]
        ),
    ]


def _figure(rows: dict[str, list[Row]]) -> Callable[[], Figure]:
    return partial(plans_figure, rows, METHODS)
