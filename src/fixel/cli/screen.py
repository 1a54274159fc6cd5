"""Shared parts of commands: options, answers as text or JSON, sentences, progress."""

import json
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from fixel.capability.options import Door
from fixel.errors import InvalidInput, plain

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.jobs.work import JobProgress

JOB_BAR = 24  # [characters]
BETWEEN_LINES_S = 30.0  # [s] where the progress of a job goes into a file

ProjectFolder = Annotated[
    Path,
    typer.Option(
        "--project", "-p", help="Folder of the project.", metavar="FOLDER", show_default="here"
    ),
]
ProjectPlace = Annotated[Path | None, Door(metavar="PROJECT", meaning="Same as --project.")]
FilmPath = Annotated[Path, Door(metavar="FILM", meaning="Video file or folder of a recording.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the answer as one JSON object.")]


class CommandAnswer(NamedTuple):
    """Answer of a command: content for `--json`, lines of text, and exit code."""

    content: Mapping[str, Any]
    lines: Iterable[str]
    code: int = 0


def print_answer(
    as_json: bool, content: Callable[[], Mapping[str, Any]], text: Callable[[], Iterable[str]]
) -> None:
    """Print the answer of a command: one JSON object on one line, or lines of text.

    In JSON, numbers that are not finite become null, and paths text.
    """
    if as_json:
        from fixel.io.document import plain_numbers

        typer.echo(json.dumps(plain_numbers(content()), allow_nan=False, default=os.fspath))
    else:
        typer.echo(plain("\n".join(text())))


def paragraphs(*blocks: Sequence[str]) -> list[str]:
    """Join blocks of lines with an empty line between two of them; empty blocks are left out."""
    full = [block for block in blocks if block]
    return [line for block in full for line in ("", *block)][1:]


def wrote(files: Iterable[Path | None]) -> list[str]:
    """Return a line for each file that was written."""
    return [f"wrote {file}" for file in files if file is not None]


def notify(sentence: str) -> None:
    """Print a sentence on standard error."""
    print(plain(sentence), file=sys.stderr, flush=True)


def command_line(without: str = "") -> str:
    """Return the running command as it can be typed again, without one of its flags."""
    return shlex.join(["fixel", *(word for word in sys.argv[1:] if word != without)])


def project_words(folder: Path) -> list[str]:
    """Return the words that a command needs at its end to find the same project."""
    return [] if folder == Path() else ["--project", str(folder)]


def command_of(*words: object, project: Path = Path()) -> str:
    """Return a command of fixel, quoted for a shell, that finds the same project."""
    return shlex.join(["fixel", *map(str, words), *project_words(project)])


def job_bar() -> "Callable[[JobProgress], None]":
    """Show progress on standard error: a bar on a terminal, else a line every 30 s."""
    terminal = sys.stderr.isatty()
    last = time.monotonic()

    def show(progress: "JobProgress") -> None:
        nonlocal last
        if terminal:
            end = "\n" if progress.share == 1.0 else ""
            print(f"\r\033[K{_bar(progress)}", end=end, file=sys.stderr, flush=True)
        elif time.monotonic() - last >= BETWEEN_LINES_S:
            last = time.monotonic()
            print(plain(progress.text), file=sys.stderr, flush=True)

    return show


def _bar(progress: "JobProgress") -> str:
    """One line: the bar stays empty while the amount of work is unknown."""
    full = int(JOB_BAR * (progress.share or 0.0))
    bar = f"[{'#' * full}{'.' * (JOB_BAR - full)}]"
    return f"{bar}  {plain(progress.text)}"


def project_at(place: Path | None, folder: Path) -> "Project":
    """Return the project in a folder, given as an argument or with --project."""
    from fixel.database.project import Project

    return Project(one_place(place, folder))


def one_place(place: Path | None, folder: Path) -> Path:
    """Return a folder, given as an argument or with --project."""
    if place is not None and folder != Path():
        found = f"{folder} and the argument {place}"
        raise InvalidInput("--project", found=found, expected="one of them")
    return folder if place is None else place


def require_folder(folder: Path | None) -> None:
    """Reject a place where no folder for pictures can be made, before any work."""
    if folder is not None:
        from fixel.workflows.analysis import new_folder

        with new_folder(folder):
            pass


def require_picture(file: Path | None) -> None:
    """Reject an invalid or unwritable file for a picture before any work."""
    if file is not None:
        from fixel.drawing.chart import require_file

        require_file(file)
