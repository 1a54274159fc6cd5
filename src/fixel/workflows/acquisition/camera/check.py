"""Check the lens of a camera, and whether the camera was moved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats.camera_file import load_camera
from fixel.formats.rig_file import EXAMPLES, rig_of
from fixel.io.document import read_document
from fixel.vision.camera import MeasuredCamera
from fixel.vision.lens import Lens
from fixel.vision.marks import Rig
from fixel.vision.tracking.checks import moved_limit
from fixel.vision.tracking.tag_reader import find_tags, tag_corners
from fixel.workflows.acquisition.camera.answer import CameraAnswer, mm, verdict
from fixel.workflows.acquisition.camera.calibrate import check_plot, draw_errors
from fixel.workflows.acquisition.camera.pictures import first_picture

MOVED: Final = 5e-4  # [m] allowed offset of a plate tag, in addition to the camera's errors
ROUND_TRIP: Final = 1e-6  # [px]


class CameraCheck(NamedTuple):
    """Result of checking a camera."""

    answer: CameraAnswer
    # Largest error from pixels to directions and back, over the whole picture [px].
    round_trip: float
    # Distance of each plate tag from its place [m]; empty if none was searched for.
    tags: dict[int, float]
    problems: tuple[str, ...]  # reasons not to use the camera

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {
            **self.answer.summary(),
            "round_trip_px": self.round_trip,
            "plate_tags_off_m": {str(k): v for k, v in self.tags.items()},
            "problems": list(self.problems),
        }

    def blocks(self) -> list[list[str]]:
        """Return paragraphs of text for people."""
        return [
            *self.answer.blocks(),
            [f"round trip from pixels to directions and back: {self.round_trip:.1g} px"],
            [
                f"tag {number} on the plate is {1e3 * off:.2f} mm from its nominal position"
                for number, off in self.tags.items()
            ],
            [f"PROBLEM: {problem}" for problem in self.problems],
        ]


def check(
    name: str,
    *,
    video: Path | None = None,
    heights: Sequence[float] = (0.0,),
    plot: Path | None = None,
) -> CameraCheck:
    """Check a camera, or that of a rig, against itself and against a video or picture.

    Parameters
    ----------
    name : str
        A camera file, a rig file or the name of an example rig.
    video : Path, optional
        Video or picture whose size is compared; its first frame shows whether the tags of a rig's
        plate are where they belong.
    heights : sequence of float
        Heights above the plate at which to report the accuracy [m].
    plot : Path, optional
        File for a map of errors at the first height.
    """
    check_plot(plot)
    measured, rig = _camera_of(name)
    problems: list[str] = []
    tags: dict[int, float] = {}
    if video is not None:
        picture = first_picture(video)
        measured.lens.for_pictures_of((picture.shape[1], picture.shape[0]))
        if rig is not None and rig.plate:
            tags = _tags_off(rig, picture)
            problems += _moved(rig, tags)
    trip = round_trip(measured.lens)
    if not trip < ROUND_TRIP:
        problems.append(
            f"the round trip from pixels to directions and back has an error of {trip:.1g} px"
        )
    placed = measured.camera is not None
    verdicts = tuple(verdict(measured, height) for height in heights) if placed else ()
    remarks = () if placed else ("it has not been placed above a plate yet",)
    answer = CameraAnswer(
        camera=measured,
        verdicts=verdicts,
        remarks=remarks,
        plot=draw_errors(measured, verdicts, plot),
    )
    return CameraCheck(answer, trip, tags, tuple(problems))


def round_trip(lens: Lens, columns: int = 65, rows: int = 37) -> float:
    """Largest error from pixels to directions and back, on a grid over the picture [px]."""
    width, height = lens.image_size
    u, v = np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows)
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    return float(np.abs(lens.pixel(lens.direction(pixels)) - pixels).max())


def _camera_of(name: str) -> tuple[MeasuredCamera, Rig | None]:
    if name not in EXAMPLES:
        raw = read_document(Path(name))
        if not (isinstance(raw, dict) and "fixel_rig" in raw):
            return load_camera(name), None
    rig = rig_of(name)
    return rig.measured or MeasuredCamera(lens=rig.camera.lens, camera=rig.camera), rig


def _tags_off(rig: Rig, picture: Any) -> dict[int, float]:
    off = {}
    for index, pixels in find_tags(picture, rig.plate).items():
        tag = rig.plate[index]
        seen = rig.camera.on_plane(pixels, tag.height)
        off[tag.id] = float(np.hypot(*(seen - tag_corners(tag)).T).max())
    return off


def _moved(rig: Rig, tags: dict[int, float]) -> list[str]:
    if not tags:
        raise InvalidInput(
            "picture",
            found="none of the tags on the plate",
            expected="tags " + ", ".join(str(tag.id) for tag in rig.plate),
            hint="check that the picture shows the bench of the rig",
        )
    limits = {tag.id: moved_limit(rig, tag, MOVED) for tag in rig.plate}
    far = {number: off for number, off in tags.items() if off > limits[number]}
    if not far:
        return []
    worst = max(far, key=lambda number: far[number] / limits[number])
    return [
        f"tag {worst} on the plate is {mm(far[worst])} from its nominal position; {len(far)} of "
        f"{len(tags)} tags are off by more than the uncertainty of the calibration "
        f"({mm(limits[worst])}): the camera or the plate was moved"
    ]
