"""Lenses from pictures of boards that were rendered through a known lens."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.testing.board_pictures import Studio, seen_corners, spread
from fixel.vision.boards import Board, Corners, Picture, board_of
from fixel.vision.bundle import values_of
from fixel.vision.calibrate_lens import Dropped, View, calibrate_lens, find_boards
from fixel.vision.lens import Lens

LENS = Lens(image_size=(480, 360), focal=(440.0, 444.0), centre=(244.0, 177.0),  # type: ignore[arg-type]
            distortion=(-0.12, 0.05, 0.001, -0.0008))  # type: ignore[arg-type]  # fmt: skip
WIDE = Lens(image_size=(480, 360), focal=(260.0, 261.0), centre=(244.0, 177.0), fisheye=True,  # type: ignore[arg-type]
            distortion=(0.05, -0.01, 0.002, -0.001))  # type: ignore[arg-type]  # fmt: skip
CHARUCO = board_of("charuco:7x5:30mm:20mm")
CHECKERS = board_of("checkerboard:8x5:25mm")


@pytest.fixture(scope="module")
def studio() -> Studio:
    return Studio(LENS, CHARUCO)


@pytest.fixture(scope="module")
def pictures(studio: Studio) -> list[tuple[str, Picture]]:
    return [(f"p{k}", studio.picture(*place)) for k, place in enumerate(spread(studio, 8, 0.30))]


def within_three_sigma(lens: Lens, names: tuple[str, ...], deviations: list[float]) -> bool:
    off = values_of(lens, names) - values_of(LENS, names)
    return bool((np.abs(off) < 3.5 * np.array(deviations)).all())


def test_charuco_pictures_recover_the_lens(pictures: list[tuple[str, Picture]]) -> None:
    views, dropped = find_boards(
        [*pictures, ("white", np.full((360, 480), 255, np.uint8))], CHARUCO
    )
    found = calibrate_lens(views, dropped)
    assert [d.name for d in dropped] == ["white"]
    assert len(found.used) == 8
    assert found.rms < 0.1
    deviations = found.camera.deviations
    assert within_three_sigma(found.camera.lens, found.camera.names, list(deviations.values()))
    assert deviations["fx"] < 2.0
    assert found.camera.seen.sum() == sum(used.corners for used in found.used)


def test_checkerboard_pictures_recover_the_lens() -> None:
    studio = Studio(LENS, CHECKERS)
    places = spread(studio, 8, 0.40, near=0.6)
    views, _ = find_boards([(f"p{k}", studio.picture(*p)) for k, p in enumerate(places)], CHECKERS)
    found = calibrate_lens(views)
    assert len(found.used) >= 6
    assert found.rms < 0.06
    deviations = list(found.camera.deviations.values())
    assert within_three_sigma(found.camera.lens, found.camera.names, deviations)


def test_it_agrees_with_opencv() -> None:
    """With all corners good and the same unknowns, both find the same least squares."""
    views = seen_corners(LENS, CHECKERS, 8, noise=0.05)
    found = calibrate_lens(views)
    solid = [np.column_stack([v.corners.places, np.zeros(len(v.corners.places))]) for v in views]
    rms, matrix, distortion, *_ = cv2.calibrateCamera(
        [s.astype(np.float32) for s in solid],
        [v.corners.pixels.astype(np.float32) for v in views],
        LENS.image_size,
        None,
        None,
        flags=cv2.CALIB_FIX_K3,
    )
    lens = found.camera.lens
    np.testing.assert_allclose(lens.focal, [matrix[0, 0], matrix[1, 1]], rtol=1e-5)
    np.testing.assert_allclose(lens.distortion[:4], distortion.ravel()[:4], atol=2e-5)
    assert found.rms * np.sqrt(2) == pytest.approx(rms, rel=1e-4)


def test_fisheye_is_found() -> None:
    found = calibrate_lens(seen_corners(WIDE, CHECKERS, 10, noise=0.05, depth=0.2), fisheye=True)
    off = values_of(found.camera.lens, found.camera.names) - values_of(WIDE, found.camera.names)
    assert (np.abs(off) < 3.5 * np.array(list(found.camera.deviations.values()))).all()


def test_a_bad_picture_is_dropped_with_the_reason() -> None:
    views = list(seen_corners(LENS, CHECKERS, 8, noise=0.05))
    bent = views[3].corners
    wave = 2.0 * np.sin(40.0 * bent.places[:, :1] + 20.0 * bent.places[:, 1:])
    views[3] = replace_corners(views[3], Corners(bent.places, bent.pixels + wave))
    one = views[5].corners
    moved = one.pixels.copy()
    moved[7] += 5.0
    views[5] = replace_corners(views[5], Corners(one.places, moved))
    found = calibrate_lens(views)
    reasons = {d.name: d.reason for d in found.dropped}
    assert "px" in reasons["view 3"]
    assert found.rms < 0.08


def replace_corners(view: View, corners: Corners) -> View:
    return View(view.name, view.size, corners)


@pytest.mark.parametrize("count", [0, 3])
def test_too_few_pictures(count: int) -> None:
    views = seen_corners(LENS, CHECKERS, 8, noise=0.05)[:count]
    with pytest.raises(InvalidInput, match="at least 4"):
        calibrate_lens(views, [Dropped("x.png", "no such board")])


def test_parallel_boards_say_nothing_of_the_focal_length() -> None:
    straight = replace(LENS, distortion=(0.0,))  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match="of parallel"):
        calibrate_lens(seen_corners(straight, CHECKERS, 5, noise=0.05, tilt=0.02))
    # Distortion bends boards as a tilt would; then the fit itself knows too little.
    with pytest.raises(InvalidInput, match="tilted more"):
        calibrate_lens(seen_corners(LENS, CHECKERS, 5, noise=0.05, tilt=0.02))


def test_hardly_tilted_boards_say_too_little() -> None:
    with pytest.raises(InvalidInput, match=r"parallel|known to"):
        calibrate_lens(seen_corners(LENS, CHECKERS, 5, noise=0.5, tilt=0.12))


@pytest.mark.parametrize(("size", "word"), [((360, 480), "90 degrees"), ((960, 720), "one size")])
def test_mixed_sizes(size: tuple[int, int], word: str) -> None:
    views = list(seen_corners(LENS, CHECKERS, 8, noise=0.05))
    views[2] = View("odd.png", size, views[2].corners)
    with pytest.raises(InvalidInput, match=word):
        calibrate_lens(views)


def test_mirrored_pictures(pictures: list[tuple[str, Picture]]) -> None:
    mirrored = [(name, np.ascontiguousarray(picture[:, ::-1])) for name, picture in pictures]
    with pytest.raises(InvalidInput, match="mirrored"):
        find_boards(mirrored, CHARUCO)


def test_another_board(pictures: list[tuple[str, Picture]]) -> None:
    views, dropped = find_boards(pictures[:4], CHECKERS)
    assert not views
    with pytest.raises(InvalidInput, match="no such board"):
        calibrate_lens(views, dropped)


@pytest.mark.parametrize(
    "text",
    ["", "charuco", "charuco:7x5:30:22", "charuco:7x5:30mm:31mm", "checkerboard:9x6",
     "checkerboard:1x6:25mm", "charuco:50x40:3mm:2mm", "board:9x6:25mm",
     "charuco:7x5:30mm:22mm:9x9",
     "checkerboard:9x6:0mm"],
)  # fmt: skip
def test_boards_that_cannot_be(text: str) -> None:
    with pytest.raises(InvalidInput):
        board_of(text)


def test_boards_are_read() -> None:
    assert board_of("checkerboard:9x6:25mm") == Board(columns=10, rows=7, square=0.025)
    assert board_of("charuco:7x5:3cm:22mm:5x5").dictionary == "5x5"


def test_unknown_counts_of_coefficients() -> None:
    with pytest.raises(InvalidInput, match="coefficients"):
        calibrate_lens(seen_corners(LENS, CHECKERS, 4, noise=0.05), coefficients=3)


def test_fewer_coefficients_stay_nought() -> None:
    lens = replace(LENS, distortion=(0.0,))  # type: ignore[arg-type]
    found = calibrate_lens(seen_corners(lens, CHECKERS, 6, noise=0.05), coefficients=1)
    assert not found.camera.lens.distortion[1:].any()
    assert set(found.camera.names) == {"fx", "fy", "cx", "cy", "k1"}
