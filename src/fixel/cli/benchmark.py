"""`fixel benchmark real`: calibrate on recorded pushes, and evaluate on others."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.cli.options import AsJson
from fixel.cli.screen import counting_bar
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fixel.reproductions import Benchmark

app = typer.Typer(
    help="Compare with published results.", no_args_is_help=True, rich_markup_mode=None
)


@app.callback()
def benchmark() -> None:
    """Compare with published results."""


@app.command("real")
def real(
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the datasets; asme-table-1 and asme-figure-11 need none.",
            metavar="FOLDER",
            exists=True,
            file_okay=False,
            show_default=False,
        ),
    ] = None,
    only: Annotated[
        str,
        typer.Option(
            help="Part of the benchmark: mit, promise, new-sides, coverage, rates, cmu-tripod,"
            " rpi-141, repeats, asme-table-1 or asme-figure-11.",
            metavar="PART",
        ),
    ] = "mit",
    protocol: Annotated[
        list[str] | None,
        typer.Option(
            help="calibrated, learned, few, unregistered or new-shape; may be repeated. All where"
            " left out. Or joint: the time one calibration of 1000 pushes takes.",
            metavar="NAME",
            show_default=False,
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(help="Random splits, 60 % for training.", min=1, metavar="COUNT")
    ] = 3,
    folds: Annotated[
        int,
        typer.Option(
            help="Instead, hold every push out once, in so many folds.", min=0, metavar="COUNT"
        ),
    ] = 0,
    quick: Annotated[
        bool, typer.Option("--quick", help="A few plates and pushes, to see that it works.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for tables, a picture and finished fits; the same command goes on there.",
            metavar="FOLDER",
            file_okay=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Calibrate on some recorded pushes and report how far others end from where they should."""
    import json

    from fixel.reproductions import PROTOCOLS, BenchmarkRequest, benchmark_real, joint_real
    from fixel.reproductions.overview import REPRODUCTIONS, reproduce

    if only in REPRODUCTIONS:
        with counting_bar() as tell:
            found = reproduce(only, data, out=out, progress=tell, quick=quick)
        typer.echo(json.dumps(found.summary()) if as_json else "\n".join(found.conclusions))
        return
    if data is None:
        raise InvalidInput(
            "--data",
            found="nothing",
            expected="the folder of the datasets",
            hint="fixel data lists them",
        )
    if protocol == ["joint"]:
        with counting_bar() as tell:
            timed = joint_real(data, only, tell)
        typer.echo(json.dumps(timed) if as_json else _timed(timed))
        return
    request = BenchmarkRequest(
        protocols=tuple(protocol) if protocol else tuple(PROTOCOLS),
        seeds=1 if quick else seeds,
        folds=0 if quick else folds,
        quick=quick,
    )
    with counting_bar() as tell:
        answer = benchmark_real(data, request, part=only, out=out, progress=tell)
    if as_json:
        typer.echo(json.dumps(answer.summary(), allow_nan=False))
        return
    typer.echo("\n".join(_lines(answer, data, out)))


def _lines(answer: Benchmark, data: Path, out: Path | None) -> list[str]:
    from fixel.cli.screen import seconds, table

    rows = answer.rows
    models = (
        [m for m in ("published", "uncalibrated", "calibrated") if m in rows[0]] if rows else []
    )
    head = ["protocol", "surface", "shape", "held out"]
    head += [f"{model} {unit}" for model in models for unit in ("mm", "deg")]
    lines = table(head, [_cells(row, models) for row in rows], left=3)
    lines += ["", "Errors are mean / median.", *answer.notes]
    lines += [
        f"{row['protocol']}: 90 % intervals hold {100.0 * row['inside_90']:.1f} %."
        for row in rows
        if row["surface"] == "all" and row.get("inside_90") is not None
    ]
    lines.append(f"Took {seconds(float(answer.timing['seconds']))}.")
    command = shlex.join(["fixel", "benchmark", "real", "--data", str(data)])
    if out is not None:
        lines.append(f"Written: {out}/{answer.part}_rows.csv, _pushes.csv, .png")
        lines.append(f"Next: {command} --protocol joint")
    else:
        lines.append(f"Next: {command} --out benchmark")
    return lines


def _cells(row: dict[str, Any], models: Sequence[str]) -> list[str]:
    cells = [row["protocol"], row["surface"], row["shape"], str(row["held_out"])]
    for model in models:
        for what in ("position_mm", "angle_deg"):
            value = row[model][what]
            cells.append(f"{_number(value['mean'])} / {_number(value['median'])}")
    return cells


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _timed(answer: dict[str, Any]) -> str:
    found = ", ".join(f"{name} {value:.4g}" for name, value in answer["best"].items())
    return "\n".join(
        (
            f"{answer['evaluations']} evaluations of {answer['pushes']} pushes under"
            f" {answer['parameters']} parameters in {answer['seconds']:.1f} s"
            f" ({answer['pushes_per_second']} pushes per second).",
            f"Robust error {answer['error_at_start']:.3f} -> {answer['error_at_best']:.3f}"
            f" {answer['error_unit']} at {found}.",
        )
    )
