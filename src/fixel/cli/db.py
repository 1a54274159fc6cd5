"""`fixel db upgrade|backup|check [PROJECT]`: the database of a project."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.capability.options import Door
from fixel.cli.capability import subcommand
from fixel.cli.screen import CommandAnswer, ProjectPlace, command_of, paragraphs, project_at
from fixel.errors import counted
from fixel.table import Table, shortened

if TYPE_CHECKING:
    from fixel.workflows.project.maintenance import CheckResult

MAX_TROUBLES = 20

app = typer.Typer(help="Upgrade, back up or check the database of a project.", no_args_is_help=True)


@subcommand(app, "upgrade")
def upgrade(project: Path, place: ProjectPlace = None) -> CommandAnswer:
    """Upgrade the tables to the schema of this version.

    Nothing changes if they have it.
    """
    own = project_at(place, project)
    versions = own.upgrade()
    before, after = versions
    if before == after:
        done = f"The database already has schema {after}."
    elif before is None:
        done = f"Created the tables, with schema {after}."
    else:
        done = f"Upgraded the database from schema {before} to {after}."
    lines = [done, "", f"Next: {_command('check', own.folder)}"]
    return CommandAnswer(versions._asdict(), lines)


@subcommand(app, "backup")
def backup(
    project: Path,
    file: Annotated[Path, Door(meaning="Backup file to write.")],
    place: ProjectPlace = None,
) -> CommandAnswer:
    """Copy the database to a file, while other programs may use it."""
    verb = "replaced" if file.exists() else "wrote"
    done = project_at(place, project).backup(file)
    lines = [
        f"{verb} {done.file}: {done.size} bytes, sha256 {done.sha256}",
        "The media files are not in it. They never change, so copy only the new ones:",
        "",
        f"Next: {shlex.join(['cp', '-rn', str(done.media), f'{done.file}.media'])}",
    ]
    return CommandAnswer(done._asdict(), lines)


@subcommand(app, "check")
def check(project: Path, place: ProjectPlace = None) -> CommandAnswer:
    """Read everything that is stored and report errors.

    The exit code is 1 if there are any.
    """
    own = project_at(place, project)
    found = own.check()
    blocks = _contents(found), _troubles(found), [f"Next: {_next(found, own.folder)}"]
    return CommandAnswer(found.summary(), paragraphs(*blocks), code=1 if found.troubles else 0)


@subcommand(app, "diagram")
def diagram(
    file: Annotated[Path, Door(meaning="Chart to write: .png, .svg or .pdf.")],
) -> CommandAnswer:
    """Draw the tables as an entity relationship diagram."""
    from fixel.workflows.project import maintenance

    names = maintenance.diagram(file)
    lines = [f"wrote {file}: {len(names)} tables", "Next: fixel db --help"]
    return CommandAnswer({"file": str(file), "tables": names}, lines)


def _contents(found: "CheckResult") -> list[str]:
    version = "unknown" if found.version is None else found.version
    rows = [(name, n) for name, n in found.counts.items() if n]
    unused = (
        f", of which {found.unused_files} do not belong to this project"
        if found.unused_files
        else ""
    )
    return [
        f"{found.engine}, schema {version}",
        *(Table(("table", "rows"), rows).lines() if rows else []),
        f"media files: {found.media_files}{unused}",
    ]


def _troubles(found: "CheckResult") -> list[str]:
    n = len(found.troubles)
    if not n:
        return ["No errors: everything could be read."]
    shown = [f"  {t.where}: {t.sentence}" for t in found.troubles[:MAX_TROUBLES]]
    return [counted(n, "error"), *shortened(shown, n, "  ")]


def _next(found: "CheckResult", project: Path) -> str:
    """Return advice against the first fault, or else the command that most users need next."""
    if found.troubles:
        return found.troubles[0].hint.removeprefix("run: ")
    if found.engine == "sqlite":
        return _command("backup", project, "backup.db")
    return command_of("list", project=project)


def _command(name: str, project: Path, *arguments: str) -> str:
    return command_of("db", name, *arguments, *([] if project == Path() else [project]))
