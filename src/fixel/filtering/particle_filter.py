"""Options of a particle filter, and the priors of its parameters.

The filter follows a pushed object and learns its friction while it moves. Every particle is a start
pose with a set of parameters and a size of model error of its own. In each frame of the camera all
of them are simulated over the smoothed motion of the pusher, in one compiled batch, and weighed by
what was seen and felt. Proposals that are simulated from the start on keep them apart.

Source: Zhang, Lyu & Trinkle (2013), A dynamic Bayesian approach to real-time estimation and
filtering in grasp acquisition, for estimating pose and parameters together with tactile bits; the
numbers are those of the filter of the RPI laboratory.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import KNOWN_PARAMETERS, Ellipsoid, Parameters, Scene, Tripod
from fixel.model.fields import (
    Value,
    check_fields,
    finite,
    inner_share,
    instance,
    non_negative,
    positive,
    settle,
    whole,
)
from fixel.model.parameters import info_of
from fixel.model.shape import length_scale
from fixel.simulation import AbstractMotionModel, FirstOrder, QuasiStatic
from fixel.typing import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticleFilter:
    """Options of a particle filter.

    Not for scenes with several free bodies or pushers, nor for parts that fly or coast: between two
    frames a particle has no velocity.

    Parameters
    ----------
    n_particles : int
        At least 2. Up to 125 are moved in every frame, more of them less often: see
        docs/how-to/filtering.md for what that means for intervals.
    priors : mapping from name to (low, high) or None
        Uniform beliefs about parameters, instead of those of `DEFAULT_PRIORS`: friction of support
        and pusher 0.1 to 1, of fixels 0.2 to 0.5, tripod radius 10 to 100 mm, less for parts below
        16 mm. None leaves a parameter at the scene's value.
    start_position_deviation, start_angle_deviation : float
        Spread of the start pose, in either coordinate [m] and in angle [rad]; as much as the
        camera's own, by which it is mostly known.
    position_deviation, angle_deviation : float
        Of a pose as the camera sees it, in either coordinate [m] and in angle [rad]. The
        laboratory's covariance is diag(0.5, 0.5 mm^2, 0.001 rad^2).
    no_contact_reliability, contact_reliability : float
        P(read 0 | no contact) and P(read 1 | contact) of a fixel [-].
    touch_gap : float
        Below which object and fixel count as touching [m], gradually: see
        `observation.contact_probability`.
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

    n_particles: int = 125
    priors: Mapping[str, tuple[float, float] | None] = field(default_factory=dict)
    start_position_deviation: Annotated[float, Value(non_negative, "m")] = math.sqrt(0.5) * 1e-3
    start_angle_deviation: Annotated[float, Value(non_negative, "rad")] = math.sqrt(1e-3)
    position_deviation: Annotated[float, Value(positive, "m")] = math.sqrt(0.5) * 1e-3
    angle_deviation: Annotated[float, Value(positive, "rad")] = math.sqrt(1e-3)
    # A fixel that never errs would kill every particle at its first error.
    no_contact_reliability: Annotated[float, Value(inner_share)] = 0.9575
    contact_reliability: Annotated[float, Value(inner_share)] = 0.9875
    touch_gap: Annotated[float, Value(positive, "m")] = 0.3e-3
    resample_below: Annotated[float, Value(inner_share)] = 0.6
    motion: AbstractMotionModel = field(default_factory=QuasiStatic)
    force_limit: Annotated[float | None, Value(positive, "N")] = None
    threads: Annotated[int, Value(whole)] = 1

    def __post_init__(self) -> None:
        whole(self.n_particles, "filter.n_particles", 2)
        check_fields(self, "filter")
        if not isinstance(self.motion, QuasiStatic | FirstOrder):
            expected = "QuasiStatic or FirstOrder, since particles have no velocities"
            found = type(self.motion).__name__
            raise InvalidInput("filter.motion", found=found, expected=expected)
        settle(self, priors=MappingProxyType(checked_priors(self.priors)))


def usual_lengths(scene: Scene | None) -> dict[str, float]:
    """Return usual lengths of options for the part of a scene, shorter for a small one."""
    scale = 1.0 if scene is None else length_scale(scene.bodies[0].shape)
    names = "start_position_deviation", "position_deviation", "touch_gap"
    return {name: scale * getattr(ParticleFilter(), name) for name in names}


# Uniform between these, as in the laboratory's own filter [-, -, -, m].
DEFAULT_PRIORS: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "mu_support": (0.1, 1.0),
        "mu_pusher": (0.1, 1.0),
        "mu_fixel": (0.2, 0.5),
        "tripod_radius": (0.010, 0.100),
    }
)

# Of the range, kept from both bounds: on the bound itself the free scale has no number.
MARGIN: Final = 1e-9

# Of the prior's interval; resampling alone, with nothing learnt, narrows it by a tenth or so.
NARROWED: Final = 0.7


