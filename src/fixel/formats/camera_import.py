"""Import of cameras calibrated by other programs: MATLAB's toolbox, OpenCV, Kalibr and ROS.

All four count pixels from the centre of the upper left one, as fixel does; the MATLAB toolbox too,
though MATLAB itself counts from 1.
"""

from __future__ import annotations

import re
import shlex
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput, check_name
from fixel.formats.camera_opencv import check_plausible, lens_of, opencv_camera, placed_above
from fixel.formats.records import within
from fixel.io.atomic import read_bounded
from fixel.io.document import MAX_BYTES, read_document
from fixel.typing import FloatArray
from fixel.vision.camera import Camera, MeasuredCamera, turned
from fixel.vision.lens import FOCAL, Lens

FORMATS: Final = ("matlab", "opencv", "kalibr", "ros")
ASSIGNMENT: Final = re.compile(r"^\s*(\w+)\s*=\s*(\[[^\]]*\]|[-+.\deE]+)\s*;?", re.MULTILINE)
COEFFICIENTS: Final = ("k1", "k2", "p1", "p2", "k3")
NEARBY: Final = (0.01, 100.0)  # [m] plausible distances of a camera from its plate
MAX_BRACKETS: Final = 10_000  # lists and mappings in an OpenCV storage, which has tens
# Kinds of elements in a MATLAB file, its flag of complex numbers, and its types of numbers.
_ARRAY, _COMPRESSED, _COMPLEX = 14, 15, 0x800
_NUMBERS: Final = dict(zip((*range(1, 8), 9, 12, 13), "bBhHiIfdqQ", strict=True))
MAX_UNPACKED: Final = 100_000_000  # [bytes] of a MATLAB file
MAX_ARRAY: Final = 100_000  # [bytes] of its variables that are read
PINHOLE: Final = {"plumb_bob": 5, "rational_polynomial": 8}


Variables = dict[str, FloatArray]


def import_camera(
    path: str | Path,
    format: str = "auto",
    *,
    size: tuple[int, int] | None = None,
    which: str = "",
    unit: float = 1e-3,
) -> tuple[MeasuredCamera, tuple[str, ...]]:
    """Load a camera that another program calibrated; return also caveats, one sentence each.

    The format is one of `FORMATS`, or `auto` to recognise it from the file. `size` is that of the
    calibration pictures, if the file lacks it [px], `which` the name of one of several cameras in a
    Kalibr file, and `unit` the unit of lengths in a MATLAB file [m], which its user chose. A file
    that cannot be read, or would be misinterpreted, raises `InvalidInput`.
    """
    path = Path(path)
    kind = _kind_of(path) if format == "auto" else format
    readers: dict[str, Callable[[], tuple[MeasuredCamera, tuple[str, ...]]]] = {
        "matlab": lambda: matlab_camera(path, _head(path), unit),
        "opencv": lambda: (opencv_camera(path, size), ()),
        "kalibr": lambda: (MeasuredCamera(lens=_kalibr(path, which)), ()),
        "ros": lambda: (MeasuredCamera(lens=_ros(path)), ()),
    }
    check_name("format", kind, ("auto", *FORMATS))
    try:
        # OpenCV does not say why a file cannot be read, and its parser dies of deep nesting.
        if kind == "opencv" and len(re.findall(rb"[\[{]|<\w", _head(path))) > MAX_BRACKETS:
            found, expected = f"more than {MAX_BRACKETS} brackets", "an OpenCV storage of a camera"
            raise InvalidInput("file", found=found, expected=expected)
        camera, remarks = readers[kind]()
    except InvalidInput as problem:
        where = str(path) if problem.where == "file" else problem.where
        if not where.startswith(str(path)):
            where = f"{path}: {where}"
        raise problem.at(where) from None
    if size is not None and tuple(size) != camera.lens.image_size:
        camera.for_pictures_of(size)
    return replace(camera, source=f"{path.name}, {kind}"), remarks


def _kind_of(path: Path) -> str:
    head = _head(path)
    if path.suffix.lower() in (".m", ".mat"):
        return "matlab"
    if b"fixel_camera" in head:
        found, expected = "a camera file of fixel already", "a camera file of another program"
        hint = f"run: {shlex.join(['fixel', 'camera', 'check', path.name])}"
        raise InvalidInput(str(path), found=found, expected=expected, hint=hint)
    if b"opencv-matrix" in head or b"<opencv_storage" in head:
        return "opencv"
    if b"distortion_model" in head and b"camera_model" in head:
        return "kalibr"
    if b"distortion_model" in head:
        return "ros"
    expected = "Calib_Results.m or .mat, an OpenCV storage, a Kalibr camchain or a ROS camera"
    hint = "choose the format with --format " + " | ".join(FORMATS)
    raise InvalidInput(str(path), found="a file of unknown format", expected=expected, hint=hint)


