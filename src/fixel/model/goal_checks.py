"""Checks of goals against a scene: names, symmetry, contradictions, the field, the start.

Whether clauses can be met together is decided on a grid of angles. At each angle a clause allows a
set of positions, which contains all that it allows up to half a step of the grid; so a goal that
can be met is never rejected, and one that misses by less than 0.5 % of the part's radius may pass.
"""

from __future__ import annotations

from itertools import combinations
from math import pi
from typing import Any, Final

import numpy as np
import shapely

from fixel.errors import InvalidInput
from fixel.model import goals
from fixel.model.bodies import Body
from fixel.model.overlap import overlap_depth
from fixel.model.scene import Scene
from fixel.model.shape import Disk, Polygon, placed
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray

STEP: Final = pi / 360.0  # [rad] of the grid of angles; larger ones miss more contradictions
ANGLES: Final = np.arange(-pi, pi, STEP)

# Difference of the area of an outline and of itself, rotated, as a share of the area, up to which
# it is symmetric: outlines are measured to a few tenths of a percent.
ASYMMETRY: Final = 0.02


def check_goal(goal: goals.Goal, scene: Scene, field: Polygon | None = None) -> None:
    """Raise `InvalidInput` for a goal that does not fit a scene, or that no pose meets.

    Faults are an unknown fixel or body; an outline without the stated symmetry; a region into which
    the part does not fit; clauses that no pose meets together; a pose inside a fixel; an event that
    the start already has; a goal outside the field, the region in which parts may be [m], such as
    the plate or the view of the camera.

    Examples
    --------
    >>> from fixel import AllOf, PoseRegion
    >>> from fixel.testing.scenes import pushed_square
    >>> left, right = (PoseRegion((x, 0, 0), position=0.01) for x in (-0.1, 0.1))
    >>> check_goal(AllOf(left, right), pushed_square())
    Traceback (most recent call last):
        ...
    fixel.errors.InvalidInput: goal: found clauses that no pose meets together: the part ...
    """
    for clause in goal.clauses:
        _check_names(clause, scene)
    for clause in goal.clauses:
        if not _possible([clause], scene):
            raise _impossible(clause, scene)
        if field is not None and not _possible(
            [clause, goals.Inside(field, body=clause.body)], scene
        ):
            found = f"{clause}, which is outside the field"
            expected = f"a goal within {goals.box_text(field)}"
            raise InvalidInput("goal", found=found, expected=expected)
    _check_together(goal, scene)
    for event in _events(goal):
        _check_start(event, scene)


def _check_names(clause: goals.Clause, scene: Scene) -> None:
    body = goals.body_of(scene, clause.body)
    fixels = clause.fixels if isinstance(clause, goals.Seated) else ()
    for name in (clause.fixel,) if isinstance(clause, goals.Contact) else fixels:
        goals.check_fixel(name, scene)
    if isinstance(clause, goals.PoseRegion):
        _check_symmetry(clause, body)
        _check_fixels_clear(clause, body, scene)


def _check_symmetry(clause: goals.PoseRegion, body: Body) -> None:
    if clause.symmetry == 1 or isinstance(body.shape, Disk):
        return
    own = shapely.Polygon(body.shape.vertices)
    first, second = (
        shapely.Polygon(placed(own.exterior.coords[:-1], target))
        for target in clause.targets(body)[:2]
    )
    share = first.symmetric_difference(second).area / own.area
    if share > ASYMMETRY:
        raise InvalidInput(
            "goal.symmetry",
            found=f"{clause.symmetry}, but a rotation by {360 / clause.symmetry:.4g} deg changes"
            f" {100 * share:.0f} % of {body.name!r}",
            expected="the number of rotations by which the outline covers itself",
        )


def _check_fixels_clear(clause: goals.PoseRegion, body: Body, scene: Scene) -> None:
    """Raise if each pose of the region overlaps a fixel: depth changes no faster than points do."""
    if clause.position is None:
        return
    arm = float(np.hypot(*(_outline(body, 0.0) - body.shape.centroid).T).max())
    arm = 0.0 if isinstance(body.shape, Disk) else arm
    moved = clause.position + arm * (pi if clause.angle is None else clause.angle)
    for fixel in scene.fixels:
        depths = [
            overlap_depth(body.shape, target, fixel.shape, fixel.pose)
            for target in clause.targets(body)
        ]
        if min(depths) > moved:
            found = f"a pose that overlaps {fixel.name!r} by {1e3 * min(depths):.3g} mm"
            expected = "a pose clear of the fixels"
            raise InvalidInput("goal.pose", found=found, expected=expected)


# --- positions that clauses allow -----------------------------------------------------------------


def _possible(clauses: list[goals.Clause], scene: Scene) -> bool:
    """Return whether some pose of each body may meet all of its clauses."""
    for body in scene.bodies:
        own = [clause for clause in clauses if goals.body_of(scene, clause.body) is body]
        if own and not any(_meet(own, scene, body, float(angle)) for angle in ANGLES):
            return False
    return True


def _meet(clauses: list[goals.Clause], scene: Scene, body: Body, angle: float) -> bool:
    area: Any = None
    for clause in clauses:
        own = _positions(clause, scene, body, angle)
        area = own if area is None or own is None else area.intersection(own)
        if area is not None and area.is_empty:
            return False
    return True


