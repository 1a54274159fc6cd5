"""Whether the data determine each unknown, in one word and one sentence.

The first rule that holds decides. An interval is *closed* on a side where the profile crosses the
threshold inside the bounds; its *width* counts up to the bound on a side where it is open. *Narrow*
is a width of at most `NARROW` of the range. Where the model misfits, the interval is that of
`honest`, which allows for it; it is *safe* if it would be narrow at `UNSURE` times the width.

================================================================ =======================
rule                                                             verdict
================================================================ =======================
the simulations never had what the unknown acts on               not excited
nothing could be evaluated                                       not identified
another value explains the data as well, and the interval over   not identified
both is not narrow
a prior was given, and the interval is hardly narrower           not identified
narrow, but the parameter stands for a property of               effective
the object that the model has not got, and the model misfits
closed on both sides, and safe                                   identified
closed and narrow as far as noise goes, but not when misfit is   precise, but the model
allowed for                                                      misfits
safe, but open on one side, and the best is on that bound        at bound
safe, but open on one side, and the best lies inside             at least, or at most
best on a bound, closed on the other side, not flat              at bound
narrow with the others held (slice), and some of them must move  trades off with them
to reach the ends of the interval, which is far wider
anything else: flat, or closed but wide                          not identified
================================================================ =======================
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple, final, get_args

import numpy as np

from fixel.calibration.honest import Honest
from fixel.calibration.noise import Dispersion
from fixel.calibration.profile import Profile, Profiles
from fixel.calibration.side import ON_BOUND
from fixel.errors import InvalidInput
from fixel.model.parameters import info_of
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

# Share of the range that an interval may cover. Random values in the range would be right half of
# the time within half of it: less than that is something learnt.
NARROW: Final = 0.5
# How far an interval that allows for misfit is itself in doubt: it stands on one disagreement of
# two fits, and on few experiments.
UNSURE: Final = 2.0
# A slice is narrow beside a profile that is so many times as wide. Twice is a correlation of 0.87.
CLEARLY_WIDER: Final = 2.0
# A partner of a trade-off: putting it back costs this share of the threshold...
COSTS: Final = 0.5
# ... and this share of what putting back the most needed one costs; three at most are named.
BESIDE_MOST: Final = 0.1
MAX_PARTNERS: Final = 3
# ... and it moved by this share of its scale at least; less is the roughness of the surface.
MOVES: Final = 0.05
# An interval is said to be widened by misfit from so many times on.
SAID: Final = 2.0
# Share of the interval's width by which its ends, interpolated between values, may be off.
SLACK: Final = 0.1
# The interval of the prior alone, over which one that is not shorter than this share was not learnt
# from the data.
LIKE_PRIOR: Final = 0.9

Excited = Callable[[str], bool]
"""Label of an unknown -> whether the simulations had what it acts on: contact, slip."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterVerdict:
    """What is known of one unknown after a calibration.

    Parameters
    ----------
    label, unit : str
        Of the unknown.
    value : float
        At the best point.
    low, high : float or None
        Ends of the interval; None where the data do not bound it inside the bounds.
    level : float
        Confidence of the interval.
    word : str
        One of `WORDS`.
    partners : tuple of str
        Labels of what it trades off with, the most needed first; mostly empty.
    reason : str
        One sentence.
    formal_low, formal_high : float or None
        Ends of the interval that noise alone would give; None where it has none, or where `low` and
        `high` do not allow for misfit.
    """

    label: str
    unit: str
    value: float
    low: float | None
    high: float | None
    level: float
    word: Word
    partners: tuple[str, ...] = ()
    reason: str = ""
    formal_low: float | None = None
    formal_high: float | None = None

    def __str__(self) -> str:
        """The word, with the partners: `"trades off with mu_fixel, mu_pusher"`."""
        return f"{self.word} with {', '.join(self.partners)}" if self.partners else self.word


