"""`fixel jobs` and `fixel trust`: work that takes long, and programs that files may name."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import (
    AsJson,
    ProjectFolder,
    argument,
    option,
    project_at,
    required,
    with_options,
)
from fixel.cli.screen import command_of, job_bar, notify, print_answer
from fixel.errors import Interrupted, InvalidInput, plain
from fixel.progress import time_text
from fixel.table import Table

if TYPE_CHECKING:
    from fixel.workflows.jobs import JobStatus

app = typer.Typer(
    help="Run, stop and resume jobs on this machine or on a cluster.", no_args_is_help=True
)

JobFolder = Annotated[Path, typer.Argument(help="Folder of the job.", metavar="FOLDER")]


@dataclass(frozen=True, kw_only=True)
class PlaceOptions:
    """Options of `fixel jobs submit` and `resume`: where and how a job runs."""

    site: Path | None = option(
        None, "Site file of the cluster on which the workers run; see fixel jobs site."
    )
    workers: int | None = option(
        None,
        "Number of worker processes; 0 computes in this process.",
        min=0,
        metavar="N",
        show_default="0, or that of the last run",
    )
    detach: bool = option(False, "Run in the background and return at once.", "--detach")
    coordinator: str = option(
        "here", "Place where the coordinator of the job runs: here or slurm.", metavar="PLACE"
    )


@app.command("submit")
@with_options
def submit(*, folder: JobFolder, options: PlaceOptions, as_json: AsJson = False) -> None:
    """Run a prepared job; resume it if it was interrupted."""
    _run(folder, options, as_json)


@app.command("resume")
@with_options
def resume(
    *,
    folder: JobFolder,
    options: PlaceOptions,
    accept_version: bool = option(
        False,
        "Resume a job that another version of fixel began; the last digits may differ.",
        "--accept-version",
    ),
    as_json: AsJson = False,
) -> None:
    """Resume a job that was stopped, cancelled or lost.

    By default, the last settings are used.
    """
    _run(folder, options, as_json, accept_version)


@app.command("status")
@with_options
def status(
    *,
    folders: list[Path] | None = argument(
        None,
        "Folders of jobs or of projects.",
        metavar="[FOLDER]...",
        show_default="the current folder",
    ),
    project: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Show the progress of jobs, and which of them are running."""
    from fixel.workflows import jobs

    found = []
    if folders and project != Path():
        project_at(folders[0], project)
    for folder in folders or [project]:
        is_job = (folder / "job.json").exists() or not folder.is_dir()
        found += [jobs.status_of(folder)] if is_job else jobs.jobs_in(folder)
    print_answer(
        as_json, lambda: {"jobs": [job.summary() for job in found]}, lambda: _listed(found)
    )


@app.command("cancel")
def cancel(folder: JobFolder, as_json: AsJson = False) -> None:
    """Stop a job and its workers; finished chunks stay stored."""
    from fixel.workflows import jobs

    _print_status(jobs.cancel(folder), as_json)


@app.command("logs")
@with_options
def logs(
    *,
    folder: JobFolder,
    follow: bool = option(
        False, "Print new lines of the log until the job ends.", "--follow", "-f"
    ),
) -> None:
    """Print the log of a job."""
    from fixel.workflows import jobs

    for line in jobs.log_lines(folder, follow):
        typer.echo(plain(line))


@app.command("site")
def site() -> None:
    """Print a commented template of a cluster's site file."""
    from fixel.jobs.site import TEMPLATE

    typer.echo(TEMPLATE, nl=False)


@app.command("pack")
@with_options
def pack(
    *, folder: JobFolder, file: Path = required("Zip file to write."), as_json: AsJson = False
) -> None:
    """Pack a job with its results into one file, to copy it."""
    from fixel.workflows import jobs

    size = jobs.pack(folder, file)
    print_answer(
        as_json,
        lambda: {"file": str(file), "bytes": size},
        lambda: [
            f"wrote {file}: {size} bytes",
            f"Next: {command_of('jobs', 'unpack', file, f'{file.stem}-job')}",
        ],
    )


@app.command("unpack")
@with_options
def unpack(
    *,
    file: Path = required("Zip file of a packed job."),
    folder: Path = required("New folder for the job.", metavar="FOLDER"),
    as_json: AsJson = False,
) -> None:
    """Unpack a job into a new folder."""
    from fixel.workflows import jobs

    _print_status(jobs.unpack(file, folder), as_json)