def _positions(clause: goals.Clause, scene: Scene, body: Body, angle: float) -> Any:
    """Return the positions of a body's frame that a clause allows near an angle; None for all."""
    slack = 0.5 * STEP * body.shape.radius
    if isinstance(clause, goals.PoseRegion):
        return _near(clause, body, angle, slack)
    if isinstance(clause, goals.Seated):
        slack += body.shape.radius + goals.tolerance_of(clause.tolerance, body)
        fixels = [fixel for fixel in scene.fixels if fixel.name in clause.fixels]
        discs = [_disc(fixel.pose[:2], slack + fixel.shape.radius) for fixel in fixels]
        return shapely.intersection_all(discs)
    if isinstance(clause, goals.Inside | goals.Exit):
        slack += goals.tolerance_of(clause.tolerance, body)
        return _half_planes(goals.hull_lines(clause.region), _outline(body, angle), slack)
    if isinstance(clause, goals.Beyond):
        slack += goals.tolerance_of(clause.tolerance, body)
        feature = clause.feature
        points = _outline(body, angle) if feature is None else placed([feature], (0, 0, angle))
        return _half_planes(clause.half_plane, points, slack)
    return None


def _near(clause: goals.PoseRegion, body: Body, angle: float, slack: float) -> Any:
    off = np.abs(wrapped(clause.symmetry * (angle - clause.pose[2]))) / clause.symmetry
    if clause.angle is not None and off > clause.angle + 0.5 * STEP:
        return shapely.Point()
    if clause.position is None:
        return None
    centre = placed(body.shape.centroid, clause.pose)
    offset = placed(body.shape.centroid, (0.0, 0.0, angle))
    return _disc(centre - offset, clause.position + slack)


def _disc(centre: Any, radius: float) -> Any:
    return shapely.Point(centre).buffer(1.01 * radius)  # a polygon that contains the disc


def _outline(body: Body, angle: float) -> FloatArray:
    scale = 1.0 if not isinstance(body.shape, Disk) else np.cos(pi / len(body.shape.outline))
    return scale * placed(body.shape.outline, (0.0, 0.0, angle))


def _half_planes(lines: tuple[FloatArray, FloatArray], points: FloatArray, slack: float) -> Any:
    """Return the positions at which all points are inside all lines, within a slack."""
    inward, offset = lines
    reach = offset - slack - (points @ inward.T).min(axis=0)
    far = 1e3 * (np.abs(reach).max() + np.ptp(points, axis=0).max() + slack)
    area = shapely.box(-far, -far, far, far)
    for normal, own in zip(inward, reach, strict=True):
        along = 4.0 * far * np.array([normal[1], -normal[0]])
        near = own * normal
        deep = near + 4.0 * far * normal
        area = area.intersection(
            shapely.Polygon([near - along, near + along, deep + along, deep - along])
        )
    return area


# --- clauses together -----------------------------------------------------------------------------


def _check_together(goal: goals.Goal, scene: Scene) -> None:
    """Raise if the clauses of every alternative contradict each other."""
    ways = _alternatives(goal)
    contradictions = [_contradiction(list(way), scene) for way in ways]
    if all(contradictions):
        pair = contradictions[0]
        found = f"clauses that no pose meets together: {'; '.join(map(str, pair))}"
        expected = "clauses that one pose can meet"
        raise InvalidInput("goal", found=found, expected=expected)


def _alternatives(goal: goals.Goal) -> list[tuple[goals.Clause, ...]]:
    """Return sets of clauses each of which suffices for the goal."""
    if isinstance(goal, goals.AnyOf):
        return [way for own in goal.goals for way in _alternatives(own)]
    if not isinstance(goal, goals.AllOf):
        return [goal.clauses]
    ways: list[tuple[goals.Clause, ...]] = [goal.never]
    for own in goal.goals:
        ways = [(*first, *second) for first in _alternatives(own) for second in ways]
    return ways


def _contradiction(clauses: list[goals.Clause], scene: Scene) -> list[goals.Clause]:
    """Return clauses that contradict each other, a pair if possible; none if they do not."""
    touched = {name: own for own in clauses if isinstance(own, goals.Seated) for name in own.fixels}
    for own in clauses:
        if isinstance(own, goals.Contact) and own.fixel in touched:
            return [touched[own.fixel], own]
    for pair in combinations(clauses, 2):
        if not _possible(list(pair), scene):
            return list(pair)
    return [] if _possible(clauses, scene) else clauses


def _impossible(clause: goals.Clause, scene: Scene) -> InvalidInput:
    body = goals.body_of(scene, clause.body)
    if isinstance(clause, goals.Seated):
        return InvalidInput(
            "goal.fixels",
            found=f"fixels too far apart for {body.name!r}: {', '.join(clause.fixels)}",
            expected="fixels that it can touch at once",
        )
    found = f"{clause}, where {body.name!r} does not fit"
    expected = "a region that contains the part at some angle"
    return InvalidInput("goal.region", found=found, expected=expected)


def _events(goal: goals.Goal) -> list[goals.Clause]:
    inner = [event for own in getattr(goal, "goals", ()) for event in _events(own)]
    return [*inner, *getattr(goal, "never", ())]


def _check_start(event: goals.Clause, scene: Scene) -> None:
    if not isinstance(event, goals.Contact | goals.Exit):
        return
    body = goals.body_of(scene, event.body)
    if not event.met(scene, goals.BodyTrack.of_ends(body.pose))[0]:
        found = f"{event}, which the start already does"
        expected = "an event that has not happened at the start"
        raise InvalidInput("goal.never", found=found, expected=expected)
