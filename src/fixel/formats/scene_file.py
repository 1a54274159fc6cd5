"""Scene files: one YAML or JSON file with all inputs of a rollout; overrides of its values."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final, get_origin

from fixel.errors import InvalidInput
from fixel.formats.records import KeyPath, annotation_at, record_at, unknown_key, written
from fixel.formats.scene_schema import SceneRecord, scene_content, scene_of, scene_record
from fixel.io.atomic import written_whole
from fixel.io.document import parse_yaml, read_document, yaml_text
from fixel.model import Scene
from fixel.simulation import AbstractStepper, Adaptive, StewartTrinkle


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFile:
    """Scene with the method that its file requests.

    Parameters
    ----------
    scene : Scene
        Scene of the file.
    motion : str
        Motion model: `dynamic`, `quasistatic` or `first-order`.
    step : float or None
        Time step [s]; None: the stepper's own choice.
    output_interval : float or None
        Time between recorded poses [s]; None: every step.
    """

    scene: Scene
    motion: str = "dynamic"
    step: float | None = None
    output_interval: float | None = None

    @property
    def stepper(self) -> AbstractStepper:
        """Stepper with the step of the file; adaptive if it has none."""
        return Adaptive() if self.step is None else StewartTrinkle(step=self.step)


def load_scene(path: str | Path, overrides: Sequence[str] = ()) -> SceneFile:
    """Load a scene file.

    Parameters
    ----------
    path : str or Path
        Scene file: YAML, or JSON if the name ends in `.json`.
    overrides : sequence of str
        Changes as `path.to.key=value`, applied in order before validation.

    Returns
    -------
    SceneFile
        Scene, and the method that the file requests; `simulate` takes both.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> file = load_scene(pushed_square().save("square.yaml"), ["duration=0.5"])
    >>> file.scene.duration
    0.5
    >>> fixel.simulate(file).duration
    0.5
    """
    return scene_file_from_dict(read_document(Path(path), "scene file"), overrides)


def scene_file_from_dict(raw: Mapping[str, Any], overrides: Sequence[str] = ()) -> SceneFile:
    """Build a scene file from its content as dicts and lists; see `load_scene`."""
    changed = copy.deepcopy(raw) if overrides else raw
    for override in overrides:
        apply_override(changed, override)
    record = scene_record(changed)
    return SceneFile(
        scene=scene_of(record),
        motion=record.motion,
        step=record.step,
        output_interval=record.output_interval,
    )


def scene_dict(scene_file: SceneFile) -> dict[str, Any]:
    """Content of a scene file as dicts and lists, mostly without defaults."""
    method = {
        "motion": scene_file.motion,
        "step": scene_file.step,
        "output_interval": scene_file.output_interval,
    }
    given = {key: value for key, value in method.items() if value is not None}
    return {"fixel": 1, **given, **scene_content(scene_file.scene)}


def save_scene(scene_file: SceneFile, path: str | Path) -> None:
    """Write a scene file: YAML, or JSON if the name ends in `.json`."""
    path = Path(path)
    content = scene_dict(scene_file)
    if path.suffix.lower() == ".json":
        text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    else:
        text = yaml_text(content)
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def scene_json_schema() -> dict[str, Any]:
    """JSON schema of scene files, for editors and other programs."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "fixel scene file",
        **{k: v for k, v in SceneRecord.model_json_schema().items() if k != "title"},
    }


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
            f"overrides {override}", found="no PATH=VALUE", expected="path.to.key=value"
        )
    segments = re.sub(r"\[(\d+)\]", r".\1", text.strip()).split(".")
    container = raw
    path: KeyPath = ()
    for segment in segments[:-1]:
        key = _key(container, segment, path)
        if isinstance(container, dict) and container.get(key) is None:
            container[key] = _empty_at((*path, key))
        container, path = container[key], (*path, key)
    key = _key(container, segments[-1], path)
    container[key] = parse_yaml(value, f"overrides {override}")


def _key(container: Any, segment: str, path: KeyPath) -> str | int:
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
            found="no such index",
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
        expected="a list or a mapping",
    )


def _empty_at(path: KeyPath) -> dict[str, Any] | list[Any] | None:
    """Empty container to insert for a missing key: a list, a dict, or None for a value."""
    if get_origin(annotation_at(SceneRecord, path)) is list:
        return []
    return {} if record_at(SceneRecord, path) else None
