"""Progress: who sees it, how often, and that it ends."""

import io
import logging
import sys
import types

import pytest

from fixel import progress as module
from fixel.progress import Progress, show_progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_function_gets_every_progress_with_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter((100.0, 101.0, 103.0))
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    seen: list[Progress] = []

    with show_progress(seen.append, "searching") as report:
        report(1, 4, "push 1")
        report.show(Progress("verdicts", 3, 4, best=2e-3))

    assert seen == [
        Progress("searching", 1, 4, seconds=1.0, left=3.0, note="push 1"),
        Progress("verdicts", 3, 4, best=2e-3, seconds=3.0, left=1.0),
    ]


def test_text_without_a_total() -> None:
    assert str(Progress("reading", 7, note="a.csv")) == "reading  7 done  a.csv"
    assert Progress("reading", 7).share is None


def test_false_writes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with show_progress(False) as report:
        report(1, 2)

    assert capsys.readouterr() == ("", "")


def test_without_a_terminal_a_line_of_the_log_every_30_s(
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    capsys: pytest.CaptureFixture[str],
) -> None:
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    with caplog.at_level(logging.INFO, "fixel"), show_progress(None, "searching") as report:
        for seconds in range(0, 100, 10):
            now[0] = float(seconds)
            report(seconds, 100)

    assert [record.getMessage() for record in caplog.records] == [
        "searching, 30 %, about 70 s left",
        "searching, 60 %, about 40 s left",
        "searching, 90 %, about 10 s left",
    ]
    assert capsys.readouterr() == ("", "")


def test_bar_of_a_terminal_appears_and_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")

    with show_progress(None, "searching [a]") as report:
        report(1, 2)
        report(2, 2)
        with show_progress(None, "inner") as inner:  # within other work: no bar of its own
            inner(1, 1)

    assert "searching [a]" in screen.getvalue()
    assert "inner" not in screen.getvalue()
    assert not module._busy


def test_bar_of_a_notebook_needs_no_widgets_and_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    pages: list[str] = []

    class Handle:
        def update(self, page: str) -> None:
            pages.append(page)

    shell = types.SimpleNamespace(kernel=object())
    display = types.SimpleNamespace(HTML=str, display=lambda page, display_id: Handle())
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", display)

    with show_progress(None, "<searching>") as report:
        report(2, 2)

    assert pages == [
        '<progress value="1.000"></progress> &lt;searching&gt;  100 %',
        "",
    ]


def test_a_console_of_ipython_is_no_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    shell = types.SimpleNamespace(get_ipython=lambda: types.SimpleNamespace())
    monkeypatch.setitem(sys.modules, "IPython", shell)

    assert module._notebook_bar() is None
