"""The `fixel` command: its sub-commands and its exit codes.

    0    done
    1    something else went wrong, said on standard error
    2    bad input: a wrong option, or a scene or dataset that cannot be; said likewise
    3    the simulation did not finish; what was computed until then is in the answer
    4    `fixel overlay --once`: something is not in its place
    130  interrupted

Nothing heavy is imported here: each command imports its workflow when it runs.
"""

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from fixel.cli import (
    actuator,
    benchmark,
    calibrate,
    camera,
    data,
    db,
    demo,
    doctor,
    domain,
    export,
    film,
    filter,
    jobs,
    overlay,
    project,
    record,
    replay,
    report,
    sample,
    sensitivity,
    serve,
    show,
    simulate,
    tactile,
    track,
    uncertainty,
)
from fixel.errors import DatasetMissing, FixelError, InvalidInput, NotStored, SolveFailed

BAD_INPUT = 2
NOT_SOLVED = 3
INTERRUPTED = 130

app = typer.Typer(
    help="Planar rigid bodies in frictional contact, solved as complementarity problems.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("simulate")(simulate.simulate)
app.command("replay")(replay.replay)
app.command("sample")(sample.sample)
app.command("track")(track.track)
app.command("new")(project.new)
app.command("import")(project.import_)
app.command("list")(project.list_)
app.command("show")(show.show)
app.command("compare")(show.compare)
app.command("filter")(filter.filter_)
app.command("calibrate")(calibrate.calibrate)
app.command("report")(report.report)
app.command("sensitivity")(sensitivity.sensitivity)
app.command("export")(export.export)
app.command("data")(data.data)
app.add_typer(camera.app, name="camera")
app.add_typer(domain.app, name="domain")
project.testbed.command("film")(film.film)
app.add_typer(project.testbed, name="testbed")
app.add_typer(record.app, name="record")
project.testbed.command("serve")(record.serve)
app.add_typer(tactile.app, name="tactile")
app.add_typer(actuator.app, name="actuator")
app.add_typer(db.app, name="db")
app.add_typer(jobs.app, name="jobs")
app.add_typer(benchmark.app, name="benchmark")
app.command("uncertainty")(uncertainty.uncertainty)
app.command("serve")(serve.serve)
app.command("overlay")(overlay.overlay)
app.command("demo")(demo.demo)
app.command("doctor")(doctor.doctor)


def _print_version(wanted: bool) -> None:
    if wanted:
        import fixel

        typer.echo(f"fixel {fixel.__version__}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Show the version and exit.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Planar rigid bodies in frictional contact, solved as complementarity problems."""


def run(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit; an expected failure becomes one sentence and an exit code."""
    if arguments is not None:  # commands repeat what was typed: as provenance, and as what is next
        sys.argv = ["fixel", *arguments]
    try:
        app(arguments, prog_name="fixel")
    except (InvalidInput, DatasetMissing, NotStored) as error:
        _exit(BAD_INPUT, f"fixel: {error}")
    except SolveFailed as error:
        _exit(NOT_SOLVED, f"fixel: {error}")
    except FixelError as error:
        _exit(1, f"fixel: {error}")
    except KeyboardInterrupt:
        _exit(INTERRUPTED, "fixel: stopped.")
    except SystemExit as end:
        # Typer has already turned an interrupt inside a command into this code, without a word.
        if end.code == INTERRUPTED:
            _exit(INTERRUPTED, "fixel: stopped.")
        raise


def _exit(code: int, sentence: str) -> None:
    print(sentence, file=sys.stderr)
    sys.exit(code)
