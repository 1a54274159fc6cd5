"""What the commands share in speaking to people: sentences, tables, progress."""

import sys
import time
from collections.abc import Callable, Sequence

Row = Sequence[str]

BAR = 30  # [characters]
BETWEEN_BARS = 0.1  # [s]


def say(sentence: str) -> None:
    """Print a sentence on standard error."""
    print(sentence, file=sys.stderr, flush=True)


def table(head: Row, rows: Sequence[Row], left: int = 1) -> list[str]:
    """Lines of a table; the first `left` columns and the last word stand left, numbers right."""
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    return [
        "  ".join(
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (head, *rows)
    ]


def progress_bar(what: str) -> Callable[[int, int], None] | None:
    """A bar on standard error, or None where nobody watches."""
    if not sys.stderr.isatty():
        return None
    last = 0.0

    def show(done: int, total: int) -> None:
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


def seconds(duration: float) -> str:
    """A wall time as one reads it."""
    return f"{1e3 * duration:.3g} ms" if duration < 1.0 else f"{duration:.3g} s"
