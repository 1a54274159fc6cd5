"""Live estimates: parameters so far, the experiment to perform next, and when to stop."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, NamedTuple, Self

import numpy as np
from scipy.special import ndtri, stdtrit

from fixel.calibration import assess
from fixel.calibration.honest import (
    INSTANTS,
    MAX_SCALES,
    MIN_FREEDOM,
    SHIFTS,
    SPAN,
    Probes,
    ShiftModel,
    condition_of,
    linear_data,
    probe_rollouts,
)
from fixel.calibration.mixed import Linear, fit_mixed, mixed_at, numbered
from fixel.calibration.objective import Comparer
from fixel.calibration.optimiser import Best
from fixel.calibration.profile import Profile, Profiles
from fixel.calibration.profile_branch import Slice
from fixel.calibration.search import with_assessment
from fixel.calibration.study import run_study
from fixel.calibration.target import Target
from fixel.calibration.usual_parameters import Space, searched_unknowns
from fixel.calibration.verdict import judge
from fixel.errors import InvalidInput, check_name, unknown_name
from fixel.model import Experiment, PlannedExperiment
from fixel.model.parameters import info_of
from fixel.model.space import ParameterSpace, check_once, split_label
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.simulation.rollouts import RolloutCase
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.units import deg, displayed, mm, mrad, um
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.run import calibrate

STARTS: Final = 3  # of a search: the previous estimates may lie in a wrong valley
AHEAD: Final = 5  # rows after which the intervals are predicted
MOST: Final = 48  # candidates of one choice; of more, others are compared each time
LITTLE: Final = 0.05  # share by which all candidates together must narrow an interval
USUAL: Final = 0.05  # half-width that is wanted if none is stated [ranges]
UNITS: Final = {"m": {"m": 1.0, "mm": mm, "um": um}, "rad": {"rad": 1.0, "deg": deg, "mrad": mrad}}


class _Scatter(NamedTuple):
    """Scatter of experiments about the model."""

    fit: assess.BestFit
    names: tuple[str, ...]  # shifts that each experiment has of its own
    log_sd: FloatArray | None = None  # of `fit_mixed`; None if the model fits within the noise

    def linear(self, shifted: ShiftModel, members: Sequence[int]) -> Linear:
        """Return experiments that are linearised about the best point."""
        unit = np.array([SHIFTS[name][1] for name in self.names])
        own = np.zeros((len(members), len(unit)))
        probes = [Probes(shifted, m, self.names, self.fit.point, own[0]) for m in members]
        parts = run_study(probe_rollouts(probes), shifted.differences)
        return linear_data(shifted, probes, parts, own, unit, self.fit.noise)

    def information(self, data: Linear, frames: FloatArray) -> FloatArray:
        """Return the information (n, p, p) of experiments with (n,) frames."""
        if self.log_sd is not None:
            certain = np.eye(data.common.shape[3])  # invertible, whatever the experiments inform
            return mixed_at(data._replace(precision=certain), self.log_sd).information
        return (frames / INSTANTS / self.fit.dispersion.value)[:, None, None] * _squares(data)

    def reach(self, information: FloatArray, weak: FloatArray, level: float) -> FloatArray:
        """Return half-widths (p,) of intervals, per scale, up to a factor common to all."""
        covariance = np.linalg.inv(information.sum(axis=0) + weak)
        tail, sd = 0.5 * (1.0 + level), np.sqrt(np.diag(covariance))
        if self.log_sd is None:
            return np.asarray(ndtri(tail) * sd)
        own = np.einsum("ij,njk,ki->ni", covariance, information, covariance)
        effective = own.sum(axis=0) ** 2 / np.maximum((own**2).sum(axis=0), 1e-300)
        return np.asarray(stdtrit(np.maximum(effective - 1.0, MIN_FREEDOM), tail) * sd)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LiveEstimates:
    """Parameters after the experiments so far."""

    # Calibration with estimates and verdicts. Its intervals allow for misfit; if the model fits
    # within the noise, they are those of a parabola instead of profiles.
    calibration: Calibration
    # Half-widths of the intervals of free parameters by label, without their bounds. They are as
    # wide as the range, or wider, where no experiment informs a parameter.
    half_widths: Mapping[str, float]
    # The larger of the half-widths now and in the previous estimates; inf without these. Widths
    # vary by chance, and a campaign that stopped at the first narrow one would trust it too much.
    settled: Mapping[str, float]
    # Error of each experiment by key, as predicted from the others [m], angles at 35 mm/rad. The
    # fit to the others is approximated by linearisation.
    held_out: Mapping[str, float]
    level: float  # confidence level of the intervals
    information: FloatArray  # (n, p, p) of each experiment, per scale of the parameters
    scatter: _Scatter  # about the model, which further experiments will have, too

    @property
    def held_out_error(self) -> float | None:
        """Root mean square of the held-out errors [m], or None for one experiment."""
        squares = np.square(list(self.held_out.values()))
        return math.sqrt(float(np.mean(squares))) if len(squares) > 1 else None

    def ahead(self, candidates: Sequence[PlannedExperiment], n: int = 1) -> dict[str, float]:
        """Return the half-widths that are expected after the first n candidates, by label."""
        return self.expected(self.informed_by(candidates[:n]))

    def expected(self, more: FloatArray) -> dict[str, float]:
        """Return the half-widths that are expected with more information (m, p, p), by label."""
        weak, now = _weak(self.calibration.space), self.information
        ratio = self.scatter.reach(np.concatenate((now, more)), weak, self.level)
        ratio /= self.scatter.reach(now, weak, self.level)
        pairs = zip(self.half_widths.items(), ratio.tolist(), strict=True)
        return {label: half * own for (label, half), own in pairs}

    def informed_by(self, candidates: Sequence[PlannedExperiment]) -> FloatArray:
        """Return the information (m, p, p) that candidates are expected to have.

        It is zero if a simulation fails. If the model misfits, a repetition has none either: it
        repeats the error of the model.
        """
        space, done = self.calibration.space, self.calibration.targets
        if not candidates:
            return np.zeros((0, len(space.free), len(space.free)))
        targets = [_target_of(own) for own in candidates]
        which = np.arange(len(done), len(done) + len(targets))
        comparer = Comparer([*done, *targets], space, motion=self.calibration.motion)
        point = np.repeat(self.scatter.fit.point[None], len(which), axis=0)
        moved, _, _ = comparer.differences(which, point)
        # Compared with the expected motion, no angle is near half a turn.
        there = [t._replace(pose=t.pose + way[:INSTANTS])
                 for t, way in zip(targets, moved, strict=True)]  # fmt: skip
        comparer = Comparer([*done, *there], space, motion=self.calibration.motion)
        data = self.scatter.linear(ShiftModel(comparer), which.tolist())
        frames = np.full(len(targets), np.mean([len(own.pose) for own in done]))
        found = self.scatter.information(data, frames)
        if self.scatter.log_sd is not None:
            seen = [condition_of(own) for own in (*done, *targets)]
            found[[seen[k] in seen[:k] for k in which.tolist()]] = 0.0
        return found


def estimate(
    experiments: Iterable[Experiment | Target],
    space: Space = None,
    *,
    motion: str | AbstractMotionModel = "dynamic",
    level: float = 0.95,
    previous: LiveEstimates | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> LiveEstimates:
    """Estimate parameters from the experiments so far.

    Arguments are those of `fixel.calibrate`, and the confidence level of the intervals. The search
    starts from the previous estimates, before the last experiment, and from two random points. An
    experiment that cannot be simulated raises `InvalidInput`.
    """
    fit = calibrate(
        experiments,
        space,
        optimiser="least-squares",
        starts=STARTS,
        start=None if previous is None else previous.calibration,
        motion=motion,
        level=level,
        verdicts=False,
        seed=seed,
        threads=threads,
        progress=False,
    )
    if fit.status == "failed":
        raise InvalidInput("experiments", found=f"none ({fit.message})", expected="some")
    comparer, members = fit.run.task(threads).comparer, fit.found.members
    best = assess.run_assessment(
        comparer, members, assess.fit_steps(comparer, members, fit.found.point)
    )
    before = {} if previous is None else previous.half_widths
    return _assessed(fit, comparer, best, level, before)


def _assessed(
    fit: Calibration,
    comparer: Comparer,
    best: assess.BestFit,
    level: float,
    before: Mapping[str, float],
) -> LiveEstimates:
    """Return the estimates of a calibration whose best fit is known."""
    shifted, space, honest = ShiftModel(comparer), comparer.space, best.honest
    own = assess.distinct(comparer, fit.found.members)
    names = tuple(s for s in SHIFTS if any(s in shifted.columns[m] for m in own.tolist()))
    scatter = _Scatter(best, names)
    data = scatter.linear(shifted, own.tolist())._replace(precision=_weak(space))
    if honest is not None:
        same = numbered([condition_of(shifted.targets[m]) for m in own.tolist()])
        data = data._replace(weight=1.0 / np.bincount(same)[same])
        usual = np.zeros(len(names) + 3)
        scatter = scatter._replace(log_sd=fit_mixed(data, usual, SPAN).log_sd)
    frames = np.array(assess.Frames(comparer, own).frames, np.float64)
    curved = np.einsum("n,npq->pq", frames / INSTANTS, _squares(data))
    profiles, half = _parabolas(space, best, curved, level)
    half = half if honest is None else 0.5 * (honest.ends(level)[1] - honest.ends(level)[0])
    excited = assess.excitation(comparer, own, best.point)
    judged = judge(space, profiles, level=level, excited=excited,
                   dispersion=best.dispersion, honest=honest)  # fmt: skip
    assessed = assess.Assessment(judged, profiles, best.noise, best.dispersion, best.misfit)
    found = replace(with_assessment(comparer, fit.found, assessed), profiles=())
    run = replace(fit.run, outcome=replace(fit.run.outcome, found=(found,)))
    now = dict(zip(space.labels, half.tolist(), strict=True))
    settled = {label: max(own, before.get(label, math.inf)) for label, own in now.items()}
    return LiveEstimates(
        calibration=run[0],
        half_widths=MappingProxyType(now),
        settled=MappingProxyType(settled),
        held_out=_held_out(shifted, own.tolist(), data),
        level=level,
        information=scatter.information(data, frames),
        scatter=scatter,
    )


def _parabolas(
    space: ParameterSpace, best: assess.BestFit, curved: FloatArray, level: float
) -> tuple[Profiles, FloatArray]:
    """Return profiles and half-widths (p,) of a deviance with half the second derivatives
    `curved` (p, p), per scale of the parameters."""
    threshold, unit = best.dispersion.threshold(level), space.scale
    curved = (curved + best.dispersion.value * _weak(space)) / np.outer(unit, unit)
    inverse = np.linalg.inv(curved)
    half, alone = np.sqrt(threshold * np.diag(inverse)), np.sqrt(threshold / np.diag(curved))
    profiles = []
    for k, centre in enumerate(best.point.tolist()):
        ends = [centre + own for own in (-half[k], half[k], -alone[k], alone[k])]
        low, high, left, right = (x if space.low[k] < x < space.high[k] else None for x in ends)
        values = np.clip(centre + half[k] * np.linspace(-2.0, 2.0, 9), space.low[k], space.high[k])
        rise = (values - centre) ** 2 / inverse[k, k]
        moved = np.abs(inverse[k]) / inverse[k, k] * half[k]
        moved[k] = 0.0
        put_back = np.diag(curved) * moved**2 / threshold
        points = np.repeat(best.point[None], len(values), axis=0)
        one = Slice(values, rise, left, right)
        profiles.append(Profile(k, values, rise, points, low, high, one, moved / unit, put_back))
    least = Best(best.point, 0.0)
    return Profiles(least, threshold, 0.0, curved, tuple(profiles), 0), half


def _held_out(shifted: ShiftModel, members: Sequence[int], data: Linear) -> Mapping[str, float]:
    """Return the error of each experiment at the best fit to the others [m]."""
    own, score = _squares(data), np.einsum("ncmp,c,ncm->np", data.common, data.white**-2.0, data.y)
    others = own.sum(axis=0) - own + data.precision
    step = np.linalg.solve(others, (score.sum(axis=0) - score)[:, :, None])[:, :, 0]
    left = data.y - np.einsum("ncmp,np->ncm", data.common, np.clip(step, -MAX_SCALES, MAX_SCALES))
    squares = np.sum(left**2, axis=(1, 2)).tolist()
    return MappingProxyType(
        {
            shifted.targets[m].key: 1e-3 * math.sqrt(one / len(shifted.instants[m]))
            for m, one in zip(members, squares, strict=True)
        }
    )


def _squares(data: Linear) -> FloatArray:
    """Return the information (n, p, p) of experiments with white noise only."""
    return np.asarray(np.einsum("ncmp,c,ncmq->npq", data.common, data.white**-2.0, data.common))


def _weak(space: ParameterSpace) -> FloatArray:
    """Return the precision (p, p) of the bounds and of given priors, per scale."""
    given = np.array([0.0 if u.prior is None else u.prior**-2 for u in space.free])
    return np.diag(((space.high - space.low) ** -2.0 + given) * space.scale**2)


def _target_of(planned: PlannedExperiment) -> Target:
    """Return a planned experiment as a target whose part stays at its start."""
    scene = planned.scene
    times = scene.duration * np.arange(1, INSTANTS + 1) / INSTANTS
    pose = np.repeat(np.asarray(scene.bodies[0].pose)[None], INSTANTS, axis=0)
    conditions = {**planned.conditions, "experiment": planned.name}
    return Target(planned.name, conditions, RolloutCase(scene, times), pose)


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Experiment to perform next."""

    index: int | None  # of the candidate; None if more experiments do not help
    # Expected half-widths of the intervals after it by label; those of now without one.
    half_widths: Mapping[str, float]
    reason: str  # of the choice, as a sentence


