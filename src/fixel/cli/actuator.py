"""`fixel actuator`: the drive that pushes."""

import json
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson

if TYPE_CHECKING:
    from fixel.workflows.acquisition.actuator import ActuatorAnswer

app = typer.Typer(
    help="The drive that pushes: a GRBL controller, a person, or none.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Port = Annotated[
    str | None,
    typer.Option(
        help="Serial port of the controller: /dev/ttyUSB0, COM5.",
        metavar="PORT",
        show_default=False,
    ),
]
Driver = Annotated[
    str, typer.Option(help="Of what kind: grbl, manual or simulated.", metavar="DRIVER")
]


@app.command("ports")
def ports(as_json: AsJson = False) -> None:
    """List the serial ports of this computer."""
    from fixel.cli.tactile import show_ports
    from fixel.workflows.acquisition.tactile import serial_ports

    show_ports(serial_ports(), as_json, "fixel actuator where --port")


@app.command("home")
def home(port: Port = None, driver: Driver = "grbl", as_json: AsJson = False) -> None:
    """Let the drive go to its end switch, and know where it is."""
    from fixel.cli.screen import notify
    from fixel.workflows.acquisition.actuator import chosen_actuator, home_actuator

    _show(home_actuator(chosen_actuator(driver, port, notify=notify)), as_json, port)


@app.command("move")
def move(
    port: Port = None,
    to: Annotated[
        float | None, typer.Option(help="Position to go to [mm].", metavar="MM", show_default=False)
    ] = None,
    by: Annotated[
        float | None,
        typer.Option(help="Or how much further [mm].", metavar="MM", show_default=False),
    ] = None,
    speed: Annotated[float, typer.Option(help="[mm/s]", metavar="MM/S")] = 13.5,
    driver: Driver = "grbl",
    dead_man: Annotated[
        float | None,
        typer.Option(
            help="For how long it may go on without this program [s].",
            metavar="S",
            show_default="0.5, or as the controller's acceleration needs",
        ),
    ] = None,
    unlock: Annotated[
        bool, typer.Option("--unlock", help="End an alarm first, without homing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Move the drive. Any key, Ctrl-C, or `fixel actuator stop` elsewhere stops it at once."""
    from fixel.cli.screen import notify
    from fixel.workflows.acquisition.actuator import chosen_actuator, move_actuator

    if sys.stdin.isatty() and driver == "grbl":
        notify("Any key stops the drive.")
    answer = move_actuator(
        chosen_actuator(driver, port, notify=notify, dead_man=dead_man),
        to=None if to is None else 1e-3 * to,
        by=None if by is None else 1e-3 * by,
        speed=1e-3 * speed,
        unlock=unlock,
    )
    _show(answer, as_json, port)


@app.command("stop")
def stop(port: Port = None, as_json: AsJson = False) -> None:
    """Stop every drive that a program of yours moves, or the one at a port, at once.

    The drive loses its place: home it before you move it again.
    """
    from fixel.workflows.acquisition.actuator_stop import stop_actuators

    stopped = stop_actuators(port)
    if as_json:
        typer.echo(json.dumps({"stopped": stopped}))
        return
    typer.echo("\n".join(f"stopped the drive at {one}" for one in stopped))
    typer.echo(f"Next: fixel actuator home --port {stopped[0]}")


@app.command("where")
def where(port: Port = None, driver: Driver = "grbl", as_json: AsJson = False) -> None:
    """Show the position of the drive; it does not move."""
    from fixel.cli.screen import notify
    from fixel.workflows.acquisition.actuator import chosen_actuator, where_is_actuator

    _show(where_is_actuator(chosen_actuator(driver, port, notify=notify)), as_json, port)


def _show(answer: "ActuatorAnswer", as_json: bool, port: str | None) -> None:
    if as_json:
        typer.echo(json.dumps(answer.summary()))
        return
    low, high = answer.reach
    state = f", {answer.state}" if answer.state else ""
    at = f" --port {port}" if port else f" --driver {answer.driver}"
    follow = f"fixel actuator {'home' if answer.state == 'Alarm' else 'move --by 10'}{at}"
    typer.echo(
        f"{answer.driver}: at {1e3 * answer.position:.3f} mm of {1e3 * low:.4g} to"
        f" {1e3 * high:.4g} mm{state}\nNext: {follow}"
    )
