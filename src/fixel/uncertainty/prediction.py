"""Predictions: simulated motions of a push whose start, parameters or model are uncertain."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from types import MappingProxyType
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.calibration.target import target_of
from fixel.errors import InvalidInput, counted
from fixel.model import BodyTrack, Experiment, Goal, Parameters, Probability, Scene
from fixel.model.fields import inner_share, settle
from fixel.model.goals import as_goal, touching
from fixel.model.records import Estimate
from fixel.model.space import meets, split_label
from fixel.model.trajectory import wrapped
from fixel.results import Result, Summary
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.simulation.simulate import SceneWithMethod, scene_file
from fixel.simulation.stepping import AbstractStepper
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray
from fixel.uncertainty.error_terms import StartError
from fixel.uncertainty.predictive import CalibratedModel
from fixel.units import length_unit


class Push(NamedTuple):
    """Scene with the parameters and the motion model to simulate it with."""

    scene: Scene
    times: FloatArray | None  # (n_time,) instants of the measured poses [s]
    conditions: Mapping[str, str | float]
    values: dict[str, float]
    motion: AbstractMotionModel
    intervals: Mapping[str, tuple[float, float]]  # of a calibration, where the data set both ends
    stepper: AbstractStepper | None  # of a scene file


def push_of(
    what: Scene | SceneWithMethod | str | PathLike[str] | Experiment,
    model: Mapping[str, float] | None = None,
    motion: AbstractMotionModel | str | None = None,
) -> Push:
    """Return the push of a scene, or of an experiment up to its last useful pose.

    Parameters are by default the scene's own values, and the motion model that of a calibration or
    scene file, else dynamic. An experiment without a scene and an unknown parameter raise
    `InvalidInput`.
    """
    times: FloatArray | None = None
    conditions: Mapping[str, str | float] = {}
    stepper: AbstractStepper | None = None
    own_motion = None
    if isinstance(what, Experiment):
        target = target_of(what)
        times = target.case.times
        scene = replace(target.case.scene, duration=float(target.case.times[-1]))
        conditions = target.conditions
    elif isinstance(what, Scene):
        scene = what
    else:
        file = scene_file(what, "a Scene, a scene file or an Experiment")
        scene, own_motion, stepper = file.scene, file.motion, file.stepper
    calibrated: object = model
    if not isinstance(calibrated, CalibratedModel):
        method = motion_model(motion or own_motion)
        return Push(scene, times, conditions, dict(Parameters(model or {})), method, {}, stepper)
    values = calibrated.values_for(**conditions)
    intervals = intervals_of(calibrated.estimates.values(), conditions)
    method = motion_model(motion or calibrated.motion)
    return Push(scene, times, conditions, values, method, intervals, stepper)


def intervals_of(
    estimates: Iterable[Estimate], conditions: Mapping[str, str | float]
) -> dict[str, tuple[float, float]]:
    """Return the intervals of parameters under conditions, where the data determine both ends."""
    found: dict[str, Estimate] = {}
    for own in estimates:
        name, where = split_label(own.label)
        if meets(conditions, where) and not name.startswith("start_"):
            found.setdefault(name, own)
    ends = ((name, own.low, own.high) for name, own in found.items())
    return {k: (a, b) for k, a, b in ends if a is not None and b is not None and a < b}


SHARES: Final = (0.05, 0.5, 0.95)  # quantiles of the ends in a summary


@final
@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Prediction(Result):
    """Ensemble of simulated motions of one push.

    Made by `fixel.predict`.

    Attributes
    ----------
    scene : Scene
    error : StartError or None
        Distribution of the start errors; None if they have another source, or there are none.
    drawn : (n, 3) float64
        Errors of the start [m, m, rad].
    start : (n, 3) float64
        Start poses, moved out of neighbours that they overlapped [m, m, rad].
    time : (n_time,) float64
        Instants of the poses [s].
    pose : (n, n_time, 3) float64
        Simulated poses of the body, with continuous angles; valid only in rows with `ended`.
    nominal : (n_time, 3) float64
        Poses of the simulation without a start error, with the nominal or likeliest parameters.
    ended : (n,) bool
        Simulations that ended: as planned, or because a rigid drive was jammed.
    reasons : tuple of str
        Reason why a simulation did not end, or that it jammed; empty for a planned end.
    motion : str
        Name of the motion model.
    seed : int
    parameters : mapping of str to float or (n,) float64
        Parameters of the simulations, by name.
    drift : (n, n_time, 3) float64, optional
        Errors of the model itself, which are added to the poses.
    noise : (n, n_time, 3) float64, optional
        Errors of the camera, which are added to the poses.
    shares : mapping of str to (3,) float64
        Standard deviations of the end by their origin [m, m, rad]; empty if not computed.
    unseen : tuple of str
        What no experiment of the calibration or posterior has: part, surface, side, speed.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> from fixel.units import mm
    >>> start = fixel.StartError(x=1 * mm, y=1 * mm, kind="uniform")
    >>> ends = fixel.predict(pushed_square(0.5), start=start, samples=40, progress=False)
    >>> ends.pose.shape[0]
    40
    """

    scene: Scene
    error: StartError | None
    drawn: FloatArray
    start: FloatArray
    time: FloatArray
    pose: FloatArray
    nominal: FloatArray
    ended: BoolArray
    reasons: tuple[str, ...]
    motion: str
    seed: int
    parameters: Mapping[str, Any] = field(default_factory=dict)
    drift: FloatArray | None = None
    noise: FloatArray | None = None
    shares: Mapping[str, FloatArray] = field(default_factory=dict)
    unseen: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        settle(self, parameters=MappingProxyType(dict(self.parameters)))

    @property
    def truths(self) -> FloatArray:
        """Poses (k, n_time, 3) of the simulations that ended, with model error."""
        poses = self.pose if self.drift is None else self.pose + self.drift
        return np.asarray(poses[self.ended])

    @property
    def draws(self) -> FloatArray:
        """Poses (k, n_time, 3) of the simulations that ended, with model error and camera noise."""
        return self.truths if self.noise is None else self.truths + self.noise[self.ended]

    @property
    def ends(self) -> FloatArray:
        """Last poses (k, 3) of the draws [m, m, rad]."""
        return np.asarray(self.draws[:, -1])

    @property
    def failed(self) -> int:
        """Number of simulations without an end, which are left out."""
        return int(np.sum(~self.ended))

    @property
    def moved_apart(self) -> float:
        """Share of starts that were moved out of a neighbour."""
        asked = self.scene.bodies[0].pose + self.drawn
        return float(np.mean(np.hypot(*(self.start - asked)[:, :2].T) > 1e-12))

    @property
    def arm(self) -> float:
        """Radius of gyration of the body, by which rotations are counted as lengths [m/rad]."""
        return float(np.sqrt(self.scene.bodies[0].shape.unit_inertia))

    # --- contacts -------------------------------------------------------------------------------

    def meets(self, goal: Goal) -> BoolArray:
        """Return whether each of the k simulations that ended meets a goal, (k,) bool.

        Goals regard the simulated poses, without model error and camera noise: these would
        separate bodies in contact.
        """
        return as_goal(goal).met(self.scene, BodyTrack(self.pose[self.ended]))

    def probability(self, goal: Goal, *, level: float = 0.95) -> Probability:
        """Return the probability that the push meets a goal, with its interval.

        Parameters
        ----------
        goal : Goal
        level : float
            Confidence level of the interval, which covers the number of runs alone: not an error
            of the model or of the distributions it was given.

        Returns
        -------
        Probability
            Share of the runs that ended, with interval and number.
        """
        met = self.meets(goal)
        return Probability.of(int(met.sum()), len(met), level)

    @property
    def mode(self) -> np.ndarray:
        """Contacts (n,) with the fixels at the end, one digit (0 or 1) each; empty without any."""
        touched = touching(self.scene, self.scene.bodies[0], self.pose[:, -1])
        modes = np.full(len(touched), "", dtype=f"<U{max(1, touched.shape[1])}")
        for column in touched.T:
            modes = np.char.add(modes, np.where(column, "1", "0"))
        return modes

    @property
    def modes(self) -> Mapping[str, Probability]:
        """Probability of each contact mode at the end, the most frequent first.

        A mode has one digit per fixel: `"011"` where the second and third are touched.
        """
        own = self.mode[self.ended]
        return {
            str(name): Probability.of(n, len(own))
            for name, n in Counter(own.tolist()).most_common()
        }

    # --- poses ----------------------------------------------------------------------------------

    def bands(self, level: float = 0.9) -> Band:
        """Return a pointwise band of the path: quantiles of each instant.

        Parameters
        ----------
        level : float
            Share of the draws inside, at each instant and in each coordinate.
        """
        shares = (0.5 - level / 2, 0.5 + level / 2)
        return Band(level, *np.quantile(_several(self.draws), shares, axis=0))

    def region(self, level: float = 0.9) -> EndBounds:
        """Return an ellipse of positions and an interval of angles that contain the end.

        Parameters
        ----------
        level : float
            Probability of each of them.
        """
        return bounds_of(self.draws[:, -1], level)

    def levels_of(self, pose: FloatArray) -> tuple[float, float]:
        """Return levels of the smallest regions that contain an end pose (3,): position, angle."""
        return levels_of(self.draws[:, -1], np.asarray(pose, np.float64))

    # --- text -----------------------------------------------------------------------------------

    def _summary(self) -> Summary:
        ends, n = self.ends, len(self.ended)
        own, metre = length_unit(self.scene.bodies[0].shape.radius)
        factors = 1.0 / metre, 1.0 / metre, math.degrees(1.0)
        units = zip(("x", "y", "theta"), (own, own, "deg"), factors, strict=True)
        low, middle, high = (
            np.quantile(ends, SHARES, axis=0) if len(ends) else np.full((3, 3), np.nan)
        )
        head: tuple[Column | str, ...] = (
            "end",
            *(Column(c, format=".2f") for c in ("nominal", "5 %", "median", "95 %")),
        )
        rows = [
            (f"{name} [{unit}]", *(factor * x[k] for x in (self.nominal[-1], low, middle, high)))
            for k, (name, unit, factor) in enumerate(units)
        ]
        starts = "" if self.error is None else f", {self.error}"
        lost = f"not included: {counted(self.failed, 'run')} without an end pose"
        notes = [lost] if self.failed else []
        if self.drift is not None:
            notes.append("end poses include model error; contacts do not")
        return Summary(
            f"Prediction: {counted(n, 'run')}{starts} ({self.motion})",
            [Table(head, rows), *self._mode_table()],
            notes,
            {"seed": str(self.seed), "parameters": ", ".join(self.parameters) or "of the scene"},
            self.unseen,
        )

    def _mode_table(self) -> list[Table]:
        names = [fixel.name for fixel in self.scene.fixels]
        if not names or not self.ended.any():
            return []
        rows = [
            (", ".join(f for f, d in zip(names, mode, strict=True) if d == "1") or "nothing",
             own.value, own.low, own.high)
            for mode, own in self.modes.items()
        ]  # fmt: skip
        numbers = (Column(c, format=".3f") for c in ("probability", "low", "high"))
        return [Table(("contacts at the end", *numbers), rows)]

    def _data(self) -> Table:
        """Start error, end and contact mode of each run that ended; what is unseen first."""
        names = ("x", "y", "theta")
        units = ("m", "m", "rad")
        unseen = ("; ".join(self.unseen),) if self.unseen else ()
        columns = [
            *(Column("unseen") for _ in unseen),
            *(Column(f"start_error_{name}", unit) for name, unit in zip(names, units, strict=True)),
            *(Column(f"end_{name}", unit) for name, unit in zip(names, units, strict=True)),
            Column("contact_mode"),
        ]
        own = self.ended
        return Table(
            columns,
            [
                (*unseen, *start, *end, mode)
                for start, end, mode in zip(
                    self.drawn[own].tolist(), self.ends.tolist(), self.mode[own], strict=True
                )
            ],
        )


LEVELS: Final = (0.5, 0.9)
CURVE_LEVELS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)


class Band(NamedTuple):
    """Ends of a band around a path, frame by frame."""

    level: float
    low: FloatArray  # (n_frame, 3) x, y, theta [m, m, rad]
    high: FloatArray  # (n_frame, 3)


class Ellipse(NamedTuple):
    """Elliptic region of positions."""

    level: float
    centre: FloatArray  # (2,) [m]
    radii: FloatArray  # (2,) half axes, the larger first [m]
    angle: float  # angle of the larger axis [rad]


class EndBounds(NamedTuple):
    """Bounds that contain the end of a push with a given probability."""

    level: float
    position: Ellipse
    angle: tuple[float, float]  # the shortest interval [rad]


def bounds_of(poses: FloatArray, level: float) -> EndBounds:
    """Return the smallest ellipse of the draws' shape and the shortest interval of angles that
    contain a share of poses (k, 3)."""
    inner_share(level, "level")
    centre, spread = _shape(poses[:, :2])
    radius = float(np.quantile(_distances(poses[:, :2], centre, spread), level))
    variances, axes = np.linalg.eigh(spread)
    ellipse = Ellipse(
        level, centre, radius * np.sqrt(variances[::-1]), math.atan2(axes[1, 1], axes[0, 1])
    )
    return EndBounds(level, ellipse, shortest(poses[:, 2], level))


def shortest(values: FloatArray, level: float) -> tuple[float, float]:
    """Return the shortest interval that contains a share of values (k,)."""
    ordered = np.sort(values)
    inside = min(len(ordered) - 1, max(1, math.ceil(level * len(ordered)) - 1))
    width = ordered[inside:] - ordered[: len(ordered) - inside]
    k = int(np.argmin(width))
    return float(ordered[k]), float(ordered[k + inside])


def levels_of(poses: FloatArray, pose: FloatArray) -> tuple[float, float]:
    """Return levels of the smallest regions of positions and of angles that contain a pose (3,):
    the share of poses (k, 3) closer to the centre, measured in units of their spread."""
    centre, spread = _shape(poses[:, :2])
    others = _distances(poses[:, :2], centre, spread)
    own = float(_distances(pose[None, :2], centre, spread)[0])
    middle = float(np.median(poses[:, 2]))
    away = abs(float(wrapped(pose[2] - middle)))
    turned = np.abs(poses[:, 2] - middle)
    return float(np.mean(others < own)), float(np.mean(turned < away))


def _several(draws: FloatArray) -> FloatArray:
    """Return draws (k, ...) if there are two at least: fewer have no spread."""
    if len(draws) < 2:
        found = f"{counted(len(draws), 'simulation')} with an end pose"
        raise InvalidInput("prediction", found=found, expected="two at least")
    return draws


def _shape(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance, which is never singular, so that distances are finite."""
    spread = np.cov(_several(positions).T)
    least = 1e-12 * max(float(np.trace(spread)), 1e-18)
    return positions.mean(axis=0), spread + least * np.eye(2)


