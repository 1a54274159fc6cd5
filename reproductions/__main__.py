"""``python -m reproductions``: calibrate on recorded pushes, and repeat published work."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.capability.options import Door
from fixel.cli.capability import command
from fixel.cli.main import run
from fixel.cli.replay import cell
from fixel.cli.screen import CommandAnswer
from fixel.errors import InvalidInput
from fixel.progress import show_progress, time_text
from fixel.replay.base import Row
from fixel.table import Table

if TYPE_CHECKING:
    from reproductions.result import Benchmark

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command()
@command
def reproduce_published(
    *,
    data: Annotated[Path | None, Door(metavar="FOLDER")] = None,
    only: Annotated[str, Door(metavar="PART")] = "mit",
    protocol: Annotated[tuple[str, ...], Door(metavar="NAME")] = (),
    seeds: Annotated[int, Door(least=1, metavar="COUNT")] = 3,
    folds: Annotated[int, Door(least=0, metavar="COUNT")] = 0,
    quick: Annotated[bool, Door(flag="--quick")] = False,
    out: Annotated[Path | None, Door(metavar="FOLDER")] = None,
) -> CommandAnswer:
    """Calibrate on some recorded pushes and report how far others end from where they should.

    Parameters
    ----------
    data : Path, optional
        Folder of the datasets; those of the ASME paper and thesis-grasps need none.
    only : str
        Part of the benchmark: mit, error-bounds, new-sides, new-parts, table-maps, learned-sides,
        coverage, plans, repeated-plans, rates, engines, cmu-tripod, rpi-141, repeats, asme-table-1,
        asme-figure-11, asme-assembly or thesis-grasps.
    protocol : tuple of str
        calibrated, learned, averaged, few, unregistered or new-shape; may be repeated. All where
        left out. Or joint: the time one calibration of 1000 pushes takes.
    seeds : int
        Random splits, 60 % for training.
    folds : int
        Instead: number of folds, every push held out once.
    quick : bool
        A few plates and pushes, to see that it works.
    out : Path, optional
        Folder for tables, a picture and finished fits; the same command goes on there.
    """
    from reproductions.run import (
        PROTOCOLS,
        REPRODUCTIONS,
        BenchmarkRequest,
        benchmark_real,
        joint_real,
        reproduce,
    )

    note = ["A quick run: it shows that everything works, and its figures mean nothing."] * quick
    if only in REPRODUCTIONS:
        with show_progress() as show:
            found = reproduce(only, data, out=out, progress=show, quick=quick)
        return CommandAnswer(found.summary(), [*found.conclusions, *note])
    data = _require_data(data)
    if protocol == ("joint",):
        timed = joint_real(data, only)
        return CommandAnswer(timed, _timed(timed))
    request = BenchmarkRequest(
        protocols=protocol or tuple(PROTOCOLS),
        seeds=1 if quick else seeds,
        folds=0 if quick else folds,
        quick=quick,
    )
    with show_progress() as show:
        answer = benchmark_real(data, request, part=only, out=out, progress=show)
    return CommandAnswer(answer.summary(), [*_benchmark_lines(answer, data, out), *note])


def _require_data(data: Path | None) -> Path:
    if data is None or not data.is_dir():
        raise InvalidInput(
            "data",
            found=None if data is None else f"no folder {data}",
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
    again = ("--data", data)
    after = ("--out", "benchmark") if out is None else ("--protocol", "joint")
    written = [] if out is None else [f"Written: {out}/{answer.part}_rows.csv, _pushes.csv, .png"]
    return [
        *Table(head, [_cells(row, models) for row in rows], left=3).lines(),
        "",
        "Errors are mean / median.",
        *answer.notes,
        *(
            f"{row['protocol']}: 90 % intervals hold {100.0 * row['inside_90']:.1f} %."
            for row in rows
            if row["surface"] == "all" and row.get("inside_90") is not None
        ),
        f"Took {time_text(float(answer.timing['seconds']))}.",
        *written,
        f"Next: python -m reproductions {shlex.join(map(str, (*again, *after)))}",
    ]


def _cells(row: Row, models: Sequence[str]) -> list[str]:
    pairs = [cell(row, f"{m}.{what}") for m in models for what in ("position_mm", "angle_deg")]
    return [row["protocol"], row["surface"], row["shape"], str(row["held_out"]), *pairs]


def _timed(answer: Row) -> list[str]:
    found = ", ".join(f"{name} {value:.4g}" for name, value in answer["best"].items())
    verdicts = ", ".join(f"{name} {verdict}" for name, verdict in answer["verdicts"].items())
    return [
        f"{answer['evaluations']} evaluations of {answer['pushes']} pushes under"
        f" {answer['parameters']} parameters in {answer['seconds']:.1f} s.",
        f"Robust error {answer['error_at_start']:.3f} -> {answer['error_at_best']:.3f}"
        f" {answer['error_unit']} at {found}.",
        f"With verdicts {answer['seconds_with_verdicts']:.1f} s: {verdicts}.",
    ]


if __name__ == "__main__":
    run(program=app, name="python -m reproductions")
