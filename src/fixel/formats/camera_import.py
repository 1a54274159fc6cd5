"""Import of cameras calibrated by other programs: MATLAB's toolbox, OpenCV, Kalibr and ROS.

All four count pixels from the centre of the upper left one, as fixel does; the MATLAB toolbox too,
though MATLAB itself counts from 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.errors import InvalidInput, os_reason
from fixel.formats.camera_matlab import matlab_camera
from fixel.formats.camera_opencv import lens_of, opencv_camera
from fixel.formats.records import within
from fixel.io.document import MAX_BYTES, read_document
from fixel.vision.camera import MeasuredCamera
from fixel.vision.lens import Lens

FORMATS: Final = ("matlab", "opencv", "kalibr", "ros")
PINHOLE: Final = {"plumb_bob": 5, "rational_polynomial": 8}


@final
@dataclass(frozen=True, slots=True)
class ImportedCamera:
    """Camera that another program calibrated.

    Attributes
    ----------
    camera : MeasuredCamera
    format : str
        One of `FORMATS`.
    remarks : tuple of str
        Caveats, one sentence each.
    """

    camera: MeasuredCamera
    format: str
    remarks: tuple[str, ...] = ()


def import_camera(
    path: str | Path,
    format: str = "auto",
    *,
    size: tuple[int, int] | None = None,
    which: str = "",
    unit: float = 1e-3,
) -> ImportedCamera:
    """Load a camera that another program calibrated.

    Parameters
    ----------
    path : str or Path
    format : str
        One of `FORMATS`, or `auto` to recognise the format from the file.
    size : (int, int), optional
        Width and height of the calibration pictures, if the file lacks them [px].
    which : str
        Name of one of several cameras in a Kalibr file, such as `cam0`.
    unit : float
        Unit of lengths in a MATLAB file [m]: the one its user chose, mostly millimetres.

    Raises
    ------
    InvalidInput
        The file cannot be read, or would be misinterpreted.
    """
    path = Path(path)
    kind = _kind_of(path) if format == "auto" else format
    readers: dict[str, Callable[[], tuple[MeasuredCamera, tuple[str, ...]]]] = {
        "matlab": lambda: matlab_camera(path, _head(path), unit),
        "opencv": lambda: (opencv_camera(path, size), ()),
        "kalibr": lambda: (MeasuredCamera(lens=_kalibr(path, which)), ()),
        "ros": lambda: (MeasuredCamera(lens=_ros(path)), ()),
    }
    if kind not in readers:
        raise InvalidInput("format", found=repr(kind), expected="auto, " + ", ".join(FORMATS))
    try:
        if kind == "opencv":
            _head(path)  # OpenCV does not say why a file cannot be read
        camera, remarks = readers[kind]()
    except InvalidInput as problem:
        where = str(path) if problem.where == "file" else problem.where
        if not where.startswith(str(path)):
            where = f"{path}: {where}"
        raise InvalidInput(
            where, found=problem.found, expected=problem.expected, hint=problem.hint
        ) from None
    if size is not None and tuple(size) != camera.lens.image_size:
        camera.for_pictures_of(size)
    return ImportedCamera(replace(camera, source=f"{path.name}, {kind}"), kind, remarks)


def _kind_of(path: Path) -> str:
    head = _head(path)
    if path.suffix.lower() in (".m", ".mat"):
        return "matlab"
    if b"fixel_camera" in head:
        raise InvalidInput(
            str(path),
            found="a camera file of fixel already",
            expected="a camera file of another program",
            hint=f"run: fixel camera check {path.name}",
        )
    if b"opencv-matrix" in head or b"<opencv_storage" in head:
        return "opencv"
    if b"distortion_model" in head and b"camera_model" in head:
        return "kalibr"
    if b"distortion_model" in head:
        return "ros"
    raise InvalidInput(
        str(path),
        found="a file of unknown format",
        expected="Calib_Results.m or .mat, an OpenCV storage, a Kalibr camchain or a ROS camera",
        hint="choose the format with --format " + " | ".join(FORMATS),
    )


def _head(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise InvalidInput(str(path), found="no such file", expected="a camera file")
        if path.stat().st_size > MAX_BYTES:
            raise InvalidInput(
                str(path), found="a file larger than 10 MB", expected="a camera file of some kB"
            )
        return path.read_bytes()
    except OSError as problem:
        reason = os_reason(problem)
        raise InvalidInput(str(path), found=reason, expected="a file that can be read") from None


def _kalibr(path: Path, which: str) -> Lens:
    raw = read_document(path)
    cameras = {
        name: each
        for name, each in (raw.items() if isinstance(raw, dict) else ())
        if isinstance(each, dict) and "intrinsics" in each
    }
    if not cameras or (which and which not in cameras) or (len(cameras) > 1 and not which):
        raise InvalidInput(
            "camera",
            found=repr(which) if which else f"{len(cameras)} cameras",
            expected="one of " + ", ".join(cameras) if cameras else "cam0 with its intrinsics",
            hint="choose one: --which cam0" if len(cameras) > 1 else None,
        )
    name = which or next(iter(cameras))
    with within(name):
        return _kalibr_lens(cameras[name])


def _kalibr_lens(one: dict[str, Any]) -> Lens:
    if one.get("camera_model") != "pinhole":
        raise InvalidInput(
            "camera_model",
            found=repr(one.get("camera_model")),
            expected="pinhole, the only model that fixel reads",
            hint="calibrate again with --models pinhole-radtan or pinhole-equi",
        )
    model = one.get("distortion_model")
    if model not in ("radtan", "equidistant", "none"):
        raise InvalidInput(
            "distortion_model", found=repr(model), expected="radtan, equidistant or none"
        )
    fx, fy, cx, cy = numbers(one, "intrinsics", 4)
    coefficients = [0.0] if model == "none" else numbers(one, "distortion_coeffs", 4)
    width, height = numbers(one, "resolution", 2)
    return lens_of(
        (int(width), int(height)),
        np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        np.array(coefficients),
        fisheye=model == "equidistant",
    )


def _ros(path: Path) -> Lens:
    raw = read_document(path)
    if not isinstance(raw, dict):
        raise InvalidInput("camera_info", found="no keys", expected="a ROS camera_info file")
    _refuse_cropped(raw)
    model = raw.get("distortion_model")
    if model not in (*PINHOLE, "equidistant"):
        raise InvalidInput(
            "distortion_model",
            found=repr(model),
            expected="plumb_bob, rational_polynomial or equidistant",
        )
    matrix, coefficients = (
        numbers(raw, message, count)
        if message in raw
        else numbers(raw.get(key), "data", count, f"{key}.")
        for message, key, count in (
            ("K" if "K" in raw else "k", "camera_matrix", 9),
            ("D" if "D" in raw else "d", "distortion_coefficients", None),
        )
    )
    most = PINHOLE.get(model, 4)
    if len(coefficients) > most:
        raise InvalidInput(
            "distortion_coefficients",
            found=f"{len(coefficients)} numbers",
            expected=f"at most {most} for {model}",
        )
    size = tuple(
        int(numbers(raw, name, None)[0])
        for name in (("width", "height") if "width" in raw else ("image_width", "image_height"))
    )
    return lens_of(
        (size[0], size[1]),
        np.reshape(matrix, (3, 3)),
        np.array(coefficients or [0.0]),
        fisheye=model == "equidistant",
    )


def _refuse_cropped(raw: dict[str, Any]) -> None:
    roi = raw.get("roi")
    cropped = isinstance(roi, dict) and any(
        roi.get(key) for key in ("x_offset", "y_offset", "width", "height")
    )
    binned = any((raw.get(key) or 0) not in (0, 1) for key in ("binning_x", "binning_y"))
    if cropped or binned:
        raise InvalidInput(
            "roi" if cropped else "binning_x",
            found="a cropped picture" if cropped else "binned pixels",
            expected="the calibration of whole pictures",
            hint="calibrate at the picture size of the experiments",
        )


def numbers(raw: Any, key: str, count: int | None, within_key: str = "") -> list[float]:
    """Return the finite numbers under a key, a scalar as a list of one; raise if not `count`."""
    value = raw.get(key) if isinstance(raw, dict) else None
    row: list[Any] = value if isinstance(value, list) else [value]
    good = [float(n) for n in row if type(n) in (int, float) and abs(n) < 1e30]
    if len(good) < len(row) or (count is not None and len(row) != count):
        raise InvalidInput(
            f"{within_key}{key}",
            found=value,
            expected=f"{count} numbers" if count and count > 1 else "numbers",
        )
    return good
