"""Draw the charts of a calibration, each as PNG, PDF, and CSV with its numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.calibration.objective import lengths_of
from fixel.calibration.study import NOMINAL
from fixel.calibration.target import Target
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
from fixel.drawing.chart import Chart, plot_axes
from fixel.drawing.overlay import OverlayMotions, Track, overlay_chart
from fixel.drawing.profiles import parameters_chart, profiles_chart
from fixel.drawing.searches import SearchPanel, search_chart, starts_chart
from fixel.errors import InvalidInput
from fixel.model import Parameters, placed
from fixel.model.records import Estimate
from fixel.simulation import Simulation, simulate
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration, Calibrations
from fixel.workflows.calibration.job import NEARLY
from fixel.workflows.calibration.result import FitKind, ParameterSet
from fixel.workflows.figures import Picture, banner_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SAMPLES: Final = 200  # minimum number of samples of a simulation
MAX_OTHERS: Final = 3
MAX_ROWS: Final = 20  # calibrations in a drawing of all


Pictures = Iterator[Picture]

# Axes of a sampling plan, with the units of their offsets among an experiment's conditions.
OFFSETS: Final = {"x": "m", "y": "m", "theta": "rad"}


class _ChartData:
    """Cached data of a calibration.

    Parameters
    ----------
    calibration : Calibrations
    project : Project, optional
        Project that contains the experiments; by default that of the job's folder.
    """

    def __init__(self, calibration: Calibrations, project: Project | None = None) -> None:
        self.calibration = calibration
        self._project = project
        self.request, self.outcome = calibration.request, calibration.outcome
        self.space, self.unit = self.request.space, self.request.made_error.unit
        self.keys, self.targets = self.outcome.keys, calibration.targets

    def lengths(self, errors: FloatArray, members: int = 1) -> FloatArray:
        """Convert errors to lengths [mm], the unit of all charts and tables.

        Parameters
        ----------
        errors : array
            Errors in the unit of the calibration.
        members : int
            Number of experiments in each error; a sum is divided by it.
        """
        shared = self.request.error_of_one(errors, members)
        return lengths_of(shared, self.unit)

    @cached_property
    def alone(self) -> list[ParameterSet]:
        """Best set of each single experiment: its own, or a neighbour's."""
        return sorted((one.found for one in self.calibration.each), key=lambda one: one.members)

    @cached_property
    def searched(self) -> list[ParameterSet]:
        """Sets for single experiments that were searched for."""
        return [one for one in self.outcome.alone if one.trace is not None]

    @cached_property
    def together(self) -> ParameterSet | None:
        """Best set for all experiments."""
        joint = self.calibration.joint
        return None if joint is None else joint.found

    @cached_property
    def banners(self) -> list[str]:
        """Banner over charts of each experiment; empty for real ones."""
        folder, project = self.calibration.folder, self._project
        if project is None and folder is not None and self.calibration.ids:
            project = Project(folder.parents[1])
        if project is None:
            return [""] * len(self.keys)
        with project.store() as store:
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
    def groups(self) -> list[str]:
        """Shape and layout of each experiment."""
        return [
            " ".join(str(own[name]) for name in ("shape", "layout") if name in own)
            for own in (target.conditions for target in self.targets)
        ]

    @cached_property
    def offset_axes(self) -> list[OffsetSeries]:
        """Axes along which experiments were offset; each contains the nominal ones."""
        found = []
        conditions = [target.conditions for target in self.targets]
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

    def estimates(self, one: ParameterSet) -> list[Estimate]:
        """Return the estimates of the free parameters of a set, with the bounds of the search."""
        number = next(k for k, own in enumerate(self.outcome.found) if own is one)
        known = self.calibration[number].estimates.values()
        return [estimate for estimate in known if estimate.bounds is not None]


def _title_of(data: _ChartData, one: ParameterSet, word: str = "") -> str:
    """Title of a set: its experiments, and why it was selected."""
    if len(one.members) > 1:
        return f"{len(one.members)} experiments, {one.how}"
    name = data.keys[one.members[0]]
    return f"{name} ({word})" if word else name


# --- plots of a single result -------------------------------------------------------------------


def plot_parameters(fit: Calibration, ax: Axes | None = None) -> Any:
    """Draw values and intervals, each between the bounds of its search; return the axes."""
    return plot_axes(_parameters_chart(_data(fit), "", fit.found).figure, ax)


