"""Content of a report on results that are in no project."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from fixel.errors import InvalidInput
from fixel.io.atomic import written_whole
from fixel.model.fields import instance
from fixel.registry import offers
from fixel.results import Result
from fixel.workflows.report.content import Content, Figure, Section


def results_content(results: Sequence[Result], folder: Path, title: str = "") -> Content:
    """Collect tables and figures of results; the figures are drawn into an existing folder.

    Parameters
    ----------
    results : sequence of Result
    folder : Path
    title : str

    Raises
    ------
    InvalidInput
        There is no result, or another object.
    """
    if not results:
        raise InvalidInput("results", found="none", expected="at least one")
    sections = []
    for k, result in enumerate(results):
        instance(result, Result, f"results[{k}]", "a result, such as a Calibration")
        summary = result._summary()
        name = f"result_{k + 1}"
        sections.append(
            Section(
                title=summary.heading.partition(":")[0],
                anchor=name,
                lead=(summary.heading,),
                tables=tuple(summary.tables),
                figures=_figures(result, name, folder),
                notes=tuple(summary.notes),
            )
        )
    facts = (
        ("fixel", version("fixel")),
        ("Python", platform.python_version()),
        ("machine", f"{platform.system()}, {platform.machine()}"),
    )
    findings = tuple(section.lead[0] for section in sections)
    return Content(
        title=title or sections[0].title,
        banner="",
        facts=facts,
        warnings=(),
        findings=findings,
        sections=tuple(sections),
        methods=(),
    )


def _figures(result: Result, name: str, folder: Path) -> tuple[Figure, ...]:
    """Draw the usual plot of a result, if it has one."""
    if not offers(f"plots of {type(result).__name__}"):
        return ()
    from matplotlib import pyplot

    axes = result.plot()
    figure = (axes.flat[0] if hasattr(axes, "flat") else axes).figure
    for ending in ("png", "pdf"):
        with written_whole(folder / f"{name}.{ending}") as file:
            figure.savefig(file, dpi=300)
    pyplot.close(figure)
    return (Figure(name, type(result).__name__, folder / f"{name}.png"),)