def _run(folder: Path, options: PlaceOptions, as_json: bool, accept_version: bool = False) -> None:
    from fixel.jobs.coordinator import interrupt_on_termination
    from fixel.jobs.site import load_site
    from fixel.workflows import jobs

    place, site = options.coordinator, options.site
    if place not in ("here", "slurm"):
        raise InvalidInput("--coordinator", found=repr(place), expected="here or slurm")
    done = jobs.status_of(folder)
    if done.state != "done":
        jobs.arrange(
            folder,
            workers=options.workers,
            site=None if site is None else load_site(site),
            accept_version=accept_version,
        )
        if place == "slurm":
            jobs.run_on_slurm(folder)
            done = jobs.status_of(folder)
        elif options.detach:
            done = jobs.run_detached(folder)
        else:
            interrupt_on_termination()
            try:
                done = jobs.run_here(folder, job_bar(), None if as_json else notify)
            except KeyboardInterrupt:
                resume = command_of("jobs", "resume", folder)
                raise Interrupted(
                    hint=f"finished chunks are stored. Resume with: {resume}"
                ) from None
    _print_status(done, as_json)


def _listed(found: "list[JobStatus]") -> list[str]:
    if not found:
        return ["no jobs in this folder", "", "Next: fixel calibrate --help"]
    head = ("job", "state", "done", "of", "failed", "workers", "rate [1/s]", "left", "")
    return [*Table(head, map(_row, found), left=2).lines(), "", *_advice(found[0])]


def _row(job: "JobStatus") -> tuple[str, ...]:
    running = ("", "", "")
    if not job.ended:
        left = "" if job.left_s is None else time_text(job.left_s)
        running = (str(job.workers), f"{job.rate:.3g}", left)
    counts = (str(job.done), _total(job), str(job.failed))
    return (job.folder, job.state, *counts, *running, job.reason or job.words)


def _total(status: "JobStatus") -> str:
    """Number of chunks, where that is known."""
    return "?" if status.share is None else str(status.total)


def _advice(job: "JobStatus") -> list[str]:
    folder = Path(job.folder)
    if job.state == "unreadable":
        return []
    if job.state == "lost":
        return [
            f"The process that ran {folder} has died. {job.kept} chunks are stored; resume "
            "continues from them.",
            f"Next: {command_of('jobs', 'resume', folder)}",
        ]
    after = {
        "queued": ("submit", folder),
        "failed": ("logs", folder),
        "stopped": ("resume", folder),
        "cancelled": ("resume", folder),
        "done": ("pack", folder, "job.zip"),
    }
    return [f"Next: {command_of('jobs', *after.get(job.state, ('logs', '-f', folder)))}"]


def _print_status(job: "JobStatus", as_json: bool) -> None:
    reason = f": {job.reason}" if job.reason else ""
    failed = f", {job.failed} of them failed" if job.failed else ""
    done = f"{job.done} of {_total(job)} chunks{failed}" if job.total else job.text
    where = [f"the result is in {Path(job.folder) / 'result'}"]
    print_answer(
        as_json,
        job.summary,
        lambda: [
            f"{job.folder} is {job.state}{reason}" + (f"; {done}" if done else ""),
            *(where if job.state == "done" else _advice(job)),
        ],
    )


@with_options
def trust(
    *,
    program: str | None = argument(
        None,
        "Path of a program, with its arguments as after --engine, or folder of a project; the list "
        "is printed without it.",
        show_default=False,
    ),
    remove: bool = option(False, "Remove the program from the list.", "--remove"),
    as_json: AsJson = False,
) -> None:
    """Allow files to run a program, or a project to lead elsewhere.

    A calibration by a program of your own then works in later commands, until the program changes.
    Trust only what you have read or made: the program can do everything that you can. A project may
    name a server for its database, and have links to other folders.
    """
    from fixel.database.project import SETTINGS
    from fixel.database.stored_content import trust_place
    from fixel.simulation.trust import distrust, trust_program, trusted_entries

    if remove:
        removed = [] if program is None else distrust(program)
        if not removed:
            found, expected = repr(program), "an entry of the list of trusted programs"
            raise InvalidInput(
                "program", found=found, expected=expected, hint="print the list: fixel trust"
            )
        title, entries = "Removed:", removed
    elif program is None:
        entries = trusted_entries()
        title = "Trusted:" if entries else "No program is trusted. Add one: fixel trust PROGRAM"
    else:
        add = trust_place if Path(program, SETTINGS).is_file() else trust_program
        title, entries = "Added:", [add(program)]
    print_answer(
        as_json,
        lambda: {"entries": [entry.content for entry in entries]},
        lambda: [title, *(f"  {line}" for entry in entries for line in entry.lines)],
    )
