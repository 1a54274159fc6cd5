"""Options of a particle filter that follows a pushed object and learns its friction while it moves.

Every particle is a start pose with a set of parameters and a size of model error of its own. In
each frame of the camera all of them are simulated over the pusher's smoothed motion, in one
compiled batch, and weighed by what was seen and felt. Proposals that are simulated from the start
on keep them apart.

Source: Zhang, Lyu & Trinkle (2013), A dynamic Bayesian approach to real-time estimation and
filtering in grasp acquisition, for estimating pose and parameters together with tactile bits; the
numbers are those of the RPI laboratory's own filter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, final

from fixel.errors import InvalidInput
from fixel.filtering.prior import checked_priors
from fixel.model.fields import (
    Value,
    check_fields,
    inner_share,
    non_negative,
    positive,
    settle,
    whole,
)
from fixel.simulation import AbstractMotionModel, FirstOrder, QuasiStatic


@final
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
        and pusher 0.1 to 1, of fixels 0.2 to 0.5, tripod radius 10 to 100 mm. None leaves a
        parameter at the scene's value.
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
