"""A particle filter that follows a pushed object and learns its friction while it moves.

Every particle is a pose with a set of parameters of its own. In each frame of the camera all of
them are simulated over the pusher's measured motion, in one compiled batch, and weighed by what was
seen and felt.

Source: Zhang, Lyu & Trinkle (2013), A dynamic Bayesian approach to real-time estimation and
filtering in grasp acquisition, for estimating pose and parameters together with tactile bits; the
numbers are those of the RPI laboratory's own filter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.filtering.observation import FixelGaps, squared_distance, tactile_log_likelihood
from fixel.filtering.prior import Prior, checked_priors, prior_for
from fixel.filtering.resampling import (
    Indices,
    effective_sample_size,
    shrunk,
    systematic,
    tempered,
)
from fixel.filtering.statistics import mean_pose, pose_covariance, quantiles
from fixel.model import Experiment, Scene
from fixel.model.fields import (
    BoolArray,
    FloatArray,
    instance,
    non_negative,
    optional_positive,
    positive,
    settle,
    vector,
)
from fixel.simulation import (
    AbstractMotionModel,
    BatchResult,
    FirstOrder,
    QuasiStatic,
    StewartTrinkle,
    simulate_batch,
)

QUANTILES: Final = (0.05, 0.5, 0.95)

FRAME: Final = 1.0 / 30.0  # [s] for which process noise is given

# [-] standard deviations; the nearest of all particles further than this from what was seen is no
# chance but a lost object.
LOST: Final = 6.0

AT_REST: Final = 1e-9  # of the object's size: motion below is rounding
STRIDE: Final = 0.01  # of the object's size: how far the pusher goes in one step of a simulation
FARTHEST: Final = 5.0  # times the pusher's way: an object that goes further was not pushed there

# Of all particles, in effective number, that one frame leaves at least. The camera will see the
# object again in the next frame, but values that have died out are gone for good.
LEAST_SHARE: Final = 0.1

MOST_WIDENED: Final = 8.0  # times the spread at the start
WEIGHTS_OF_LIMIT: Final = 20.0  # of the object, for a drive that the scene calls rigid


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ParticleFilter:
    """Options of a particle filter.

    Not for scenes with several free bodies or pushers, nor for parts that fly or coast: between two
    frames a particle has no velocity.

    Parameters
    ----------
    n_particles : int
        At least 2; 500 as in the laboratory.
    priors : mapping from name to (low, high) or None
        Uniform beliefs about parameters, in place of those of `DEFAULT_PRIORS`: friction of support
        and pusher 0.1 to 1, of fixels 0.2 to 0.5, tripod radius 10 to 100 mm. None leaves a
        parameter at the scene's value.
    start_position_deviation, start_angle_deviation : float
        Spread of the start pose, in either coordinate [m] and in angle [rad].
    position_deviation, angle_deviation : float
        Of a pose as the camera sees it, in either coordinate [m] and in angle [rad]. The
        laboratory's covariance is diag(0.5, 0.5 mm^2, 0.001 rad^2).
    no_contact_reliability, contact_reliability : float
        P(read 0 | no contact) and P(read 1 | contact) of a fixel [-].
    touch_gap : float
        Below which object and fixel count as touching [m].
    position_noise, angle_noise : float
        Process noise in 1/30 s, for all that the model leaves out [m], [rad]. It grows with the
        square root of time.
    discount : float
        Of the kernel that jitters parameters, see `resampling.shrunk` [-].
    resample_below : float
        Effective sample size, as a share of the particles, below which is resampled [-].
    motion : AbstractMotionModel
        `QuasiStatic` or `FirstOrder`: both go from pose to pose without velocities, so that a frame
        needs nothing of the one before it but the pose. That is right for pushing so slow that
        friction stops the object at once.
    force_limit : float, optional
        At which a drive stalls that the scene calls rigid [N]; 20 weights of the object where left
        out. A rigid drive would jam in most particles of a seated grasp.
    threads : int
        Of the simulation. The results are the same bits for any number.
    """

    n_particles: int = 500
    priors: Mapping[str, tuple[float, float] | None] = field(default_factory=dict)
    start_position_deviation: float = 0.5e-3
    start_angle_deviation: float = 0.02
    position_deviation: float = math.sqrt(0.5) * 1e-3
    angle_deviation: float = math.sqrt(1e-3)
    no_contact_reliability: float = 0.9575
    contact_reliability: float = 0.9875
    touch_gap: float = 0.95e-3
    position_noise: float = 0.2e-3
    angle_noise: float = 4e-3
    discount: float = 0.98
    resample_below: float = 0.5
    motion: AbstractMotionModel = field(default_factory=QuasiStatic)
    force_limit: float | None = None
    threads: int = 1

    def __post_init__(self) -> None:
        _refuse_count("filter.n_particles", self.n_particles, 2)
        _refuse_count("filter.threads", self.threads, 1)
        for name, unit in _POSITIVE.items():
            settle(self, **{name: positive(getattr(self, name), f"filter.{name}", unit)})
        for name, unit in _NOT_NEGATIVE.items():
            settle(self, **{name: non_negative(getattr(self, name), f"filter.{name}", unit)})
        for name, (low, high) in _BETWEEN.items():
            _refuse_outside(f"filter.{name}", getattr(self, name), low, high)
        if not isinstance(self.motion, QuasiStatic | FirstOrder):
            raise InvalidInput(
                "filter.motion",
                found=type(self.motion).__name__,
                expected="QuasiStatic or FirstOrder: particles carry no velocities",
            )
        limit = optional_positive(self.force_limit, "filter.force_limit", "N")
        priors = MappingProxyType(checked_priors(self.priors))
        settle(self, force_limit=limit, priors=priors)

    def start(
        self,
        setup: Scene | Experiment,
        seed: int = 0,
        *,
        pose: ArrayLike | None = None,
        pusher: ArrayLike | None = None,
        time: float | None = None,
    ) -> RunningFilter:
        """Begin to follow an object.

        Parameters
        ----------
        setup : Scene or Experiment
            What is on the plate. Of an experiment, its scene at its first frame is taken.
        seed : int
            Of everything random.
        pose, pusher : (3,) array_like, optional
            Of the object and of the pusher now [m, m, rad]; as in the scene where left out.
        time : float, optional
            Now [s]; 0, or the experiment's first instant, where left out.

        Raises
        ------
        InvalidInput
            No scene, more than one body or pusher, or a prior that changes nothing in it.
        """
        _refuse_count("filter.seed", seed, 0)
        if isinstance(setup, Experiment):
            scene = scene_of(setup)
            time = float(setup.trajectory.time[0]) if time is None else time
            pose = setup.trajectory.at(time) if pose is None else pose
            if pusher is None and setup.pusher is not None:
                pusher = setup.pusher.at(time)
        else:
            instance(setup, Scene, "setup", "a Scene or an Experiment")
            scene = setup
        _refuse_scene(scene)
        return RunningFilter(
            self,
            self._yielding(scene),
            seed,
            0.0 if time is None else float(time),
            vector(scene.bodies[0].pose if pose is None else pose, "pose", POSE),
            vector(scene.pushers[0].pose if pusher is None else pusher, "pusher", POSE),
        )

    def _yielding(self, scene: Scene) -> Scene:
        """The scene with a drive that stalls."""
        pusher, body = scene.pushers[0], scene.bodies[0]
        if pusher.drive.force_limit is not None:
            return scene
        weight = body.mass * scene.gravity
        limit = WEIGHTS_OF_LIMIT * weight if self.force_limit is None else self.force_limit
        drive = replace(pusher.drive, force_limit=limit or None)
        return replace(scene, pushers=(replace(pusher, drive=drive),))


POSE: Final = "x [m], y [m], angle [rad]"

_POSITIVE = {"position_deviation": "m", "angle_deviation": "rad", "touch_gap": "m"}
_NOT_NEGATIVE = {
    "start_position_deviation": "m",
    "start_angle_deviation": "rad",
    "position_noise": "m",
    "angle_noise": "rad",
}
# Open intervals: a fixel that never errs would kill every particle at its first error.
_BETWEEN = {
    "no_contact_reliability": (0.0, 1.0),
    "contact_reliability": (0.0, 1.0),
    "discount": (0.5, 1.0),
    "resample_below": (0.0, 1.0),
}


class Frame(NamedTuple):
    """What is known at one instant."""

    time: float  # [s]
    pusher: ArrayLike  # (3,) measured pose [m, m, rad]
    seen: ArrayLike | None = None  # (3,) pose of the object by the camera; None while hidden
    touches: ArrayLike | None = None  # (n_fixel,) readings 0 or 1; NaN or None for none


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """What the particles say at one instant.

    Attributes
    ----------
    time : float
        [s]
    pose : (3,) float64
        Mean, the angle on the circle and continuous from frame to frame [m, m, rad].
    covariance : (3, 3) float64
        Of the pose.
    names : tuple of str
        Of the parameters.
    mean : (n_name,) float64
    quantiles : (n_name, 3) float64
        At 5, 50 and 95 %.
    touch : (n_fixel,) float64
        Probability that the object touches each fixel [-].
    ess : float
        Effective sample size, before it was resampled [-].
    failed : int
        Particles that could not be simulated over this frame.
    recovered : bool
        Whether the object had been lost, see `RunningFilter`.
    """

    time: float
    pose: FloatArray
    covariance: FloatArray
    names: tuple[str, ...]
    mean: FloatArray
    quantiles: FloatArray
    touch: FloatArray
    ess: float
    failed: int
    recovered: bool


@final
class RunningFilter:
    """A particle filter at work: `step` once a frame.

    A particle whose simulation fails, or ends where no push can have brought it, has no weight. The
    object is *lost* when none has any, or when the nearest of them lies further than six standard
    deviations from what was seen. Then the filter starts again, wider: poses about what is seen
    now, or, while hidden, about where they were, with the spread of the start doubled every time in
    a row; half of the particles keep parameters by the last weights, half draw theirs from the
    prior. Such estimates are marked `recovered`.

    Made by `ParticleFilter.start`.
    """

    def __init__(
        self,
        options: ParticleFilter,
        scene: Scene,
        seed: int,
        time: float,
        pose: FloatArray,
        pusher: FloatArray,
    ) -> None:
        self.options = options
        self.scene = scene
        self.prior: Prior = prior_for(scene, options.priors)
        self._gaps = FixelGaps(scene)
        self._random = np.random.default_rng(seed)
        self._time, self._pusher = time, pusher
        self._losses = 0  # in a row
        self._angle = float(pose[2])
        n = options.n_particles
        self._pose = self._spread(np.tile(pose, (n, 1)), *self._start_spread)
        self._values = self.prior.drawn(n, self._random)
        self._told = np.zeros((n, len(self.prior.names)), np.bool_)
        self._weight: FloatArray = np.full(n, 1.0 / n)
        body = scene.bodies[0]
        self._reach = float(np.hypot(*(body.shape.outline - body.shape.centroid).T).max())
        self._stride = STRIDE * self._reach
        self.estimate = self._estimated(self._touching(), 0, False)
        # Compiled code is loaded now, so that the first frame takes no longer than the others.
        self._simulated(self._pose, pusher, FRAME)

    @property
    def particles(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Copies of poses (n, 3), parameters (n, n_name) and weights (n,)."""
        return self._pose.copy(), self._values.copy(), self._weight.copy()

    def step(self, frame: Frame) -> Estimate:
        """Move all particles to a frame, and weigh them by what was seen and felt there.

        Raises
        ------
        InvalidInput
            A frame that is not after the last one, poses that are not three numbers, or readings
            that are not one a fixel.
        """
        pusher, seen, touches = self._checked(frame)
        options, random = self.options, self._random
        if effective_sample_size(self._weight) < options.resample_below * options.n_particles:
            self._pose = self._pose[self._resample()]
        before = self._pose
        spread = math.sqrt((frame.time - self._time) / FRAME)
        noisy = self._spread(before, options.position_noise * spread, options.angle_noise * spread)
        moved, failed, stalled = self._simulated(noisy, pusher, frame.time - self._time)
        self._pose = np.where(failed[:, None], before, moved)
        self._time, self._pusher = float(frame.time), pusher
        touching = self._touching()
        pushed = np.abs(moved - noisy).max(axis=1) > AT_REST * self._reach
        self._note(np.asarray(pushed & ~failed), np.asarray(touching.any(axis=1)), stalled)
        with np.errstate(divide="ignore"):
            prior = np.where(failed, -np.inf, np.log(self._weight))
        likelihood, near = self._likelihood(seen, touching, touches)
        log_weight = prior + likelihood
        lost = not np.isfinite(log_weight).any() or not near[np.isfinite(log_weight)].any()
        if lost:
            self._start_again(seen, random)
            touching = self._touching()
        else:
            self._losses = 0
            least = LEAST_SHARE * options.n_particles
            self._weight = tempered(prior, likelihood, least)
        self.estimate = self._estimated(touching, int(failed.sum()), lost)
        return self.estimate

    # --- the parts of a step --------------------------------------------------------------------

    def _checked(self, frame: Frame) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
        if not self._time < frame.time < math.inf:
            raise InvalidInput(
                "frame.time", found=frame.time, expected=f"an instant after {self._time:g} s"
            )
        pusher = vector(frame.pusher, "frame.pusher", POSE)
        # The nearest of angles that differ by whole turns: a head does not spin between frames.
        last = self._pusher[2]
        turn = math.remainder(float(pusher[2] - last), 2.0 * math.pi)
        pusher = np.array([pusher[0], pusher[1], last + turn])
        seen = None if frame.seen is None else vector(frame.seen, "frame.seen", POSE)
        if frame.touches is None:
            return pusher, seen, None
        touches = np.asarray(frame.touches, np.float64)
        known = touches[~np.isnan(touches)]
        if touches.shape != (self._gaps.n_fixel,) or not np.isin(known, (0.0, 1.0)).all():
            raise InvalidInput(
                "frame.touches",
                found=frame.touches,
                expected=f"{self._gaps.n_fixel} readings, one a fixel, each 0, 1 or NaN",
            )
        return pusher, seen, touches

    def _note(self, pushed: BoolArray, touching: BoolArray, stalled: BoolArray) -> None:
        """Which parameters each particle's motion has depended on up to now."""
        depends = {
            "mu_pusher": pushed,
            "tripod_radius": pushed,
            "mu_fixel": pushed & touching,
            # Friction of the plane scales all forces and no path, until a drive gives way.
            "mu_support": pushed & stalled,
        }
        for k, name in enumerate(self.prior.names):
            self._told[:, k] |= depends[name]

    def _resample(self) -> Indices:
        """Choose who goes on; new parameters, equal weights. Poses are left to the caller."""
        chosen = systematic(self._weight, self._random)
        values = shrunk(
            self.prior, self._values, self._weight, chosen, self.options.discount, self._random
        )
        # What nothing has depended on yet is as it was before: drawn anew, lest it drifts.
        self._told = self._told[chosen]
        self._values = np.where(self._told, values, self.prior.drawn(len(chosen), self._random))
        self._weight = np.full(len(chosen), 1.0 / len(chosen))
        return chosen

    def _spread(self, pose: FloatArray, position: float, angle: float) -> FloatArray:
        noise = self._random.standard_normal(pose.shape)
        return np.asarray(pose + noise * (position, position, angle))

    def _simulated(
        self, start: FloatArray, pusher: FloatArray, duration: float
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Poses (n, 3) after a frame, which particles have none, and whose drive stalled (n,)."""
        path = np.array([[0.0, *self._pusher], [duration, *pusher]])
        turn = abs(float(pusher[2] - self._pusher[2]))
        way = float(np.hypot(*(pusher - self._pusher)[:2])) + self._reach * turn
        result = simulate_batch(
            self.scene,
            self.prior.columns(self._values) or None,
            start=start,
            waypoints=np.broadcast_to(path, (len(start), 2, 4)),
            motion=self.options.motion,
            stepper=StewartTrinkle(step=duration / max(1, math.ceil(way / self._stride))),
            duration=duration,
            threads=self.options.threads,
        )
        assert isinstance(result, BatchResult)
        pose = result.final[:, 0]
        # A particle that noise has squeezed between head and fixel may be thrown anywhere.
        farthest = FARTHEST * (way + 6.0 * self.options.position_noise) + self._stride
        failed = ~result.converged | ~np.isfinite(pose).all(axis=1)
        with np.errstate(invalid="ignore", over="ignore"):
            failed |= ~(np.hypot(*(pose - start)[:, :2].T) <= farthest)
        return pose, failed, result.stalled[:, 0]

    def _touching(self) -> BoolArray:
        return np.asarray(self._gaps.of(self._pose) < self.options.touch_gap)

    def _likelihood(
        self, seen: FloatArray | None, touching: BoolArray, touches: FloatArray | None
    ) -> tuple[FloatArray, BoolArray]:
        """Its logarithm (n,), and which particles (n,) are not far from what was seen."""
        options, n = self.options, len(self._pose)
        likelihood, near = np.zeros(n), np.ones(n, np.bool_)
        if seen is not None:
            away = squared_distance(
                self._pose, seen, options.position_deviation, options.angle_deviation
            )
            likelihood, near = -0.5 * away, away < LOST**2
        if touches is not None:
            likelihood = likelihood + tactile_log_likelihood(
                touching, touches, options.no_contact_reliability, options.contact_reliability
            )
        return likelihood, near

    @property
    def _start_spread(self) -> tuple[float, float]:
        options = self.options
        return options.start_position_deviation, options.start_angle_deviation

    def _start_again(self, seen: FloatArray | None, random: np.random.Generator) -> None:
        n = len(self._pose)
        chosen = self._resample()
        anew = random.permutation(n)[: n // 2]
        self._values[anew] = self.prior.drawn(len(anew), random)
        self._told[anew] = False
        self._losses += 1
        if seen is None:
            wider = min(2.0**self._losses, MOST_WIDENED)
            position, angle = (wider * spread for spread in self._start_spread)
            self._pose = self._spread(self._pose[chosen], position, angle)
        else:
            options = self.options
            about = np.tile(seen, (n, 1))
            self._pose = self._spread(about, options.position_deviation, options.angle_deviation)

    def _estimated(self, touching: BoolArray, failed: int, recovered: bool) -> Estimate:
        weight = self._weight
        pose = mean_pose(self._pose, weight, self._angle)
        self._angle = float(pose[2])
        return Estimate(
            time=self._time,
            pose=pose,
            covariance=pose_covariance(self._pose, weight, pose),
            names=self.prior.names,
            mean=np.sum(weight[:, None] * self._values, axis=0),
            quantiles=quantiles(self._values, weight, QUANTILES),
            touch=np.sum(weight[:, None] * touching, axis=0),
            ess=effective_sample_size(weight),
            failed=failed,
            recovered=recovered,
        )


def scene_of(experiment: Experiment) -> Scene:
    """The scene of an experiment, or a refusal."""
    if experiment.scene is None:
        reasons = "; ".join(flag.detail for flag in experiment.flags if flag.detail)
        raise InvalidInput(
            f"experiment {experiment.key}",
            found="no scene" + (f": {reasons}" if reasons else ""),
            expected="one whose object, pusher and fixels are known",
            hint="fixel show has its path",
        )
    return experiment.scene


def _refuse_scene(scene: Scene) -> None:
    if len(scene.bodies) != 1 or len(scene.pushers) != 1:
        raise InvalidInput(
            "filter.scene",
            found=f"{len(scene.bodies)} free bodies and {len(scene.pushers)} pushers",
            expected="one free body and one pusher",
        )


def _refuse_count(where: str, value: object, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InvalidInput(where, found=value, expected=f"a whole number of at least {least}")


def _refuse_outside(where: str, value: object, low: float, high: float) -> None:
    number = positive(value, where)
    if not low < number < high:
        raise InvalidInput(where, found=number, expected=f"a number between {low:g} and {high:g}")
