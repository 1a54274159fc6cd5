"""`fixel domain` and `fixel domain growth`: where one parameter set can be trusted."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from fixel.cli.options import (
    AsJson,
    CalibrationEngine,
    DatasetName,
    PictureFolder,
    ProjectFolder,
    Seed,
    Selection,
    option,
    require_folder,
    with_options,
)
from fixel.cli.screen import (
    command_line,
    command_of,
    notify,
    print_answer,
    seconds,
    shortened,
    wrote,
)
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.analysis import StoredAnalysis
    from fixel.workflows.domain.request import DomainRequest
    from fixel.workflows.domain.run import DomainResult
    from fixel.workflows.growth.explore import Exploration

MAX_ROWS = 30

app = typer.Typer(invoke_without_command=True, rich_markup_mode=None)


@dataclass(frozen=True, kw_only=True)
class DomainOptions:
    """Options of `fixel domain` for the map."""

    calibration: int | None = option(
        None,
        "Stored calibration to start from.",
        metavar="ID",
        show_default="the newest for several",
    )
    engine: CalibrationEngine = None
    fit: list[str] | None = option(
        None,
        "Parameter to calibrate, instead of those of the calibration; may be repeated.",
        metavar="NAME[=LOW:HIGH[:START]]",
    )
    selection: Selection
    axes: str | None = option(
        None,
        "Conditions that are the axes of the map, such as offset_y_m,offset_theta_rad.",
        metavar="NAME[,NAME]",
        show_default="the offsets that vary",
    )
    by: str | None = option(
        None,
        "Conditions with a map for each of their values, such as shape,layout.",
        metavar="NAME[,NAME]",
    )
    apart: str | None = option(
        None,
        "Conditions with a parameter set for each of their values, such as surface,shape.",
        metavar="NAME[,NAME]",
    )
    leave_out: str | None = option(
        None, "Condition whose values are held out as a whole, such as layout.", metavar="CONDITION"
    )
    nominal: str | None = option(
        None,
        "Nominal conditions from which the domain grows, in SI units.",
        metavar="AXIS=VALUE[,AXIS=VALUE]",
    )
    step: list[str] | None = option(
        None,
        "Width of the cells along an axis, in SI units; may be repeated.",
        metavar="AXIS=WIDTH",
    )
    threshold_mm: float | None = option(
        None,
        "Threshold of the root mean square error [mm].",
        show_default="twice the median",
    )
    relative: float | None = option(
        None,
        "Threshold relative to the smallest E of each experiment, as a share above it; instead "
        "of --threshold-mm.",
        metavar="SHARE",
    )
    level: float = option(0.9, "Share of new experiments that must stay below the threshold.")
    confidence: float = option(0.95, "Confidence required for a trusted cell.")
    folds: int | None = option(
        None,
        "Number of folds of the cross-validation.",
        min=2,
        show_default="5; 2 for more than 2000",
    )
    seed: Seed = 0

    @property
    def request(self) -> "DomainRequest":
        """Request of the map."""
        from fixel.workflows.domain.request import DomainRequest

        if self.threshold_mm is not None and self.relative is not None:
            raise InvalidInput(
                "--relative", found="--relative and --threshold-mm", expected="one of them"
            )
        return DomainRequest(
            query=self.selection.query,
            calibration=self.calibration,
            engine=self.engine or "",
            fit=tuple(self.fit or ()),
            axes=_names(self.axes),
            by=_names(self.by),
            apart=_names(self.apart),
            leave_out=self.leave_out or "",
            nominal=_values("--nominal", self.nominal.split(",") if self.nominal else []),
            steps=_widths(self.step or []),
            threshold=self.threshold_mm if self.relative is None else self.relative,
            measure="absolute" if self.relative is None else "relative",
            level=self.level,
            confidence=self.confidence,
            folds=self.folds,
            seed=self.seed,
        )


@app.callback()
@with_options
def domain(
    *,
    context: typer.Context,
    folder: ProjectFolder = Path(),
    options: DomainOptions,
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Map where one parameter set predicts held-out experiments.

    Fits are stored, so other axes, thresholds and nominals need no new fits.
    """
    if context.invoked_subcommand is not None:
        return
    from fixel.database.project import Project
    from fixel.workflows.domain.run import map_stored

    request = options.request
    done = map_stored(
        Project(folder),
        request,
        plot=plot,
        command=command_line(),
    )
    print_answer(as_json, lambda: _content(done), lambda: _lines(done, folder, request))


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def _values(where: str, settings: list[str]) -> dict[str, str | float]:
    found: dict[str, str | float] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise InvalidInput(where, found=repr(setting), expected="AXIS=VALUE")
        try:
            found[name.strip()] = float(text)
        except ValueError:
            found[name.strip()] = text.strip()
    return found


def _widths(settings: list[str]) -> dict[str, float]:
    found = {}
    for name, value in _values("--step", settings).items():
        if isinstance(value, str):
            raise InvalidInput(f"--step {name}", found=repr(value), expected="a number, SI units")
        found[name] = value
    return found


def _content(done: "DomainResult") -> dict[str, Any]:
    analysis = done.kept.analysis
    return {
        "unseen": list(done.gathered.unseen),
        "title": analysis.title,
        "headline": list(analysis.headline),
        "warnings": list(analysis.warnings),
        "numbers": analysis.numbers,
        "calibration": done.gathered.calibration,
        "folder": str(done.kept.folder),
        "pictures": [str(path) for path in done.files],
    }


