"""Figures as a table on the screen and as rows of a CSV file."""

from __future__ import annotations

import csv
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable
from datetime import date
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.figures import Figure

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results"
PAGE = HERE.parent / "docs" / "evidence" / "benchmarks.md"
COLUMNS = (
    "date", "fixel version", "git commit", "machine", "python", "numba", "figure", "unit",
    "min", "median", "max", "bar", "passed",
)  # fmt: skip


def console() -> Console:
    """Standard output, wide enough for the table where it is not a terminal."""
    return Console() if sys.stdout.isatty() else Console(width=120)


def show(console: Console, figures: Iterable[Figure]) -> None:
    """Print a table of figures."""
    table = Table()
    for heading in ("figure", "measured", "min", "max", "unit", "must reach", ""):
        numeric = heading in ("measured", "min", "max")
        table.add_column(heading, justify="right" if numeric else "left", no_wrap=True)
    for figure in figures:
        several = len(figure.values) > 1
        table.add_row(
            figure.name,
            f"{figure.median:.4g}",
            f"{min(figure.values):.4g}" if several else "",
            f"{max(figure.values):.4g}" if several else "",
            figure.unit,
            str(figure.bar or ""),
            _verdict(figure),
        )
    console.print(table)


def _verdict(figure: Figure) -> str:
    if figure.passed is None:
        return ""
    return "[green]PASS[/green]" if figure.passed else "[bold red]MISS[/bold red]"


def append(figures: Iterable[Figure], folder: Path = RESULTS, *, small: bool = False) -> Path:
    """Append one row a figure to today's file of this machine and size; returns the file."""
    folder.mkdir(parents=True, exist_ok=True)
    today = date.today().isoformat()
    path = folder / f"{machine()}-{today}{'-small' if small else ''}.csv"
    fresh = not path.exists()
    head = (today, version("fixel"), commit(), machine(), platform.python_version())
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        if fresh:
            writer.writerow(COLUMNS)
        for figure in figures:
            numbers = (min(figure.values), figure.median, max(figure.values))
            writer.writerow(
                (
                    *head,
                    version("numba"),
                    figure.name,
                    figure.unit,
                    *(f"{x:.6g}" for x in numbers),
                    str(figure.bar or ""),
                    {True: "yes", False: "no", None: ""}[figure.passed],
                )
            )
    return path


def write_into(page: Path, name: str, text: str) -> None:
    """Replace what stands between ``<!-- name -->`` and ``<!-- end of name -->`` in a page."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, rest = page.read_text(encoding="utf-8").split(begin)
    after = rest.split(end)[1]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def as_markdown(figures: Iterable[Figure], names: Iterable[str]) -> str:
    """The table of a page, with where and when it was measured."""
    lines = [
        f"Measured {date.today().isoformat()} at commit {commit()} on {machine()},"
        f" Python {platform.python_version()}, Numba {version('numba')}: {', '.join(names)}.",
        "",
        "| figure | median | min | max | unit | must reach | |",
        "|---|---|---|---|---|---|---|",
    ]
    for figure in figures:
        numbers = (figure.median, min(figure.values), max(figure.values))
        verdict = {True: "pass", False: "**miss**", None: ""}[figure.passed]
        cells = (
            figure.name,
            *(f"{x:.4g}" for x in numbers),
            figure.unit,
            figure.bar or "",
            verdict,
        )
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def machine() -> str:
    """Model of the processor and number of cores, fit for a file name."""
    return re.sub(r"[^a-z0-9]+", "-", f"{_processor()} {os.cpu_count()} cores".lower()).strip("-")


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            for line in lines:
                if line.startswith("model name"):
                    return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def commit() -> str:
    """Short hash of the commit, with a + where tracked files differ from it."""
    hash_ = _git("rev-parse", "--short", "HEAD")
    return hash_ + ("+" if _git("status", "--porcelain", "--untracked-files=no") else "")


def _git(*arguments: str) -> str:
    done = subprocess.run(
        ["git", *arguments], cwd=HERE, capture_output=True, text=True, check=False
    )
    return done.stdout.strip()
