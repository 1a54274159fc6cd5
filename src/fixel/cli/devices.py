"""`fixel tactile`, `actuator` and `overlay`: tactile board, drive, and live outlines."""

import json
import sys
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.capability.options import Door
from fixel.cli import screen
from fixel.cli.capability import command, subcommand
from fixel.errors import InvalidInput, number_of
from fixel.progress import show_progress, time_text
from fixel.table import Table
from fixel.workflows.acquisition import Camera

if TYPE_CHECKING:
    from fixel.testbed.frame_source import FrameSource
    from fixel.testbed.tactile import TactileReader, TactileReading
    from fixel.workflows.acquisition.devices import ActuatorAnswer, TactileCheck
    from fixel.workflows.acquisition.overlay import Look, Overlay

tactile = typer.Typer(
    help="Check and watch the board of the fixels' contact sensors.", no_args_is_help=True
)


BoardPort = Annotated[
    str | None,
    Door(metavar="PORT", meaning="Required. Serial port of the board: /dev/ttyACM0, COM4."),
]
DrivePort = Annotated[
    str | None,
    Door(
        metavar="PORT",
        meaning="Serial port of the controller: /dev/ttyUSB0, COM5; required for --driver grbl.",
    ),
]
Driver = Annotated[str, Door(metavar="DRIVER", meaning="Kind of drive: grbl, manual or simulated.")]
Axes = Annotated[
    str, Door(metavar="AXES", meaning="Axes of the controller: X, Y, Z, A, or several such as XY.")
]
DEAD_MAN = "0.5, or longer if the acceleration of the controller requires it"


def _ports(following: str) -> Callable[..., None]:
    """Return the command that lists serial ports, and proposes another one."""

    @command
    def ports() -> screen.CommandAnswer:
        """List the serial ports of this computer."""
        from fixel.testbed.serial_port import found_ports

        found = found_ports()
        rows = [(port.port, port.description, port.in_use_by or "no program") for port in found]
        lines = [
            "No serial ports. Plug the device in, then list again; on Linux, dmesg shows its port."
        ]
        if found:
            lines = [*Table(("port", "device", "in use by"), rows, left=3).lines(), ""]
            lines.append(f"Next: fixel {following} --port {found[0].port}")
        return screen.CommandAnswer({"ports": [port._asdict() for port in found]}, lines)

    return ports


tactile.command("ports")(_ports("tactile check"))


@subcommand(tactile, "check")
def check(
    *,
    port: BoardPort = None,
    readings: Annotated[int, Door(least=1)] = 300,
    deadline: Annotated[float, Door(flag="--deadline", unit="ms", least=1e-4)] = 0.015,
) -> screen.CommandAnswer:
    """Request many readings of the board and check each.

    The exit code is 1 if one is missing, late or damaged.

    Parameters
    ----------
    readings : int
        Number of readings.
    deadline : float
        Latest time of an answer [s].
    """
    from fixel.workflows.acquisition.devices import check_tactile

    with show_progress(stage="reading") as report:
        found = check_tactile(port, readings=readings, deadline=deadline, progress=report)
    return screen.CommandAnswer(found.summary(), _check_lines(found), code=0 if found.passed else 1)


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


@subcommand(tactile, "watch")
def watch(
    *,
    port: BoardPort = None,
    duration: Annotated[float | None, Door(least=0.0, usual="until Ctrl-C")] = None,
    rate: Annotated[float, Door(least=0.1)] = 30.0,
    threshold: Annotated[int | None, Door(least=0, most=1023)] = None,
    as_json: bool,
) -> None:
    """Show the readings of the board live.

    With --json, it prints one line per reading.

    Parameters
    ----------
    duration : float, optional
        Duration [s].
    rate : float
        Readings per second [Hz].
    threshold : int, optional
        Threshold of all three sensors, from 0 to 1023.
    """
    from fixel.workflows.acquisition.devices import watch_tactile

    options: Any = {"rate": rate, "duration": duration, "threshold": threshold}
    live = sys.stdout.isatty() and not as_json
    last = ""
    for reader, reading in watch_tactile(port, **options):
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

actuator.command("ports")(_ports("actuator where"))


@subcommand(actuator, "home")
def home(
    *, port: DrivePort = None, driver: Driver = "grbl", axes: Axes = "X"
) -> screen.CommandAnswer:
    """Home the drive: move it to its end switch and set its position."""
    from fixel.workflows.acquisition.devices import chosen_actuator, commanded

    drive = chosen_actuator(driver, port, axes=axes, notify=screen.notify)
    return _position(commanded(drive, drive.home), port, axes)


