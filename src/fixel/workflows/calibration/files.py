"""Files with the experiments of a calibration, stored with its job."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from fixel.calibration.target import Target
from fixel.formats.scene_model import scene_content, scene_of
from fixel.formats.scene_schema import SceneRecord
from fixel.io.array_bytes import arrays_of, bytes_of
from fixel.io.damaged_files import readable
from fixel.simulation.ensemble import RolloutCase

TARGETS: Final = "targets.json"
POSES: Final = "poses.npz"


def target_files(targets: Sequence[Target]) -> dict[str, bytes]:
    """Return the files that contain targets, by name."""
    content = [
        {
            "key": target.key,
            "conditions": dict(target.conditions),
            "scene": scene_content(target.case.scene),
            "samples": len(target.pose),
        }
        for target in targets
    ]
    poses = bytes_of(
        time=np.concatenate([target.case.times for target in targets]),
        pose=np.concatenate([target.pose for target in targets]),
    )
    return {TARGETS: json.dumps(content, allow_nan=False).encode(), POSES: poses}


def read_targets(folder: Path) -> list[Target]:
    """Load the targets from a folder; bit-exact inverse of `target_files`."""
    with readable(folder):
        return _read_targets(folder)


def _read_targets(folder: Path) -> list[Target]:
    content = json.loads((folder / TARGETS).read_text(encoding="utf-8"))
    arrays = arrays_of((folder / POSES).read_bytes())
    ends = np.cumsum([entry["samples"] for entry in content])[:-1]
    return [
        Target(
            entry["key"],
            entry["conditions"],
            RolloutCase(scene_of(SceneRecord.model_validate(entry["scene"])), time),
            pose,
        )
        for entry, time, pose in zip(
            content, np.split(arrays["time"], ends), np.split(arrays["pose"], ends), strict=True
        )
    ]
