"""Particles that live through the frames of a run: simulated, corrected and scored together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.filtering.particle_filter import ParticleFilter, Unknowns
from fixel.kernels.gap import measure_gaps
from fixel.model import Scene, wrapped
from fixel.model.shape import length_scale
from fixel.model.trajectory import pose_difference
from fixel.simulation import Newton, StewartTrinkle
from fixel.simulation.batch import simulate_packed
from fixel.simulation.geometry import pack_shapes
from fixel.simulation.pack import Template
from fixel.simulation.simulate import method_of
from fixel.simulation.vary import Variation
from fixel.typing import BoolArray, FloatArray

FRAME: Final = 1.0 / 30.0  # [s] for which model error is given
GROUP: Final = 4  # frames of the past that are simulated in one step
FOLD: Final = 8  # frames: where a block ends at one, the correction goes into the simulated pose
STRIDE: Final = 0.01  # of the object's size: how far the pusher goes in one step of a simulation
LEVER: Final = 0.05  # [m]: a radian of model error counts as this way
AT_REST: Final = 1e-9  # of the object's size: motion below is rounding
SIDES: Final = [0, 0, 1]  # which variance is that of x, y and the angle
MOST_CONTACTS: Final = 24  # in one rollout
FARTHEST: Final = 5.0  # times the pusher's way: an object that goes further was not pushed there
CLEAR: Final = 1e-3  # probability from which a contact is clear
FAR_GAP: Final = 5e-3  # [m] gaps beyond it are bounded, not measured


class FrameMeasurement(NamedTuple):
    """Measurements of one frame, or of a few of them together, without the pusher."""

    time: float  # [s] of the last frame
    seen: FloatArray | None = None  # (3,) mean pose of the object
    seen_at: float = 0.0  # [s] mean time of the frames in which it was seen
    number: int = 0  # of these frames
    ones: FloatArray | None = None  # (n_fixel,) how often each fixel has read 1
    zeros: FloatArray | None = None  # (n_fixel,) how often 0
    fold: bool = False  # whether the camera's correction goes into the simulated pose now


def gathered(sights: Sequence[FrameMeasurement]) -> FrameMeasurement:
    """Return sights in a row as one."""
    seen = [(sight.seen, sight.seen_at) for sight in sights if sight.seen is not None]
    felt = [(s.ones, s.zeros) for s in sights if s.ones is not None and s.zeros is not None]
    last = FrameMeasurement(sights[-1].time, fold=sights[-1].fold)
    if seen:
        pose = np.array([pose for pose, _ in seen])
        pose[:, 2] = pose[0, 2] + wrapped(pose[:, 2] - pose[0, 2])
        moment = sum(time for _, time in seen) / len(seen)
        last = last._replace(seen=pose.mean(axis=0), seen_at=moment, number=len(seen))
    if felt:
        ones, zeros = (np.sum(part, axis=0) for part in zip(*felt, strict=True))
        last = last._replace(ones=ones, zeros=zeros)
    return last


@dataclass(slots=True)
class Particles:
    """Particles at one instant. Arrays have one row for each particle."""

    free: FloatArray  # (n, size) unknowns, see `Unknowns`
    pose: FloatArray  # (n, 3) as simulated [m, m, rad]
    shift: FloatArray  # (n, 3) what the camera has added to it since it last went into it
    # (n, 2) Of the pose, coordinates and angle, for the model's own error [m^2, rad^2].
    variance: FloatArray
    score: FloatArray  # (n,) logarithm of the likelihood of all that was measured
    touch: FloatArray  # (n, n_fixel) probability that the object touches each fixel [-]
    # (n, 3), (n, 2) Pose before the last sight corrected it, and its variance.
    expected: FloatArray
    doubt: FloatArray
    failed: BoolArray  # (n,) which could not be simulated last
    # (n,) Whether the pusher has moved the object, the drive has given way, and a fixel was
    # touched.
    pushed: BoolArray
    stalled: BoolArray
    touched: BoolArray

    @property
    def place(self) -> FloatArray:
        """(n, 3) poses, as corrected by the camera [m, m, rad]."""
        return self.pose + self.shift

    def depends(self, names: Sequence[str]) -> FloatArray:
        """(n_name,) share of the particles whose path has depended on each parameter [-]."""
        # Friction of the plane scales all forces and no path, until a drive gives way.
        on = {"mu_support": self.pushed & self.stalled, "mu_fixel": self.pushed & self.touched}
        return np.array([np.mean(on.get(name, self.pushed)) for name in names])

    def take(self, which: np.ndarray) -> Particles:
        """Return a copy of some particles."""
        return Particles(*(np.array(getattr(self, name)[which]) for name in Particles.__slots__))

    def put(self, which: np.ndarray, other: Particles) -> None:
        """Replace some particles by others."""
        for name in Particles.__slots__:
            column = getattr(self, name).copy()  # two columns may be the same array
            column[which] = getattr(other, name)
            setattr(self, name, column)


class Mechanics:
    """Mechanics that move particles through frames of a scene with a drive that stalls."""

    def __init__(self, options: ParticleFilter, scene: Scene) -> None:
        self.options, self.scene = options, scene
        self.gaps = FixelGaps(scene)
        body = scene.bodies[0]
        self._reach = float(np.hypot(*(body.shape.outline - body.shape.centroid).T).max())
        self._stride = STRIDE * self._reach
        self._scale = length_scale(body.shape)
        motion, stepper = options.motion, StewartTrinkle(step=FRAME)
        self._method = method_of(motion, stepper, Newton(), MOST_CONTACTS)
        self._template = Template(scene, motion, stepper)

    def begun(self, unknowns: Unknowns, free: FloatArray) -> Particles:
        """Return particles at the start."""
        n = len(free)
        particles = Particles(
            free=free,
            pose=unknowns.start(free),
            shift=np.zeros((n, 3)),
            variance=np.zeros((n, 2)),
            score=np.zeros(n),
            touch=np.zeros((n, self.gaps.n_fixel)),
            expected=unknowns.start(free),
            doubt=np.zeros((n, 2)),
            failed=np.zeros(n, np.bool_),
            pushed=np.zeros(n, np.bool_),
            stalled=np.zeros(n, np.bool_),
            touched=np.zeros(n, np.bool_),
        )
        particles.touch, _ = self._contact(particles)
        return particles

    def advance(
        self,
        particles: Particles,
        unknowns: Unknowns,
        sights: Sequence[FrameMeasurement],
        path: FloatArray,
        shake: FloatArray,
        coarse: bool = False,
    ) -> None:
        """Move particles through frames, in place.

        The first measurement and the first pose of the pusher's path (n, n_sight, 3) are at the
        frame of the particles, the others at those to come. `shake` (2,) is the variance by which
        the error of that path changes in a second [m^2/s, rad^2/s]. Steps may be as long as a group
        of frames if `coarse`.
        """
        time = np.array([sight.time for sight in sights])
        poses, particles.failed, stalled = self._simulated(
            particles.pose, unknowns.prior.columns(unknowns.values(particles.free)), path, coarse
        )
        walk = unknowns.walk(particles.free)
        before = particles.pose
        moved = np.abs(poses[:, -1] - before).max(axis=1) > AT_REST * self._reach
        particles.pushed, particles.stalled = particles.pushed | moved, particles.stalled | stalled
        for k, sight in enumerate(sights[1:], 1):
            particles.pose = poses[:, k - 1]
            back = 0.0
            if sight.seen is not None:
                back = (sight.time - sight.seen_at) / (time[k] - time[k - 1])
            behind = back * (particles.pose - before)
            before = particles.pose
            model = np.column_stack((self._scale * walk, walk / LEVER)) ** 2 / FRAME
            pusher = np.where(particles.pushed[:, None], shake, 0.0)
            particles.variance = particles.variance + (time[k] - time[k - 1]) * (model + pusher)
            self._weigh(particles, sight, behind)
        # Not in between: the poses after it are simulated already, without the correction.
        if sights[-1].fold:
            particles.pose, particles.shift = particles.place, np.zeros_like(particles.shift)

    def _simulated(
        self, start: FloatArray, values: dict[str, FloatArray], path: FloatArray, coarse: bool
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Poses (n, n_frame, 3) at all but the first instant, which have no simulation, and whose
        drive has given way."""
        options = self.options
        move = np.diff(path, axis=1)
        way = np.hypot(move[:, :, 0], move[:, :, 1]) + self._reach * np.abs(move[:, :, 2])
        stride = self._stride * (GROUP if coarse else 1)
        # Pushing does not depend on its speed: a step takes a frame, however long the way is.
        steps = np.maximum(1.0, np.ceil(np.median(way, axis=0) / stride))
        clock = FRAME * np.cumsum(np.concatenate(([0.0], steps)))
        times = np.broadcast_to(clock[:, None], (*path.shape[:2], 1))
        variation = Variation(values, start[:, None], np.concatenate((times, path), axis=2))
        packed = self._template.packed(variation, len(start), float(clock[-1]))
        result = simulate_packed(self.scene, packed, self._method, clock[1:], options.threads)
        pose = result.pose[:, :, 0]
        # The engine ends a rollout that throws a body by more than its size. What was squeezed
        # between head and fixel may still come out a good way off, unexplained by a push.
        away = np.hypot(
            *np.moveaxis(np.diff(pose[:, :, :2], axis=1, prepend=start[:, None, :2]), 2, 0)
        )
        thrown = (away > FARTHEST * way + self._stride).any(axis=1)
        thrown |= ~np.isfinite(pose).all(axis=(1, 2))
        failed = np.asarray(~result.converged | thrown)
        pose = np.where(thrown[:, None, None], start[:, None], pose)
        return pose, failed, result.stalled[:, 0]

    def _weigh(self, particles: Particles, sight: FrameMeasurement, behind: FloatArray) -> None:
        """Weigh by a sight that lies `behind` the poses (n, 3) on their way."""
        options = self.options
        particles.expected, particles.doubt = particles.place, particles.variance
        if sight.seen is not None:
            noise = np.array([options.position_deviation, options.angle_deviation]) ** 2
            noise = noise / sight.number
            away = sight.seen - particles.place + behind
            away[:, 2] = wrapped(away[:, 2])
            total = particles.variance + noise
            gain = particles.variance / total
            square = away**2 / total[:, SIDES]
            particles.score -= 0.5 * np.sum(square + np.log(total / noise)[:, SIDES], axis=1)
            particles.shift = particles.shift + gain[:, SIDES] * away
            particles.variance = particles.variance * (1.0 - gain)
        contact, memory = self._contact(particles)
        particles.touch = lasting(contact, particles.touch, memory)
        particles.touched = particles.touched | (contact > CLEAR).any(axis=1)
        if sight.ones is not None and sight.zeros is not None:
            likelihood, particles.touch = reading_likelihood(
                particles.touch,
                sight.ones,
                sight.zeros,
                options.no_contact_reliability,
                options.contact_reliability,
            )
            particles.score += likelihood

    def _contact(self, particles: Particles) -> tuple[FloatArray, FloatArray]:
        """Probabilities of contact by the gaps, and how much of the old ones still holds."""
        gap, variance = self.gaps.of(particles.place), particles.variance[:, :1]
        contact = contact_probability(gap, self.options.touch_gap, np.sqrt(variance))
        return contact, variance / (variance + (0.25 * self.options.touch_gap) ** 2)


