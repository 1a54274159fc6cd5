"""Unknowns of a plan: parameters, start, rig and runs, and samples of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Annotated, Any, Final, NamedTuple, final

import numpy as np
import shapely

from fixel.calibration.known_pushes import push_target
from fixel.errors import InvalidInput
from fixel.model import Experiment, Parameters, Scene
from fixel.model.experiment import conditions_of
from fixel.model.fields import Value, check_fields, instance, non_negative, settle, whole
from fixel.parts.fit import NAMES
from fixel.parts.model import PartModel
from fixel.simulation.motion import AbstractMotionModel, QuasiStatic
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.error_terms import LABEL, StartError, even_points
from fixel.uncertainty.posterior import Posterior
from fixel.uncertainty.predictive import CalibratedModel, EndError, PredictiveModel
from fixel.uncertainty.run_to_run import RunToRun

# Numbers of the streams of random values, so that no setting changes the values of another.
_PARAMETERS, _START, _RIG, _RUN, _REST = range(5)

CENTRES: Final = ("friction_centre_x", "friction_centre_y")

Interval = tuple[float, float]

# SI units of the unknowns that are no parameters.
UNKNOWN_UNITS: Final[Mapping[str, str]] = {
    "start x": "m", "start y": "m", "start angle": "rad",
    "tool along its path": "m", "tool across its path": "m", "tool heading": "rad",
}  # fmt: skip


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RigError:
    """Standard deviations of the errors of a rig, drawn for every run.

    Parameters
    ----------
    path : float
        Offset of the tool's path across it [m].
    heading : float
        Angle of that path, about its start [rad].
    travel : float
        Offset of the path along it [m].
    fixels : float
        Place of each fixel, in either coordinate [m].

    Examples
    --------
    >>> from fixel.units import deg, mm
    >>> RigError(path=0.2 * mm, heading=0.3 * deg).travel
    0.0
    """

    path: Annotated[float, Value(non_negative, "m")] = 0.0
    heading: Annotated[float, Value(non_negative, "rad")] = 0.0
    travel: Annotated[float, Value(non_negative, "m")] = 0.0
    fixels: Annotated[float, Value(non_negative, "m")] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "belief.rig")


class Scenarios(NamedTuple):
    """Samples of what is unknown, each for one run of a plan."""

    values: Mapping[str, FloatArray]  # parameters (n,) by name
    start: FloatArray  # (n, 3) errors of the start pose [m, m, rad]
    tool: FloatArray  # (n, 3) errors of the tool's path: along, across [m], heading [rad]
    fixels: FloatArray | None  # (n, n_fixel, 3) errors of the places of fixels [m, m, rad]
    rest: FloatArray  # (n, 3) error of ends that touch nothing, by rotation, see `rest_at`
    drift: FloatArray  # (n, 3) error of such ends, for any rotation [m, m, rad]
    # (n, 3) error of ends after a mean motion, over its scale, and what that is.
    misfit: FloatArray
    end_error: EndError | None
    world: IntArray  # (n,) sample of the parameters, which runs share

    @property
    def n(self) -> int:
        """Number of scenarios."""
        return len(self.world)

    def rows(self, which: IntArray) -> Scenarios:
        """Return some of the scenarios."""
        own: Scenarios = rows_of(self, which)
        return own

    def unknowns(self) -> dict[str, FloatArray]:
        """Return what differs between scenarios, (n,) each, by name."""
        errors = np.column_stack((self.start, self.tool))
        named = {**self.values, **dict(zip(UNKNOWN_UNITS, errors.T, strict=True))}
        return {name: x for name, x in named.items() if np.ptp(x) > 0.0}


def rows_of(own: Any, which: IntArray) -> Any:
    """Return some rows of arrays, also of those in tuples and mappings."""
    if isinstance(own, tuple):
        return type(own)(*(rows_of(x, which) for x in own))
    if isinstance(own, Mapping):
        return {name: rows_of(x, which) for name, x in own.items()}
    return own[which] if isinstance(own, np.ndarray) else own


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Belief:
    """Distribution of the parameters, the start, the rig and the runs of a plan.

    Parameters
    ----------
    parameters : Posterior, PartModel, Calibration, mapping or sequence of mappings, optional
        Samples from a posterior, from the distribution of the part that `conditions` names, or from
        the intervals and correlations of a calibration. Or a value or an interval ``(low, high)``
        by name, sampled evenly [SI], or several sets of values that are equally likely, the nominal
        one first. By default the scene's own values.
    start : StartError, optional
        Errors of the start pose. By default none.
    rig : RigError, optional
        Errors of the rig. By default none.
    run_to_run : RunToRun, optional
        Scatter between runs of the same push, drawn inside the simulation and learned from
        repetitions. It replaces the error of the model itself, the default, which is added to ends
        where nothing touches (posterior, part model) or grows with the motion and the spread
        (calibration).
    conditions : mapping of str to str or float
        Labels of the part, the surface and others, which select parameters.
    sets : sequence of mappings, optional
        Parameter sets that are drawn instead of those of a model, once the part was seen. The error
        of the model stays.

    Examples
    --------
    >>> from fixel.units import mm
    >>> start = StartError(x=mm, y=mm, kind="uniform")
    >>> belief = Belief(parameters={"mu_pusher": (0.2, 0.4)}, start=start)
    >>> from fixel.testing.scenes import pushed_square
    >>> scenarios = belief.scenarios(pushed_square(), worlds=4, runs=2)
    >>> scenarios.n
    8
    """

    parameters: Any = None
    start: StartError | None = None
    rig: RigError | None = None
    run_to_run: RunToRun | None = None
    conditions: Mapping[str, str | float] = field(default_factory=dict)
    sets: Sequence[Mapping[str, float]] = ()

    def __post_init__(self) -> None:
        instance(self.start, StartError | None, "belief.start", "a StartError")
        instance(self.rig, RigError | None, "belief.rig", "a RigError")
        instance(self.run_to_run, RunToRun | None, "belief.run_to_run", "a RunToRun")
        settle(self, conditions=conditions_of(self.conditions, "belief.conditions"))
        given = self.parameters
        instance(self.sets, Sequence, "belief.sets", "parameter sets")
        if self.sets:
            _check_sets(self.sets, "belief.sets")
        if isinstance(given, Sequence):
            _check_sets(given, "belief.parameters")
        elif not isinstance(given, Posterior | PartModel | CalibratedModel):
            instance(given, Mapping | None, "belief.parameters", "a mapping or a calibrated model")
            Parameters({name: ends(x, name)[0] for name, x in (given or {}).items()})

    @property
    def motion(self) -> AbstractMotionModel:
        """Motion model that the parameters belong to; quasi-static by default."""
        from fixel.simulation.motion import motion_model

        own = getattr(self.parameters, "motion", None)
        return motion_model(own) if own else QuasiStatic()

    @property
    def is_calibrated(self) -> bool:
        """Whether the parameters come from experiments."""
        return isinstance(self.parameters, Posterior | PartModel | CalibratedModel)

    @property
    def misfit(self) -> str:
        """Why the calibrated model does not fit its experiments; empty where it does."""
        own: Any = getattr(self.parameters, "misfit", None)
        return str(own.reason) if getattr(own, "model_error", False) else ""

    @property
    def has_known_pushes(self) -> bool:
        """Whether it is known which pushes the parameters were calibrated to."""
        return getattr(self.parameters, "known", None) is not None

    @property
    def error_text(self) -> str:
        """Error of the calibrated model as text; empty where none is known."""
        if self.run_to_run is not None or not isinstance(self.parameters, PredictiveModel):
            return ""
        own = self.parameters.predictive.error
        return f"error of ends: {1e3 * own.size:.3g} mm after a motion of {1e3 * own.motion:.3g} mm"

    @property
    def start_text(self) -> str:
        """Error of the start as text."""
        return "start: no stated error" if self.start is None else str(self.start)

    def nominal(self, scene: Scene) -> dict[str, float]:
        """Return the likeliest parameters."""
        given: Any = self.sets or self.parameters
        if isinstance(given, Posterior):
            own = given.under(self.conditions)
            found = own.values(own.best[None], self.conditions)
            return _without_start({name: float(x[0]) for name, x in found.items()})
        if isinstance(given, PartModel):
            labels = self._labels(given, scene)
            mean = given.distribution(
                labels.get(given.surface, ""), labels.get(given.part, "")
            ).mean
            return dict(zip(NAMES, mean.tolist(), strict=True))
        if isinstance(given, CalibratedModel):
            return _without_start(given.values_for(**self.conditions))
        if isinstance(given, Sequence):
            return {name: float(x) for name, x in given[0].items()}
        return {name: sum(ends(x, name)) / 2.0 for name, x in (given or {}).items()}

    def unseen(self, push: Scene | Experiment) -> tuple[str, ...]:
        """Return sentences on what no experiment of the model has about a push."""
        given: Any = self.parameters
        if isinstance(given, PartModel):
            return given.unseen(push, **self._labels(given, push))
        known = getattr(given, "known", None)
        if known is None:
            return ()
        return tuple(known.texts(push_target(push, dict(self.conditions))))

    def scenarios(self, scene: Scene, *, worlds: int, runs: int, seed: int = 0) -> Scenarios:
        """Draw scenarios: `runs` for each of `worlds` samples of the parameters.

        Parameters
        ----------
        scene : Scene
        worlds, runs : int
        seed : int

        Returns
        -------
        Scenarios
            Runs of one sample of the parameters follow each other.
        """
        n = whole(worlds, "worlds") * whole(runs, "runs")
        world = np.repeat(np.arange(worlds), runs)
        columns, error = self._drawn(scene, worlds, seed)
        values = {name: column[world] for name, column in columns.items()}
        start = np.zeros((n, 3)) if self.start is None else self._starts(n, seed)
        rest, drift, misfit = np.zeros((3, n, 3))
        if self.run_to_run is not None:
            own = self.run_to_run.drawn(n, seed=_seed(seed, _RUN), scene=scene, values=values)
            values, start, rest = own.values, start + own.start, own.rest
        elif error is not None:
            arm = math.sqrt(scene.bodies[0].shape.unit_inertia)
            rng, size = np.random.default_rng(_seed(seed, _REST)), np.array([1.0, 1.0, arm])
            if isinstance(error, EndError):
                misfit = EndError.draws(rng, (n,)) / size
            else:
                drift = error[world, None] * (rng.standard_normal((n, 3)) / size)
        tool, fixels = self._rig(scene, n, seed)
        end_error = error if isinstance(error, EndError) else None
        return Scenarios(values, start, tool, fixels, rest, drift, misfit, end_error, world)

    def _starts(self, n: int, seed: int) -> FloatArray:
        assert self.start is not None
        drawn = self.start.samples(n, _seed(seed, _START))
        # Points of a sequence in order would give the runs of a world neighbouring parts of it.
        return drawn[np.random.default_rng(_seed(seed, _START)).permutation(n)]

    def _rig(self, scene: Scene, n: int, seed: int) -> tuple[FloatArray, FloatArray | None]:
        if self.rig is None:
            return np.zeros((n, 3)), None
        rng = np.random.default_rng(_seed(seed, _RIG))
        size = (self.rig.travel, self.rig.path, self.rig.heading)
        tool = rng.standard_normal((n, 3)) * size
        if self.rig.fixels == 0.0 or not scene.fixels:
            return tool, None
        fixels = self.rig.fixels * rng.standard_normal((n, len(scene.fixels), 3))
        return tool, fixels * (1.0, 1.0, 0.0)

    def _drawn(
        self, scene: Scene, worlds: int, seed: int
    ) -> tuple[dict[str, FloatArray], FloatArray | EndError | None]:
        """Draw parameters (worlds,), and standard deviations of the model error [m], if known."""
        if self.sets:
            deviation = replace(self, sets=())._drawn(scene, worlds, seed)[1]
            return _of_sets(self.sets, worlds), deviation
        given: Any = self.parameters
        number = _seed(seed, _PARAMETERS)
        if isinstance(given, Posterior):
            own = given.under(self.conditions)
            rng = np.random.default_rng(number)
            rows = np.resize(rng.permutation(len(own.points)), worlds)
            values = own.values(own.points[rows], self.conditions)
            tau = own.points[rows, -1] if own.labels[-1] == LABEL else None
            return _without_start(values), tau
        if isinstance(given, PartModel):
            labels = self._labels(given, scene)
            tau = np.full(worlds, given.typical_deviation) if given.typical_error else None
            return given.samples(worlds, number, **labels), tau
        if self.run_to_run is None and isinstance(given, PredictiveModel):  # which computes it
            found = given.predictive
            return _without_start(found.samples(worlds, number, self.conditions)), found.error
        if isinstance(given, CalibratedModel):
            return _without_start(given.samples(worlds, number, **self.conditions)), None
        if isinstance(given, Sequence):
            return _of_sets(given, worlds), None
        return self._intervals(worlds, number), None

    def _intervals(self, worlds: int, number: int) -> dict[str, FloatArray]:
        """Draw evenly from the intervals of a mapping."""
        spans = {name: ends(x, name) for name, x in (self.parameters or {}).items()}
        wide = [name for name, (low, high) in spans.items() if high > low]
        even = even_points(worlds, len(wide), number) if wide else np.zeros((worlds, 0))
        shuffled = even[np.random.default_rng(number).permutation(worlds)]
        found = {name: np.full(worlds, low) for name, (low, _) in spans.items()}
        for name, share in zip(wide, shuffled.T, strict=True):
            low, high = spans[name]
            found[name] = low + (high - low) * share
        return found

    def _labels(self, model: PartModel, push: Scene | Experiment) -> dict[str, str]:
        own = {name: str(x) for name, x in self.conditions.items()}
        return own or dict(model.labels(push))


def ends(value: Any, name: str) -> Interval:
    """Return the ends of an interval; twice the value if it is one number."""
    try:
        low, high = value if np.ndim(value) else (value, value)
        low, high = float(low), float(high)
    except (TypeError, ValueError):
        low = high = math.nan
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        expected = "a number, or (low, high) with low <= high"
        raise InvalidInput(f"belief.parameters.{name}", found=repr(value), expected=expected)
    return low, high


def check_centres(belief: Belief, scene: Scene) -> None:
    """Raise `InvalidInput` for a given centre of friction that is outside the part."""
    given: Any = belief.parameters
    if given is None or belief.is_calibrated:
        return
    shape = scene.bodies[0].shape
    hull = shapely.MultiPoint(shape.outline).convex_hull.buffer(1e-9)
    for own in given if isinstance(given, Sequence) else [given]:
        spans = {name: ends(own.get(name, 0.0), name) for name in CENTRES}
        corners = shape.centroid + np.array(list(product(*spans.values())))
        if hull.covers(shapely.MultiPoint(corners)):
            continue
        text = " and ".join(
            f"{name} in {_millimetres(*span)}" for name, span in spans.items() if name in own
        )
        x, y = shape.outline.T - shape.centroid[:, None]
        raise InvalidInput(
            "belief.parameters",
            found=f"{text}, a centre of friction outside the part",
            expected=f"one on the part: x in {_millimetres(x.min(), x.max())} and y in"
            f" {_millimetres(y.min(), y.max())} from its centre of mass",
        )


def _millimetres(low: float, high: float) -> str:
    return f"[{1e3 * low:.4g}, {1e3 * high:.4g}] mm"


def _of_sets(sets: Sequence[Mapping[str, float]], n: int) -> dict[str, FloatArray]:
    rows = np.arange(n) * max(n, len(sets)) // n % len(sets)  # of many, evenly spread ones
    return {name: np.array([own[name] for own in sets])[rows] for name in sets[0]}


def _check_sets(sets: Sequence[Any], where: str) -> None:
    if not sets:
        raise InvalidInput(where, found="no sets", expected="one set or more")
    for k, own in enumerate(sets):
        instance(own, Mapping, f"{where}[{k}]", "a mapping of names to values")
        Parameters(own)
        if set(own) != set(sets[0]):
            expected = f"the parameters of the first set: {', '.join(sets[0])}"
            raise InvalidInput(f"{where}[{k}]", found=", ".join(own), expected=expected)


def _without_start(values: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out the start of the calibrated experiments, which is not that of a plan."""
    return {name: x for name, x in values.items() if not name.startswith("start_")}


def _seed(seed: int, stream: int) -> int:
    """Return the seed of a stream of random values."""
    return int(np.random.SeedSequence([seed, stream]).generate_state(1)[0])