@subcommand(actuator, "move")
def move(
    *,
    port: DrivePort = None,
    to: Annotated[str | None, Door(metavar="MM")] = None,
    by: Annotated[str | None, Door(metavar="MM")] = None,
    axes: Axes = "X",
    speed: Annotated[float, Door(flag="--speed", unit="mm/s", metavar="MM/S", above=0.0)] = 0.0135,
    driver: Driver = "grbl",
    dead_man: Annotated[float | None, Door(metavar="S", usual=DEAD_MAN, above=0.0)] = None,
    unlock: Annotated[bool, Door(flag="--unlock")] = False,
) -> screen.CommandAnswer:
    """Move the drive. Any key, Ctrl-C, or `fixel actuator stop` elsewhere stops it at once.

    Parameters
    ----------
    to : str, optional
        Target position; with --axes XY one for each, such as 40,10 [mm].
    by : str, optional
        Distance to move, instead of --to [mm].
    speed : float
        Speed [mm/s].
    dead_man : float, optional
        Time after which the drive stops if this program no longer answers [s].
    unlock : bool
        Clear an alarm first, without homing.
    """
    from fixel.workflows.acquisition.devices import chosen_actuator, move_actuator

    if sys.stdin.isatty() and driver == "grbl":
        screen.notify("Any key stops the drive.")
    answer = move_actuator(
        chosen_actuator(driver, port, axes=axes, notify=screen.notify, dead_man=dead_man),
        to=_metres(to, "to", len(axes)),
        by=_metres(by, "by", len(axes)),
        speed=speed,
        unlock=unlock,
    )
    return _position(answer, port, axes)


def _metres(text: str | None, where: str, n_axes: int) -> float | tuple[float, ...] | None:
    """Parse one length in millimetres, or one for each axis."""
    if text is None:
        return None
    with suppress(ValueError):
        values = tuple(1e-3 * number_of(part, where) for part in text.split(","))
        if len(values) == n_axes:
            return values if n_axes > 1 else values[0]
    expected = "a number [mm]" if n_axes == 1 else f"{n_axes} numbers with commas between [mm]"
    raise InvalidInput(where, found=repr(text), expected=expected)


# Not by `command`, which imports what checks requests: a stop must not wait for that.
@actuator.command("stop")
def stop(
    port: Annotated[
        str | None, typer.Option(help="Serial port of the drive to stop.", metavar="PORT")
    ] = None,
    as_json: screen.AsJson = False,
) -> None:
    """Stop every drive of your programs, or only that at a port.

    The position is lost: home the drive before you move it again.
    """
    from fixel.testbed.emergency import stop_actuators

    stopped = stop_actuators(port)
    lines = [f"stopped the drive at {one}" for one in stopped]
    lines.append(f"Next: fixel actuator home --port {stopped[0]}")
    screen.print_answer(as_json, lambda: {"stopped": stopped}, lambda: lines)


@subcommand(actuator, "where")
def where(
    *, port: DrivePort = None, driver: Driver = "grbl", axes: Axes = "X"
) -> screen.CommandAnswer:
    """Show the position of the drive without moving it."""
    from fixel.workflows.acquisition.devices import chosen_actuator, commanded

    drive = chosen_actuator(driver, port, axes=axes, notify=screen.notify)
    return _position(commanded(drive), port, axes)


def _position(answer: "ActuatorAnswer", port: str | None, axes: str) -> screen.CommandAnswer:
    """Report the position of the drive, and the next command for it."""
    low, high = answer.reach_m
    state = f", {answer.state}" if answer.state else ""
    if not answer.zero_known:
        state += "; without homing, 0 is where the controller was switched on or reset"
    at = f"--port {port}" if port else f"--driver {answer.driver}"
    at += f" --axes {axes}" if axes != "X" else ""
    place = ", ".join(f"{1e3 * each:.3f}" for each in answer.place_m)
    within = f" of {1e3 * low:.4g} to {1e3 * high:.4g} mm" if len(axes) == 1 else ""
    again = f"move --by {','.join(['10'] * len(axes))}"
    following = f"Next: fixel actuator {'home' if answer.state == 'Alarm' else again} {at}"
    lines = [f"{answer.driver}: at {place} mm{within}{state}", following]
    return screen.CommandAnswer(answer._asdict(), lines)


