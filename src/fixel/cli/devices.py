"""`fixel tactile`, `actuator` and `overlay`: tactile board, drive, and live outlines."""

import json
import sys
from contextlib import suppress
from itertools import islice
from math import degrees, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import CAMERA, AsJson, ProjectFolder, argument, option, with_options
from fixel.cli.screen import command_line, command_of, notify, paragraphs, print_answer, wrote
from fixel.errors import InvalidInput
from fixel.progress import show_progress, time_text
from fixel.table import Table

if TYPE_CHECKING:
    from fixel.testbed.frame_source import FrameSource
    from fixel.testbed.serial_port import PortSeen
    from fixel.testbed.tactile import TactileReader, TactileReading
    from fixel.vision.marks import Rig
    from fixel.workflows.acquisition.devices import ActuatorAnswer, TactileCheck
    from fixel.workflows.acquisition.overlay import Look, Overlay, Tolerance

tactile = typer.Typer(
    help="Check and watch the board of the fixels' contact sensors.", no_args_is_help=True
)

Port = Annotated[
    str | None,
    typer.Option(
        help="Serial port of the board: /dev/ttyACM0, COM4.", metavar="PORT", show_default=False
    ),
]


@tactile.command("ports")
def ports(as_json: AsJson = False) -> None:
    """List the serial ports of this computer."""
    from fixel.testbed.serial_port import found_ports

    _print_ports(found_ports(), as_json, "fixel tactile check --port")


def _print_ports(found: "list[PortSeen]", as_json: bool, follow: str) -> None:
    """Print ports as a table or as JSON, and the next command."""
    rows = [(port.port, port.description, port.in_use_by or "no program") for port in found]
    lines = [
        "No serial ports. Plug the device in, then list again; on Linux, dmesg shows its port."
    ]
    if found:
        lines = [*Table(("port", "device", "in use by"), rows, left=3).lines(), ""]
        lines.append(f"Next: {follow} {found[0].port}")
    print_answer(as_json, lambda: {"ports": [port._asdict() for port in found]}, lambda: lines)


@tactile.command("check")
@with_options
def check(
    *,
    port: Port = None,
    readings: int = option(300, "Number of readings.", min=1),
    deadline: float = option(15.0, "Latest time of an answer [ms].", min=0.1, metavar="MS"),
    as_json: AsJson = False,
) -> None:
    """Request many readings of the board and check each.

    The exit code is 1 if one is missing, late or damaged.
    """
    from fixel.workflows.acquisition.devices import check_tactile

    with show_progress(stage="reading") as report:
        found = check_tactile(port, readings=readings, deadline=1e-3 * deadline, progress=report)
    print_answer(as_json, found.summary, lambda: _check_lines(found))
    if not found.passed:
        raise typer.Exit(1)


def _check_lines(found: "TactileCheck") -> list[str]:
    counts = found.statistics
    with_time = "with time stamps" if found.protocol > 1 else "without time stamps"
    lines = [f"{found.port}: tactile board, protocol {found.protocol}, {with_time}"]
    if found.thresholds:
        blue, red, green = found.thresholds
        lines += [f"thresholds   blue {blue}, red {red}, green {green} of 1023"]
    lines += [
        f"requested    {counts['asked']} in {time_text(found.seconds)}",
        f"answered     {counts['answered']}",
        f"missing      {counts['missing']} within {1e3 * found.deadline_s:.3g} ms",
        f"late         {counts['late']}",
        f"damaged      {counts['garbled']}",
        f"stray bytes  {counts['stray_bytes']}",
    ]
    if counts["round_trip_median_s"] is not None:
        median, worst = counts["round_trip_median_s"], counts["round_trip_max_s"]
        lines += [f"round trip   {1e3 * median:.2f} ms median, {1e3 * worst:.2f} ms at most"]
    if found.drift:
        lines += [f"clock        {-1e6 * found.drift:+.0f} ppm against this computer's"]
    if found.trouble:
        lines += [f"stopped      {found.trouble}"]
    return [*lines, "", f"Next: fixel tactile watch --port {found.port}"]


