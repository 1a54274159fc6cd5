"""One contract for all fields with a `Value`: constructors and files refuse the same."""

from fractions import Fraction
from math import inf, nan

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel import (
    Beyond,
    Contact,
    FreePushes,
    Inside,
    PoseRegion,
    RigError,
    RigPushes,
    StartError,
    model,
)
from fixel.model import (
    Body,
    Disk,
    Ellipsoid,
    Fixel,
    FrictionMap,
    LineDrive,
    Plane,
    Polygon,
    Pusher,
    Scene,
    Spring,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.model.fields import field_types, finite, fraction, non_negative, positive, table, vector
from fixel.sampling import PlannedShape, RegularPolygon
from fixel.testing.scenes import grasp, pushed_square
from fixel.vision.marks import MarkedPart, Sticker, Tag

SQUARE = Polygon([[0, 0], [2, 0], [2, 2], [0, 2]])
BODY = {"name": "a", "shape": SQUARE, "mass": 1.0}
GIVEN = {
    Spring: {"stiffness": 1.0, "anchor": (0, 0)},
    Body: BODY,
    LineDrive: {"speed": 1.0},
    Pusher: {"name": "p", "shape": SQUARE, "friction": 0.2, "pose": (0, 0, 0),
             "drive": LineDrive(speed=1.0)},
    Fixel: {"name": "f", "shape": SQUARE, "friction": 0.2, "pose": (0, 0, 0)},
    Tripod: {"radius": 0.1, "friction": 0.2},
    UniformPressure: {"friction": 0.2},
    Ellipsoid: {"force": 1.0, "torque": 1.0},
    Plane: {},
    FrictionMap: {"origin": (0, 0), "cell": (1, 1), "factor": [[1.0]]},
    Scene: {"bodies": Body(**BODY)},
    PoseRegion: {"pose": (0, 0, 0), "position": 1.0},
    Inside: {"region": SQUARE},
    Beyond: {"line": [(0, 0), (0, 1)]},
    Contact: {"fixel": "f"},
    FreePushes: {},
    RigPushes: {},
    RigError: {},
    StartError: {"x": 1.0, "kind": "normal"},
    RegularPolygon: {"sides": 4, "side": 1.0},
    PlannedShape: {"name": "a", "outline": Disk(1.0), "mass": 1.0, "zone_start": 0.1},
    Tag: {"id": 1, "size": 0.1, "height": 0.1},
    Sticker: {"colour": "red", "diameter": 0.1, "place": (0, 0), "height": 0.1},
    MarkedPart: {"height": 0.1},
}  # fmt: skip


def _masked(*shape):
    """Return an array whose last value is masked, under which NumPy still has a number."""
    array = np.ma.masked_array(np.ones(shape))
    array[(-1,) * len(shape)] = np.ma.masked
    return array


NOT_A_NUMBER = (nan, "1", True, 10**400, np.timedelta64(1, "s"), np.timedelta64(1, "ns"))
BAD = {
    finite: (*NOT_A_NUMBER, inf),
    positive: (*NOT_A_NUMBER, 0.0, -1.0),
    non_negative: (*NOT_A_NUMBER, -0.1),
    fraction: (*NOT_A_NUMBER, -0.1, 1.1),
    vector: ((0.0,), (0.0, 0.0, 0.0, 0.0), "north", 1.0, _masked(2), _masked(3)),
    table: ([], [[0.0]], "path", _masked(1, 2), _masked(2, 3), _masked(2, 4)),
}
FIELDS = [
    (kind, name, own.value.check)
    for kind in GIVEN
    for name, own in field_types(kind).items()
    if own.value is not None
]


@pytest.mark.parametrize(
    ("kind", "name", "check"), FIELDS, ids=[f"{k.__name__}.{n}" for k, n, _ in FIELDS]
)
def test_a_value_that_cannot_be_is_refused_at_its_field(kind, name, check):
    kind(**GIVEN[kind])
    for bad in BAD[check]:
        assert refused(kind, **{**GIVEN[kind], name: bad}).where.partition("[")[0].endswith(name)


def test_a_masked_number_is_refused_and_numbers_of_any_kind_are_read():
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    lost = np.ma.masked_array(corners, mask=corners == 2.0)
    refused(Polygon, lost, match="polygon.* masked values")
    refused(SupportPoints, points=corners, friction=np.ma.masked_less([0.2, 0.3, 0.2, -1.0], 0.0),
            match="friction.* masked values")  # fmt: skip
    halves = np.vectorize(Fraction, otypes=[object])(corners)
    assert Polygon(halves) == Polygon(np.ma.masked_array(corners)) == SQUARE
    for wrong in (None, "0", True, 1j, np.timedelta64(0, "s")):
        refused(Polygon, np.where(corners == 0.0, wrong, halves), match="x .m., y .m.")


def test_nullable_numbers_of_pandas_are_read_and_missing_ones_refused():
    pandas = pytest.importorskip("pandas")
    corners = pandas.DataFrame([[0, 0], [2, 0], [2, 2], [0, 2]], index=list("abcd"))
    assert Polygon(corners.astype("Float64")) == SQUARE
    refused(Polygon, corners.astype("Int64").replace(2, pandas.NA), match="rows of 2 numbers")


def test_values_are_stored_as_floats_and_frozen_arrays():
    body = Body("a", SQUARE, mass=1, pose=[0, -0.0, 1])
    assert type(body.mass) is float
    assert not np.signbit(body.pose[1])
    with pytest.raises(ValueError, match="read-only"):
        body.pose[0] = 1.0


@pytest.mark.parametrize("scene", [pushed_square(), grasp("seated")], ids=["push", "grasp"])
def test_a_printed_scene_is_the_call_that_makes_it(scene):
    public = {name: getattr(fixel, name) for name in {*dir(model)} & {*fixel.__all__}}
    assert eval(repr(scene), public) == scene
    assert "inertia" not in repr(scene)  # a usual value


def test_a_long_path_is_printed_by_its_shape():
    points = np.column_stack((np.arange(61.0), np.zeros((61, 3))))
    assert repr(fixel.PathDrive(points)) == "PathDrive(waypoints=<array of (61, 4)>)"
