"""Calibration while a campaign runs; called in a process of its own."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from fixel.calibration.usual_parameters import Space
from fixel.errors import unknown_name
from fixel.model import Experiment, PlannedExperiment
from fixel.model.space import split_label
from fixel.simulation.motion import motion_model
from fixel.table import Table
from fixel.workflows.bench.estimates import LiveEstimates, Until, choose, estimate
from fixel.workflows.calibration.parameter_options import searched_unknowns

AHEAD: Final = 5  # rows after which the intervals are predicted


class LiveAnswer(NamedTuple):
    """Estimates so far, and the row to perform next."""

    estimates: LiveEstimates
    table: Table
    chosen: str  # name of the row; empty if none was chosen
    words: tuple[str, ...]  # what was found, in sentences
    finish: str  # why no more experiments are needed; empty if they are
    seconds: float  # duration of the computation [s]


def check_wishes(
    rows: Sequence[PlannedExperiment], fit: Sequence[str], motion: str, until: str
) -> None:
    """Raise `InvalidInput` for what could not be estimated, before the first push."""
    motion_model(motion)
    names = {own.name for own in searched_unknowns(fit, [row.scene for row in rows])}
    for label in Until.parse(until).wanted if until else ():
        if names and split_label(label)[0] not in names:
            raise unknown_name("until", label, names)


def estimate_rows(
    experiments: Sequence[Experiment],
    space: Space,
    motion: str,
    until: str,
    left: Sequence[PlannedExperiment],
    choosing: bool,
    previous: LiveEstimates | None,
) -> LiveAnswer:
    """Calibrate the experiments so far, and choose the next of the rows that are left if asked.

    `until` has the wanted intervals as text, or is empty. If no experiment informs the parameters,
    raise `InvalidInput`.
    """
    begun = time.monotonic()
    aims = Until.parse(until) if until else None
    if aims is not None and previous is None and len(experiments) > 1:
        # Intervals must be narrow twice in a row, also after a pause of the campaign.
        previous = estimate(experiments[:-1], space, motion=motion)
    known = estimate(experiments, space, motion=motion, previous=previous)
    wanted: Mapping[str, float] = {} if aims is None else aims.wanted
    finish = aims.words(known) if aims is not None and aims.met(known) else ""
    words = [
        f"Error of experiments predicted from the others: {1e3 * known.held_out_error:.2f} mm."
    ]
    chosen = ""
    if choosing and left and not finish:
        choice = choose(known, left, wanted)
        words.append(choice.reason)
        if choice.index is None:
            finish = choice.reason
        else:
            chosen = left[choice.index].name
    table = _table(known, wanted, known.ahead(left, AHEAD), min(AHEAD, len(left)))
    return LiveAnswer(known, table, chosen, tuple(words), finish, time.monotonic() - begun)


def _table(
    known: LiveEstimates, wanted: Mapping[str, float], ahead: Mapping[str, float], n: int
) -> Table:
    """Return the estimates with their half-widths, now and after the next rows."""
    rows = []
    for own in known.calibration.estimates.values():
        halves = (known.half_widths.get(own.label), ahead.get(own.label) if n else None)
        # Wider than its bounds, an interval says nothing.
        most = math.inf if own.bounds is None else 0.5 * (own.bounds[1] - own.bounds[0])
        texts = ["-" if half is None or half >= most else own.text(half) for half in halves]
        goal = own.text(wanted[own.label]) if own.label in wanted else "-"
        rows.append((own.label, own.value_text, *texts, goal, own.verdict_text))
    head = ("parameter", "value", "+/-", f"+/- after {n} more", "wanted", "verdict")
    return Table(head, rows, left=6)
