"""The `fixel` command: its sub-commands and its exit codes.

    0    done
    1    something else went wrong; the message is on standard error
    2    bad input: a wrong option, or an invalid scene or dataset; message as above
    3    the simulation did not finish; what was computed until then is in the answer
    4    `fixel overlay --once`: something is not in its place
    130  interrupted
    141  standard output was closed, as by `| head`

With `--json` the message is a JSON object on standard output: `{"error": {...}}`.

Nothing heavy is imported here: each command imports its workflow when it runs.
"""

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Final, cast

import typer
from typer.core import TyperGroup

from fixel import errors
from fixel.capability.capability import Capability
from fixel.cli import (
    bench,
    db,
    demo,
    devices,
    jobs,
    plan,
    project,
    record,
    replay,
    serve,
    show,
    testbed,
)
from fixel.cli.capability import NOT_SOLVED, typer_command, typer_commands
from fixel.cli.screen import notify
from fixel.workflows.acquisition.camera import CAMERA
from fixel.workflows.capabilities import CAPABILITIES

# Base class of Typer's errors for wrong options; it has no public name of its own.
ClickException = cast(type[Exception], typer.BadParameter.mro()[2])

BAD_INPUT = 2
INTERRUPTED = 130

# Commands in the order of a typical workflow, as `fixel --help` lists them.
SECTIONS: Final[Mapping[str, Mapping[str, Capability | Callable[..., None] | typer.Typer]]] = {
    "Get started": {
        "demo": demo.demo,
        "doctor": demo.doctor,
        "compile": demo.compile_,
        "new": project.new,
        "serve": serve.serve,
    },
    "Simulate": {"simulate": CAPABILITIES["simulate"], "sample": CAPABILITIES["sample"]},
    "Experiments": {
        "import": project.import_,
        "testbed": testbed.app,
        "list": project.list_,
        "show": show.show,
        "compare": CAPABILITIES["compare"],
        "filter": CAPABILITIES["filter"],
        "export": project.export,
    },
    "Calibrate and assess": {
        "calibrate": CAPABILITIES["calibrate"],
        "calibrations": show.calibrations,
        "domain": CAPABILITIES["domain"],
        "error-bound": CAPABILITIES["error-bound"],
        "sensitivity": CAPABILITIES["sensitivity"],
        "uncertainty": CAPABILITIES["uncertainty"],
        "next": CAPABILITIES["next"],
        "table": typer_commands("table", CAPABILITIES, "Check a table for plans, and map it."),
        "plan": plan.app,
        "report": show.report,
    },
    "Bench": {
        "bench": bench.bench,
        "camera": typer_commands(
            "camera", CAMERA, "Calibrate, place and check a camera; print boards and tags."
        ),
        "overlay": devices.overlay,
        "record": record.app,
        "track": record.track,
        "tactile": devices.tactile,
        "actuator": devices.actuator,
    },
    "Published data": {"data": project.data, "replay": replay.replay},
    "Jobs and database": {"jobs": jobs.app, "db": db.app, "trust": jobs.trust},
}


COMMANDS: Final = {name: one for commands in SECTIONS.values() for name, one in commands.items()}
HELP: Final = ["-h", "--help"]


class InSections(TyperGroup):
    """Command group that lists commands under the headings of `SECTIONS`, in their order."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:  # Typer would end without its hint
            raise SystemExit(INTERRUPTED) from stop
        except ClickException as problem:
            error: Any = problem
            name = getattr(error, "option_name", "").lstrip("-").replace("-", "_")
            if name and "option" in (own.name for own in error.ctx.command.params):
                error.possibilities = [*(error.possibilities or ()), f"--option {name}=VALUE"]
            raise

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        width = formatter.width - 6 - max(map(len, self.commands))
        for title, names in SECTIONS.items():
            with formatter.section(title):
                rows = [(name, self.commands[name].get_short_help_str(width)) for name in names]
                formatter.write_dl(rows)


def _print_version(wanted: bool) -> None:
    if wanted:
        import fixel

        typer.echo(f"fixel {fixel.__version__}")
        raise typer.Exit


def main(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Show the version and exit.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Simulate, calibrate and plan pushes of rigid parts on a table."""


