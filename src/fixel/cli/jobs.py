"""`fixel jobs submit|status|resume|cancel|logs|site|pack|unpack`: work that takes long."""

import json
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder, project_at

if TYPE_CHECKING:
    from fixel.jobs.work import JobProgress
    from fixel.workflows.jobs import JobStatus

BAR = 24  # [characters]
BETWEEN_LINES_S = 30.0  # [s] where progress goes into a file

app = typer.Typer(
    help="Run a job here or on a cluster; stop and continue it at any time.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

JobFolder = Annotated[Path, typer.Argument(help="Folder of the job.", metavar="FOLDER")]
Workers = Annotated[
    int | None,
    typer.Option(help="Processes; 0 for this one alone.", min=0, metavar="N", show_default="0"),
]
SiteFile = Annotated[
    Path | None,
    typer.Option(help="Cluster the workers run on: see fixel jobs site.", metavar="FILE"),
]
Detach = Annotated[bool, typer.Option("--detach", help="Leave it running, and return at once.")]
Coordinator = Annotated[
    str, typer.Option(help="Where the job is run from: here, or slurm.", metavar="PLACE")
]


@app.command("submit")
def submit(
    folder: JobFolder,
    site: SiteFile = None,
    workers: Workers = None,
    detach: Detach = False,
    coordinator: Coordinator = "here",
    as_json: AsJson = False,
) -> None:
    """Run a prepared job; an interrupted one goes on."""
    _run(folder, site, workers, detach, coordinator, as_json)


@app.command("resume")
def resume(
    folder: JobFolder,
    site: SiteFile = None,
    workers: Workers = None,
    detach: Detach = False,
    coordinator: Coordinator = "here",
    accept_version: Annotated[
        bool,
        typer.Option("--accept-version", help="Go on with another fixel; last digits may differ."),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Resume a job that was stopped, cancelled or lost, with its last settings by default."""
    _run(folder, site, workers, detach, coordinator, as_json, accept_version)


@app.command("status")
def status(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Folders of jobs, or of projects.",
            metavar="[FOLDER]...",
            show_default="the current folder",
        ),
    ] = None,
    project: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Show how far jobs are, and which are running."""
    from fixel.workflows import jobs

    found = []
    if folders and project != Path():
        project_at(folders[0], project)
    for folder in folders or [project]:
        is_job = (folder / "job.json").exists()
        found += [jobs.status_of(folder)] if is_job else jobs.jobs_in(folder)
    if as_json:
        typer.echo(json.dumps({"jobs": [job.summary() for job in found]}))
    else:
        typer.echo("\n".join(_listed(found)))


@app.command("cancel")
def cancel(folder: JobFolder, as_json: AsJson = False) -> None:
    """End a job and its workers; what was finished stays."""
    from fixel.workflows import jobs

    _say_status(jobs.cancel(folder), as_json)


@app.command("logs")
def logs(
    folder: JobFolder,
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Go on until the job ends.")
    ] = False,
) -> None:
    """Print what happened."""
    from fixel.workflows import jobs

    for line in jobs.log_lines(folder, follow):
        typer.echo(line)


@app.command("site")
def site() -> None:
    """Print a template for a cluster, with comments."""
    from fixel.jobs.site import TEMPLATE

    typer.echo(TEMPLATE, nl=False)


@app.command("pack")
def pack(
    folder: JobFolder,
    file: Annotated[Path, typer.Argument(help="A zip to write.", metavar="FILE")],
    as_json: AsJson = False,
) -> None:
    """Write a job with all its answers into one file, to be copied by hand."""
    from fixel.workflows import jobs

    size = jobs.pack(folder, file)
    if as_json:
        typer.echo(json.dumps({"file": str(file), "bytes": size}))
        return
    typer.echo(f"wrote {file}: {size} bytes")
    typer.echo(f"Next: {shlex.join(['fixel', 'jobs', 'unpack', str(file), f'{file.stem}-job'])}")


@app.command("unpack")
def unpack(
    file: Annotated[Path, typer.Argument(help="A packed job.", metavar="FILE")],
    folder: Annotated[Path, typer.Argument(help="A new folder.", metavar="FOLDER")],
    as_json: AsJson = False,
) -> None:
    """Make a folder of a packed job."""
    from fixel.workflows import jobs

    _say_status(jobs.unpack(file, folder), as_json)


def _run(
    folder: Path,
    site: Path | None,
    workers: int | None,
    detach: bool,
    coordinator: str,
    as_json: bool,
    accept_version: bool = False,
) -> None:
    from fixel.errors import InvalidInput
    from fixel.jobs.coordinator import interrupt_on_termination
    from fixel.jobs.site import load_site
    from fixel.workflows import jobs

    if coordinator not in ("here", "slurm"):
        raise InvalidInput("--coordinator", found=coordinator, expected="here or slurm")
    before = jobs.status_of(folder)
    if before.state == "done":
        _say_status(before, as_json)
        return
    jobs.arrange(
        folder,
        workers=workers,
        site=None if site is None else load_site(site),
        accept_version=accept_version,
    )
    if coordinator == "slurm":
        jobs.run_on_slurm(folder)
        _say_status(jobs.status_of(folder), as_json)
        return
    if detach:
        _say_status(jobs.run_detached(folder), as_json)
        return
    interrupt_on_termination()
    try:
        done = jobs.run_here(folder, job_bar(), None if as_json else _say)
    except KeyboardInterrupt:
        _say(f"stopped; what was finished is kept. Go on with: {_command('resume', folder)}")
        raise
    _say_status(done, as_json)


def _say(sentence: str) -> None:
    from fixel.cli.screen import notify

    notify(sentence)


def job_bar() -> "Callable[[JobProgress], None]":
    """Show progress on standard error: a bar on a terminal, else a line every 30 s."""
    terminal = sys.stderr.isatty()
    last = time.monotonic()

    def show(progress: "JobProgress") -> None:
        nonlocal last
        if terminal:
            end = "\n" if progress.share == 1.0 else ""
            print(f"\r\033[K{_bar(progress)}", end=end, file=sys.stderr, flush=True)
        elif time.monotonic() - last >= BETWEEN_LINES_S:
            last = time.monotonic()
            print(", ".join([_share(progress), *_details(progress)]), file=sys.stderr, flush=True)

    return show


def _bar(progress: "JobProgress") -> str:
    """One line: the bar stays empty while the amount of work is unknown."""
    full = int(BAR * (progress.share or 0.0))
    bar = f"[{'#' * full}{'.' * (BAR - full)}]"
    return "  ".join([bar, _share(progress), *_details(progress)])


def _share(progress: "JobProgress") -> str:
    if progress.share is None:
        return f"{progress.done} chunks done"
    return f"{int(100 * progress.share)} %"


def _details(progress: "JobProgress") -> list[str]:
    from fixel.cli.screen import seconds

    rate = f"{progress.rate:.3g}/s" if progress.rate else ""
    left = f"about {seconds(progress.left_s)} left" if progress.left_s else ""
    failed = f"{progress.failed} failed" if progress.failed else ""
    return [part for part in (progress.note, rate, left, failed) if part]


def _listed(found: "list[JobStatus]") -> list[str]:
    from fixel.cli.screen import seconds, table

    if not found:
        return ["no jobs here", "", "Next: fixel calibrate --help"]
    head = ("job", "state", "done", "of", "failed", "workers", "rate [1/s]", "left", "")
    rows = [
        (
            job.folder,
            job.state,
            str(job.done),
            _total(job),
            str(job.failed),
            "" if job.ended else str(job.workers),
            "" if job.ended else f"{job.rate:.3g}",
            "" if job.ended or job.left_s is None else seconds(job.left_s),
            job.reason or job.note,
        )
        for job in found
    ]
    return [*table(head, rows, left=2), "", *_advice(found[0])]


def _total(status: "JobStatus") -> str:
    """Number of chunks, where that is known."""
    return "?" if status.share is None else str(status.total)


def _advice(job: "JobStatus") -> list[str]:
    folder = Path(job.folder)
    if job.state == "lost":
        answers = f"{job.kept} answers are kept"
        return [
            f"The process that ran {folder} has died; {answers}, and resume goes on from them.",
            f"Next: {_command('resume', folder)}",
        ]
    after = {
        "queued": "submit",
        "failed": "logs",
        "stopped": "resume",
        "cancelled": "resume",
        "done": "pack",
    }
    command = _command(after.get(job.state, "logs -f"), folder)
    return [f"Next: {command}{' job.zip' if job.state == 'done' else ''}"]


def _say_status(job: "JobStatus", as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(job.summary()))
        return
    reason = f": {job.reason}" if job.reason else ""
    failed = f", {job.failed} of them failed" if job.failed else ""
    typer.echo(f"{job.folder} is {job.state}{reason}; {job.done} of {_total(job)} chunks{failed}")
    if job.state == "done":
        typer.echo(f"the result is in {Path(job.folder) / 'result'}")
    else:
        typer.echo("\n".join(_advice(job)))


def _command(name: str, folder: Path) -> str:
    return f"fixel jobs {name} {shlex.quote(str(folder))}"
