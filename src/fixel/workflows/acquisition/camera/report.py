"""Results of the commands of cameras, and their reports."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.errors import counted
from fixel.table import Column, Table
from fixel.vision.calibrate_lens import LensCalibration
from fixel.vision.camera import MeasuredCamera
from fixel.vision.lens import BROWN
from fixel.vision.place_camera import Placement
from fixel.vision.plane_errors import PlaneErrors, empty_corners
from fixel.workflows.analysis import Analysis, AnalysisReport, StoredAnswer

EXIT: Final = 1  # code of a check that finds a problem


class CameraAnswer(NamedTuple):
    """Result of calibrating, importing, exporting, placing or checking a camera."""

    camera: MeasuredCamera
    file: Path | None = None  # camera file that was written
    calibration: LensCalibration | None = None
    placement: Placement | None = None
    verdicts: tuple[PlaneErrors, ...] = ()  # accuracy at each requested height
    remarks: tuple[str, ...] = ()
    plot: Path | None = None
    # Largest error from pixels to directions and back, over the whole picture [px].
    round_trip: float | None = None
    # Distance of each plate tag from its place [m]; empty if none was searched for.
    tags: Mapping[int, float] = MappingProxyType({})
    problems: tuple[str, ...] = ()  # reasons not to use the camera

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
            answer |= found.summary()
            answer["corners_without_board"] = list(empty_corners(self.camera.seen))
        if self.placement is not None:
            off = np.hypot(*self.placement.misfit.T)
            answer["place_rms_px"] = self.placement.rms
            answer["misfit_rms_m"] = float(np.sqrt(np.mean(off**2)))
            answer["misfit_worst_m"] = float(off.max())
            answer["points"] = len(off)
        if self.round_trip is not None:
            answer["round_trip_px"] = self.round_trip
            answer["plate_tags_off_m"] = {str(k): v for k, v in self.tags.items()}
            answer["problems"] = list(self.problems)
        return answer

    def analysis(self) -> Analysis:
        """Return the report for people."""
        found = self.calibration
        notes = [] if found is None else [*_views(found), *_coefficients(found, self.camera)]
        if found is not None:
            notes += _corners(self.camera)
        notes += [
            f"tag {number} on the plate is {1e3 * off:.2f} mm from its nominal position"
            for number, off in self.tags.items()
        ]
        if self.round_trip is not None:
            notes += [f"round trip from pixels to directions and back: {self.round_trip:.1g} px"]
        lens = [] if self.placement else self.camera.lines()
        return Analysis(
            kind="camera",
            title="Camera",
            question={},
            headline=(*lens, *self._place(), *(f"{own.sentence}." for own in self.verdicts)),
            warnings=self.problems,
            tables=() if found is None else (_pictures(found),),
            notes=(*notes, *(f"note: {remark}" for remark in self.remarks)),
            numbers=self.summary(),
        )

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


def _pictures(found: LensCalibration) -> Table:
    """Table of the pictures that were used."""
    rows = [(u.name, u.corners, u.rms, math.degrees(u.tilt)) for u in found.used]
    residual, tilt = Column("rms", "px", ".3f"), Column("tilt", "deg", ".0f")
    return Table(("picture", "corners", residual, tilt), rows)


def _views(found: LensCalibration) -> list[str]:
    """Number of pictures that were used, and those that were left out or used in part."""
    lines = [f"{counted(len(found.used), 'picture')} used, rms {found.rms:.3f} px"]
    used = {u.name for u in found.used}
    for what, wanted in (("left out", False), ("used in part", True)):
        own = [f"  {name}: {reason}" for name, reason in found.dropped if (name in used) is wanted]
        lines += [f"{what} ({len(own)}):", *own] if own else []
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


class PrintAnswer(NamedTuple):
    """Result of printing boards or tags into a file."""

    file: Path
    sheets: int
    what: str
    tags: int = 0  # number of tags, 0 for a board
    plot: Path | None = None
    problems: tuple[str, ...] = ()

    def analysis(self) -> Analysis:
        """Return how to print the file."""
        said = "Print at 100 %, check the length of the ruler, glue the sheet to a flat plate."
        if self.tags:
            said = f"{counted(self.tags, 'tag')} on {counted(self.sheets, 'sheet')}. "
            said += "Print at 100 %, check the ruler, leave the white border around each tag."
        numbers = {"file": str(self.file), "sheets": self.sheets, "what": self.what}
        numbers |= {"tags": self.tags}
        return Analysis(
            kind="camera", title="Print", question={}, headline=(said,), numbers=numbers
        )


def report_of(answer: CameraAnswer | PrintAnswer) -> AnalysisReport:
    """Return the report of a camera or a print, with the files that were written."""
    files = {"file": answer.file, "plot": answer.plot}
    return AnalysisReport(answer.analysis(), files={k: v for k, v in files.items() if v})


def failed(answer: CameraAnswer | PrintAnswer) -> bool:
    """Whether a problem was found."""
    return bool(answer.problems)


def next_words(done: StoredAnswer) -> list[object]:
    """Return the words of the command that most users need next."""
    answer, asked, verb = done.result, done.request, done.capability.verb
    if verb == "export":
        return []
    if verb == "board":
        return ["camera", "calibrate", "PICTURES...", "--board", answer.what]
    if verb == "tags":
        return ["camera", "place", "CAMERA", "PICTURE", "--rig", asked.rig or "RIG"]
    if verb == "check" and not answer.problems:
        return ["record", "--camera", "0", "--out", "FOLDER", "--rig", asked.camera]
    if verb == "check":
        return ["camera", "place", asked.camera, "PICTURE"]
    if verb == "place":
        return ["camera", "check", "RIG", "--video", "FILE"]
    if verb == "import" and answer.camera.camera is not None:
        return ["camera", "check", asked.out]
    board = getattr(asked, "board", "BOARD")
    return ["camera", "place", asked.out, "PICTURE", "--board", board]
