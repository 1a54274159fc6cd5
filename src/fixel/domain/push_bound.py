"""Error bounds of untried pushes, for the position and the angle of their end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.calibration import known_pushes
from fixel.calibration.known_pushes import CONTACT_ANGLE, PART, SIDE, SPEED
from fixel.calibration.objective import Comparer
from fixel.calibration.target import Target, same_configuration
from fixel.domain.cells import PUSH, TRAVEL, coordinates_of, label_of, refuse_missing
from fixel.domain.error_bound import CAUTIOUS, NO_DATA, TYPICAL, ConformalBound, min_experiments
from fixel.domain.evidence import default_folds
from fixel.domain.held_out import (
    Apart,
    CalibrationModel,
    Finished,
    end_errors,
    held_out,
    stepper_for,
)
from fixel.errors import InvalidInput
from fixel.model import Experiment, Probability, Scene, pose_error
from fixel.progress import Reporter
from fixel.results import Result, Summary
from fixel.simulation import QuasiStatic
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.pack import check_motion
from fixel.table import Column, Table
from fixel.typing import FloatArray, IntArray

FEATURES: Final = (
    "contact_x", "contact_y", "push_angle_rad", "travel_m", "speed_m_s", "moved_m", "turned_rad",
)  # fmt: skip
BOUNDED: Final = "bounded"
UNSEEN: Final = "unseen"
# Largest number of fits with groups left out; more groups are left out several at a time.
MAX_FOLDS: Final = 24
FOLDS: Final = 5  # parts of the experiments whose coverage is measured in turn

# Cache of the fits of experiments without each fold, by the name of a set of fits.
FinishedFits = Callable[[Sequence[Target], Apart, str], Finished]


class PushBound(NamedTuple):
    """Error bound of one push."""

    # Bounds on the errors of the end position [m] and angle [rad]; None without data. For a push
    # that is unlike all experiments the typical bound.
    position: float | None
    angle: float | None
    # `"bounded"`; `"unseen"`: bounded by experiments that were left out as a whole; `"no data"`.
    verdict: str
    reason: str  # reason of missing data, or what an unseen push is judged by; else empty
    # What is new about the push, or not given: part, surface, laboratory, side, speed, travel.
    unseen: tuple[str, ...] = ()
    # For an unseen push: bounds by the worst of the groups that were left out [m], [rad].
    cautious_position: float | None = None
    cautious_angle: float | None = None
    # For an unseen push: largest probability that n groups can prove, n / (n + 1).
    proved: float | None = None

    def __repr__(self) -> str:
        lines = [f"unseen: {text}" for text in self.unseen]
        why = f"{self.verdict}: {self.reason}" if self.reason else self.verdict
        lines.append(self.reason if self.verdict == UNSEEN else why)
        for name, *ends in (
            ("bound" if self.proved is None else "typical bound", self.position, self.angle),
            ("cautious bound", self.cautious_position, self.cautious_angle),
        ):
            x, y = ends
            if x is not None and y is not None:
                lines.append(f"{name}: {1e3 * x:.3g} mm, {math.degrees(y):.3g} deg")
        return "\n".join(lines)


class LeftOutErrors(NamedTuple):
    """Errors of experiments under calibrations without their whole group."""

    # Condition whose values were left out, such as `"shape"`; also `"side"` and `"speed"`.
    condition: str
    unit: tuple[str, ...]  # value of each experiment
    # (n,) Errors of the end [m], [rad]; inf for a failed simulation.
    position: FloatArray
    angle: FloatArray

    @property
    def parts(self) -> list[str]:
        """Part of each side or speed, and for other conditions the value itself."""
        return [unit.rsplit(f" {self.condition} ", 1)[0] for unit in self.unit]

    def rows(self, which: Sequence[int]) -> LeftOutErrors:
        """Return those of some of the experiments."""
        own = list(which)
        unit = tuple(self.unit[k] for k in own)
        return LeftOutErrors(self.condition, unit, self.position[own], self.angle[own])


@final
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ErrorBound(Result):
    """Bounds that the errors of new pushes satisfy with a stated probability.

    Made by `fixel.error_bound`. The bounds are conformal: they hold for new pushes that are drawn
    like the experiments, whatever the distribution of the errors. Position and angle each hold with
    probability `level`.

    Attributes
    ----------
    keys : tuple of str
        Names of the experiments.
    features : (n, 7) float64
        Features of the pushes: place of the contact, direction, travel and speed; how far the part
        moves and turns by a quasi-static simulation of the scene as it is, before any calibration.
    position, angle : (n,) float64
        Held-out errors of the end [m], [rad]; inf for a failed simulation.
    level : float
        Probability of each bound.
    group : tuple of str
        Group of each experiment.
    groups : tuple of str
        Conditions by which experiments are grouped.
    fold : (n,) int
        Fold in which each experiment was held out.
    known : KnownPushes, optional
        Parts, surfaces, laboratories, sides and speeds of the experiments.
    left_out : tuple of LeftOutErrors
        Errors with whole groups left out, one entry for each condition of `leave_out`.
    seed : int

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(10, duration=0.2)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> bound = fixel.error_bound(pushes, space, folds=2, progress=False)
    >>> bound.at(pushes[0].scene).verdict
    'bounded'
    """

    keys: tuple[str, ...]
    features: FloatArray
    position: FloatArray
    angle: FloatArray
    level: float
    group: tuple[str, ...]
    groups: tuple[str, ...]
    fold: np.ndarray
    seed: int = 0
    known: known_pushes.KnownPushes | None = None
    left_out: tuple[LeftOutErrors, ...] = ()

    def at(self, scene: Scene | Experiment, **conditions: str | float) -> PushBound:
        """Return the error bound of a push.

        What is new about the push comes first: a part, surface, laboratory, side, speed or travel
        that no experiment has. Its bounds are then those of groups that were left out as a whole,
        typical and cautious; without such groups there is none.

        Parameters
        ----------
        scene : Scene or Experiment
        **conditions
            Conditions of the groups that a bare scene does not have, such as `surface="abs"`.

        Returns
        -------
        PushBound
            Position [m], angle [rad], verdict, reason, and what is unseen.

        Raises
        ------
        InvalidInput
            A condition of the groups is missing.
        """
        target = known_pushes.with_dataset(known_pushes.push_target(scene, conditions))
        values = self.group[0].split() if len(self.groups) > 1 else self.group[:1]
        examples = dict(zip(self.groups, values, strict=False))
        refuse_missing(target.conditions, conditions, examples)
        group = label_of(target.conditions, self.groups)
        unseen = () if self.known is None else self.known.unseen(target)
        new = [own for own in unseen if own.is_given]
        if group not in self.group and not new:
            new = [known_pushes.Trait(self.groups[0], f"no experiments with {group}")]
            unseen = (*new, *unseen)
        texts = known_pushes.texts_of(unseen)
        table = features_of([target])
        if new:
            return self._of_left_out(new, table, texts)
        (reason,) = self._bounds[0].reasons(table, [group])
        position, angle = (float(own.bounds(table, [group])[0]) for own in self._bounds)
        if reason or not (math.isfinite(position) and math.isfinite(angle)):
            why = reason or "too many simulations failed"
            return PushBound(None, None, NO_DATA, why, texts)
        return PushBound(position, angle, BOUNDED, "", texts)

    def _of_left_out(
        self, new: Sequence[known_pushes.Trait], table: FloatArray, texts: tuple[str, ...]
    ) -> PushBound:
        """Return the bounds of a push that is unlike all experiments."""
        names = list(dict.fromkeys(own.what for own in new))
        one = next((k for k, own in enumerate(self.left_out) if self._covers(own, names)), None)
        if one is None:
            option = names[0] if len(names) == 1 else "one that leaves out all of these together"
            hint = f"no group of experiments was left out for it; leave_out: {option}"
            if names == [known_pushes.TRAVEL_LENGTH]:
                hint = "no bound for a push with another travel"
            return PushBound(None, None, NO_DATA, f"{texts[0]}; {hint}", texts)
        left = self.left_out[one]
        own = table[:, _columns(left.condition)]
        bounds = self._unit_bounds[one]
        (reason,) = bounds[0].reasons(own)
        ends = [
            [float(b.with_rule(rule).bounds(own)[0]) for b in bounds]
            for rule in (TYPICAL, CAUTIOUS)
        ]
        if reason or not np.isfinite(ends).all():
            return PushBound(None, None, NO_DATA, reason or "too many simulations failed", texts)
        n, proved = bounds[0].n_unit, bounds[0].with_rule(CAUTIOUS).proved_level
        parts = len(set(left.parts))
        of = f"{n} in all" if parts in (1, n) else f"{n} on {parts} parts"
        why = (
            f"bounds from calibrations without each {left.condition}, {of}: these prove at"
            f" most {100.0 * proved:.1f} %; a guarantee of {100.0 * self.level:g} % needs"
            f" {min_experiments(self.level)}"
        )
        (x, turn), (wide_x, wide_turn) = ends
        return PushBound(x, turn, UNSEEN, why, texts, wide_x, wide_turn, proved)

    def _covers(self, left: LeftOutErrors, names: Sequence[str]) -> bool:
        """Whether leaving out the values of one condition made everything new that is new here."""
        return all(self._made_new(left, name) for name in names)

    def _made_new(self, left: LeftOutErrors, name: str) -> bool:
        if name == left.condition or (name == PART and left.condition in known_pushes.PARTS):
            return True
        column = () if self.known is None else self.known.labels.get(name, ())
        if not column or left.condition in (SIDE, SPEED):
            return False
        # A value occurs in one unit only, so that leaving out the unit left it out too.
        pairs = set(zip(column, left.unit, strict=True))
        return len(pairs) == len({value for value, _ in pairs})

    @cached_property
    def coverage(self) -> dict[str, Probability]:
        """Share of held-out errors within bounds learned without them, with its interval.

        Measured on fifths of the experiments in turn; empty where there are too few.
        """
        part = np.random.default_rng(self.seed).permutation(len(self.keys)) % FOLDS
        if np.sum(part != 0) < min_experiments(self.level):
            return {}
        found = {}
        for name, errors in (("position", self.position), ("angle", self.angle)):
            inside = []
            for k in range(FOLDS):
                own, others = np.flatnonzero(part == k), np.flatnonzero(part != k)
                bound = self._fitted(errors, others).bounds(
                    self.features[own], [self.group[j] for j in own]
                )
                known = np.isfinite(bound)
                inside += (errors[own] <= bound)[known].tolist()
            if inside:
                found[name] = Probability.of(sum(inside), len(inside))
        return found

    @cached_property
    def _bounds(self) -> tuple[ConformalBound, ConformalBound]:
        every = np.arange(len(self.keys))
        return self._fitted(self.position, every), self._fitted(self.angle, every)

    @cached_property
    def _unit_bounds(self) -> list[tuple[ConformalBound, ConformalBound]]:
        """Bounds for new units of each condition that was left out."""
        found = []
        for left in self.left_out:
            table = self.features[:, _columns(left.condition)]
            position, angle = (
                ConformalBound.fit(
                    table, own, left.parts, self.level, self.seed, units=left.unit, rule=TYPICAL
                )
                for own in (left.position, left.angle)
            )
            found.append((position, angle))
        return found

    def _fitted(self, errors: FloatArray, rows: np.ndarray) -> ConformalBound:
        labels = [self.group[k] for k in rows]
        return ConformalBound.fit(self.features[rows], errors[rows], labels, self.level, self.seed)

    def _summary(self) -> Summary:
        own = [bound.bounds(self.features, list(self.group)) for bound in self._bounds]
        rows = [
            (name, *(factor * float(np.median(x)) for x in (errors, bounds)),
             factor * float(bounds.min()), factor * float(bounds.max()))
            for name, factor, errors, bounds in (
                ("position [mm]", 1e3, self.position, own[0]),
                ("angle [deg]", math.degrees(1.0), self.angle, own[1]),
            )
        ]  # fmt: skip
        names = ("median error", "median bound", "smallest", "largest")
        counts = ", ".join(f"{len(set(own.unit))} of {own.condition}" for own in self.left_out)
        notes = [f"held-out errors within the bound, {k}: {p}" for k, p in self.coverage.items()]
        notes += (
            [f"groups left out as a whole, for pushes unlike these: {counts}"] if counts else []
        )
        return Summary(
            f"ErrorBound: holds for {100.0 * self.level:g} % of new pushes (held out,"
            f" {len(set(self.fold.tolist()))} folds, {len(self.keys)} experiments)",
            [Table(("end", *(Column(name, format=".3g") for name in names)), rows)],
            notes,
            {"model of the errors": self._bounds[0].model, "seed": str(self.seed)},
        )

    def _data(self) -> Table:
        """Held-out errors and bounds, one row per experiment."""
        own = [bound.bounds(self.features, list(self.group)) for bound in self._bounds]
        columns = ("experiment", "group", Column("position", "m"), Column("angle", "rad"),
                   Column("position_bound", "m"), Column("angle_bound", "rad"))  # fmt: skip
        return Table(
            columns, zip(self.keys, self.group, self.position, self.angle, *own, strict=True)
        )


def _columns(condition: str) -> list[int]:
    """Return the features of which the bounds of new units depend: not the one that is new."""
    dropped = {SIDE: (0, 1), SPEED: (4,)}.get(condition, ())
    return [k for k in range(len(FEATURES)) if k not in dropped]


def features_of(targets: Sequence[Target]) -> FloatArray:
    """Return features (n, 7) of pushes before they are made; zeros without a pusher."""
    rows = []
    for target in targets:
        own = coordinates_of(target._replace(conditions={}))
        bearing, travel = float(own.get(CONTACT_ANGLE) or 0.0), float(own.get(TRAVEL) or 0.0)
        speed = travel / float(target.case.times[-1])
        rows.append(
            (math.cos(bearing), math.sin(bearing), float(own.get(PUSH) or 0.0), travel, speed)
        )
    return np.column_stack((np.array(rows, np.float64), _motions(targets)))


def _motions(targets: Sequence[Target]) -> FloatArray:
    """Return how far parts move [m] and turn [rad], (n, 2), quasi-statically; zeros without an end.

    Errors grow with motion, for which the friction of the scene is near enough.
    """
    found = np.zeros((len(targets), 2))
    can = [k for k, target in enumerate(targets) if _slides(target.case.scene)]
    if can:
        ends = Ensemble([targets[k].case for k in can]).simulate(np.arange(len(can)), {})
        start = np.array([targets[k].case.scene.bodies[0].pose for k in can])
        position, angle = pose_error(ends.pose[:, -1], start)
        found[can] = np.where(ends.converged[:, None], np.column_stack((position, angle)), 0.0)
    return np.abs(found)


def _slides(scene: Scene) -> bool:
    """Whether quasi-static motion describes a scene: one pusher, and friction under one body."""
    try:
        check_motion(scene, QuasiStatic.kind)
    except InvalidInput:
        return False
    return len(scene.bodies) == len(scene.pushers) == 1


def bound_of(
    targets: Sequence[Target],
    model: CalibrationModel,
    asked: Any,
    fits: FinishedFits,
    progress: Reporter,
) -> ErrorBound:
    """Return the error bounds of experiments, with the options of `fixel.error_bound`."""
    features = features_of(targets)
    judged = _first_of_repeated(targets, features)
    n, least = len(targets), min_experiments(asked.level)
    if len(judged) < least:
        raise InvalidInput(
            "experiments",
            found=f"{n}" if n == len(judged) else f"{n}, of {len(judged)} different pushes",
            expected=f"{least} at least for bounds with a probability of {100 * asked.level:g} %",
            hint="run more experiments, or choose a lower level",
        )
    labels = tuple(label_of(target.conditions, asked.groups) for target in targets)
    for name in asked.leave_out:
        _check_units(known_pushes.with_units(targets, name), name, model)
    apart = Apart(
        folds=default_folds(len(targets)) if asked.folds is None else asked.folds, seed=asked.seed
    )
    position, angle, fold = _errors(
        targets, model, apart, asked, fits(targets, apart, ""), progress
    )
    left = []
    for name in asked.leave_out:
        progress.stage = f"leaving out {name}"
        left.append(_left_out(targets, name, model, asked, fits, progress))
    return ErrorBound(
        keys=tuple(targets[k].key for k in judged),
        features=features[judged],
        position=position[judged],
        angle=angle[judged],
        level=asked.level,
        group=tuple(labels[k] for k in judged),
        groups=asked.groups,
        fold=fold[judged],
        seed=asked.seed,
        known=known_pushes.KnownPushes.of([targets[k] for k in judged], asked.groups),
        left_out=tuple(own.rows(judged) for own in left),
    )


def _errors(
    targets: Sequence[Target],
    model: CalibrationModel,
    apart: Apart,
    asked: Any,
    finished: Finished,
    progress: Reporter,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return held-out errors of end positions and angles (n,), and the fold of each."""
    found = held_out(targets, model, apart, finished, progress, asked.threads)
    comparer = Comparer(
        targets, model.space, model.error, model.motion, stepper_for(targets), asked.threads
    )
    return *end_errors(comparer, found), found.fold