NOT_IN_PLACE = 4
WAKING = 5  # pictures that are skipped: a camera that was just switched on sends dark ones


@command
def overlay(
    project: Path,
    scene: Annotated[Path | None, Door(metavar="SCENE")] = None,
    *,
    rig: Annotated[str, Door(metavar="RIG")],
    camera: Camera = "0",
    experiment: Annotated[str | None, Door(metavar="KEY")] = None,
    anchor: Annotated[str, Door(metavar="NAME")] = "",
    tolerance: Annotated[float | None, Door(unit="mm", above=0.0, usual="the rig's")] = None,
    tolerance_angle: Annotated[
        float | None, Door(flag="--tolerance-deg", unit="deg", above=0.0, usual="the rig's")
    ] = None,
    port: Annotated[int | None, Door(least=1, most=65535, usual="any free one")] = None,
    once: Annotated[bool, Door(flag="--once")] = False,
    output: Annotated[Path, Door(writes=True)] = Path("overlay.png"),
    as_json: bool,
) -> screen.CommandAnswer:
    """Show planned poses on the live picture, and their errors.

    Parameters
    ----------
    scene : Path, optional
        Scene file, YAML or JSON.
    rig : str
        Rig file with camera and markers, or name of an example rig.
    experiment : str, optional
        Stored experiment, instead of a scene file.
    anchor : str
        Part to anchor at: all poses move so that it is where it is seen.
    tolerance : float, optional
        Largest allowed position error of a part [m].
    tolerance_angle : float, optional
        Largest allowed angle error of a part [rad].
    port : int, optional
        Port of the page; it is served to this machine only.
    once : bool
        Check once and write a picture; exit code 0 if all parts are in place, 4 if not.
    output : Path
        Picture to write with --once: .png.
    """
    from fixel.drawing.chart import require_file
    from fixel.formats.rig_file import rig_of
    from fixel.testbed.open_source import source_of
    from fixel.workflows.acquisition.overlay import Overlay, Tolerance, scene_of

    picture = output if once else None
    require_file(picture, (".png",))
    bench = rig_of(rig)
    placed = scene_of(scene, experiment, project)
    limits = Tolerance(
        distance=tolerance or bench.position_tolerance,
        angle=tolerance_angle or bench.angle_tolerance,
    )
    looks = Overlay(bench, placed, limits, anchor=anchor)
    heading = f"{experiment or (scene.name if scene else '')} on {bench.name}"
    size = bench.camera.lens.image_size
    with source_of(camera, size=size, as_fast_as_possible=once) as source:
        if picture is not None:
            look = _once(looks, source, picture)
        else:
            look = _live(looks, source, heading, port, show=not as_json)
    setting = ["--camera", camera, "--rig", rig] + (["--scene", str(scene)] if scene else [])
    content = look.summary() | {"files": {"picture": str(output)} if once else {}}
    code = NOT_IN_PLACE if once and not look.placed else 0
    return screen.CommandAnswer(content, _lines(look, setting, picture), code)


def _lines(look: "Look", setting: list[str], picture: Path | None) -> list[str]:
    """A few lines of text: the verdict, the errors, the file, the next command."""
    # After a part has been moved, the same command.
    record = screen.command_of("record", *setting, "--out", "recording")
    return screen.paragraphs(
        [look.sentence],
        _errors(look),
        [*look.problems, *look.remarks],
        screen.wrote([picture]),
        [f"Next: {record if look.placed else screen.command_line()}"],
    )


def _errors(look: "Look") -> list[str]:
    rows = [
        (part.name, "-", "-", "-", f"not seen: {part.reason}")
        if part.error is None
        else (part.name, *look.words(part), "in place" if part.within else "off")
        for part in look.checked
    ]
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
        screen.notify(f"The camera stopped: {reason}.")
        if look is not None:
            view.show(None, look.summary() | {"problems": [f"The camera stopped: {reason}"]})

    with WebServer([overlay_page(view, heading)], port=port) as server:
        screen.notify(f"Open {server.link}\nStop with Ctrl-C.")
        with suppress(KeyboardInterrupt):
            for look in watch(looks, frames_of(source, stream.live, end), view.show):
                if show and sys.stderr.isatty():
                    print(f"\r{look.sentence:<60.60}", end="", file=sys.stderr, flush=True)
    if look is None:
        raise InvalidInput("--camera", found="no picture", expected="a camera that sends pictures")
    return look
