"""Progress of long work: a bar in terminals and notebooks, else lines of the log."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from html import escape
from typing import Any, Final

BETWEEN_BARS_S: Final = 0.1
BETWEEN_LINES_S: Final = 30.0
WIDTH: Final = 24  # [characters] of a bar

_LOG: Final = logging.getLogger("fixel")
_busy = False  # whether a bar is shown: work inside other work shows none of its own


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of long work.

    Examples
    --------
    >>> print(Progress("searching", 50, 200, best=2.31e-3, seconds=4.0, left=12.0))
    searching  25 %  best 2.31 mm  about 12 s left
    """

    stage: str  # work that is done now: "searching", "verdicts"
    done: int  # number of parts that are done
    total: int | None = None  # number of parts; None while unknown
    best: float | None = None  # smallest error found so far, a root mean square [m]
    seconds: float = 0.0  # wall time since the start [s]
    left: float | None = None  # estimated time left [s]; None while unknown
    note: str = ""  # other text, such as the name of the part

    @property
    def share(self) -> float | None:
        """Share of the work that is done; None while the amount of work is unknown."""
        return None if self.total is None else min(1.0, self.done / max(1, self.total))

    @property
    def words(self) -> list[str]:
        """Stage, smallest error and note, without share and time left."""
        best = "" if self.best is None else f"best {1e3 * self.best:.3g} mm"
        return [part for part in (self.stage, best, self.note) if part]

    def __str__(self) -> str:
        share = f"{self.done} done" if self.share is None else f"{100 * self.share:.0f} %"
        left = [f"about {time_text(self.left)} left"] if self.left else []
        words = self.words if self.stage else ["", *self.words]
        return "  ".join(part for part in (*words[:1], share, *words[1:], *left) if part)


ProgressOption = bool | Callable[[Progress], None] | None


class Reporter:
    """Callback that long work reports its progress to; made by `show_progress`."""

    def __init__(self, display: Callable[[Progress], None], stage: str = "") -> None:
        self.stage = stage
        self._display = display
        self._began = time.monotonic()

    def __call__(self, done: int, total: int | None = None, note: str = "") -> None:
        """Report the number done and the number in all, as `fixel.typing.ProgressCallback`."""
        self.show(Progress(self.stage, done, total, note=note))

    def show(self, progress: Progress) -> None:
        """Report progress; its time, and the time left if missing, are filled in."""
        seconds = time.monotonic() - self._began
        left = progress.left
        if left is None and progress.total and progress.done:
            left = seconds * max(0, progress.total - progress.done) / progress.done
        self._display(replace(progress, seconds=seconds, left=left))


@contextmanager
def show_progress(progress: ProgressOption = None, stage: str = "") -> Iterator[Reporter]:
    """Show the progress of the work in this block; yield the callback that reports it.

    The callback gets the numbers done and in all. None shows a bar in terminals and notebooks, else
    a line of the log `fixel` every 30 s; False shows nothing. A function is called with every
    `Progress`. `stage` is the name of the work.

    Examples
    --------
    >>> with show_progress(print, "simulating") as report:
    ...     report(0, 200)
    ...     report(200, 200)
    simulating  0 %
    simulating  100 %
    """
    global _busy
    if callable(progress):
        yield Reporter(progress, stage)
        return
    if progress is False or _busy:
        yield Reporter(_nothing, stage)
        return
    _busy = True
    try:
        bar = _notebook_bar() or _terminal_bar() or _Lines()
        try:
            yield Reporter(bar.show, stage)
        finally:
            bar.close()
    finally:
        _busy = False


def _nothing(progress: Progress) -> None:
    pass


class _Lines:
    """One line of the log every 30 s."""

    def __init__(self) -> None:
        self._last = time.monotonic()

    def show(self, progress: Progress) -> None:
        now = time.monotonic()
        if now - self._last >= BETWEEN_LINES_S:
            self._last = now
            _LOG.info("%s", str(progress).replace("  ", ", "))

    def close(self) -> None:
        pass


class _Bar:
    """Bar that is drawn at most ten times a second."""

    def __init__(self, draw: Callable[[Progress], None], end: Callable[[], None]) -> None:
        self._draw = draw
        self._end = end
        self._last = 0.0
        self._pending: Progress | None = None

    def show(self, progress: Progress) -> None:
        now = time.monotonic()
        if now - self._last < BETWEEN_BARS_S and progress.share != 1.0:
            self._pending = progress
            return
        self._last, self._pending = now, None
        self._draw(progress)

    def close(self) -> None:
        with suppress(Exception):  # the screen may be gone; that must hide no other error
            if self._pending is not None:
                self._draw(self._pending)
            self._end()


def _terminal_bar() -> _Bar | None:
    if not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import BarColumn, Progress as RichProgress, TextColumn

    columns = (BarColumn(WIDTH), TextColumn("{task.description}", markup=False))
    rich = RichProgress(*columns, console=Console(stderr=True), transient=True)
    task = rich.add_task("", total=None)
    rich.start()

    def draw(progress: Progress) -> None:
        rich.update(task, completed=progress.done, total=progress.total, description=str(progress))

    return _Bar(draw, rich.stop)


def _notebook_bar() -> _Bar | None:
    """Return a bar for a notebook: HTML under one display id, without widgets."""
    shell = sys.modules.get("IPython")
    if shell is None or not hasattr(shell.get_ipython(), "kernel"):
        return None
    from IPython.display import HTML, display

    handle: Any = display(HTML(""), display_id=True)

    def draw(progress: Progress) -> None:
        share = progress.share
        value = "" if share is None else f' value="{share:.3f}"'
        handle.update(HTML(f"<progress{value}></progress> {escape(str(progress))}"))

    return _Bar(draw, lambda: handle.update(HTML("")))


def time_text(seconds: float) -> str:
    """Format a duration: `412 ms`, `3.21 s`, `4 min`, `2.5 h`."""
    if seconds < 120.0:
        return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.2g} h"
