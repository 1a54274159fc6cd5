"""`fixel bench`: perform a plan of experiments, with a page and keys."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from select import select
from typing import TYPE_CHECKING, Any, Final

from fixel.cli.capability import typer_command
from fixel.cli.screen import command_of, notify, paragraphs, print_answer
from fixel.errors import plain
from fixel.workflows.bench.run import BENCH

if TYPE_CHECKING:
    from pydantic import BaseModel

    from fixel.web.bench_session import BenchSession

KEYS: Final = {"\n": "push", "p": "push", "m": "place", "s": "skip", "a": "again", "q": "end"}
DECISIONS: Final = {"y": "accept", "r": "repeat"}  # for the newest attempt that waits for one
SAID: Final = (
    "Enter: push. While it pushes, any key stops the drive. s: skip the row. y, r: accept or repeat"
    " a doubtful attempt. a: try again after trouble. q: end."
)
EVERY: Final = 0.05  # [s]
PATIENCE: Final = 2.0  # [s]


def _perform(request: "BaseModel", folder: Path, as_json: bool) -> None:
    """Serve the page and read keys until the campaign has ended."""
    from fixel.database.project import Project
    from fixel.testbed.motion import ManualActuator
    from fixel.web.context import ProjectContext
    from fixel.web.project import project_server
    from fixel.workflows.bench.run import report_of

    context = ProjectContext(Project(folder))
    session = context.bench
    try:
        loop = session.start(BENCH.function(context.project, **BENCH.arguments(request)))
        # The operator of a manual drive answers in the terminal.
        manual = loop.devices.drive.name == ManualActuator.name
        keys = sys.stdin.isatty() and not (manual or loop.dry_run)
        page = nullcontext() if loop.dry_run else project_server(context)
        with page as server, _pressed_keys(keys) as pressed:
            if server is not None:
                notify(f"Open {server.address}bench?token={server.gate.token}")
            if keys:
                notify(SAID)
            show = _reporter(session)
            while session.running:
                for key in pressed(EVERY):
                    _take(session, key)
                show()
        session.raise_failure()
        analysis = report_of(loop).analysis
    finally:  # also stops the drive, on Ctrl-C
        context.close()
    changed: dict[str, Any] = {"dry_run": False, "check": False}
    changed |= {"limit": None} if loop.limit_reached else {}
    again = command_of(*BENCH.words(request.model_copy(update=changed)), project=folder)
    after = command_of("calibrate", "--dataset", loop.campaign.folder.name, project=folder)
    # Where enough is known, the same command would perform nothing.
    done = not loop.campaign.left or (loop.live is not None and loop.live.finish)
    print_answer(
        as_json,
        lambda: analysis.numbers | analysis.texts(),
        lambda: paragraphs(analysis.lines(), [f"Next: {after if done else again}"]),
    )


def _take(session: "BenchSession", key: str) -> None:
    """Do what a key means now."""
    report = json.loads(session.view.report)
    if report.get("phase") in ("pushing", "moving"):
        session.ask("stop", by="key")
    elif key in KEYS:
        session.ask(KEYS[key], by="key")
    elif key in DECISIONS:
        open_ones = [own["name"] for own in report["attempts"] if own["state"] == "tracked"]
        if open_ones:
            session.ask(DECISIONS[key], open_ones[-1], by="key")


def _reporter(session: "BenchSession") -> Callable[[], None]:
    """Return a function that prints the status over the last one.

    Without a terminal, it prints each new row, trouble, and checks that fail for `PATIENCE`.
    """
    terminal, row, last, since, printed = sys.stderr.isatty(), "", "", 0.0, ""

    def show() -> None:
        nonlocal row, last, since, printed
        if not (report := json.loads(session.view.report)):
            return
        checks = report["checks"] if report["phase"] == "placing" else ()
        words = [f"{own['name']}: {own['words']}" for own in checks if not own["passed"]]
        words = report["problems"] or words
        before = row
        if report["row"]:
            row = f"row {report['number']}/{report['rows']} {report['row']}"
        if terminal:
            line = plain(f"{row}: {report['phase']} {'; '.join(words)}")
            if line != last:
                print(f"\r{line:<{len(last)}}", end="", file=sys.stderr, flush=True)
            last = line
            return
        if row != before:
            notify(row)
        line = "; ".join(own for own in words if not own.startswith("in place"))
        if line != last:
            last, since = line, time.monotonic()
        waits = PATIENCE if line and not report["problems"] else 0.0
        if line != printed and time.monotonic() - since >= waits:
            printed = line
            if line:
                notify(f"trouble: {line}")

    return show


@contextmanager
def _pressed_keys(read: bool) -> Iterator[Callable[[float], Iterator[str]]]:
    """Yield a function that waits for a time [s] and returns the keys pressed meanwhile."""
    if not read or sys.platform == "win32":
        yield _nothing
        return
    import termios
    import tty

    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)

    def pressed(patience: float) -> Iterator[str]:
        while select([sys.stdin], [], [], patience)[0]:
            yield sys.stdin.read(1)

    try:
        yield pressed
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def _nothing(patience: float) -> Iterator[str]:
    time.sleep(patience)
    return iter(())


bench = typer_command(BENCH, _perform)
