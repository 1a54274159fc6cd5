"""Camera and rig files, YAML: a camera above a plate, and the markers by which it identifies parts.

Of a camera: a lens, its pose above the plate, and the uncertainty of both. Pixels count from the
centre of the upper left one; coefficients are in OpenCV's order. Parts are named like the body and
pusher of the scene: `object` and `actuator` in all scenes of the thesis, whatever the shape; `part`
and `probe` under the microscope.
"""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from fixel.errors import InvalidInput
from fixel.formats import records
from fixel.formats.records import content
from fixel.io.atomic import write_whole
from fixel.io.document import document, read_document, yaml_text
from fixel.vision.camera import Camera, MeasuredCamera
from fixel.vision.lens import Lens
from fixel.vision.marks import MarkedPart, Rig, Sticker, Tag

Size = Annotated[list[Annotated[int, Field(gt=0)]], Field(min_length=2, max_length=2)]
Matrix = Annotated[list[records.Triple], Field(min_length=3, max_length=3)]


LensRecord: Any = records.record_of(
    Lens,
    "lens",
    units=True,
    names={"image_size": "image_size_px"},
    image_size=Size,
    focal=Annotated[list[records.Positive], Field(min_length=2, max_length=2)],
    distortion=Annotated[list[records.Number], Field(max_length=8)],
)


class LookingRecord(records.FileRecord):
    height_mm: records.Positive = Field(description="height of the camera above the plate [mm]")
    above_mm: records.Point = Field([0.0, 0.0], description="world position below the camera [mm]")
    turned_deg: records.Number = Field(
        0.0, description="angle from world x to the picture's right [deg]"
    )
    tilted_deg: records.Point = Field(
        [0.0, 0.0], description="tilt of the optical axis, down and right in the picture [deg]"
    )


MatrixRecord: Any = records.record_of(
    Camera, "camera", title="MatrixRecord", units=True, leave_out=["lens"], rotation=Matrix
)


class PlaceRecord(records.FileRecord):
    """Pose of a camera, in exactly one form."""

    looking: LookingRecord | None = Field(None, description="pose of a camera that looks down")
    matrix: MatrixRecord | None = Field(None, description="pose as rotation and translation")


MeasuredRecord: Any = records.record_of(
    MeasuredCamera,
    "measured",
    title="MeasuredRecord",
    units=True,
    leave_out=["lens", "camera", "source"],
    covariance=list[list[records.Number]],
    seen=list[list[records.NonNegative]],
)


class CameraRecord(records.FileRecord):
    """Content of a camera file."""

    fixel_camera: Literal[1] = Field(1, description="version of the format")
    source: str = Field("", description="origin of the calibration, as text")
    lens: LensRecord
    place: PlaceRecord | None = Field(
        None, description="pose above the plate; missing until the camera is placed"
    )
    measured: MeasuredRecord | None = Field(None, description="uncertainty of the calibration")


def load_camera(path: str | Path) -> MeasuredCamera:
    """Load a camera file: YAML, or JSON if the name ends in `.json`."""
    with document(path, "camera file") as raw:
        if not isinstance(raw, dict) or "lens" not in raw:
            hint = "to import a file of MATLAB, OpenCV, Kalibr or ROS: fixel camera import FILE"
            raise InvalidInput("lens", found=None, hint=hint)
        return camera_from_dict(raw)


def camera_from_dict(raw: Any) -> MeasuredCamera:
    """Build a camera from the content of a camera file, as dicts and lists."""
    record = records.validated(CameraRecord, raw, "camera")
    # The default has eight coefficients, of which a fisheye has four.
    usual = {} if "distortion" in record.lens.model_fields_set else {"distortion": [0.0]}
    size = tuple(record.lens.image_size_px)
    lens = records.made(record.lens, "lens", image_size=size, **usual)
    measured = {} if record.measured is None else records.arguments(record.measured)
    with records.within("measured", "measured"):
        for name in ("covariance", "seen"):
            if len({len(row) for row in measured.get(name, ())}) > 1:
                raise InvalidInput(name, found="rows of several lengths", expected="equal rows")
        camera = _camera(lens, record.place)
        return MeasuredCamera(lens=lens, camera=camera, source=record.source, **measured)


def camera_dict(camera: MeasuredCamera) -> dict[str, Any]:
    """Content of a camera file, as dicts and lists."""
    content: dict[str, Any] = {"fixel_camera": 1}
    if camera.source:
        content["source"] = camera.source
    content["lens"] = records.keys_of(camera.lens, LensRecord)
    if camera.camera is not None:
        content["place"] = {"matrix": records.keys_of(camera.camera, MatrixRecord)}
    known = records.keys_of(camera, MeasuredRecord) | {"seen": camera.seen.astype(int).tolist()}
    measured = {key: value for key, value in known.items() if value not in (None, [], ())}
    return content | ({"measured": measured} if measured else {})


def save_camera(camera: MeasuredCamera, path: str | Path) -> None:
    """Write a camera file."""
    write_whole(path, yaml_text(camera_dict(camera)))


def _camera(lens: Lens, record: PlaceRecord | None) -> Camera | None:
    if record is None:
        return None
    records.only_form(record, "place")
    with records.within("place", "camera"):
        if record.matrix:
            return Camera(lens=lens, **records.arguments(record.matrix))
        return Camera.looking_down(lens, **records.arguments(record.looking))


EXAMPLES = ("thesis-tags", "thesis-stickers", "microscope")


