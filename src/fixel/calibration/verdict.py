"""Verdicts: how well the data determine each unknown, in one word and one sentence.

The first rule that applies decides. An interval is *closed* on a side where the profile crosses
the threshold inside the bounds; on an open side its *width* ends at the bound. *Narrow* is a width
of at most `NARROW` of the range. If the model misfits, or the noise is unknown, the interval is
that of `honest`, which allows for misfit; it is *safe* if it would also be narrow at `UNSURE`
times the width.

================================================================ =======================
rule                                                             verdict
================================================================ =======================
the simulations never had what the unknown acts on               not excited
nothing could be evaluated                                       not identified
another value explains the data as well, and the interval over   not identified
both is not narrow
a prior was given, and the interval is hardly narrower           not identified
narrow, but the parameter stands for a property of               effective
the object that the model lacks, and the model may misfit
closed on both sides, and safe                                   identified
safe, but open on one side, and the best is on that bound        at bound
safe, but open on one side, and the best lies inside             at least, or at most
best on a bound, closed on the other side, not flat              at bound
closed and narrow as far as noise goes, but not when misfit is   precise, but the model
allowed for                                                      misfits
narrow with the others fixed (slice), and some of them must move trades off with them
to reach the ends of the interval, which is far wider
anything else: flat, or closed but wide                          not identified
================================================================ =======================
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from fixel.calibration.honest import Honest
from fixel.calibration.noise import Dispersion
from fixel.calibration.profile import Profile, Profiles
from fixel.calibration.profile_branch import ON_BOUND
from fixel.errors import InvalidInput
from fixel.model.fields import inner_share
from fixel.model.parameters import info_of
from fixel.model.records import Estimate
from fixel.model.space import ParameterSpace, Unknown
from fixel.typing import FloatArray

Word = Literal[
    "identified",
    "trades off",
    "not identified",
    "not excited",
    "at bound",
    "effective",
    "precise, but the model misfits",
    "at least",
    "at most",
]

WORDS: Final[tuple[Word, ...]] = get_args(Word)

# Largest share of the range that a narrow interval covers. An interval of half the range contains
# random values half of the time.
NARROW: Final = 0.5
# Uncertainty factor of an interval that allows for misfit, since it depends on one difference of
# two fits, and on few experiments.
UNSURE: Final = 2.0
# Ratio of profile to slice width from which the slice is narrow. Two means a correlation of 0.87.
CLEARLY_WIDER: Final = 2.0
# A partner of a trade-off: resetting it costs this share of the threshold...
COSTS: Final = 0.5
# ... and this share of the cost of the most important partner; at most three are named.
PARTNER_SHARE: Final = 0.1
MAX_PARTNERS: Final = 3
# ... and it moved by at least this share of its scale; less is roughness of the deviance.
MOVES: Final = 0.05
# Widening of an interval by misfit from which it is mentioned.
SAID: Final = 2.0
# Error of the ends of an interval, which are interpolated, as a share of its width.
SLACK: Final = 0.1
# Share of the prior's interval from which an interval counts as that of the prior, not of the
# data.
LIKE_PRIOR: Final = 0.9


class _ParameterCase(NamedTuple):
    """Data of one unknown for the rules."""

    unknown: Unknown
    labels: tuple[str, ...]
    profile: Profile
    best: FloatArray
    low: float | None
    high: float | None
    others: tuple[float, ...]  # values outside the interval that fit as well
    rough: bool  # whether roughness of the deviance exceeds the noise
    centre: float | None = None  # centre of the interval that allows for misfit

    @property
    def value(self) -> float:
        return float(self.best[self.profile.unknown]) if self.centre is None else self.centre

    @property
    def formal_width(self) -> float:
        return _up_to(self.unknown, self.profile.low, self.profile.high)

    @property
    def precise(self) -> bool:
        """Whether the interval for noise alone is closed and narrow."""
        closed = self.profile.low is not None and self.profile.high is not None
        return closed and self.formal_width <= NARROW * self.range

    @property
    def widened(self) -> float:
        """Width of the interval that allows for misfit, over that of the formal interval."""
        if self.centre is None or not self.formal_width > 0.0:
            return 1.0
        return self.width / self.formal_width

    @property
    def range(self) -> float:
        return self.unknown.high - self.unknown.low

    @property
    def open_sides(self) -> int:
        return (self.low is None) + (self.high is None)

    @property
    def width(self) -> float:
        return _up_to(self.unknown, self.low, self.high)

    @property
    def slice_width(self) -> float:
        return _up_to(self.unknown, self.profile.slice.low, self.profile.slice.high)

    @property
    def narrow(self) -> bool:
        return self.width <= NARROW * self.range

    @property
    def safe(self) -> bool:
        return self.width * (1.0 if self.centre is None else UNSURE) <= NARROW * self.range

    @property
    def bound(self) -> float | None:
        """Bound that the best value lies on; None if it lies inside."""
        for bound in (self.unknown.low, self.unknown.high):
            if abs(self.value - bound) <= ON_BOUND * self.range:
                return bound
        return None

    def shown(self, value: float) -> str:
        unit = "" if self.unknown.unit == "-" else f" {self.unknown.unit}"
        return f"{value:.4g}{unit}"


def judge(
    space: ParameterSpace,
    profiles: Profiles,
    *,
    level: float = 0.95,
    excited: Mapping[str, object] = MappingProxyType({}),
    solutions: Sequence[FloatArray] = (),
    dispersion: Dispersion | None = None,
    honest: Honest | None = None,
) -> tuple[Estimate, ...]:
    """Return a verdict for each free unknown; frozen ones have none.

    Profiles are at the threshold of `level`. `excited` has whether the simulations had what an
    unknown acts on, contact or slip; by default all had. `solutions` are points that fit almost as
    well as the best, and `dispersion` is that of the prior (`NormalPrior.weighted`). `honest`
    allows for misfit, if the model misfits or the noise is unknown.
    """
    inner_share(level, "level")
    if profiles.profiles and len(profiles.profiles) != len(space.free):
        found = f"profiles of {len(profiles.profiles)} parameters"
        raise InvalidInput(
            "profiles", found=found, expected=f"one profile for each of {len(space.free)}"
        )
    verdicts = []
    for j, unknown in enumerate(space.free):
        if not excited.get(unknown.label, True):
            reason = (
                "the simulations have no contact or slip that depends on it, so its value is "
                "arbitrary"
            )
            verdicts.append(_without_interval(unknown, profiles, j, "not excited", reason))
        elif not profiles.profiles:
            reason = "the best point could not be evaluated"
            verdicts.append(_without_interval(unknown, profiles, j, "not identified", reason))
        else:
            case = _case(space, profiles, j, level, solutions, honest)
            verdicts.append(_judged(case, _prior_width(unknown, profiles, dispersion)))
    return tuple(verdicts)


def _without_interval(
    unknown: Unknown, profiles: Profiles, j: int, word: Word, reason: str
) -> Estimate:
    value = float(profiles.best.point[j])
    return Estimate(
        label=unknown.label, unit=unknown.unit, value=value, verdict=word, reason=reason
    )


def _case(
    space: ParameterSpace,
    profiles: Profiles,
    j: int,
    level: float,
    solutions: Sequence[FloatArray],
    honest: Honest | None,
) -> _ParameterCase:
    profile = profiles.profiles[j]
    good = profiles.best.error + profiles.limit
    values = [
        *profile.values[profile.deviances <= good].tolist(),
        *(float(s[j]) for s in solutions),
    ]
    low, high, centre = profile.low, profile.high, None
    values = _outside(values, space.free[j], low, high)
    if honest is not None:
        centre = float(honest.value[j])
        bottom, top = (float(ends[j]) for ends in honest.ends(level))
        low = bottom if bottom > space.free[j].low else None
        high = top if top < space.free[j].high else None
        values = _outside(values, space.free[j], low, high)
    others = tuple(sorted(values))
    if others:  # extend the interval to all of them
        low = None if low is None else min(low, others[0])
        high = None if high is None else max(high, others[-1])
    return _ParameterCase(
        unknown=space.free[j],
        labels=space.labels,
        profile=profile,
        best=profiles.best.point,
        low=low,
        high=high,
        others=others,
        rough=honest is None and profiles.roughness > profiles.threshold,
        centre=centre,
    )


def _outside(
    values: Sequence[float], unknown: Unknown, low: float | None, high: float | None
) -> list[float]:
    """Return the values clearly outside an interval."""
    slack = SLACK * _up_to(unknown, low, high)
    bottom = -math.inf if low is None else low - slack
    top = math.inf if high is None else high + slack
    return [value for value in values if not bottom <= value <= top]


def _prior_width(
    unknown: Unknown, profiles: Profiles, dispersion: Dispersion | None
) -> float | None:
    """Return the width of the prior's interval; None without a prior."""
    if unknown.prior is None:
        return None
    ratio = profiles.limit / (dispersion.value if dispersion else 1.0)
    return 2.0 * unknown.prior * math.sqrt(ratio)


