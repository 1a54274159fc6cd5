"""Every benchmark runs, at a size where its numbers mean nothing."""

import csv
import importlib
import math
import pkgutil
from pathlib import Path

import benchmarks
import pytest
from benchmarks import __main__ as command, report, web_load, work_precision
from benchmarks.figures import FULL, SMALL, Figure, at_least, at_most

pytestmark = pytest.mark.system

# Each is run by hand for its figures; here they would take the longest of all tests.
SECONDS_LONG = ("compile", "coverage", "sbc", "camera", "web", "planning", "policies", "bench")


@pytest.mark.parametrize("name", [n for n in command.SCENARIOS if n not in SECONDS_LONG])
def test_scenario_runs(name: str) -> None:
    module, function, _ = command.SCENARIOS[name]
    run = getattr(importlib.import_module(f"benchmarks.{module}"), function)
    figures = run(SMALL)
    assert figures
    assert all(math.isfinite(value) for figure in figures for value in figure.values)


@pytest.mark.parametrize("name", [m.name for m in pkgutil.iter_modules(benchmarks.__path__)])
def test_every_module_still_imports_what_it_needs(name: str) -> None:
    assert importlib.import_module(f"benchmarks.{name}").__doc__


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in SECONDS_LONG if n != "compile"])
def test_long_scenario_runs(name: str) -> None:
    test_scenario_runs(name)


@pytest.mark.slow
def test_first_compilation_runs() -> None:
    from benchmarks.processes import run_compile

    assert run_compile(SMALL)[0].median > 0.0


def test_bars() -> None:
    assert Figure("f", "s", (3.0, 1.0, 2.0), at_most(2.0)).passed
    assert not Figure("f", "x", (3.0, 1.0, 2.0), at_least(2.1)).passed
    assert not Figure("f", "s", (math.nan,), at_most(1.0)).passed
    assert Figure("f", "s", (1.0,)).passed is None
    with pytest.raises(ValueError, match="f: no values"):
        Figure("f", "s", ())


def test_rows_of_the_csv_file(tmp_path: Path) -> None:
    figures = [Figure("one", "s", (3.0, 1.0, 2.0), at_most(2.5)), Figure("two", "-", (1.0,))]
    path = report.append(figures, tmp_path)
    assert report.append(figures, tmp_path) == path
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == report.COLUMNS
    assert len(rows) == 4
    one, two = rows[:2]
    assert (one["min"], one["median"], one["max"]) == ("1", "2", "3")
    assert (one["bar"], one["passed"]) == ("<= 2.5", "yes")
    assert (two["bar"], two["passed"]) == ("", "")


def test_table_of_a_page_is_replaced_and_the_rest_kept(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("above\n<!-- figures -->\nold\n<!-- end of figures -->\nbelow\n", "utf-8")
    for number in (1.0, 2.0):
        table = report.as_markdown([Figure("one", "s", (number,))], ["start"])
        report.write_into(page, "figures", table)
    text = page.read_text("utf-8")
    assert text.startswith("above\n")
    assert text.endswith("below\n")
    assert "old" not in text
    assert text.count("| one | 2 |") == text.count("| one |") == 1


@pytest.mark.parametrize("page", [report.PAGE, work_precision.PAGE], ids=lambda page: page.stem)
def test_pages_have_room_for_figures(page: Path) -> None:
    text = page.read_text("utf-8")
    assert text.count("<!-- figures -->\n") == text.count("<!-- end of figures -->") == 1


def test_work_precision_diagram(tmp_path: Path) -> None:
    points = [
        work_precision.Point(motion, stepper, setting, 900.0, 50.0, 3.0, 0.01, worst, 0.96)
        for motion in ("dynamic", "quasistatic")
        for stepper in ("stewart-trinkle", "midpoint", "adaptive")
        for setting, worst in ((1e-2, 0.08), (1e-3, math.inf))
    ]
    work_precision.write(points, tmp_path / "points.csv")
    assert work_precision.read(tmp_path / "points.csv") == points
    work_precision.draw(points, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 0
    assert "| quasistatic | midpoint | 10 ms | 900 | 96.0 % | 0.01 |" in (
        work_precision.as_markdown(points, 400)
    )


def test_command_writes_where_it_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["grasp", "--small", "--output", str(tmp_path)]) == 0
    assert "grasp, default stepper" in capsys.readouterr().out
    assert len(list(tmp_path.iterdir())) == 1


def test_tiny_sizes_have_no_verdicts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    module, function, _ = command.SCENARIOS["grasp"]
    figures = [Figure("one", "s", (3.0,), at_most(2.0)), Figure("two", "s", (1.0,), at_most(2.0))]
    run = importlib.import_module(f"benchmarks.{module}")
    monkeypatch.setattr(run, function, lambda size: figures)
    shown = []
    for size in ([], ["--small"]):
        command.main(["grasp", *size, "--output", str(tmp_path)])
        shown.append(capsys.readouterr().out)
    assert [("PASS" in out, "MISS" in out) for out in shown] == [(True, True), (False, False)]
    full, small = sorted(tmp_path.iterdir(), key=lambda path: "small" in path.stem)
    assert ("yes" in full.read_text(), "yes" in small.read_text()) == (True, False)
    with pytest.raises(SystemExit):
        command.main(["grasp", "--small", "--page"])


def test_figures_that_need_a_browser_are_skipped_with_a_word(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(web_load.shutil, "which", lambda name: None)
    assert web_load._skipped(FULL) == web_load._skipped(SMALL)
    assert "no Chromium" in web_load._skipped(FULL)[0]
    monkeypatch.setattr(web_load.shutil, "which", lambda name: name)
    assert [len(web_load._skipped(size)) for size in (FULL, SMALL)] == [0, 1]


def test_unknown_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refusal:
        command.main(["nonsense"])
    assert refusal.value.code == 2
    assert "nonsense" in capsys.readouterr().err
