"""Text output of `fixel calibrate`: tables of parameters, verdicts, the next command."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fixel.calibration.misfit import WARNED
from fixel.calibration.objective import Robust
from fixel.cli.screen import compare_command, seconds, table
from fixel.model.records import Estimate, interval_name
from fixel.workflows.calibration.calibration import Calibrations
from fixel.workflows.calibration.commands import PRESSURE, enlarged_command
from fixel.workflows.calibration.result import FitKind, ParameterSet, length_of, outliers

MAX_ROWS = 20
ENDS = ("at least", "at most")
MAX_OUTLIERS = 5
BEST_FIT = (
    "Quote the values. Simulations use the best fit, {}: with a wrong model, the parameters that "
    "predict best differ from the true ones."
)


def lines_of(done: Calibrations, folder: Path, pictures: list[Path]) -> list[str]:
    """Return the lines to print."""
    outcome = done.outcome
    lines = [*done.skipped]
    if done.request.sample_of is not None:
        lines.append(
            f"a random sample of {len(outcome.keys)} of {done.request.sample_of} experiments"
            f" (seed {done.request.seed})"
        )
    if outcome.alone:
        lines += [*_alone_lines(done), ""]
    for one in outcome.together:
        lines += [*_together_lines(done, one), ""]
    lines += [f"wrote {path}" for path in pictures]
    ids = ", ".join(map(str, done.ids[:3])) + (", ..." if len(done.ids) > 3 else "")
    lines.append(f"stored as calibration {ids}; job {done.folder}")
    lines.append(f"Next: {_next(done, folder)}")
    return lines


def _next(done: Calibrations, folder: Path) -> str:
    """Return the command that compares the worst experiment with its simulation."""
    outcome, space = done.outcome, done.request.space
    one = outcome.together[-1] if outcome.together else max(_best_alone(done), key=_worst)
    target = done.targets[one.members[int(one.errors.argmax())]]
    columns = space.columns(one.values(space.labels)[None], target.conditions)
    values = {name: float(column[0]) for name, column in columns.items()}
    return compare_command(target.key, values, done.request.motion, folder)


def _worst(one: ParameterSet) -> float:
    return float(one.errors.max())


def _best_alone(done: Calibrations) -> list[ParameterSet]:
    """Select one set per experiment: a neighbour's follows its own, and only if it is better."""
    return list({one.members: one for one in done.outcome.alone}.values())


def _alone_lines(done: Calibrations) -> list[str]:
    outcome, unit = done.outcome, done.request.made_error.unit
    alone = _best_alone(done)
    if len(alone) == 1:
        return _together_lines(done, alone[0])
    free = done.request.space.free
    head = ("experiment", "before [mm]", "after [mm]", *(_headed(u) for u in free))
    rows = [
        (
            outcome.keys[one.members[0]] + ("" if one.how == FitKind.ALONE else f" ({one.how})"),
            f"{length_of(outcome.nominal[one.members[0]], unit):.4g}",
            f"{length_of(one.errors[0], unit):.4g}",
            *(f"{_shown(u.unit, x):.4g}" for u, x in zip(free, one.point, strict=True)),
        )
        for one in alone[:MAX_ROWS]
    ]
    more = len(alone) - len(rows)
    lines = table(head, rows) + ([f"... and {more} more; --json has them all"] if more > 0 else [])
    return lines + _verdicts(outcome.alone, [u.label for u in free])


def _verdicts(alone: Sequence[ParameterSet], labels: list[str]) -> list[str]:
    """Count how often each parameter has which verdict."""
    counts: dict[str, Counter[str]] = {label: Counter() for label in labels}
    for estimate in (e for one in alone for e in one.estimates if e.label in counts):
        counts[estimate.label][estimate.verdict.partition(" with ")[0]] += 1
    return [
        f"  {label}: " + ", ".join(f"{word} in {n}" for word, n in own.most_common())
        for label, own in counts.items()
        if own
    ]


