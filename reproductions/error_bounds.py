"""Coverage of error bounds for the calibrated simulator, on real held-out pushes.

The held-out pushes of a fit are halved at random within every group. One half calibrates the
bounds, coverage is counted on the other, and vice versa. The training pushes of the fit are used
only to shape the model of errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from fixel.domain.error_bound import LEVEL, ConformalBound, constant_bound
from fixel.replay.base import Row
from fixel.typing import BoolArray, FloatArray, IntArray
from reproductions.charts.error_bounds import error_bounds_figure
from reproductions.map_cells import PLACES, Half, map_rows
from reproductions.new_sides import trusted_rows
from reproductions.protocols import BenchmarkData, calibrated_bench, full_fit
from reproductions.residuals import PushErrors, Split, evidence_of
from reproductions.result import Reproduction, RunOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEVELS: Final = (0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
HALVINGS: Final = 2  # number of halvings of the held-out pushes of every fit, each used both ways
SEEDS: Final = 3
# Settings were chosen on half of the held-out pushes of this split; the other splits are reported.
CHOSEN_ON: Final = 0
WHAT: Final = {"position": ("mm", 1e3), "angle": ("deg", 180.0 / np.pi), "both": ("mm", 1e3)}


class PushTable(NamedTuple):
    """Features and errors of all pushes with the fits of one split."""

    features: FloatArray  # (n, f)
    errors: FloatArray  # (n, 3)
    group: IntArray  # (n,)
    held_out: BoolArray  # (n,)


class HalfCount(NamedTuple):
    """Bounds and errors of one half, with bounds calibrated on the other."""

    repeat: int
    which: IntArray  # (m,) counted rows of the table
    group: IntArray  # (m,)
    error: FloatArray  # (m,)
    bound: FloatArray  # (n_level, m)
    constant: float
    constant_of_group: FloatArray  # (m,) inf if the group has too few pushes


def run(options: RunOptions) -> Reproduction:
    """Measure coverage and sharpness of the error bounds.

    With `quick`, it uses three plates, few pushes and one split.
    """
    bench = calibrated_bench(options, SEEDS)
    halvings = 1 if options.quick else HALVINGS
    bench.total = bench.request.seeds * (len(bench.rows) + halvings * len(WHAT))
    tables, features = _tables(bench)
    names = [" ".join(key) for key in bench.rows]
    counted: dict[str, list[HalfCount]] = {what: [] for what in WHAT}
    model = ""
    for repeat, table in enumerate(tables):
        for halving in range(halvings):
            for column, what in enumerate(WHAT):
                model, both = _both_ways(table, column, repeat, halving)
                counted[what] += both
                bench.advance(f"{what}, split {repeat + 1}")
    overall = [row for what in WHAT for row in _overall(what, counted[what])]
    groups = [row for what in WHAT for row in _by_group(what, counted[what], names)]
    curve = [row for what in WHAT for row in _curve(what, _reported(counted[what]))]
    trusted = [row for what in WHAT for row in _trusted(what, _reported(counted[what]), names)]
    maps = map_rows(_map_halves(tables, features, names))
    return Reproduction(
        tables={
            "overall": overall,
            "groups": groups,
            "reliability": curve,
            "trusted": trusted,
            "maps": maps,
        },
        conclusions=_conclusions(overall, groups),
        settings={
            "level": LEVEL,
            "seeds": bench.request.seeds,
            "halvings": halvings,
            "model": model,
            "quick": options.quick,
            "features": list(features),
        },
        figure=_figure(counted, groups, curve),
    )


def _tables(bench: BenchmarkData) -> tuple[list[PushTable], tuple[str, ...]]:
    """Tables of pushes, one per split, and names of the features."""
    found: list[list[tuple[PushErrors, Split]]] = [[] for _ in range(bench.request.seeds)]
    for key in bench.rows:
        group = bench.group(key)
        speed = bench.data.speed[group.rows]
        for k, split in enumerate(bench.splits(key)):
            fit = full_fit(bench, group, k, split)
            found[k].append((evidence_of(group, split, fit, speed), split))
            bench.advance(f"features {' '.join(key)}")
    return [_table(own) for own in found], found[0][0][0].features.names


def _table(found: Sequence[tuple[PushErrors, Split]]) -> PushTable:
    held = [np.isin(np.arange(len(own.errors)), split.held_out) for own, split in found]
    return PushTable(
        np.concatenate([own.features.table for own, _ in found]),
        np.concatenate([own.errors for own, _ in found]),
        np.concatenate([np.full(len(own.errors), k) for k, (own, _) in enumerate(found)]),
        np.concatenate(held),
    )


# --- halves -------------------------------------------------------------------------------------


def _both_ways(
    table: PushTable, column: int, repeat: int, halving: int
) -> tuple[str, list[HalfCount]]:
    first, second = _halves(table, 100 * repeat + halving)
    answer = []
    for judging, counting in ((first, second), (second, first)):
        bounds, own = _counted(table, column, repeat, judging, counting)
        answer.append(own)
    return bounds.model, answer


def _halves(table: PushTable, seed: int) -> tuple[IntArray, IntArray]:
    """Halve the held-out rows at random, separately in each group."""
    rng = np.random.default_rng(seed)
    halves: tuple[list[int], list[int]] = ([], [])
    for group in np.unique(table.group):
        own = rng.permutation(np.flatnonzero(table.held_out & (table.group == group)))
        for k, half in enumerate(halves):
            half += own[k::2].tolist()
    return np.sort(halves[0]), np.sort(halves[1])


def _map_halves(
    tables: Sequence[PushTable], features: Sequence[str], names: Sequence[str]
) -> list[tuple[Half, Half]]:
    """Pairs of halves of the reported splits, each used both ways."""
    columns = [features.index(name) for name in PLACES]
    found = []
    for repeat, table in enumerate(tables):
        if repeat == CHOSEN_ON and len(tables) > 1:
            continue
        first, second = (
            Half(
                table.features[rows][:, columns],
                table.errors[rows, list(WHAT).index("both")],
                [names[g] for g in table.group[rows]],
            )
            for rows in _halves(table, 100 * repeat)
        )
        found += [(first, second), (second, first)]
    return found


def _counted(
    table: PushTable, column: int, repeat: int, judging: IntArray, counting: IntArray
) -> tuple[ConformalBound, HalfCount]:
    error, group = table.errors[:, column], table.group
    train = np.flatnonzero(~table.held_out)
    bounds = ConformalBound.fit(
        table.features[judging],
        error[judging],
        group[judging].tolist(),
        LEVEL,
        repeat,
        also=(table.features[train], error[train]),
    )
    bound = bounds.quantiles(table.features[counting], group[counting].tolist(), LEVELS)
    by_group = np.full(len(counting), np.inf)
    for g in np.unique(group):
        own = error[judging][group[judging] == g]
        if len(own) >= 9:
            by_group[group[counting] == g] = constant_bound(own, LEVEL)
    return bounds, HalfCount(
        repeat, counting, group[counting], error[counting], bound,
        constant_bound(error[judging], LEVEL), by_group,
    )  # fmt: skip


# --- tables -------------------------------------------------------------------------------------


def _reported(counted: Sequence[HalfCount]) -> list[HalfCount]:
    """Counts of splits on which no settings were chosen, or all if there are no such splits."""
    return [own for own in counted if own.repeat != CHOSEN_ON] or list(counted)


def _joined(counted: Sequence[HalfCount]) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Concatenate errors (n,), bounds (n,) at the level, groups (n,), constant bounds (n, 2)."""
    at = LEVELS.index(LEVEL)
    constant = np.concatenate(
        [np.column_stack((np.full(len(c.error), c.constant), c.constant_of_group)) for c in counted]
    )
    return (
        np.concatenate([c.error for c in counted]),
        np.concatenate([c.bound[at] for c in counted]),
        np.concatenate([c.group for c in counted]),
        constant,
    )