def contact_probability(gap: FloatArray, touch_gap: float, spread: FloatArray) -> FloatArray:
    """Return the probability that shapes touch, from the gaps (n, n_fixel) between them [m].

    A half at half of `touch_gap` [m]; how far on both sides it is in between is given by
    `touch_gap` and by `spread` (n, 1), the standard deviation of the gap itself [m].
    """
    width = np.sqrt((0.25 * touch_gap) ** 2 + spread**2)
    # The logistic function is the normal distribution's within 0.01 on this scale.
    return np.asarray(0.5 * (1.0 + np.tanh(0.851 * (0.5 * touch_gap - gap) / width)))


def lasting(contact: FloatArray, before: FloatArray, memory: FloatArray) -> FloatArray:
    """Return probabilities of contact (n, n_fixel) that remember those of the frame before.

    Where the pose is uncertain, it is as uncertain in the next frame, in the same direction: sixty
    frames at an unclear gap are one unknown, not sixty. Contacts that are clear remember nothing:
    `memory` (n, 1) is the share of the old probability that remains, which is that after its
    readings.
    """
    unclear = (contact > CLEAR) & (contact < 1.0 - CLEAR)
    return np.asarray(np.where(unclear, contact + memory * (before - contact), contact))


def reading_likelihood(
    contact: FloatArray, ones: FloatArray, zeros: FloatArray, silent: float, heard: float
) -> tuple[FloatArray, FloatArray]:
    """Return the log likelihood (n,) of readings, and probabilities of contact after them.

    These follow from Bayes' rule. Probabilities of contact before the readings are (n, n_fixel).
    Each fixel has read `ones` and `zeros` (n_fixel,) times; `silent` is P(read 0 | no contact), and
    `heard` P(read 1 | contact).
    """
    likely = contact * (heard**ones * (1.0 - heard) ** zeros)
    other = (1.0 - contact) * (silent**zeros * (1.0 - silent) ** ones)
    both = likely + other
    return np.asarray(np.sum(np.log(both), axis=1)), np.asarray(likely / both)


