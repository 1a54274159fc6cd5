"""Straight 50 mm pushes of the MIT push dataset: poses at start and end.

Source: K.-T. Yu, M. Bauza, N. Fazeli, A. Rodriguez (2016), More than a million ways to be pushed,
IROS. The table also has the predictions of the quasi-static simulator of J. Zhou.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.raw.base import MM, CsvRows, ellipse, member, only_file, read_json, read_table
from fixel.errors import InvalidInput
from fixel.model import Polygon, Shape
from fixel.typing import FloatArray

PUSHES = ("pushes.csv.gz", "pushes.csv")
SHAPES = "shapes.json"

# Radius of the steel tip [m] and nominal length of a stroke [m].
PUSHER_RADIUS = 4.75e-3
STROKE = 50e-3

# Masses of steel plates [kg], which the dataset's README quotes from the paper.
MASSES = {
    "rect1": 0.837, "rect2": 1.045, "rect3": 1.251, "tri1": 0.803, "tri2": 0.983, "tri3": 1.133,
    "ellip1": 0.894, "ellip2": 1.110, "ellip3": 1.334, "hex": 0.983, "butter": 1.197,
}  # fmt: skip

# Mass of other plates by area [kg/m^2]: 13 mm of steel.
MASS_PER_AREA = 0.013 * 7950.0


@final
@dataclass(frozen=True, slots=True)
class MitPushes:
    """Pushes at constant speed along a straight line.

    Attributes
    ----------
    table : CsvRows
        Rows of the file; every array below has one row for each.
    shapes : mapping from name to Shape
        Outlines in the frame of the dataset's poses.
    start, end : (n, 3) float64
        Measured poses of the object [m, m, rad].
    tip_start, tip_end : (n, 2) float64
        Measured centres of the tip [m].
    speed : (n,) float64
        Speed of the tip [m/s].
    gap_start, gap_end : (n,) float64
        Gap from the surface of the tip to the outline [m].
    predictions : mapping from name to (n, 3) float64
        End pose by the published simulator, one per limit surface; NaN if missing.
    """

    name: ClassVar[str] = "mit_push_endpoints"
    folder: Path
    table: CsvRows
    shapes: dict[str, Shape]
    start: FloatArray
    end: FloatArray
    tip_start: FloatArray
    tip_end: FloatArray
    speed: FloatArray
    gap_start: FloatArray
    gap_end: FloatArray
    predictions: dict[str, FloatArray]

    def __len__(self) -> int:
        return len(self.start)

    @property
    def surface(self) -> NDArray[np.str_]:
        """Name of the surface of each push, (n,)."""
        return self.table.text("surface")

    @property
    def shape(self) -> NDArray[np.str_]:
        """Name of the shape of each push, (n,)."""
        return self.table.text("shape")

    @property
    def stroke(self) -> FloatArray:
        """Distance of the tip from start to end of each push, (n,) [m]."""
        dx, dy = (self.tip_end - self.tip_start).T
        return np.asarray(np.hypot(dx, dy), dtype=np.float64)


def recognised(folder: Path) -> bool:
    """Whether a folder contains this dataset."""
    return any((folder / name).is_file() for name in PUSHES) and (folder / SHAPES).is_file()


def read(folder: Path) -> MitPushes:
    """Load all pushes of a folder."""
    table = read_table(only_file(folder, *PUSHES))
    table.require(["push_id", "surface", "shape"])
    shapes = shapes_of(read_json(only_file(folder, SHAPES)))
    for name in np.unique(table.text("shape")):
        if str(name) not in shapes:
            raise InvalidInput(
                table.source,
                found=f"the shape {name}",
                expected=f"one of those in {SHAPES}: {', '.join(shapes)}",
            )
    speed = table.numbers("speed_mm_s") * MM
    if (speed <= 0.0).any():
        raise InvalidInput(
            f"{table.source}, row {int(np.argmax(speed <= 0.0)) + 1}, column speed_mm_s",
            found=float(speed.min() / MM),
            expected="a positive speed [mm/s]",
        )
    return MitPushes(
        folder=folder,
        table=table,
        shapes=shapes,
        start=table.stacked("obj_x0", "obj_y0", "obj_th0"),
        end=table.stacked("obj_x1", "obj_y1", "obj_th1"),
        tip_start=table.stacked("tip_x0", "tip_y0"),
        tip_end=table.stacked("tip_x1", "tip_y1"),
        speed=speed,
        gap_start=table.numbers("gap0_mm") * MM,
        gap_end=table.numbers("gap1_mm") * MM,
        predictions={
            name: table.stacked(
                *(f"author_{name}_{axis}1" for axis in ("x", "y", "th")), blank=True
            )
            for name in ("poly4", "quad")
            if f"author_{name}_x1" in table.columns
        },
    )


def mass_of(name: str, shape: Shape) -> float:
    """Mass of a plate [kg], from the paper or else from its area."""
    return MASSES.get(name, MASS_PER_AREA * shape.area)


def shapes_of(content: dict[str, Any]) -> dict[str, Shape]:
    return {name: _shape(f"{SHAPES}: {name}", value) for name, value in content.items()}


def _shape(where: str, value: Any) -> Shape:
    kind = member(value, "type", where)
    try:
        if kind == "ellipse":
            return ellipse(
                member(value, "semi_axis_x_m", where), member(value, "semi_axis_y_m", where)
            )
        if kind == "polygon":
            return Polygon(member(value, "vertices_m", where))
    except InvalidInput as problem:
        raise problem if problem.where == where else problem.within(where) from None
    raise InvalidInput(where, found=kind, expected="the type polygon or ellipse")
