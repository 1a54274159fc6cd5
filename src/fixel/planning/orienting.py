"""Orienting a part without sensors: pushes by a wide fence that end at one known angle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import degrees, pi, tau
from typing import Final, final

import numpy as np
import shapely
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, counted
from fixel.model import Body, Disk, Shape
from fixel.model.fields import Comparable, frozen, instance, non_negative, numbers
from fixel.model.trajectory import wrapped
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray, IntArray

# Angles closer than this are equal [rad]: far above rounding, far below any digitised outline.
SAME: Final = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class PushFunction(Comparable):
    """Angles at which a part comes to rest on a wide fence that pushes it.

    A direction is that of the fence from the centre of mass, in the frame of the part. A push
    turns the part until the distance of the fence from the centre of mass is smallest. That holds
    for any pressure on the plate with its centre at the centre of mass, and for any friction at the
    fence, as long as the fence moves along its normal.

    References
    ----------
    :cite:t:`goldberg1993`; :cite:t:`peshkin1988`.

    Examples
    --------
    >>> import numpy as np
    >>> from fixel import Polygon
    >>> rest = PushFunction.of(Polygon.rectangle(0.04, 0.02))
    >>> np.degrees(rest.stable).round(), rest.symmetry
    (array([  0.,  90., 180., 270.]), 2)
    """

    stable: FloatArray  # (n,) directions in which the part rests, increasing from 0 to 2 pi [rad]
    # (n,) Directions between them, from which it may turn either way [rad]; the part comes to rest
    # at `stable[k]` from directions between `borders[k]` and `borders[k + 1]`.
    borders: FloatArray
    symmetry: int  # number of equal turns by which directions and borders repeat

    @classmethod
    def of(cls, part: Body | Shape) -> PushFunction:
        """Return the function of a part.

        Parameters
        ----------
        part : Body or Shape
            Part with an outline of corners; of a shape the centroid is the centre of mass. Hollows
            do not touch the fence: only the convex hull matters.

        Raises
        ------
        InvalidInput
            The part is a disk, or its centre of mass lies outside its outline.
        """
        directions, corners = _rests(hull_of(part))
        # The border before a stable direction is the farthest corner since the last one.
        borders = np.array(
            [
                _farthest(corners, before, after)
                for before, after in zip(np.roll(directions, 1), directions, strict=True)
            ]
        )
        return cls(frozen(directions), frozen(borders), _symmetry(directions, borders))

    def rest(self, directions: ArrayLike) -> IntArray:
        """Return the indices (...) into `stable` where the part comes to rest, from directions
        (...) of the fence at the start [rad]."""
        ahead = np.mod(np.asarray(directions, np.float64) - self.borders[0], tau)
        start = np.mod(self.borders - self.borders[0], tau)
        return np.asarray(np.searchsorted(start, ahead, side="right") - 1, np.int64)


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class OrientingPlan(Result):
    """Pushes by a wide fence after which a part has one angle, whatever its angle at the start.

    Attributes
    ----------
    rotations : (n - 1,) float64
        Rotations of the direction of pushing between the n pushes, counter-clockwise [rad].
    margins : (n - 1,) float64
        Largest error of each rotation that does not change its effect [rad].
    angle : float
        Angle of the part after the last push, from the direction of that push [rad]; known up to
        the symmetry.
    symmetry : int
        Number of angles, evenly spaced over a turn, at which the part may end.
    function : PushFunction
        Angles at which the part comes to rest.
    outline : (m, 2) float64
        Corners of the convex hull of the part from its centre of mass [m].

    Examples
    --------
    >>> from fixel import Polygon
    >>> plan = orienting_plan(Polygon.rectangle(0.05, 0.035))
    >>> plan.pushes, plan.ends([0.1, 1.0, 2.0, 4.0]).round(2)
    (2, array([4.71, 1.57, 1.57, 4.71]))
    """

    rotations: FloatArray
    margins: FloatArray
    angle: float
    symmetry: int
    function: PushFunction
    outline: FloatArray

    @property
    def pushes(self) -> int:
        """Number of pushes."""
        return len(self.rotations) + 1

    @property
    def margin(self) -> float:
        """Smallest margin [rad]; pi for a plan of one push."""
        return float(min(self.margins, default=pi))

    def ends(self, angles: ArrayLike, errors: ArrayLike = 0.0) -> FloatArray:
        """Compute the angle of the part after the plan.

        Parameters
        ----------
        angles : (...) array_like
            Angles of the part at the start, from the direction of the first push [rad].
        errors : (..., n - 1) array_like
            Errors of the rotations [rad].

        Returns
        -------
        (...) float64
            Angles from the direction of the last push, between 0 and 2 pi [rad].
        """
        return np.asarray(self.track(angles, errors)[-1])

    def track(self, angles: ArrayLike, errors: ArrayLike = 0.0) -> FloatArray:
        """Compute the angle of the part after each push, (n, ...), as `ends` does for the last."""
        rest = self.function.rest(pi - numbers(angles, "angles"))
        off = np.broadcast_to(errors, (*rest.shape, len(self.rotations)))
        found = [rest]
        for k, rotation in enumerate(self.rotations):
            rest = self.function.rest(self.function.stable[rest] + rotation + off[..., k])
            found.append(rest)
        return np.asarray(np.mod(pi - self.function.stable[np.array(found)], tau))

    def _summary(self) -> Summary:
        columns = (Column("push"), Column("rotation", "deg"), Column("margin", "deg"))
        rows: list[tuple[int, float | None, float | None]] = [(1, None, None)]
        turned = np.degrees([self.rotations, self.margins]).T.tolist()
        rows += [(k, round(turn, 2), round(room, 2)) for k, (turn, room) in enumerate(turned, 2)]
        note = f"The part ends {degrees(self.angle):.1f} deg from the direction of the last push."
        if self.symmetry > 1:
            note += f" It repeats every {360 / self.symmetry:g} deg."
        heading = f"Orienting plan of {counted(self.pushes, 'push')} by a wide fence"
        return Summary(heading, [Table(columns, rows)], [note])


def orienting_plan(part: Body | Shape, *, angle_error: float = 0.0) -> OrientingPlan:
    """Plan the fewest pushes by a wide fence that bring a part to one angle without a sensor.

    The angle at the start is unknown. Between pushes the fence, or the plate, is rotated; each push
    lasts until the part lies flat on the fence. The search is exact. Of plans with equally few
    pushes it returns one with the largest smallest margin.

    Parameters
    ----------
    part : Body or Shape
        Part with an outline of corners; of a shape the centroid is the centre of mass.
    angle_error : float
        Largest error of a rotation between two pushes [rad]. Rotations with a smaller margin are
        not used, so that the plan may need more pushes.

    Returns
    -------
    OrientingPlan

    Raises
    ------
    InvalidInput
        The part is a disk, its centre of mass lies outside its outline, or no plan survives the
        error.

    References
    ----------
    :cite:t:`goldberg1993`.

    Examples
    --------
    >>> from fixel import Polygon
    >>> from fixel.units import deg, mm
    >>> orienting_plan(Polygon.rectangle(50 * mm, 35 * mm), angle_error=5 * deg)
    Orienting plan of 2 pushes by a wide fence
      push  rotation [deg]  margin [deg]
      1                  -             -
      2               45.0         10.01
      The part ends 90.0 deg from the direction of the last push. It repeats every 180 deg.
    """
    least = non_negative(angle_error, "angle_error", "rad")
    plan = surviving_plan(part, least)
    if plan is None:
        largest = degrees(_largest_error(PushFunction.of(part)))
        found = f"{degrees(least):.3g} deg"
        expected = f"at most {largest:.3g} deg for this part"
        hint = "no plan of any length survives a larger error of the rotations"
        raise InvalidInput("angle_error", found=found, expected=expected, hint=hint)
    return plan


def surviving_plan(part: Body | Shape, angle_error: float) -> OrientingPlan | None:
    """Return the plan of fewest pushes that survives an error of the rotations [rad], if any."""
    function = PushFunction.of(part)
    found = _search(function, angle_error)
    if found is None:
        return None
    chain, last = found
    return OrientingPlan(
        rotations=frozen(np.array([turn for turn, _ in chain])),
        margins=frozen(np.array([margin for _, margin in chain])),
        angle=float(np.mod(pi - function.stable[last], tau / function.symmetry)),
        symmetry=function.symmetry,
        function=function,
        outline=frozen(hull_of(part)),
    )


# --- push function ------------------------------------------------------------------------------


def hull_of(part: Body | Shape) -> FloatArray:
    """Return the corners (n, 2) of the convex hull from the centre of mass, counter-clockwise."""
    instance(part, Body | Shape, "part", "a Body or a Polygon")
    shape = part.shape if isinstance(part, Body) else part
    if isinstance(shape, Disk):
        raise InvalidInput("part", found="a disk", expected="a part with corners")
    com = part.com if isinstance(part, Body) else shape.centroid
    hull = shapely.Polygon(shape.outline).convex_hull
    if not hull.contains(shapely.Point(*com)):
        found = f"a centre of mass at ({com[0]:g}, {com[1]:g}), outside the outline"
        raise InvalidInput("part", found=found, expected="a centre of mass inside the outline")
    ring = shapely.get_coordinates(shapely.orient_polygons(hull).exterior)[:-1]
    return np.asarray(ring - com)


def _rests(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the stable directions, increasing, and the corners as (angle, radius)."""
    after = np.roll(corners, -1, axis=0)
    along = after - corners
    length = np.hypot(*along.T)
    # Share of the edge before the foot of the centre of mass; a foot on a corner is no rest.
    foot = -(corners * along).sum(axis=1) / length**2
    rests = (foot > SAME) & (foot < 1.0 - SAME)
    directions = np.mod(np.arctan2(-along[rests, 0], along[rests, 1]), tau)
    directions[directions > tau - SAME] = 0.0
    polar = np.column_stack((np.arctan2(corners[:, 1], corners[:, 0]), np.hypot(*corners.T)))
    return np.sort(directions), polar