TagRecord: Any = records.record_of(Tag, "tag", units=True)
StickerRecord: Any = records.record_of(Sticker, "sticker", units=True)
PartRecord: Any = records.record_of(
    MarkedPart,
    "part",
    units=True,
    leave_out=["marks"],
    more={
        "tags": (list[TagRecord], Field([], description="tags, in the frame of the part")),
        "stickers": (
            list[StickerRecord],
            Field([], description="stickers, in the frame of the part"),
        ),
    },
)
PartRecord.makes = lambda height, tags, stickers: MarkedPart(
    height=height, marks=(*tags, *stickers)
)
_PLACEMENT: Final = {"position_tolerance": "position_mm", "angle_tolerance": "angle_deg"}
PlacementRecord: Any = records.record_of(
    Rig,
    "rig",
    title="PlacementRecord",
    names=_PLACEMENT,
    leave_out=[name for name in Rig.__dataclass_fields__ if name not in _PLACEMENT],
)
RigRecord: Any = records.record_of(
    Rig,
    "",
    units=True,
    names={"tactile": "tactile_bits"},
    leave_out=["camera", "parts", "measured", *_PLACEMENT],
    more={
        "fixel_rig": (Literal[1], Field(description="version of the format")),
        "camera": (Any, Field(description="camera, or name of a camera file next to this file")),
        "parts": (
            dict[str, PartRecord],
            Field({}, description="parts by the names of body and pusher"),
        ),
        "placement": (
            PlacementRecord,
            Field(PlacementRecord(), description="tolerance for placing parts"),
        ),
    },
    first=["fixel_rig", "name", "camera", "parts"],
)


def rig_of(name_or_path: str | Path) -> Rig:
    """Load a rig by the name of an example, one of `EXAMPLES`, or from a rig file."""
    if str(name_or_path) in EXAMPLES:
        folder = files("fixel") / "testing" / "examples" / "rigs"
        with as_file(folder / f"{name_or_path}.yaml") as path:
            return load_rig(path)
    return load_rig(_rig_path(name_or_path))


def _rig_path(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if not path.suffix and not path.exists():
        found, expected = f"no file {str(path)!r}", "a rig file, or one of " + ", ".join(EXAMPLES)
        raise InvalidInput("rig", found=found, expected=expected)
    return path


def markers_of(name_or_path: str | Path) -> tuple[str, dict[str, MarkedPart], tuple[Tag, ...]]:
    """Load name, marked parts and plate tags of a rig; see `rig_of`.

    Its camera need not be placed yet, and its camera file need not exist.
    """
    if str(name_or_path) in EXAMPLES:
        rig = rig_of(name_or_path)
        return rig.name, rig.parts, rig.plate
    with document(_rig_path(name_or_path), "rig file") as raw:
        found = records.arguments(records.validated(RigRecord, raw, "rig"))
    return found["name"], found["parts"], tuple(found["plate"])


def has_plate(file: Path) -> bool:
    """Whether a rig file exists and has tags on its plate; its camera file is not read."""
    if not file.is_file():
        return False
    raw = read_document(file, "rig file")
    return isinstance(raw, dict) and bool(raw.get("plate"))


def camera_of(name: str) -> tuple[MeasuredCamera, Rig | None]:
    """Load the camera of a camera file, or that of a rig with its rig."""
    if name not in EXAMPLES:
        raw = read_document(Path(name), "camera or rig file")
        if not (isinstance(raw, dict) and "fixel_rig" in raw):
            return load_camera(name), None
    rig = rig_of(name)
    return rig.measured or MeasuredCamera(lens=rig.camera.lens, camera=rig.camera), rig


def load_rig(path: str | Path) -> Rig:
    """Load a rig file: YAML, or JSON if the name ends in `.json`."""
    with document(path, "rig file") as raw:
        return rig_from_dict(raw, Path(path).parent)


def rig_from_dict(raw: Any, folder: Path | None = None) -> Rig:
    """Build a rig from the content of a rig file; camera files are searched in `folder`."""
    record = records.validated(RigRecord, raw, "rig")
    measured = _camera_of_rig(record.camera, folder)
    rig: Rig = records.made(
        record,
        camera=measured.placed(),
        measured=measured if measured.names else None,
        **records.arguments(record.placement),
    )
    return rig


def rig_dict(rig: Rig) -> dict[str, Any]:
    """Content of a rig file as dicts and lists, including the camera."""
    measured = rig.measured or MeasuredCamera(lens=rig.camera.lens, camera=rig.camera)
    camera = camera_dict(measured)
    return {
        "fixel_rig": 1,
        **records.keys_of(rig, RigRecord),
        "camera": {key: value for key, value in camera.items() if key != "fixel_camera"},
        "parts": {name: _part_content(part) for name, part in rig.parts.items()},
        "placement": records.keys_of(rig, PlacementRecord),
    }


def save_rig(rig: Rig, path: str | Path) -> None:
    """Write a self-contained rig file, including the camera."""
    write_whole(path, yaml_text(rig_dict(rig)))


def _camera_of_rig(raw: Any, folder: Path | None) -> MeasuredCamera:
    if not isinstance(raw, str | dict):
        raise InvalidInput(
            "camera", found=raw, expected="a lens and a pose, or the name of a camera file"
        )
    with records.within("camera", "camera"):
        if isinstance(raw, dict):
            found = camera_from_dict(raw)
        else:
            found = load_camera((folder or Path()) / raw)
        found.placed()
        return found


def _part_content(part: MarkedPart) -> dict[str, Any]:
    tags = [content(mark) for mark in part.marks if isinstance(mark, Tag)]
    stickers = [content(mark) for mark in part.marks if isinstance(mark, Sticker)]
    found = records.keys_of(part, PartRecord)
    return found | ({"tags": tags} if tags else {}) | ({"stickers": stickers} if stickers else {})