def _head(path: Path) -> bytes:
    return read_bounded(path, "a camera file", MAX_BYTES)


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
    if (model := one.get("camera_model")) != "pinhole":
        found, expected = repr(model), "pinhole, the only model that fixel reads"
        hint = "calibrate again with --models pinhole-radtan or pinhole-equi"
        raise InvalidInput("camera_model", found=found, expected=expected, hint=hint)
    model = one.get("distortion_model")
    check_name("distortion_model", model, ("radtan", "equidistant", "none"))
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
    model: Any = raw.get("distortion_model")
    check_name("distortion_model", model, (*PINHOLE, "equidistant"))
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
        found, expected = f"{len(coefficients)} numbers", f"at most {most} for {model}"
        raise InvalidInput("distortion_coefficients", found=found, expected=expected)
    size = tuple(
        int(numbers(raw, name, 1)[0])
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
        where, found = ("roi", "a cropped picture") if cropped else ("binning_x", "binned pixels")
        expected = "the calibration of whole pictures"
        hint = "calibrate at the picture size of the experiments"
        raise InvalidInput(where, found=found, expected=expected, hint=hint)


def numbers(raw: Any, key: str, count: int | None, within_key: str = "") -> list[float]:
    """Return the finite numbers under a key, a scalar as a list of one; raise if not `count`."""
    value = raw.get(key) if isinstance(raw, dict) else None
    row: list[Any] = value if isinstance(value, list) else [value]
    good = [float(n) for n in row if type(n) in (int, float) and abs(n) < 1e30]
    if len(good) < len(row) or (count is not None and len(row) != count):
        found, expected = value, {None: "numbers", 1: "a number"}.get(count, f"{count} numbers")
        raise InvalidInput(f"{within_key}{key}", found=found, expected=expected)
    return good


# --- Calib_Results (.m and .mat) of the camera calibration toolbox for MATLAB by J.-Y. Bouguet ----
# Its coefficients are k1, k2, p1, p2, k3, and its uncertainties are three standard deviations. Only
# numbers are read; no code is run.


def matlab_camera(path: Path, data: bytes, unit: float) -> tuple[MeasuredCamera, tuple[str, ...]]:
    """Load the camera of a `Calib_Results` file, with caveats; `unit` is that of lengths [m]."""
    found = _of_mat(data) if path.suffix.lower() == ".mat" else _of_m(data)
    lens = _lens(found)
    names, deviations = _deviations(found)
    remarks = []
    if names:
        remarks.append(
            "standard deviations of the lens are those of the file; it has no correlations, so "
            "they are assumed independent"
        )
    camera, remark = _camera(found, lens, unit)
    measured = MeasuredCamera(
        lens=lens,
        camera=camera,
        names=names,
        covariance=np.diag(np.square(deviations)),
        noise=_noise(found),
    )
    return measured, (*remarks, *remark)


def _lens(found: Variables) -> Lens:
    for name, what in (("fc", "focal lengths [px]"), ("cc", "principal point [px]"),
                       ("nx", "width of the pictures [px]"), ("ny", "height [px]")):  # fmt: skip
        if name not in found:
            hint = "is this a Calib_Results of the toolbox?"
            raise InvalidInput(name, found=None, expected=what, hint=hint)
    size = (int(_row(found, "nx", 1)[0]), int(_row(found, "ny", 1)[0]))
    kc = found.get("kc", np.zeros(1)).ravel()
    if len(kc) > 5:
        raise InvalidInput("kc", found=f"{len(kc)} numbers", expected="at most k1, k2, p1, p2, k3")
    lens = Lens(
        image_size=size,
        focal=_row(found, "fc", 2),
        centre=_row(found, "cc", 2),
        skew=float(_row(found, "alpha_c", 1)[0]) if "alpha_c" in found else 0.0,
        distortion=kc if kc.size else np.zeros(1),
    )
    check_plausible(lens)
    return lens


def _deviations(found: Variables) -> tuple[tuple[str, ...], FloatArray]:
    """Names and standard deviations of the lens parameters whose error is in the file."""
    rows: dict[str, float] = {}
    for key, names in (
        ("fc_error", FOCAL[:2]),
        ("cc_error", FOCAL[2:4]),
        ("alpha_c_error", FOCAL[4:]),
        ("kc_error", COEFFICIENTS),
    ):
        rows |= dict(zip(names, found.get(key, np.zeros(0)).ravel().tolist(), strict=False))
    known = {name: error / 3.0 for name, error in rows.items() if 0.0 < error < np.inf}
    return tuple(known), np.array(list(known.values()))


def _noise(found: Variables) -> float | None:
    error = found.get("err_std")
    if error is None or not np.isfinite(error).all() or not (error > 0.0).all():
        return None
    return float(np.sqrt(np.mean(np.square(error))))


def _camera(found: Variables, lens: Lens, unit: float) -> tuple[Camera | None, tuple[str, ...]]:
    if "Tc_ext" not in found or not {"omc_ext", "Rc_ext"} & set(found):
        return None, ("the file has no plane (Tc_ext): place the camera with fixel camera place",)
    rotation = (
        turned(np.eye(3), _row(found, "omc_ext", 3))
        if "omc_ext" in found
        else found["Rc_ext"].reshape(3, 3)
    )
    translation = unit * _row(found, "Tc_ext", 3)
    away = float(np.linalg.norm(translation))
    if not NEARBY[0] < away < NEARBY[1]:
        raise InvalidInput(
            "Tc_ext",
            found=f"a plane {away:g} m from the camera",
            expected="a plane at 1 cm to 100 m",
            hint="choose the unit of the file: --unit mm, cm or m",
        )
    camera, round_ = placed_above(lens, rotation, translation)
    remark = (
        "the z axis of the file points away from the camera, so the y axis of the world is that "
        "of the file reversed"
    )
    return camera, (remark,) if round_ else ()


def _row(found: Variables, name: str, count: int) -> FloatArray:
    row = found[name].ravel()
    if len(row) != count or not np.isfinite(row).all():
        raise InvalidInput(name, found=row.tolist(), expected=f"{count} finite numbers")
    return row


def _of_m(data: bytes) -> Variables:
    text = data.decode("latin-1")
    text = re.sub(r"%[^\n]*", "", text).replace("...\n", " ")
    found: Variables = {}
    for name, value in ASSIGNMENT.findall(text):
        rows = [row.replace(",", " ").split() for row in re.split(r"[;\n]", value.strip("[] \n"))]
        try:
            table = [[float(number) for number in row] for row in rows if row]
            found[name] = np.array(table, dtype=np.float64)
        except ValueError:
            continue  # an expression, or rows of several lengths: none of the variables needed
    return found


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of the elements of a MATLAB file, or of one of its elements."""
    place = 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        begin = place + 8
        place = begin + size + (0 if kind == _COMPRESSED else -size % 8)
        if kind >> 16:  # at most 4 bytes, next to their size
            kind, size, place = kind & 0xFFFF, min(kind >> 16, 4), begin
            begin -= 4
        yield kind, data[begin : begin + size]


def _of_mat(data: bytes) -> Variables:
    """Return the arrays of real numbers; `scipy.io` ends the process on some damaged files."""
    found: Variables = {}
    order, left = {b"\0\1IM": "<", b"\1\0MI": ">"}.get(data[124:128]), MAX_UNPACKED
    if order is None:
        expected, hint = "a MATLAB file of version 5 to 7", "in MATLAB: save('Calib.mat', '-v7')"
        raise InvalidInput("file", found="another format", expected=expected, hint=hint)
    try:
        for kind, content in _elements(data[128:], order):
            if kind == _COMPRESSED:
                content = zlib.decompressobj().decompress(content, left + 1)
                left -= len(content)
                if left < 0:
                    raise InvalidInput(f"more than {MAX_UNPACKED // 10**6} MB, unpacked")
                ((kind, content),) = _elements(content, order)
            if kind == _ARRAY:
                (_, flags), (_, shape), (_, name), *rest = _elements(content, order)
                (flag,) = struct.unpack_from(f"{order}I", flags)
                is_real = 6 <= flag & 0xFF <= 15 and not flag & _COMPLEX
                if is_real and len(rest[0][1]) < MAX_ARRAY:
                    row = np.frombuffer(rest[0][1], order + _NUMBERS[rest[0][0]]).astype(float)
                    sides = np.frombuffer(shape, f"{order}i4")
                    found[name.decode()] = row.reshape(sides, order="F")
    except Exception as problem:  # of damaged content: of several types
        raise InvalidInput("file", found=problem, expected="a MATLAB file") from None
    return found
