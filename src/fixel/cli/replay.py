"""`fixel replay DATASET`: compare recorded pushes with simulated ones."""

from __future__ import annotations

import shlex
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from fixel.cli.options import AsJson
from fixel.cli.screen import counting_bar

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from fixel.reproductions.replay import Replay


class MotionName(StrEnum):
    """Names of the motion models, as in scene files."""

    DYNAMIC = "dynamic"
    QUASISTATIC = "quasistatic"
    FIRST_ORDER = "first-order"


def replay(
    dataset: Annotated[
        Path,
        typer.Argument(
            help="Folder of the dataset.",
            metavar="DATASET",
            exists=True,
            file_okay=False,
            show_default=False,
        ),
    ],
    select: Annotated[
        list[str] | None,
        typer.Option(
            help="Keep only records where COLUMN is VALUE; may be repeated.", metavar="COLUMN=VALUE"
        ),
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(
            help="Replay at most this many records, spread evenly over those selected.",
            min=1,
            metavar="COUNT",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Change one nominal value, e.g. mu_pusher=0.2; may be repeated.",
            metavar="NAME=VALUE",
        ),
    ] = None,
    motion: Annotated[
        MotionName | None,
        typer.Option(help="Motion model, instead of the dataset's usual one.", show_default=False),
    ] = None,
    window: Annotated[
        float,
        typer.Option(
            help="Length of the windows of long runs in seconds; 0 for whole runs.",
            min=0.0,
            metavar="SECONDS",
        ),
    ] = 2.0,
    everything: Annotated[
        bool, typer.Option("--all", help="Keep records of doubtful quality too.")
    ] = False,
    as_json: AsJson = False,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Draw measured and simulated motion: .png, .svg or .pdf.", metavar="FILE"
        ),
    ] = None,
) -> None:
    """Replay recorded pushes and report how far simulation and measurement lie apart."""
    from fixel.reproductions.replay import (
        ReplayRequest,
        columns_and_values,
        draw_replay,
        names_and_numbers,
        refuse_picture,
        replay_dataset,
    )

    if plot is not None:
        refuse_picture(plot)
    choice = ReplayRequest(
        select=columns_and_values(select or ()),
        limit=limit,
        settings=names_and_numbers(set_ or ()),
        motion=None if motion is None else motion.value,
        everything=everything,
        window=window,
    )
    with counting_bar() as tell:
        answer = replay_dataset(dataset, choice, tell)
    if plot is not None:
        draw_replay(answer, plot)
    if as_json:
        import json

        typer.echo(json.dumps(answer.summary()))
        return
    _print(answer, dataset, plot)


class ReplayColumn(NamedTuple):
    """Heading over two lines, and a function that formats the value of a row."""

    heading: str
    notify: Callable[[dict[str, Any]], str]


def _print(answer: Replay, dataset: Path, plot: Path | None) -> None:
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


def _print_table(console: Console, columns: list[ReplayColumn], rows: list[dict[str, Any]]) -> None:
    cells = [[column.notify(row) for column in columns] for row in rows]
    if not console.is_terminal:
        headings = [column.heading.replace("\n", " ") for column in columns]
        widths = [max(map(len, column)) for column in zip(headings, *cells, strict=True)]
        for line in (headings, *cells):
            padded = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
            console.print("  ".join(padded).rstrip())
        return
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column.heading, overflow="fold")
    for row, line in zip(rows, cells, strict=True):
        pooled = "all" in (row.get("run"), row.get("shape"))
        table.add_row(*line, style="bold" if pooled else None)
    console.print(table)


def _speed(answer: Replay) -> str:
    timing = answer.timing
    rate = timing.simulated / max(timing.simulation, 1e-9)
    return (
        f"{timing.simulated} simulated in {timing.simulation:.2f} s ({rate:.0f} per second);"
        f" with reading and start {timing.total:.2f} s."
    )


def _next(answer: Replay, dataset: Path, plot: Path | None) -> str:
    command = shlex.join(["fixel", "replay", str(dataset)])
    if plot is None:
        return f"{command} --plot replay.png"
    if answer.dataset == "mit_timeseries":
        return f"{command} --window 0"  # complete runs
    value = "tripod_radius=0.041" if answer.dataset == "rpi_2dgad" else "mu_pusher=0.2"
    return f"{command} --set {value}"


def _push_columns(rows: list[dict[str, Any]]) -> list[ReplayColumn]:
    columns = [
        ReplayColumn("surface", lambda row: row["surface"]),
        ReplayColumn("shape", lambda row: row["shape"]),
        ReplayColumn("speed\nmm/s", lambda row: _number(row["speed_mm_s"], 0)),
        ReplayColumn("pushes", lambda row: str(row["pushes"])),
    ]
    for name in ("fixel", "poly4", "quad"):
        if name in rows[0]:
            columns += [
                ReplayColumn(f"{name}\nmm", _pair_of(name, "position_mm")),
                ReplayColumn(f"{name}\ndeg", _pair_of(name, "angle_deg")),
            ]
    return columns


def _trial_columns(rows: list[dict[str, Any]]) -> list[ReplayColumn]:
    return [
        ReplayColumn("trial", lambda row: str(row["experiment_id"])),
        ReplayColumn("simulation", lambda row: row["model"]),
        ReplayColumn("path", lambda row: row["path"]),
        ReplayColumn("against", lambda row: row["against"]),
        ReplayColumn("frames", lambda row: str(row["frames"])),
        ReplayColumn("rms\nmm", lambda row: _number(row["position_mm_rms"])),
        ReplayColumn("rms\ndeg", lambda row: _number(row["angle_deg_rms"])),
        ReplayColumn("weighted\nrms mm", lambda row: _number(row["weighted_mm_rms"])),
        ReplayColumn("E\nmm^2", lambda row: _number(row["error_mm2"])),
        ReplayColumn("final\nmm", lambda row: _number(row["position_mm_final"])),
        ReplayColumn("final\ndeg", lambda row: _number(row["angle_deg_final"])),
        ReplayColumn("contact mode\n(felt)", _modes),
        ReplayColumn("status", lambda row: row["status"]),
    ]


def _window_columns(rows: list[dict[str, Any]]) -> list[ReplayColumn]:
    return [
        ReplayColumn("run", lambda row: row["run"]),
        ReplayColumn("windows", lambda row: str(row["windows"])),
        ReplayColumn("motion", lambda row: row["motion"]),
        ReplayColumn("moved\nmm", lambda row: _pair(row["moved_mm"], 1)),
        ReplayColumn("rms\nmm", lambda row: _number(row["position_mm_rms"])),
        ReplayColumn("rms\ndeg", lambda row: _number(row["angle_deg_rms"])),
        ReplayColumn("final\nmm", lambda row: _pair(row["position_mm_final"])),
        ReplayColumn("final\ndeg", lambda row: _pair(row["angle_deg_final"])),
    ]


def _pair_of(name: str, what: str) -> Callable[[dict[str, Any]], str]:
    return lambda row: _pair(row[name][what])


def _pair(value: dict[str, float | None], digits: int = 2) -> str:
    """Format mean and median."""
    return f"{_number(value['mean'], digits)} / {_number(value['median'], digits)}"


def _modes(row: dict[str, Any]) -> str:
    if row["contact_mode"] is None:
        return "-"
    return f"{row['contact_mode']} ({row['contact_mode_measured']})"


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
