"""Pushes of a part that can be made, and the next ones: those that reduce uncertainty most."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
import shapely

from fixel.calibration.objective import ANGLE_SCALE
from fixel.domain.push_bound import PushBound
from fixel.errors import InvalidInput
from fixel.model import Body, Disk, LineDrive, Pusher, Scene, placed
from fixel.model.fields import instance, non_negative, positive, whole
from fixel.model.scene import check_push
from fixel.parts import fit
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray, IntArray

MOVED: Final = 1e-4  # smallest motion of a part that a candidate must cause [m]
MAX_TEXTS: Final = 6  # sentences on what is unseen


@final
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class NextPushes(Result):
    """Proposed next pushes of a part; made by `PartModel.next_pushes`.

    Attributes
    ----------
    order : tuple of int
        Indices of the candidates, the best first.
    names : tuple of str
        Names of these candidates.
    start, end : (k, 2) float64
        Start and end of the pusher's centre in each proposed push, in the part's frame at the start
        [m].
    outline : (m, 2) float64
        Outline of the part in its frame [m].
    radius : float
        Radius of the pusher [m].
    variance : (k + 1,) float64
        Mean variance of the predicted ends of the intended pushes before the first and after each
        [m^2]; angles at 35 mm/rad.
    error : float
        Typical error on parts that were left out, after as many pushes [m].
    misfit : float
        Typical error that no push removes: that of parts with all their pushes [m].
    position, angle : (2,) float64
        Mean typical and mean cautious bound of the intended pushes now [m], [rad]; inf without one.
    bounded : tuple of int
        Number of intended pushes that have a bound, and their number.
    candidates : int
        Number of candidates.
    idle : int
        Number of candidates that were left out: they fail, or do not move the part.
    pushes : int
        Number of pushes of the part that were made.
    unseen : tuple of str
        What no experiment of the known parts has: the part, a surface, a laboratory.
    reasons : tuple of str
        Reasons why intended pushes have no bound.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_parts
    >>> model = fixel.part_model(example_parts(3), progress=False)
    >>> part = example_parts(1, 1, seed=9)[0].scene
    >>> found = model.next_pushes(fixel.push_candidates(part), n=3, part="new", surface="board")
    >>> len(found.order), found.unseen[0][:10]
    (3, "part 'new'")
    >>> bool((found.shrinking < 1.0).all())
    True
    """

    order: tuple[int, ...]
    names: tuple[str, ...]
    start: FloatArray
    end: FloatArray
    outline: FloatArray
    radius: float
    variance: FloatArray
    error: float
    misfit: float
    position: FloatArray
    angle: FloatArray
    bounded: tuple[int, int]
    candidates: int
    idle: int
    pushes: int
    unseen: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()

    @property
    def shrinking(self) -> FloatArray:
        """Expected ratios (k,) of the bound after each push to the bound now.

        Pushes reduce what the error now has above the misfit, as much as the variance.
        """
        if not self.variance[0] > 0.0 or not self.error > self.misfit:
            return np.ones(len(self.order))
        left = self.variance[1:] / self.variance[0]
        floor = (self.misfit / self.error) ** 2
        return np.asarray(np.sqrt(floor + (1.0 - floor) * left))

    def table(self) -> Table:
        """Return the proposed pushes with their expected bounds, typical / cautious."""
        rows = [
            (k + 1, self.name_of(k), *row[:4], *map(_both, (row[4:6], row[6:])))
            for k, row in enumerate(self._numbers())
        ]
        number = (Column(name, format=".1f") for name in
                  ("x [mm]", "y [mm]", "direction [deg]", "travel [mm]"))  # fmt: skip
        return Table(("", "push", *number, "bound [mm]", "bound [deg]"), rows)

    def _data(self) -> Table:
        """Candidate, place, direction and travel of each push, and bounds expected after it."""
        names = ("x_mm", "y_mm", "direction_deg", "travel_mm", "typical_mm", "cautious_mm",
                 "typical_deg", "cautious_deg")  # fmt: skip
        rows = [(self.name_of(k), *row) for k, row in enumerate(self._numbers())]
        return Table(("push", *names), rows)

    def _numbers(self) -> list[tuple[float, ...]]:
        """Return place x, y, direction, travel and four bounds of each push [mm], [deg]."""
        rows = []
        for k, ratio in enumerate(self.shrinking.tolist()):
            way = self.end[k] - self.start[k]
            turn = math.degrees(math.atan2(way[1], way[0]))
            bounds = np.concatenate((1e3 * self.position, np.degrees(self.angle))) * ratio
            place = 1e3 * np.array([*self.start[k], np.hypot(*way)])
            rows.append((*place[:2].tolist(), turn, float(place[2]), *bounds.tolist()))
        return rows

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on the bounds and on candidates that were left out."""
        notes = [
            "place of the pusher and direction in the part's frame; bounds (typical / cautious) are"
            " expected after each push"
        ]
        if self.bounded[0]:
            notes.append(f"bounds of the intended pushes now: {self.now}")
        return (*notes, *self.gaps)

    @property
    def gaps(self) -> tuple[str, ...]:
        """Sentences on intended pushes without a bound and candidates that were left out."""
        (number, total), gaps = self.bounded, []
        if number < total:
            reasons = "; ".join(self.reasons)
            gaps.append(f"{total - number} of {total} intended pushes have no bound: {reasons}")
        if self.idle:
            gaps.append(f"left out: {self.idle} candidates that fail or do not move the part")
        return tuple(gaps)

    @property
    def now(self) -> str:
        """Mean bounds of the intended pushes as text."""
        return ", ".join(
            f"{rule} {1e3 * p:.2f} mm and {math.degrees(a):.2f} deg"
            for rule, p, a in zip(("typical", "cautious"), self.position, self.angle, strict=True)
        )

    def name_of(self, k: int) -> str:
        """Return the name of a proposed push, or its number among the candidates, from 1."""
        name = self.names[k]
        return f"candidate {self.order[k] + 1}" if name == "scene" else name

    def _summary(self) -> Summary:
        return Summary(
            f"NextPushes: {len(self.order)} of {self.candidates} candidates,"
            f" after {self.pushes} pushes",
            [self.table()],
            self.notes,
            unseen=self.unseen,
        )


