"""File formats: scenes, trajectories, cameras, rigs, plans, recordings, videos and exports."""

from fixel.formats.scene_file import (
    SceneFile as SceneFile,
    load_scene as load_scene,
    save_scene as save_scene,
    scene_dict as scene_dict,
    scene_file_from_dict as scene_file_from_dict,
    scene_json_schema as scene_json_schema,
)
