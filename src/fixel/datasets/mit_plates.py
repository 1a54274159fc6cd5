"""Plates and tip of the MIT push dataset: outlines, masses, and known doubts about its records.

Source: K.-T. Yu, M. Bauza, N. Fazeli, A. Rodriguez (2016), More than a million ways to be pushed,
IROS.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from fixel.datasets.base import guarded, remark
from fixel.datasets.files import Problems, member
from fixel.errors import FixelError, InvalidInput
from fixel.model import Body, Disk, Flag, Polygon, Shape, UniformPressure
from fixel.typing import FloatArray

DATASET: Final = "mit-push"
OBJECT: Final = "object"
SHAPES: Final = "shapes.json"

TIP: Final = Disk(4.75e-3)  # of steel

# Nominal friction: at the tip as in the published simulator; that of the plane has no effect on
# quasi-static motion.
MU_PUSHER, MU_SUPPORT = 0.25, 0.3

# Masses of steel plates [kg], which the dataset's README quotes from the paper.
MASSES = {
    "rect1": 0.837, "rect2": 1.045, "rect3": 1.251, "tri1": 0.803, "tri2": 0.983, "tri3": 1.133,
    "ellip1": 0.894, "ellip2": 1.110, "ellip3": 1.334, "hex": 0.983, "butter": 1.197,
}  # fmt: skip

# Mass of other plates by area [kg/m^2]: 13 mm of steel.
MASS_PER_AREA = 0.013 * 7950.0

# Corners of the polygon that approximates an ellipse: at most 0.02 mm inside one of 65 mm.
ELLIPSE_CORNERS = 128

# Surfaces and shapes whose registration is off by 1 to 3 mm in all pushes.
SYSTEMATIC = frozenset(("plywood", shape) for shape in ("ellip2", "ellip3", "hex", "rect2"))
# Surface, shape and speed [m/s] of pushes that no published model explains.
UNEXPLAINED = ("abs", "rect1", 0.02)


def plate(name: str, shape: Shape, start: FloatArray) -> Body:
    """Create a plate with even pressure, of the mass in the paper or else by its area."""
    return Body(
        name=OBJECT,
        shape=shape,
        mass=MASSES.get(name, MASS_PER_AREA * shape.area),
        pose=start,
        support=UniformPressure(friction=MU_SUPPORT),
    )


def shapes_of(content: Mapping[str, Any]) -> tuple[dict[str, Shape], Problems]:
    """Return the outlines in a shapes.json, and the errors of those that cannot be read."""
    shapes: dict[str, Shape] = {}
    problems: Problems = {}
    for name, value in content.items():
        try:
            with guarded(f"{SHAPES}: {name}"):
                shapes[name] = _shape(f"{SHAPES}: {name}", value)
        except FixelError as problem:
            problems[name] = problem
    return shapes, problems


def _shape(where: str, value: Any) -> Shape:
    try:
        if isinstance(value, list):
            return Polygon(np.array(value, dtype=np.float64))
        kind = member(value, "type", where)
        if kind == "ellipse":
            axes = (member(value, f"semi_axis_{axis}_m", where) for axis in "xy")
            return _ellipse(*axes)
        if kind == "polygon":
            return Polygon(member(value, "vertices_m", where))
    except InvalidInput as problem:
        raise problem if problem.where == where else problem.within(where) from None
    raise InvalidInput(where, found=kind, expected="the type polygon or ellipse")


def _ellipse(semi_axis_x: float, semi_axis_y: float) -> Shape:
    """Build an ellipse about the origin [m]: a disk, or a polygon with corners on the curve."""
    if semi_axis_x == semi_axis_y:
        return Disk(semi_axis_x)
    angle = np.arange(ELLIPSE_CORNERS) * (2.0 * math.pi / ELLIPSE_CORNERS)
    return Polygon(np.column_stack((semi_axis_x * np.cos(angle), semi_axis_y * np.sin(angle))))


def known_doubts(surface: str, shape: str, speed: float) -> Iterator[Flag]:
    """Yield remarks on pushes of which the dataset's users know that something is wrong."""
    if (surface, shape) in SYSTEMATIC:
        yield remark("systematic-offset", f"{shape} on {surface} is registered 1 to 3 mm off")
    if (surface, shape) == UNEXPLAINED[:2] and abs(speed - UNEXPLAINED[2]) < 1e-6:
        yield remark(
            "unexplained-error", "the errors of published models are twice the usual error"
        )
