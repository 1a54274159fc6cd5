"""Error bounds on sides and at speeds that were never pushed, on real pushes.

Every side of every plate is held out once, and every speed of the plates with two. The calibration
is fitted to three quarters of the plate's other pushes; the rest of these are its pushes of known
sides. What bounds a new side is learned from left-out sides of the other plates. The same with
labels of sides dealt out at random shows how much of the error the side itself makes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.known_pushes import (
    Configurations,
    PushedContacts,
    TouchedPlaces,
    contacts_of,
)
from fixel.datasets.mit_push_records import TIP
from fixel.domain.error_bound import (
    CAUTIOUS,
    LEVEL,
    TYPICAL,
    ConformalBound,
    min_experiments,
)
from fixel.model import wrapped
from fixel.model.overlap import gaps_and_normals
from fixel.replay.base import Row
from fixel.typing import BoolArray, FloatArray, IntArray
from reproductions.charts.error_bounds import new_sides_figure
from reproductions.fitting import FittedPushes
from reproductions.protocols import BenchmarkData, calibrated_bench, full_fit
from reproductions.pushes import Key, PushGroup
from reproductions.residuals import evidence_of, split_without
from reproductions.result import Reproduction, RunOptions

SIDE: Final = "side"
SPEED: Final = "speed"
RANDOM: Final = "random"  # sides of the same sizes, dealt out at random
ERRORS: Final = {"position": ("mm", 1e3), "angle": ("deg", 180.0 / np.pi)}
BOUNDS: Final = ("blind", "bound", "typical", "cautious")
THRESHOLDS: Final = (3, 4, 5, 7)  # [mm] or [deg]
SMOOTH_SIDES: Final = 4  # of outlines with more corners than this many sides
MAX_SIDES: Final = 8
MIN_PUSHES: Final = 15  # on a side of its own
CONTROL_SEED: Final = 12345
FIRST_SEED: Final = 100


class LeftOut(NamedTuple):
    """One plate under a calibration without one of its sides or speeds."""

    key: Key
    unit: str  # that was left out
    features: FloatArray  # (n, f) of all pushes of the plate
    errors: FloatArray  # (n, 2) position [m], angle [rad]
    contacts: TouchedPlaces
    train: BoolArray  # (n,)
    new: BoolArray  # (n,) on the side, or at the speed, that was left out

    @property
    def known(self) -> BoolArray:
        """Held-out pushes of the other sides (n,)."""
        return ~(self.train | self.new)


def side_labels(group: PushGroup) -> IntArray:
    """Return the number of the side that each push begins on (n,).

    A side of a polygon, or a quarter of the directions of the normal of a smooth outline. Sides
    with a handful of pushes go to the largest.
    """
    _, normal = gaps_and_normals(group.shape, TIP.radius, group.start, group.tip_start)
    angle = wrapped(np.arctan2(normal[:, 1], normal[:, 0]) - group.start[:, 2])
    outline = getattr(group.shape, "outline", np.zeros((0, 2)))
    if 0 < len(outline) <= MAX_SIDES:
        edge = np.roll(outline, -1, axis=0) - outline
        outward = np.arctan2(-edge[:, 0], edge[:, 1])
        side = np.abs(wrapped(angle[:, None] - outward)).argmin(axis=1)
    else:
        quarter = 2.0 * np.pi / SMOOTH_SIDES
        side = (np.floor((angle + quarter) / quarter)).astype(np.int64) % SMOOTH_SIDES
    _, side, count = np.unique(side, return_inverse=True, return_counts=True)
    side = np.where((count < MIN_PUSHES)[side], count.argmax(), side)
    return np.asarray(np.unique(side, return_inverse=True)[1], np.int64)


def run(options: RunOptions) -> Reproduction:
    """Measure coverage and sharpness on new sides and speeds, and what the side itself costs.

    With `quick`, it uses three plates and few pushes.
    """
    bench = calibrated_bench(options)
    labels = {kind: _labels_by_plate(bench, kind) for kind in (SIDE, SPEED, RANDOM)}
    plates = sorted({key[1] for key in bench.rows})
    folds = max(int(own.max()) + 1 for own in labels[SIDE].values())
    fits = sum(int(own.max()) + 1 for kind in labels.values() for own in kind.values())
    bench.total = fits + len(ERRORS) * (len(plates) + folds)
    left = {kind: _left_out(bench, kind, own) for kind, own in labels.items()}
    overall: list[Row] = []
    groups: list[Row] = []
    trusted: list[Row] = []
    for column, name in enumerate(ERRORS):
        beyond = _beyond(bench, plates, left[SIDE] + left[SPEED], column)
        for kind in (SIDE, SPEED):
            counted = _counted(bench, left[kind], beyond, column)
            if counted is None:
                continue
            unit, factor = ERRORS[name]
            bounds = {what: factor * getattr(counted, what) for what in BOUNDS}
            trusted += trusted_rows(name, kind, counted.group, factor * counted.error, bounds, unit)
            overall += _overall(name, kind, counted)
            groups += _by_group(name, kind, counted)
    transfer = _transfer(left[SIDE], left[RANDOM])
    return Reproduction(
        tables={"overall": overall, "groups": groups, "trusted": trusted, "transfer": transfer},
        conclusions=_conclusions(overall, transfer, trusted),
        settings={"level": LEVEL, "quick": options.quick},
        figure=partial(new_sides_figure, groups, LEVEL),
    )


# --- calibrations without a side or a speed -------------------------------------------------------


def _labels_by_plate(bench: BenchmarkData, kind: str) -> dict[Key, IntArray]:
    found: dict[Key, IntArray] = {}
    for key, rows in bench.rows.items():
        if kind == SPEED:
            label = np.unique(np.round(bench.data.speed[rows], 6), return_inverse=True)[1]
        else:
            label = side_labels(bench.group(key))
        if kind == RANDOM:
            label = np.random.default_rng(CONTROL_SEED).permutation(label)
        if label.max() > 0:
            found[key] = label
    return found


def _left_out(bench: BenchmarkData, kind: str, labels: dict[Key, IntArray]) -> list[LeftOut]:
    found = []
    for key, label in labels.items():
        for side in range(int(label.max()) + 1):
            found.append(_one(bench, key, kind, label, side))
            bench.advance(f"without {kind} {side + 1} {' '.join(key)}")
    return found


def _one(bench: BenchmarkData, key: Key, kind: str, label: IntArray, side: int) -> LeftOut:
    group = bench.group(key)
    split = split_without(label, side, FIRST_SEED + side)
    fit = full_fit(bench, group, f"{kind}_{side}", split)
    speed = bench.data.speed[group.rows]
    configurations = Configurations(
        group.shape, TIP.radius, group.start, group.tip_start, group.tip_end
    )
    if kind == RANDOM:  # no bounds are made of these
        features, errors = np.zeros((len(group), 0)), _errors(group, fit)
    else:
        found = evidence_of(group, split, fit, speed)
        features, errors = found.features.table, found.errors[:, :2]
    return LeftOut(
        key,
        f"{' '.join(key)} {kind} {side + 1}",
        features,
        errors,
        contacts_of(configurations, speed),
        np.isin(np.arange(len(group)), split.train),
        label == side,
    )


def _errors(group: PushGroup, fit: FittedPushes) -> FloatArray:
    off = fit.predict(group, np.arange(len(group))) - group.end
    errors = np.column_stack((np.hypot(off[:, 0], off[:, 1]), np.abs(wrapped(off[:, 2]))))
    return np.where(np.isfinite(errors), errors, np.inf)


# --- bounds ---------------------------------------------------------------------------------------


class CoverageCount(NamedTuple):
    """Bounds on left-out pushes, and their errors."""

    group: list[str]
    error: FloatArray  # (m,)
    blind: FloatArray  # (m,) bound that ignores contacts
    bound: FloatArray  # (m,) bound for the contact; inf without data
    typical: FloatArray  # (m,) the same by the rule for an average new unit
    cautious: FloatArray  # (m,) the same by the rule for nearly any new unit
    new: BoolArray  # (m,) whether the contact is new


def _beyond(
    bench: BenchmarkData, plates: Sequence[str], left: Sequence[LeftOut], column: int
) -> dict[str, ConformalBound | None]:
    """Bounds for new sides and speeds of every plate, from those of the other plates."""
    found: dict[str, ConformalBound | None] = {}
    for plate in plates:
        others = [own for own in left if own.key[1] != plate]
        found[plate] = None
        if len(others) >= min_experiments(LEVEL):
            first = list({own.key: own for own in others}.values())
            features, errors = _rows(others, lambda own: own.new, column)
            found[plate] = ConformalBound.fit(
                features, errors, _spread(others, lambda own: own.key[1], lambda own: own.new),
                also=_rows(first, lambda own: ~own.new, column),
                units=_spread(others, lambda own: own.unit, lambda own: own.new),
            )  # fmt: skip
        bench.advance(f"other plates than {plate}")
    return found


def _counted(
    bench: BenchmarkData,
    left: Sequence[LeftOut],
    beyond: dict[str, ConformalBound | None],
    column: int,
) -> CoverageCount | None:
    """Bounds and errors of all left-out pushes; None where too few are left to judge any."""
    plates: dict[Key, list[LeftOut]] = {}
    for own in left:
        plates.setdefault(own.key, []).append(own)
    parts: list[tuple[Any, ...]] = []
    for k in range(max((len(own) for own in plates.values()), default=0)):
        # Every plate with its k-th side left out; of fewer sides the last judges again.
        use = [own[min(k, len(own) - 1)] for own in plates.values()]
        names = _spread(use, lambda own: " ".join(own.key), lambda own: own.known)
        contacts = TouchedPlaces.joined(
            [own.contacts.rows(np.flatnonzero(own.known)) for own in use]
        )
        features, errors = _rows(use, lambda own: own.known, column)
        bench.advance(f"bounds {k + 1}")
        if len(errors) < min_experiments(LEVEL):
            continue  # a quick look at few pushes
        also = _rows(use, lambda own: own.train, column)
        plain = ConformalBound.fit(features, errors, names, also=also)
        pushed = PushedContacts(contacts, names)
        for own in [own[k] for own in plates.values() if k < len(own)]:
            rows = np.flatnonzero(own.new)
            table, name = own.features[rows], [" ".join(own.key)] * len(rows)
            contact = own.contacts.rows(rows)
            bounds = plain.for_contacts(contacts, names, beyond[own.key[1]])
            kind = [kind for kind, _ in pushed.novelty(contact, name)]
            other = [
                bounds.with_rule(rule).bounds(table, name, contact) for rule in (TYPICAL, CAUTIOUS)
            ]
            parts.append((name, own.errors[rows, column], plain.bounds(table, name),
                          bounds.bounds(table, name, contact), *other,
                          np.array(kind) != ""))  # fmt: skip
    if not parts:
        return None
    return CoverageCount(
        [name for part in parts for name in part[0]],
        *(np.concatenate([part[j] for part in parts]) for j in range(1, 7)),
    )


def _rows(
    left: Sequence[LeftOut], which: Callable[[LeftOut], BoolArray], column: int
) -> tuple[FloatArray, FloatArray]:
    features = np.concatenate([own.features[which(own)] for own in left])
    return features, np.concatenate([own.errors[which(own), column] for own in left])


def _spread(
    left: Sequence[LeftOut], name: Callable[[LeftOut], str], which: Callable[[LeftOut], BoolArray]
) -> list[str]:
    return [text for own in left for text in [name(own)] * int(which(own).sum())]


# --- what is reported -----------------------------------------------------------------------------


def _overall(name: str, kind: str, counted: CoverageCount) -> list[Row]:
    return [
        {"error": name, "left_out": kind, "contacts": what, **_row(name, counted, which)}
        for what, which in (
            ("all", np.ones(len(counted.new), bool)),
            ("new", counted.new),
            ("like pushed ones", ~counted.new),
        )
        if which.any()
    ]


def _by_group(name: str, kind: str, counted: CoverageCount) -> list[Row]:
    group = np.array(counted.group)
    return [
        {"error": name, "left_out": kind, "group": own, **_row(name, counted, group == own)}
        for own in dict.fromkeys(counted.group)
    ]


def _row(name: str, counted: CoverageCount, which: BoolArray) -> Row:
    """Shares of the pushes that have a bound; the worst group of these."""
    unit, factor = ERRORS[name]
    group = np.array(counted.group)
    row: Row = {"counted": int(which.sum()), "unit": unit}
    row["error_mean"] = factor * float(counted.error[which & np.isfinite(counted.error)].mean())
    for what in BOUNDS:
        bound = getattr(counted, what)
        known = which & np.isfinite(bound)
        held = counted.error <= bound
        by_group = [
            (float(held[known & (group == own)].mean()), own)
            for own in dict.fromkeys(group[known].tolist())
        ]
        row[f"{what}_no_data"] = 1.0 - float(known.sum() / which.sum())
        if by_group:
            row[f"{what}_coverage"] = float(held[known].mean())
            row[f"{what}_worst"], row[f"{what}_worst_group"] = min(by_group)
            row[f"{what}_mean"] = factor * float(bound[known].mean())
    return row


def trusted_rows(
    name: str,
    kind: str,
    group: Sequence[str],
    error: FloatArray,
    bounds: Mapping[str, FloatArray],
    unit: str,
) -> list[Row]:
    """Count the pushes whose verdict is "trusted", and those of them that stay within tau.

    Parameters
    ----------
    name, kind : str
        Names of the error, and of what was held out.
    group : (m,) sequence of str
    error : (m,) float64
        Errors, in `unit`.
    bounds : mapping of str to (m,) float64
        Bounds of the errors by name, in `unit`.
    unit : str
    """
    names = np.array(group)
    rows: list[Row] = []
    for tau in THRESHOLDS:
        for what, bound in bounds.items():
            chosen = bound <= tau
            row: Row = {"error": name, "left_out": kind, "tau": tau, "unit": unit, "bound": what}
            rows.append(row | {"trusted": int(chosen.sum()), "pushes": len(error)})
            if chosen.any():
                by_group = [
                    (float((error <= tau)[chosen & (names == own)].mean()), own)
                    for own in dict.fromkeys(names[chosen].tolist())
                ]
                rows[-1]["within"] = float((error <= tau)[chosen].mean())
                rows[-1]["within_worst"], rows[-1]["within_worst_group"] = min(by_group)
            rows[-1]["all_within"] = float((error <= tau).mean())
    return rows


def _transfer(left: Sequence[LeftOut], control: Sequence[LeftOut]) -> list[Row]:
    """Errors of the same pushes, held out with their side and held out at random.

    Both calibrations have equally many training pushes.
    """
    rows: list[Row] = []
    with_side, at_random = _held_out_once(left), _held_out_once(control)
    for key, errors in with_side.items():
        other = at_random[key]
        both = np.isfinite(errors).all(axis=1) & np.isfinite(other).all(axis=1)
        rows.append({"group": " ".join(key), "pushes": int(both.sum())})
        for column, (name, (unit, factor)) in enumerate(ERRORS.items()):
            rows[-1][f"{name}_new_side_{unit}"] = factor * float(errors[both, column].mean())
            rows[-1][f"{name}_random_{unit}"] = factor * float(other[both, column].mean())
    total: Row = {"group": "all", "pushes": sum(row["pushes"] for row in rows)}
    for name in rows[0]:
        if name not in total:
            total[name] = sum(row["pushes"] * row[name] for row in rows) / total["pushes"]
    return [*rows, total]


def _held_out_once(left: Sequence[LeftOut]) -> dict[Key, FloatArray]:
    found: dict[Key, FloatArray] = {}
    for own in left:
        found.setdefault(own.key, np.full(own.errors.shape, np.nan))[own.new] = own.errors[own.new]
    return found


def _conclusions(
    overall: Sequence[Row], transfer: Sequence[Row], trusted: Sequence[Row]
) -> list[str]:
    sentences = []
    for row in overall:
        if row["contacts"] != "all" or "bound_coverage" not in row:
            continue
        sentences.append(
            f"{row['error'].capitalize()}, a {row['left_out']} never pushed: {100 * LEVEL:g} %"
            f" bounds hold for {100 * row['bound_coverage']:.1f} % of {row['counted']} pushes,"
            f" {100 * row['bound_worst']:.1f} % in the worst group ({row['bound_worst_group']}),"
            f" {row['bound_mean']:.2f} {row['unit']} on average, {100 * row['bound_no_data']:.1f} %"
            f" without data; blind to the contact {_blind(row)}."
        )
    sentences += [
        f"Trusted at {row['tau']} {row['unit']} ({row['error']}, a {row['left_out']} never pushed):"
        f" {row['trusted']} of {row['pushes']} pushes, {100 * row['within']:.1f} % of them within."
        for row in trusted
        if row["bound"] == "bound" and row["error"] == "position" and "within" in row
    ]
    total = transfer[-1]
    sentences.append(
        f"Errors on a new side {total['position_new_side_mm']:.2f} mm,"
        f" {total['angle_new_side_deg']:.2f} deg; of the same pushes held out at random, with"
        f" equally many training pushes, {total['position_random_mm']:.2f} mm,"
        f" {total['angle_random_deg']:.2f} deg."
    )
    return sentences


def _blind(row: Row) -> str:
    if "blind_coverage" not in row:  # a speed is new in its features as well
        return "no data"
    return (
        f"{100 * row['blind_coverage']:.1f} %, {100 * row['blind_worst']:.1f} % and"
        f" {row['blind_mean']:.2f} {row['unit']}"
    )