def _both(bounds: tuple[float, ...]) -> str | None:
    """Return a typical and a cautious bound as text; None without them."""
    return " / ".join(f"{x:.2f}" for x in bounds) if np.isfinite(bounds).all() else None


def propose(
    offered: fit.PartPushes,
    wanted: fit.PartPushes,
    prior: fit.SupportPrior,
    bounds_of: Callable[[FloatArray, BoolArray], Sequence[PushBound]],
    *,
    n: int,
    pushes: int,
    error: float,
    misfit: float,
) -> NextPushes:
    """Propose n pushes among those offered, given the pushes whose ends are wanted.

    `bounds_of` returns the bounds of the wanted pushes, by their features (m, f) and whether their
    simulations converged (m,). `pushes` were made. Typical errors on left-out parts are `error`
    now, and `misfit` of parts with all their pushes [m].
    """
    _refuse_other_parts(offered, wanted)
    moving = _moving(offered, prior)
    features, _, good = fit.bound_features(wanted, np.arange(len(wanted)), prior)
    bounds = bounds_of(features, good)
    intended = fit.slopes(wanted, np.flatnonzero(good), prior)
    chosen, variance = fit.choose_pushes(fit.slopes(offered, moving, prior), intended, n)
    which = moving[chosen]
    some = [own for own in bounds if own.position is not None]
    position, angle = (
        np.mean([[getattr(own, name), getattr(own, f"cautious_{name}")] for own in some], axis=0)
        if some
        else np.full(2, math.inf)
        for name in ("position", "angle")
    )
    texts = dict.fromkeys(text for own in bounds for text in own.unseen)
    return NextPushes(
        order=tuple(which.tolist()),
        names=tuple(offered.targets[k].key for k in which.tolist()),
        start=offered.in_frame(offered.tip_start)[which],
        end=offered.in_frame(offered.tip_end)[which],
        outline=offered.body.shape.outline,
        radius=offered.radius,
        variance=variance,
        error=error,
        misfit=misfit,
        position=position,
        angle=angle,
        bounded=(len(some), len(bounds)),
        candidates=len(offered),
        idle=len(offered) - len(moving),
        pushes=pushes,
        unseen=tuple(texts)[:MAX_TEXTS],
        reasons=tuple(dict.fromkeys(own.reason for own in bounds if own.position is None)),
    )


def _moving(offered: fit.PartPushes, prior: fit.SupportPrior) -> IntArray:
    """Return the candidates that can be simulated and move the part."""
    every = np.arange(len(offered))
    ends, good = fit.simulated(offered, every, prior.best[None])
    away = ends[0] - offered.start
    way = np.hypot(away[:, 0], away[:, 1]) + ANGLE_SCALE * np.abs(away[:, 2])
    moving = np.flatnonzero(good[0] & (way > MOVED))
    if not len(moving):
        failed = f"of which {int(np.sum(~good[0]))} fail and the others do not move the part"
        expected = "at least one push that moves the part"
        raise InvalidInput(
            "candidates", found=f"{len(offered)} pushes, {failed}", expected=expected
        )
    return moving


