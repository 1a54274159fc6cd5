"""Collect everything that a project knows about a calibration, and write it as one HTML file."""

from __future__ import annotations

import base64
import io
import os
import platform
import re
import shlex
import shutil
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

from fixel.calibration.result import CalibratedValues
from fixel.database.project import Project
from fixel.drawing.chart import save_figure
from fixel.errors import InvalidInput
from fixel.io.atomic import write_whole
from fixel.model.fields import instance, path_of
from fixel.registry import offers
from fixel.results import Result
from fixel.trust import repeatable
from fixel.typing import Notify
from fixel.workflows.analysis import ENDINGS, StoredAnalysis, load_analyses, new_folder
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.stored import load_values, stored_calibration, stored_in_run
from fixel.workflows.report import sections
from fixel.workflows.report.sections import Content, Figure, ReportData, Section
from fixel.workflows.sentences import environment, sentences

PAGE: Final = "report.html"
FIGURES: Final = "figures"
BIBLIOGRAPHY: Final = "cite.bib"
MAX_PAGE_BYTES: Final = 10_000_000  # largest size of the page [byte]
PER_INCH: Final = 116  # of a picture, on the page [pixel]: a figure of two columns fills it
WIDEST: Final = 1500  # largest width of a picture on the page [pixel]; its PDF has full detail

_ENTRY: Final = re.compile(r"^@\w+\{(\w+),\n.*?^\}\n", re.MULTILINE | re.DOTALL)
_FIELD: Final = re.compile(r"^  (\w+) = \{(.*)\},$", re.MULTILINE)
OWN: Final = "fixel"  # key of the program itself

# BibTeX notation, and how people read it.
READ: Final = {'{\\"u}': "ü", "{\\`e}": "è", "{": "", "}": ""}

# Kinds of analyses in the order of a report, with the titles of their sections.
WANTED: Final[dict[str, str]] = {
    "tracking": "Tracked poses and true poses",
    "domain": "Domain of applicability",
    "error-bound": "Error bounds of untried pushes",
    "growth": "Domain of applicability, grown as in the thesis",
    "sensitivity": "Sensitivity to the start pose",
    "uncertainty": "Parameter uncertainty and predictions",
    "plan": "Plan of pushes and its success probability",
}


class Report(NamedTuple):
    """Report that was written."""

    page: Path
    bibliography: Path
    figures: list[Path]  # PDF files
    content: Content
    size: int  # size of the page [byte]

    def summary(self) -> dict[str, Any]:
        """Return plain values, for `--json`."""
        return {
            "report": str(self.page),
            "bibliography": str(self.bibliography),
            "figures": [str(path) for path in self.figures],
            "bytes": self.size,
            "title": self.content.title,
            "warnings": list(self.content.warnings),
            "findings": list(self.content.findings),
        }


def report(
    what: Project | Result | Sequence[Result],
    path: str | os.PathLike[str] = "report",
    *,
    calibration: int | None = None,
    engine: str = "",
    title: str = "",
    command: str = "",
    notify: Notify | None = None,
) -> Report:
    """Write one page that needs no network, with every figure as PDF next to it.

    Parameters
    ----------
    what : Project, result, or sequence of results
        A project: its newest calibration for several experiments, and the analyses that used it.
        Results, such as calibrations and comparisons: their tables and figures.
    path : path
        A ``.html`` file, or a folder; files of the same names are replaced.
    calibration : int, optional
        Id of the calibration of a project.
    engine : str
        Engine whose newest calibration is used, such as ``"mujoco"``.
    title, command : str
        Title of the page, and the command that wrote it.
    notify : callable, optional
        Called with a sentence before each part of the work.

    Returns
    -------
    Report
        Its files and its content.

    Raises
    ------
    InvalidInput
        Nothing to report on, or a folder that cannot be written to.

    Examples
    --------
    >>> import fixel, tempfile
    >>> found = fixel.compare(fixel.datasets.example()[:3], progress=False)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = fixel.report(found, f"{folder}/report.html")
    >>> done.page.name, len(done.figures)
    ('report.html', 1)
    """
    instance(what, Project | Result | Iterable, "what", "a project, a result, or several results")
    page = path_of(path, "path")
    page = page if page.suffix.lower() == ".html" else page / PAGE
    folder = page.parent
    template = environment().get_template("report.html")
    with new_folder(folder / FIGURES):
        if isinstance(what, Project):
            content = gather(what, calibration, folder / FIGURES, title, notify, engine)
        else:
            results = [what] if isinstance(what, Result) else [*what]
            content = results_content(results, folder / FIGURES, title)
        cited = works(content.references)
        html = template.render(
            content=content,
            picture=_embedded,
            cited=[line(work) for work in cited.values()],
            bibtex=bibtex(cited),
            commands=[*content.commands, *([command] if command else [])],
            pdf=FIGURES,
        )
        data = html.encode()
        if len(data) > MAX_PAGE_BYTES:
            found = f"{len(data) / 1e6:.1f} MB"
            expected = f"at most {MAX_PAGE_BYTES / 1e6:.0f} MB"
            hint = "report fewer analyses: remove some from the folder analyses of the project"
            raise InvalidInput(str(page), found=found, expected=expected, hint=hint)
        write_whole(folder / BIBLIOGRAPHY, bibtex(cited))
        write_whole(page, data)
    shown = [figure for section in content.sections for figure in section.figures]
    return Report(
        page=page,
        bibliography=folder / BIBLIOGRAPHY,
        figures=[figure.png.with_suffix(".pdf") for figure in shown],
        content=content,
        size=len(data),
    )