def _overall(what: str, counted: Sequence[HalfCount]) -> list[Row]:
    """Rows of the reported splits together, then of each split."""
    repeats = sorted({own.repeat for own in counted})
    parts = [("reported", _reported(counted))]
    parts += [(f"split {k}", [own for own in counted if own.repeat == k]) for k in repeats]
    return [{"error": what, "pushes": name, **_row(what, own)} for name, own in parts]


def _row(what: str, counted: Sequence[HalfCount]) -> Row:
    error, bound, group, constant = _joined(counted)
    unit, factor = WHAT[what]
    near = np.isfinite(bound)
    groups = [np.mean((error <= bound)[group == g]) for g in np.unique(group)]
    known = near & np.isfinite(constant[:, 1])
    mean = _mean(bound[near])
    by_group = _mean(constant[known, 1])
    row = {
        "counted": len(error),
        "unit": unit,
        "coverage": float(np.mean((error <= bound)[near])),
        "coverage_least_group": float(np.min(groups)),
        "coverage_of_counts_low": min(_coverage(own) for own in counted),
        "coverage_of_counts_high": max(_coverage(own) for own in counted),
        "no_data": float(np.mean(~near)),
        "bound_mean": factor * mean,
        "bound_median": factor * float(np.median(bound[near])),
        "constant": factor * _mean(constant[near, 0]),
        "coverage_constant": float(np.mean(error <= constant[:, 0])),
        "coverage_constant_least_group": float(
            min(np.mean((error <= constant[:, 0])[group == g]) for g in np.unique(group))
        ),
        "sharper": 1.0 - mean / _mean(constant[near, 0]),
        "rank_correlation": _rank_correlation(bound[near], error[near]),
    }
    if known.any():
        row["constant_by_group_mean"] = factor * by_group
        row["sharper_than_by_group"] = 1.0 - _mean(bound[known]) / by_group
    return row


