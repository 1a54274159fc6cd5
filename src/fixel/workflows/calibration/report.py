"""Report and charts of calibrations for `fixel calibrate`, its page and `Calibration.plot`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np

from fixel.calibration.result import FitKind
from fixel.calibration.search import NEARLY
from fixel.calibration.study import NOMINAL
from fixel.calibration.target import Target
from fixel.calibration.usual_parameters import known_parameters
from fixel.database.project import Project
from fixel.database.query import ALL_EXPERIMENTS
from fixel.drawing.calibration import (
    BEFORE,
    OffsetSeries,
    Quantity,
    errors_chart,
    offsets_chart,
    seconds_chart,
)
from fixel.drawing.chart import Chart
from fixel.drawing.overlay import OverlayMotions, Track, overlay_chart
from fixel.drawing.profiles import parameters_chart, profiles_chart
from fixel.drawing.searches import SearchPanel, search_chart, starts_chart
from fixel.errors import InvalidInput
from fixel.model import Parameters, placed
from fixel.simulation import Simulation, simulate
from fixel.simulation.result import finite_track
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.workflows.analysis import AnalysisReport, Picture, StoredAnswer, banner_of
from fixel.workflows.calibration.calibration import Calibration, Calibrations

JSON: Final = ("pictures",)  # what `--json` has besides numbers
SAMPLES: Final = 200  # minimum number of samples of a simulation
MAX_OTHERS: Final = 3
MAX_ROWS: Final = 20  # calibrations in a drawing of all

NamedCharts = Iterator[tuple[str, Chart]]
Picks = list[tuple[str, Calibration]]  # each with the word for it, such as "best"

# Axes of a sampling plan, with the units of their offsets among an experiment's conditions.
OFFSETS: Final = {"x": "m", "y": "m", "theta": "rad"}


def report_of(found: Calibrations) -> AnalysisReport:
    """Return the report of the calibrations of a run."""
    ids = f"{', '.join(map(str, found.ids[:3]))}{', ...' * (len(found.ids) > 3)}"
    stored = f"stored as calibration {ids}; job {found.folder}"
    notes, numbers = (*found.analysis.notes, stored), found.summary()
    analysis = found.analysis.model_copy(update={"notes": notes, "numbers": numbers})
    return AnalysisReport(analysis, pictures_of(found))


def about() -> tuple[Table, ...]:
    """Return the tables that a form shows: parameters that can be calibrated."""
    return (replace(known_parameters(), title="Parameters that can be calibrated"),)


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that compares the worst experiment with its simulation."""
    run = done.result
    fits = [run.joint] if run.joint else run.each or [*run]
    fit = max(fits, key=lambda one: float(one.found.errors.max()))
    worst = fit.keys_of_experiments[int(fit.found.errors.argmax())]
    table = ["--table", run.asked["table"]] if run.asked.get("table") else []
    return ["compare", worst, "--calibration", str(run.ids[fit.number]), *table]


# --- which pictures -----------------------------------------------------------------------------


