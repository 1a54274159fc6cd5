"""Assessment of a calibration: noise, profiles and verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple, TypeVar

import numpy as np

from fixel.calibration.honest import (
    Honest,
    ShiftModel,
    StartSensitivity,
    mixed_study,
    start_dispersion,
    start_study,
)
from fixel.calibration.least_squares import LeastSquares, LeastSquaresFit, NormalPrior
from fixel.calibration.noise import (
    Dispersion,
    Misfit,
    Noise,
    counting_frames,
    dispersion_of,
    misfit_of,
    noise_from_differences,
    noise_from_repetitions,
    noise_from_residuals,
)
from fixel.calibration.objective import Comparer, EndPose
from fixel.calibration.profile import ProfileLikelihood, Profiles
from fixel.calibration.study import box_of, relayed, run_study
from fixel.calibration.target import repetitions
from fixel.calibration.verdict import judge
from fixel.errors import InvalidInput
from fixel.model import Fixel, Parameters, Pusher
from fixel.model.parameters import info_of
from fixel.model.records import Estimate
from fixel.model.space import ParameterSpace
from fixel.simulation.motion import Dynamic, OtherEngine
from fixel.simulation.simulate import simulate
from fixel.typing import BoolArray, FloatArray, IntArray

# Residuals of one point held in memory; of more, only some frames are looked at. The profiles ask
# for some 500 points at a time.
MAX_RESIDUALS: Final = 30_000

T = TypeVar("T")


class AssessmentRequest(NamedTuple):
    """Simulations that an assessment needs next."""

    kind: str  # name of a function in `ANSWERS`
    # (k, n) Rows are independent of each other: they may be answered in several parts.
    points: FloatArray
    note: str = ""  # what a progress bar shows
    left: int | None = None  # estimated number of points of the questions after this one
    single: bool = False  # whether a row is one rollout, of one experiment instead of all


AssessmentSteps = Generator[AssessmentRequest, FloatArray, T]
"""Yields questions, is sent one row of the answer for each point, and returns its result."""


class Assessment(NamedTuple):
    """All of it."""

    estimates: tuple[Estimate, ...]
    profiles: Profiles
    noise: Noise
    dispersion: Dispersion
    misfit: Misfit | None = None

    @property
    def quoted(self) -> tuple[Estimate, ...]:
        """Estimates; after a misfit with what noise alone would allow, where that differs."""
        if self.misfit is None or not self.misfit.noted:
            return self.estimates
        best = self.profiles.best.point.tolist()
        noise = {p.unknown: (best[p.unknown], p.low, p.high) for p in self.profiles.profiles}
        return tuple(
            own if (own.low, own.high) == noise[k][1:] else own.with_noise(*noise[k])
            for k, own in enumerate(self.estimates)
        )


def assess(
    comparer: Comparer, members: Sequence[int], point: FloatArray, *, noise: Noise | None = None
) -> Assessment:
    """Run `assessment_steps` to its end in this process; same parameters."""
    running = assessment_steps(comparer, members, point, noise=noise)
    return run_assessment(comparer, members, running)


def run_assessment(comparer: Comparer, members: Sequence[int], running: AssessmentSteps[T]) -> T:
    """Answer all questions of a running assessment in this process; its result."""
    own = np.asarray(members, np.int64)
    return run_study(running, lambda ask: answer(comparer, own, ask.kind, ask.points))


def run_assessments(
    comparer: Comparer, members: Sequence[Sequence[int]], running: Sequence[AssessmentSteps[T]]
) -> list[T | InvalidInput]:
    """Run independent assessments side by side in this process, so that batches are large.

    Each has the numbers of its experiments. The result of each is the same as alone, or the reason
    why it has none.
    """
    asks: dict[int, AssessmentRequest] = {}
    found: dict[int, T | InvalidInput] = {}
    together: dict[int, FloatArray] = {}  # answers from one batch

    def advance(k: int, tell: Callable[[], FloatArray] | None) -> None:
        try:
            asks[k] = running[k].send(tell()) if tell else next(running[k])
        except (StopIteration, InvalidInput) as end:
            found[k] = end.value if isinstance(end, StopIteration) else end
            asks.pop(k, None)

    def own_answer(k: int) -> FloatArray:
        own = np.asarray(members[k], np.int64)
        return together[k] if k in together else answer(comparer, own, asks[k].kind, asks[k].points)

    for k in range(len(running)):
        advance(k, None)
    while asks:
        which = [k for k, ask in asks.items() if ask.kind == "frames"]
        frames = [Frames(comparer, distinct(comparer, members[k])) for k in which]
        together = {}
        with suppress(InvalidInput):  # of one assessment: then each asks alone
            tables = frames_together(frames, [asks[k].points for k in which])
            together = dict(zip(which, tables, strict=True))
        for k in list(asks):
            advance(k, partial(own_answer, k))
    return [found[k] for k in range(len(running))]


def assessment_steps(
    comparer: Comparer,
    members: Sequence[int],
    point: FloatArray,
    *,
    noise: Noise | None = None,
    level: float = 0.95,
    solutions: Sequence[FloatArray] = (),
) -> AssessmentSteps[Assessment]:
    """Compute what experiments determine of the parameters they were calibrated for.

    Simulates nothing itself: every simulation is asked for, so that a journal can store each
    answer. The same answers give the same questions and the same result, bit for bit.

    The point (n_free,) is the calibration's best; `solutions` are others nearly as good. The noise
    is that of the measured poses: from repetitions where there are some, else from what the fit
    leaves. `level` is that of the intervals.
    """
    own = distinct(comparer, members)
    chosen = Frames(comparer, own)
    fitted = yield from fit_steps(comparer, members, point, noise=noise)
    noise, dispersion = fitted.noise, fitted.dispersion
    box = box_of(comparer.space.started_at(point))
    prior = NormalPrior.of(comparer.space).weighted(dispersion.value)
    known = None if np.isfinite(prior.sd).any() else fitted.fit
    threshold = dispersion.threshold(level)
    profile = ProfileLikelihood().start(box, fitted.point, threshold, prior, known)
    while not profile.done:
        answers = yield AssessmentRequest(
            "frames", profile.ask(), f"verdicts, {profile.phase}", profile.left
        )
        profile.tell(chosen.scaled(answers, noise))
    found = profile.profiles
    excited = yield AssessmentRequest(
        "excited", np.asarray(point, np.float64)[None], "verdicts, contacts"
    )
    estimates = judge(
        comparer.space,
        found,
        level=level,
        excited=dict(zip(comparer.space.labels, excited[0].tolist(), strict=True)),
        solutions=solutions,
        dispersion=dispersion,
        honest=fitted.honest,
    )
    return Assessment(estimates, found, noise, dispersion, fitted.misfit)


class BestFit(NamedTuple):
    """The likeliest point, and how well the model fits there."""

    point: FloatArray  # (n_free,) of least squares
    noise: Noise  # that residuals are divided by
    dispersion: Dispersion
    misfit: Misfit | None  # misfit at the point; None if the point could not be simulated
    # Estimate that allows for misfit; None where there is too little of it to matter.
    honest: Honest | None
    # Of least squares; None where its residuals were divided by another noise.
    fit: LeastSquaresFit | None


def fit_steps(
    comparer: Comparer, members: Sequence[int], point: FloatArray, *, noise: Noise | None = None
) -> AssessmentSteps[BestFit]:
    """Fit by least squares, and where the model misfits also with mixed effects.

    The parameters are those of `assess`. A wrong valley looks like misfit: where there is any,
    least squares begins once more from the mixed fit before it is assessed.
    """
    own = distinct(comparer, members)
    chosen = Frames(comparer, own)
    known = noise or noise_from_repeated(comparer, own)
    camera = noise or noise_from_differences([comparer.targets[m] for m in own.tolist()])
    noise = known or (yield from _left(point))
    scatter = known or camera or noise  # the last is of the residuals: the noise is unknown
    # The search minimised its own error; the likeliest point lies near by.
    best = yield from _least_squares(chosen, point, noise)
    starts = yield from _starts(comparer, own, best.point, camera)
    misfit = chosen.misfit(best.residual, noise, scatter, starts)
    honest = None
    if misfit is not None and misfit.noted:
        moving = own[[*chosen.counting(noise, best.residual)]].tolist()
        mixed = yield from _simulated(
            mixed_study(ShiftModel(comparer), moving, best.point, camera or scatter),
            "fit with shifts of each experiment",
        )
        again = yield from _least_squares(chosen, mixed.value, noise)
        fits = [best.point, again.point]
        if again.deviance < best.deviance:
            best = again
            misfit = chosen.misfit(best.residual, noise, scatter, starts)
        if misfit is not None and misfit.noted:
            honest = mixed.widened(fits, known_noise=not math.isnan(misfit.ratio))
    count = len(best.point)
    dispersion = chosen.dispersion(noise, best.residual, count)
    fit: LeastSquaresFit | None = best
    if dispersion.source != noise.source:
        fit = None
        # The fit is worse than the noise allows: the model is wrong by more, frame after frame.
        left = yield from _left(best.point)
        ratio = noise.standard_deviations / left.standard_deviations
        residual = (best.residual.reshape(-1, 3) * ratio).ravel()
        noise, dispersion = left, chosen.dispersion(left, residual, count)
    if starts and camera is not None:
        least = start_dispersion(starts, chosen.frames, noise, camera)
        dispersion = replace(dispersion, value=max(dispersion.value, least))
    return BestFit(best.point, noise, dispersion, misfit, honest, fit)


def _least_squares(
    chosen: Frames, point: FloatArray, noise: Noise
) -> AssessmentSteps[LeastSquaresFit]:
    search = LeastSquares().start(box_of(chosen.space.started_at(point)))
    while not search.done:
        answers = yield AssessmentRequest("frames", search.ask(), "best fit")
        search.tell(chosen.scaled(answers, noise))
    return search.fits[0]


def _starts(
    comparer: Comparer, members: IntArray, point: FloatArray, camera: Noise | None
) -> AssessmentSteps[list[StartSensitivity]]:
    """Return the sensitivities to measured start poses; empty without any, or of unknown noise."""
    own = members.tolist()
    if camera is None or not any(comparer.targets[m].starts_measured for m in own):
        return []
    study = start_study(ShiftModel(comparer), own, point, camera)
    found = yield from _simulated(study, "noise of the start")
    return [one.at_end for one in found] if isinstance(comparer.error, EndPose) else found


def _simulated(study: Generator[FloatArray, FloatArray, T], note: str) -> AssessmentSteps[T]:
    """Run a study that needs simulations with shifts of each experiment."""

    def ask(rows: FloatArray) -> AssessmentSteps[FloatArray]:
        return (yield AssessmentRequest("shifted", rows, note, single=True))

    return (yield from relayed(study, ask))


def answer(comparer: Comparer, members: IntArray, kind: str, points: FloatArray) -> FloatArray:
    """Answer a question of `assessment_steps`: one row for each point (k, n).

    Its kind is one of `ANSWERS`. Members (n,) are numbers of experiments.
    """
    return ANSWERS[kind](comparer, distinct(comparer, members), points)


def distinct(comparer: Comparer, members: Sequence[int] | IntArray) -> IntArray:
    """Numbers of the experiments without those that were stored before under another name."""
    seen: dict[object, int] = {}
    for m in np.asarray(members).tolist():
        target = comparer.targets[m]
        seen.setdefault((target.pose.tobytes(), target.case.times.tobytes()), m)
    return np.array(list(seen.values()), np.int64)


def _frames(comparer: Comparer, members: IntArray, points: FloatArray) -> FloatArray:
    """(k, m) differences of the frames that count [m, m, rad]; a failed row is inf."""
    return Frames(comparer, members).differences(points)


def _noise_left(comparer: Comparer, members: IntArray, points: FloatArray) -> FloatArray:
    """(k, 4) noise that the simulations at each point leave: its fields, without the source."""
    rows = []
    for point in points:
        series = comparer.residuals_at(members, point)
        if isinstance(comparer.error, EndPose):
            series = [np.concatenate([one[-1:] for one in series])] if series else []
        left = noise_from_residuals(series, len(point))
        rows.append([left.position_m, left.angle_rad, left.correlation, left.freedom])
    return np.array(rows)


def _shifted(comparer: Comparer, members: IntArray, points: FloatArray) -> FloatArray:
    """(k, m) differences of single experiments with shifts of their own [mm]."""
    return ShiftModel(comparer).differences(points)


def _excited(comparer: Comparer, members: IntArray, points: FloatArray) -> FloatArray:
    """(k, n_free) whether each unknown is excited at each point: 1 or 0."""
    rows = [list(excitation(comparer, members, point).values()) for point in points]
    return np.array(rows, np.float64)


ANSWERS: Final[dict[str, Callable[[Comparer, IntArray, FloatArray], FloatArray]]] = {
    "frames": _frames,
    "noise": _noise_left,
    "excited": _excited,
    "shifted": _shifted,
}


def _left(point: FloatArray) -> AssessmentSteps[Noise]:
    """Noise from what the calibrated simulations leave."""
    answers = yield AssessmentRequest("noise", np.asarray(point, np.float64)[None], "noise")
    position, angle, correlation, freedom = answers[0].tolist()
    return Noise.of(position, angle, "residuals", correlation=correlation, freedom=freedom)


class Frames:
    """The frames that count of experiments, by their numbers (n,), as residuals."""

    def __init__(self, comparer: Comparer, members: IntArray) -> None:
        self.comparer = comparer
        self._members = members
        self._targets = [comparer.targets[m] for m in members.tolist()]
        length = comparer.length(members)
        frames = np.arange(comparer.ensemble.n_sample)
        self._stride = 1
        if isinstance(comparer.error, EndPose):
            seen = frames == length[:, None] - 1
        else:
            self._stride = max(1, math.ceil(3 * int(length.sum()) / MAX_RESIDUALS))
            # Counted from the last frame, which says most of where a push ends.
            before_end = length[:, None] - 1 - frames
            seen = (before_end >= 0) & (before_end % self._stride == 0)
        self._seen: BoolArray = np.asarray(seen)

    @property
    def weights(self) -> FloatArray:
        """(m,) how many frames stand for the experiment that a residual belongs to."""
        count = self._seen.sum(axis=1)
        return np.repeat(count, 3 * count).astype(np.float64)

    @property
    def space(self) -> ParameterSpace:
        """Space of the parameters that are fitted."""
        return self.comparer.space

    @property
    def frames(self) -> list[int]:
        """Number of frames that count of each experiment."""
        return [int(n) for n in self._seen.sum(axis=1)]

    def misfit(
        self,
        at_best: FloatArray,
        noise: Noise,
        scatter: Noise,
        starts: Sequence[StartSensitivity] = (),
    ) -> Misfit | None:
        """Compare residuals (m,) at the best with the measurements' scatter; None without any.

        They are in standard deviations of `noise`. `starts` are the sensitivities of the
        experiments to their start poses, if the noise of these is known.
        """
        if at_best.size == 0 or not np.isfinite(at_best).all():
            return None
        rows, frames = self.counting(noise, at_best), np.nonzero(self._seen)[1]
        table = at_best.reshape(-1, 3) * noise.standard_deviations
        parts, keys = [table[own] for own in rows.values()], [self._targets[k].key for k in rows]
        by_start = [starts[k].deviations(frames[own]) for k, own in rows.items() if starts]
        return misfit_of(parts, keys, scatter, by_start)

    def counting(self, noise: Noise, at_best: FloatArray) -> dict[int, IntArray]:
        """Return the rows (n,) of residuals that count (`counting_frames`), by experiment."""
        table = at_best.reshape(-1, 3) * noise.standard_deviations
        rows = np.split(np.arange(len(table)), np.cumsum(self.frames)[:-1])
        frames = [np.flatnonzero(row) for row in self._seen]
        masks = counting_frames(self._targets, frames, [table[own] for own in rows])
        return {k: rows[k][mask] for k, mask in enumerate(masks) if mask.any()}

    def dispersion(self, noise: Noise, at_best: FloatArray, unknowns: int) -> Dispersion:
        """Return the dispersion of the residuals (m,) at the best, in standard deviations."""
        known = at_best.size > 0 and bool(np.isfinite(at_best).all())
        if known:
            rows = np.concatenate([*self.counting(noise, at_best).values()])
            at_best = at_best.reshape(-1, 3)[rows].ravel()
        deviance = float(at_best @ at_best) if known else math.inf
        # Of frames so far apart, fewer say as much as one.
        noise = replace(noise, correlation=max(1.0, noise.correlation / self._stride))
        return dispersion_of(noise, deviance, at_best.size, unknowns)

    def residuals(self, noise: Noise) -> Callable[[FloatArray], FloatArray]:
        """Points (k, n) -> residuals (k, m) in standard deviations; a failed row is inf."""
        return lambda points: self.scaled(self.differences(points), noise)

    def scaled(self, differences: FloatArray, noise: Noise) -> FloatArray:
        """Differences (k, m) in standard deviations."""
        table = differences.reshape(len(differences), -1, 3) / noise.standard_deviations
        return np.asarray(table.reshape(len(differences), -1))

    def differences(self, points: FloatArray) -> FloatArray:
        """Points (k, n) -> (k, m) differences of poses, frame by frame [m, m, rad]; a failed row is
        inf."""
        return frames_together([self], [points])[0]

    def rollouts(self, points: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return experiments (r,) and points (r, n) of the simulations at points (k, n)."""
        n = len(self._members)
        return np.tile(self._members, len(points)), np.repeat(points, n, axis=0)

    def table(self, difference: FloatArray, good: BoolArray) -> FloatArray:
        """Return the rows (k, m) of `differences` from those of its rollouts (r, n_sample, 3)."""
        n = len(self._members)
        k = len(good) // n
        table = difference.reshape(k, n, -1, 3)[:, self._seen].reshape(k, -1)
        table[~good.reshape(k, n).all(axis=1)] = math.inf
        return table