def plot_each(fits: Calibrations, ax: Axes | None = None) -> Any:
    """Draw values and intervals of all calibrations of a run, by parameter; return the axes."""
    many = fits[:MAX_ROWS]
    named = [_title_of(_data(fit), fit.found, "") if len(fit.found.members) > 1
             else fit.keys_of_experiments[0] for fit in many]  # fmt: skip
    rows = [
        replace(fit.estimates[unknown.label], label=f"{unknown.label} {name}")
        for unknown in fits.request.space.free
        for fit, name in zip(many, named, strict=True)
    ]
    of = f"the first {MAX_ROWS} of {len(fits)}" if len(fits) > MAX_ROWS else f"{len(fits)}"
    chart = parameters_chart(
        title=f"Parameters of {of} calibrations", rows=rows, level=fits.request.level
    )
    return plot_axes(chart.figure, ax)


def plot_profiles(fit: Calibration, ax: Axes | None = None) -> Any:
    """Draw the profile likelihood of each parameter; return the axes."""
    if not fit.found.profiles:
        raise InvalidInput(
            "kind",
            found="'profiles' of a calibration without verdicts",
            expected="one with verdicts",
            hint=fit.found.note or "calibrate with verdicts=True",
        )
    return plot_axes(_profiles_chart(_data(fit), "", fit.found).figure, ax)


def plot_search(fit: Calibration, ax: Axes | None = None) -> Any:
    """Draw the error against the evaluation, with the best so far; return the axes."""
    if fit.found.trace is None:
        raise InvalidInput("kind", found="a result without a search", expected="one with a search")
    return plot_axes(_search_chart(_data(fit), [("", fit.found)]).figure, ax)


def plot_starts(fit: Calibration, ax: Axes | None = None) -> Any:
    """Draw the results of the searches from several starts; return the axes."""
    found = next(_starts(_data(fit), "", fit.found), None)
    if found is None:
        raise InvalidInput(
            "kind", found="'starts' of a single search", expected="one with several starts"
        )
    return plot_axes(found.chart.figure, ax)


def plot_errors(fit: Calibration, ax: Axes | None = None) -> Any:
    """Draw the error of every experiment before and after the calibration; return the axes."""
    lengths = _data(fit).lengths
    before = fit.run.outcome.nominal[list(fit.found.members)]
    series = {BEFORE: lengths(before), "after": lengths(fit.found.errors)}
    chart = errors_chart(fit.keys_of_experiments, series, "mm")
    return plot_axes(chart.figure, ax)


def _data(fit: Calibration) -> _ChartData:
    return _ChartData(fit.run)


# --- which pictures -----------------------------------------------------------------------------

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


def pictures_of(calibration: Calibrations, project: Project | None = None) -> Pictures:
    """Yield the charts of a calibration, with captions.

    Parameters
    ----------
    calibration : Calibrations
    project : Project, optional
        Project that contains the experiments; by default that of the job's folder.
    """
    data = _ChartData(calibration, project)
    for parts in (_of_searches, _of_parameters, _of_experiments, _overlays):
        for picture in parts(data):
            yield picture._replace(caption=_caption(picture.name))


def _caption(name: str) -> str:
    stem = max((stem for stem in CAPTIONS if name.startswith(stem)), key=len)
    which = name[len(stem) + 1 :]
    return CAPTIONS[stem] + (f" Here the {which}." if stem == "overlay" and which else "")


def _of_searches(data: _ChartData) -> Pictures:
    """Charts of the search for all experiments, of three single searches, and of all durations."""
    together, searched = data.together, data.searched
    if together is not None and together.trace is not None:
        yield Picture("search", _search_chart(data, [("", together)]), data.banner)
        yield from _starts(data, "", together)
    picks = _picks(searched)
    if picks:
        name = "search" if together is None else "search_alone"
        yield Picture(name, _search_chart(data, picks), data.banner)
    for word, one in picks:
        yield from _starts(data, word, one)
    if len(searched) > 1:
        counts = [0 if one.trace is None else len(one.trace.errors) for one in searched]
        seconds = np.array([one.seconds for one in searched])
        keys = [data.keys[one.members[0]] for one in searched]
        yield Picture("seconds", seconds_chart(keys, seconds, counts), data.banner)


