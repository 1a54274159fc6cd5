"""Cameras in OpenCV's storage files (YAML, XML, JSON), and in ROS camera_info files."""

from __future__ import annotations

from codecs import BOM_UTF8
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.io.atomic import read_bounded, refuse_ending, write_whole, written_whole
from fixel.io.document import MAX_BYTES, yaml_text
from fixel.typing import FloatArray
from fixel.vision.camera import Camera, MeasuredCamera
from fixel.vision.frame import opencv
from fixel.vision.lens import Lens

MATRIX: Final = (
    "camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "K", "M1", "mtx",
)  # fmt: skip
DISTORTION: Final = (
    *("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs"),
    *("dist_coeff", "dist", "D", "D1"),
)
WIDTH: Final = ("image_width", "image_Width", "width")
HEIGHT: Final = ("image_height", "image_Height", "height")
ENDINGS: Final = {"opencv": (".yml", ".yaml", ".xml", ".json"), "ros": (".yaml", ".yml")}


def lens_of(
    size: tuple[int, int], matrix: FloatArray, distortion: FloatArray, *, fisheye: bool = False
) -> Lens:
    """Build a lens from OpenCV's camera matrix and distortion coefficients."""
    k = np.asarray(matrix, dtype=np.float64)
    if k.shape != (3, 3) or not np.isfinite(k).all():
        raise InvalidInput("camera_matrix", found=k.tolist(), expected="3 x 3 finite numbers")
    if k[0, 0] <= 0.0:
        expected = "a calibrated camera: focal lengths above 0 px"
        raise InvalidInput(
            "camera_matrix", found=f"a focal length of {k[0, 0]:g} px", expected=expected
        )
    if (np.abs([k[1, 0], k[2, 0], k[2, 1], k[2, 2] - 1.0]) > 1e-9).any():
        raise InvalidInput(
            "camera_matrix", found=k.tolist(), expected="fx, skew, cx; 0, fy, cy; 0, 0, 1"
        )
    if k[0, 1] and not fisheye:
        raise InvalidInput(
            "camera_matrix",
            found=f"a skew of {k[0, 1]:g} px",
            expected="0: OpenCV ignores skew in projections",
            hint="set it to 0 if the coefficients come from OpenCV or ROS",
        )
    lens = Lens(
        image_size=size,
        focal=(k[0, 0], k[1, 1]),  # type: ignore[arg-type]
        centre=(k[0, 2], k[1, 2]),  # type: ignore[arg-type]
        skew=k[0, 1] / k[0, 0],
        distortion=np.ravel(distortion),
        fisheye=fisheye,
    )
    check_plausible(lens)
    return lens


def check_plausible(lens: Lens) -> None:
    """Reject an implausible lens, for example with numbers of another resolution or in mm."""
    width, height = lens.image_size
    u, v = lens.centre
    if not (0.0 < u < width and 0.0 < v < height):
        raise InvalidInput(
            "centre",
            found=f"({u:.0f}, {v:.0f}) px in pictures of {width} x {height} px",
            expected="a point in the picture",
            hint="check whether the values belong to another resolution",
        )
    least = width / 20.0  # a view of 170 degrees
    if not 0.1 < lens.focal[0] / lens.focal[1] < 10.0 or lens.focal[0] < least:
        expected = f"two similar focal lengths above {least:g} px in pictures {width} px wide"
        hint = "convert lengths in mm, or shares of the width, to pixels"
        raise InvalidInput("focal", found=lens.focal.tolist(), expected=expected, hint=hint)


def placed_above(lens: Lens, rotation: FloatArray, translation: FloatArray) -> tuple[Camera, bool]:
    """Build a placed camera; also return whether the plane's y and z axes had to be reversed."""
    # If the world's z points away from the camera, half a turn about x reverses it.
    turned = bool((-rotation.T @ translation)[2] < 0.0)
    if turned:
        rotation = rotation @ np.diag([1.0, -1.0, -1.0])
    return Camera(lens=lens, rotation=rotation, translation=translation), turned