def _lines(done: "DomainResult", folder: Path, request: "DomainRequest") -> list[str]:
    analysis = done.kept.analysis
    lines = [f"Unseen by {text}" for text in done.gathered.unseen]
    lines += [*analysis.headline, ""]
    for one in analysis.tables:
        shown = shortened(one.lines(MAX_ROWS), len(one.rows) + 1)
        lines += [f"{one.title}:", *shown, ""]
    others = analysis.warnings[len(done.gathered.unseen) :]
    lines += [f"Warning: {sentence}." for sentence in others]
    return [
        *lines,
        *wrote(done.files),
        f"stored in {done.kept.folder}",
        f"Next: {_next(done, folder, request)}",
    ]


def _next(done: "DomainResult", folder: Path, request: "DomainRequest") -> str:
    """Return the next command: charts, then a tighter threshold or, below the noise, a report."""
    from fixel.workflows.domain.request import command_of as domain_command

    if not done.files:
        return f"{domain_command(folder, request, done.claim)} --plot domain"
    tighter = replace(done.claim, threshold=0.5 * done.claim.threshold)
    floor = done.gathered.floor_mm
    if floor is not None and tighter.measure == "absolute" and tighter.threshold < floor:
        return command_of("report", project=folder)
    return domain_command(folder, request, tighter)


@app.command("growth")
@with_options
def growth(
    *,
    folder: ProjectFolder = Path(),
    shape: str | None = option(None, "Select experiments with this shape only.", metavar="NAME"),
    dataset: DatasetName = None,
    index: str = option(
        "corrected",
        "Order of the rows: corrected, or printed as in the code of the thesis, with theta one "
        "row too early.",
        metavar="WHICH",
    ),
    threshold: str | None = option(
        None,
        "Threshold of the error, as a number in its unit or as a distance: 5 or 2.2mm.",
        metavar="E",
        show_default="5 mm² as in the thesis",
    ),
    sizes: list[str] | None = option(
        None,
        "Numbers of samples of the intervals, 2 to 5, for one axis or for all; may be repeated.",
        metavar="[AXIS=]N[,N]",
        show_default="x=2,4 y=3,5 theta=2,4",
    ),
    motion: str | None = option(
        None, "Use only calibrations with this motion model.", metavar="MODEL"
    ),
    error: str | None = option(None, "Use only calibrations with this error.", metavar="NAME"),
    plot: Path | None = option(None, "Folder for copies of the charts.", metavar="FOLDER"),
    as_json: AsJson = False,
) -> None:
    """Grow the domain from stored calibrations, as the thesis did.

    Step i adds the experiments x+i, y+i, y-i and theta+i to the nominal one; one set of parameters
    simulates them all, and the largest error counts.
    """
    from fixel.database.project import Project
    from fixel.domain.growth import INDEXES
    from fixel.workflows.growth.run import GrowthRequest, run_growth

    if index not in INDEXES:
        raise InvalidInput("--index", found=repr(index), expected="corrected or printed")
    request = GrowthRequest(
        shape=shape,
        dataset=dataset,
        index="printed" if index == "printed" else "corrected",
        sizes=_sizes(sizes or []),
        threshold=threshold,
        motion=motion,
        error=error,
    )
    require_folder(plot)
    report = command_of("report", project=folder)
    found, kept = run_growth(
        Project(folder),
        request,
        command=command_line(),
        where=report.removeprefix("fixel report"),
        notify=notify if sys.stderr.isatty() else None,
    )
    copied = [] if plot is None else kept.copy_pictures(plot)
    print_answer(
        as_json,
        lambda: _growth_content(kept, copied),
        lambda: _growth_lines(found, kept, copied, report),
    )


def _sizes(texts: list[str]) -> dict[str, tuple[int, ...]] | None:
    from fixel.domain.growth import AXES

    found: dict[str, tuple[int, ...]] = {}
    for text in texts:
        axis, equals, numbers = text.rpartition("=")
        try:
            own = tuple(int(number) for number in numbers.split(","))
        except ValueError:
            own = ()
        if not own or (equals and axis not in AXES):
            raise InvalidInput(
                "--sizes", found=repr(text), expected="numbers of samples, such as y=3,5 or 2,4"
            )
        found |= dict.fromkeys((axis,) if equals else AXES, own)
    return found or None


def _growth_content(kept: "StoredAnalysis", copied: list[Path]) -> dict[str, Any]:
    analysis = kept.analysis
    return {
        "headline": list(analysis.headline),
        "warnings": list(analysis.warnings),
        "folder": str(kept.folder),
        "pictures": [str(kept.picture(shown.name)) for shown in analysis.pictures],
        "copied": [str(path) for path in copied],
        "seconds": analysis.seconds,
        **analysis.numbers,
    }


def _growth_lines(
    found: "Exploration", kept: "StoredAnalysis", copied: list[Path], report: str
) -> list[str]:
    analysis, n = kept.analysis, len(found.added)
    lines = []
    for one in analysis.tables:
        lines += [one.title, *one.lines(), ""]
    new = f", {n} parameter sets stored as calibrations" if n else ""
    return [
        *lines,
        *analysis.headline,
        "",
        *(f"Warning: {sentence}" for sentence in analysis.warnings),
        *wrote(path for path in copied if path.suffix == ".png"),
        f"{found.rollouts} simulations, {seconds(analysis.seconds)}{new}; stored with its charts "
        f"in {kept.folder}",
        f"Next: {report}",
    ]