def program_of(names: Iterable[str]) -> typer.Typer:
    """Return the `fixel` command with some of its sub-commands: one asked for is ready sooner."""
    program = typer.Typer(
        cls=InSections,
        help=main.__doc__,
        no_args_is_help=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": HELP},
    )
    program.callback()(main)
    for name in names:
        command = COMMANDS[name]
        if isinstance(command, Capability):
            group = any(one.group == name for one in CAPABILITIES.values())
            made = typer_commands(name, CAPABILITIES) if group else typer_command(command)
        else:
            made = command
        if isinstance(made, typer.Typer):
            program.add_typer(made, name=name)
        else:
            program.command(name)(made)
    return program


@cache
def __getattr__(name: str) -> Any:
    if name == "app":  # the whole command, for documentation and completion
        return program_of(COMMANDS)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _show_help(program: typer.Typer, path: Sequence[str], name: str) -> bool:
    """Print the help of a command of these names, if there is one."""
    command: Any = typer.main.get_command(program)
    context = command.context_class(command, info_name=name, **command.context_settings)
    for word in path:
        command = getattr(command, "commands", {}).get(word)
        if command is None:
            return False
        settings = command.context_settings
        context = command.context_class(command, info_name=word, parent=context, **settings)
    for own in command.params:
        if own.param_type_name == "argument":
            own.display_type_rich = lambda ctx: ""  # Typer would add `<str>` to its name
    typer.echo(command.get_help(context))
    return True


def run(
    arguments: Sequence[str] | None = None,
    *,
    program: typer.Typer | None = None,
    name: str = "fixel",
) -> None:
    """Run a command line and exit.

    An expected failure becomes one sentence and an exit code; with `--json`, one JSON object. A
    closed pipe raises `BrokenPipeError`.
    """
    if arguments is not None:  # commands repeat these, in provenance and in proposed commands
        sys.argv = [name, *arguments]
    given = sys.argv[1:]
    as_json = "--json" in given
    asked = given[:1] if given[:1] and given[0] in COMMANDS else COMMANDS
    try:
        program = program or program_of(asked)
        # The parser of options takes its time, and help needs none.
        if given and given[-1] in HELP and _show_help(program, given[:-1], name):
            sys.exit()
        # With --json, errors in options come here too.
        code = program(arguments, prog_name=name, standalone_mode=not as_json)
    except (errors.InvalidInput, errors.DatasetMissing, errors.NotStored, ClickException) as error:
        _exit(BAD_INPUT, error, as_json)
    except errors.SolveFailed as error:
        _exit(NOT_SOLVED, error, as_json)
    except errors.FixelError as error:
        _exit(BAD_INPUT if getattr(error, "is_input", False) else 1, error, as_json)
    except OSError as error:
        failure = errors.machine_failure(error)
        if failure is None:
            raise
        _exit(1, failure, as_json)
    except (KeyboardInterrupt, typer.Abort) as error:
        _exit(INTERRUPTED, error, as_json)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            _exit(INTERRUPTED, end.__cause__, as_json)
        if isinstance(end.__context__, BrokenPipeError):  # Typer has turned it into code 1
            raise end.__context__ from None
        raise
    sys.exit(code if isinstance(code, int) else 0)


def _exit(code: int, error: BaseException | None, as_json: bool) -> None:
    if code == INTERRUPTED:
        hint = getattr(error, "hint", "")
        error = errors.Interrupted(hint=hint)
        sentence = f"stopped; {hint}" if hint else "stopped."
    else:
        message = getattr(error, "format_message", error.__str__)
        sentence = message()
    if not as_json:
        notify(f"fixel: {sentence}")
        sys.exit(code)
    content: dict[str, Any] = {"kind": type(error).__name__, "sentence": sentence}
    content |= {"exit_code": code, **getattr(error, "details", {})}
    print(json.dumps({"error": content}, allow_nan=False), flush=True)
    sys.exit(code)
