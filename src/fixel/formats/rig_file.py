"""Rig files, YAML: a camera above a plate, and the markers by which it identifies the parts.

Parts are named like the body and pusher of the scene: `object` and `actuator` in all scenes of the
thesis, whatever the shape; `part` and `probe` under the microscope.
"""

from __future__ import annotations

import math
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from fixel.errors import InvalidInput
from fixel.formats.camera_file import camera_dict, camera_from_dict, load_camera
from fixel.formats.records import (
    FileRecord,
    NonNegative,
    Point,
    Positive,
    Triple,
    built,
    plain,
    unit_content,
    validated,
    within,
)
from fixel.io.atomic import written_whole
from fixel.io.document import read_document, yaml_text
from fixel.vision.camera import MeasuredCamera
from fixel.vision.marks import COLOURS, FAMILIES, THESIS_BITS, MarkedPart, Rig, Sticker, Tag

EXAMPLES = ("thesis-tags", "thesis-stickers", "microscope")


class TagRecord(FileRecord):
    id: int = Field(ge=0, description="number of the tag in its family")
    size_mm: Positive = Field(description="side of the black square [mm]")
    pose_mm_deg: Triple = Field([0.0] * 3, description="pose of the centre: x, y [mm], angle [deg]")
    height_mm: NonNegative = Field(description="height of the upper face above the plate [mm]")
    family: str = Field(FAMILIES[0], description=f"family of the tag: {', '.join(FAMILIES)}")


class StickerRecord(FileRecord):
    colour: str = Field(description=f"colour of the sticker: {', '.join(COLOURS)}")
    diameter_mm: Positive = Field(description="diameter [mm]")
    place_mm: Point = Field(description="position of the centre: x, y [mm]")
    height_mm: NonNegative = Field(description="height of the upper face above the plate [mm]")


class PartRecord(FileRecord):
    height_mm: Positive = Field(description="height of the upper face above the plate [mm]")
    tags: list[TagRecord] = Field([], description="tags, in the frame of the part")
    stickers: list[StickerRecord] = Field([], description="stickers, in the frame of the part")


class PlacementRecord(FileRecord):
    position_mm: Positive = Field(1.0, description="allowed position error [mm]")
    angle_deg: Positive = Field(1.0, description="allowed angle error [deg]")


class RigRecord(FileRecord):
    """Content of a rig file."""

    fixel_rig: Literal[1] = Field(description="version of the format")
    name: str = Field(description="name of the bench")
    camera: Any = Field(description="camera, or name of a camera file next to this file")
    parts: dict[str, PartRecord] = Field({}, description="parts by the names of body and pusher")
    plate: list[TagRecord] = Field([], description="tags on the plate, at poses in the world")
    fixel_height_mm: Positive = Field(
        51.08, description="height of the fixels above the plate [mm]"
    )
    tactile_bits: list[str] = Field(
        list(THESIS_BITS), description="name of the fixel of each bit, lowest first"
    )
    placement: PlacementRecord = Field(
        PlacementRecord(position_mm=1.0, angle_deg=1.0), description="tolerance for placing parts"
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
    return _plate(validated(RigRecord, read_document(Path(name_or_path), "rig file"), "rig"))


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
    return Rig(
        name=record.name,
        camera=measured.placed(),
        measured=measured if measured.names else None,
        parts={name: _part(part, f"parts.{name}") for name, part in record.parts.items()},
        fixel_height=record.fixel_height_mm / 1e3,
        plate=_plate(record),
        tactile=tuple(record.tactile_bits),
        position_tolerance=record.placement.position_mm / 1e3,
        angle_tolerance=math.radians(record.placement.angle_deg),
    )


def rig_dict(rig: Rig) -> dict[str, Any]:
    """Content of a rig file as dicts and lists, including the camera."""
    measured = rig.measured or MeasuredCamera(lens=rig.camera.lens, camera=rig.camera)
    camera = camera_dict(measured)
    return {
        "fixel_rig": 1,
        "name": rig.name,
        "camera": {key: value for key, value in camera.items() if key != "fixel_camera"},
        "parts": {name: _part_content(part) for name, part in rig.parts.items()},
        "plate": [unit_content(tag, TagRecord) for tag in rig.plate],
        "fixel_height_mm": plain(1e3 * rig.fixel_height),
        "tactile_bits": list(rig.tactile),
        "placement": {
            "position_mm": plain(1e3 * rig.position_tolerance),
            "angle_deg": plain(math.degrees(rig.angle_tolerance)),
        },
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
    with within("camera", "camera."):
        if isinstance(raw, dict):
            found = camera_from_dict(raw)
        else:
            found = load_camera((folder or Path()) / raw)
        found.placed()
        return found


def _plate(record: RigRecord) -> tuple[Tag, ...]:
    return tuple(_tag(tag, f"plate[{k}]") for k, tag in enumerate(record.plate))


def _part(record: PartRecord, path: str) -> MarkedPart:
    tags = [_tag(tag, f"{path}.tags[{k}]") for k, tag in enumerate(record.tags)]
    stickers = [
        built(Sticker, sticker, f"{path}.stickers[{k}]", "sticker.")
        for k, sticker in enumerate(record.stickers)
    ]
    with within(path, "part."):
        return MarkedPart(height=record.height_mm / 1e3, marks=(*tags, *stickers))


def _tag(record: TagRecord, path: str) -> Tag:
    return built(Tag, record, path, "tag.")


def _part_content(part: MarkedPart) -> dict[str, Any]:
    content: dict[str, Any] = {"height_mm": plain(1e3 * part.height)}
    for key, kind, record in (("tags", Tag, TagRecord), ("stickers", Sticker, StickerRecord)):
        marks = [unit_content(mark, record) for mark in part.marks if isinstance(mark, kind)]
        content |= {key: marks} if marks else {}
    return content