def _of_parameters(data: _ChartData) -> Pictures:
    """Charts of the set for all experiments, or of single ones if there is no such set."""
    together = data.together
    sets = [("", together)] if together is not None else _picks(data.searched)
    for word, one in sets:
        yield Picture(
            _named("parameters", word, data), _parameters_chart(data, word, one), data.banner
        )
        if one.profiles:
            profiles = _profiles_chart(data, word, one)
            yield Picture(_named("profiles", word, data), profiles, data.banner)
    if len(data.alone) > 1:
        quantities = [
            Quantity(
                unknown.label,
                unknown.unit,
                _column(data, [one.point[k] for one in data.alone]),
                bounds=(unknown.low, unknown.high),
            )
            for k, unknown in enumerate(data.space.free)
        ]
        chart = _offsets_chart(data, "Parameters, each experiment by itself", quantities)
        yield Picture("parameters_by_offset", chart, data.banner)


def _of_experiments(data: _ChartData) -> Pictures:
    """Charts of the errors of all experiments, before and after."""
    if len(data.keys) == 1:  # the overlay shows it
        return
    series = {name: data.lengths(errors) for name, errors in _series(data).items()}
    yield Picture("errors", errors_chart(data.keys, series, "mm"), data.banner)
    if data.offset_axes:
        name = "each alone" if "each alone" in series else list(series)[-1]
        error = Quantity("error", "mm", series[name], log=True)
        chart = _offsets_chart(data, f"Error, {name}", [error])
        yield Picture("errors_by_offset", chart, data.banner)


def _overlays(data: _ChartData) -> Pictures:
    """Overlays of the best, the median and the worst experiment, before and after."""
    together, alone = data.together, {one.members[0]: one for one in data.alone}
    after = list(_series(data).values())[-1]
    for word, member in _three(after):
        one = together if together is not None else alone[member]
        chart = _overlay_chart(data, word, member, one.point, float(after[member]))
        yield Picture(_named("overlay", word, data), chart, data.banners[member])


# --- choices ------------------------------------------------------------------------------------


def _named(stem: str, word: str, data: _ChartData) -> str:
    """Add a word such as "best" to a name, unless there is only one experiment."""
    return f"{stem}_{word}" if word and len(data.keys) > 1 else stem