def choose(
    estimates: LiveEstimates,
    candidates: Sequence[PlannedExperiment],
    wanted: Mapping[str, float] = MappingProxyType({}),
) -> Choice:
    """Choose the candidate that is expected to narrow the widest interval most.

    That interval has the largest ratio to its wanted half-width, in SI units by name. By default,
    every free parameter has 5 % of its range. A wanted parameter that is not calibrated raises
    `InvalidInput`.
    """
    now, aims = estimates.half_widths, _aims(estimates.calibration.space, wanted)
    wide = [own for own in aims if estimates.settled[own] > aims[own]]
    wide.sort(key=lambda own: -now[own] / aims[own])
    if not wide:
        return Choice(index=None, half_widths=now, reason="all intervals are as narrow as wanted")
    stride = max(1, math.ceil(len(candidates) / MOST))
    which = range(len(estimates.calibration.targets) % stride, len(candidates), stride)
    more = estimates.informed_by([candidates[k] for k in which])
    every, each = estimates.expected(more), [estimates.expected(own[None]) for own in more]
    for label in wide:
        if every[label] < (1.0 - LITTLE) * now[label]:
            k = min(range(len(each)), key=lambda k: each[k][label])
            reason = f"narrows {label} from {_text(label, now)} to about {_text(label, each[k])}"
            return Choice(index=which[k], half_widths=MappingProxyType(each[k]), reason=reason)
    why = (
        "the experiments that are left hardly narrow" if candidates else "no experiment is left for"
    )
    shown = ", ".join(f"{label} ({_text(label, now)})" for label in wide)
    return Choice(index=None, half_widths=now, reason=f"{why} {shown}")