def _trusted(what: str, counted: Sequence[HalfCount], names: Sequence[str]) -> list[Row]:
    error, bound, group, _ = _joined(counted)
    unit, factor = WHAT[what]
    own = [names[g] for g in group.tolist()]
    return trusted_rows(what, "random pushes", own, factor * error, {"bound": factor * bound}, unit)


def _coverage(own: HalfCount) -> float:
    return float(np.mean(own.error <= own.bound[LEVELS.index(LEVEL)]))


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if len(values) else float("inf")


def _rank_correlation(a: FloatArray, b: FloatArray) -> float:
    from scipy.stats import rankdata

    ranks = np.stack((rankdata(a), rankdata(b)))
    spread = ranks.std(axis=1)
    if not spread.all():
        return 0.0
    centred = ranks - ranks.mean(axis=1, keepdims=True)
    return float((centred[0] * centred[1]).mean() / spread.prod())


def _by_group(what: str, counted: Sequence[HalfCount], names: Sequence[str]) -> list[Row]:
    counted = _reported(counted)
    error, bound, group, constant = _joined(counted)
    unit, factor = WHAT[what]
    rows: list[Row] = []
    for g in np.unique(group).tolist():
        own = (group == g) & np.isfinite(bound)
        single = [np.mean((c.error <= c.bound[LEVELS.index(LEVEL)])[c.group == g]) for c in counted]
        rows.append(
            {
                "error": what,
                "group": names[g],
                "counted": int(own.sum()),
                "unit": unit,
                "coverage": float(np.mean((error <= bound)[group == g])),
                "coverage_sd_of_counts": float(np.std(single)),
                "coverage_constant": float(np.mean((error <= constant[:, 0])[group == g])),
                "error_mean": factor * float(np.mean(error[own])),
                "bound_mean": factor * _mean(bound[own]),
                "constant_of_group": factor * _mean(constant[own, 1]),
            }
        )
    return [{k: v for k, v in row.items() if v != float("inf")} for row in rows]


def _curve(what: str, counted: Sequence[HalfCount]) -> list[Row]:
    rows: list[Row] = []
    for k, level in enumerate(LEVELS):
        held = np.concatenate([own.error <= own.bound[k] for own in counted])
        rows.append({"error": what, "level": level, "coverage": float(held.mean())})
    return rows


def _conclusions(overall: Sequence[Row], groups: Sequence[Row]) -> list[str]:
    sentences = []
    for row in overall:
        if row["pushes"] != "reported":
            continue
        name = {"position": "Position", "angle": "Angle", "both": "Both, angles at 35 mm/rad"}
        sentences.append(
            f"{name[row['error']]}: {100 * LEVEL:g} % bounds cover {100 * row['coverage']:.1f} %"
            f" of {row['counted']} counts, {100 * row['coverage_least_group']:.1f} % in the worst"
            f" group; {row['bound_mean']:.2f} {row['unit']} on average against a constant"
            f" {row['constant']:.2f} ({100 * row['sharper']:.1f} % sharper)."
        )
    worst = min(groups, key=lambda row: float(row["coverage_constant"]))
    sentences.append(
        f"The constant bound covers {100 * worst['coverage_constant']:.0f} % only of"
        f" {worst['group']} ({worst['error']})."
    )
    return sentences


def _figure(
    counted: dict[str, list[HalfCount]], groups: list[Row], curve: list[Row]
) -> Callable[[], Figure]:
    error, bound, _, constant = _joined(_reported(counted["both"]))
    near = np.isfinite(bound) & np.isfinite(error)
    return partial(
        error_bounds_figure,
        groups=[row for row in groups if row["error"] == "both"],
        curve=curve,
        error=1e3 * error[near],
        bound=1e3 * bound[near],
        constant=1e3 * float(constant[:, 0].mean()),
        level=LEVEL,
    )