@tactile.command("watch")
@with_options
def watch(
    *,
    port: Port = None,
    duration: float | None = option(None, "Duration [s].", min=0.0, show_default="until Ctrl-C"),
    rate: float = option(30.0, "Readings per second [Hz].", min=0.1),
    threshold: int | None = option(
        None, "Threshold of all three sensors, from 0 to 1023.", min=0, max=1023
    ),
    as_json: AsJson = False,
) -> None:
    """Show the readings of the board live.

    With --json, it prints one line per reading.
    """
    from fixel.workflows.acquisition.devices import watch_tactile

    thresholds = None if threshold is None else (threshold,) * 3
    live = sys.stdout.isatty() and not as_json
    last = ""
    for reader, reading in watch_tactile(
        port, interval=1.0 / rate, duration=duration, thresholds=thresholds
    ):
        content = {
            "bits": reading.bits,
            "time_s": reading.time,
            "device_time_s": reading.device_time,
            "values": reading.values,
            "problem": reading.problem,
        }
        line = json.dumps(content) if as_json else _line(reader, reading)
        news = line.split("  (")[0] + reading.problem
        if live:
            print(f"\r\033[K{line}", end="", flush=True)
        elif as_json or news != last:
            # A file gets the changes only; most readings are the same.
            typer.echo(line)
            last = news
    if live:
        typer.echo("")


def _line(reader: "TactileReader", reading: "TactileReading") -> str:
    from fixel.testbed.tactile import COLOURS, FIXELS, contact_mode

    counts = reader.statistics
    if reading.bits is None:
        return f"no reading: {reading.problem}"
    fixels = ", ".join(
        f"{name} {'TOUCHED' if touched == '1' else 'free   '}"
        for name, touched in zip(FIXELS, contact_mode(reading.bits), strict=True)
    )
    volts = ""
    if reading.values is not None:
        by_colour = dict(zip(COLOURS, reading.values, strict=True))
        volts = "  " + " ".join(f"{by_colour[name] * 5 / 1023:.2f}" for name in FIXELS) + " V"
    lost = counts.asked - counts.answered
    trip = f"{1e3 * counts.round_trips[-1]:.1f} ms" if counts.round_trips else "-"
    return f"{fixels}  ({trip}, {counts.asked} requested, {lost} lost){volts}" + (
        f"  {reading.problem}" if reading.problem else ""
    )


actuator = typer.Typer(help="Home, move and stop the drive of the pusher.", no_args_is_help=True)

DrivePort = Annotated[
    str | None,
    typer.Option(
        help="Serial port of the controller: /dev/ttyUSB0, COM5.",
        metavar="PORT",
        show_default=False,
    ),
]
Driver = Annotated[
    str, typer.Option(help="Kind of drive: grbl, manual or simulated.", metavar="DRIVER")
]
Axes = Annotated[
    str,
    typer.Option(help="Axes of the controller: X, Y, Z, A, or several such as XY.", metavar="AXES"),
]


@actuator.command("ports")
def actuator_ports(as_json: AsJson = False) -> None:
    """List the serial ports of this computer."""
    from fixel.testbed.serial_port import found_ports

    _print_ports(found_ports(), as_json, "fixel actuator where --port")


@actuator.command("home")
def home(
    port: DrivePort = None, driver: Driver = "grbl", axes: Axes = "X", as_json: AsJson = False
) -> None:
    """Home the drive: move it to its end switch and set its position."""
    from fixel.workflows.acquisition.devices import chosen_actuator, home_actuator

    drive = chosen_actuator(driver, port, axes=axes, notify=notify)
    _print_position(home_actuator(drive), as_json, port, axes)


@actuator.command("move")
@with_options
def move(
    *,
    port: DrivePort = None,
    to: str | None = option(
        None,
        "Target position; with --axes XY one for each, such as 40,10 [mm].",
        metavar="MM",
        show_default=False,
    ),
    by: str | None = option(
        None, "Distance to move, instead of --to [mm].", metavar="MM", show_default=False
    ),
    axes: Axes = "X",
    speed: float = option(13.5, "Speed [mm/s].", metavar="MM/S"),
    driver: Driver = "grbl",
    dead_man: float | None = option(
        None,
        "Time after which the drive stops if this program no longer answers [s].",
        metavar="S",
        show_default="0.5, or longer if the acceleration of the controller requires it",
    ),
    unlock: bool = option(False, "Clear an alarm first, without homing.", "--unlock"),
    as_json: AsJson = False,
) -> None:
    """Move the drive. Any key, Ctrl-C, or `fixel actuator stop` elsewhere stops it at once."""
    from fixel.workflows.acquisition.devices import chosen_actuator, move_actuator

    if sys.stdin.isatty() and driver == "grbl":
        notify("Any key stops the drive.")
    answer = move_actuator(
        chosen_actuator(driver, port, axes=axes, notify=notify, dead_man=dead_man),
        to=_metres(to, "--to", len(axes)),
        by=_metres(by, "--by", len(axes)),
        speed=1e-3 * speed,
        unlock=unlock,
    )
    _print_position(answer, as_json, port, axes)