@dataclass(frozen=True)
class Until:
    """Half-widths of intervals at which a campaign ends, by name in SI units."""

    wanted: Mapping[str, float]

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the half-widths of a text: `NAME=VALUE`, several with commas between them.

        Values are in SI units, or have one of m, mm, um, rad, deg and mrad behind the number. Other
        texts, and parameters that are unknown, raise `InvalidInput`.
        """
        wanted: dict[str, float] = {}
        for part in text.split(","):
            name, _, value = (own.strip() for own in part.rpartition("="))
            name = name if "=" in part else value
            try:
                units = UNITS.get(info_of(split_label(name)[0]).unit, {})
            except InvalidInput as problem:
                raise problem.at("until") from None
            found = re.fullmatch(r"((?:\d+\.?\d*|\.\d+)(?:e-?\d+)?)\s*([a-z]*)", value)
            factor = {"": 1.0, **units}.get(found[2]) if found else None
            if found is None or factor is None or not 0.0 < float(found[1]) < math.inf:
                expected = f"such as {name}=" + (f"1{[*units][1]}" if units else "0.02")
                raise InvalidInput("until", found=repr(part.strip()), expected=expected)
            check_once("until", [*wanted, name])
            wanted[name] = float(found[1]) * factor
        return cls(MappingProxyType(wanted))

    def met(self, estimates: LiveEstimates) -> bool:
        """Return whether all intervals are as narrow as wanted, twice in a row."""
        aims = _aims(estimates.calibration.space, self.wanted)
        return all(estimates.settled[label] <= aim for label, aim in aims.items())

    def words(self, estimates: LiveEstimates) -> str:
        """Return the half-width of each interval, and the wanted one."""
        now, aims = estimates.half_widths, _aims(estimates.calibration.space, self.wanted)
        return ", ".join(f"{own} {_text(own, now)} of {_text(own, aims)} wanted" for own in aims)


def _aims(space: ParameterSpace, wanted: Mapping[str, float]) -> dict[str, float]:
    """Return the wanted half-width of each free parameter that has one, by label."""
    if not wanted:
        return {u.label: USUAL * (u.high - u.low) for u in space.free}
    names = dict.fromkeys(name for u in space.free for name in (u.label, u.name))
    for name in wanted:
        check_name("until", name, names)
    known = {u.label: wanted.get(u.label, wanted.get(u.name)) for u in space.free}
    return {label: own for label, own in known.items() if own is not None}


def _text(label: str, half_widths: Mapping[str, float]) -> str:
    """Return the half-width of a parameter with its unit."""
    unit, factor = displayed(info_of(split_label(label)[0]).unit)
    return f"±{factor * half_widths[label]:.2g} {unit}".rstrip()


# --- of a running campaign, in a process of its own --------------------------------------------


class LiveAnswer(NamedTuple):
    """Estimates so far, and the row to perform next."""

    estimates: LiveEstimates
    table: Table
    chosen: str  # name of the row; empty if none was chosen
    words: tuple[str, ...]  # what was found, in sentences
    finish: str  # why no more experiments are needed; empty if they are
    seconds: float  # duration of the computation [s]


def check_wishes(
    rows: Sequence[PlannedExperiment], fit: Sequence[str], motion: str, until: str
) -> None:
    """Raise `InvalidInput` for what could not be estimated, before the first push."""
    motion_model(motion)
    names = {own.name for own in searched_unknowns(fit, [row.scene for row in rows])}
    for label in Until.parse(until).wanted if until else ():
        if names and split_label(label)[0] not in names:
            raise unknown_name("until", label, names)


def estimate_rows(
    experiments: Sequence[Experiment],
    space: Space,
    motion: str,
    until: str,
    left: Sequence[PlannedExperiment],
    choosing: bool,
    previous: LiveEstimates | None,
) -> LiveAnswer:
    """Calibrate the experiments so far, and choose the next of the rows that are left if asked.

    `until` has the wanted intervals as text, or is empty. If no experiment informs the parameters,
    raise `InvalidInput`.
    """
    begun = time.monotonic()
    aims = Until.parse(until) if until else None
    if aims is not None and previous is None and len(experiments) > 1:
        # Intervals must be narrow twice in a row, also after a pause of the campaign.
        previous = estimate(experiments[:-1], space, motion=motion)
    known = estimate(experiments, space, motion=motion, previous=previous)
    wanted: Mapping[str, float] = {} if aims is None else aims.wanted
    finish = aims.words(known) if aims is not None and aims.met(known) else ""
    words = []
    if (error := known.held_out_error) is not None:
        words.append(f"Error of experiments predicted from the others: {1e3 * error:.2f} mm.")
    chosen = ""
    if choosing and left and not finish:
        choice = choose(known, left, wanted)
        words.append(choice.reason)
        if choice.index is None:
            finish = choice.reason
        else:
            chosen = left[choice.index].name
    table = _table(known, wanted, known.ahead(left, AHEAD), min(AHEAD, len(left)))
    return LiveAnswer(known, table, chosen, tuple(words), finish, time.monotonic() - begun)


def _table(
    known: LiveEstimates, wanted: Mapping[str, float], ahead: Mapping[str, float], n: int
) -> Table:
    """Return the estimates with their half-widths, now and after the next rows."""
    rows = []
    for own in known.calibration.estimates.values():
        halves = (known.half_widths.get(own.label), *([ahead.get(own.label)] if n else []))
        # Wider than its bounds, an interval says nothing.
        most = math.inf if own.bounds is None else 0.5 * (own.bounds[1] - own.bounds[0])
        texts = ["-" if half is None or half >= most else own.text(half) for half in halves]
        goal = own.text(wanted[own.label]) if own.label in wanted else "-"
        rows.append((own.label, own.value_text, *texts, goal, own.verdict_text))
    after = [f"+/- after {n} more"] if n else []
    head = ("parameter", "value", "+/-", *after, "wanted", "verdict")
    return Table(head, rows, left=len(head))