N_POSE: Final = 3
TREMBLE: Final = 1e-3  # [-] of a proposal, where two particles are the same
# Model error in one frame of 1/30 s [m], from what no camera sees in a run to what carries the
# object wherever the camera sees it. The least with the probability that the model is right;
# otherwise the logarithm is uniform in between.
MIN_WALK: Final = 3e-6
MAX_WALK: Final = 5e-4
RIGHT: Final = 0.5  # [-]


@dataclass(frozen=True, slots=True)
class UniformPrior:
    """Independent uniform beliefs about parameters.

    Bounded values are moved on a *free* scale, the logarithm of the distances to the two bounds,
    so that no jitter leaves the bounds. All arrays of values are (n, n_name).
    """

    names: tuple[str, ...]
    # (n_name,) Bounds, in the parameters' own units.
    low: FloatArray
    high: FloatArray

    def drawn(self, n: int, random: np.random.Generator) -> FloatArray:
        """`n` sets of values."""
        return np.asarray(self.low + (self.high - self.low) * random.random((n, len(self.names))))

    def free(self, values: FloatArray) -> FloatArray:
        """Values on the free scale; what cannot vary is zero there."""
        share = (values - self.low) / np.where(self.varies, self.high - self.low, 1.0)
        share = np.clip(share, MARGIN, 1.0 - MARGIN)
        return np.where(self.varies, np.log(share) - np.log1p(-share), 0.0)

    def bounded(self, free: FloatArray) -> FloatArray:
        """The inverse of `free`."""
        share = 0.5 * (1.0 + np.tanh(0.5 * free))
        return np.asarray(self.low + (self.high - self.low) * share)

    @property
    def varies(self) -> BoolArray:
        """(n_name,) whether there is anything to learn."""
        return np.asarray(self.high > self.low)

    def excited(self, low: FloatArray, high: FloatArray) -> BoolArray:
        """Return which parameters a run has informed: their intervals have become narrower.

        The interval is from the 5 % quantile `low` to the 95 % quantile `high`, (n_name,) each.
        """
        before = 0.9 * (self.high - self.low)
        return np.asarray((high - low < NARROWED * before) & (before > 0.0))

    def touched(self, low: FloatArray, high: FloatArray) -> BoolArray:
        """Return which intervals `low` to `high` (n_name,) of 90 % end at a bound.

        Nearer to it than half of what lies outside of the interval of a uniform belief.
        """
        near = 0.025 * (self.high - self.low)
        return np.asarray((low - self.low < near) | (self.high - high < near))

    def columns(self, values: FloatArray) -> dict[str, FloatArray]:
        """Values by name, as a batch takes them."""
        return {name: values[:, k] for k, name in enumerate(self.names)}


def checked_priors(
    priors: Mapping[str, tuple[float, float] | None],
) -> dict[str, tuple[float, float] | None]:
    """Ranges by name, each known and possible, or a refusal."""
    instance(priors, Mapping, "filter.priors", "ranges by name of parameter")
    found: dict[str, tuple[float, float] | None] = {}
    for name, bounds in priors.items():
        where = f"filter.priors {name}"
        if name not in DEFAULT_PRIORS:
            info_of(name, where)  # speaks for names that nothing in fixel knows
            raise InvalidInput(
                where,
                found="a parameter that particles cannot have",
                expected="one of " + ", ".join(DEFAULT_PRIORS),
            )
        found[name] = None if bounds is None else _range(where, name, bounds)
    return found


def _range(where: str, name: str, bounds: tuple[float, float]) -> tuple[float, float]:
    unit = KNOWN_PARAMETERS[name].unit
    expected = "two numbers, the lower one first"
    if np.shape(bounds) != (2,):
        raise InvalidInput(where, found=bounds, expected=expected)
    low, high = (finite(bound, where, unit if unit != "-" else "") for bound in bounds)
    if low > high:
        raise InvalidInput(where, found=f"{low:g} to {high:g}", expected=expected)
    Parameters({name: low})
    return low, high


def prior_for(scene: Scene, priors: Mapping[str, tuple[float, float] | None]) -> UniformPrior:
    """Return the beliefs that make sense in a scene.

    Given priors replace `DEFAULT_PRIORS`; None leaves a parameter at the scene's value. Defaults
    that change nothing in the scene are left out; a given prior that changes nothing is refused.
    """
    scale = length_scale(scene.bodies[0].shape)
    low, high = DEFAULT_PRIORS["tripod_radius"]
    chosen = {**DEFAULT_PRIORS, "tripod_radius": (scale * low, scale * high), **priors}
    idle = {name: reason for name, reason in _idle(scene).items() if name in chosen}
    for name in idle:
        if priors.get(name) is not None:
            found, expected = f"a fixed value ({idle[name]})", "a parameter that changes the scene"
            raise InvalidInput(f"filter.priors {name}", found=found, expected=expected)
    kept = {n: bounds for n, bounds in chosen.items() if bounds is not None and n not in idle}
    bounds = np.array([*kept.values()], np.float64).reshape(-1, 2)
    return UniformPrior(tuple(kept), bounds[:, 0].copy(), bounds[:, 1].copy())