def _metres(text: str | None, where: str, n_axes: int) -> float | tuple[float, ...] | None:
    """Parse one length in millimetres, or one for each axis."""
    if text is None:
        return None
    with suppress(ValueError):
        values = tuple(1e-3 * float(part) for part in text.split(","))
        if len(values) == n_axes:
            return values if n_axes > 1 else values[0]
    expected = "a number [mm]" if n_axes == 1 else f"{n_axes} numbers with commas between [mm]"
    raise InvalidInput(where, found=repr(text), expected=expected)


@actuator.command("stop")
def stop(port: DrivePort = None, as_json: AsJson = False) -> None:
    """Stop every drive of your programs, or only that at a port.

    The position is lost: home the drive before you move it again.
    """
    from fixel.testbed.emergency import stop_actuators

    stopped = stop_actuators(port)
    print_answer(
        as_json,
        lambda: {"stopped": stopped},
        lambda: [
            *(f"stopped the drive at {one}" for one in stopped),
            f"Next: fixel actuator home --port {stopped[0]}",
        ],
    )


@actuator.command("where")
def where(
    port: DrivePort = None, driver: Driver = "grbl", axes: Axes = "X", as_json: AsJson = False
) -> None:
    """Show the position of the drive without moving it."""
    from fixel.workflows.acquisition.devices import chosen_actuator, where_is_actuator

    drive = chosen_actuator(driver, port, axes=axes, notify=notify)
    _print_position(where_is_actuator(drive), as_json, port, axes)


def _print_position(answer: "ActuatorAnswer", as_json: bool, port: str | None, axes: str) -> None:
    low, high = answer.reach_m
    state = f", {answer.state}" if answer.state else ""
    if not answer.zero_known:
        state += "; without homing, 0 is where the controller was switched on or reset"
    at = f"--port {port}" if port else f"--driver {answer.driver}"
    at += f" --axes {axes}" if axes != "X" else ""
    place = ", ".join(f"{1e3 * each:.3f}" for each in answer.place_m)
    within = f" of {1e3 * low:.4g} to {1e3 * high:.4g} mm" if len(axes) == 1 else ""
    again = f"move --by {','.join(['10'] * len(axes))}"
    print_answer(
        as_json,
        answer._asdict,
        lambda: [
            f"{answer.driver}: at {place} mm{within}{state}",
            f"Next: fixel actuator {'home' if answer.state == 'Alarm' else again} {at}",
        ],
    )


NOT_IN_PLACE = 4
WAKING = 5  # pictures that are skipped: a camera that was just switched on sends dark ones
RigName = Annotated[
    str,
    typer.Option(
        help="Rig file with camera and markers, or name of an example rig.", metavar="RIG"
    ),
]
PagePort = Annotated[
    int | None,
    typer.Option(
        help="Port of the page; it is served to this machine only.",
        min=1,
        max=65535,
        show_default="any free one",
    ),
]


@with_options
def overlay(
    *,
    rig: RigName,
    scene: Path | None = argument(
        None,
        "Scene file, YAML or JSON.",
        metavar="SCENE",
        exists=True,
        dir_okay=False,
        show_default=False,
    ),
    camera: Annotated[str, CAMERA] = "0",
    experiment: str | None = option(
        None, "Stored experiment, instead of a scene file.", metavar="KEY"
    ),
    project: ProjectFolder = Path(),
    anchor: str = option(
        "", "Part to anchor at: all poses move so that it is where it is seen.", metavar="NAME"
    ),
    tolerance_mm: float | None = option(
        None, "Largest allowed position error of a part [mm].", show_default="the rig's"
    ),
    tolerance_deg: float | None = option(
        None, "Largest allowed angle error of a part [deg].", show_default="the rig's"
    ),
    port: PagePort = None,
    once: bool = option(
        False,
        "Check once and write a picture; exit code 0 if all parts are in place, 4 if not.",
        "--once",
    ),
    output: Path = option(Path("overlay.png"), "Picture to write with --once: .png."),
    as_json: AsJson = False,
) -> None:
    """Show planned poses on the live picture, and their errors."""
    from fixel.drawing.chart import require_file
    from fixel.formats.rig_file import rig_of
    from fixel.workflows.acquisition.overlay import Overlay, scene_of

    picture = output if once else None
    require_file(picture, (".png",))
    bench = rig_of(rig)
    placed = scene_of(scene, experiment, project)
    tolerance = _tolerance(bench, tolerance_mm, tolerance_deg)
    looks = Overlay(bench, placed, tolerance, anchor=anchor)
    heading = f"{experiment or (scene.name if scene else '')} on {bench.name}"
    look = _look(looks, camera, picture, heading, port, show=not as_json)
    setting = ["--camera", camera, "--rig", rig] + (["--scene", str(scene)] if scene else [])
    files = {"picture": str(output)} if once else {}
    print_answer(
        as_json, lambda: {**look.summary(), "files": files}, lambda: _lines(look, setting, picture)
    )
    if once and not look.placed:
        raise typer.Exit(NOT_IN_PLACE)