def frames_together(frames: Sequence[Frames], points: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the differences of several sets of frames of one comparer, each at its own points."""
    if not frames:
        return []
    asked = [one.rollouts(own) for one, own in zip(frames, points, strict=True)]
    which, at = map(np.concatenate, zip(*asked, strict=True))
    difference, good, _ = frames[0].comparer.differences(which, at)
    ends = np.cumsum([len(own) for own, _ in asked])[:-1]
    parts = zip(frames, np.split(difference, ends), np.split(good, ends), strict=True)
    return [one.table(own, fine) for one, own, fine in parts]


def noise_from_repeated(comparer: Comparer, members: IntArray) -> Noise | None:
    """Noise from experiments that were done again under the same conditions; none without."""
    targets = [comparer.targets[m] for m in members.tolist()]
    groups = repetitions(targets, ends=isinstance(comparer.error, EndPose))
    return noise_from_repetitions(groups) if groups else None


def excitation(comparer: Comparer, members: IntArray, point: FloatArray) -> dict[str, bool]:
    """Return whether simulations at a point have the contact that each free unknown acts on.

    Friction at a fixel means nothing where no fixel is touched, whatever its value; likewise at the
    pusher.
    """
    found = {}
    for unknown in comparer.space.free:
        contact = info_of(unknown.name).contact
        own = (m for m in members.tolist() if unknown.covers(comparer.targets[m].conditions))
        touched = (contact in _touches(comparer, m, point) for m in own)
        found[unknown.label] = not contact or any(touched)
    return found


def _touches(comparer: Comparer, member: int, point: FloatArray) -> set[str]:
    """Kinds of obstacle that the body of an experiment ever touches: `"pusher"`, `"fixel"`."""
    target = comparer.targets[member]
    scene = target.case.scene
    columns = comparer.space.columns(point[None], target.conditions)
    own = comparer.ensemble.motion
    run = simulate(
        scene,
        Parameters({n: float(value[0]) for n, value in columns.items() if "." not in n}),
        # Another engine does not tell its contacts.
        motion=Dynamic() if isinstance(own, OtherEngine) else own,
        stepper=comparer.ensemble.stepper,
        duration=float(target.case.times[-1]),
    )
    others = {run.names[k] for end in ("other", "body") for k in np.unique(run.contacts[end])}
    kinds: dict[str, tuple[Pusher | Fixel, ...]] = {"pusher": scene.pushers, "fixel": scene.fixels}
    return {kind for kind, things in kinds.items() if not others.isdisjoint(t.name for t in things)}
