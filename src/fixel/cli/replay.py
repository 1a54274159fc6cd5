"""`fixel replay`: recorded pushes, simulated."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from fixel.capability.options import Door, Values
from fixel.cli.capability import command
from fixel.cli.screen import CommandAnswer, command_of, require_picture
from fixel.progress import show_progress
from fixel.table import Table

if TYPE_CHECKING:
    from fixel.replay import Replay

Record = dict[str, Any]


@command
def replay(
    dataset: Annotated[Path, Door(metavar="DATASET")],
    *,
    select: Annotated[tuple[str, ...], Door(metavar="COLUMN=VALUE")] = (),
    limit: Annotated[int | None, Door(least=1, metavar="COUNT")] = None,
    settings: Values = None,
    motion: Literal["dynamic", "quasistatic", "first-order"] | None = None,
    window: Annotated[float, Door(least=0.0, metavar="SECONDS")] = 2.0,
    everything: Annotated[bool, Door(flag="--all")] = False,
    plot: Annotated[Path | None, Door(writes=True)] = None,
) -> CommandAnswer:
    """Replay recorded pushes and report the simulation's errors.

    Parameters
    ----------
    dataset : Path
        Folder of the dataset.
    select : tuple of str
        Select records whose COLUMN has this VALUE; may be repeated.
    limit : int, optional
        Maximum number of records, spread evenly over those selected.
    settings : mapping of str to float, optional
        Change one nominal value, e.g. mu_pusher=0.2; may be repeated.
    motion : str, optional
        Motion model; by default that of the dataset.
    window : float
        Length of the windows of long runs [s]; 0 replays whole runs.
    everything : bool
        Include records of doubtful quality.
    plot : Path, optional
        Draw measured and simulated motion: .png, .svg or .pdf.
    """
    from fixel.replay import ReplayRequest, replay_dataset
    from fixel.replay.base import columns_and_values

    require_picture(plot)
    request = ReplayRequest(
        select=columns_and_values(select),
        limit=limit,
        settings=settings or {},
        motion=motion,
        everything=everything,
        window=window,
    )
    with show_progress() as show:
        answer = replay_dataset(dataset, request, show)
    if plot is not None:
        from fixel.drawing.chart import save_figure

        save_figure(answer.figure, plot)
    return CommandAnswer(answer.summary(), _replay_lines(answer, dataset, plot))


# Columns of the tables: heading, name of the value in a row, and its format.
COLUMNS: Final = {
    "mit_push_endpoints": (
        ("surface", "surface", ""),
        ("shape", "shape", ""),
        ("speed mm/s", "speed_mm_s", ".0f"),
        ("pushes", "pushes", ""),
        ("fixel mm", "fixel.position_mm", ".2f"),
        ("fixel deg", "fixel.angle_deg", ".2f"),
        ("poly4 mm", "poly4.position_mm", ".2f"),
        ("poly4 deg", "poly4.angle_deg", ".2f"),
        ("quad mm", "quad.position_mm", ".2f"),
        ("quad deg", "quad.angle_deg", ".2f"),
    ),
    "rpi_2dgad": (
        ("trial", "experiment_id", ""),
        ("simulation", "model", ""),
        ("path", "path", ""),
        ("against", "against", ""),
        ("frames", "frames", ""),
        ("rms mm", "position_mm_rms", ".2f"),
        ("rms deg", "angle_deg_rms", ".2f"),
        ("weighted rms mm", "weighted_mm_rms", ".2f"),
        ("E mm^2", "error_mm2", ".2f"),
        ("final mm", "position_mm_final", ".2f"),
        ("final deg", "angle_deg_final", ".2f"),
        ("contact mode", "contact_mode", ""),
        ("felt", "contact_mode_measured", ""),
        ("status", "status", ""),
    ),
    "mit_timeseries": (
        ("run", "run", ""),
        ("windows", "windows", ""),
        ("motion", "motion", ""),
        ("moved mm", "moved_mm", ".1f"),
        ("rms mm", "position_mm_rms", ".2f"),
        ("rms deg", "angle_deg_rms", ".2f"),
        ("final mm", "position_mm_final", ".2f"),
        ("final deg", "angle_deg_final", ".2f"),
    ),
}


def _replay_lines(answer: "Replay", dataset: Path, plot: Path | None) -> list[str]:
    rows = answer.groups or answer.pushes
    columns = [own for own in COLUMNS[answer.dataset] if own[1].partition(".")[0] in rows[0]]
    cells = [[cell(row, name, form) for _, name, form in columns] for row in rows]
    lines = Table([heading for heading, _, _ in columns], cells, left=len(columns)).lines()
    lines += answer.notes
    if answer.not_solved:
        lines.append(
            f"{answer.not_solved} simulations did not finish and are not included in averages."
        )
    lines.append(_speed(answer))
    if plot is not None:
        lines.append(f"wrote {plot}")
    return [*lines, f"Next: {_next(answer, dataset, plot)}"]


def cell(row: Record, name: str, form: str = ".2f") -> str:
    """Format a value of a row, such as `fixel.position_mm`; mean and median with a slash."""
    value: Any = row
    for part in name.split("."):
        value = value[part]
    values = (value["mean"], value["median"]) if isinstance(value, dict) else (value,)
    return " / ".join("-" if own is None else format(own, form) for own in values)


def _speed(answer: "Replay") -> str:
    timing = answer.timing
    return (
        f"{timing['simulated']} simulated in {timing['simulation_s']:.2f} s "
        f"({timing['per_second']:.0f} per second); {timing['total_s']:.2f} s including reading "
        "and start."
    )


def _next(answer: "Replay", dataset: Path, plot: Path | None) -> str:
    if plot is None:
        return command_of("replay", dataset, "--plot", "replay.png")
    if answer.dataset == "mit_timeseries":
        return command_of("replay", dataset, "--window", 0)  # complete runs
    value = "tripod_radius=0.041" if answer.dataset == "rpi_2dgad" else "mu_pusher=0.2"
    return command_of("replay", dataset, "--set", value)
