"""A particle filter at work: what one frame does to the particles."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.calibration.target import scene_of
from fixel.errors import InvalidInput
from fixel.filtering import particles as cloud
from fixel.filtering.head_path import smoothed
from fixel.filtering.particle_filter import ParticleFilter, UniformPrior, Unknowns, prior_for
from fixel.filtering.particles import quantiles
from fixel.model import Experiment, Scene
from fixel.model.fields import instance, vector, whole
from fixel.model.scene import check_push
from fixel.model.trajectory import pose_difference
from fixel.simulation.geometry import POSE
from fixel.typing import BoolArray, FloatArray

WEIGHTS_OF_LIMIT: Final = 20.0  # of the object, for a drive that the scene calls rigid
QUANTILES: Final = (0.05, 0.5, 0.95)
# [-] standard deviations; the nearest of all particles further than this from what was seen is no
# chance but a lost object.
LOST: Final = 6.0
# Of all particles, in effective number, that a frame leaves at least: see `resampling.power`.
MIN_SHARE: Final = 0.5
MAX_WIDENED: Final = 8.0  # times the spread at the start
ISLAND: Final = 125  # particles at most that are weighed, resampled and moved among themselves
BLOCK: Final = 40  # frames of the past through which proposals are simulated in one frame
MAX_PATH_FRAMES: Final = 600  # of the pusher's path, smoothed again with every new frame


class FilterFrame(NamedTuple):
    """Measurements of one instant."""

    time: float  # [s]
    pusher: ArrayLike  # (3,) measured pose [m, m, rad]
    seen: ArrayLike | None = None  # (3,) pose of the object by the camera; None while hidden
    touches: ArrayLike | None = None  # (n_fixel,) readings 0 or 1; NaN or None for none


class FilterEstimate(NamedTuple):
    """Estimate of the particles at one instant."""

    time: float  # [s]
    # (3,) Mean, the angle on the circle and continuous from frame to frame [m, m, rad].
    pose: FloatArray
    covariance: FloatArray  # (3, 3) of the pose
    names: tuple[str, ...]  # of the parameters
    mean: FloatArray  # (n_name,)
    quantiles: FloatArray  # (n_name, 3) at 5, 50 and 95 %
    touch: FloatArray  # (n_fixel,) probability that the object touches each fixel [-]
    ess: float  # effective sample size, before it was resampled [-]
    failed: int  # particles that could not be simulated over this frame
    # Squared distance of what the camera saw from what was expected, in standard deviations of both
    # together; 3 on average where all beliefs are right, 0 while hidden [-].
    surprise: float
    recovered: bool  # whether the object had been lost, see `RunningFilter`


class Move(NamedTuple):
    """Proposals for the particles of an island, on their way from the start to now."""

    both: cloud.Particles  # the island's particles, and after them a proposal for each
    frame: int  # at which they are
    prior_ratio: FloatArray  # (n,) see `Unknowns.proposed`


class RunningFilter:
    """A particle filter at work: `step` once a frame.

    Parameters and start pose of a particle never change by themselves: its path follows from them.
    What the model leaves out is a random walk of a size that is unknown too; a Kalman filter in
    each particle follows it. While particles are weighed by every new frame, a proposal for each is
    simulated from the start on, a few frames of the past for every new one; once it has caught up,
    it takes the particle's place by Metropolis' rule. So no value dies out for good.

    Particles form *islands* of at most 125, each a filter of its own. The estimate is the mean over
    them. The proposals of one island are simulated in each frame, in turns. An island that alone
    has lost the object is replaced by particles of the others.

    A particle whose simulation fails, or ends where no push can have brought it, stays where it
    was: it is squeezed between head and fixel. The object is *lost* when all of them fail, or when
    the nearest lies further than six standard deviations from what was seen. Then the filter starts
    again, wider: poses about what is seen now, or, while hidden, about where they were, with the
    spread of the start doubled every time in a row; half of the particles keep parameters by the
    last weights, half draw theirs from the prior. Such estimates are marked `recovered`.

    Made by `ParticleFilter.start`.

    Source: Chopin (2002), A sequential particle filter method for static models; Vergé, Dubarry,
    Del Moral & Moulines (2015), On parallel implementation of sequential Monte Carlo methods: the
    island particle model, for islands.
    """

    _particles: cloud.Particles
    _driven: FloatArray  # (3,) where the particles believe the pusher to be
    _path: FloatArray  # (n_frame, 3) of the pusher, smoothed
    _shake: FloatArray  # see `Mechanics.advance`
    _log_weight: FloatArray
    _reached: FloatArray  # how much of the likelihood is in the weights

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
        self.prior: UniformPrior = prior_for(scene, options.priors)
        self._mechanics = cloud.Mechanics(options, scene)
        self._random = np.random.default_rng(seed)
        n_island = -(-options.n_particles // ISLAND)
        self._islands = np.array_split(np.arange(options.n_particles), n_island)
        self._losses = 0  # in a row
        self._angle = float(pose[2])
        self._start_spread = options.start_position_deviation, options.start_angle_deviation
        self._unknowns = Unknowns(self.prior, pose, np.array(self._start_spread)[[0, 0, 1]])
        free = self._unknowns.drawn(options.n_particles, self._random)
        self._begin(free, time, pusher)
        self.estimate = self._estimated(0.0, 0, False)
        # Compiled code is loaded now, so that the first frame takes no longer than the others.
        sights = [cloud.FrameMeasurement(time), cloud.FrameMeasurement(time + cloud.FRAME)]
        copy = self._particles.take(np.arange(options.n_particles))
        path = np.tile(pusher, (options.n_particles, 2, 1))
        self._mechanics.advance(copy, self._unknowns, sights, path, self._shake)

    @property
    def particles(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Copies of poses (n, 3), parameters (n, n_name) and weights (n,)."""
        particles = self._particles
        return (
            particles.place,
            self._unknowns.values(particles.free),
            cloud.normalised(self._log_weight),
        )

    def draws(self, n: int) -> FloatArray:
        """Draw parameters (n, n_name) of the particles, in proportion to their weights."""
        _, values, weight = self.particles
        place = (np.arange(n) + 0.5) / n
        return np.asarray(
            values[np.minimum(np.searchsorted(np.cumsum(weight), place), len(values) - 1)]
        )

    def step(self, frame: FilterFrame) -> FilterEstimate:
        """Move all particles to a frame, and weigh them by what was seen and felt there.

        Raise `InvalidInput` for a frame that is not after the last one, poses that are not three
        numbers, or readings that are not one per fixel.
        """
        pusher, sight = self._checked(frame)
        self._sights.append(sight)
        self._measured.append(pusher)
        self._smooth()
        particles, unknowns = self._particles, self._unknowns
        path = np.tile((self._driven, self._path[-1]), (len(particles.free), 1, 1))
        self._mechanics.advance(particles, unknowns, self._sights[-2:], path, self._shake)
        self._driven = self._path[-1]
        surprise, near = self._surprise(sight.seen)
        failed = int(particles.failed.sum())
        alive = cloud.normalised(self._log_weight) > 0.0
        adrift = [
            bool(particles.failed[own].all() or not near[own].any())
            for own in (island[alive[island]] for island in self._islands)
        ]
        if all(adrift):
            self._start_again(sight, pusher)
        else:
            self._losses = 0
            self._replace(adrift)
            self._move()
            for island in self._islands:
                self._weigh(island)
        self.estimate = self._estimated(surprise, failed, all(adrift))
        return self.estimate

    # --- the parts of a step --------------------------------------------------------------------

    def _checked(self, frame: FilterFrame) -> tuple[FloatArray, cloud.FrameMeasurement]:
        before = self._sights[-1].time
        if not before < frame.time < math.inf:
            raise InvalidInput(
                "frame.time", found=frame.time, expected=f"a time after {before:g} s"
            )
        pusher = vector(frame.pusher, "frame.pusher", POSE)
        # The nearest of angles that differ by whole turns: a head does not spin between frames.
        last = self._measured[-1][2]
        turn = math.remainder(float(pusher[2] - last), 2.0 * math.pi)
        pusher = np.array([pusher[0], pusher[1], last + turn])
        seen = None if frame.seen is None else vector(frame.seen, "frame.seen", POSE)
        now = len(self._sights)
        sight = cloud.FrameMeasurement(float(frame.time), fold=now % cloud.FOLD == 0)
        if seen is not None:
            sight = sight._replace(seen=seen, seen_at=sight.time, number=1)
        if frame.touches is not None:
            touches = np.asarray(frame.touches, np.float64)
            known = touches[~np.isnan(touches)]
            n_fixel = self._mechanics.gaps.n_fixel
            if touches.shape != (n_fixel,) or not np.isin(known, (0.0, 1.0)).all():
                expected = f"{n_fixel} readings, one per fixel, each 0, 1 or NaN"
                raise InvalidInput("frame.touches", found=frame.touches, expected=expected)
            sight = sight._replace(ones=1.0 * (touches == 1.0), zeros=1.0 * (touches == 0.0))
        return pusher, sight

    def _begin(self, free: FloatArray, time: float, pusher: FloatArray) -> None:
        """Place particles at the start, before anything was measured."""
        self._sights = [cloud.FrameMeasurement(time)]
        self._measured = [pusher]
        self._path = np.array([pusher])
        self._shake = np.zeros(2)
        self._driven = pusher
        self._particles = self._mechanics.begun(self._unknowns, free)
        self._log_weight = np.full(len(free), -math.log(len(free)))
        self._reached = np.zeros(len(free))
        self._moves = [self._proposed(island) for island in self._islands]

    def _smooth(self) -> None:
        """Smooth the latest frames of the path of the pusher; older ones are unchanged."""
        recent = slice(-MAX_PATH_FRAMES, None)
        time = np.array([sight.time for sight in self._sights[recent]])
        path, rate = smoothed(time, np.array(self._measured[recent]))
        self._shake = np.array([0.5 * (rate[0] + rate[1]), rate[2]])
        self._path = np.concatenate((self._path[: len(self._sights) - len(path)], path))

    def _surprise(self, seen: FloatArray | None) -> tuple[float, BoolArray]:
        """Return the surprise of a seen pose, and a mask (n,) of the particles near it."""
        particles, options = self._particles, self.options
        if seen is None:
            return 0.0, np.ones(len(particles.free), np.bool_)
        noise = np.array([options.position_deviation, options.angle_deviation])[[0, 0, 1]] ** 2
        away = pose_difference(seen, particles.expected)
        near = np.sum(away**2 / (noise + particles.doubt[:, [0, 0, 1]]), axis=1) < LOST**2
        weight = cloud.normalised(self._log_weight)
        mean = np.sum(weight[:, None] * away, axis=0)
        about = away - mean
        total = np.einsum("i,ij,ik->jk", weight, about, about)
        total += np.diag(noise + np.sum(weight[:, None] * particles.doubt, axis=0)[[0, 0, 1]])
        return float(mean @ np.linalg.solve(total, mean)), near

    def _weigh(self, island: cloud.Indices) -> float:
        """Weigh the particles of an island, and return the power of their likelihood.

        All islands weigh the same: their likelihoods belong to different versions of the path.
        """
        score, reached = self._particles.score[island], self._reached[island]
        log_weight = self._log_weight[island]
        found = cloud.power(log_weight, score, reached, MIN_SHARE * len(island))
        weight = cloud.normalised(log_weight + found * score - reached)
        with np.errstate(divide="ignore"):
            self._log_weight[island] = np.log(weight / len(self._islands))
        self._reached[island] = found * score
        return found

    def _replace(self, adrift: list[bool]) -> None:
        """Replace the particles of some islands by those of the others."""
        weight = cloud.normalised(self._log_weight)
        for k, island in enumerate(self._islands):
            if adrift[k]:
                weight[island] = 0.0
        for k, island in enumerate(self._islands):
            if adrift[k]:
                chosen = self._random.choice(len(weight), len(island), p=weight / weight.sum())
                self._put(island, chosen)
                self._moves[k] = self._proposed(island)

    def _put(self, island: cloud.Indices, chosen: cloud.Indices) -> None:
        """Make the particles of an island equal copies of chosen ones."""
        self._particles.put(island, self._particles.take(chosen))
        self._reached[island] = self._reached[chosen]
        self._log_weight[island] = -math.log(len(island) * len(self._islands))

    def _proposed(self, island: cloud.Indices) -> Move:
        """Resample an island where its weights ask for it, and return its next move."""
        weight = cloud.normalised(self._log_weight[island])
        if cloud.effective_sample_size(weight) < self.options.resample_below * len(weight):
            self._put(island, island[cloud.systematic(weight, self._random)])
            weight = np.full(len(weight), 1.0 / len(weight))
        own = self._particles.take(island)
        there, prior_ratio = self._unknowns.proposed(
            own.free, weight, own.depends(self.prior.names), self._random
        )
        both = np.concatenate((own.free, there))
        return Move(self._mechanics.begun(self._unknowns, both), 0, prior_ratio)

    def _move(self) -> None:
        """Simulate the proposals of one island, and its particles with them, through the past.

        Through many frames of it: the first step of a simulation costs as much as several more.
        """
        now = len(self._sights) - 1
        turn = now % len(self._islands)
        island, move = self._islands[turn], self._moves[turn]
        end = min(now, move.frame + max(BLOCK, 2 * len(self._islands)))
        self._catch_up(move, end)
        if end < now:
            self._moves[turn] = move._replace(frame=end)
            return
        n, both = len(island), move.both
        # The particles themselves too: the pusher's path is known better now.
        self._particles.put(island, both.take(np.arange(n)))
        found = self._weigh(island)
        ratio = found * (both.score[n:] - both.score[:n]) + move.prior_ratio
        moved = np.log(self._random.random(n)) < ratio  # Metropolis' rule
        self._particles.put(island, both.take(np.arange(n) + np.where(moved, n, 0)))
        self._reached[island] = found * self._particles.score[island]
        self._moves[turn] = self._proposed(island)

    def _catch_up(self, move: Move, end: int) -> None:
        """Simulate an island's move up to a frame."""
        begun, particles = move.frame, move.both
        knots = sorted(
            {begun, end, *range(begun - begun % cloud.GROUP + cloud.GROUP, end, cloud.GROUP)}
        )
        sights = [self._sights[begun]]
        sights += [cloud.gathered(self._sights[a + 1 : b + 1]) for a, b in pairwise(knots)]
        path = np.tile(self._path[knots], (len(particles.free), 1, 1))
        self._mechanics.advance(particles, self._unknowns, sights, path, self._shake, coarse=True)

    def _start_again(self, sight: cloud.FrameMeasurement, pusher: FloatArray) -> None:
        random, options = self._random, self.options
        weight = cloud.normalised(self._log_weight)
        n = len(weight)
        self._losses += 1
        free = self._unknowns.drawn(n, random)
        keep = random.permutation(n)[: n - n // 2]
        names = len(self.prior.names)
        free[keep, :names] = self._particles.free[cloud.systematic(weight, random)[keep], :names]
        if sight.seen is None:
            wider = min(2.0**self._losses, MAX_WIDENED)
            position, angle = (wider * spread for spread in self._start_spread)
            centre = cloud.mean_pose(self._particles.place, weight, self._angle)
        else:
            position, angle = options.position_deviation, options.angle_deviation
            centre = sight.seen
        self._unknowns = Unknowns(self.prior, centre, np.array([position, position, angle]))
        self._begin(free, sight.time, pusher)

    def _whole_weight(self) -> FloatArray:
        """(n,) weights for the pose, in which the likelihood is not coarsened.

        The camera sees the pose itself. Only conclusions from the path to parameters suffer from
        errors that all particles share.
        """
        log_weight = self._log_weight + (1.0 / cloud.COARSE - 1.0) * self._reached
        weight = np.empty(len(log_weight))
        for island in self._islands:
            weight[island] = cloud.normalised(log_weight[island]) / len(self._islands)
        return weight

    def _estimated(self, surprise: float, failed: int, recovered: bool) -> FilterEstimate:
        particles, weight = self._particles, cloud.normalised(self._log_weight)
        values = self._unknowns.values(particles.free)
        whole = self._whole_weight()
        pose = cloud.mean_pose(particles.place, whole, self._angle)
        self._angle = float(pose[2])
        own = np.sum(whole[:, None] * particles.variance, axis=0)[[0, 0, 1]]
        return FilterEstimate(
            time=self._sights[-1].time,
            pose=pose,
            covariance=cloud.pose_covariance(particles.place, whole, pose) + np.diag(own),
            names=self.prior.names,
            mean=np.sum(weight[:, None] * values, axis=0),
            quantiles=quantiles(values, weight, QUANTILES),
            touch=np.sum(whole[:, None] * particles.touch, axis=0),
            ess=cloud.effective_sample_size(weight),
            failed=failed,
            surprise=surprise,
            recovered=recovered,
        )


def start_filter(
    options: ParticleFilter,
    setup: Scene | Experiment,
    seed: int = 0,
    *,
    pose: ArrayLike | None = None,
    pusher: ArrayLike | None = None,
    time: float | None = None,
) -> RunningFilter:
    """Begin to follow the object of a scene, or of an experiment at its first frame.

    Poses (3,) of the object and of the pusher now [m, m, rad] are by default those of the scene,
    and the time now [s] is 0, or the experiment's first instant. Raise `InvalidInput` without a
    scene, for more than one body or pusher, or if the prior changes nothing in it.
    """
    whole(seed, "filter.seed", 0)
    if isinstance(setup, Experiment):
        scene = scene_of(setup)
        time = float(setup.trajectory.time[0]) if time is None else time
        pose = setup.trajectory.at(time) if pose is None else pose
        if pusher is None and setup.pusher is not None:
            pusher = setup.pusher.at(time)
    else:
        instance(setup, Scene, "setup", "a Scene or an Experiment")
        scene = setup
    check_push(scene, "filter.scene")
    return RunningFilter(
        options,
        _yielding(options, scene),
        seed,
        0.0 if time is None else float(time),
        vector(scene.bodies[0].pose if pose is None else pose, "pose", POSE),
        vector(scene.pushers[0].pose if pusher is None else pusher, "pusher", POSE),
    )


def _yielding(options: ParticleFilter, scene: Scene) -> Scene:
    """The scene with a drive that stalls."""
    pusher, body = scene.pushers[0], scene.bodies[0]
    if pusher.drive.force_limit is not None:
        return scene
    weight = body.mass * scene.gravity
    limit = WEIGHTS_OF_LIMIT * weight if options.force_limit is None else options.force_limit
    drive = replace(pusher.drive, force_limit=limit or None)
    return replace(scene, pushers=(replace(pusher, drive=drive),))
