"""A particle filter at work: what one frame does to the particles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.filtering.observation import (
    FixelGaps,
    contact_probability,
    squared_distance,
    tactile_log_likelihood,
)
from fixel.filtering.prior import Prior, prior_for
from fixel.filtering.resampling import (
    Indices,
    effective_sample_size,
    shrunk,
    systematic,
    tempered,
)
from fixel.filtering.statistics import mean_pose, pose_covariance, quantiles
from fixel.model import Scene
from fixel.model.fields import BoolArray, FloatArray, vector
from fixel.simulation import BatchResult, StewartTrinkle, simulate_batch

if TYPE_CHECKING:
    from fixel.filtering.particle_filter import ParticleFilter

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
POSE: Final = "x [m], y [m], angle [rad]"


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

    A particle whose simulation fails, or ends where no push can have brought it, stays where it was
    and keeps its weight: noise has squeezed it between head and fixel, which says nothing of its
    parameters. The object is *lost* when all of them fail, or when the nearest lies further than
    six standard deviations from what was seen. Then the filter starts again, wider: poses about
    what is seen now, or, while hidden, about where they were, with the spread of the start doubled
    every time in a row; half of the particles keep parameters by the last weights, half draw theirs
    from the prior. Such estimates are marked `recovered`.

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
        gap = self._gaps.of(self._pose)
        touching = np.asarray(gap < options.touch_gap)
        pushed = np.abs(moved - noisy).max(axis=1) > AT_REST * self._reach
        self._note(np.asarray(pushed & ~failed), np.asarray(touching.any(axis=1)), stalled)
        with np.errstate(divide="ignore"):
            prior = np.log(self._weight)
        likelihood, near = self._likelihood(seen, gap, touches)
        alive = np.isfinite(prior + likelihood)
        lost = bool(failed[alive].all() or not near[alive].any())
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
        # The engine ends a rollout that throws a body by more than its size. What noise has
        # squeezed between head and fixel may still come out a good way off, unexplained by a push.
        farthest = FARTHEST * (way + 6.0 * self.options.position_noise) + self._stride
        away = np.hypot(*(pose - start)[:, :2].T)
        return pose, ~result.converged | (away > farthest), result.stalled[:, 0]

    def _touching(self) -> BoolArray:
        return np.asarray(self._gaps.of(self._pose) < self.options.touch_gap)

    def _likelihood(
        self, seen: FloatArray | None, gap: FloatArray, touches: FloatArray | None
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
                contact_probability(gap, options.touch_gap),
                touches,
                options.no_contact_reliability,
                options.contact_reliability,
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