def _three(errors: FloatArray) -> list[tuple[str, int]]:
    """Indices of the best, the median and the worst error; fewer if there are fewer."""
    order = np.argsort(errors, kind="stable").tolist()
    if len(order) == 1:
        return [("", order[0])]
    middle = [("median", order[(len(order) - 1) // 2])] if len(order) > 2 else []
    return [("best", order[0]), *middle, ("worst", order[-1])]


def _picks(found: list[ParameterSet]) -> list[tuple[str, ParameterSet]]:
    """Select the best, the median and the worst single calibration."""
    if not found:
        return []
    errors = np.array([one.errors[0] for one in found])
    return [(word, found[k]) for word, k in _three(errors)]


def _series(data: _ChartData) -> dict[str, FloatArray]:
    """Errors of all experiments by the set used; the last is the requested result."""
    series = {BEFORE: data.outcome.nominal}
    if data.alone:
        name = "after" if data.together is None else "each alone"
        series[name] = _column(data, [one.errors[0] for one in data.alone])
    if data.together is not None:
        series["after" if not data.alone else "one set for all"] = data.together.errors
    return series


def _column(data: _ChartData, values: list[float]) -> FloatArray:
    """Arrange values of the single calibrations by experiment; nan where one has none."""
    column = np.full(len(data.keys), np.nan)
    for one, value in zip(data.alone, values, strict=True):
        column[one.members[0]] = value if math.isfinite(one.errors[0]) else np.nan
    return column


# --- charts -------------------------------------------------------------------------------------


def _search_chart(data: _ChartData, picks: list[tuple[str, ParameterSet]]) -> Chart:
    panels = []
    for word, one in picks:
        assert one.trace is not None
        title = _title_of(data, one)
        if word:
            title = f"{word} of {len(data.searched)}\n{title}"
        panels.append(
            SearchPanel(title, data.lengths(one.trace.errors, len(one.members)), one.trace.begins)
        )
    return search_chart(panels, unit="mm", what=_what(data, picks[0][1]))


def _what(data: _ChartData, one: ParameterSet) -> str:
    """Name of the number that a search minimised."""
    if len(one.members) == 1:
        return "RMS error"
    return "largest RMS error" if data.request.combine == "largest" else "RMS error"


def _starts(data: _ChartData, word: str, one: ParameterSet) -> Pictures:
    """Chart of the ends of all starts, if there were several."""
    if data.request.starts == 1 or one.trace is None:
        return
    ends = one.trace.ends()
    if len(ends) < 2:
        return
    chart = starts_chart(
        title=f"{len(ends)} starts: {_title_of(data, one)}",
        unit="mm",
        errors=data.lengths(np.array([end.error for end in ends]), len(one.members)),
        points=np.array([end.point for end in ends]),
        unknowns=data.space.free,
        evaluations=np.bincount(one.trace.starts).tolist(),
        nearly=NEARLY if data.unit == "mm" else 0.5 * NEARLY,
        what=_what(data, one),
    )
    yield Picture(_named("starts", word, data), chart, data.banner)


def _parameters_chart(data: _ChartData, word: str, one: ParameterSet) -> Chart:
    return parameters_chart(
        title=_title_of(data, one, word),
        rows=data.estimates(one),
        others={name: point.tolist() for name, point in _other_sets(data, one).items()},
        level=data.request.level,
    )


def _other_sets(data: _ChartData, one: ParameterSet) -> dict[str, FloatArray]:
    """Other sets for the same experiments, and distinct solutions that are nearly as good."""
    found = {
        str(o.how): o.point
        for o in data.outcome.together
        if o is not one and one.how == FitKind.DIRECT
    }
    for k, point in enumerate(one.solutions[1:], 2):
        found[f"solution {k}, nearly as good"] = point
    return dict(list(found.items())[:MAX_OTHERS])


def _profiles_chart(data: _ChartData, word: str, one: ParameterSet) -> Chart:
    return profiles_chart(
        title=_title_of(data, one, word),
        profiles=one.profiles,
        estimates={estimate.label: estimate for estimate in one.estimates},
        level=data.request.level,
    )


def _offsets_chart(data: _ChartData, title: str, quantities: list[Quantity]) -> Chart:
    return offsets_chart(
        title=title,
        keys=data.keys,
        groups=data.groups,
        axes=data.offset_axes,
        quantities=quantities,
    )


# --- one experiment -----------------------------------------------------------------------------


def _overlay_chart(
    data: _ChartData, word: str, member: int, point: FloatArray, error: float
) -> Chart:
    target = data.targets[member]
    scene = target.case.scene
    before, after = (_simulated(data, target, p) for p in (data.space.nominal, point))
    body = scene.bodies[0]
    nominal = float(data.lengths(data.outcome.nominal[member]))
    start = np.concatenate(([0.0], target.case.times))
    title = target.key if not word else f"{target.key}: the {word} of {len(data.keys)}"
    own = OverlayMotions(
        outline=body.shape.outline,
        measured=Track(start, np.vstack((body.pose, target.pose))),
        before=_track(before, nominal),
        after=_track(after, float(data.lengths(np.asarray(error)))),
        real=not data.banners[member],
        fixels=[placed(fixel.shape.outline, fixel.pose) for fixel in scene.fixels],
        pusher=_pusher(after),
        unit="mm",
    )
    return overlay_chart(title, own)


def _simulated(data: _ChartData, target: Target, point: FloatArray) -> Simulation:
    columns = data.space.columns(point[None], target.conditions)
    duration = float(target.case.times[-1])
    return simulate(
        target.case.scene,
        Parameters({name: float(values[0]) for name, values in columns.items()}),
        motion=data.request.made_motion,
        duration=duration,
        output_interval=duration / max(SAMPLES, len(target.pose)),
    )


def _track(simulation: Simulation, error: float) -> Track:
    """Simulated track until the simulation ended."""
    pose = simulation.pose[simulation.scene.bodies[0].name]
    known = np.isfinite(pose).all(axis=1)
    return Track(simulation.time[known], pose[known], error if math.isfinite(error) else None)


def _pusher(simulation: Simulation) -> list[FloatArray]:
    """Outlines of the pusher at the start and at the end."""
    outlines = []
    for pusher in simulation.scene.pushers[:1]:
        pose = simulation.pose[pusher.name]
        known = pose[np.isfinite(pose).all(axis=1)]
        outlines += [placed(pusher.shape.outline, known[k]) for k in (0, -1)]
    return outlines
