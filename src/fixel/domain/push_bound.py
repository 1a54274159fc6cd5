"""Error bounds of untried pushes, for the position and the angle of their end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Final, NamedTuple, final

import numpy as np

from fixel.calibration.target import Target
from fixel.domain.contacts import CONTACT_ANGLE
from fixel.domain.coordinates import (
    PUSH,
    TRAVEL,
    coordinates_of,
    label_of,
    push_target,
    refuse_missing,
)
from fixel.domain.error_bound import ConformalBound, min_experiments
from fixel.model import Experiment, Probability, Scene
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray

FEATURES: Final = ("contact_x", "contact_y", "push_angle_rad", "travel_m", "speed_m_s")
FOLDS: Final = 5  # parts of the experiments whose coverage is measured in turn


class PushBound(NamedTuple):
    """Error bound of one push.

    Attributes
    ----------
    position, angle : float or None
        Bounds on the errors of the end position [m] and angle [rad]; None without data.
    verdict : str
        `"bounded"` or `"no data"`.
    reason : str
        Reason of missing data; empty with data.
    """

    position: float | None
    angle: float | None
    verdict: str
    reason: str


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
    features : (n, 5) float64
        Features of the pushes: place of the contact, direction, travel and speed.
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

    _drawings: ClassVar[Mapping[str, str]] = {"bounds": "fixel.drawing.domain:draw_bounds"}

    keys: tuple[str, ...]
    features: FloatArray
    position: FloatArray
    angle: FloatArray
    level: float
    group: tuple[str, ...]
    groups: tuple[str, ...]
    fold: np.ndarray
    seed: int = 0

    def at(self, scene: Scene | Experiment, **conditions: str | float) -> PushBound:
        """Return the error bound of a push.

        Parameters
        ----------
        scene : Scene or Experiment
        **conditions
            Conditions of the groups that a bare scene does not have, such as `surface="abs"`.

        Returns
        -------
        PushBound
            Position [m], angle [rad], verdict and reason.

        Raises
        ------
        InvalidInput
            A condition of the groups is missing.
        """
        target = push_target(scene, conditions)
        values = self.group[0].split() if len(self.groups) > 1 else self.group[:1]
        examples = dict(zip(self.groups, values, strict=False))
        refuse_missing(target.conditions, conditions, examples)
        group = label_of(target.conditions, self.groups)
        table = features_of([target])
        if group not in self.group:
            return PushBound(None, None, "no data", f"no experiments with {group}")
        (reason,) = self._bounds[0].reasons(table, [group])
        position, angle = (float(own.bounds(table, [group])[0]) for own in self._bounds)
        if reason or not (math.isfinite(position) and math.isfinite(angle)):
            why = reason or "too many simulations failed"
            return PushBound(None, None, "no data", why)
        return PushBound(position, angle, "bounded", "")

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
        notes = [f"held-out errors within the bound, {k}: {p}" for k, p in self.coverage.items()]
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


def features_of(targets: Sequence[Target]) -> FloatArray:
    """Return features (n, 5) of pushes from their geometry; zeros without a pusher."""
    rows = []
    for target in targets:
        own = coordinates_of(target._replace(conditions={}))
        bearing, travel = float(own.get(CONTACT_ANGLE) or 0.0), float(own.get(TRAVEL) or 0.0)
        speed = travel / float(target.case.times[-1])
        rows.append(
            (math.cos(bearing), math.sin(bearing), float(own.get(PUSH) or 0.0), travel, speed)
        )
    return np.array(rows, np.float64)