class FixelGaps:
    """Distances from the one free body of a scene to every fixel, for many poses at a time."""

    def __init__(self, scene: Scene) -> None:
        pieces = [scene.bodies[0].shape, *(f.shape for f in scene.fixels)]
        self._size, self._shapes = pack_shapes(pieces).scaled()
        self._fixel = np.array([f.pose for f in scene.fixels]).reshape(-1, 3)
        reach = np.array([np.hypot(*shape.outline.T).max() for shape in pieces])
        self._reach = reach[0] + reach[1:]

    @property
    def n_fixel(self) -> int:
        """Number of fixels."""
        return len(self._fixel)

    def of(self, pose: FloatArray) -> FloatArray:
        """(n, n_fixel) gaps [m] at poses (n, 3); negative in overlap, lower bounds from 5 mm on."""
        away = pose[:, None, :2] - self._fixel[:, :2]
        gap = np.asarray(np.hypot(away[:, :, 0], away[:, :, 1]) - self._reach)
        row, fixel = np.nonzero(gap < FAR_GAP)
        if len(row) == 0:
            return gap
        first = np.column_stack((away[row, fixel] / self._size, pose[row, 2]))
        second = np.zeros_like(first)
        second[:, 2] = self._fixel[fixel, 2]
        found = measure_gaps(*self._shapes, np.zeros_like(fixel), 1 + fixel, first, second)
        gap[row, fixel] = self._size * found[:, 0]
        return gap