class _ChartData:
    """Cached data of the calibrations of a run.

    Its experiments are in a project, by default that of the job's folder.
    """

    def __init__(self, run: Calibrations, project: Project | None = None) -> None:
        if project is None and run.folder is not None and run.ids:
            project = Project(run.folder.parents[1])
        self.run, self.keys, self._project = run, run.outcome.keys, project
        # Best calibration of each single experiment: its own, or a neighbour's.
        self.alone = sorted(run.each, key=lambda fit: fit.found.members)
        single = (fit for fit in run if fit.found.how.is_single)
        self.searched = [fit for fit in single if fit.found.trace is not None]
        errors = np.array([fit.found.errors[0] for fit in self.searched])
        self.picks: Picks = [(word, self.searched[k]) for word, k in _three(errors)]
        self.joint: Picks = [] if run.joint is None else [("", run.joint)]

    @cached_property
    def banners(self) -> list[str]:
        """Banner over charts of each experiment; empty for real ones."""
        if self._project is None:
            return [""] * len(self.keys)
        with self._project.store() as store:
            ids = [store.find(key) for key in self.keys]
            listed = store.experiments(ALL_EXPERIMENTS).rows
            real = {summary.id for summary in listed if summary.is_real}
            makers = {k: store.experiment(k).simulated_by for k in set(ids) - real}
        return [f"SIMULATED by {makers[k]}" if makers.get(k) else "" for k in ids]

    @cached_property
    def banner(self) -> str:
        """Banner over charts of all experiments."""
        return banner_of(self.banners)

    @cached_property
    def errors(self) -> dict[str, FloatArray]:
        """Errors of all experiments [mm] by the set used; the last is the requested result."""
        series = {BEFORE: self.run.outcome.nominal}
        if self.alone:
            name = "each alone" if self.joint else "after"
            series[name] = self.column([fit.found.errors[0] for fit in self.alone])
        for _, fit in self.joint:
            series["one set for all" if self.alone else "after"] = fit.found.errors
        return {name: self.run.request.lengths(errors) for name, errors in series.items()}

    def column(self, values: list[float]) -> FloatArray:
        """Arrange values of the single calibrations by experiment; nan where one has none."""
        column = np.full(len(self.keys), np.nan)
        for fit, value in zip(self.alone, values, strict=True):
            if math.isfinite(fit.found.errors[0]):
                column[fit.found.members[0]] = value
        return column

    @cached_property
    def offset_axes(self) -> list[OffsetSeries]:
        """Axes along which experiments were offset; each contains the nominal ones."""
        found = []
        conditions = [target.conditions for target in self.run.targets]
        for name, unit in OFFSETS.items():
            offset = f"offset_{name}_{unit}"
            members = [
                k for k, own in enumerate(conditions)
                if own.get("axis") in (name, NOMINAL) and offset in own
            ]  # fmt: skip
            values = np.array([float(conditions[k][offset]) for k in members])
            if len(np.unique(values)) > 1:
                found.append(OffsetSeries(name, unit, np.array(members), values))
        return found

    def name(self, stem: str, word: str) -> str:
        """Return a name with a word such as "best", unless there is only one experiment."""
        return f"{stem}_{word}" if word and len(self.keys) > 1 else stem


def _title_of(fit: Calibration, word: str = "") -> str:
    """Title of a calibration: its experiments, and why it was selected."""
    if len(fit.found.members) > 1:
        return f"{fit.subject}, {fit.found.how}"
    return f"{fit.subject} ({word})" if word else fit.subject


# Captions, by the beginning of the charts' names.
CAPTIONS: Final = {
    "search_alone": "Error against evaluation in three single calibrations: those of the "
    "experiments with the smallest, the median and the largest error.",
    "search": "Error against evaluation during the search; the line is the smallest error so far.",
    "starts": "Results of the searches from several starts: sorted errors, and parameter values.",
    "seconds": "Computing times of the single calibrations.",
    "parameters_by_offset": "Parameter values of the single calibrations against the start pose "
    "of the object.",
    "parameters": "Values before and after, with their intervals and verdicts, between the bounds"
    " of the search.",
    "profiles": "Profile likelihoods: increase of the deviance of least squares when one parameter "
    "is fixed at another value. A flat line means that the data do not determine the parameter. "
    "Where the model misfits, value and interval are of a second fit, and the profile shows what "
    "noise alone would allow.",
    "errors_by_offset": "Error against the start pose of the object.",
    "errors": "Errors of all experiments before and after calibration.",
    "overlay": "Measured and simulated motion, before and after calibration.",
}


def pictures_of(run: Calibrations, project: Project | None = None) -> Iterator[Picture]:
    """Yield the charts of a run, with captions.

    Its experiments are in a project, by default that of the job's folder.
    """
    data = _ChartData(run, project)
    for parts in (_of_searches, _of_parameters, _of_experiments):
        for name, chart in parts(data):
            yield Picture(name, chart, data.banner, _caption(name))
    for word, member in _three(list(data.errors.values())[-1]):
        name, chart = data.name("overlay", word), _overlay_chart(data, word, member)
        yield Picture(name, chart, data.banners[member], _caption(name))


def _caption(name: str) -> str:
    stem = max((stem for stem in CAPTIONS if name.startswith(stem)), key=len)
    which = name[len(stem) + 1 :]
    return CAPTIONS[stem] + (f" Here the {which}." if stem == "overlay" and which else "")


