"""Whether a film is of the rig it is said to be of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from fixel.errors import InvalidInput
from fixel.kernels.arrays import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray
from fixel.vision.marks import Rig, Tag
from fixel.vision.tracking.outline import fit_pose
from fixel.vision.tracking.tag_reader import read_tags, tag_corners
from fixel.vision.tracking.tags import names_of, tag_edges

MOVED: Final = 1.5  # [px] by which tags on the plate may be off their places
FOUND: Final = 15.0  # [px] within which a plate tag is where it should be, roughly
FLIPS: Final[Mapping[str, tuple[slice, slice]]] = {
    "mirrored left to right": (slice(None), slice(None, None, -1)),
    "mirrored upside down": (slice(None, None, -1), slice(None)),
}


def refuse_size(rig: Rig, frame: Frame) -> None:
    """Refuse pictures of another size than the rig's camera has."""
    wanted, found = tuple(rig.camera.lens.image_size), frame.size
    if found == wanted:
        return
    turned = found == wanted[::-1]
    raise InvalidInput(
        "video",
        found=f"{found[0]} x {found[1]} pixels"
        + (", the picture turned by a quarter" if turned else ""),
        expected=f"{wanted[0]} x {wanted[1]}, for which rig {rig.name!r} was calibrated",
        hint="turn the film back"
        if turned
        else "film at that resolution, or calibrate the camera at this one: a scaled calibration "
        "is a guess, since cameras crop",
    )


def refuse_flipped(rig: Rig, picture: Gray) -> None:
    """Refuse pictures whose tags can be read only when they are flipped."""
    tags = [m for part in rig.parts.values() for m in part.marks if isinstance(m, Tag)]
    tags += rig.plate
    if not tags:
        return
    wanted = names_of(tags)
    families = {tag.family for tag in tags}
    if wanted & set(read_tags(picture, families)):
        return
    if wanted & set(read_tags(picture[:, ::-1], families)):
        raise InvalidInput(
            "video",
            found="a mirrored picture: its tags can be read only in a mirror",
            expected="the picture as the camera sees it",
            hint="turn off mirroring in the camera's or recorder's settings",
        )


def plate_offsets(rig: Rig, frame: Frame) -> dict[int, FloatArray]:
    """(2,) how far tags of the plate are off their places, in the plane [m], by id."""
    offsets: dict[int, FloatArray] = {}
    for tag in rig.plate:
        fit = fit_pose(
            frame.luma, rig.camera, tag_edges(tag, 0), np.zeros(3), reach=FOUND, turns=False
        )
        if fit is not None and fit.residual < 1.0:
            offsets[tag.id] = fit.pose[:2]
    return offsets


def refuse_moved(rig: Rig, frame: Frame) -> None:
    """Refuse pictures in which the plate's own tags are not where they should be."""
    if not rig.plate:
        return
    found = read_tags(frame.luma, {tag.family for tag in rig.plate})
    off = {}
    turned = {}
    width, height = rig.camera.lens.image_size
    for tag in rig.plate:
        quads = found.get((tag.family, tag.id), [])
        if not quads:
            continue
        should = rig.camera.project_at(tag_corners(tag), tag.height)
        off[tag.id] = float(np.hypot(*(quads[0] - should).mean(0)))
        opposite = np.array([width - 1.0, height - 1.0]) - quads[0]
        turned[tag.id] = float(np.hypot(*(opposite - should).mean(0)))
    if not off:
        return
    if max(turned.values()) < FOUND < max(off.values()):
        raise InvalidInput(
            "video",
            found="a picture turned by half a turn",
            expected=f"the picture as rig {rig.name!r} has it",
            hint="turn off rotation in the camera's settings, or calibrate the plate anew",
        )
    exact = plate_offsets(rig, frame)
    pixel = rig.camera.metres_per_pixel()
    off |= {id_: float(np.hypot(*shift)) / pixel for id_, shift in exact.items()}
    if max(off.values()) > MOVED:
        worst = max(off, key=lambda id_: off[id_])
        raise InvalidInput(
            "camera",
            found=f"tag {worst} of the plate {off[worst] * pixel * 1e3:.1f} mm off its place: the "
            "camera or the plate was moved",
            expected=f"at most {MOVED * pixel * 1e3:.1f} mm",
            hint="calibrate the plate anew, or track with --register to find the camera's new "
            "place from these tags",
        )


def registered(rig: Rig, frame: Frame) -> Camera:
    """The rig's camera where it must be, for its plate's tags to be where they show.

    Raises
    ------
    InvalidInput
        Fewer than two tags of the plate in the picture, or tags that fit no place of the camera.
    """
    camera = rig.camera
    found = read_tags(frame.luma, {tag.family for tag in rig.plate})
    own, seen = [], []
    for tag in rig.plate:
        for quad in found.get((tag.family, tag.id), [])[:1]:
            corners = tag_corners(tag)
            own.append(np.column_stack((corners, np.full(4, tag.height))))
            seen.append(quad)
    if len(own) < 2:
        raise InvalidInput(
            "camera",
            found=f"{len(own)} tags of the plate in the picture",
            expected="at least two to find the camera's place from",
        )
    points, pixels = np.concatenate(own), np.concatenate(seen)

    def placed(unknown: FloatArray) -> Camera:
        turn = _rotation(unknown[:3])
        return Camera(
            lens=camera.lens,
            rotation=turn @ camera.rotation,
            translation=turn @ camera.translation + unknown[3:],
        )

    fitted = least_squares(
        lambda x: np.asarray((placed(x).project(points) - pixels).ravel()), np.zeros(6)
    )
    rest = float(np.sqrt(np.mean(fitted.fun**2)))
    if rest > 2.0:
        raise InvalidInput(
            "camera",
            found=f"tags of the plate that are {rest:.1f} px off wherever the camera is put",
            expected="tags at the places the rig says",
            hint="was one of them moved? calibrate the plate anew",
        )
    return placed(fitted.x)


def _rotation(vector: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())
