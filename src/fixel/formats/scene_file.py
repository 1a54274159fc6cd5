"""Scene files: one YAML or JSON file with all inputs of a rollout."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from fixel.formats import scene_schema as schema
from fixel.formats.overrides import apply_override
from fixel.formats.scene_model import scene_content, scene_of
from fixel.io.document import read_document, yaml_text
from fixel.model import Scene


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


def load_scene(path: str | Path, overrides: Sequence[str] = ()) -> SceneFile:
    """Load a scene file.

    Parameters
    ----------
    path : str or Path
        Scene file: YAML, or JSON if the name ends in `.json`.
    overrides : sequence of str
        Changes as `path.to.key=value`, applied in order before validation.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.
    """
    return scene_file_from_dict(read_document(Path(path)), overrides)


def scene_file_from_dict(raw: Mapping[str, Any], overrides: Sequence[str] = ()) -> SceneFile:
    """Build a scene file from its content as dicts and lists; see `load_scene`."""
    changed = copy.deepcopy(raw) if overrides else raw
    for override in overrides:
        apply_override(changed, override)
    record = schema.scene_record(changed)
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
    path.write_text(text, encoding="utf-8")


def scene_json_schema() -> dict[str, Any]:
    """JSON schema of scene files, for editors and other programs."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "fixel scene file",
        **{k: v for k, v in schema.SceneRecord.model_json_schema().items() if k != "title"},
    }
