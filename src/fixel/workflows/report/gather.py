"""Collect everything that a project knows about one calibration, in the order of a report."""

from __future__ import annotations

import platform
import shutil
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final

from fixel.database.project import Project
from fixel.typing import FloatArray, Notify
from fixel.workflows.analysis import Kind, StoredAnalysis, kept
from fixel.workflows.calibration.detail import misfit_of
from fixel.workflows.calibration.run import Calibration, reopened
from fixel.workflows.calibration.stored import CalibratedValues, calibrated
from fixel.workflows.figures import ENDINGS
from fixel.workflows.report.content import Content, Figure, Section
from fixel.workflows.report.of_calibration import (
    calibration_warnings,
    errors_section,
    figures_of,
    headline,
    methods,
    parameters_section,
)
from fixel.workflows.report.of_data import ReportData, data_of, data_section, data_warnings

# Kinds of analyses in the order of a report, with the titles of their sections.
WANTED: Final[dict[Kind, str]] = {
    "tracking": "What the camera saw beside what really happened",
    "domain": "Where the calibrated simulator can be trusted",
    "growth": "The domain of applicability, as the thesis grew it",
    "sensitivity": "How far the start decides the outcome",
    "uncertainty": "What is not known, and what follows from it",
}
MISSING: Final[dict[Kind, str]] = {
    "domain": "Nobody has tried the parameters on experiments that they were not fitted to. All"
    " errors here are of the fit: run fixel domain.",
    "sensitivity": "Nobody has asked how far small errors of the start decide the outcome: run"
    " fixel sensitivity.",
    "uncertainty": "Nobody has asked what follows from what is not known about the parameters: run"
    " fixel uncertainty.",
}


def gather(
    project: Project, number: int | None, folder: Path, title: str, notify: Notify | None = None
) -> Content:
    """Collect the content of a report, and draw its figures into a folder.

    Parameters
    ----------
    project : Project
    number : int, optional
        Id of the calibration; by default the newest for several experiments.
    folder : Path
        Existing folder for figures.
    title : str
        Title of the report; an empty one is replaced by one with the project's name.
    notify : callable, optional
        Called with a sentence before each part of the work.
    """
    tell = notify or (lambda _: None)
    with project.store() as store:
        one = calibrated(store, number)
        ids = sorted(one.members)
        data = data_of(store, ids)
        checksum = store.checksum(ids)
    keys = {summary.id: summary.key for summary in data.summaries}
    opened = reopened(project, one.record)
    tell("drawing the calibration")
    figures = figures_of(opened, folder) if opened is not None else []
    analyses = _analyses(project, one)
    tell("collecting the analyses")
    sections = [
        data_section(data),
        errors_section(one, _nominal(opened, one), keys, figures),
        parameters_section(one, figures),
        *(_section(answer, folder) for answer in analyses),
    ]
    return Content(
        title=title or f"How far to believe the simulator of {project.settings.name}",
        banner=data.banner,
        facts=_facts(project, one, data, checksum),
        warnings=tuple(_warnings(one, data, keys, analyses)),
        findings=(
            headline(one, _nominal(opened, one)),
            *(answer.analysis.headline[0] for answer in analyses if answer.analysis.headline),
        ),
        sections=tuple(sections),
        methods=tuple(_methods(one, data, analyses)),
        references=("stewart1996", *_references(one, analyses)),
        commands=tuple(_commands(one, analyses)),
    )


def _analyses(project: Project, one: CalibratedValues) -> list[StoredAnalysis]:
    """Select the newest analysis of each kind that used this calibration or its experiments."""
    found = []
    for kind in WANTED:
        fitting = [own for own in kept(project, kind) if _fits(own, one)]
        found += fitting[:1]
    return found


def _fits(own: StoredAnalysis, one: CalibratedValues) -> bool:
    if own.analysis.calibrations:
        return one.id in own.analysis.calibrations or bool(
            one.members & set(own.analysis.experiments)
        )
    return bool(one.members & set(own.analysis.experiments))


def _nominal(opened: Calibration | None, one: CalibratedValues) -> FloatArray | None:
    """(n_member,) errors before the calibration, in the order of its members."""
    if opened is None or one.id not in opened.ids:
        return None
    found = opened.outcome.found[opened.ids.index(one.id)]
    return opened.outcome.nominal[list(found.members)]


def _section(answer: StoredAnalysis, folder: Path) -> Section:
    analysis = answer.analysis
    figures = []
    for picture in analysis.pictures:
        name = f"{analysis.kind}_{picture.name}"
        for ending in ENDINGS:
            source = answer.picture(picture.name, ending)
            if source.is_file():
                shutil.copyfile(source, folder / f"{name}.{ending}")
        figures.append(Figure(name=name, caption=picture.caption, png=folder / f"{name}.png"))
    return Section(
        title=WANTED[analysis.kind],
        anchor=analysis.kind,
        lead=analysis.headline,
        tables=analysis.tables,
        figures=tuple(figures),
        commands=(analysis.command,) if analysis.command else (),
    )


def _warnings(
    one: CalibratedValues,
    data: ReportData,
    keys: dict[int, str],
    analyses: Sequence[StoredAnalysis],
) -> list[str]:
    there = {answer.analysis.kind for answer in analyses}
    found = [
        *data_warnings(data),
        *(words for kind, words in MISSING.items() if kind not in there),
        *misfit_of(one.record),  # first: it decides how far to trust the rest
        *(
            words
            for answer in analyses
            for words in answer.analysis.warnings
            if not words.endswith(tuple(misfit_of(one.record)[:1]))
        ),
        *calibration_warnings(one, keys),
    ]
    return list(dict.fromkeys(found))


def _facts(
    project: Project, one: CalibratedValues, data: ReportData, checksum: str
) -> tuple[tuple[str, str], ...]:
    made = one.record.provenance
    seed = "" if made.seed is None else str(made.seed)
    facts = (
        ("project", project.settings.name),
        ("calibration", f"{one.id}: {one.record.name}"),
        ("made on", made.created[:19].replace("T", " ")),
        ("made by", made.command),
        ("seed", seed),
        ("experiments", str(len(data.summaries))),
        ("checksum of their data", checksum[:16]),
        ("fixel", version("fixel")),
        ("calibrated with fixel", made.version),
        ("Python", platform.python_version()),
        ("machine", f"{platform.system()}, {platform.machine()}"),
    )
    return tuple((name, value) for name, value in facts if value)


def _methods(
    one: CalibratedValues, data: ReportData, analyses: Sequence[StoredAnalysis]
) -> list[str]:
    n = len(data.summaries)
    kind = "simulated" if data.simulated == n else "recorded"
    first = f"{n} {kind} experiment{'s' * (n != 1)} were simulated with fixel {version('fixel')}."
    own = [sentence for answer in analyses for sentence in answer.analysis.methods]
    return [first, *methods(one), *own]


def _references(one: CalibratedValues, analyses: Sequence[StoredAnalysis]) -> list[str]:
    search = {"pattern-search": "torczon1997", "nelder-mead": "nelder1965"}
    found = [search.get(str(one.record.method.get("optimiser")), "")]
    found += ["raue2009"] if one.record.estimates else []
    return [*found, *(key for answer in analyses for key in answer.analysis.references)]


def _commands(one: CalibratedValues, analyses: Sequence[StoredAnalysis]) -> list[str]:
    own = [one.record.provenance.command, *(answer.analysis.command for answer in analyses)]
    return [command for command in dict.fromkeys(own) if command]
