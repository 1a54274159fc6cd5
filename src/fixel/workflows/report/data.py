"""Report section on the experiments: their number, kinds and faults."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from fixel.database.query import ALL_EXPERIMENTS
from fixel.database.store import Store
from fixel.model.selection import ExperimentQuery, ExperimentRow
from fixel.model.trajectory import turned
from fixel.table import Table
from fixel.workflows.report.content import Section
from fixel.workflows.sentences import sentences

MAX_VALUES: Final = 8  # values of one condition that are written out
FEW_EXPERIMENTS: Final = 10  # number of experiments below which little can be concluded


@final
@dataclass(frozen=True)
class ReportData:
    """Experiments of a report."""

    summaries: list[ExperimentRow]  # experiments that are used
    flags: Mapping[str, int]  # how many experiments of the project carry each flag
    left_out: int  # number of experiments of the project that are left out for their flags

    @property
    def simulated(self) -> int:
        """Number of simulated experiments."""
        return sum(not summary.is_real for summary in self.summaries)

    @property
    def banner(self) -> str:
        """Banner over the report; empty if all experiments are real."""
        if not self.simulated:
            return ""
        if self.simulated == len(self.summaries):
            return "All experiments are SIMULATED; none was recorded"
        return f"{self.simulated} of {len(self.summaries)} experiments are SIMULATED"

    @cached_property
    def conditions(self) -> dict[str, list[str | float]]:
        """Values of each condition that differs among the experiments."""
        found: dict[str, set[str | float]] = {}
        for summary in self.summaries:
            for name, value in summary.conditions.items():
                if not name.startswith("truth_"):
                    found.setdefault(name, set()).add(value)
        return {name: sorted(v, key=_in_order) for name, v in sorted(found.items()) if len(v) > 1}


def data_of(store: Store, ids: Sequence[int]) -> ReportData:
    """Load the summaries and flags of experiments."""
    listed = store.experiments(ALL_EXPERIMENTS).rows
    wanted = set(ids)
    clean = store.experiments(ExperimentQuery())
    return ReportData([s for s in listed if s.id in wanted], store.flags(), clean.left_out)


def data_section(data: ReportData) -> Section:
    """Build the section on the experiments and their conditions."""
    summaries = data.summaries
    sets = Counter(summary.dataset for summary in summaries)
    frames = np.array([s.n_frame for s in summaries])
    lasted = np.array([s.duration_s for s in summaries])
    start = np.array([(s.start_x_m, s.start_y_m, s.start_theta_rad) for s in summaries])
    end = np.array([(s.end_x_m, s.end_y_m, s.end_theta_rad) for s in summaries])
    moved = 1e3 * np.hypot(*(end - start)[:, :2].T)
    angle = np.degrees(
        [abs(turned(s.start_theta_rad, s.end_theta_rad, s.n_frame)) for s in summaries]
    )
    rows = (
        ("frames of an experiment", *_spread(frames)),
        ("duration [s]", *_spread(lasted)),
        ("object moved [mm]", *_spread(moved)),
        ("object turned [deg]", *_spread(angle)),
    )
    tables = [Table(("", "least", "median", "most"), rows, title="Experiments")]
    if data.conditions:
        tables.append(_conditions(data))
    if data.flags:
        title = "Flags on the data of this project"
        tables.append(Table(("flag", "experiments"), sorted(data.flags.items()), title=title))
    return Section(
        title="Measurements",
        anchor="data",
        lead=sentences(
            "data", "counted", n=len(summaries), simulated=data.simulated, sets=sorted(sets.items())
        ),
        tables=tuple(tables),
        commands=("fixel list",),
    )


def data_warnings(data: ReportData) -> tuple[str, ...]:
    """Return warnings about the experiments."""
    return sentences(
        "data",
        "warnings",
        simulated=data.simulated,
        n=len(data.summaries),
        few=FEW_EXPERIMENTS,
        left_out=data.left_out,
    )


def _spread(values: np.ndarray) -> tuple[str, str, str]:
    return f"{values.min():.4g}", f"{np.median(values):.4g}", f"{values.max():.4g}"


def _conditions(data: ReportData) -> Table:
    rows = []
    for name, values in data.conditions.items():
        shown = [_plain(value) for value in values]
        if len(shown) > MAX_VALUES:
            shown = [*shown[: MAX_VALUES // 2], "...", *shown[-MAX_VALUES // 2 :]]
        rows.append((name, str(len(values)), ", ".join(shown)))
    return Table(("condition", "values", "which"), rows, title="Conditions that differ")


def _in_order(value: str | float) -> tuple[bool, float, str]:
    """Sort key: numbers by size, then words alphabetically."""
    words = isinstance(value, str)
    return words, 0.0 if isinstance(value, str) else value, str(value)


def _plain(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