def _of_searches(data: _ChartData) -> NamedCharts:
    """Charts of the search for all experiments, of three single searches, and of all durations."""
    searched = data.searched
    for _, fit in data.joint:
        if fit.found.trace is not None:
            yield "search", fit_search_chart(fit)
    if data.picks:
        words = [f"{word} of {len(searched)}\n" if word else "" for word, _ in data.picks]
        single = fit_search_chart(*(fit for _, fit in data.picks), words=words)
        yield "search_alone" if data.joint else "search", single
    for word, fit in (*data.picks, *data.joint):
        if fit.found.ends:
            yield data.name("starts", word), fit_starts_chart(fit)
    if len(searched) > 1:
        seconds = np.array([fit.found.seconds for fit in searched])
        keys = [fit.keys_of_experiments[0] for fit in searched]
        yield "seconds", seconds_chart(keys, seconds, [fit.evaluations for fit in searched])


def _of_parameters(data: _ChartData) -> NamedCharts:
    """Charts of the set for all experiments, or of single ones if there is no such set."""
    for word, fit in data.joint or data.picks:
        yield data.name("parameters", word), fit_parameters_chart(fit, word)
        if fit.found.profiles:
            yield data.name("profiles", word), fit_profiles_chart(fit, word)
    if len(data.alone) > 1:
        quantities = [
            Quantity(
                unknown.label,
                unknown.unit,
                data.column([fit.found.point[k] for fit in data.alone]),
                bounds=(unknown.low, unknown.high),
            )
            for k, unknown in enumerate(data.run.request.space.free)
        ]
        title = "Parameters, each experiment by itself"
        yield "parameters_by_offset", _offsets_chart(data, title, quantities)


def _of_experiments(data: _ChartData) -> NamedCharts:
    """Charts of the errors of all experiments, before and after."""
    if len(data.keys) == 1:  # the overlay shows it
        return
    yield "errors", errors_chart(data.keys, data.errors)
    if data.offset_axes:
        name = "each alone" if "each alone" in data.errors else list(data.errors)[-1]
        error = Quantity("error", "mm", data.errors[name], log=True)
        yield "errors_by_offset", _offsets_chart(data, f"Error, {name}", [error])


