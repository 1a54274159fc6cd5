"""Rig files, YAML: a camera above a plate, and the markers by which it identifies the parts.

Parts are named like the body and pusher of the scene: `object` and `actuator` in all scenes of the
thesis, whatever the shape; `part` and `probe` under the microscope.
"""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field

from fixel.errors import InvalidInput
from fixel.formats.camera_file import camera_dict, camera_from_dict, load_camera
from fixel.formats.records import (
    arguments,
    content,
    keys_of,
    made,
    record_of,
    validated,
    within,
)
from fixel.io.atomic import written_whole
from fixel.io.document import read_document, yaml_text
from fixel.vision.camera import MeasuredCamera
from fixel.vision.marks import MarkedPart, Rig, Sticker, Tag

EXAMPLES = ("thesis-tags", "thesis-stickers", "microscope")


TagRecord: Any = record_of(Tag, "tag", units=True)
StickerRecord: Any = record_of(Sticker, "sticker", units=True)
PartRecord: Any = record_of(
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
PlacementRecord: Any = record_of(
    Rig,
    "rig",
    title="PlacementRecord",
    names=_PLACEMENT,
    leave_out=[name for name in Rig.__dataclass_fields__ if name not in _PLACEMENT],
)
RigRecord: Any = record_of(
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
    """Load a rig by the name of an example, or from a rig file.

    Parameters
    ----------
    name_or_path : str or Path
        One of `EXAMPLES`, or the path of a rig file.
    """
    if str(name_or_path) in EXAMPLES:
        folder = files("fixel") / "testing" / "examples" / "rigs"
        with as_file(folder / f"{name_or_path}.yaml") as path:
            return load_rig(path)
    path = Path(name_or_path)
    if not path.suffix and not path.exists():
        raise InvalidInput(
            "rig",
            found=f"no file {str(path)!r}",
            expected="a rig file, or one of " + ", ".join(EXAMPLES),
        )
    return load_rig(path)


def plate_of(name_or_path: str | Path) -> tuple[Tag, ...]:
    """Load the tags on the plate of a rig, whose camera need not be placed yet; see `rig_of`."""
    if str(name_or_path) in EXAMPLES:
        return rig_of(name_or_path).plate
    record = validated(RigRecord, read_document(Path(name_or_path), "rig file"), "rig")
    plate: tuple[Tag, ...] = tuple(arguments(record)["plate"])
    return plate


def load_rig(path: str | Path) -> Rig:
    """Load a rig file: YAML, or JSON if the name ends in `.json`.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.
    """
    path = Path(path)
    return rig_from_dict(read_document(path, "rig file"), path.parent)


def rig_from_dict(raw: Any, folder: Path | None = None) -> Rig:
    """Build a rig from the content of a rig file; camera files are searched in `folder`."""
    record = validated(RigRecord, raw, "rig")
    measured = _camera(record.camera, folder)
    rig: Rig = made(
        record,
        camera=measured.placed(),
        measured=measured if measured.names else None,
        **arguments(record.placement),
    )
    return rig


def rig_dict(rig: Rig) -> dict[str, Any]:
    """Content of a rig file as dicts and lists, including the camera."""
    measured = rig.measured or MeasuredCamera(lens=rig.camera.lens, camera=rig.camera)
    camera = camera_dict(measured)
    return {
        "fixel_rig": 1,
        **keys_of(rig, RigRecord),
        "camera": {key: value for key, value in camera.items() if key != "fixel_camera"},
        "parts": {name: _part_content(part) for name, part in rig.parts.items()},
        "placement": keys_of(rig, PlacementRecord),
    }


def save_rig(rig: Rig, path: str | Path) -> None:
    """Write a self-contained rig file, including the camera."""
    with written_whole(path) as unfinished:
        unfinished.write_text(yaml_text(rig_dict(rig)), encoding="utf-8")


def _camera(raw: Any, folder: Path | None) -> MeasuredCamera:
    if not isinstance(raw, str | dict):
        raise InvalidInput(
            "camera", found=raw, expected="a lens and a pose, or the name of a camera file"
        )
    with within("camera", "camera"):
        if isinstance(raw, dict):
            found = camera_from_dict(raw)
        else:
            found = load_camera((folder or Path()) / raw)
        found.placed()
        return found


def _part_content(part: MarkedPart) -> dict[str, Any]:
    tags = [content(mark) for mark in part.marks if isinstance(mark, Tag)]
    stickers = [content(mark) for mark in part.marks if isinstance(mark, Sticker)]
    found = keys_of(part, PartRecord)
    return found | ({"tags": tags} if tags else {}) | ({"stickers": stickers} if stickers else {})
