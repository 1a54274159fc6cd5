"""Prior of the parameters, and the free scale on which particles are moved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import KNOWN_PARAMETERS, Ellipsoid, Parameters, Scene, Tripod
from fixel.model.fields import finite
from fixel.model.parameters import info_of
from fixel.typing import BoolArray, FloatArray

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


@final
@dataclass(frozen=True, slots=True)
class UniformPrior:
    """Independent uniform beliefs about parameters.

    Bounded values are moved on a *free* scale, the logarithm of the distances to the two bounds,
    so that no jitter leaves the bounds. All arrays of values are (n, n_name).

    Attributes
    ----------
    names : tuple of str
    low, high : (n_name,) float64
        Bounds, in the parameters' own units.
    """

    names: tuple[str, ...]
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

    def columns(self, values: FloatArray) -> dict[str, FloatArray]:
        """Values by name, as a batch takes them."""
        return {name: values[:, k] for k, name in enumerate(self.names)}


def checked_priors(
    priors: Mapping[str, tuple[float, float] | None],
) -> dict[str, tuple[float, float] | None]:
    """Ranges by name, each known and possible, or a refusal."""
    found: dict[str, tuple[float, float] | None] = {}
    for name, bounds in priors.items():
        where = f"filter.priors.{name}"
        if name not in DEFAULT_PRIORS:
            info_of(name)  # speaks for names that nothing in fixel knows
            raise InvalidInput(
                where,
                found="a parameter that particles cannot differ in",
                expected="one of " + ", ".join(DEFAULT_PRIORS),
            )
        found[name] = None if bounds is None else _range(where, name, bounds)
    return found


def _range(where: str, name: str, bounds: tuple[float, float]) -> tuple[float, float]:
    unit = KNOWN_PARAMETERS[name].unit
    expected = "two numbers, the lower first"
    if np.shape(bounds) != (2,):
        raise InvalidInput(where, found=bounds, expected=expected)
    low, high = (finite(bound, where, unit if unit != "-" else "") for bound in bounds)
    if low > high:
        raise InvalidInput(where, found=f"{low:g} to {high:g}", expected=expected)
    Parameters({name: low})
    return low, high


def prior_for(scene: Scene, priors: Mapping[str, tuple[float, float] | None]) -> UniformPrior:
    """The beliefs that make sense in a scene.

    Parameters
    ----------
    scene : Scene
    priors : mapping from name to (low, high) or None
        Replace `DEFAULT_PRIORS`; None leaves a parameter at the scene's value. Defaults that
        change nothing in the scene are left out; what is asked for and changes nothing is refused.
    """
    chosen = {**DEFAULT_PRIORS, **priors}
    idle = {name: reason for name, reason in _idle(scene).items() if name in chosen}
    for name in idle:
        if priors.get(name) is not None:
            raise InvalidInput(
                f"filter.priors.{name}",
                found=idle[name],
                expected="a parameter that changes something in the scene",
            )
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


def excited(prior: UniformPrior, low: FloatArray, high: FloatArray) -> list[bool]:
    """Return which parameters a run has informed: their 90 % intervals have become narrower.

    Parameters
    ----------
    prior : UniformPrior
    low, high : (n_name,) float64
        The 5 % and 95 % quantiles afterwards.
    """
    before = 0.9 * (prior.high - prior.low)
    narrow = (high - low) < NARROWED * before
    return [bool(a and not math.isclose(b, 0.0)) for a, b in zip(narrow, before, strict=True)]


def touches_bound(prior: UniformPrior, low: FloatArray, high: FloatArray) -> list[bool]:
    """Return which 90 % intervals end at a bound of the prior.

    Nearer to it than half of what lies outside of the interval of a uniform belief.

    Parameters
    ----------
    prior : UniformPrior
    low, high : (n_name,) float64
        The 5 % and 95 % quantiles.
    """
    near = 0.025 * (prior.high - prior.low)
    return [bool(told) for told in (low - prior.low < near) | (prior.high - high < near)]
