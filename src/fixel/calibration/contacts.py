"""Contacts of pushes: which sides of a part, places on them and speeds have been pushed.

Bounds on errors are learned from pushes. A side that was never pushed, or a speed, can be close to
these in all features and still be unlike them in what the side or the speed itself does.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Final, NamedTuple, final

import numpy as np
import shapely

from fixel.errors import InvalidInput
from fixel.model import Disk, Shape, rotated, wrapped
from fixel.typing import FloatArray, IntArray

# A contact is new where it differs by more than this from every pushed one of the part.
MAX_TURN: Final = float(np.radians(20.0))  # of the outline's normal, in the frame of the part [rad]
MAX_DISTANCE: Final = 0.5  # along the outline, in radii of a disk of the part's area [-]
MAX_RATIO: Final = 1.25  # of speeds [-]

# The condition of an experiment that says where the pusher stands around the part.
CONTACT_ANGLE: Final = "contact_angle_rad"

SIDE: Final = "side"
SPEED: Final = "speed"
BOTH: Final = "side and speed"
PART: Final = "part"


class Configurations(NamedTuple):
    """Intended straight pushes of one object by a round pusher."""

    shape: Shape
    radius: float  # radius of the pusher [m]
    start: FloatArray  # (n, 3) pose of the object [m, m, rad]
    tip_start: FloatArray  # (n, 2) centre of the pusher [m]
    tip_end: FloatArray  # (n, 2)


class TouchedPlaces(NamedTuple):
    """Places and speeds at which pushers touch parts."""

    # (n,) Direction of the outward normal at the contact, in the frame of the part [rad].
    normal: FloatArray
    # (n, 2) Contact point from the centroid, in the frame of the part, in radii of a disk of the
    # same area [-].
    place: FloatArray
    speed: FloatArray  # (n,) speed of the pusher [m/s]

    def rows(self, which: IntArray) -> TouchedPlaces:
        """Return some of them."""
        return TouchedPlaces(self.normal[which], self.place[which], self.speed[which])

    @classmethod
    def joined(cls, parts: Sequence[TouchedPlaces]) -> TouchedPlaces:
        """Return several tables as one."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def contacts_of(asked: Configurations, speed: FloatArray) -> TouchedPlaces:
    """Return the first contact of straight pushes at speeds (n,) [m/s]."""
    gap, normal = gaps_and_normals(asked.shape, asked.radius, asked.start, asked.tip_start)
    point = asked.tip_start - (asked.radius + gap)[:, None] * normal - asked.start[:, :2]
    normal, point = (rotated(own, -asked.start[:, 2]) for own in (normal, point))
    place = (point - np.asarray(asked.shape.centroid)) / np.sqrt(asked.shape.area / np.pi)
    return TouchedPlaces(np.arctan2(normal[:, 1], normal[:, 0]), place, np.asarray(speed))


class Novelty(NamedTuple):
    """Kind of novelty of each contact, with its reason."""

    # (n,) `"side"`, `"speed"`, `"side and speed"` or `"part"`; empty for contacts like pushed ones.
    kind: tuple[str, ...]
    reason: tuple[str, ...]  # (n,) the same as a sentence


@final
class PushedContacts:
    """Contacts that have been pushed, by the label of their part.

    Pushes of one part are no data for another.
    """

    def __init__(self, contacts: TouchedPlaces, parts: Sequence[Hashable]) -> None:
        _check(contacts, len(parts))
        rows: dict[Hashable, list[int]] = {}
        for k, part in enumerate(parts):
            rows.setdefault(part, []).append(k)
        self._known = {part: contacts.rows(np.array(own)) for part, own in rows.items()}

    def novelty(self, contacts: TouchedPlaces, parts: Sequence[Hashable]) -> Novelty:
        """Return what is new about other contacts."""
        _check(contacts, len(parts))
        found = [self._one(contacts.rows(np.array([k])), part) for k, part in enumerate(parts)]
        return Novelty(tuple(kind for kind, _ in found), tuple(reason for _, reason in found))

    def _one(self, asked: TouchedPlaces, part: Hashable) -> tuple[str, str]:
        known = self._known.get(part)
        if known is None:
            return PART, "no experiment with this part"
        turn = np.abs(wrapped(known.normal - asked.normal))
        away = np.linalg.norm(known.place - asked.place, axis=1)
        speed = float(asked.speed[0])
        fast = (known.speed <= MAX_RATIO * speed) & (speed <= MAX_RATIO * known.speed)
        on_side = turn <= MAX_TURN
        near = on_side & (away <= MAX_DISTANCE)
        if (near & fast).any():
            return "", ""
        said = []
        if not on_side.any():
            apart = np.degrees(turn.min())
            said.append(
                f"side never pushed: its normal is {apart:.0f} degrees from those of all pushed "
                "sides"
            )
        elif not near.any():
            apart = away[on_side].min()
            said.append(
                f"contact point never pushed: {apart:.2g} part radii from all pushes on this side"
            )
        at_speed = f"{1e3 * speed:.3g} mm/s"
        if not fast.any():
            nearest = 1e3 * known.speed[np.abs(np.log(known.speed / speed)).argmin()]
            said.append(f"speed never pushed: {at_speed}, nearest {nearest:.3g} mm/s")
        if not said:
            said.append(f"side never pushed at {at_speed}")
        kind = BOTH if len(said) == 2 else SPEED if near.any() else SIDE
        return kind, "; ".join(said)


def _check(contacts: TouchedPlaces, n: int) -> None:
    shapes = (contacts.normal.shape, contacts.place.shape, contacts.speed.shape)
    if shapes != ((n,), (n, 2), (n,)):
        raise InvalidInput(
            "contacts", found=f"shapes {shapes}", expected=f"({n},), ({n}, 2), ({n},)"
        )
    if not all(np.isfinite(column).all() for column in contacts):
        raise InvalidInput(
            "contacts", found="numbers that are not finite", expected="finite numbers"
        )
    if (contacts.speed <= 0.0).any():
        raise InvalidInput("contacts.speed", found="0 or less", expected="positive speeds [m/s]")


def gaps_and_normals(
    shape: Shape, radius: float, pose: FloatArray, tip: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the gaps (n,) between round tips and an outline, and the outward normals (n, 2).

    Poses (n, 3) of the object [m, m, rad] and centres (n, 2) of the tip [m] are in the world, and
    so are normals. Gaps [m] are negative for overlap. Exact for convex outlines.
    """
    local = rotated(tip - pose[:, :2], -pose[:, 2])
    if isinstance(shape, Disk):
        distance, away = np.hypot(*local.T) - shape.radius, local
    else:
        distance, away = _from_polygon(shape.outline, local)
    length = np.hypot(*away.T)[:, None]
    normal = np.divide(away, length, out=np.zeros_like(away), where=length > 0.0)
    return distance - radius, rotated(normal, pose[:, 2])


def _from_polygon(outline: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return signed distances (n,), and vectors (n, 2) that point outward."""
    polygon = shapely.Polygon(outline)
    points = shapely.points(point)
    along = shapely.line_locate_point(polygon.exterior, points)
    nearest = shapely.get_coordinates(shapely.line_interpolate_point(polygon.exterior, along))
    sign = np.where(shapely.contains(polygon, points), -1.0, 1.0)
    away = sign[:, None] * (point - nearest)
    return sign * np.hypot(*away.T), away