def _distances(positions: FloatArray, centre: FloatArray, spread: FloatArray) -> FloatArray:
    away = positions - centre
    return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", away, np.linalg.inv(spread), away)))


class CoverageCurve(NamedTuple):
    """Share of outcomes inside the bounds of each level."""

    levels: FloatArray  # (n,)
    held: FloatArray  # (n,)
    low: FloatArray  # (n,) 2.5 % point of the share, were the levels true
    high: FloatArray  # (n,) 97.5 %
    outcomes: int


def coverage_curve(found: FloatArray, levels: tuple[float, ...] = CURVE_LEVELS) -> CoverageCurve:
    """Return the coverage curve of outcomes.

    Each outcome is given by the level (n,) of the smallest bounds that contain it. The range `low`
    to `high` assumes independent outcomes.
    """
    from scipy.stats import binom

    own = np.asarray(found, np.float64)
    if own.ndim != 1 or not len(own) or not np.isfinite(own).all():
        raise InvalidInput("coverage", found="no outcomes", expected="one level for each outcome")
    wanted = np.array(levels)
    held = np.array([float(np.mean(own <= level)) for level in levels])
    n = len(own)
    return CoverageCurve(
        wanted, held, binom.ppf(0.025, n, wanted) / n, binom.ppf(0.975, n, wanted) / n, n
    )