def _left_out(
    targets: Sequence[Target],
    name: str,
    model: CalibrationModel,
    asked: Any,
    fits: FinishedFits,
    progress: Reporter,
) -> LeftOutErrors:
    """Return errors under fits without the values of a condition."""
    own = known_pushes.with_units(targets, name)
    units = tuple(label_of(target.conditions, (name,)) for target in own)
    apart = Apart(out=name, folds=min(len(set(units)), MAX_FOLDS), seed=asked.seed)
    finished = fits(own, apart, f"without-{name}")
    position, angle, _ = _errors(own, model, apart, asked, finished, progress)
    return LeftOutErrors(name, units, position, angle)


def _check_units(targets: Sequence[Target], name: str, model: CalibrationModel) -> None:
    """Raise if a condition has one value only, or a parameter for each of its values."""
    n = len({label_of(target.conditions, (name,)) for target in targets})
    if n < 2:
        raise InvalidInput("leave_out", found=f"{n} value of {name}", expected="at least 2",
                           hint="one value does not show how much others differ")  # fmt: skip
    own = [u.label for u in model.space.unknowns if name in u.where and not u.frozen]
    if own:
        raise InvalidInput("leave_out", found=f"{own[0]}, a parameter for each {name}",
                           expected=f"parameters that a new {name} shares")  # fmt: skip


def _first_of_repeated(targets: Sequence[Target], features: FloatArray) -> list[int]:
    """Return one experiment of each configuration: repetitions do not show how pushes differ."""
    found: dict[object, int] = {}
    for k, target in enumerate(targets):
        label = same_configuration(target)
        start = target.case.scene.bodies[0].pose
        pose = (*features[k].tolist(), *start.tolist(), *target.conditions.items())
        plain = tuple(value for value in pose if value != ("experiment", target.key))
        found.setdefault(plain if label == target.key else label, k)
    return sorted(found.values())
