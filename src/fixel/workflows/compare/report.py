"""Report of a comparison of an experiment with its simulation."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees
from pathlib import Path
from typing import Any

from fixel.drawing.chart import save_figure
from fixel.drawing.experiment import comparison_figure
from fixel.table import Column, Table
from fixel.workflows.analysis import Analysis, AnalysisReport, StoredAnswer
from fixel.workflows.compare.run import StoredComparison
from fixel.workflows.project.compare import PathComparison, RunComparison, length_unit
from fixel.workflows.sentences import origin_of


def report_of(found: StoredComparison) -> AnalysisReport:
    """Return headline, tables and numbers of a comparison."""
    run, experiment = found.run, found.experiment
    notes = [] if found.simulation_id is None else [f"stored as simulation {found.simulation_id}"]
    return AnalysisReport(
        Analysis(
            kind="compare",
            title=f"Comparison of {experiment.key} with a simulation",
            question={"experiment": experiment.key},
            headline=(origin_of(experiment), *_status(run), *_modes("", run),
                      *_modes("by the publisher, ", found.published)),
            warnings=tuple(f"Unseen: {text}" for text in found.unseen),
            tables=tuple(table for table in _tables(found) if table.rows),
            notes=tuple(notes),
            numbers=_numbers(found),
            calibrations=() if found.calibration is None else (found.calibration,),
            experiments=(found.experiment_id,),
            seconds=0.0 if run is None else run.simulation.wall_time_s,
        )
    )  # fmt: skip


def draw(found: StoredComparison, path: Path) -> None:
    """Draw measured and simulated motion into a file."""
    shown = found.run or found.published
    assert shown is not None  # one of them was compared
    pair = shown.simulated, shown.contacts
    save_figure(lambda: comparison_figure(found.experiment, *pair), path)


def failed(found: StoredComparison) -> bool:
    """Whether the simulation stopped before the end of the measurement."""
    return found.run is not None and not found.run.complete


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that most users need next."""
    found: StoredComparison = done.result
    if not done.drawn:
        return [*done.again, "--plot", f"{found.experiment.name.replace('/', '-')}.png"]
    if found.run is None:
        return ["show", found.experiment.key]
    if found.simulation_id is None:
        return [*done.again, "--save"]
    return ["compare", found.experiment.key, "--set", "mu_pusher=0.2"]


def _numbers(found: StoredComparison) -> dict[str, Any]:
    own: dict[str, Any] = {"experiment": found.experiment.key}
    if found.run is not None:
        own = {"unseen": list(found.unseen)} | found.run.summary()
        own |= {"simulation_id": found.simulation_id}
    by_publisher = {} if found.published is None else {"by_publisher": found.published.errors()}
    return own | {"experiment_id": found.experiment_id} | by_publisher


def _status(run: RunComparison | None) -> list[str]:
    if run is None:
        return ["no scene, so fixel cannot simulate it"]
    first, last = run.time[0], run.time[-1]
    if run.complete:
        return [f"{run.status}; {len(run.time)} frames from {first:.4g} to {last:.4g} s"]
    stopped = run.simulation.stopped_at
    return [
        f"{run.status}, stopped at {stopped:.6g} s: no error can be computed",
        run.simulation.advice,
    ]


def _modes(by: str, run: PathComparison | None) -> list[str]:
    if run is None or not run.contact_mode:
        return []
    measured = run.experiment.contact_mode or "not known"
    verdict = {True: ", the same", False: ", different", None: ""}[run.same_contact_mode]
    what = "measured" if run.experiment.real else "recorded"
    return [f"{by}contact mode, {what} {measured}, simulated {run.contact_mode}{verdict}"]


def _tables(found: StoredComparison) -> Iterator[Table]:
    values = {} if found.run is None else found.run.parameters
    yield Table(("parameter", Column("value", format=".6g")), list(values.items()))
    unit, metre = length_unit(found.experiment)
    every = {"fixel": found.run, "the publisher of the data": found.published}
    shown = [(name, run) for name, run in every.items() if run is not None and run.complete]
    rows = [
        (
            name,
            *(None if x is None else x / metre for x in (run.position_rms, run.final_position)),
            None if run.final_angle is None else degrees(run.final_angle),
            # The thesis's E weighs angles for objects of its own size.
            *([run.error_mm2] if unit == "mm" else []),
        )
        for name, run in shown
    ]
    lengths = (Column(f"position, {which}", unit, ".3f") for which in ("rms", "at end"))
    weighed = [Column("E, 35 mm/rad", "mm^2", ".3f")] if unit == "mm" else []
    columns: tuple[Column | str, ...]
    columns = ("simulation by", *lengths, Column("angle, at end", "deg", ".3f"), *weighed)
    yield Table(columns, rows)