def gather(
    project: Project,
    number: int | None,
    folder: Path,
    title: str,
    notify: Notify | None = None,
    engine: str = "",
) -> Content:
    """Collect the content of a report, and draw its figures into an existing folder.

    The calibration is by default the newest for several experiments, by `engine` if that is given.
    An empty title is replaced by one with the project's name. `notify` is called with a sentence
    before each part of the work.
    """
    tell = notify or (lambda _: None)
    with project.store() as store:
        one = load_values(store, number, engine=engine)
        ids = sorted(one.members)
        data = sections.data_of(store, ids)
        checksum = store.checksum(ids)
    own = stored_in_run(project, one.id, one.record)
    fit = stored_calibration(project, one.id) if own is None else own
    tell("drawing the calibration")
    figures = sections.figures_of(own.run, folder, project) if own is not None else []
    analyses = _analyses(project, one)
    tell("collecting the analyses")
    parts = [
        sections.data_section(data),
        sections.errors_section(fit, figures),
        sections.parameters_section(fit, figures),
        *(_section(answer, folder) for answer in analyses),
    ]
    return Content(
        title=title or f"Accuracy of the simulator of {project.settings.name}",
        banner=data.banner,
        facts=_facts(project, one, data, checksum),
        warnings=tuple(_warnings(fit, data, analyses)),
        findings=(
            sections.headline(fit),
            *(answer.analysis.headline[0] for answer in analyses if answer.analysis.headline),
        ),
        sections=tuple(parts),
        methods=tuple(_methods(fit, data, analyses)),
        references=("stewart1996", *_references(one, analyses)),
        commands=tuple(_commands(one, analyses)),
    )


def _analyses(project: Project, one: CalibratedValues) -> list[StoredAnalysis]:
    """Select the newest analysis of each kind that used this calibration or its experiments."""
    found = []
    for kind in WANTED:
        fitting = [
            own
            for own in load_analyses(project, kind)
            if one.id in own.analysis.calibrations or one.members & {*own.analysis.experiments}
        ]
        found += fitting[:1]
    return found


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


def _warnings(fit: Calibration, data: ReportData, analyses: Sequence[StoredAnalysis]) -> list[str]:
    there = {answer.analysis.kind for answer in analyses}
    found = [
        *sections.data_warnings(data),
        *sentences("data", "missing", kinds=there),
        *fit.found.misfit,  # first: it decides how far to trust the rest
        *(
            words
            for answer in analyses
            for words in answer.analysis.warnings
            if not words.endswith(fit.found.misfit[:1])
        ),
        *sections.calibration_warnings(fit),
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
        ("created", made.created[:19].replace("T", " ")),
        ("command", repeatable(made.command)),
        ("seed", seed),
        ("experiments", str(len(data.summaries))),
        ("checksum of the data", checksum[:16]),
        ("fixel version of the calibration", made.version),
        *_machine(),
    )
    return tuple((name, value) for name, value in facts if value)


def _machine() -> tuple[tuple[str, str], ...]:
    return (
        ("fixel", version("fixel")),
        ("Python", platform.python_version()),
        ("machine", f"{platform.system()}, {platform.machine()}"),
    )


def _methods(fit: Calibration, data: ReportData, analyses: Sequence[StoredAnalysis]) -> list[str]:
    n = len(data.summaries)
    first = sentences("data", "methods", n=n, simulated=data.simulated, version=version("fixel"))
    own = [sentence for answer in analyses for sentence in answer.analysis.methods]
    return [*first, *sections.methods(fit), *own]


