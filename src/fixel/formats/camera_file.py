"""Camera files, YAML: a lens, its pose above the plate, and the uncertainty of both.

Pixels count from the centre of the upper left one; coefficients are in OpenCV's order.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from fixel.errors import InvalidInput
from fixel.formats.records import (
    FileRecord,
    NonNegative,
    Number,
    Point,
    Positive,
    Triple,
    built,
    only_form,
    si_fields,
    unit_content,
    validated,
    within,
)
from fixel.io.atomic import written_whole
from fixel.io.document import read_document, yaml_text
from fixel.vision.camera import Camera, MeasuredCamera
from fixel.vision.lens import Lens

Size = Annotated[list[Annotated[int, Field(gt=0)]], Field(min_length=2, max_length=2)]
Matrix = Annotated[list[Triple], Field(min_length=3, max_length=3)]


class LensRecord(FileRecord):
    image_size_px: Size = Field(description="width and height of the pictures [px]")
    focal_px: Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        description="focal lengths along u, v [px]"
    )
    centre_px: Point = Field(description="principal point: u, v [px]")
    skew: Number = Field(0.0, description="skew: alpha_c of the MATLAB toolbox [-]")
    distortion: Annotated[list[Number], Field(max_length=8)] = Field(
        [],
        description="distortion coefficients k1 k2 p1 p2 k3 k4 k5 k6, or k1 to k4 with fisheye [-]",
    )
    fisheye: bool = Field(
        False, description="whether the lens has the equidistant model of Kannala and Brandt"
    )


class LookingRecord(FileRecord):
    height_mm: Positive = Field(description="height of the camera above the plate [mm]")
    above_mm: Point = Field([0.0, 0.0], description="world position below the camera [mm]")
    turned_deg: Number = Field(0.0, description="angle from world x to the picture's right [deg]")
    tilted_deg: Point = Field(
        [0.0, 0.0], description="tilt of the optical axis, down and right in the picture [deg]"
    )


class MatrixRecord(FileRecord):
    rotation: Matrix = Field(description="rotation camera_from_world: x right, y down, z away")
    translation_mm: Triple = Field(description="world origin in camera axes [mm]")


class PlaceRecord(FileRecord):
    """Pose of a camera, in exactly one form."""

    looking: LookingRecord | None = Field(None, description="pose of a camera that looks down")
    matrix: MatrixRecord | None = Field(None, description="pose as rotation and translation")


class MeasuredRecord(FileRecord):
    names: list[str] = Field([], description="names of the estimated parameters: fx, k1, tz, ...")
    covariance: list[list[Number]] = Field(
        [], description="covariance of these parameters [px, -, rad, m]"
    )
    noise_px: Positive | None = Field(
        None, description="standard deviation of a corner along each axis [px]"
    )
    seen: list[list[NonNegative]] = Field(
        [], description="number of board corners by cell of the picture"
    )


class CameraRecord(FileRecord):
    """Content of a camera file."""

    fixel_camera: Literal[1] = Field(1, description="version of the format")
    source: str = Field("", description="origin of the calibration, as text")
    lens: LensRecord
    place: PlaceRecord | None = Field(
        None, description="pose above the plate; missing until the camera is placed"
    )
    measured: MeasuredRecord | None = Field(None, description="uncertainty of the calibration")


def load_camera(path: str | Path) -> MeasuredCamera:
    """Load a camera file: YAML, or JSON if the name ends in `.json`.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.
    """
    raw = read_document(Path(path))
    if not isinstance(raw, dict) or "lens" not in raw:
        raise InvalidInput(
            str(path),
            found="no lens in it",
            expected="a camera file of fixel",
            hint="to import a file of MATLAB, OpenCV, Kalibr or ROS: fixel camera import FILE",
        )
    with within(str(path)):
        return camera_from_dict(raw)


def camera_from_dict(raw: Any) -> MeasuredCamera:
    """Build a camera from the content of a camera file, as dicts and lists."""
    record = validated(CameraRecord, raw, "camera")
    lens = _lens(record.lens)
    measured = record.measured or MeasuredRecord.model_validate({})
    with within("measured", "measured."):
        return MeasuredCamera(
            lens=lens,
            camera=_camera(lens, record.place),
            names=tuple(measured.names),
            covariance=_rows(measured.covariance, "covariance"),
            noise=measured.noise_px,
            seen=_rows(measured.seen, "seen"),
            source=record.source,
        )


def camera_dict(camera: MeasuredCamera) -> dict[str, Any]:
    """Content of a camera file, as dicts and lists."""
    content: dict[str, Any] = {"fixel_camera": 1}
    if camera.source:
        content["source"] = camera.source
    content["lens"] = unit_content(camera.lens, LensRecord)
    if camera.camera is not None:
        content["place"] = {"matrix": unit_content(camera.camera, MatrixRecord)}
    measured: dict[str, Any] = {}
    if camera.names:
        measured |= {"names": list(camera.names), "covariance": camera.covariance.tolist()}
    if camera.noise is not None:
        measured["noise_px"] = camera.noise
    if camera.seen.size:
        measured["seen"] = [[int(n) for n in row] for row in camera.seen]
    return content | ({"measured": measured} if measured else {})


def save_camera(camera: MeasuredCamera, path: str | Path) -> None:
    """Write a camera file."""
    with written_whole(path) as unfinished:
        unfinished.write_text(yaml_text(camera_dict(camera)), encoding="utf-8")


def _lens(record: LensRecord) -> Lens:
    width, height = record.image_size_px
    distortion = record.distortion or [0.0]
    size = width, height
    return built(Lens, record, "lens", "lens.", image_size=size, distortion=distortion)


def _camera(lens: Lens, record: PlaceRecord | None) -> Camera | None:
    if record is None:
        return None
    only_form(record, "place")
    with within("place", "camera."):
        if record.matrix:
            return Camera(lens=lens, **si_fields(record.matrix))
        assert record.looking is not None
        return Camera.looking_down(lens, **si_fields(record.looking))


def _rows(rows: list[list[float]], where: str) -> Any:
    if len({len(row) for row in rows}) > 1:
        raise InvalidInput(where, found="rows of several lengths", expected="equal rows")
    return rows