def _judged(case: _ParameterCase, prior_width: float | None) -> Estimate:
    """Apply the rules of the table, in order."""
    if case.others and not case.narrow:
        values = ", ".join(case.shown(value) for value in case.others[:3])
        reason = f"{values} explains the data as well as {case.shown(case.value)}"
        return _of(case, "not identified", reason)
    if prior_width is not None and case.width >= LIKE_PRIOR * prior_width:
        return _of(
            case, "not identified", "its interval is that of the prior; the data add no information"
        )
    stands_for = info_of(case.unknown.name).stands_for
    if (
        case.centre is not None
        and stands_for
        and (case.precise or (case.narrow and case.open_sides < 2))
    ):
        return _of(case, "effective", f"it stands for {stands_for}, which the model does not have")
    if case.safe and case.open_sides == 0:
        return _of(case, "identified", _extent(case))
    if case.safe and case.open_sides == 1:
        if case.bound is not None:
            return _of(case, "at bound", _at_bound(case))
        return _of(case, "at least" if case.high is None else "at most", _one_sided(case))
    alone = case.open_sides == 1 and not _needed(case)
    if case.centre is None and case.bound is not None and alone:
        return _of(case, "at bound", _at_bound(case))
    if case.centre is not None and case.precise:
        ends = f"{case.shown(case.profile.low or 0.0)} to {case.shown(case.profile.high or 0.0)}"
        reason = f"noise alone gives {ends}; model error widens the interval"
        return _of(case, "precise, but the model misfits", reason)
    partners = _partners(case)
    if partners:
        reason = "only a combination with the parameters it trades off with is determined"
        return _of(case, "trades off", reason, partners)
    return _of(case, "not identified", _why_wide(case))