def _three(errors: FloatArray) -> list[tuple[str, int]]:
    """Indices of the best, the median and the worst error; fewer if there are fewer."""
    order = np.argsort(errors, kind="stable").tolist()
    if len(order) < 2:
        return [("", k) for k in order]
    middle = [("median", order[(len(order) - 1) // 2])] if len(order) > 2 else []
    return [("best", order[0]), *middle, ("worst", order[-1])]


# --- charts -------------------------------------------------------------------------------------


def fit_search_chart(*fits: Calibration, words: Sequence[str] = ("",)) -> Chart:
    """Draw the error against the evaluation, with the best so far; each may have a word."""
    if any(fit.found.trace is None for fit in fits):
        raise InvalidInput("kind", found="a result without a search", expected="one with a search")
    panels = [
        SearchPanel(
            word + _title_of(fit),
            fit.request.lengths(fit.found.trace.errors, len(fit.found.members)),
            fit.found.trace.begins,
        )
        for word, fit in zip(words, fits, strict=True)
        if fit.found.trace is not None
    ]
    return search_chart(panels, what=_what(fits[0]))


def _what(fit: Calibration) -> str:
    """Name of the number that a search minimised."""
    largest = len(fit.found.members) > 1 and fit.request.combine == "largest"
    return "largest RMS error" if largest else "RMS error"


def fit_starts_chart(fit: Calibration) -> Chart:
    """Draw the results of the searches from several starts."""
    trace, ends = fit.found.trace, fit.found.ends
    if trace is None or not ends:
        raise InvalidInput(
            "kind", found="'starts' of a single search", expected="one with several starts"
        )
    errors = np.array([end.error for end in ends])
    return starts_chart(
        title=f"{len(ends)} starts: {_title_of(fit)}",
        errors=fit.request.lengths(errors, len(fit.found.members)),
        points=np.array([end.point for end in ends]),
        unknowns=fit.space.free,
        evaluations=np.bincount(trace.starts).tolist(),
        nearly=NEARLY if fit.request.made_error.unit == "mm" else 0.5 * NEARLY,
        what=_what(fit),
    )


def fit_parameters_chart(fit: Calibration, word: str = "") -> Chart:
    """Draw values and intervals, each between the bounds of its search."""
    rows = [estimate for estimate in fit.estimates.values() if estimate.bounds is not None]
    found = {
        str(other.how): other.point.tolist()
        for other in fit.run.outcome.found
        if fit.found.how == FitKind.DIRECT and other is not fit.found and not other.how.is_single
    }
    for k, point in enumerate(fit.found.solutions[1:].tolist(), 2):
        found[f"solution {k}, nearly as good"] = point
    others = dict(list(found.items())[:MAX_OTHERS])
    return parameters_chart(_title_of(fit, word), rows, others, fit.level)


def each_fit_chart(fits: Calibrations) -> Chart:
    """Draw values and intervals of all calibrations of a run, by parameter."""
    rows = [
        replace(fit.estimates[unknown.label], label=f"{unknown.label} {_title_of(fit)}")
        for unknown in fits.request.space.free
        for fit in fits[:MAX_ROWS]
    ]
    of = f"the first {MAX_ROWS} of {len(fits)}" if len(fits) > MAX_ROWS else f"{len(fits)}"
    return parameters_chart(f"Parameters of {of} calibrations", rows, None, fits.request.level)


def fit_profiles_chart(fit: Calibration, word: str = "") -> Chart:
    """Draw the profile likelihood of each parameter."""
    if not fit.found.profiles:
        found, expected = "'profiles' of a calibration without verdicts", "one with verdicts"
        hint = fit.found.note or "calibrate with verdicts=True"
        raise InvalidInput("kind", found=found, expected=expected, hint=hint)
    estimates = {estimate.label: estimate for estimate in fit.found.estimates}
    return profiles_chart(_title_of(fit, word), fit.found.profiles, estimates, fit.level)


def fit_errors_chart(fit: Calibration) -> Chart:
    """Draw the error of every experiment before and after the calibration."""
    errors = {BEFORE: fit.nominal_errors, "after": fit.found.errors}
    series = {name: fit.request.lengths(own) for name, own in errors.items()}
    return errors_chart(fit.keys_of_experiments, series)


def _offsets_chart(data: _ChartData, title: str, quantities: list[Quantity]) -> Chart:
    groups = [
        " ".join(str(own[name]) for name in ("shape", "layout") if name in own)
        for own in (target.conditions for target in data.run.targets)
    ]
    return offsets_chart(title, data.keys, groups, data.offset_axes, quantities)


# --- one experiment -----------------------------------------------------------------------------


def _overlay_chart(data: _ChartData, word: str, member: int) -> Chart:
    """Draw the measured motion of an experiment and those of the set used, before and after."""
    used = (*(fit for _, fit in data.joint), *data.alone)
    fit = next(fit for fit in used if member in fit.found.members)
    target = data.run.targets[member]
    points = (fit.space.nominal, fit.found.point)
    before, after = (_simulated(fit, target, point) for point in points)
    scene, body = target.case.scene, target.case.scene.bodies[0]
    errors = [float(own[member]) for own in data.errors.values()]
    start = np.concatenate(([0.0], target.case.times))
    title = target.key if not word else f"{target.key}: the {word} of {len(data.keys)}"
    own = OverlayMotions(
        outline=body.shape.outline,
        measured=Track(start, np.vstack((body.pose, target.pose))),
        before=_track(before, errors[0]),
        after=_track(after, errors[-1]),
        real=not data.banners[member],
        fixels=[placed(fixel.shape.outline, fixel.pose) for fixel in scene.fixels],
        pusher=_pusher(after),
        unit="mm",
    )
    return overlay_chart(title, own)


def _simulated(fit: Calibration, target: Target, point: FloatArray) -> Simulation:
    columns = fit.space.columns(point[None], target.conditions)
    duration = float(target.case.times[-1])
    return simulate(
        target.case.scene,
        Parameters({name: float(values[0]) for name, values in columns.items()}),
        motion=fit.motion,
        duration=duration,
        output_interval=duration / max(SAMPLES, len(target.pose)),
    )


def _track(simulation: Simulation, error: float) -> Track:
    """Simulated track until the simulation ended."""
    own = finite_track(simulation, simulation.scene.bodies[0].name)
    return Track(own.time, own.pose, error if math.isfinite(error) else None)


def _pusher(simulation: Simulation) -> list[FloatArray]:
    """Outlines of the pusher at the start and at the end."""
    outlines = []
    for pusher in simulation.scene.pushers[:1]:
        pose = finite_track(simulation, pusher.name).pose
        outlines += [placed(pusher.shape.outline, pose[k]) for k in (0, -1)]
    return outlines
