"""Results of calibrating and placing a camera, and the accuracy of places on the plate."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.vision.calibrate_lens import LensCalibration
from fixel.vision.camera import MeasuredCamera
from fixel.vision.lens import BROWN, FISHEYE
from fixel.vision.place_camera import Placement
from fixel.vision.plane_errors import PlaneErrors, plane_errors

CORNERS: Final = ("upper left", "upper right", "lower left", "lower right")
MAX_ROWS: Final = 40  # pictures in the text of a calibration


class CameraAnswer(NamedTuple):
    """Result of calibrating, importing, exporting or placing a camera."""

    camera: MeasuredCamera
    file: Path | None = None  # camera file that was written
    calibration: LensCalibration | None = None
    placement: Placement | None = None
    verdicts: tuple[PlaceAccuracy, ...] = ()  # accuracy at each requested height
    remarks: tuple[str, ...] = ()
    plot: Path | None = None

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        lens, found = self.camera.lens, self.calibration
        answer: dict[str, Any] = {
            "image_size_px": list(lens.image_size),
            "focal_px": lens.focal.tolist(),
            "centre_px": lens.centre.tolist(),
            "skew": lens.skew,
            "distortion": lens.distortion.tolist(),
            "fisheye": lens.fisheye,
            "standard_deviations": self.camera.deviations,
            "noise_px": self.camera.noise,
            "remarks": list(self.remarks),
            "file": str(self.file) if self.file else None,
            "plot": str(self.plot) if self.plot else None,
        }
        if self.camera.camera is not None:
            answer["position_m"] = self.camera.camera.position.tolist()
            answer["metres_per_pixel"] = self.camera.camera.metres_per_pixel()
            answer["verdicts"] = [each.summary() for each in self.verdicts]
        if found is not None:
            answer["rms_px"] = found.rms
            answer["corners_without_board"] = list(empty_corners(self.camera.seen))
            answer["used"] = [
                {"name": u.name, "corners": u.corners, "rms_px": u.rms, "tilt_rad": u.tilt}
                for u in found.used
            ]
            used = {u.name for u in found.used}
            for key, whole in (("dropped", True), ("used_in_part", False)):
                answer[key] = [
                    {"name": d.name, "reason": d.reason}
                    for d in found.dropped
                    if (d.name not in used) is whole
                ]
            answer["left_out_rms_px"] = {str(n): rms for n, rms in found.unseen.items()}
        if self.placement is not None:
            off = np.hypot(*self.placement.misfit.T)
            answer["place_rms_px"] = self.placement.rms
            answer["misfit_rms_m"] = float(np.sqrt(np.mean(off**2)))
            answer["misfit_worst_m"] = float(off.max())
            answer["points"] = len(off)
        return answer

    def blocks(self) -> list[list[str]]:
        """Return paragraphs of text for people."""
        found = self.calibration
        seen = [] if found is None else [*_coefficients(found, self.camera), *_corners(self.camera)]
        return [
            [] if self.placement else _lens(self.camera),
            [] if found is None else _views(found),
            seen,
            self._place(),
            [f"{each.sentence}." for each in self.verdicts],
            [f"note: {remark}" for remark in self.remarks],
        ]

    def _place(self) -> list[str]:
        camera = self.camera.camera
        if camera is None:
            return []
        x, y, z = 1e3 * camera.position
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, -camera.rotation[2, 2]))))
        lines = [
            f"camera {z:.1f} mm above the plate, over x {x:.1f} mm, y {y:.1f} mm, tilted by "
            f"{tilt:.1f} deg; {1e3 * camera.metres_per_pixel():.3g} mm per pixel on the plate"
        ]
        if self.placement is not None:
            own = self.summary()
            lines.append(
                f"{own['points']} points are off their nominal positions by "
                f"{1e3 * own['misfit_rms_m']:.2g} mm (rms, {self.placement.rms:.2g} px), at most "
                f"{1e3 * own['misfit_worst_m']:.2g} mm"
            )
        return lines


def _lens(camera: MeasuredCamera) -> list[str]:
    """Resolution and parameters of a lens, and their standard deviations."""
    lens, known = camera.lens, camera.deviations

    def number(name: str, value: float, unit: str = " px") -> str:
        spread = f" +- {known[name]:.2g}" if name in known else ""
        return f"{name} {value:.6g}{spread}{unit}"

    terms = [number("skew", lens.skew, "")] if lens.skew else []
    terms += [
        number(name, value, "")
        for name, value in zip(FISHEYE if lens.fisheye else BROWN, lens.distortion, strict=True)
        if value or name in known
    ]
    kind, (width, height) = "fisheye" if lens.fisheye else "lens", lens.image_size
    pairs = ((("fx", "fy"), lens.focal), (("cx", "cy"), lens.centre))
    rows = [", ".join(map(number, names, values.tolist())) for names, values in pairs]
    rows += [", ".join(terms)] if terms else []
    return [f"{kind} for pictures of {width} x {height} px", *(f"  {row}" for row in rows)]


def _views(found: LensCalibration) -> list[str]:
    """Table of the pictures, and of those that were left out."""
    rows = [(u.name, u.corners, u.rms, math.degrees(u.tilt)) for u in found.used]
    residual, tilt = Column("rms", "px", ".3f"), Column("tilt", "deg", ".0f")
    lines = Table(("picture", "corners", residual, tilt), rows).lines(MAX_ROWS)
    if len(rows) > MAX_ROWS:
        lines.append(f"... and {len(rows) - MAX_ROWS} more")
    lines.append(f"{len(rows)} pictures used, rms {found.rms:.3f} px")
    used = {u.name for u in found.used}
    for what, wanted in (("left out", False), ("used in part", True)):
        own = [f"  {d.name}: {d.reason}" for d in found.dropped if (d.name in used) is wanted]
        lines += [f"{what} ({len(own)}):", *own[:MAX_ROWS]] if own else []
    return lines


def _coefficients(found: LensCalibration, camera: MeasuredCamera) -> list[str]:
    """Error on held-out pictures by number of distortion coefficients."""
    if not found.unseen:
        return []
    used = sum(name in BROWN for name in camera.names)
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


def _corners(camera: MeasuredCamera) -> list[str]:
    """Warning of the corners of the picture that no board was near."""
    empty = empty_corners(camera.seen)
    if not empty:
        return ["The boards cover all corners of the picture."]
    return [
        f"No board was near {len(empty)} of 4 corners of the picture ({', '.join(empty)}): "
        "take more pictures with the board there, since the lens is extrapolated there."
    ]


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


class PlaceAccuracy(NamedTuple):
    """Expected accuracy of places at one height."""

    errors: PlaneErrors
    typical: float  # radius that contains 95 % of the errors, median over the picture [m]
    worst: float  # the same, maximum [m]
    worst_at: str  # part of the picture with the largest error: `upper left corner`
    empty_corners: tuple[str, ...]  # of the picture, without a board nearby; all four if unknown
    seen_known: bool  # whether the places of the boards are known

    @property
    def sentence(self) -> str:
        """Accuracy in one sentence, for the user."""
        height = f"{1e3 * self.errors.height:g} mm above the plate"
        if not self.errors.known:
            return (
                f"The accuracy of positions {height} is unknown, since the camera file has no "
                "uncertainty"
            )
        parts = [
            f"Accuracy of positions {height}: {mm(self.typical)} (95 %), at worst "
            f"{mm(self.worst)} in the {self.worst_at}"
        ]
        if self.seen_known:
            n = len(self.empty_corners)
            parts.append(
                "the boards cover all corners of the picture"
                if not n
                else f"no board was near {n} of 4 corners of the picture "
                f"({', '.join(self.empty_corners)})"
            )
        return "; ".join(parts)

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {
            "height_m": self.errors.height,
            "known": self.errors.known,
            "typical_95_m": self.typical if self.errors.known else None,
            "worst_95_m": self.worst if self.errors.known else None,
            "worst_at": self.worst_at if self.errors.known else None,
            "corners_without_board": list(self.empty_corners) if self.seen_known else None,
            "sentence": self.sentence,
        }


def verdict(measured: MeasuredCamera, height: float) -> PlaceAccuracy:
    """Compute the expected accuracy of places at a height above the plate [m]."""
    errors = plane_errors(measured, height)
    worst = np.unravel_index(int(np.argmax(errors.whole)), errors.whole.shape)
    return PlaceAccuracy(
        errors=errors,
        typical=float(np.median(errors.whole)),
        worst=float(errors.whole.max()),
        worst_at=_part_of_picture(errors.pixels[worst], measured.lens.image_size),
        empty_corners=empty_corners(measured.seen),
        seen_known=bool(measured.seen.size),
    )


def empty_corners(seen: FloatArray) -> tuple[str, ...]:
    """Return the corners of the picture, a quarter of its sides wide, that no board reached."""
    if not seen.size:
        return CORNERS
    rows, columns = max(1, seen.shape[0] // 4), max(1, seen.shape[1] // 4)
    upper, lower = seen[:rows], seen[-rows:]
    parts = (upper[:, :columns], upper[:, -columns:], lower[:, :columns], lower[:, -columns:])
    return tuple(name for name, part in zip(CORNERS, parts, strict=True) if not part.any())


def mm(metres: float) -> str:
    """Format a length for reading: microns below a tenth of a millimetre."""
    return f"{1e3 * metres:.2g} mm" if metres >= 1e-4 else f"{1e6 * metres:.2g} um"


def _part_of_picture(pixel: FloatArray, size: tuple[int, int]) -> str:
    u, v = pixel / (np.array(size) - 1.0)
    down = "upper" if v < 0.25 else "lower" if v > 0.75 else ""
    across = "left" if u < 0.25 else "right" if u > 0.75 else ""
    if down and across:
        return f"{down} {across} corner"
    return f"{down or across} part of the picture" if down or across else "middle of the picture"
