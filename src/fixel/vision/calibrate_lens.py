"""Lens calibration from pictures of a board: choice of pictures, fit and its uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.typing import FloatArray
from fixel.vision.bundle import BundleFit, PointObservations, fit
from fixel.vision.camera import MeasuredCamera
from fixel.vision.frame import Picture, opencv
from fixel.vision.lens import BROWN, FISHEYE, Lens
from fixel.vision.marks import Board, Corners

MIN_PICTURES: Final = 4
MIN_TILT: Final = 8.0  # [deg] between two boards; with less the focal length is undetermined
LOOSE_FOCAL: Final = 0.03  # relative standard deviation from which a calibration is rejected
FAR_OUT: Final = 5.0  # robust standard deviations from which a corner counts as wrong
WORSE: Final = 3.0  # times the usual residual, from which a picture is dropped
TOLERABLE: Final = 0.3  # [px] residual of a picture that is never dropped
COEFFICIENTS: Final = 5  # k1, k2, p1, p2, k3
MAX_COEFFICIENTS: Final = 8
FEWER: Final = (4,)  # other numbers of coefficients for comparison
FEW_COEFFICIENTS: Final = 4
FOLDS: Final = 3
NEAR_STEPS: Final = 6  # of fits that start at the fit of all pictures
MIN_TO_HOLD_OUT: Final = 8  # pictures
CELLS: Final = 16  # across the picture, of the map of corners seen
SkippedPicture = tuple[str, str]  # picture, or corners of one, left out; and the reason


class BoardView(NamedTuple):
    """Picture in which a board was found."""

    name: str
    size: tuple[int, int]  # width and height [px]
    corners: Corners


class UsedView(NamedTuple):
    """Picture used in a calibration."""

    name: str
    corners: int
    rms: float  # root mean square of its residuals along each axis [px]
    tilt: float  # tilt of its board against the sensor [rad]


@dataclass(frozen=True, slots=True)
class LensCalibration:
    """Result of a lens calibration."""

    camera: MeasuredCamera  # lens with covariance, without a place
    used: tuple[UsedView, ...]
    dropped: tuple[SkippedPicture, ...]
    rms: float  # root mean square of all residuals along each axis [px]
    # Root mean square of residuals in held-out pictures [px], by number of distortion coefficients;
    # empty with fewer than `MIN_TO_HOLD_OUT` pictures, and where the number was given.
    unseen: Mapping[int, float] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        used = {one.name for one in self.used}
        dropped = [{"name": name, "reason": reason} for name, reason in self.dropped]
        return {
            "rms_px": self.rms,
            "used": [
                {"name": u.name, "corners": u.corners, "rms_px": u.rms, "tilt_rad": u.tilt}
                for u in self.used
            ],
            "dropped": [one for one in dropped if one["name"] not in used],
            "used_in_part": [one for one in dropped if one["name"] in used],
            "left_out_rms_px": {str(n): rms for n, rms in self.unseen.items()},
        }


def find_boards(
    pictures: Iterable[tuple[str, Picture]],
    board: Board,
    notify: Callable[[str], None] | None = None,
) -> tuple[tuple[BoardView, ...], tuple[SkippedPicture, ...]]:
    """Find a board in pictures; return its views, and the pictures without one.

    A mirrored picture raises, as all others will be mirrored too.
    """
    views, dropped = [], []
    for name, picture in pictures:
        if notify:
            notify(name)
        try:
            corners = board.find(picture)
        except InvalidInput as problem:
            if "mirrored" in str(problem.found):
                raise problem.within(name) from None
            dropped.append((name, f"{problem.found}"))
            continue
        height, width = picture.shape[:2]
        views.append(BoardView(name, (width, height), corners))
    return tuple(views), tuple(dropped)


def calibrate_lens(
    views: Sequence[BoardView],
    dropped: Sequence[SkippedPicture] = (),
    *,
    coefficients: int | None = None,
    fisheye: bool = False,
) -> LensCalibration:
    """Calibrate a lens from views of a board, at least four, tilted against each other.

    Without a number of distortion coefficients (0, 1, 2, 4, 5 or 8; with `fisheye`, the model of
    Kannala and Brandt instead of Brown's, up to 4) it is 5, or 8 where held-out pictures show that
    5 are too few. Fewer would fit as well in the middle, and hide the uncertainty in the corners of
    the picture. With `fisheye` or fewer than `MIN_TO_HOLD_OUT` pictures, it is 4. Views that do not
    determine the lens raise `InvalidInput` with what is missing. `dropped` are pictures already
    left out.
    """
    names = lens_names(coefficients, fisheye)
    left, out = list(views), list(dropped)
    while True:
        size = _one_size(left)
        _refuse_few(left, out)
        _refuse_parallel(left, size)
        found, sight = _fitted(left, size, names, fisheye)
        worst = _worst_view(found, sight, left)
        if worst is None:
            break
        out.append((left[worst].name, _too_far(found, sight, worst)))
        del left[worst]
    found, sight, wrong = _without_wrong_corners(found, sight, names)
    unseen: dict[int, float] = {}
    if coefficients is None and not fisheye and len(left) >= MIN_TO_HOLD_OUT:
        unseen, more = _held_out(found, sight)
        for count in (MAX_COEFFICIENTS, COEFFICIENTS) if more else (COEFFICIENTS,):
            own = lens_names(count, False)
            wider = fit(found.lens, own, found.rotations, found.translations, sight)
            if _sees_corners(wider.lens):
                names, found = own, wider
                break
    for view, count in zip(left, wrong, strict=True):
        if count:
            out.append((view.name, f"{count} of its corners are outliers"))
    _refuse_loose(found, names)
    camera = MeasuredCamera(
        lens=found.lens,
        names=names,
        covariance=found.covariance,
        noise=max(found.noise, 1e-9),
        seen=_seen(sight.pixels, size),
        source=f"{len(left)} pictures of a board",
    )
    used = tuple(_used(found, sight, k, view.name) for k, view in enumerate(left))
    rms = float(np.sqrt(np.mean(found.residuals**2)))
    return LensCalibration(camera, used, tuple(out), rms, unseen)


def _held_out(found: BundleFit, sight: PointObservations) -> tuple[dict[int, float], bool]:
    """Cross-validate the number of coefficients: residuals by number [px], and if 5 are too few.

    A third of the pictures at a time is held out: the lens is fitted without them, then only their
    places are fitted. More coefficients are needed where the mean square of the pictures decreases
    by more than twice its standard error.
    """
    n_view = len(found.rotations)
    squares = {count: np.zeros(n_view) for count in (*FEWER, COEFFICIENTS, MAX_COEFFICIENTS)}
    for count, own in squares.items():
        names = lens_names(count, False)
        kept = names[4:]
        others = [name for name in BROWN if name not in kept]
        start = found.lens.with_parameters(others, [0.0] * len(others))
        for part in range(FOLDS):
            out = np.arange(n_view) % FOLDS == part
            rest = _views(found, sight, ~out)
            lens = fit(start, names, *rest, steps=NEAR_STEPS).lens
            rotations, translations, left = _views(found, sight, out)
            places = fit(lens, (), rotations, translations, left, steps=NEAR_STEPS)
            residuals = places.residuals
            sums = np.bincount(left.view, (residuals**2).mean(axis=1), minlength=int(out.sum()))
            own[out] = sums / np.bincount(left.view, minlength=int(out.sum()))
    gain = squares[COEFFICIENTS] - squares[MAX_COEFFICIENTS]
    error = float(gain.std(ddof=1)) / np.sqrt(n_view)
    return {count: float(np.sqrt(own.mean())) for count, own in squares.items()}, bool(
        gain.mean() > 2.0 * error
    )


def _sees_corners(lens: Lens) -> bool:
    """Whether the model has a direction for every corner of the picture."""
    width, height = lens.image_size
    try:
        lens.direction([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]])
    except InvalidInput:
        return False
    return True


def _views(
    found: BundleFit, sight: PointObservations, which: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, PointObservations]:
    """Select places and corners of some views, with new indices of the views."""
    corners = sight.only(which[sight.view])
    number = np.cumsum(which) - 1
    return (
        found.rotations[which],
        found.translations[which],
        PointObservations(corners.points, corners.pixels, number[corners.view]),
    )


def lens_names(coefficients: int | None, fisheye: bool) -> tuple[str, ...]:
    """Return the names of the numbers of a lens; raise for a number of coefficients it has not."""
    known = (0, 1, 2, 3, 4) if fisheye else (0, 1, 2, 4, 5, 8)
    count = FEW_COEFFICIENTS if coefficients is None else coefficients
    if count not in known:
        expected = "one of " + ", ".join(map(str, known))
        raise InvalidInput("coefficients", found=count, expected=expected)
    return ("fx", "fy", "cx", "cy", *(FISHEYE if fisheye else BROWN)[:count])


def _one_size(views: Sequence[BoardView]) -> tuple[int, int]:
    sizes = [view.size for view in views] or [(1, 1)]
    usual = max(set(sizes), key=sizes.count)
    others = [view for view in views if view.size != usual]
    if others:
        turned = all(view.size == usual[::-1] for view in others)
        raise InvalidInput(
            "pictures",
            found=f"{len(others)} of {'x'.join(map(str, others[0].size))} px, such as "
            f"{others[0].name}, and others of {'x'.join(map(str, usual))} px",
            expected="pictures of one size",
            hint="some pictures are turned by 90 degrees"
            if turned
            else "take all pictures like those of the experiments",
        )
    return usual


def _refuse_few(views: Sequence[BoardView], dropped: Sequence[SkippedPicture]) -> None:
    if len(views) >= MIN_PICTURES:
        return
    reasons = "; ".join(f"{name}: {reason}" for name, reason in dropped[:3])
    raise InvalidInput(
        "pictures",
        found=f"{len(views)} with a usable board" + (f" ({reasons})" if reasons else ""),
        expected=f"at least {MIN_PICTURES}; 10 to 20 are good",
        hint="check that --board names this board: fixel camera board --help"
        if dropped
        else "take more pictures, with the board tilted by 20 to 40 degrees, some in each corner "
        "of the picture",
    )


def _refuse_parallel(views: Sequence[BoardView], size: tuple[int, int]) -> None:
    """Raise if all boards are parallel: small and near or large and far, they look the same.

    Tilts are computed from homographies with a rough focal length, which suffices for this test.
    """
    cv2 = opencv()
    rough, centre = float(max(size)), (np.array(size) - 1.0) / 2.0
    normals = []
    for view in views:
        flat, _ = cv2.findHomography(view.corners.places, (view.corners.pixels - centre) / rough)
        normal = np.cross(flat[:, 0], flat[:, 1])
        normals.append(normal / np.linalg.norm(normal) * np.sign(normal[2]))
    between = np.array(normals) @ np.array(normals).T
    most = float(np.degrees(np.arccos(np.clip(between.min(), -1.0, 1.0))))
    if most < MIN_TILT:
        found = f"boards within {most:.1f} degrees of parallel"
        expected = f"boards tilted against each other by more than {MIN_TILT:g} degrees"
        hint = "tilt the board by 20 to 40 degrees to the left, right, top and bottom"
        raise InvalidInput("pictures", found=found, expected=expected, hint=hint)


def _fitted(
    views: Sequence[BoardView], size: tuple[int, int], names: tuple[str, ...], fisheye: bool
) -> tuple[BundleFit, PointObservations]:
    cv2 = opencv()
    places = [view.corners.places for view in views]
    solid = [np.column_stack([p, np.zeros(len(p))]).astype(np.float32) for p in places]
    pixels = [view.corners.pixels.astype(np.float32)[:, None] for view in views]
    # OpenCV's fit with two coefficients is the start of ours.
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    if fisheye or len(names) < 6:
        flags |= cv2.CALIB_FIX_K2
    if len(names) < 5:
        flags |= cv2.CALIB_FIX_K1
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # several add their sums in any order, which changes the last digits
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            solid, pixels, size, None, None, flags=flags
        )
    except cv2.error as problem:
        found = f"boards that no lens fits ({problem.err})"
        expected = "pictures of the board given with --board"
        raise InvalidInput("pictures", found=found, expected=expected) from None
    finally:
        cv2.setNumThreads(threads)
    k1, k2 = distortion.ravel()[:2]
    lens = Lens(
        image_size=size,
        focal=(matrix[0, 0], matrix[1, 1]),  # type: ignore[arg-type]
        centre=(matrix[0, 2], matrix[1, 2]),  # type: ignore[arg-type]
        # Start of a fisheye without distortion: tan(a) is a + a^3/3 + ...
        distortion=(k1 + 1.0 / 3.0,) if fisheye else (k1, k2),  # type: ignore[arg-type]
        fisheye=fisheye,
    )
    rotations = np.array([cv2.Rodrigues(turn)[0] for turn in turns])
    sight = PointObservations(
        np.concatenate(solid).astype(np.float64),
        np.concatenate([view.corners.pixels for view in views]),
        np.repeat(np.arange(len(views)), [len(p) for p in places]),
    )
    return fit(lens, names, rotations, np.array(shifts)[:, :, 0], sight), sight


def _worst_view(
    found: BundleFit, sight: PointObservations, views: Sequence[BoardView]
) -> int | None:
    """Return the picture whose corners fit much worse than those of the others, if any."""
    rms = [_rms(found.residuals[sight.view == k]) for k in range(len(views))]
    worst = int(np.argmax(rms))
    others = float(np.median(np.delete(rms, worst)))
    return worst if rms[worst] > max(WORSE * others, TOLERABLE) else None


def _too_far(found: BundleFit, sight: PointObservations, worst: int) -> str:
    own, rest = (_rms(found.residuals[which]) for which in (sight.view == worst,
                                                             sight.view != worst))  # fmt: skip
    return (
        f"corners off by {own:.2f} px, those of other pictures by {rest:.2f} px; the board may "
        "have moved or bent"
    )


def _without_wrong_corners(
    found: BundleFit, sight: PointObservations, names: tuple[str, ...]
) -> tuple[BundleFit, PointObservations, list[int]]:
    """Repeat a fit without corners whose residuals are far too large."""
    n_view = len(found.rotations)
    wrong = np.zeros(n_view, dtype=int)
    for _ in range(3):
        off = np.hypot(*found.residuals.T)
        usual = float(np.median(off)) / 1.1774  # median of a Rayleigh distribution
        good = off <= FAR_OUT * max(usual, 1e-6)
        counts = np.bincount(sight.view[good], minlength=n_view)
        good |= (counts < 6)[sight.view]
        if good.all():
            break
        wrong += np.bincount(sight.view[~good], minlength=n_view)
        sight = sight.only(good)
        found = fit(found.lens, names, found.rotations, found.translations, sight)
    return found, sight, wrong.tolist()


def _refuse_loose(found: BundleFit, names: tuple[str, ...]) -> None:
    deviation = np.sqrt(np.maximum(np.diag(found.covariance)[:2], 0.0))
    if not (deviation < LOOSE_FOCAL * found.lens.focal).all():
        raise InvalidInput(
            "pictures",
            found=f"a focal length of {found.lens.focal[0]:.0f} px known to {deviation[0]:.0f} px",
            expected=f"pictures that determine it to {100 * LOOSE_FOCAL:g} %",
            hint="take more pictures, with the board more tilted and closer",
        )


def _seen(pixels: FloatArray, size: tuple[int, int]) -> FloatArray:
    width, height = size
    rows = max(4, round(CELLS * height / width))
    counts, _, _ = np.histogram2d(
        pixels[:, 1],
        pixels[:, 0],
        bins=(rows, CELLS),
        range=((-0.5, height - 0.5), (-0.5, width - 0.5)),
    )
    return counts


def _used(found: BundleFit, sight: PointObservations, k: int, name: str) -> UsedView:
    own = found.residuals[sight.view == k]
    tilt = float(np.arccos(min(1.0, abs(found.rotations[k, 2, 2]))))
    return UsedView(name, len(own), _rms(own), tilt)


def _rms(residuals: FloatArray) -> float:
    return float(np.sqrt(np.mean(residuals**2)))