def _farthest(corners: FloatArray, before: float, after: float) -> float:
    """Return the direction of the farthest corner between two directions of the fence."""
    width = np.mod(after - before, tau) or tau
    ahead = np.mod(corners[:, 0] - before, tau)
    between = np.flatnonzero(ahead < width)
    best = between[np.argmax(corners[between, 1])]
    return float(np.mod(corners[best, 0], tau))


def _symmetry(stable: FloatArray, borders: FloatArray) -> int:
    """Return the number of equal turns by which stable directions and borders repeat."""
    n = len(stable)
    for parts in range(n, 1, -1):
        if n % parts == 0:
            ahead = np.roll([stable, borders], -n // parts, axis=1)
            if np.abs(wrapped(ahead - [stable, borders] - tau / parts)).max() < SAME:
                return parts
    return 1


# --- search -------------------------------------------------------------------------------------

Turn = tuple[float, float]  # rotation of the fence, and its margin [rad]
Arc = tuple[int, int]  # first stable direction that is possible, and the number of those after it


def _search(function: PushFunction, least: float) -> tuple[tuple[Turn, ...], int] | None:
    """Search arcs of possible stable directions breadth first, with margins of at least `least`.

    Returns the rotations with the index of the last direction; None where there is no plan. Of the
    chains to one arc only the one with the largest smallest margin goes on. Arcs suffice: what a
    push maps into an arc is an arc, since pushes preserve the order of directions.
    """
    n = len(function.stable) // function.symmetry
    # Without a sensor all directions are possible; a plan excludes one of the gaps between them.
    level: dict[Arc, tuple[Turn, ...]] = {(first, n - 1): () for first in range(n)}
    reached = set(level)
    while level:
        known = [arc for arc in level if arc[1] == 0]
        if known:
            best = max(known, key=lambda arc: _smallest(level[arc]))
            return level[best], best[0]
        following: dict[Arc, tuple[Turn, ...]] = {}
        for arc, chain in level.items():
            for rotation, margin, image in _rotations(function, arc):
                if margin < max(least, SAME) or image in reached:
                    continue
                new = (*chain, (rotation, margin))
                if image not in following or _smallest(new) > _smallest(following[image]) + SAME:
                    following[image] = new
        reached |= set(following)
        level = following
    return None


def _smallest(chain: tuple[Turn, ...]) -> float:
    return min((margin for _, margin in chain), default=pi)


def _rotations(function: PushFunction, arc: Arc) -> Iterator[tuple[float, float, Arc]]:
    """Yield rotations in the middle of an interval with one effect, its half-width, and the effect:
    the arc that is possible after the push."""
    period = tau / function.symmetry
    n = len(function.stable) // function.symmetry
    stable = function.stable[:n]
    # Borders of the basins, each before its stable direction.
    borders = stable - np.mod(stable - function.borders[:n], tau)
    turns, ends = np.divmod([arc[0], arc[0] + arc[1]], n)
    ends = stable[ends] + period * turns
    # Rotations at which an end of the arc meets a border.
    limits = np.sort(np.mod(borders - ends[:, None], period).ravel())
    limits = limits[np.diff(limits, append=limits[0] + period) > SAME]
    widths = np.diff(limits, append=limits[0] + period)
    middles = limits + 0.5 * widths
    turns, ahead = np.divmod(ends[:, None] + middles - borders[0], period)
    first, last = np.searchsorted(borders - borders[0], ahead, side="right") - 1 + n * turns
    for rotation, width, begin, more in zip(middles, widths, first, last - first, strict=True):
        if more < n:
            yield float(rotation % period), 0.5 * float(width), (int(begin) % n, int(more))


def _largest_error(function: PushFunction) -> float:
    """Return the largest error of the rotations that some plan survives, to 0.01 degrees [rad]."""
    low, high = 0.0, pi
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _search(function, middle) else (low, middle)
    return low
