"""`Calib_Results` (.m and .mat) of the camera calibration toolbox for MATLAB by J.-Y. Bouguet.

Its pixels count from the centre of the upper left one, its coefficients are k1, k2, p1, p2, k3, and
its uncertainties are three standard deviations. Only numbers are read; no code is run.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats.camera_opencv import check_plausible, placed_above
from fixel.typing import FloatArray
from fixel.vision.camera import Camera, MeasuredCamera, turned
from fixel.vision.lens import FOCAL, Lens

ASSIGNMENT: Final = re.compile(r"^\s*(\w+)\s*=\s*(\[[^\]]*\]|[-+.\deE]+)\s*;?", re.MULTILINE)
COEFFICIENTS: Final = ("k1", "k2", "p1", "p2", "k3")
NEARBY: Final = (0.01, 100.0)  # [m] plausible distances of a camera from its plate

Variables = dict[str, FloatArray]


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
            raise InvalidInput(
                name, found=None, expected=what, hint="is this a Calib_Results of the toolbox?"
            )
    size = (int(_row(found, "nx", 1)[0]), int(_row(found, "ny", 1)[0]))
    kc = found.get("kc", np.zeros(1)).ravel()
    if len(kc) > 5:
        raise InvalidInput(
            "kc", found=f"{len(kc)} numbers", expected="at most k1, k2, p1, p2 and k3"
        )
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


def _of_mat(data: bytes) -> Variables:
    from scipy.io import loadmat

    try:
        content: dict[str, Any] = loadmat(io.BytesIO(data))
    except NotImplementedError:
        raise InvalidInput(
            "file",
            found="MATLAB's format of version 7.3",
            expected="an older version",
            hint="in MATLAB: save('Calib_Results_v7.mat', '-v7')",
        ) from None
    except Exception as problem:
        # scipy lets any error of its parser pass: TypeError, zlib.error, MemoryError, ...
        raise InvalidInput(
            "file", found=f"a file that scipy cannot read ({problem})", expected="a MATLAB file"
        ) from None
    return {
        name: np.asarray(value, dtype=np.float64)
        for name, value in content.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "iuf"
    }