def _references(one: CalibratedValues, analyses: Sequence[StoredAnalysis]) -> list[str]:
    search = {"pattern-search": "torczon1997", "nelder-mead": "nelder1965"}
    found = [search.get(str(one.record.method.get("optimiser")), "")]
    found += ["raue2009"] if any(e.word not in ("", "frozen") for e in one.record.estimates) else []
    return [*found, *(key for answer in analyses for key in answer.analysis.references)]


def _commands(one: CalibratedValues, analyses: Sequence[StoredAnalysis]) -> list[str]:
    own = [one.record.provenance.command, *(answer.analysis.command for answer in analyses)]
    return [command for command in dict.fromkeys(map(repeatable, own)) if command]


def next_command(report: Report) -> str:
    """Return the command that opens the report."""
    return f"xdg-open {shlex.quote(str(report.page))}"


def _embedded(path: Path) -> dict[str, Any]:
    """Embed a picture as a `data:` address, in few colours and no larger than a screen shows, with
    its width on the page [pixel]."""
    from PIL import Image

    with Image.open(path) as original:
        inches = original.width / original.info.get("dpi", (300.0, 300.0))[0]
        image = original.convert("RGB")
    if image.width > WIDEST:
        height = round(image.height * WIDEST / image.width)
        image = image.resize((WIDEST, height), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    image.quantize(128, dither=Image.Dither.NONE).save(out, format="PNG", optimize=True)
    data = base64.b64encode(out.getvalue()).decode()
    return {"source": f"data:image/png;base64,{data}", "width": round(inches * PER_INCH)}


# --- results that are in no project ---------------------------------------------------------------


def results_content(results: Sequence[Result], folder: Path, title: str = "") -> Content:
    """Collect tables and figures of results; the figures are drawn into an existing folder.

    No result, or another object, raises `InvalidInput`.
    """
    if not results:
        raise InvalidInput("results", found="none", expected="at least one")
    parts = []
    for k, result in enumerate(results):
        instance(result, Result, f"results[{k}]", "a result, such as a Calibration")
        summary, kind = result._summary(), type(result).__name__
        words = re.sub("(?<=[a-z])[A-Z]", lambda found: f" {found[0].lower()}", kind)
        heading = summary.heading.replace(kind, words, 1)
        name = f"result_{k + 1}"
        parts.append(
            Section(
                title=heading.partition(":")[0],
                anchor=name,
                lead=(heading,),
                tables=tuple(summary.tables),
                figures=_drawn(result, name, folder),
                notes=tuple(summary.notes),
            )
        )
    return Content(
        title=title or parts[0].title,
        banner="",
        facts=_machine(),
        warnings=(),
        findings=tuple(section.lead[0] for section in parts),
        sections=tuple(parts),
        methods=(),
    )


def _drawn(result: Result, name: str, folder: Path) -> tuple[Figure, ...]:
    """Draw the usual plot of a result, if it has one."""
    if not offers(f"plots of {type(result).__name__}"):
        return ()
    from matplotlib import pyplot

    axes = result.plot()
    figure = (axes.flat[0] if hasattr(axes, "flat") else axes).figure
    save_figure(lambda: figure, folder / f"{name}.png", folder / f"{name}.pdf")
    pyplot.close(figure)
    return (Figure(name, type(result).__name__, folder / f"{name}.png"),)


# --- works to cite, from `references.bib` ---------------------------------------------------------


@cache
def known_works() -> dict[str, str]:
    """Load the BibTeX entry of every known work, by key; the program has its version."""
    text = (files("fixel.workflows.report") / "references.bib").read_text(encoding="utf-8")
    text = text.replace("Version VERSION", f"Version {version('fixel')}")
    return {found[1]: found[0] for found in _ENTRY.finditer(text)}


def works(keys: Sequence[str]) -> dict[str, str]:
    """Select the entries of the program and of what is cited, each once; skip unknown keys."""
    known = known_works()
    return {key: known[key] for key in dict.fromkeys((OWN, *keys)) if key in known}


def bibtex(cited: dict[str, str]) -> str:
    """Return the content of a `.bib` file."""
    return "\n".join(cited.values())


def line(entry: str) -> str:
    """Format an entry as a line of a list of references."""
    fields = dict(_FIELD.findall(entry))
    authors = fields.pop("author").replace(" and others", " et al.").replace(" and ", ", ")
    title, year = fields.pop("title")[1:-1], fields.pop("year")
    for written, read in READ.items():
        authors = authors.replace(written, read)
    rest = [value.replace("--", "-") for name, value in fields.items() if name != "number"]
    parts = [f"{authors} ({year})", title, ", ".join(rest)]
    return ". ".join(part for part in parts if part) + "."
