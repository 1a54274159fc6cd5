"""Repeated pushes over a table: how far ends differ by noise, place, orientation, tilt, session."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fixel.calibration.known_pushes import PARTS, SURFACES
from fixel.calibration.target import Target
from fixel.errors import InvalidInput, counted
from fixel.model import rotated, wrapped
from fixel.model.shape import length_scale
from fixel.model.trajectory import pose_difference
from fixel.parts.model import SAME_DIRECTION, SAME_PLACE
from fixel.results import Result, Summary
from fixel.simulation.pack import pusher_path
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray, IntArray

MAX_SESSIONS: Final = 20  # a condition with more values names no sessions
SESSIONS: Final = ("session", "date", "day", "batch", "speed", "speed_m_s")
# Two pushes are at one spot of the table within the first length and angle; beyond the others they
# are elsewhere with the same orientation, or turned. These are lengths of tables, for parts of all
# sizes: a table that is uneven over 20 mm is so under small parts, too.
SPOT: Final = (5e-3, math.radians(5.0))  # [m, rad]
ELSEWHERE: Final = (20e-3, math.radians(10.0))
TURNED: Final = math.radians(85.0)
MIN_PAIRS: Final = 3
# With fewer different pushes, the bootstrap draws spots of the table instead of pushes.
MIN_DIFFERENT: Final = 10
DRAWS: Final = 1000
ACCEPTED: Final = 0.1  # share of the pushes that a good table may cost

Range = tuple[float, float, float]  # estimate and both ends of its interval; nan if unknown
UNKNOWN: Final[Range] = (math.nan, math.nan, math.nan)


class TableEffect(NamedTuple):
    """Cause for which equal pushes end differently."""

    name: str
    position: Range  # root mean square distance that it adds to the end of a push [m]
    angle: Range  # the same for the angle [rad]
    within: Range  # share of pushes within the tolerance, with it and the effects before it
    pairs: int  # pairs of equal pushes that show it

    @property
    def is_found(self) -> bool:
        """Whether an interval excludes zero."""
        return self.position[1] > 0.0 or self.angle[1] > 0.0


@final
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TableCheck(Result):
    """Effects of a table on equal pushes, and whether it is good enough for a goal.

    Made by `fixel.table_check`.

    Attributes
    ----------
    effects : tuple of TableEffect
        `noise` from run to run, `place`, `orientation`, `tilt` (a drift of the ends in a constant
        direction of the world) and `drift` between sessions.
    pairs : (n, 4) ndarray
        Pairs of equal pushes: distance of their places [m], turn [rad], and difference of their
        motions in the frame of the part: position [m] and angle [rad].
    loss : (float, float, float)
        Share of pushes that the table costs, with its interval.
    tolerance : (float, float)
        Tolerances of the goal [m, rad].
    session : str
        Condition that names the sessions; empty if there is only one.
    notes : tuple of str
    real : bool
        Whether all pushes are real.

    Examples
    --------
    >>> import fixel
    >>> from fixel.sampling import table_plan
    >>> from fixel.testbed.simulated import SimulatedTestbed
    >>> check = fixel.table_check(SimulatedTestbed().run(table_plan().experiments))
    >>> check.verdict
    'good enough'
    """

    effects: tuple[TableEffect, ...]
    pairs: FloatArray
    loss: Range
    tolerance: tuple[float, float]
    session: str
    notes: tuple[str, ...]
    real: bool

    def __getitem__(self, name: str) -> TableEffect:
        """Return the effect of a name, such as `place`."""
        return {own.name: own for own in self.effects}[name]

    @property
    def verdict(self) -> str:
        """`good enough`, `not good enough` or `undecided`."""
        if self.loss[1] > ACCEPTED:
            return "not good enough"
        return "good enough" if self.loss[2] <= ACCEPTED else "undecided"

    def _summary(self) -> Summary:
        flat, (loss, low, high) = self["noise"].within[0], self.loss
        goal = f"{1e3 * self.tolerance[0]:.3g} mm and {math.degrees(self.tolerance[1]):.3g} deg"
        open_ = "It is undecided whether the table is good enough"
        start = open_ if self.verdict == "undecided" else f"The table is {self.verdict}"
        heading = (
            f"{start} for {goal}: with it {flat - loss:.2f} of the pushes end within them, with a"
            f" flat one {flat:.2f}. It costs {low:.2f} to {high:.2f}; {ACCEPTED:g} is accepted."
        )
        factors = (1e3, math.degrees(1.0), 1.0)
        rows = [(own.name, *map(_text, own[1:4], factors)) for own in self.effects]
        effects = Table(("effect", "position [mm]", "angle [deg]", "share within"), rows)
        return Summary(heading, [effects, self._differences()], self.notes)

    def _data(self) -> Table:
        return Table(("effect", "position_m", "angle_rad", "within", "pairs"), [
            (own.name, own.position[0], own.angle[0], own.within[0], own.pairs)
            for own in self.effects
        ])  # fmt: skip

    def _differences(self) -> Table:
        distance, turn, position, angle = self.pairs.T
        apart, far, alike = ELSEWHERE[0], 2.0 * ELSEWHERE[0], turn < ELSEWHERE[1]
        near = f"{1e3 * apart:.0f} to {1e3 * far:.0f} mm"
        rows = {
            "same place and orientation": (distance < SPOT[0]) & (turn < SPOT[1]),
            f"same orientation, {near} apart": alike & (distance > apart) & (distance < far),
            "same orientation, farther apart": alike & (distance > far),
            "turned by 90 deg or more": turn > TURNED,
            "turned and as far apart": (turn > TURNED) & (distance > far),
        }
        columns = ("mean of equal pushes", "pairs", Column("difference", "mm", ".2f"),
                   Column("turn", "deg", ".2f"))  # fmt: skip
        return Table(columns, [
            (name, own.sum(), 1e3 * position[own].mean(), np.degrees(angle[own].mean()))
            for name, own in rows.items() if own.any()
        ])  # fmt: skip


def _text(values: Range, factor: float) -> str | None:
    value, low, high = (factor * own for own in values)
    return None if math.isnan(value) else f"{value:.2f} ({low:.2f} to {high:.2f})"


# --- pairs ----------------------------------------------------------------------------------------


class EqualPushes(NamedTuple):
    """Pairs of pushes with the same contact, direction and travel in the frame of the part."""

    pushes: IntArray  # (n, 2)
    place: FloatArray  # (n, 2) distance of their places [m], turn [rad]
    angle: FloatArray  # (n, 2) orientations of the part [rad]
    away: FloatArray  # (n, 3) difference of their motions in the frame of the part [m, m, rad]
    along: FloatArray  # (n, 3) the same along the push, to its left and as the part turns
    sessions: IntArray  # (n, 2)

    @property
    def size(self) -> FloatArray:
        """Differences (n, 2) of position [m] and angle [rad]."""
        return np.column_stack((np.hypot(*self.away[:, :2].T), np.abs(self.away[:, 2])))

    def groups(self, which: BoolArray) -> IntArray:
        """Return the number of the group (n, 2) of each push, as some of the pairs link them."""
        n = int(self.pushes.max(initial=0)) + 1
        links = coo_array((np.ones(int(which.sum())), self.pushes[which].T), (n, n))
        return np.asarray(connected_components(links, directed=False)[1][self.pushes], np.int64)


def equal_pushes(targets: Sequence[Target], part: str, session: str) -> EqualPushes:
    """Find the pairs among pushes of single parts, whose conditions name part and session."""
    columns = zip(*map(_in_part, targets), strict=True)
    start, motion, contact, heading, travel = map(np.array, columns)
    shapes = [own.case.scene.bodies[0].shape for own in targets]
    outlines = [shape.outline.tobytes() for shape in shapes]
    parts = [(own.conditions.get(part), what) for own, what in zip(targets, outlines, strict=True)]
    scale = np.array([length_scale(shape) for shape in shapes])
    number = [[parts.index(own)] for own in parts]  # different parts are metres apart
    near = cKDTree(np.hstack((contact / scale[:, None], number))).query_pairs(
        SAME_PLACE, output_type="ndarray"
    )
    i, j = near.T
    equal = np.abs(wrapped(heading[i] - heading[j])) < SAME_DIRECTION
    pushes = near[equal & (np.abs(travel[i] - travel[j]) < scale[i] * SAME_PLACE)]
    i, j = pushes.T
    away, moved = pose_difference(motion[j], motion[i]), start[j] - start[i]
    sense = np.where(motion[i, 2] + motion[j, 2] < 0.0, -1.0, 1.0)
    values = [str(own.conditions.get(session, "")) for own in targets]
    return EqualPushes(
        pushes=pushes,
        place=np.column_stack((np.hypot(*moved[:, :2].T), np.abs(wrapped(moved[:, 2])))),
        angle=start[pushes, 2],
        away=away,
        along=np.column_stack((rotated(away, -heading[i]), sense * away[:, 2])),
        sessions=np.unique(values, return_inverse=True)[1][pushes],
    )


def _in_part(target: Target) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
    """Return start (3), and in the frame of the part there motion (3), contact (2), direction and
    travel of a push."""
    scene, time = target.case.scene, float(target.case.times[-1])
    start, end = np.asarray(scene.bodies[0].pose), target.pose[-1]
    path = pusher_path(scene.pushers[0], time)
    tip = np.column_stack([np.interp((0.0, time), path[:, 0], x) for x in path[:, 1:3].T])
    inner = rotated(np.vstack((end[:2], tip)) - start[:2], np.full(3, -start[2]))
    motion, way = np.append(inner[0], wrapped(end[2] - start[2])), inner[2] - inner[1]
    return start, motion, inner[1], math.atan2(way[1], way[0]), math.hypot(*way)


# --- estimates ------------------------------------------------------------------------------------


def check_table(
    targets: Sequence[Target],
    part: str | None,
    surface: str | None,
    session: str | None,
    tolerance: tuple[float, float],
    level: float,
    seed: int,
    real: bool,
) -> TableCheck:
    """Check a table with pushes; arguments as for `fixel.table_check`."""
    surface = surface or _condition(targets, SURFACES)
    tables = sorted({str(own.conditions.get(surface, "")) for own in targets})
    if len(tables) > 1:
        found, hint = " and ".join(map(repr, tables)), f"select one: where={surface}={tables[-1]}"
        raise InvalidInput("surface", found=found, expected="pushes on one table", hint=hint)
    session = session or _condition(targets, SESSIONS)
    if len({own.conditions.get(session) for own in targets}) > MAX_SESSIONS:
        session = ""
    pairs = equal_pushes(targets, part or _condition(targets, PARTS), session)
    moments = table_moments(pairs, tolerance, seed)
    n = moments.n.tolist()
    if n[0] < MIN_PAIRS or max(n[1:3]) < MIN_PAIRS:
        raise InvalidInput(
            "experiments",
            found=f"{n[0]} pairs of equal pushes at one spot, {n[1] + n[2]} elsewhere",
            expected=f"{MIN_PAIRS} of each at least",
            hint="fixel sample --table --out table.yaml plans them",
        )
    *rooms, tilt, drift = effects = table_effects(moments, level)
    different = len(np.unique(pairs.groups(np.ones(len(pairs.pushes), bool))))
    towards = math.degrees(math.atan2(*moments.tilt[0, ::-1].tolist()))
    notes = (
        f"{100.0 * level:g} % intervals from {counted(len(np.unique(pairs.pushes)), 'push')}"
        f" of {counted(different, 'kind')}; a share is with the effects up to its row, for a plan"
        " that knows the mean of its push",
        *(f"{own.name} unknown: no equal pushes for it" for own in rooms if not own.pairs),
        *([f"parts drift towards {towards:.0f} deg from world x"] if tilt.is_found else []),
        f"sessions: {session if drift.pairs else 'no spot was pushed in two of them'}",
    )
    last = 2 if n[2] >= MIN_PAIRS else 1
    return TableCheck(
        effects=tuple(effects),
        pairs=np.column_stack((pairs.place, pairs.size)),
        loss=_range(moments.mean[:, 0, 2] - moments.mean[:, last, 2], level),
        tolerance=tolerance,
        session=session if drift.pairs else "",
        notes=notes,
        real=real,
    )


def _condition(targets: Sequence[Target], names: Sequence[str]) -> str:
    """Return the first name that an experiment has among its conditions; empty for none."""
    return next((name for name in names if any(name in t.conditions for t in targets)), "")


class TableMoments(NamedTuple):
    """Moments of all pairs, then of bootstrap draws; nan for fewer than `MIN_PAIRS` pairs."""

    # (m, 3, 3) For pairs at one spot, elsewhere and turned: variances of position [m^2] and angle
    # [rad^2], share within the tolerance.
    mean: FloatArray
    tilt: FloatArray  # (m, 2) drift of the ends in the world [m]
    drift: FloatArray  # (m, n_session, 3) mean of each session, as `EqualPushes.along`
    n: IntArray  # (4,) pairs of the three kinds, and of different sessions at one spot


def table_moments(pairs: EqualPushes, tolerance: tuple[float, float], seed: int) -> TableMoments:
    """Compute the moments of pairs.

    Half the squared difference of two equal pushes estimates the variance of what differs between
    them; the difference over the root of two is like the error of one push.
    """
    (distance, turn), spot = pairs.place.T, np.all(pairs.place < SPOT, axis=1)
    one = pairs.sessions[:, 0] == pairs.sessions[:, 1]
    kept = one if (spot & one).sum() >= MIN_PAIRS else np.full(len(one), True)
    elsewhere = (distance > ELSEWHERE[0]) & (turn < ELSEWHERE[1])
    masks = np.array([spot & kept, elsewhere & kept, (turn > TURNED) & kept, spot & ~one])
    n = masks.sum(axis=1)
    masks[n < MIN_PAIRS] = False
    within = (pairs.size <= math.sqrt(2.0) * np.array(tolerance)).all(axis=1)
    columns = np.column_stack((0.5 * pairs.size**2, within, np.ones(len(one))))
    # A drift t in the world differs by (R(-b) - R(-a)) t between parts at the angles a and b.
    a, b = pairs.angle.T
    moved = rotated(pairs.away, b) - rotated(pairs.away, a)
    tilted = np.column_stack((moved, 4.0 * np.sin(0.5 * (b - a)) ** 2))
    shifted = np.column_stack((pairs.along, np.ones(len(one))))
    parts = [*(own[:, None] * columns for own in masks[:3]), kept[:, None] * tilted]
    rows = np.hstack((*parts, masks[3, :, None] * shifted))
    groups = pairs.groups(np.full(len(one), True))
    groups = groups if len(np.unique(groups)) >= MIN_DIFFERENT else pairs.groups(spot)
    # Pairs of the same groups and sessions have one weight.
    keys, which = np.unique(np.hstack((groups, pairs.sessions)), axis=0, return_inverse=True)
    table = np.zeros((len(keys), rows.shape[1]))
    np.add.at(table, which.ravel(), rows)
    steps = np.diff(np.eye(int(keys[:, 2:].max(initial=0)) + 1)[keys[:, 2:]], axis=1)[:, 0]
    rng, m = np.random.default_rng(seed), int(groups.max(initial=0)) + 1
    found = []
    for draw in range(1 + DRAWS):
        times = rng.multinomial(m, np.full(m, 1.0 / m)) if draw else np.ones(m)
        first, second = times[keys[:, :2]].T
        weighted = np.where(keys[:, 0] == keys[:, 1], first, first * second)[:, None] * table
        total, (x, y, scale) = weighted.sum(axis=0)[:12].reshape(3, 4), weighted.sum(axis=0)[12:15]
        with np.errstate(invalid="ignore", divide="ignore"):
            mean, tilt = total[:, :3] / total[:, 3:], np.array([x, y]) / scale
        drift = np.linalg.pinv(steps.T * weighted[:, 18] @ steps) @ steps.T @ weighted[:, 15:18]
        found.append((mean, tilt, drift))
    mean, tilt, drift = (np.array(own) for own in zip(*found, strict=True))
    return TableMoments(mean, tilt, drift, n)


def table_effects(moments: TableMoments, level: float) -> list[TableEffect]:
    """Return noise, place and orientation, each beyond those before it, tilt and drift."""
    known, effects = np.zeros((1, 2)), []
    n = [own if own >= MIN_PAIRS else 0 for own in moments.n.tolist()]
    for k, name in enumerate(("noise", "place", "orientation")):
        variance = moments.mean[:, k, :2]
        position, angle = np.sqrt(np.maximum(variance - known, 0.0)).T
        within = _range(moments.mean[:, k, 2], level)
        effects.append(
            TableEffect(name, _range(position, level), _range(angle, level), within, n[k])
        )
        known = variance if n[k] else known
    effects.append(TableEffect("tilt", _length(moments.tilt, level), UNKNOWN, UNKNOWN, n[2]))
    if not n[3]:
        return [*effects, TableEffect("drift", UNKNOWN, UNKNOWN, UNKNOWN, 0)]
    drift = moments.drift / math.sqrt(moments.drift.shape[1] - 1.0)
    position = _length(drift[..., :2].reshape(len(drift), -1), level)
    return [*effects, TableEffect("drift", position, _length(drift[..., 2], level), UNKNOWN, n[3])]


def _length(vectors: FloatArray, level: float) -> Range:
    """Return the length of a vector, less its own noise, from its estimate and draws (m, k)."""
    if not np.isfinite(vectors[0]).all():
        return UNKNOWN
    noise = float(np.nanvar(vectors[1:], axis=0).sum())
    squared = (vectors**2).sum(axis=1) - noise
    squared[1:] -= noise  # draws have the noise of the estimate and their own
    return _range(np.sqrt(np.maximum(squared, 0.0)), level)


def _range(values: FloatArray, level: float) -> Range:
    """Return an estimate and its interval, from the estimate and draws (m,)."""
    if not math.isfinite(values[0]):
        return UNKNOWN
    low, high = np.nanquantile(values[1:], (0.5 - 0.5 * level, 0.5 + 0.5 * level)).tolist()
    return float(values[0]), low, high