def _together_lines(done: Calibrations, one: Any) -> list[str]:
    outcome, unit = done.outcome, done.request.made_error.unit
    members = list(one.members)
    before, after = outcome.nominal[members], one.errors
    n = len(members)
    of = outcome.keys[members[0]] if n == 1 else f"{n} experiments"
    means, largest = (
        " -> ".join(f"{length_of(error, unit):.4g}" for error in pair)
        for pair in ((before.mean(), after.mean()), (before.max(), after.max()))
    )
    lines = [f"{of}, {one.how}: RMS error {means} mm"]
    if n > 1:
        lines[0] += f", largest {largest}"
    if one.trace is not None:
        lines.append(
            f"{len(one.trace.errors)} evaluations in {seconds(one.seconds)}; {one.trace.ended}"
        )
    lines = [*one.misfit, *lines]  # first: it decides how far to trust the rest
    lines += [sentence for sentence in (one.note, one.noise) if sentence]
    lines += _outlier_lines(done, one)
    if len(one.solutions) > 1:
        lines.append(f"{len(one.solutions)} distinct parameter sets fit almost equally well")
    free = done.request.space.free
    pairs = zip(free, one.values(done.request.space.labels).tolist(), strict=True)
    rows = [row for u, value in pairs for row in _rows_of(u, value, one)]
    head = ("parameter", "value", "unit", interval_name(done.request.level), "verdict")
    lines += table(head, rows) if one.estimates else table(head[:3], [row[:3] for row in rows])
    lines += [f"  {e.label}: {e.reason}" for e in one.estimates if e.reason]
    if one.misfit and one.estimates:
        fitted = zip(free, one.point.tolist(), strict=True)
        lines.append(
            BEST_FIT.format(", ".join(f"{u.label} {_shown(u.unit, x):.4g}" for u, x in fitted))
        )
    larger = enlarged_command(done.command, done.request) if one.misfit_ratio >= WARNED else ""
    if not larger:
        return lines
    what = "calibrate the centre of pressure, too"
    if PRESSURE in larger:
        what = "calibrate with uniform pressure and a free centre of pressure"
    return [*lines, f"Next, {what}:", f"  {larger}"]


def _outlier_lines(done: Calibrations, one: ParameterSet) -> list[str]:
    """Name the outliers, and what to do about them."""
    unit = done.request.made_error.unit
    found = outliers(one.errors, unit)
    if not found:
        return []
    named = ", ".join(
        f"{done.outcome.keys[one.members[k]]} ({length_of(one.errors[k], unit):.3g} mm)"
        for k in found[:MAX_OUTLIERS]
    )
    more = f" and {len(found) - MAX_OUTLIERS} more" if len(found) > MAX_OUTLIERS else ""
    known = one.errors[np.isfinite(one.errors)]
    share = float(one.errors[found].sum() / known.sum())
    lines = [
        f"{len(found)} of {len(one.errors)} experiments are outliers, with {100 * share:.0f} % of "
        f"the summed error: {named}{more}"
    ]
    if done.request.error.name != Robust.name:
        lines.append(f"To reduce their weight, add: --error {Robust.name}")
    return lines


def _rows_of(unknown: Any, value: float, one: Any) -> list[tuple[str, ...]]:
    """Build a row with the value and its interval, and below it those from noise alone."""
    unit = {"m": "mm", "rad": "deg"}.get(unknown.unit, unknown.unit)
    shown = f"{_shown(unknown.unit, value):.4g}"
    estimate = next((e for e in one.estimates if e.label == unknown.label), None)
    if estimate is None:
        return [(unknown.label, shown, unit, "", "")]
    interval, written = _interval(estimate)
    verdict = " ".join([estimate.verdict, *_known_end(estimate.verdict, written)])
    rows: list[tuple[str, ...]] = [(unknown.label, shown, unit, interval, verdict)]
    if (narrow := estimate.noise_alone) is not None:
        value = _shown(unknown.unit, narrow.value)
        rows.append(("  noise alone", f"{value:.4g}", unit, _interval(narrow)[0], ""))
    return rows


def _interval(estimate: Estimate) -> tuple[str, list[str]]:
    """Return an interval as text, and its two ends, which are empty where it is open."""
    ends = (estimate.low, estimate.high)
    written = ["" if x is None else f"{_shown(estimate.unit, x):.4g}" for x in ends]
    return f"{written[0]} .. {written[1]}" if any(written) else "none", written


def _known_end(verdict: str, written: list[str]) -> list[str]:
    """Return the end of the interval that a one-sided verdict is about, as formatted."""
    return [written[ENDS.index(verdict)]] if verdict in ENDS else []


def _headed(unknown: Any) -> str:
    unit = {"m": "mm", "rad": "deg"}.get(unknown.unit, unknown.unit)
    return f"{unknown.label} [{unit}]"


def _shown(unit: str, value: float) -> float:
    """Convert a value to the unit for display: mm and degrees."""
    return value * {"m": 1e3, "rad": 57.29577951308232}.get(unit, 1.0)
