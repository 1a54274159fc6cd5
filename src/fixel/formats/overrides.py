"""Overrides of single values of a scene file: `bodies.0.mass=0.2`, `bodies.object.mass=0.2`."""

from __future__ import annotations

import re
from typing import Any, get_origin

from fixel.errors import InvalidInput
from fixel.formats.records import Path, annotation_at, record_at, unknown_key, written
from fixel.formats.scene_schema import SceneRecord
from fixel.io.document import parse_yaml


def apply_override(raw: Any, override: str) -> None:
    """Change one value of a raw scene in place.

    Parameters
    ----------
    raw : dict
        Content of a scene file.
    override : str
        `path.to.key=value`, the value in YAML. List items are addressed by number or, if they have
        one, by name. A key missing in the file is added if scene files allow it there.

    Raises
    ------
    InvalidInput
        The path does not exist; the message lists what does.
    """
    text, equals, value = override.partition("=")
    if not equals or not text.strip():
        raise InvalidInput(
            f"--set {override}", found="no path and value", expected="path.to.key=value"
        )
    segments = re.sub(r"\[(\d+)\]", r".\1", text.strip()).split(".")
    container = raw
    path: Path = ()
    for segment in segments[:-1]:
        key = _key(container, segment, path)
        if isinstance(container, dict) and container.get(key) is None:
            container[key] = _empty_at((*path, key))
        container, path = container[key], (*path, key)
    key = _key(container, segments[-1], path)
    container[key] = parse_yaml(value, f"--set {override}")


def _key(container: Any, segment: str, path: Path) -> str | int:
    """Key or list index that a segment of a path refers to in a container."""
    if isinstance(container, list):
        names = [item.get("name") if isinstance(item, dict) else None for item in container]
        if segment in names:
            return names.index(segment)
        if segment.isdecimal() and int(segment) < len(container):
            return int(segment)
        there = ", ".join(str(name) for name in names if name is not None)
        raise InvalidInput(
            f"{written(path)}.{segment}",
            found="no such entry",
            expected=f"a number below {len(container)}" + (f", or one of {there}" if there else ""),
        )
    if isinstance(container, dict):
        record = record_at(SceneRecord, path)
        if segment in container or (record and segment in record.model_fields):
            return segment
        raise unknown_key(SceneRecord, (*path, segment))
    raise InvalidInput(
        ".".join((written(path), segment)).removeprefix("."),
        found=f"{container!r} at {written(path) or 'the top'}",
        expected="a list or keys there",
    )


def _empty_at(path: Path) -> dict[str, Any] | list[Any] | None:
    """Empty container to insert for a missing key: a list, a dict, or None for a value."""
    if get_origin(annotation_at(SceneRecord, path)) is list:
        return []
    return {} if record_at(SceneRecord, path) else None