def _at_bound(case: _ParameterCase) -> str:
    bound = case.unknown.low if case.low is None else case.unknown.high
    if _falls_outwards(case):
        return (
            f"the deviance still decreases at the bound {case.shown(bound)}; widen the bound "
            "if larger values are possible"
        )
    return f"the best value is the bound {case.shown(bound)}"


def _one_sided(case: _ParameterCase) -> str:
    if case.high is None:
        known, bound = f"at least {case.shown(case.low or 0.0)}", case.unknown.high
    else:
        known, bound = f"at most {case.shown(case.high)}", case.unknown.low
    return f"it is {known}; the data do not distinguish it from the bound {case.shown(bound)}"


def _falls_outwards(case: _ParameterCase) -> bool:
    """Whether the deviance rises linearly from the bound, instead of from a minimum there."""
    known = np.isfinite(case.profile.deviances)
    values, deviances = case.profile.values[known], case.profile.deviances[known]
    crossing = case.high if case.low is None else case.low
    if crossing is None:
        return False
    # Half-way, a line has risen by half of the whole, a parabola by a quarter.
    places = [case.value, 0.5 * (case.value + crossing), crossing]
    start, half, whole = np.interp(places, values, deviances)
    return bool(half - start > 0.375 * (whole - start))


def _needed(case: _ParameterCase) -> list[int]:
    """Return the indices of the unknowns that must move to reach the ends of the interval."""
    rise, moved = case.profile.rise, case.profile.moved
    least = max(COSTS, PARTNER_SHARE * float(rise.max(initial=0.0)))
    found = [k for k in range(len(rise)) if rise[k] >= least and moved[k] >= MOVES]
    return sorted(found, key=lambda k: -moved[k])[:MAX_PARTNERS]


def _partners(case: _ParameterCase) -> tuple[str, ...]:
    least = min(case.width / CLEARLY_WIDER, NARROW * case.range)
    if case.slice_width > least:
        return ()
    return tuple(case.labels[k] for k in _needed(case))


def _why_wide(case: _ParameterCase) -> str:
    if case.open_sides == 2:
        return "all values within the bounds fit about equally well"
    if case.open_sides == 1:
        end = case.low if case.high is None else case.high
        side = "above" if case.high is None else "below"
        return f"the data determine only that it lies {side} {case.shown(end or 0.0)}"
    return _extent(case)


def _extent(case: _ParameterCase) -> str:
    if case.widened >= SAID:
        wider = f"misfit makes it {case.widened:.2g} times wider than noise alone"
        return f"its interval covers {100.0 * case.width / case.range:.2g} % of the range; {wider}"
    share = f"its interval covers {100.0 * case.width / case.range:.2g} % of the range searched"
    widened = "; numerical errors widen it more than noise; smaller steps would narrow it"
    return share + widened if case.rough else share


def _up_to(unknown: Unknown, low: float | None, high: float | None) -> float:
    """Return the width of an interval, up to the bound on an open side."""
    return (unknown.high if high is None else high) - (unknown.low if low is None else low)


def _of(case: _ParameterCase, word: Word, reason: str, partners: tuple[str, ...] = ()) -> Estimate:
    return Estimate(
        label=case.unknown.label,
        unit=case.unknown.unit,
        value=case.value,
        low=case.low,
        high=case.high,
        verdict=f"{word} with {', '.join(partners)}" if partners else word,
        reason=reason,
    )