class _ParameterCase(NamedTuple):
    """One unknown, as the rules see it."""

    unknown: Unknown
    labels: tuple[str, ...]
    profile: Profile
    best: FloatArray
    low: float | None
    high: float | None
    others: tuple[float, ...]  # values outside the interval that are as good
    rough: bool  # whether bumps of the deviance count for more than the noise
    level: float
    centre: float | None = None  # of an interval that allows for misfit
    misfits: bool = False  # by so much that it has to be said

    @property
    def value(self) -> float:
        return float(self.best[self.profile.unknown]) if self.centre is None else self.centre

    @property
    def formal_width(self) -> float:
        return _up_to(self.unknown, self.profile.low, self.profile.high)

    @property
    def precise(self) -> bool:
        """Whether the interval that noise alone would give is closed and narrow."""
        closed = self.profile.low is not None and self.profile.high is not None
        return closed and self.formal_width <= NARROW * self.range

    @property
    def widened(self) -> float:
        """How many times as wide as the formal interval the one that allows for misfit is."""
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
        return self.width * (UNSURE if self.misfits else 1.0) <= NARROW * self.range

    @property
    def bound(self) -> float | None:
        """The bound that the best value lies on."""
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
    excited: Excited | None = None,
    solutions: Sequence[FloatArray] = (),
    dispersion: Dispersion | None = None,
    honest: Honest | None = None,
    misfits: bool = False,
) -> tuple[ParameterVerdict, ...]:
    """A verdict on each free unknown; frozen ones are not judged.

    Parameters
    ----------
    space : ParameterSpace
    profiles : Profiles
        Of its free unknowns, in their order, at the threshold of `level`.
    level : float
        Confidence of the intervals.
    excited : callable, optional
        Label of an unknown -> bool. All are taken to be where left out.
    solutions : sequence of (n,) arrays, optional
        Points known to be nearly as good as the best, as `find_solutions` finds them.
    dispersion : Dispersion, optional
        The one that the prior was weighted with: `Prior.weighted`.
    honest : Honest, optional
        Estimate that allows for misfit, where there is any.
    misfits : bool
        Whether there is so much that it has to be said.
    """
    if not 0.0 < level < 1.0:
        raise InvalidInput("level", found=level, expected="a number between 0 and 1")
    if profiles.profiles and len(profiles.profiles) != len(space.free):
        found = f"profiles of {len(profiles.profiles)} unknowns"
        raise InvalidInput("profiles", found=found, expected=f"one each of {len(space.free)}")
    verdicts = []
    for j, unknown in enumerate(space.free):
        if excited is not None and not excited(unknown.label):
            verdicts.append(_not_excited(unknown, float(profiles.best.point[j]), level))
        elif not profiles.profiles:
            verdicts.append(_not_evaluated(unknown, float(profiles.best.point[j]), level))
        else:
            case = _case(space, profiles, j, level, solutions, honest)._replace(misfits=misfits)
            verdicts.append(_judged(case, _prior_width(unknown, profiles, dispersion)))
    return tuple(verdicts)


def _not_excited(unknown: Unknown, value: float, level: float) -> ParameterVerdict:
    reason = "the simulations never had the contact or slip it acts on, so its value is a guess"
    return _verdict(unknown, value, None, None, level, "not excited", reason)


def _not_evaluated(unknown: Unknown, value: float, level: float) -> ParameterVerdict:
    reason = "the best point could not be evaluated"
    return _verdict(unknown, value, None, None, level, "not identified", reason)


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
    if others:  # the interval about all of them
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
        level=level,
        centre=centre,
    )


def _outside(
    values: Sequence[float], unknown: Unknown, low: float | None, high: float | None
) -> list[float]:
    """Values clearly outside an interval."""
    slack = SLACK * _up_to(unknown, low, high)
    bottom = -math.inf if low is None else low - slack
    top = math.inf if high is None else high + slack
    return [value for value in values if not bottom <= value <= top]


def _prior_width(
    unknown: Unknown, profiles: Profiles, dispersion: Dispersion | None
) -> float | None:
    """Width of the interval that the prior alone would give."""
    if unknown.prior is None:
        return None
    ratio = profiles.limit / (dispersion.value if dispersion else 1.0)
    return 2.0 * unknown.prior * math.sqrt(ratio)


