"""Text output of the commands of `fixel camera`."""

import math
from typing import TYPE_CHECKING, Any

from fixel.table import Column, Table

if TYPE_CHECKING:
    from fixel.workflows.acquisition.camera.calibrate import CameraAnswer

MAX_ROWS = 40


def lens_lines(answer: "CameraAnswer") -> list[str]:
    """Lines with resolution and parameters, and their standard deviations."""
    camera, lens = answer.camera, answer.camera.lens
    width, height = lens.image_size
    known = camera.deviations

    def number(name: str, value: float, unit: str = " px") -> str:
        spread = f" +- {known[name]:.2g}" if name in known else ""
        return f"{name} {value:.6g}{spread}{unit}"

    names = (
        ("k1", "k2", "k3", "k4")
        if lens.fisheye
        else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    )
    terms = [
        number(name, value, "")
        for name, value in zip(names, lens.distortion.tolist(), strict=True)
        if value or name in known
    ]
    skew = [number("skew", lens.skew, "")] if lens.skew else []
    lines = [
        f"{'fisheye' if lens.fisheye else 'lens'} for pictures of {width} x {height} px",
        "  " + ", ".join(number(n, v) for n, v in zip(("fx", "fy"), lens.focal, strict=True)),
        "  " + ", ".join(number(n, v) for n, v in zip(("cx", "cy"), lens.centre, strict=True)),
    ]
    return [*lines, "  " + ", ".join(skew + terms)] if skew or terms else lines


def view_lines(answer: "CameraAnswer") -> list[str]:
    """Table of the pictures, and of those that were left out."""
    found = answer.calibration
    assert found is not None
    rows = [(u.name, u.corners, u.rms, math.degrees(u.tilt)) for u in found.used]
    residual, tilt = Column("rms", "px", ".3f"), Column("tilt", "deg", ".0f")
    pictures = Table(("picture", "corners", residual, tilt), rows)
    used = {u.name for u in found.used}
    left_out = [f"  {d.name}: {d.reason}" for d in found.dropped if d.name not in used]
    partly = [f"  {d.name}: {d.reason}" for d in found.dropped if d.name in used]
    return [
        *pictures.lines(MAX_ROWS),
        *([f"... and {len(rows) - MAX_ROWS} more"] if len(rows) > MAX_ROWS else []),
        f"{len(rows)} pictures used, rms {found.rms:.3f} px",
        *([f"left out ({len(left_out)}):", *left_out[:MAX_ROWS]] if left_out else []),
        *([f"used in part ({len(partly)}):", *partly[:MAX_ROWS]] if partly else []),
    ]


def coefficient_lines(answer: "CameraAnswer") -> list[str]:
    """Line with the error on held-out pictures by number of distortion coefficients."""
    found = answer.calibration
    assert found is not None
    if not found.unseen:
        return []
    known = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    used = sum(name in known for name in answer.camera.names)
    errors = ", ".join(f"{count}: {rms:.4f} px" for count, rms in found.unseen.items())
    more = (
        "more than 5 are needed"
        if used > 5
        else "more are not needed; with fewer, errors in the corners are underestimated"
    )
    return [
        f"RMS error of held-out pictures by number of distortion coefficients: {errors}. "
        f"{used} used; {more}."
    ]


def corner_lines(answer: "CameraAnswer") -> list[str]:
    """Warning of the corners of the picture that no board was near."""
    from fixel.workflows.acquisition.camera.calibrate import empty_corners

    empty = empty_corners(answer.camera.seen)
    if not empty:
        return ["The boards cover all corners of the picture."]
    return [
        f"No board was near {len(empty)} of 4 corners of the picture ({', '.join(empty)}): "
        "take more pictures with the board there, since the lens is extrapolated there."
    ]


def place_lines(answer: "CameraAnswer") -> list[str]:
    """Line with the position of the camera."""
    camera = answer.camera.camera
    if camera is None:
        return []
    x, y, z = 1e3 * camera.position
    tilt = answer.camera.camera and _tilt(camera.rotation)
    return [
        f"camera {z:.1f} mm above the plate, over x {x:.1f} mm, y {y:.1f} mm, tilted by "
        f"{tilt:.1f} deg; {1e3 * camera.metres_per_pixel():.3g} mm per pixel on the plate"
    ]


def _tilt(rotation: Any) -> float:
    return math.degrees(math.acos(max(-1.0, min(1.0, -rotation[2, 2]))))


def misfit_lines(answer: "CameraAnswer") -> list[str]:
    """Distance between the points of the plate and their nominal places."""
    found = answer.placement
    assert found is not None
    summary = answer.summary()
    return [
        f"{summary['points']} points are off their nominal positions by "
        f"{1e3 * summary['misfit_rms_m']:.2g} mm (rms, {found.rms:.2g} px), at most "
        f"{1e3 * summary['misfit_worst_m']:.2g} mm"
    ]


def verdict_lines(answer: "CameraAnswer") -> list[str]:
    """Accuracy of places at each height."""
    return [f"{each.sentence}." for each in answer.verdicts]


def remark_lines(answer: "CameraAnswer") -> list[str]:
    """Remarks about a file."""
    return [f"note: {remark}" for remark in answer.remarks]
