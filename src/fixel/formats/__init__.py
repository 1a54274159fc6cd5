"""File formats: scenes, trajectories, cameras, rigs, plans, recordings, videos and exports."""

from fixel.formats.scene_file import (
    SceneFile,
    load_scene,
    save_scene,
    scene_dict,
    scene_file_from_dict,
    scene_json_schema,
)

__all__ = [
    "SceneFile",
    "load_scene",
    "save_scene",
    "scene_dict",
    "scene_file_from_dict",
    "scene_json_schema",
]