# Power of the likelihood for parameters, where all is well: below 1, because all particles share
# errors that no one of them can explain, the pusher's smoothed path above all. Chosen on 17
# simulated pushes.
# Source: Miller & Dunson (2019), Robust Bayesian inference via coarsening.
COARSE = 0.6
# Tried from the largest on; each is a tenth less than the one before.
POWERS = tuple(COARSE * 0.9**k for k in range(60))

Indices = NDArray[np.int64]


def normalised(log_weight: FloatArray) -> FloatArray:
    """(n,) weights that sum to 1, from logarithms of which one at least is finite."""
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def effective_sample_size(weight: FloatArray) -> float:
    """Return the number of equal weights that would estimate as well, 1 to n [-].

    Source: Kong, Liu & Wong (1994), Sequential imputations and Bayesian missing data problems.
    """
    return float(1.0 / np.sum(weight * weight))


def power(log_weight: FloatArray, score: FloatArray, reached: FloatArray, least: float) -> float:
    """Return the largest power of the likelihood that leaves `least` particles alive.

    At most `COARSE`. Where that would leave fewer, for instance when a fixel is touched at last,
    the likelihood counts with a lower power until moves have spread the particles again. `score`
    (n,) is the logarithm of the likelihood of all measurements, and `reached` (n,) how much of it
    is in the weights already.
    """
    best, most = COARSE, 0.0
    for trial in POWERS:
        alive = effective_sample_size(normalised(log_weight + trial * score - reached))
        if alive >= least:
            return trial
        if alive > most:
            best, most = trial, alive
    return best


def systematic(weight: FloatArray, random: np.random.Generator) -> Indices:
    """Numbers of the particles that go on, (n,) int64, increasing.

    One uniform number places n equal strides over the weights; a particle of weight w goes on
    n w times on average, and at most one time more or less than that.

    Source: Kitagawa (1996), Monte Carlo filter and smoother.
    """
    n = len(weight)
    edges = np.cumsum(weight)
    place = (np.arange(n) + random.random()) * (edges[-1] / n)
    # The last stride may round to the end of all weights; a weight of zero must not be met there.
    last = int(np.flatnonzero(weight)[-1])
    return np.asarray(np.minimum(np.searchsorted(edges, place, side="right"), last))


def mean_pose(pose: FloatArray, weight: FloatArray, near: float) -> FloatArray:
    """Return the mean (3,) of poses (n, 3), the angle on the circle, with weights (n,) of sum 1.

    Of the angles that differ by whole turns, it is the one within half a turn of `near` [rad].
    """
    x, y = np.sum(weight[:, None] * pose[:, :2], axis=0)
    turn = pose[:, 2] - near
    angle = math.atan2(float(np.sum(weight * np.sin(turn))), float(np.sum(weight * np.cos(turn))))
    return np.array([x, y, near + angle])


def pose_covariance(pose: FloatArray, weight: FloatArray, mean: FloatArray) -> FloatArray:
    """(3, 3) covariance about a mean [m, m, rad], angles the short way."""
    away = pose_difference(pose, mean)
    return np.asarray(np.einsum("i,ij,ik->jk", weight, away, away))


def quantiles(values: FloatArray, weight: FloatArray, levels: ArrayLike) -> FloatArray:
    """(n_name, n_level) quantiles of weighted values (n, n_name), linear between their middles."""
    wanted = np.asarray(levels, np.float64)
    alive = weight > 0.0
    values, weight = values[alive], weight[alive]
    found = np.empty((values.shape[1], len(wanted)))
    for k, column in enumerate(values.T):
        order = np.argsort(column, kind="stable")
        share = np.cumsum(weight[order]) - 0.5 * weight[order]
        found[k] = np.interp(wanted, share, column[order])
    return found
