"""A plate with tags on it, as a camera would see it: enough for tests of looking at it."""

import cv2
import numpy as np

from fixel.model import Disk, placed
from fixel.vision.camera import Camera
from fixel.vision.lens import Lens
from fixel.vision.marks import MarkedPart, Rig, Tag, dictionary_of
from fixel.vision.outlines import outline_pixels
from fixel.vision.tracking.tags import CORNERS

FINE = 4  # subpixels along a side
CELLS = 10  # of a tag of 36h11, its white border included; 8 without


def small_rig(**changed):
    """The bench of the thesis, seen by a camera of a quarter of its pixels."""
    lens = Lens(
        image_size=(640, 360), focal=(472.0, 476.0), centre=(322.0, 185.5), distortion=(0, -0.0536)
    )
    camera = Camera.looking_down(lens, 0.516, above=(0.12, 0.01), turned=0.05)
    parts = {
        "object": MarkedPart(height=0.0254, marks=(Tag(id=1, size=0.04, height=0.0255),)),
        "actuator": MarkedPart(height=0.03, marks=(Tag(id=2, size=0.024, height=0.0301),)),
    }
    plate = tuple(
        Tag(id=20 + k, size=0.03, pose=(x, y, 0.0), height=0.0)
        for k, (x, y) in enumerate([(-0.1, 0.12), (0.35, 0.12), (0.35, -0.12), (-0.1, -0.12)])
    )
    values = {"name": "small", "camera": camera, "parts": parts, "plate": plate}
    return Rig(**(values | changed))


def plate_picture(rig, poses, tops=()):
    """(h, w, 3) uint8 of the plate with its tags, parts at poses, and tops of fixels."""
    width, height = rig.camera.lens.image_size
    fine = np.full((FINE * height, FINE * width), 165, dtype=np.uint8)
    for tag in rig.plate:
        _lay(fine, rig, tag, tag.pose)
    for name, pose in poses.items():
        for tag in rig.parts[name].marks:
            there = placed(tag.pose[:2], pose)
            _lay(fine, rig, tag, (*there, tag.pose[2] + pose[2]))
    for place, radius in tops:
        rim = outline_pixels(rig.camera, Disk(radius), (*place, 0.0), rig.fixel_height)
        cv2.fillPoly(
            fine, [np.round(16 * (FINE * (rim + 0.5) - 0.5)).astype(np.int32)], 70, shift=4
        )
    gray = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(cv2.GaussianBlur(gray, (0, 0), 0.6), cv2.COLOR_GRAY2BGR)


def _lay(fine, rig, tag, pose):
    dictionary = dictionary_of(tag.family)
    side = 30 * CELLS
    card = np.full((side, side), 255, dtype=np.uint8)
    card[30:-30, 30:-30] = cv2.aruco.generateImageMarker(dictionary, tag.id, side - 60)
    corners = placed(tag.size * CELLS / (CELLS - 2) * CORNERS, pose)
    pixels = FINE * (rig.camera.project_at(corners, tag.height) + 0.5) - 0.5
    ends = np.array([[0, 0], [side, 0], [side, side], [0, side]]) - 0.5
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 1, 0)
    region = fine[low[1] : int(pixels[:, 1].max()) + 3, low[0] : int(pixels[:, 0].max()) + 3]
    way = cv2.getPerspectiveTransform(ends.astype(np.float32), (pixels - low).astype(np.float32))
    seen = cv2.warpPerspective(card, way, region.shape[::-1], flags=cv2.INTER_AREA)
    mask = cv2.warpPerspective(np.full_like(card, 255), way, region.shape[::-1])
    region[mask > 127] = seen[mask > 127]
