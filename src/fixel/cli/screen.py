"""Output that the commands share: sentences, tables, progress."""

import shlex
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fixel.typing import Progress

Row = Sequence[str]

BAR = 30  # [characters]
BETWEEN_BARS = 0.1  # [s] between two updates of a bar


def notify(sentence: str) -> None:
    """Print a sentence on standard error."""
    print(sentence, file=sys.stderr, flush=True)


def table(head: Row, rows: Sequence[Row], left: int = 1) -> list[str]:
    """Format the lines of a table; the first `left` columns are left-aligned, the others right."""
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    return [
        "  ".join(
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (head, *rows)
    ]


def progress_bar(what: str) -> "Progress | None":
    """Create a bar on standard error; None if that is no terminal."""
    if not sys.stderr.isatty():
        return None
    last = 0.0

    def show(done: int, total: int, note: str = "") -> None:
        nonlocal last
        now = time.monotonic()
        if done < total and now - last < BETWEEN_BARS:
            return
        last = now
        full = BAR * done // total
        end = "\n" if done == total else ""
        bar = "#" * full + "." * (BAR - full)
        print(f"\r{what} [{bar}] {100 * done // total:3d} %", end=end, file=sys.stderr, flush=True)

    return show


@contextmanager
def counting_bar() -> "Iterator[Progress]":
    """Yield a callback for a bar on standard error, which takes number, total and name."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("getting ready", total=None)

        def show(done: int, total: int, note: str = "") -> None:
            bar.update(task, completed=done, total=total, description=note)

        yield show


def compare_command(
    key: str, values: Mapping[str, float], motion: str, folder: Path = Path()
) -> str:
    """Return the command that compares an experiment with its simulation."""
    words = ["fixel", "compare", key]
    for name, value in values.items():
        words += ["--set", f"{name}={value:.4g}"]
    words += [] if motion == "dynamic" else ["--motion", motion]
    words += [] if folder == Path() else ["--project", str(folder)]
    return shlex.join(words)


def seconds(duration: float) -> str:
    """Format a wall time for display."""
    return f"{1e3 * duration:.3g} ms" if duration < 1.0 else f"{duration:.3g} s"