def _tolerance(bench: "Rig", mm: float | None, deg: float | None) -> "Tolerance":
    """Return the tolerance; where none is given, that of the rig."""
    from fixel.workflows.acquisition.overlay import Tolerance

    return Tolerance(
        distance=bench.position_tolerance if mm is None else 1e-3 * mm,
        angle=bench.angle_tolerance if deg is None else radians(deg),
    )


def _look(
    looks: "Overlay",
    camera: str,
    picture: Path | None,
    heading: str,
    port: int | None,
    *,
    show: bool,
) -> "Look":
    """Look once and write a picture, or show the overlay in a browser."""
    from fixel.testbed.open_source import source_of

    size, once = looks.rig.camera.lens.image_size, picture is not None
    with source_of(camera, size=size, as_fast_as_possible=once) as source:
        if picture is not None:
            return _once(looks, source, picture)
        return _live(looks, source, heading, port, show=show)


def _lines(look: "Look", setting: list[str], picture: Path | None) -> list[str]:
    """A few lines of text: the verdict, the errors, the file, the next command."""
    # After a part has been moved, the same command.
    record = command_of("record", *setting, "--out", "recording")
    return paragraphs(
        [look.sentence],
        _errors(look),
        [*look.problems, *look.remarks],
        wrote([picture]),
        [f"Next: {record if look.placed else command_line()}"],
    )


def _errors(look: "Look") -> list[str]:
    rows = []
    for part in look.checked:
        if part.error is None:
            rows.append((part.name, "-", "-", "-", f"not seen: {part.reason}"))
        else:
            rows.append((part.name, *look.words(part), "in place" if part.within else "off"))
    allowed = look.tolerance
    return [
        *Table(("measured - planned", "x [mm]", "y [mm]", "angle [deg]", "verdict"), rows).lines(),
        f"tolerance: {1e3 * allowed.distance:.3g} mm, {degrees(allowed.angle):.3g} deg",
    ]


def _once(looks: "Overlay", source: "FrameSource", output: Path) -> "Look":
    from fixel.workflows.acquisition.overlay import draw_look, frames_of, look_once, write_png

    stream = source.open()
    frames = islice(frames_of(source, stream.live), WAKING if stream.live else 0, None)
    picture, look = look_once(looks, frames)
    write_png(output, draw_look(picture, look, words=True))
    return look


def _live(
    looks: "Overlay", source: "FrameSource", heading: str, port: int | None, *, show: bool
) -> "Look":
    """Show the overlay in a browser until the pictures end, or Ctrl-C."""
    from fixel.web.live import LiveView
    from fixel.web.live_pages import overlay_page
    from fixel.web.serve import WebServer
    from fixel.workflows.acquisition.overlay import frames_of, watch

    view = LiveView()
    look: Look | None = None
    stream = source.open()

    def end(reason: str) -> None:
        notify(f"The camera stopped: {reason}.")
        if look is not None:
            view.show(None, look.summary() | {"problems": [f"The camera stopped: {reason}"]})

    with WebServer([overlay_page(view, heading)], port=port) as server:
        notify(f"Open {server.link}\nStop with Ctrl-C.")
        with suppress(KeyboardInterrupt):
            for look in watch(looks, frames_of(source, stream.live, end), view.show):
                if show and sys.stderr.isatty():
                    print(f"\r{look.sentence:<60.60}", end="", file=sys.stderr, flush=True)
    if look is None:
        raise InvalidInput("--camera", found="no picture", expected="a camera that sends pictures")
    return look
