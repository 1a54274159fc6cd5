"""Write a report as one self-contained HTML file, with its figures and a bibliography."""

from __future__ import annotations

import base64
import io
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, final

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.io.atomic import written_whole
from fixel.workflows.figures import make_folder
from fixel.workflows.report.bibliography import bibtex, line, works
from fixel.workflows.report.content import Content
from fixel.workflows.report.gather import gather

PAGE: Final = "report.html"
FIGURES: Final = "figures"
BIBLIOGRAPHY: Final = "cite.bib"
MAX_PAGE_BYTES: Final = 10_000_000  # largest size of the page [byte]
PER_INCH: Final = 116  # of a picture, on the page [pixel]: a figure of two columns fills it
WIDEST: Final = 1500  # largest width of a picture on the page [pixel]; its PDF has full detail


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Report that was written.

    Attributes
    ----------
    page, bibliography : Path
    figures : list of Path
        PDF files.
    content : Content
    size : int
        Size of the page [byte].
    """

    page: Path
    bibliography: Path
    figures: list[Path]
    content: Content
    size: int

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


def write_report(
    project: Project,
    folder: Path,
    *,
    number: int | None = None,
    title: str = "",
    command: str = "",
    notify: Callable[[str], None] | None = None,
) -> Report:
    """Write the report of a calibration and of the analyses that used it.

    Parameters
    ----------
    project : Project
    folder : Path
        Created if missing; files of the same names are replaced.
    number : int, optional
        Id of the calibration.
    title, command : str
    notify : callable, optional

    Raises
    ------
    InvalidInput
        Nothing to report on, or a folder that cannot be written to.
    """
    template = _template()
    make_folder(folder / FIGURES)
    content = gather(project, number, folder / FIGURES, title, notify)
    cited = works(content.references)
    html = template.render(
        content=content,
        style=_own("report.css"),
        picture=_embedded,
        cited=[line(work) for work in cited.values()],
        bibtex=bibtex(cited),
        commands=[*content.commands, *([command] if command else [])],
        pdf=FIGURES,
    )
    data = html.encode()
    if len(data) > MAX_PAGE_BYTES:
        raise InvalidInput(
            str(folder / PAGE),
            found=f"{len(data) / 1e6:.1f} MB",
            expected=f"at most {MAX_PAGE_BYTES / 1e6:.0f} MB",
            hint="report fewer analyses: remove some from the project's folder analyses",
        )
    with written_whole(folder / BIBLIOGRAPHY) as path:
        path.write_text(bibtex(cited), encoding="utf-8")
    with written_whole(folder / PAGE) as path:
        path.write_bytes(data)
    shown = [figure for section in content.sections for figure in section.figures]
    return Report(
        page=folder / PAGE,
        bibliography=folder / BIBLIOGRAPHY,
        figures=[figure.png.with_suffix(".pdf") for figure in shown],
        content=content,
        size=len(data),
    )


def next_command(report: Report) -> str:
    """Return the command that opens the report."""
    return f"xdg-open {shlex.quote(str(report.page))}"


def _template() -> Any:
    import jinja2

    # Names of experiments may contain anything: everything is escaped.
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(_own("report.html.j2"))


def _own(name: str) -> str:
    return (files("fixel.workflows.report") / name).read_text(encoding="utf-8")


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
