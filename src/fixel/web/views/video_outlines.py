"""Outlines of a measured part in the video of its experiment, if the bench is known."""

from __future__ import annotations

from typing import Final

import numpy as np
from pydantic import Field

from fixel.database.project import Project
from fixel.errors import FixelError
from fixel.formats.rig_file import EXAMPLES, load_rig, rig_of
from fixel.model import Experiment
from fixel.vision.marks import Rig
from fixel.vision.outlines import outline_pixels
from fixel.web.values import Answer, Array, ShortArray
from fixel.workflows.acquisition.tracked_experiment import CAMERA

RIGS: Final = "rigs"  # folder of a project for the rig files of its benches
MAX_OUTLINES: Final = 600  # outlines; in between the part is drawn at the nearest


class VideoOutlines(Answer):
    """Outlines of the object in pictures of this size."""

    size: tuple[int, int] = Field(
        serialization_alias="size_px", description="width and height of the video"
    )
    time: Array = Field(
        serialization_alias="time_s", description="(n,) time on the clock of the video"
    )
    outline: ShortArray = Field(
        serialization_alias="outline_px",
        description="(n, m, 2) closed outlines; the centre of the first pixel is 0",
    )


def rig_named(project: Project, name: str) -> Rig | None:
    """Load the rig of a name from the project's `rigs` folder or the examples; None if unknown."""
    for path in sorted((project.folder / RIGS).glob("*.yaml")):
        try:
            rig = load_rig(path)
        except FixelError:
            continue  # another bench's file may be broken; this one may still be found
        if rig.name == name:
            return rig
    return next((rig for rig in map(rig_of, EXAMPLES) if rig.name == name), None)


def outlines_in_video(project: Project, experiment: Experiment) -> VideoOutlines | None:
    """Return outlines of the measured object in its video; None without rig, scene or height, or
    if the camera was not where the rig places it."""
    rig = rig_named(project, str(experiment.conditions.get("rig", "")))
    scene, part = experiment.scene, None if rig is None else rig.parts.get(experiment.object_name)
    height = experiment.height or (None if part is None else part.height)
    if rig is None or scene is None or height is None or CAMERA in experiment.conditions:
        return None
    shape = next(b.shape for b in scene.bodies if b.name == experiment.object_name)
    track = experiment.trajectory
    n = len(track.time)
    chosen = np.unique(np.linspace(0, n - 1, min(n, MAX_OUTLINES)).round().astype(np.int64))
    lines = [outline_pixels(rig.camera, shape, pose, height) for pose in track.pose[chosen]]
    return VideoOutlines(
        size=rig.camera.lens.image_size, time=track.time[chosen], outline=np.stack(lines)
    )
