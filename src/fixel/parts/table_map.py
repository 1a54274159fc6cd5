"""Map of an uneven table, learned from pushes of several parts that stand on it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeVar, final

import numpy as np

from fixel.calibration.known_pushes import contacts_of
from fixel.calibration.objective import ANGLE_SCALE
from fixel.calibration.target import target_of
from fixel.errors import InvalidInput, counted
from fixel.model import Experiment, LoadMap, Scene, placed
from fixel.model.support import support_points
from fixel.parts import table_fit
from fixel.parts.fit import NAMES, PartPushes
from fixel.parts.model import PartModel, grouped
from fixel.progress import ProgressOption, show_progress
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray, IntArray, ProgressCallback

Standing = TypeVar("Standing", Scene, Experiment)
Values = Mapping[str, Mapping[str, float]]  # calibrated values of parts

MIN_PARTS: Final = 3  # with fewer, sides are left out instead of parts
WEIGHTS: Final = (0.5, 1.0)  # of the map, if it helps left-out pushes at all
SCALES: Final = (1e3, math.degrees(1.0))  # of errors in tables: [mm], [deg]
DRAWS: Final = 500  # of the bootstrap
# Posterior over prior deviation above which a place counts as never seen.
UNSEEN: Final = 0.8
MOVED_LEVEL: Final = 3.0  # in standard deviations, at which a board counts as moved


class MapJudgement(NamedTuple):
    """Errors of pushes that were left out, without and with the map from the others."""

    left_out: str  # "part" or "side"
    part: tuple[str, ...]  # part of each push (n,)
    # (n, 2) Errors of position [m] and angle [rad]; of the start where a simulation failed.
    before: FloatArray
    after: FloatArray

    def gain(self, seed: int = 0) -> FloatArray:
        """Return the mean change (2,) of both errors with its bootstrap interval, as rows (3, 2).

        Parts, and pushes within them, are drawn again. The nominal level is 95 %; intervals of
        three to seven parts held 83 to 88 %.
        """
        change, names = self.after - self.before, np.array(self.part)
        rng = np.random.default_rng(seed)
        rows = [np.flatnonzero(names == name) for name in dict.fromkeys(self.part)]
        means = np.array([change[own].mean(axis=0) for own in rows])
        redrawn = np.array(
            [change[rng.choice(own, (DRAWS, len(own)))].mean(axis=1) for own in rows]
        )
        parts = rng.integers(0, len(rows), (DRAWS, len(rows)))
        draws = redrawn[parts, np.arange(DRAWS)[:, None]].mean(axis=1)
        return np.array([means.mean(axis=0), *np.percentile(draws, (2.5, 97.5), axis=0)])

    def table(self) -> Table:
        """Return the mean errors of each part without and with the map."""
        rows, names = [], np.array(self.part)
        for name in dict.fromkeys(self.part):
            own = names == name
            means = [x for e in (self.before, self.after) for x in e[own].mean(axis=0) * SCALES]
            rows.append((name, int(own.sum()), *means))
        columns = ("without map [mm]", "without map [deg]", "with map [mm]", "with map [deg]")
        title = f"mean errors of pushes whose {self.left_out} was left out"
        head: list[str | Column] = ["part", "pushes"]
        head += [Column(name, format=".2f") for name in columns]
        return Table(head, rows, title=title)

    def sentence(self) -> str:
        """Return the change of the errors in words."""
        (x, turn), (low_x, low_turn), (high_x, high_turn) = (self.gain() * SCALES).tolist()
        return (
            f"errors of pushes whose {self.left_out} was left out change by {x:+.2f} mm"
            f" ({low_x:+.2f} to {high_x:+.2f}) and {turn:+.2f} deg ({low_turn:+.2f} to"
            f" {high_turn:+.2f})"
        )


class BoardShift(NamedTuple):
    """Estimated motion of a table since its map was made."""

    shift: FloatArray  # (3,) [m, m, rad]
    deviation: FloatArray  # (3,) standard deviations
    pushes: int

    @property
    def noticed(self) -> bool:
        """Whether the table has moved beyond doubt."""
        return bool((np.abs(self.shift) > MOVED_LEVEL * self.deviation).any())

    def __repr__(self) -> str:
        verdict = "the table has moved" if self.noticed else "no motion of the table is seen"
        scales, names = (SCALES[0], *SCALES), (("x", "mm"), ("y", "mm"), ("turn", "deg"))
        rows = (np.column_stack((self.shift, 2.0 * self.deviation)).T * scales).T.tolist()
        ends = [
            f"{name} {x:+.1f} +- {sd:.1f} {unit}"
            for (name, unit), (x, sd) in zip(names, rows, strict=True)
        ]
        return f"{verdict}: {', '.join(ends)} (95 %), from {self.pushes} pushes"


@final
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TableMap(Result):
    """Unevenness of a table in world coordinates, shared by all parts that stand on it.

    Made by `fixel.table_map`. Where the table is high, parts press more; the map is the logarithm
    of that factor, never a height: heights and stiffness have the same effect. It belongs to one
    table in one place. Put it into scenes with `on` before you pass these to `fixel.calibrate`,
    `fixel.part_model`, `fixel.predict`, `fixel.plan` or any other function.

    Attributes
    ----------
    surface, name : str
        Condition that names the table, and its value.
    frame : tuple of str
        Datasets of the experiments, in whose world coordinates the map is.
    part : str
        Condition that names the part.
    values : mapping of str to mapping of str to float
        Calibrated values of each part.
    load_map : LoadMap
        Mean of the map, times its weight.
    spread : (n_node, k) float64
        Square root of the covariance of the nodes.
    own : mapping of str to OwnFit
        Loads of each part from pose to pose that the map does not explain.
    pusher : mapping of str to (3,) float64
        Corrections of the friction [-] and the shift [m] at the pusher, fitted with the map.
    weight : float
        Weight of the map, chosen on left-out pushes; 0 for a map that does not help.
    judgement : MapJudgement
        Errors of pushes that were left out.
    experiments : tuple of str
        Names of the experiments.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_parts
    >>> pushes = example_parts(3, 8, uneven=0.8)
    >>> table = fixel.table_map(pushes, progress=False)
    >>> table.name, table.load_map.log_load.shape == table.deviation.shape
    ('board', True)
    """

    surface: str
    name: str
    frame: tuple[str, ...]
    part: str
    values: Mapping[str, Mapping[str, float]]
    load_map: LoadMap
    spread: FloatArray
    own: Mapping[str, table_fit.OwnFit]
    weight: float
    judgement: MapJudgement
    experiments: tuple[str, ...]
    pusher: Mapping[str, FloatArray] = field(default_factory=dict)

    def on(self, push: Standing) -> Standing:
        """Return a scene, or an experiment with its scene, on this table.

        Raises
        ------
        InvalidInput
            The experiment names another table, or is from another dataset, whose world
            coordinates the map does not know.
        """
        if isinstance(push, Scene):
            return replace(push, plane=replace(push.plane, load_map=self.load_map))
        self._refuse_elsewhere(push)
        return push if push.scene is None else replace(push, scene=self.on(push.scene))

    def _refuse_elsewhere(self, push: Experiment) -> None:
        """Raise for an experiment on another table, or in other world coordinates."""
        found = push.conditions.get(self.surface, self.name)
        if found != self.name:
            raise InvalidInput(
                f"experiment {push.key}",
                found=f"{self.surface}={found}",
                expected=f"experiments on the table of this map, {self.surface}={self.name}",
            )
        if push.dataset not in self.frame:
            raise InvalidInput(
                f"experiment {push.key}",
                found=f"dataset {push.dataset}, whose world coordinates are not those of the map",
                expected=f"experiments of {' or '.join(self.frame)}",
                hint="make a map of each laboratory",
            )

    def _groups(self, pushes: Sequence[Experiment], new: bool = False) -> dict[str, PartPushes]:
        """Return the pushes of each part on this table; raise for new parts unless asked for."""
        for own in pushes:
            self._refuse_elsewhere(own)
        groups = by_part(pushes, self.part)
        strange = sorted(set(groups) - set(self.values))
        if strange and not new:
            expected = "parts of the map: " + ", ".join(self.values)
            raise InvalidInput("experiments", found=f"a part {strange[0]!r}", expected=expected)
        return groups

    def unseen(self, push: Scene | Experiment) -> str:
        """Return why the map knows little about a push; empty if it has seen its place."""
        scene = push if isinstance(push, Scene) else push.scene
        if scene is None:
            return ""
        body = scene.bodies[0]
        points = support_points(body.support, body.shape, body.com, body.mass, scene.gravity)[0]
        spread = replace(self.load_map, log_load=self.deviation)
        far = spread.at(placed(points + body.com, body.pose)) > UNSEEN * table_fit.DEVIATION
        share = float(far.mean())
        if share < 0.5:
            return ""
        return (
            f"the part stands {'for the most part ' if share < 1.0 else ''}where none of the"
            f" {len(self.experiments)} pushes of the map was"
        )

    def moved(
        self, experiments: Iterable[Experiment], progress: ProgressOption = False
    ) -> BoardShift:
        """Estimate how far the table has moved, from new pushes of the parts of the map.

        Parameters
        ----------
        experiments : sequence of Experiment
            Pushes of known parts on this table, made since.

        Raises
        ------
        InvalidInput
            A part is not one of the map, or `on` refuses an experiment.
        """
        pushes = list(experiments)
        with show_progress(progress, "differentiating pushes") as report:
            parts = [*_standing(self._groups(pushes), self.values, report).values()]
        return BoardShift(*table_fit.shift_of(parts, self.load_map, self.spread), len(pushes))

    @cached_property
    def deviation(self) -> FloatArray:
        """Standard deviation (n_y, n_x) at the nodes; that of the prior is 1."""
        size = np.linalg.norm(self.spread, axis=1)
        return np.asarray(size.reshape(self.load_map.log_load.shape), np.float64)

    def predict(self, pushes: Sequence[Experiment]) -> FloatArray:
        """Predict the ends of pushes of parts that the map knows, with what is their own.

        How a part stands differs from pose to pose by more than the map explains; where it has
        stood in nearly the same pose, its own pushes count.

        Parameters
        ----------
        pushes : sequence of Experiment
            Their measured ends are not used.

        Returns
        -------
        (n, 3) float64
            End poses [m, m, rad]; the start where a simulation failed.

        Raises
        ------
        InvalidInput
            A part is not one of the map, or `on` refuses an experiment.
        """
        groups = self._groups(pushes)
        names = np.array([str(own.conditions.get(self.part, "")) for own in pushes])
        ends = np.zeros((len(pushes), 3))
        for name, group in groups.items():
            part = table_fit.StandingPart(group, self.values[name], differentiate=False)
            height = self.load_map.at(part.places)
            ends[names == name] = part.ends(np.arange(len(group)), height, self.own[name])
        return ends

    def corrected(self, model: PartModel) -> PartModel:
        """Return a part model with friction and shift of its parts as fitted with the map.

        It predicts a new part on this table better, before and after the part's first pushes.

        Parameters
        ----------
        model : PartModel
            Model from pushes without the map, whose values the map was made with.
        """
        at = [NAMES.index(name) for name in table_fit.CORRECTED]
        fits = [own._replace(values=own.values.copy()) for own in model.fits]
        for own in fits:
            own.values[at] += self.pusher.get(own.part, 0.0) if own.surface == self.name else 0.0
        return replace(model, fits=tuple(fits))

    def with_part(self, experiments: Sequence[Experiment], values: Mapping[str, float]) -> TableMap:
        """Return the map with one more part, so that `predict` knows it; the table stays as it is.

        Parameters
        ----------
        experiments : sequence of Experiment
            Pushes of the part, few or many.
        values : mapping of str to float
            Its calibrated values, such as those of `fixel.part_model` after these pushes.

        Raises
        ------
        InvalidInput
            The pushes are of several parts, or `on` refuses one.
        """
        groups = self._groups(experiments, new=True)
        if len(groups) != 1:
            found = " and ".join(groups) or "none"
            raise InvalidInput("experiments", found=found, expected="pushes of one part")
        ((name, group),) = groups.items()
        own = table_fit.own_of(table_fit.StandingPart(group, values), self.load_map)
        return replace(
            self, values={**self.values, name: dict(values)}, own={**self.own, name: own}
        )

    def _summary(self) -> Summary:
        verdict = f"weight {self.weight:g}" if self.weight else "not used, as it does not help"
        seen = self.deviation < UNSEEN * table_fit.DEVIATION
        area = 1e4 * float(seen.sum() * np.prod(self.load_map.cell))
        return Summary(
            f"TableMap of {self.surface}={self.name}: {counted(len(self.experiments), 'push')} of"
            f" {counted(len(self.values), 'part')}; {verdict}",
            [self.judgement.table()],
            [self.judgement.sentence(), f"the pushes have seen {area:.0f} cm^2 of the table"],
            {"world coordinates of": ", ".join(self.frame)},
        )

    def _data(self) -> Table:
        """Nodes of the map, with their standard deviations."""
        grid = self.load_map
        y, x = np.indices(grid.log_load.shape).reshape(2, -1)
        return Table.from_columns(
            {
                "x_m": grid.origin[0] + grid.cell[0] * x,
                "y_m": grid.origin[1] + grid.cell[1] * y,
                "log_load": grid.log_load.ravel(),
                "deviation": self.deviation.ravel(),
            }
        )


def by_part(
    experiments: Iterable[Experiment], part: str, threads: int | None = None
) -> dict[str, PartPushes]:
    """Return the pushes of each part, by the condition that names it."""
    groups = grouped([target_of(own) for own in experiments], "", part, threads)
    return {name: pushes for (_, name), pushes in groups.items()}


def _standing(
    groups: Mapping[str, PartPushes], values: Values, progress: ProgressCallback
) -> dict[str, table_fit.StandingPart]:
    parts = {}
    for done, (name, group) in enumerate(groups.items()):
        parts[name] = table_fit.StandingPart(group, values[name])
        progress(done + 1, len(groups), name)
    return parts


def fitted_map(
    groups: Mapping[str, PartPushes], values: Values, progress: ProgressCallback
) -> dict[str, Any]:
    """Fit a map to the pushes of all parts, and judge it by leaving parts and sides out.

    Return the fields of a `TableMap` that follow.
    """
    parts = _standing(groups, values, progress)
    places = np.concatenate([own.places.reshape(-1, 2) for own in parts.values()])
    grid = table_fit.MapGrid.over(places)
    rows = {name: table_fit.MapRows.of(own, grid) for name, own in parts.items()}
    fit = table_fit.fit_table(list(rows.values()))
    if len(parts) >= MIN_PARTS:
        weight, judgement = _weighed(_without_parts(parts, fit, grid))
    else:
        weight, judgement = _weighed(_without_sides(parts, rows, grid))
    return {
        "load_map": grid.load_map(weight * grid.levelled(grid.root @ fit.mean, places)),
        "spread": grid.levelled(grid.root @ fit.factor, places),
        "own": {name: table_fit.own_fit(own, weight * fit.mean) for name, own in rows.items()},
        "pusher": {name: weight * fit.pusher(k) for k, name in enumerate(parts)},
        "weight": weight,
        "judgement": judgement,
    }


def _weighed(judged: Mapping[float, MapJudgement]) -> tuple[float, MapJudgement]:
    """Return the weight with the smallest errors of left-out pushes, and these.

    It is 0, with the errors of half the map, unless the interval of the gain with half the map
    excludes none: a few parts may dislike the whole map, and still show that it is one.
    """
    gains = {weight: own.gain() for weight, own in judged.items()}
    best = min(WEIGHTS, key=lambda weight: float(gains[weight][0] @ (1.0, ANGLE_SCALE)))
    half = gains[WEIGHTS[0]]
    helps = half[0] @ (1.0, ANGLE_SCALE) < 0.0 and half[2, 0] < 0.0
    return (best, judged[best]) if helps else (0.0, judged[WEIGHTS[0]])


def _without_parts(
    parts: Mapping[str, table_fit.StandingPart], fit: table_fit.TableFit, grid: table_fit.MapGrid
) -> dict[float, MapJudgement]:
    """Predict the pushes of each part with the map from the others, by its weight."""
    names: list[str] = []
    errors: list[list[FloatArray]] = []
    for k, (name, part) in enumerate(parts.items()):
        height = grid.load_map(grid.root @ fit.without(k)).at(part.places)
        every = np.arange(len(height))
        names += [name] * len(height)
        ends = [part.base, *(part.ends(every, weight * height) for weight in WEIGHTS)]
        errors.append([part.pushes.errors(every, own) for own in ends])
    return _judgements("part", names, errors)


def _without_sides(
    parts: Mapping[str, table_fit.StandingPart],
    rows: Mapping[str, table_fit.MapRows],
    grid: table_fit.MapGrid,
) -> dict[float, MapJudgement]:
    """Predict the pushes on one half of every outline with the map from the other halves."""
    names: list[str] = []
    errors: list[list[FloatArray]] = []
    half = {name: half_of_outline(own.pushes) for name, own in parts.items()}
    for side in (0, 1):
        seen = [rows[name].rows(np.flatnonzero(half[name] != side)) for name in parts]
        mean = table_fit.fit_table(seen).mean
        found = grid.load_map(grid.root @ mean)
        for own, (name, part) in zip(seen, parts.items(), strict=True):
            new = np.flatnonzero(half[name] == side)
            height = found.at(part.places[new])
            names += [name] * len(new)
            ends = [part.base[new]]
            ends += [part.ends(new, w * height, table_fit.own_fit(own, w * mean)) for w in WEIGHTS]
            errors.append([part.pushes.errors(new, end) for end in ends])
    return _judgements("side", names, errors)


def _judgements(
    left_out: str, names: Sequence[str], errors: Sequence[Sequence[FloatArray]]
) -> dict[float, MapJudgement]:
    """Return judgements by weight, from errors of each part without a map and with `WEIGHTS`."""
    before, *after = (np.concatenate(own) for own in zip(*errors, strict=True))
    return {
        weight: MapJudgement(left_out, tuple(names), before, own)
        for weight, own in zip(WEIGHTS, after, strict=True)
    }


def half_of_outline(pushes: PartPushes) -> IntArray:
    """Return which half of the outline each push begins on (n,), by the direction of its normal."""
    every = np.arange(len(pushes))
    normal = contacts_of(pushes.configurations(every), np.ones(len(pushes))).normal
    return np.asarray(normal > np.median(normal), np.int64)