def _judged(case: _ParameterCase, prior_width: float | None) -> ParameterVerdict:
    """The rules of the table, in order."""
    if case.others and not case.narrow:
        values = ", ".join(case.shown(value) for value in case.others[:3])
        reason = f"{values} explains the data as well as {case.shown(case.value)}"
        return _of(case, "not identified", reason)
    if prior_width is not None and case.width >= LIKE_PRIOR * prior_width:
        return _of(
            case, "not identified", "its interval is that of the prior; the data add nothing"
        )
    stands_for = info_of(case.unknown.name).stands_for
    if case.misfits and stands_for and (case.precise or (case.narrow and case.open_sides < 2)):
        return _of(case, "effective", f"it stands for {stands_for}, which the model has not got")
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
        reason = f"noise alone would put it at {ends}; the model's own errors leave more open"
        return _of(case, "precise, but the model misfits", reason)
    partners = _partners(case)
    if partners:
        reason = "it is known only while held together with what it trades off with"
        return _of(case, "trades off", reason, partners)
    return _of(case, "not identified", _why_wide(case))


def _at_bound(case: _ParameterCase) -> str:
    bound = case.unknown.low if case.low is None else case.unknown.high
    if _falls_outwards(case):
        return f"the deviance still falls at the bound {case.shown(bound)}; widen it if it may be"
    return f"the best value is the bound {case.shown(bound)} itself"


def _one_sided(case: _ParameterCase) -> str:
    if case.high is None:
        known, bound = f"at least {case.shown(case.low or 0.0)}", case.unknown.high
    else:
        known, bound = f"at most {case.shown(case.high)}", case.unknown.low
    return f"it is {known}; the data do not tell it from the bound {case.shown(bound)}"


def _falls_outwards(case: _ParameterCase) -> bool:
    """Whether the deviance rises in a line from the bound, rather than from a minimum there."""
    known = np.isfinite(case.profile.deviances)
    values, deviances = case.profile.values[known], case.profile.deviances[known]
    crossing = case.high if case.low is None else case.low
    if crossing is None:
        return False
    # Of a line the first half rises half as much as the whole, of a parabola a quarter.
    places = [case.value, 0.5 * (case.value + crossing), crossing]
    start, half, whole = np.interp(places, values, deviances)
    return bool(half - start > 0.375 * (whole - start))


def _needed(case: _ParameterCase) -> list[int]:
    """Numbers of the unknowns that must move to reach the ends of the interval."""
    rise, moved = case.profile.rise, case.profile.moved
    least = max(COSTS, BESIDE_MOST * float(rise.max(initial=0.0)))
    found = [k for k in range(len(rise)) if rise[k] >= least and moved[k] >= MOVES]
    return sorted(found, key=lambda k: -moved[k])[:MAX_PARTNERS]


def _partners(case: _ParameterCase) -> tuple[str, ...]:
    least = min(case.width / CLEARLY_WIDER, NARROW * case.range)
    if case.slice_width > least:
        return ()
    return tuple(case.labels[k] for k in _needed(case))


def _why_wide(case: _ParameterCase) -> str:
    if case.open_sides == 2:
        return "no value within the bounds fits clearly worse than the best"
    if case.open_sides == 1:
        end = case.low if case.high is None else case.high
        side = "above" if case.high is None else "below"
        return f"the data say no more than that it lies {side} {case.shown(end or 0.0)}"
    return _extent(case)


def _extent(case: _ParameterCase) -> str:
    if case.widened >= SAID:
        wider = f"misfit makes it {case.widened:.2g} times as wide as noise alone would"
        return f"its interval covers {100.0 * case.width / case.range:.2g} % of the range; {wider}"
    share = f"its interval covers {100.0 * case.width / case.range:.2g} % of the range searched"
    widened = "; rough simulations widen it more than the noise does, finer steps would narrow it"
    return share + widened if case.rough else share


def _up_to(unknown: Unknown, low: float | None, high: float | None) -> float:
    """Width of an interval, up to the bound where it is open."""
    return (unknown.high if high is None else high) - (unknown.low if low is None else low)


def _of(
    case: _ParameterCase, word: Word, reason: str, partners: tuple[str, ...] = ()
) -> ParameterVerdict:
    found = _verdict(
        case.unknown, case.value, case.low, case.high, case.level, word, reason, partners
    )
    if case.centre is None:
        return found
    return replace(found, formal_low=case.profile.low, formal_high=case.profile.high)


def _verdict(
    unknown: Unknown,
    value: float,
    low: float | None,
    high: float | None,
    level: float,
    word: Word,
    reason: str,
    partners: tuple[str, ...] = (),
) -> ParameterVerdict:
    return ParameterVerdict(
        label=unknown.label,
        unit=unknown.unit,
        value=value,
        low=low,
        high=high,
        level=level,
        word=word,
        partners=partners,
        reason=reason,
    )
