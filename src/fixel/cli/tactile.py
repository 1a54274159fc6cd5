"""`fixel tactile`: the board that reads the tactile fixels."""

import json
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson

if TYPE_CHECKING:
    from fixel.testbed.serial_port import PortSeen
    from fixel.testbed.tactile import TactileReader
    from fixel.testbed.tactile_reading import TactileReading
    from fixel.workflows.acquisition.tactile import TactileCheck

app = typer.Typer(
    help="The Arduino that feels what the fixels touch.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Port = Annotated[
    str | None,
    typer.Option(
        help="Serial port of the board: /dev/ttyACM0, COM4.", metavar="PORT", show_default=False
    ),
]


@app.command("ports")
def ports(as_json: AsJson = False) -> None:
    """List the serial ports of this computer."""
    from fixel.workflows.acquisition.tactile import serial_ports

    show_ports(serial_ports(), as_json, "fixel tactile check --port")


def show_ports(found: "list[PortSeen]", as_json: bool, follow: str) -> None:
    """Print ports as a table or as JSON, and the next command."""
    from fixel.cli.screen import table

    if as_json:
        typer.echo(json.dumps({"ports": [port._asdict() for port in found]}))
        return
    if not found:
        typer.echo("No serial ports. Plug the device in; on Linux, dmesg says what it became.")
        return
    rows = [(port.port, port.description, port.in_use_by or "nobody") for port in found]
    typer.echo("\n".join(table(("port", "what", "in use by"), rows, left=3)))
    typer.echo(f"\nNext: {follow} {found[0].port}")


@app.command("check")
def check(
    port: Port = None,
    readings: Annotated[int, typer.Option(help="How often to ask.", min=1)] = 300,
    deadline: Annotated[
        float, typer.Option(help="What counts as in time [ms].", min=0.1, metavar="MS")
    ] = 15.0,
    as_json: AsJson = False,
) -> None:
    """Ask the board many times; exit code 1 if an answer was missing, late or damaged."""
    from fixel.cli.screen import progress_bar
    from fixel.workflows.acquisition.tactile import check_tactile

    found = check_tactile(
        port,
        readings=readings,
        deadline=1e-3 * deadline,
        progress=None if as_json else progress_bar("asking"),
    )
    typer.echo(json.dumps(found.summary()) if as_json else "\n".join(_checked(found)))
    if not found.passed:
        raise typer.Exit(1)


def _checked(found: "TactileCheck") -> list[str]:
    from fixel.cli.screen import seconds

    counts = found.statistics
    with_time = "with time stamps" if found.protocol > 1 else "bits alone"
    lines = [f"{found.port}: tactile board, protocol {found.protocol}, {with_time}"]
    if found.thresholds:
        blue, red, green = found.thresholds
        lines += [f"thresholds   blue {blue}, red {red}, green {green} of 1023"]
    lines += [
        f"asked        {counts['asked']} in {seconds(found.seconds)}",
        f"answered     {counts['answered']}",
        f"missing      {counts['missing']} within {1e3 * found.deadline:.3g} ms",
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
        lines += [f"broken off   {found.trouble}"]
    return [*lines, "", f"Next: fixel tactile watch --port {found.port}"]


@app.command("watch")
def watch(
    port: Port = None,
    duration: Annotated[
        float | None, typer.Option(help="For how long [s].", min=0.0, show_default="until Ctrl-C")
    ] = None,
    rate: Annotated[float, typer.Option(help="Readings a second [Hz].", min=0.1)] = 30.0,
    threshold: Annotated[
        int | None, typer.Option(help="Of all three sensors, of 1023.", min=0, max=1023)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show what the board feels, live; with --json a line a reading."""
    from fixel.workflows.acquisition.tactile import watch_tactile

    thresholds = None if threshold is None else (threshold,) * 3
    live = sys.stdout.isatty() and not as_json
    last = ""
    for reader, reading in watch_tactile(
        port, interval=1.0 / rate, duration=duration, thresholds=thresholds
    ):
        line = _as_json(reading) if as_json else _line(reader, reading)
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
    from fixel.testbed.tactile_bits import COLOURS, FIXELS, contact_mode

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
    return f"{fixels}  ({trip}, {counts.asked} asked, {lost} lost){volts}" + (
        f"  {reading.problem}" if reading.problem else ""
    )


def _as_json(reading: "TactileReading") -> str:
    return json.dumps(
        {
            "bits": reading.bits,
            "time_s": reading.time,
            "device_time_s": reading.device_time,
            "values": reading.values,
            "problem": reading.problem,
        }
    )
