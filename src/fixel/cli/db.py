"""`fixel db upgrade|backup|check [PROJECT]`: the database of a project."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder, ProjectPlace, project_at, project_words

if TYPE_CHECKING:
    from fixel.workflows.project.maintenance import Backup, CheckResult, SchemaVersions

MAX_TROUBLES = 20

app = typer.Typer(
    help="Upgrade, back up or check the database of a project.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.command("upgrade")
def upgrade(
    place: ProjectPlace = None, folder: ProjectFolder = Path(), as_json: AsJson = False
) -> None:
    """Bring the tables up to date, or leave them be."""
    from fixel.workflows.project import maintenance

    project = project_at(place, folder)
    versions = maintenance.upgrade(project)
    typer.echo(json.dumps(versions._asdict()) if as_json else _upgraded(versions, project))


@app.command("backup")
def backup(
    file: Annotated[Path, typer.Argument(help="Where the copy goes.", metavar="FILE")],
    place: ProjectPlace = None,
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Copy the database, while others may go on using it."""
    from fixel.workflows.project import maintenance

    done = maintenance.backup(project_at(place, folder), file)
    if as_json:
        paths = {"file": str(done.file), "media": str(done.media)}
        typer.echo(json.dumps(done._asdict() | paths))
    else:
        typer.echo(_backed_up(done))


@app.command("check")
def check(
    place: ProjectPlace = None, folder: ProjectFolder = Path(), as_json: AsJson = False
) -> None:
    """Read all that is stored and report faults.

    Exit code 1 if there are any.
    """
    from fixel.workflows.project import maintenance

    project = project_at(place, folder)
    found = maintenance.check(project)
    typer.echo(json.dumps(found.summary()) if as_json else _checked(found, project))
    if found.troubles:
        raise typer.Exit(1)


@app.command("diagram")
def diagram(
    file: Annotated[Path, typer.Argument(help="Picture: .png, .svg or .pdf.", metavar="FILE")],
    as_json: AsJson = False,
) -> None:
    """Draw the tables and what refers to what, as an entity relationship diagram."""
    from fixel.workflows.project import maintenance

    names = maintenance.diagram(file)
    if as_json:
        typer.echo(json.dumps({"file": str(file), "tables": names}))
    else:
        typer.echo(f"wrote {file}: {len(names)} tables")


def _upgraded(versions: "SchemaVersions", project: Path) -> str:
    if versions.before == versions.after:
        done = f"The database has schema {versions.after} already."
    elif versions.before is None:
        done = f"The database was empty; it has schema {versions.after} now."
    else:
        done = f"The database had schema {versions.before}; it has {versions.after} now."
    return f"{done}\n\nNext: {_command('check', project)}"


def _backed_up(done: "Backup") -> str:
    return (
        f"wrote {done.file}: {done.size} bytes, sha256 {done.sha256}\n"
        f"The media are not in it; they never change, so copy what is new:\n\n"
        f"Next: {shlex.join(['cp', '-rn', str(done.media), f'{done.file}.media'])}"
    )


def _checked(found: "CheckResult", project: Path) -> str:
    blocks = [_contents(found), _troubles(found), [f"Next: {_next(found, project)}"]]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _contents(found: "CheckResult") -> list[str]:
    from fixel.cli.screen import table

    version = "unknown" if found.version is None else found.version
    rows = [(name, str(n)) for name, n in found.counts.items() if n]
    unused = f", {found.unused_files} of them not of this project" if found.unused_files else ""
    return [
        f"{found.engine}, schema {version}",
        *(table(("table", "rows"), rows) if rows else []),
        f"media files: {found.media_files}{unused}",
    ]


def _troubles(found: "CheckResult") -> list[str]:
    if not found.troubles:
        return ["Everything can be read."]
    shown = [f"  {t.where}: {t.sentence}" for t in found.troubles[:MAX_TROUBLES]]
    left_out = len(found.troubles) - len(shown)
    more = [f"  ... and {left_out} more; --json has them all"] if left_out else []
    plural = "" if len(found.troubles) == 1 else "s"
    return [f"{len(found.troubles)} thing{plural} wrong", *shown, *more]


def _next(found: "CheckResult", project: Path) -> str:
    """Return advice against the first fault, or else the command that most users need next."""
    if found.troubles:
        return found.troubles[0].hint.removeprefix("run: ")
    return _next_of(found.engine, project)


def _next_of(engine: str, project: Path) -> str:
    if engine == "sqlite":
        return _command("backup", project, "backup.db")
    return shlex.join(["fixel", "list", *project_words(project)])


def _command(name: str, project: Path, *arguments: str) -> str:
    where = [] if project == Path() else [str(project)]
    return shlex.join(["fixel", "db", name, *arguments, *where])