def _refuse_other_parts(offered: fit.PartPushes, wanted: fit.PartPushes) -> None:
    """Reject pushes of parts with different outlines."""
    outline = offered.body.shape.outline
    for name, pushes in (("candidates", offered), ("intended", wanted)):
        for target in pushes.targets:
            if not np.array_equal(target.case.scene.bodies[0].shape.outline, outline):
                raise InvalidInput(name, found="parts with several outlines", expected="one part")


GAP: Final = 1e-4  # from the tip to the outline at the start [m]
MAX_CONTACTS: Final = 10_000
DIRECTIONS: Final = (-20.0, 0.0, 20.0)  # of the push from the inward normal [deg]


def push_candidates(
    part: Body | Scene,
    *,
    radius: float = 5e-3,
    travel: float = 50e-3,
    speed: float = 20e-3,
    friction: float = 0.25,
    contacts: int = 24,
) -> list[Scene]:
    """Return straight pushes of a part with a round tip, from contacts all around its outline.

    Parameters
    ----------
    part : Body or Scene
        Part at its start pose; a scene with one part and at most one pusher, whose tip is used.
    radius : float
        Radius of the tip [m].
    travel : float
        Length of each push [m].
    speed : float
        Speed of the tip [m/s].
    friction : float
        Friction of the tip on the part [-].
    contacts : int
        Number of contacts, evenly spaced along the outline; each is pushed along the inward normal
        and at 20 degrees to either side. Contacts that the tip cannot reach are left out: in a
        narrow notch, or behind a fixel.

    Returns
    -------
    list of Scene

    Raises
    ------
    InvalidInput
        A length is not positive, the scene has several parts or pushers, its pusher is not round,
        or the tip fits nowhere.

    Examples
    --------
    >>> from fixel import Body, Polygon, UniformPressure
    >>> square = Polygon([(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)])
    >>> part = Body("square", square, mass=0.8, support=UniformPressure(friction=0.3))
    >>> len(push_candidates(part, contacts=8))
    24
    """
    scene = _scene_of(part)
    for tip in scene.pushers:
        radius, friction = float(getattr(tip.shape, "radius", radius)), tip.friction
    positive(radius, "radius", "m"), positive(travel, "travel", "m")
    positive(speed, "speed", "m/s"), non_negative(friction, "friction")
    whole(contacts, "contacts", most=MAX_CONTACTS)
    body = scene.bodies[0]
    neighbours = [placed(own.shape.outline, own.pose) for own in scene.fixels]
    outline = shapely.Polygon(placed(body.shape.outline, body.pose))
    obstacles = shapely.union_all([outline, *map(shapely.Polygon, neighbours)])
    found = []
    for share in (np.arange(contacts) + 0.5) / contacts:
        point, normal = _contact(outline, float(share))
        at = point + (radius + GAP) * normal
        if shapely.distance(obstacles, shapely.Point(at)) < radius:
            continue
        for angle in np.radians(DIRECTIONS).tolist():
            c, s = math.cos(angle), math.sin(angle)
            drive = LineDrive(
                direction=-np.array([[c, -s], [s, c]]) @ normal, speed=speed, travel=travel
            )
            shape = Disk(radius)
            pusher = Pusher("tip", shape, pose=(*at, 0.0), drive=drive, friction=friction)
            found.append(replace(scene, pushers=(pusher,), duration=travel / speed))
    if not found:
        expected = "small enough for the tip to fit next to the part"
        hint = "use a smaller radius or more contacts"
        raise InvalidInput("radius", found=f"{1e3 * radius:.3g} mm", expected=expected, hint=hint)
    return found


def _scene_of(part: Body | Scene) -> Scene:
    """Return a scene with one part and at most one round pusher; reject others."""
    if isinstance(part, Body):
        return Scene(bodies=(part,), duration=1.0)
    instance(part, Scene, "part", "a Body or a Scene")
    check_push(part, "part", pushers=(0, 1))
    if not all(isinstance(tip.shape, Disk) for tip in part.pushers):
        raise InvalidInput("part", found="a pusher that is not round", expected="a disk")
    return part


def _contact(outline: shapely.Polygon, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a point at a share of the way around an outline, and its outward normal."""
    ring = outline.exterior
    step = 1e-4
    at, after = (
        shapely.get_coordinates(ring.interpolate((share + d) % 1.0, normalized=True))[0]
        for d in (0.0, step)
    )
    along = (after - at) / np.hypot(*(after - at))
    outward = np.array([along[1], -along[0]]) * (1.0 if ring.is_ccw else -1.0)
    return at, outward