def _idle(scene: Scene) -> dict[str, str]:
    """Parameters that change nothing in a scene, and why."""
    supports = [body.support for body in scene.bodies]
    idle = {}
    if any(isinstance(support, Ellipsoid) for support in supports):
        idle["mu_support"] = "an ellipsoidal limit surface, which has no coefficient"
    if not any(isinstance(support, Tripod) for support in supports):
        idle["tripod_radius"] = "no tripod"
    if not scene.fixels:
        idle["mu_fixel"] = "no fixels"
    return idle


class Unknowns(NamedTuple):
    """Parameters, start pose and model error of a particle, and the belief about them.

    One row of numbers on the *free* scale for each particle: the parameters
    (`UniformPrior.free`), the start pose in standard deviations from its centre, and the
    logarithm of the model error, stretched like a parameter.
    """

    prior: UniformPrior
    centre: FloatArray  # (3,) of the start pose [m, m, rad]
    deviation: FloatArray  # (3,) of the start pose [m, m, rad]

    @property
    def size(self) -> int:
        """Number of unknowns of one particle."""
        return len(self.prior.names) + N_POSE + 1

    def drawn(self, n: int, random: np.random.Generator) -> FloatArray:
        """(n, size) draws from the belief."""
        free = np.empty((n, self.size))
        free[:, : -N_POSE - 1] = self.prior.free(self.prior.drawn(n, random))
        free[:, -N_POSE - 1 : -1] = random.standard_normal((n, N_POSE))
        free[:, -1] = random.logistic(size=n)
        return free

    def values(self, free: FloatArray) -> FloatArray:
        """(n, n_name) parameters."""
        return self.prior.bounded(free[:, : -N_POSE - 1])

    def start(self, free: FloatArray) -> FloatArray:
        """(n, 3) start poses [m, m, rad]."""
        first = len(self.prior.names)
        return self.centre + free[:, first:-1] * self.deviation

    def walk(self, free: FloatArray) -> FloatArray:
        """(n,) standard deviations of the model error in one frame [m]."""
        place = 0.5 * (1.0 + np.tanh(0.5 * free[:, -1]))  # uniform from 0 to 1
        share = np.maximum(0.0, place - RIGHT) / (1.0 - RIGHT)
        return np.asarray(MIN_WALK * (MAX_WALK / MIN_WALK) ** share)

    def log_density(self, free: FloatArray) -> FloatArray:
        """(n, size) logarithms of the belief's density on the free scale, up to constants."""
        stretched = np.abs(free)
        found = -stretched - 2.0 * np.log1p(np.exp(-stretched))
        found[:, -N_POSE - 1 : -1] = -0.5 * free[:, -N_POSE - 1 : -1] ** 2
        return np.asarray(found)

    def proposed(
        self, free: FloatArray, weight: FloatArray, depends: FloatArray, random: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return a new place (n, size) for every particle, from a normalised weight (n,).

        It goes along the difference of two others: such steps have the spread of the particles
        themselves. Some of the unknowns stay where they are, and every tenth step is a whole
        difference, which can reach another peak. Parameters are drawn again from the belief where
        no path depends on them (`depends` is the share of the particles whose path does); a quarter
        of the places have one unknown drawn again.

        Return also the logarithm (n,) of the belief's density there over that here, less what the
        draws make up for. Source: ter Braak (2006), A Markov chain Monte Carlo version of the
        genetic algorithm differential evolution.
        """
        n, size = free.shape
        one, other = (random.choice(n, n, p=weight) for _ in range(2))
        moved = random.random((n, size)) < random.choice([0.35, 0.7, 1.0], n)[:, None]
        whole = random.random(n) < 0.1
        scale = np.where(whole, 1.0, 2.38 / np.sqrt(2.0 * np.maximum(moved.sum(axis=1), 1)))
        scale *= random.uniform(0.6, 1.1, n)
        tremble = TREMBLE * random.standard_normal((n, size))
        step = scale[:, None] * (free[one] - free[other]) + tremble
        there = free + np.where(moved, step, 0.0)
        drawn = np.asarray(random.integers(0, size, n))[:, None] == np.arange(size)
        drawn &= random.random((n, 1)) < 0.25
        drawn[:, : len(depends)] |= random.random((n, len(depends))) >= depends
        there = np.where(drawn, self.drawn(n, random), there)
        prior = self.log_density(there) - self.log_density(free)
        return there, np.sum(np.where(drawn, 0.0, prior), axis=1)
