"""`fixel replay` and `fixel benchmark real`: recorded pushes, simulated and calibrated."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from fixel.cli.options import AsJson, option, required, with_options
from fixel.cli.screen import command_of, counting_bar, print_answer, seconds, table
from fixel.cli.simulation import MotionChoice
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from rich.console import Console

    from fixel.reproductions import Benchmark
    from fixel.reproductions.replay import Replay

Record = dict[str, Any]

app = typer.Typer(
    help="Compare with published results.", no_args_is_help=True, rich_markup_mode=None
)


@with_options
def replay(
    *,
    dataset: Path = required(
        "Folder of the dataset.",
        metavar="DATASET",
        exists=True,
        file_okay=False,
        show_default=False,
    ),
    select: list[str] | None = option(
        None, "Keep only records where COLUMN is VALUE; may be repeated.", metavar="COLUMN=VALUE"
    ),
    limit: int | None = option(
        None,
        "Replay at most this many records, spread evenly over those selected.",
        min=1,
        metavar="COUNT",
    ),
    set_: list[str] | None = option(
        None,
        "Change one nominal value, e.g. mu_pusher=0.2; may be repeated.",
        "--set",
        metavar="NAME=VALUE",
    ),
    motion: MotionChoice | None = option(
        None, "Motion model, instead of the dataset's usual one.", show_default=False
    ),
    window: float = option(
        2.0,
        "Length of the windows of long runs in seconds; 0 for whole runs.",
        min=0.0,
        metavar="SECONDS",
    ),
    everything: bool = option(False, "Keep records of doubtful quality too.", "--all"),
    as_json: AsJson = False,
    plot: Path | None = option(None, "Draw measured and simulated motion: .png, .svg or .pdf."),
) -> None:
    """Replay recorded pushes and report how far simulation and measurement lie apart."""
    from fixel.reproductions import replay as pushes

    if plot is not None:
        pushes.refuse_picture(plot)
    request = pushes.ReplayRequest(
        select=pushes.columns_and_values(select or ()),
        limit=limit,
        settings=pushes.names_and_numbers(set_ or ()),
        motion=None if motion is None else motion.value,
        everything=everything,
        window=window,
    )
    with counting_bar() as show:
        answer = pushes.replay_dataset(dataset, request, show)
    if plot is not None:
        pushes.draw_replay(answer, plot)
    if as_json:
        print_answer(True, answer.summary, list)
    else:
        _print_replay(answer, dataset, plot)


# Heading of a column over two lines, and a function that formats the value of a row.
ReplayColumn = tuple[str, Callable[[Record], str]]


def _print_replay(answer: "Replay", dataset: Path, plot: Path | None) -> None:
    from rich.console import Console

    console = Console(soft_wrap=True, highlight=False)
    rows = answer.groups or answer.pushes
    columns = {"rpi_2dgad": _trial_columns, "mit_timeseries": _window_columns}.get(
        answer.dataset, _push_columns
    )(rows)
    _print_table(console, columns, rows)
    for note in answer.notes:
        console.print(note)
    if answer.not_solved:
        console.print(f"{answer.not_solved} simulations did not finish; they are in no average.")
    console.print(_speed(answer))
    if plot is not None:
        console.print(f"Drawn: {plot}")
    console.print(f"Next: {_next(answer, dataset, plot)}")


def _print_table(console: "Console", columns: list[ReplayColumn], rows: list[Record]) -> None:
    cells = [[text(row) for _, text in columns] for row in rows]
    if not console.is_terminal:
        headings = [heading.replace("\n", " ") for heading, _ in columns]
        console.print("\n".join(table(headings, cells, left=len(columns))))
        return
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    framed = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading, _ in columns:
        framed.add_column(heading, overflow="fold")
    for row, line in zip(rows, cells, strict=True):
        pooled = "all" in (row.get("run"), row.get("shape"))
        framed.add_row(*line, style="bold" if pooled else None)
    console.print(framed)


def _speed(answer: "Replay") -> str:
    timing = answer.timing
    rate = timing.simulated / max(timing.simulation, 1e-9)
    return (
        f"{timing.simulated} simulated in {timing.simulation:.2f} s ({rate:.0f} per second);"
        f" with reading and start {timing.total:.2f} s."
    )


def _next(answer: "Replay", dataset: Path, plot: Path | None) -> str:
    if plot is None:
        return command_of("replay", dataset, "--plot", "replay.png")
    if answer.dataset == "mit_timeseries":
        return command_of("replay", dataset, "--window", 0)  # complete runs
    value = "tripod_radius=0.041" if answer.dataset == "rpi_2dgad" else "mu_pusher=0.2"
    return command_of("replay", dataset, "--set", value)


def _push_columns(rows: list[Record]) -> list[ReplayColumn]:
    columns = [
        _plain("surface"),
        _plain("shape"),
        _rounded("speed\nmm/s", "speed_mm_s", 0),
        _plain("pushes"),
    ]
    for name in ("fixel", "poly4", "quad"):
        if name in rows[0]:
            columns += [
                (f"{name}\nmm", _pair_of(name, "position_mm")),
                (f"{name}\ndeg", _pair_of(name, "angle_deg")),
            ]
    return columns


def _trial_columns(rows: list[Record]) -> list[ReplayColumn]:
    return [
        _plain("trial", "experiment_id"),
        _plain("simulation", "model"),
        _plain("path"),
        _plain("against"),
        _plain("frames"),
        _rounded("rms\nmm", "position_mm_rms"),
        _rounded("rms\ndeg", "angle_deg_rms"),
        _rounded("weighted\nrms mm", "weighted_mm_rms"),
        _rounded("E\nmm^2", "error_mm2"),
        _rounded("final\nmm", "position_mm_final"),
        _rounded("final\ndeg", "angle_deg_final"),
        ("contact mode\n(felt)", _modes),
        _plain("status"),
    ]


def _window_columns(rows: list[Record]) -> list[ReplayColumn]:
    return [
        _plain("run"),
        _plain("windows"),
        _plain("motion"),
        ("moved\nmm", lambda row: _pair(row["moved_mm"], 1)),
        _rounded("rms\nmm", "position_mm_rms"),
        _rounded("rms\ndeg", "angle_deg_rms"),
        ("final\nmm", lambda row: _pair(row["position_mm_final"])),
        ("final\ndeg", lambda row: _pair(row["angle_deg_final"])),
    ]


def _plain(heading: str, key: str = "") -> ReplayColumn:
    return (heading, lambda row: str(row[key or heading]))


def _rounded(heading: str, key: str, digits: int = 2) -> ReplayColumn:
    return (heading, lambda row: _number(row[key], digits))


def _pair_of(name: str, what: str) -> Callable[[Record], str]:
    return lambda row: _pair(row[name][what])


def _pair(value: dict[str, float | None], digits: int = 2) -> str:
    """Format mean and median."""
    return f"{_number(value['mean'], digits)} / {_number(value['median'], digits)}"


def _modes(row: Record) -> str:
    if row["contact_mode"] is None:
        return "-"
    return f"{row['contact_mode']} ({row['contact_mode_measured']})"


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


@app.callback()
def benchmark() -> None:
    """Compare with published results."""


@app.command("real")
@with_options
def real(
    *,
    data: Path | None = option(
        None,
        "Folder of the datasets; asme-table-1 and asme-figure-11 need none.",
        metavar="FOLDER",
        exists=True,
        file_okay=False,
        show_default=False,
    ),
    only: str = option(
        "mit",
        "Part of the benchmark: mit, promise, new-sides, coverage, rates, cmu-tripod,"
        " rpi-141, repeats, asme-table-1 or asme-figure-11.",
        metavar="PART",
    ),
    protocol: list[str] | None = option(
        None,
        "calibrated, learned, few, unregistered or new-shape; may be repeated. All where"
        " left out. Or joint: the time one calibration of 1000 pushes takes.",
        metavar="NAME",
        show_default=False,
    ),
    seeds: int = option(3, "Random splits, 60 % for training.", min=1, metavar="COUNT"),
    folds: int = option(
        0, "Instead, hold every push out once, in so many folds.", min=0, metavar="COUNT"
    ),
    quick: bool = option(False, "A few plates and pushes, to see that it works.", "--quick"),
    out: Path | None = option(
        None,
        "Folder for tables, a picture and finished fits; the same command goes on there.",
        metavar="FOLDER",
        file_okay=False,
    ),
    as_json: AsJson = False,
) -> None:
    """Calibrate on some recorded pushes and report how far others end from where they should."""
    from fixel.reproductions import PROTOCOLS, BenchmarkRequest, benchmark_real, joint_real
    from fixel.reproductions.overview import REPRODUCTIONS, reproduce

    if only in REPRODUCTIONS:
        with counting_bar() as show:
            found = reproduce(only, data, out=out, progress=show, quick=quick)
        print_answer(as_json, found.summary, lambda: found.conclusions)
        return
    data = _require_data(data)
    if protocol == ["joint"]:
        with counting_bar() as show:
            timed = joint_real(data, only, show)
        print_answer(as_json, lambda: timed, lambda: _timed(timed))
        return
    request = BenchmarkRequest(
        protocols=tuple(protocol or PROTOCOLS),
        seeds=1 if quick else seeds,
        folds=0 if quick else folds,
        quick=quick,
    )
    with counting_bar() as show:
        answer = benchmark_real(data, request, part=only, out=out, progress=show)
    print_answer(as_json, answer.summary, lambda: _benchmark_lines(answer, data, out))


def _require_data(data: Path | None) -> Path:
    if data is None:
        raise InvalidInput(
            "--data",
            found="nothing",
            expected="the folder of the datasets",
            hint="fixel data lists them",
        )
    return data


def _benchmark_lines(answer: "Benchmark", data: Path, out: Path | None) -> list[str]:
    rows = answer.rows
    models = (
        [m for m in ("published", "uncalibrated", "calibrated") if m in rows[0]] if rows else []
    )
    head = ["protocol", "surface", "shape", "held out"]
    head += [f"{model} {unit}" for model in models for unit in ("mm", "deg")]
    again = ("benchmark", "real", "--data", data)
    after = ("--out", "benchmark") if out is None else ("--protocol", "joint")
    written = [] if out is None else [f"Written: {out}/{answer.part}_rows.csv, _pushes.csv, .png"]
    return [
        *table(head, [_cells(row, models) for row in rows], left=3),
        "",
        "Errors are mean / median.",
        *answer.notes,
        *(
            f"{row['protocol']}: 90 % intervals hold {100.0 * row['inside_90']:.1f} %."
            for row in rows
            if row["surface"] == "all" and row.get("inside_90") is not None
        ),
        f"Took {seconds(float(answer.timing['seconds']))}.",
        *written,
        f"Next: {command_of(*again, *after)}",
    ]


def _cells(row: Record, models: Sequence[str]) -> list[str]:
    pairs = [_pair(row[model][what]) for model in models for what in ("position_mm", "angle_deg")]
    return [row["protocol"], row["surface"], row["shape"], str(row["held_out"]), *pairs]


def _timed(answer: Record) -> list[str]:
    found = ", ".join(f"{name} {value:.4g}" for name, value in answer["best"].items())
    return [
        f"{answer['evaluations']} evaluations of {answer['pushes']} pushes under"
        f" {answer['parameters']} parameters in {answer['seconds']:.1f} s"
        f" ({answer['pushes_per_second']} pushes per second).",
        f"Robust error {answer['error_at_start']:.3f} -> {answer['error_at_best']:.3f}"
        f" {answer['error_unit']} at {found}.",
    ]
