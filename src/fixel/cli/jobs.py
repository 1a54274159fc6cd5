"""`fixel jobs` and `fixel trust`: work that takes long, and programs that files may name."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fixel.capability.options import MAX_WORKERS, Door
from fixel.cli.capability import command, subcommand
from fixel.cli.screen import CommandAnswer, command_of, job_bar, notify, one_place
from fixel.errors import Interrupted, InvalidInput, plain
from fixel.progress import time_text
from fixel.table import Table

if TYPE_CHECKING:
    from fixel.workflows.jobs import JobStatus

app = typer.Typer(
    help="Run, stop and resume jobs on this machine or on a cluster.", no_args_is_help=True
)

JobFolder = Annotated[Path, Door(metavar="FOLDER", meaning="Folder of the job.")]


@command
def submit(
    folder: JobFolder,
    *,
    site: Path | None = None,
    workers: Annotated[
        int | None, Door(least=0, most=MAX_WORKERS, metavar="N", usual="0, or that of the last run")
    ] = None,
    detach: Annotated[bool, Door(flag="--detach")] = False,
    coordinator: Annotated[Literal["here", "slurm"], Door(metavar="PLACE")] = "here",
    accept_version: Annotated[bool, Door(flag="--accept-version")] = False,
) -> CommandAnswer:
    """Run a prepared job; resume it if it was interrupted.

    Parameters
    ----------
    site : Path, optional
        Site file of the cluster on which the workers run; see fixel jobs site.
    workers : int, optional
        Number of worker processes; 0 computes in this process.
    detach : bool
        Run in the background and return at once.
    coordinator : str
        Place where the coordinator of the job runs: here or slurm.
    accept_version : bool
        Resume a job that another version of fixel began; the last digits may differ.
    """
    from fixel.jobs.coordinator import interrupt_on_termination
    from fixel.jobs.site import load_site
    from fixel.workflows import jobs

    done = jobs.status_of(folder)
    if done.state == "done":
        return _status(done)
    own = None if site is None else load_site(site)
    jobs.arrange(folder, workers=workers, site=own, accept_version=accept_version)
    if coordinator == "slurm":
        jobs.run_on_slurm(folder)
        return _status(jobs.status_of(folder))
    if detach:
        return _status(jobs.run_detached(folder))
    interrupt_on_termination()
    try:
        return _status(jobs.run_here(folder, job_bar(), notify))
    except KeyboardInterrupt:
        resume = command_of("jobs", "resume", folder)
        raise Interrupted(hint=f"finished chunks are stored. Resume with: {resume}") from None


RESUME = """Resume a job that was stopped, cancelled or lost.

By default, the last settings are used."""
app.command("submit")(submit)
app.command("resume", help=RESUME)(submit)


@subcommand(app, "status")
def status(
    project: Path,
    folders: Annotated[tuple[Path, ...], Door(metavar="FOLDER", usual="the current folder")] = (),
) -> CommandAnswer:
    """Show the progress of jobs, and which of them are running.

    Parameters
    ----------
    folders : tuple of Path
        Folders of jobs or of projects.
    """
    from fixel.workflows import jobs

    found = []
    if folders:
        one_place(folders[0], project)
    for folder in folders or [project]:
        is_job = (folder / "job.json").exists() or not folder.is_dir()
        found += [jobs.status_of(folder)] if is_job else jobs.jobs_in(folder)
    return CommandAnswer({"jobs": [job.summary() for job in found]}, _listed(found))


@subcommand(app, "cancel")
def cancel(folder: JobFolder) -> CommandAnswer:
    """Stop a job and its workers; finished chunks stay stored."""
    from fixel.workflows import jobs

    return _status(jobs.cancel(folder))


@app.command("logs")
def logs(
    folder: Annotated[Path, typer.Argument(help="Folder of the job.", metavar="FOLDER")],
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Print new lines of the log until the job ends.")
    ] = False,
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


@subcommand(app, "pack")
def pack(
    folder: JobFolder, file: Annotated[Path, Door(meaning="Zip file to write.")]
) -> CommandAnswer:
    """Pack a job with its results into one file, to copy it."""
    from fixel.workflows import jobs

    size = jobs.pack(folder, file)
    unpacking = command_of("jobs", "unpack", file, f"{file.stem}-job")
    lines = [f"wrote {file}: {size} bytes", f"Next: {unpacking}"]
    return CommandAnswer({"file": str(file), "bytes": size}, lines)


@subcommand(app, "unpack")
def unpack(
    file: Annotated[Path, Door(meaning="Zip file of a packed job.")],
    folder: Annotated[Path, Door(metavar="FOLDER", meaning="New folder for the job.")],
) -> CommandAnswer:
    """Unpack a job into a new folder."""
    from fixel.workflows import jobs

    return _status(jobs.unpack(file, folder))


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


def _status(job: "JobStatus") -> CommandAnswer:
    reason = f": {job.reason}" if job.reason else ""
    failed = f", {job.failed} of them failed" if job.failed else ""
    done = f"{job.done} of {_total(job)} chunks{failed}" if job.total else job.text
    lines = [
        f"{job.folder} is {job.state}{reason}" + (f"; {done}" if done else ""),
        *(
            [f"the result is in {Path(job.folder) / 'result'}"]
            if job.state == "done"
            else _advice(job)
        ),
    ]
    return CommandAnswer(job.summary(), lines)


@command
def trust(
    program: Annotated[str | None, Door(metavar="PROGRAM")] = None,
    *,
    remove: Annotated[bool, Door(flag="--remove")] = False,
) -> CommandAnswer:
    """Allow files to run a program, or a project to lead elsewhere.

    A calibration by a program of your own then works in later commands, until the program changes.
    Trust only what you have read or made: the program can do everything that you can. A project may
    name a server for its database, and have links to other folders.

    Parameters
    ----------
    program : str, optional
        Path of a program, with its arguments as after --engine, or folder of a project; the list is
        printed without it.
    remove : bool
        Remove the program from the list.
    """
    from fixel.database.project import SETTINGS
    from fixel.database.stored_content import trust_place
    from fixel.trust import distrust, trust_program, trusted_entries

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
    lines = [title, *(f"  {line}" for entry in entries for line in entry.lines)]
    return CommandAnswer({"entries": [entry.content for entry in entries]}, lines)
