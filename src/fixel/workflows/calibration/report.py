"""Report of calibrations for the command `fixel calibrate` and its page."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from fixel.calibration.usual_parameters import known_parameters
from fixel.table import Table
from fixel.workflows.analysis import AnalysisReport
from fixel.workflows.calibration.calibration import Calibrations
from fixel.workflows.calibration.charts import pictures_of

if TYPE_CHECKING:
    from fixel.workflows.analysis import StoredAnswer

JSON: Final = ("pictures",)  # what `--json` has besides numbers


def report_of(found: Calibrations) -> AnalysisReport:
    """Return the report of the calibrations of a run."""
    ids = f"{', '.join(map(str, found.ids[:3]))}{', ...' * (len(found.ids) > 3)}"
    stored = f"stored as calibration {ids}; job {found.folder}"
    notes, numbers = (*found.analysis.notes, stored), found.summary()
    analysis = found.analysis.model_copy(update={"notes": notes, "numbers": numbers})
    return AnalysisReport(analysis, pictures_of(found))


def about() -> tuple[Table, ...]:
    """Return the tables that a form shows: parameters that can be calibrated."""
    return (replace(known_parameters(), title="Parameters that can be calibrated"),)


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that compares the worst experiment with its simulation."""
    run = done.result
    fits = [run.joint] if run.joint else run.each or [*run]
    fit = max(fits, key=lambda one: float(one.found.errors.max()))
    worst = fit.keys_of_experiments[int(fit.found.errors.argmax())]
    table = ["--table", run.asked["table"]] if run.asked.get("table") else []
    return ["compare", worst, "--calibration", str(run.ids[fit.number]), *table]
