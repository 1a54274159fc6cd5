"""Predictions for a part that has hardly been pushed, from other parts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple, final

import numpy as np
from scipy.special import stdtrit

from fixel.calibration.known_pushes import PART, KnownPushes, push_target, texts_of, with_dataset
from fixel.calibration.target import Target, target_of
from fixel.domain.error_bound import CAUTIOUS, NO_DATA, TYPICAL, ConformalBound, min_experiments
from fixel.domain.push_bound import UNSEEN, PushBound
from fixel.errors import InvalidInput, counted
from fixel.model import Experiment, Pose, Scene
from fixel.model.fields import whole
from fixel.model.shape import length_scale
from fixel.parts import fit
from fixel.parts.left_out import (
    MAX_TEST,
    LeftOutEnds,
    after,
    halves,
    judged_pushes,
    leave_parts_out,
    rung,
)
from fixel.parts.next_pushes import NextPushes, propose
from fixel.progress import ProgressOption, show_progress
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray

MIN_PARTS: Final = 3  # with fewer, leaving one out says nothing
UPPER: Final = 0.8  # probability of the upper estimate of the errors of one more part
# Two pushes count as one if contact and direction are as close as this.
SAME_PLACE: Final = 2e-3  # [m]
SAME_DIRECTION: Final = math.radians(3.0)
# Sizes and travels are extrapolated by this factor at most.
MAX_RATIO: Final = 1.5


class EndPrediction(NamedTuple):
    """Predicted end of a push, and bounds on its error."""

    pose: Pose  # end of the part with the most probable parameters [m, m, rad]
    bound: PushBound  # what is unseen about the push, and the typical and the cautious bound

    def __repr__(self) -> str:
        x, y, theta = self.pose
        end = f"end: {1e3 * x:.1f} mm, {1e3 * y:.1f} mm, {math.degrees(theta):.1f} deg"
        return f"{self.bound!r}\n{end}"


@final
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PartModel(Result):
    """Predictions for a part that has hardly been pushed, from other parts.

    Made by `fixel.part_model`. Parts on a surface differ in how they stand on it. Their support
    parameters have a common normal distribution, learned from parts; it is the prior of a new part
    and narrows with its pushes. Bounds come from whole parts that were left out, with as many own
    pushes as the new part has.

    Attributes
    ----------
    experiments : tuple of Experiment
        Pushes of the known parts.
    part, surface : str
        Conditions that name the part and the surface of a push.
    fits : tuple of PartValues
        Values fitted to every known part on every surface.
    share : float
        Weight of the mean load of the known parts in the prior, chosen by leaving parts out.
    left_out : LeftOutEnds
        Errors on parts that were left out, after as many pushes.
    level : float
        Probability of the bounds.
    pushes : tuple of Experiment
        Pushes of the new part.
    chosen : bool
        Whether these were proposed by `next_pushes`.
    seed : int

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_parts
    >>> model = fixel.part_model(example_parts(3), progress=False)
    >>> new = example_parts(1, seed=9)
    >>> before = model.at(new[0].scene, part="new", surface="board")
    >>> before.bound.verdict
    'unseen'
    >>> mine = model.after(new[:3])
    >>> [len(own.pushes) for own in (model, mine)]
    [0, 3]
    """

    experiments: tuple[Experiment, ...]
    part: str
    surface: str
    fits: tuple[fit.PartValues, ...]
    share: float
    left_out: LeftOutEnds
    level: float
    pushes: tuple[Experiment, ...] = ()
    chosen: bool = False
    seed: int = 0
    threads: int | None = field(default=None, compare=False)

    def at(self, push: Scene | Experiment, **conditions: str | float) -> EndPrediction:
        """Predict the end of a push of the new part, with bounds on the error.

        Parameters
        ----------
        push : Scene or Experiment
            Push of one part by one round pusher.
        **conditions
            Conditions that a bare scene does not have, such as `surface="abs"`.

        Returns
        -------
        EndPrediction
            Pose, and a `PushBound` that names what is unseen first.

        Raises
        ------
        InvalidInput
            The scene has several bodies or pushers, or a support that is not modelled.
        """
        return self.predict([push], **conditions)[0]

    def predict(
        self, pushes: Sequence[Scene | Experiment], **conditions: str | float
    ) -> tuple[EndPrediction, ...]:
        """Predict the ends of several pushes, as `at` does for one.

        Pushes of one part on one surface are simulated together.
        """
        targets = [self._named(push_target(own, conditions)) for own in pushes]
        groups: dict[tuple[object, ...], list[int]] = {}
        for k, target in enumerate(targets):
            label = _label(target, self.surface, self.part)
            groups.setdefault((*label, target.case.scene.bodies[0].shape), []).append(k)
        found: dict[int, EndPrediction] = {}
        for (surface, part, _), rows in groups.items():
            own = fit.PartPushes([targets[k] for k in rows], self.threads)
            prior = self.distribution(str(surface), str(part))
            features, ends, good = fit.bound_features(own, np.arange(len(own)), prior)
            bounds = self._bounds_of([targets[k] for k in rows], features, good)
            for k, end, bound in zip(rows, ends.tolist(), bounds, strict=True):
                found[k] = EndPrediction(Pose(*end), bound)
        return tuple(found[k] for k in range(len(targets)))

    def after(
        self,
        pushes: Iterable[Experiment],
        *,
        chosen: bool = False,
        progress: ProgressOption = False,
    ) -> PartModel:
        """Return the model of one new part after some of its pushes.

        Parameters
        ----------
        pushes : sequence of Experiment
            Pushes of one part on one surface, added to those that the model has already.
        chosen : bool
            Whether they were proposed by `next_pushes`; bounds are then judged with parts whose
            pushes were chosen in the same way.
        progress : bool or callable, optional
            See `fixel.progress.show_progress`; nothing is shown by default.

        Returns
        -------
        PartModel

        Raises
        ------
        InvalidInput
            Pushes of several parts or surfaces.
        """
        added = (*self.pushes, *pushes)
        targets = [self._named(target_of(own)) for own in added]
        if targets:
            _one_label(targets, self.surface, self.part, "pushes")
        k = rung(distinct(fit.PartPushes(targets))) if targets else 0
        k = min(k, judged_pushes(self._groups, MIN_PARTS))
        left_out = self.left_out
        if k != left_out.pushes or chosen != self.chosen:
            with show_progress(progress, "leaving parts out") as report:
                left_out = leave_parts_out(
                    self._groups,
                    self.fits,
                    self.share,
                    k,
                    chosen=chosen,
                    seed=self.seed,
                    progress=report,
                )
        return replace(self, pushes=added, chosen=chosen, left_out=left_out)

    def next_pushes(
        self,
        candidates: Sequence[Scene | Experiment],
        intended: Sequence[Scene | Experiment] | None = None,
        n: int = 5,
        **conditions: str | float,
    ) -> NextPushes:
        """Return which pushes to make next, the best first.

        Each is the push that reduces the expected error of the intended ones most, given those
        before it. Its worth is the expected decrease of the bound, not of the interval of a
        parameter.

        Parameters
        ----------
        candidates : sequence of Scene or Experiment
            Pushes of the new part that can be made; `fixel.push_candidates` makes some.
        intended : sequence of Scene or Experiment, optional
            Pushes whose ends matter; by default the candidates.
        n : int
            Number of pushes.
        **conditions
            Conditions that bare scenes do not have, such as `surface="abs"`.

        Returns
        -------
        NextPushes
            Order of the candidates, and the expected bounds after each.

        Raises
        ------
        InvalidInput
            There are no candidates, none moves the part, or they are of several parts.
        """
        if not len(candidates):
            raise InvalidInput("candidates", found="none", expected="at least one push")
        whole(n, "n")
        offered = [self._named(push_target(own, conditions)) for own in candidates]
        wanted = [self._named(push_target(own, conditions)) for own in intended or ()] or offered
        label = _one_label((*offered, *wanted), self.surface, self.part, "candidates")
        return propose(
            fit.PartPushes(offered, self.threads),
            fit.PartPushes(wanted, self.threads),
            self.distribution(*label),
            lambda features, good: self._bounds_of(wanted, features, good),
            n=n,
            pushes=len(self.pushes),
            error=self.typical_error,
            misfit=self.misfit,
        )

    def distribution(self, surface: str, part: str = "") -> fit.SupportPrior:
        """Return the distribution of the support parameters of a part on a surface.

        It comes from the other parts and the pushes of `after`; a known part counts as new.
        """
        others = [own for own in self.fits if not part or own.part != part]
        prior = fit.learned_prior(others, surface, self.share)
        if not self.pushes:
            return prior
        targets = [self._named(target_of(own)) for own in self.pushes]
        pushes = fit.PartPushes(targets, self.threads)
        repeated = len(pushes) / distinct(pushes)
        return after(pushes, np.arange(len(pushes)), prior, repeated)

    def samples(self, k: int = 64, seed: int = 0, **conditions: str) -> dict[str, FloatArray]:
        """Return k samples of the support parameters of a part, (k,) by name.

        Conditions name its surface, and the part if it is one of the known ones. Samples are
        parameters of scenes, as for `fixel.simulate_batch`.
        """
        z = np.random.default_rng(seed).normal(size=(k, len(fit.NAMES)))
        found = self.distribution(*(conditions.get(n, "") for n in (self.surface, self.part)))
        return dict(zip(fit.NAMES, found.at(z).T.copy(), strict=True))

    def labels(self, push: Scene | Experiment) -> dict[str, str]:
        """Return surface and part of a push; those of the new part's own pushes if it has none."""
        targets = [push_target(push, {}), *map(target_of, self.pushes[:1])]
        return {
            name: str(own.conditions[name])
            for own in reversed(targets)
            for name in (self.surface, self.part)
            if name in own.conditions
        }

    def unseen(self, push: Scene | Experiment, **conditions: str | float) -> tuple[str, ...]:
        """Return what no experiment of the known parts has; never empty, as the part is new."""
        return self._unseen(self._named(push_target(push, conditions)))

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the known parts."""
        return tuple(dict.fromkeys(own.part for own in self.fits))

    @property
    def proved_level(self) -> float:
        """Probability that the known parts can prove at most: n / (n + 1) for n parts."""
        n = len(self.parts)
        return n / (n + 1.0)

    @property
    def typical_error(self) -> float:
        """Median error of the position on parts that were left out [m]; 0 without any."""
        return _median(self.left_out.errors[:, 0])

    @property
    def typical_deviation(self) -> float:
        """Standard deviation of the position, along either axis, with `typical_error` [m]."""
        return self.typical_error / math.sqrt(2.0 * math.log(2.0))

    @cached_property
    def expected_error(self) -> FloatArray:
        """Mean errors [m], [rad] of a new part, and what they stay below with 80 %, as rows (2, 2).

        A part is one draw from all parts: its mean errors have a Student distribution about those
        of the parts that were left out. NaN below `MIN_PARTS` parts.
        """
        parts, errors = np.array(self.left_out.part), self.left_out.errors
        ended = np.isfinite(errors).all(axis=1)
        names = dict.fromkeys(parts[ended].tolist())
        means = np.array([errors[ended & (parts == name)].mean(axis=0) for name in names])
        n = len(means)
        if n < MIN_PARTS:
            return np.full((2, 2), np.nan)
        wide = float(stdtrit(n - 1, UPPER)) * math.sqrt(1.0 + 1.0 / n)
        return np.array([means.mean(axis=0), means.mean(axis=0) + wide * means.std(axis=0, ddof=1)])

    @cached_property
    def misfit(self) -> float:
        """Median error of the position on the known parts, fitted to their own pushes [m]."""
        errors = []
        for own in self.fits:
            group = self._groups[own.surface, own.part]
            which = np.sort(halves(len(group), self.seed)[1][:MAX_TEST])
            ends, good = fit.simulated(group, which, own.values[None])
            errors.append(np.where(good[0], group.errors(which, ends[0])[:, 0], np.inf))
        return _median(np.concatenate(errors))

    @cached_property
    def coverage(self) -> dict[str, tuple[float, float]]:
        """Shares of errors within the typical and the cautious bound, by error.

        Every part is judged by bounds from the other parts; the mean of the parts and surfaces.
        """
        found = {}
        for column, name in enumerate(("position", "angle")):
            shares = [
                self._covered(column, part)
                for part in dict.fromkeys(self.left_out.part)
                if len(set(self.left_out.part)) > MIN_PARTS
            ]
            if shares:
                typical, cautious = np.mean([row for own in shares for row in own], axis=0)
                found[name] = (float(typical), float(cautious))
        return found

    def _covered(self, column: int, part: str) -> list[tuple[float, float]]:
        """Return shares within both bounds for every group of a part, judged by other parts."""
        left = self.left_out
        own = np.array([name == part for name in left.part])
        bounds = self._fitted(column, ~own)
        errors, table = left.errors[:, column], left.features
        rows = []
        for group in dict.fromkeys(np.array(left.group)[own].tolist()):
            at = np.flatnonzero(own & (np.array(left.group) == group))
            typical, cautious = (
                float((errors[at] <= bounds[rule].bounds(table[at])).mean())
                for rule in (TYPICAL, CAUTIOUS)
            )
            rows.append((typical, cautious))
        return rows

    @cached_property
    def _bounds(self) -> tuple[dict[str, ConformalBound], dict[str, ConformalBound]]:
        """Bounds of position and angle by rule; empty with too few parts."""
        every = np.ones(len(self.left_out.errors), bool)
        return self._fitted(0, every), self._fitted(1, every)

    def _fitted(self, column: int, which: np.ndarray) -> dict[str, ConformalBound]:
        left, rows = self.left_out, np.flatnonzero(which)
        parts = [left.part[k] for k in rows.tolist()]
        if len(set(parts)) < MIN_PARTS:
            return {}
        # A new part is one more draw from the parts; two surfaces of one part are not independent.
        typical = ConformalBound.fit(
            left.features[rows],
            left.errors[rows, column],
            level=self.level,
            seed=self.seed,
            groups=parts,
            units=[left.group[k] for k in rows.tolist()],
            rule=TYPICAL,
        )
        return {TYPICAL: typical, CAUTIOUS: typical.with_rule(CAUTIOUS)}

    @cached_property
    def _groups(self) -> dict[tuple[str, str], fit.PartPushes]:
        targets = [self._named(target_of(own)) for own in self.experiments]
        return grouped(targets, self.surface, self.part, self.threads)

    @cached_property
    def _known(self) -> KnownPushes:
        return KnownPushes.of([with_dataset(target_of(own)) for own in self.experiments])

    def _named(self, target: Target) -> Target:
        """Return a target whose conditions name its part and surface, by empty names at least."""
        blank = dict.fromkeys((self.part, self.surface), "")
        return with_dataset(target._replace(conditions={**blank, **target.conditions}))

    def _bounds_of(
        self, targets: Sequence[Target], features: FloatArray, good: BoolArray
    ) -> list[PushBound]:
        """Return the bounds of predicted pushes, with what is unseen about them."""
        n, k = len(set(self.left_out.part)), self.left_out.pushes
        if self._bounds[0]:
            ends = np.array(
                [own[rule].bounds(features) for own in self._bounds for rule in (TYPICAL, CAUTIOUS)]
            ).T
            far = self._bounds[0][TYPICAL].reasons(features)
        else:
            ends = np.full((len(targets), 4), np.inf)
            few = f"{n} parts were pushed often enough; a bound needs {MIN_PARTS} at least"
            far = (few,) * len(targets)
        judged = (
            f"bounds from {n} parts that were left out, each after {counted(k, 'push')} of its own"
        )
        surfaces = {own.surface for own in self.fits}
        found = []
        for target, end, why, ended in zip(targets, ends.tolist(), far, good, strict=True):
            texts = self._unseen(target)
            reason = "its simulation failed" if not ended else self._out_of_range(target) or why
            if reason or not np.isfinite(end).all():
                why = reason or "too many simulations failed"
                found.append(PushBound(None, None, NO_DATA, why, texts))
                continue
            on_new = _label(target, self.surface, self.part)[0] not in surfaces
            if on_new:  # typical bounds of left-out parts do not hold there
                end = [end[1], end[1], end[3], end[3]]
            why = f"{judged}; no surface was left out, so both are cautious" if on_new else judged
            proved = n / (n + 1.0)
            found.append(PushBound(end[0], end[2], UNSEEN, why, texts, end[1], end[3], proved))
        return found

    def _unseen(self, target: Target) -> tuple[str, ...]:
        """Return what is unseen about a push, or that its part is predicted like a new one."""
        _, part = _label(target, self.surface, self.part)
        given = {name: x for name, x in target.conditions.items() if x != ""}
        unseen = self._known.unseen(target._replace(conditions=given))
        if self.pushes:
            own = f" {part!r}" if part else ""
            others = texts_of([one for one in unseen if one.what not in (self.part, PART)])
            return (f"part{own}: only {counted(len(self.pushes), 'push')} of it", *others)
        texts = texts_of(unseen)
        return texts or (f"part {part!r}: predicted like a new one, from the other parts",)

    def _out_of_range(self, target: Target) -> str:
        """Return why a push is too far from the known ones for a bound; empty if it is not."""
        own = KnownPushes.of([target])
        for what, known, value in (
            ("size", self._known.size[:, 0], float(own.size[0, 0])),
            ("travel", self._known.travel, float(own.travel[0])),
        ):
            low, high = float(np.nanmin(known)), float(np.nanmax(known))
            if not low / MAX_RATIO <= value <= MAX_RATIO * high:
                return (
                    f"its {what} of {1e3 * value:.3g} mm is far from those of the parts that were"
                    f" pushed, {1e3 * low:.3g} to {1e3 * high:.3g} mm"
                )
        return ""

    def _summary(self) -> Summary:
        left = self.left_out
        k, group = left.pushes, np.array(left.group)
        rows = []
        for name in dict.fromkeys(left.group):
            errors = left.errors[group == name]
            done = errors[np.isfinite(errors).all(axis=1)]
            position, angle = done.mean(axis=0) if len(done) else (math.nan, math.nan)
            rows.append((name, len(errors), 1e3 * position, math.degrees(angle)))
        n = len(self.parts)
        (x, turn), (most_x, most_turn) = (self.expected_error * (1e3, math.degrees(1.0))).tolist()
        notes = [] if math.isnan(x) else [
            f"mean errors of one more part: about {x:.1f} mm and {turn:.1f} deg; below"
            f" {most_x:.1f} mm and {most_turn:.1f} deg each with {100.0 * UPPER:.0f} %"
        ]  # fmt: skip
        notes += [
            f"{100.0 * self.level:g} % bounds hold on left-out parts, {name}: typical"
            f" {100.0 * typical:.0f} %, cautious {100.0 * cautious:.0f} %"
            for name, (typical, cautious) in self.coverage.items()
        ]
        notes.append(
            f"{n} parts prove at most {100.0 * self.proved_level:.1f} %; a guarantee of"
            f" {100.0 * self.level:g} % needs {min_experiments(self.level)} parts"
        )
        return Summary(
            f"PartModel: {counted(n, 'part')}, {counted(len(self.experiments), 'push')};"
            f" {counted(len(self.pushes) or 'no', 'push')} of the new part",
            [
                Table(
                    ("left out", "predicted", Column("position [mm]", format=".2f"),
                     Column("angle [deg]", format=".2f")),
                    rows,
                    title=f"mean error after {counted(k, 'push')} of the part that was left out",
                )
            ],
            notes,
            {"weight of the others' mean load": f"{self.share:g}", "seed": str(self.seed)},
        )  # fmt: skip


def grouped(
    targets: Sequence[Target], surface: str, part: str, threads: int | None = None
) -> dict[tuple[str, str], fit.PartPushes]:
    """Return the pushes of every part on every surface, by surface and part."""
    rows: dict[tuple[str, str], list[Target]] = {}
    for target in targets:
        rows.setdefault(_label(target, surface, part), []).append(target)
    return {label: fit.PartPushes(rows[label], threads) for label in sorted(rows)}


def distinct(pushes: fit.PartPushes) -> int:
    """Return the number of pushes that differ in contact or direction: repetitions count once."""
    if not len(pushes):
        return 0
    rows = pushes.in_frame(pushes.tip_start)
    way = pushes.in_frame(pushes.tip_end) - rows
    heading = np.arctan2(way[:, 1], way[:, 0])
    kept, apart = list[int](), length_scale(pushes.body.shape) * SAME_PLACE
    for k in range(len(pushes)):
        near = np.hypot(*(rows[kept] - rows[k]).T) < apart
        turn = np.abs(np.angle(np.exp(1j * (heading[kept] - heading[k]))))
        if not (near & (turn < SAME_DIRECTION)).any():
            kept.append(k)
    return len(kept)


def _label(target: Target, surface: str, part: str) -> tuple[str, str]:
    return str(target.conditions.get(surface, "")), str(target.conditions.get(part, ""))


def _one_label(targets: Sequence[Target], surface: str, part: str, where: str) -> tuple[str, str]:
    """Return the surface and part that pushes have in common; reject several."""
    labels = {_label(target, surface, part) for target in targets}
    if len(labels) > 1:
        found = " and ".join(sorted(" ".join(own).strip() for own in labels))
        raise InvalidInput(where, found=found, expected="pushes of one part on one surface")
    return labels.pop()


def _median(errors: FloatArray) -> float:
    """Return the median of the finite errors; 0 without any."""
    some = errors[np.isfinite(errors)]
    return float(np.median(some)) if len(some) else 0.0