def matrix_of(lens: Lens) -> FloatArray:
    """OpenCV's camera matrix of a lens, (3, 3)."""
    (fx, fy), (cx, cy) = lens.focal, lens.centre
    return np.array([[fx, fx * lens.skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def opencv_camera(path: Path, size: tuple[int, int] | None) -> MeasuredCamera:
    """Load the camera of a storage file; `size` is used if the file has no picture size [px]."""
    cv2 = opencv()
    try:
        data = read_bounded(path, "a camera file", MAX_BYTES).removeprefix(BOM_UTF8)
        text = data.decode("latin-1")
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        try:
            return _read(storage, size)
        finally:
            storage.release()
    except (cv2.error, SystemError):  # the second by its bindings when the parser fails
        found, expected = "a file that OpenCV cannot read", "an OpenCV storage"
        raise InvalidInput("file", found=found, expected=expected) from None


def save_opencv(lens: Lens, path: str | Path) -> None:
    """Write a lens in the format of OpenCV's calibration program."""
    _check_export(lens, path, "opencv")
    cv2 = opencv()
    with written_whole(path) as unfinished:
        storage = cv2.FileStorage(str(unfinished), cv2.FILE_STORAGE_WRITE)
        try:
            width, height = lens.image_size
            storage.write("image_width", width)
            storage.write("image_height", height)
            storage.write("fisheye_model", int(lens.fisheye))
            storage.write("camera_matrix", matrix_of(lens))
            storage.write("distortion_coefficients", lens.distortion.reshape(1, -1).copy())
        finally:
            storage.release()


def save_ros(lens: Lens, path: str | Path, name: str = "camera") -> None:
    """Write a lens as a ROS camera_info file."""
    _check_export(lens, path, "ros")
    width, height = lens.image_size
    matrix = matrix_of(lens)
    model, count = "equidistant", 4
    if not lens.fisheye:
        long = lens.distortion[5:].any()
        model, count = ("rational_polynomial", 8) if long else ("plumb_bob", 5)
    content = {
        "image_width": width,
        "image_height": height,
        "camera_name": name,
        "camera_matrix": _ros_matrix(matrix),
        "distortion_model": model,
        "distortion_coefficients": _ros_matrix(lens.distortion[None, :count]),
        "rectification_matrix": _ros_matrix(np.eye(3)),
        "projection_matrix": _ros_matrix(np.column_stack([matrix, np.zeros(3)])),
    }
    write_whole(path, yaml_text(content))


def _read(storage: Any, size: tuple[int, int] | None) -> MeasuredCamera:
    matrix = _matrix(storage, MATRIX, "the camera matrix")
    distortion = _matrix(storage, DISTORTION, "the distortion coefficients")
    width, height = _number(storage, WIDTH), _number(storage, HEIGHT)
    stated = (int(width), int(height)) if width and height else None
    said = stated or _pair(storage.getNode("image_size")) or size
    if said is None:
        expected = "the size of the pictures it was calibrated with"
        hint = "give it with --size, such as --size 1280x720"
        raise InvalidInput("image_width", found=None, expected=expected, hint=hint)
    fisheye = bool(_number(storage, ("fisheye_model", "fisheye")))
    return MeasuredCamera(lens=lens_of(said, matrix, distortion, fisheye=fisheye))


def _matrix(storage: Any, names: tuple[str, ...], what: str) -> FloatArray:
    for name in names:
        node = storage.getNode(name)
        if not node.empty():
            found = node.mat()
            if found is None:
                raise InvalidInput(name, found="no matrix", expected=what)
            return np.asarray(found, dtype=np.float64)
    raise InvalidInput(names[0], found=None, expected=f"{what}, as one of " + ", ".join(names))


def _number(storage: Any, names: tuple[str, ...]) -> float | None:
    for name in names:
        node = storage.getNode(name)
        if (node.isInt() or node.isReal()) and abs(node.real()) < 1e9:
            return float(node.real())
    return None


def _pair(node: Any) -> tuple[int, int] | None:
    if node.empty() or not node.isSeq() or node.size() != 2:
        return None
    sides = node.at(0).real(), node.at(1).real()
    return (int(sides[0]), int(sides[1])) if np.isfinite(sides).all() else None


def _ros_matrix(matrix: FloatArray) -> dict[str, Any]:
    rows, cols = matrix.shape
    return {"rows": rows, "cols": cols, "data": matrix.ravel().tolist()}


def _check_export(lens: Lens, path: str | Path, format: str) -> None:
    refuse_ending(path, ENDINGS[format], "camera")
    if lens.skew and not lens.fisheye:
        width = lens.skew * lens.image_size[1] / 2.0
        found = f"a skew of {lens.skew:g}"
        expected = "no skew: OpenCV and ROS ignore it in projections"
        hint = f"positions at the edge would be {abs(width):.2f} px wrong"
        raise InvalidInput("lens.skew", found=found, expected=expected, hint=hint)
