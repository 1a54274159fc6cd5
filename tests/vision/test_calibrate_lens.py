"""Lenses from pictures of boards that were rendered through a known lens."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from benchmarks.board_pictures import Studio, seen_corners, spread
from tests.fixtures import refused

from fixel.vision.calibrate_lens import BoardView, calibrate_lens, find_boards
from fixel.vision.lens import Lens
from fixel.vision.marks import Board, Corners, board_of
from fixel.vision.plane_errors import radius95

LENS = Lens(image_size=(480, 360), focal=(440.0, 444.0), centre=(244.0, 177.0),
            distortion=(-0.12, 0.05, 0.001, -0.0008))  # fmt: skip
WIDE = Lens(image_size=(480, 360), focal=(260.0, 261.0), centre=(244.0, 177.0), fisheye=True,
            distortion=(0.05, -0.01, 0.002, -0.001))  # fmt: skip
CHARUCO = board_of("charuco:7x5:30mm:20mm")
CHECKERS = board_of("checkerboard:8x5:25mm")


@pytest.fixture(scope="module")
def studio():
    return Studio(LENS, CHARUCO)


@pytest.fixture(scope="module")
def pictures(studio):
    return [(f"p{k}", studio.picture(*place)) for k, place in enumerate(spread(studio, 8, 0.30))]


def within_errors(camera, true=LENS):
    off = [camera.lens.parameters[name] - true.parameters[name] for name in camera.names]
    return (np.abs(off) < 3.5 * np.array(list(camera.deviations.values()))).all()


def test_charuco_pictures_recover_the_lens(pictures):
    views, dropped = find_boards(
        [*pictures, ("white", np.full((360, 480), 255, np.uint8))], CHARUCO
    )
    found = calibrate_lens(views, dropped)
    assert [name for name, _ in dropped] == ["white"]
    assert len(found.used) == 8
    assert found.rms < 0.1
    assert within_errors(found.camera)
    assert found.camera.deviations["fx"] < 2.0
    assert found.camera.seen.sum() == sum(used.corners for used in found.used)


def test_the_same_pictures_give_the_same_bits(pictures):
    views, _ = find_boards(pictures, CHARUCO)
    focal = [calibrate_lens(views).camera.lens.focal.tobytes() for _ in range(3)]
    assert len(set(focal)) == 1


@pytest.mark.system
def test_checkerboard_pictures_recover_the_lens():
    studio = Studio(LENS, CHECKERS)
    places = spread(studio, 8, 0.40, near=0.6)
    views, _ = find_boards([(f"p{k}", studio.picture(*p)) for k, p in enumerate(places)], CHECKERS)
    found = calibrate_lens(views)
    assert len(found.used) >= 6
    assert found.rms < 0.06
    assert within_errors(found.camera)


def test_it_agrees_with_opencv():
    """With all corners good and the same unknowns, both find the same least squares."""
    views = seen_corners(LENS, CHECKERS, 8, noise=0.05)
    found = calibrate_lens(views, coefficients=4)
    solid = [np.column_stack([v.corners.places, np.zeros(len(v.corners.places))]) for v in views]
    rms, matrix, distortion, *_ = cv2.calibrateCamera(
        [s.astype(np.float32) for s in solid], [v.corners.pixels.astype(np.float32) for v in views],
        LENS.image_size, None, None, flags=cv2.CALIB_FIX_K3,
    )  # fmt: skip
    lens = found.camera.lens
    np.testing.assert_allclose(lens.focal, [matrix[0, 0], matrix[1, 1]], rtol=1e-5)
    np.testing.assert_allclose(lens.distortion[:4], distortion.ravel()[:4], atol=2e-5)
    assert found.rms * np.sqrt(2) == pytest.approx(rms, rel=1e-4)


def test_fisheye_is_found():
    found = calibrate_lens(seen_corners(WIDE, CHECKERS, 10, noise=0.05, depth=0.2), fisheye=True)
    assert within_errors(found.camera, WIDE)


def test_a_bad_picture_is_dropped_with_the_reason():
    views = list(seen_corners(LENS, CHECKERS, 8, noise=0.05))
    bent = views[3].corners
    wave = 2.0 * np.sin(40.0 * bent.places[:, :1] + 20.0 * bent.places[:, 1:])
    views[3] = views[3]._replace(corners=Corners(bent.places, bent.pixels + wave))
    one = views[5].corners
    moved = one.pixels.copy()
    moved[7] += 5.0
    views[5] = views[5]._replace(corners=Corners(one.places, moved))
    found = calibrate_lens(views)
    assert "px" in dict(found.dropped)["view 3"]
    assert found.rms < 0.08


@pytest.mark.parametrize("count", [0, 3])
def test_too_few_pictures(count):
    views = seen_corners(LENS, CHECKERS, 8, noise=0.05)[:count]
    refused(calibrate_lens, views, [("x.png", "no such board")], match="at least 4")


@pytest.mark.parametrize(("lens", "seen", "options", "message"), [
    (replace(LENS, distortion=(0.0,)), {"noise": 0.05, "tilt": 0.02}, {}, "of parallel"),
    # Distortion bends boards as a tilt would; then the fit itself knows too little.
    (LENS, {"noise": 0.05, "tilt": 0.02}, {}, "more tilted"),
    (LENS, {"noise": 0.5, "tilt": 0.12}, {}, r"parallel|known to"),
    (LENS, {"noise": 0.05}, {"coefficients": 3}, "coefficients"),
], ids=["parallel", "parallel and distorted", "hardly tilted", "coefficients"])  # fmt: skip
def test_boards_that_say_too_little_are_refused(lens, seen, options, message):
    refused(calibrate_lens, seen_corners(lens, CHECKERS, 5, **seen), **options, match=message)


@pytest.mark.parametrize(("size", "word"), [((360, 480), "90 degrees"), ((960, 720), "one size")])
def test_mixed_sizes(size, word):
    views = list(seen_corners(LENS, CHECKERS, 8, noise=0.05))
    views[2] = BoardView("odd.png", size, views[2].corners)
    refused(calibrate_lens, views, match=word)


def test_mirrored_pictures(pictures):
    mirrored = [(name, np.ascontiguousarray(picture[:, ::-1])) for name, picture in pictures]
    refused(find_boards, mirrored, CHARUCO, match="mirrored")


def test_another_board(pictures):
    views, dropped = find_boards(pictures[:4], CHECKERS)
    assert not views
    refused(calibrate_lens, views, dropped, match="no such board")


@pytest.mark.parametrize(
    "text",
    ["", "charuco", "charuco:7x5:30:22", "charuco:7x5:30mm:31mm", "checkerboard:9x6",
     "checkerboard:1x6:25mm", "charuco:50x40:3mm:2mm", "board:9x6:25mm",
     "charuco:7x5:30mm:22mm:9x9",
     "checkerboard:9x6:0mm"],
)  # fmt: skip
def test_boards_that_cannot_be(text):
    refused(board_of, text)


def test_boards_are_read():
    assert board_of("checkerboard:9x6:25mm") == Board(columns=10, rows=7, square=0.025)
    assert board_of("charuco:7x5:3cm:22mm:5x5").dictionary == "5x5"


def test_fewer_coefficients_stay_nought():
    lens = replace(LENS, distortion=(0.0,))
    found = calibrate_lens(seen_corners(lens, CHECKERS, 6, noise=0.05), coefficients=1)
    assert not found.camera.lens.distortion[1:].any()
    assert set(found.camera.names) == {"fx", "fy", "cx", "cy", "k1"}


# --- lenses that the usual model does not describe ----------------------------------------------


def otherwise_seen(k3, seed, n_view=12):
    """Corners by OpenCV's projection, with noise, and a bias that is smooth over each picture."""
    rng = np.random.default_rng(seed)
    matrix = np.array([[951.3, 0, 652.7], [0, 948.6, 351.4], [0, 0, 1.0]])
    lens = np.array([-0.18, 0.07, 0.0007, -0.0009, k3])
    i, j = np.meshgrid(np.arange(6) + 1.0, np.arange(4) + 1.0)
    flat = 0.03 * np.column_stack([i.ravel(), j.ravel()])
    views = []
    aims = [(0.25, 0.3), (0.75, 0.3), (0.75, 0.7), (0.25, 0.7), (0.5, 0.5)]
    while len(views) < n_view:
        lean = rng.uniform(0.25, 0.6) * np.array([*rng.normal(size=2), 0.0])
        turn = cv2.Rodrigues(lean)[0] @ np.diag([1.0, -1.0, -1.0])
        u, v = np.array(aims[len(views) % 5]) * [1280, 720]
        middle = rng.uniform(0.34, 0.5) * np.array([(u - 652.7) / 951.3, (v - 351.4) / 948.6, 1.0])
        shift = middle - turn @ [0.105, 0.075, 0.0]
        points = np.column_stack([flat, np.zeros(24)])
        pixels = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], shift, matrix, lens)[0][:, 0]
        a, b, phase = rng.uniform(-30, 30, 3)
        bias = 0.03 * np.sin(flat @ [[a, b], [b, -a]] + phase)
        pixels += bias + rng.normal(0.0, 0.02, pixels.shape)
        views.append(BoardView(f"{len(views)}", (1280, 720), Corners(flat, pixels)))
    return views


@pytest.mark.system
@pytest.mark.parametrize("k3", [pytest.param(0.0, marks=pytest.mark.slow), -0.06])
def test_the_lens_is_as_sure_as_it_says_in_the_corners(k3):
    """Directions of pixels all over the picture, against OpenCV's: 95 of 100 within the radius.

    A lens has no place, so directions are compared after the turn that suits them best.
    """
    matrix = np.array([[951.3, 0, 652.7], [0, 948.6, 351.4], [0, 0, 1.0]])
    u, v = np.meshgrid(np.linspace(20, 1259, 9), np.linspace(20, 699, 6))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 80, 1e-12)
    distortion = np.array([-0.18, 0.07, 0.0007, -0.0009, k3])
    true = cv2.undistortPointsIter(pixels[:, None], matrix, distortion, np.eye(3), np.eye(3), stop)[
        :, 0
    ]
    held = []
    for seed in range(3):
        known = calibrate_lens(otherwise_seen(k3, seed)).camera
        names = known.names
        found = known.lens.direction(pixels)
        slopes = []
        for name, step in zip(names, 1e-3 * np.array(list(known.deviations.values())), strict=True):
            moved = known.lens.with_parameters([name], [known.lens.parameters[name] + step])
            slopes.append((moved.direction(pixels) - found) / step)
        slope = np.stack(slopes, axis=-1).reshape(2 * len(pixels), -1)
        # The place of the camera over a plane is free: what a homography can do.
        x, y = true.T
        zero, one = np.zeros_like(x), np.ones_like(x)
        rows = np.stack(
            [
                np.stack([x, y, one, zero, zero, zero, -x * x, -x * y], axis=-1),
                np.stack([zero, zero, zero, x, y, one, -x * y, -y * y], axis=-1),
            ],
            axis=1,
        ).reshape(2 * len(pixels), 8)
        free = np.eye(len(rows)) - rows @ np.linalg.pinv(rows)
        off = (free @ (found - true).ravel()).reshape(-1, 2)
        covariance = free @ slope @ known.covariance @ slope.T @ free
        own = np.stack([covariance[k : k + 2, k : k + 2] for k in range(0, len(rows), 2)])
        held.append(np.mean(np.hypot(*off.T) <= radius95(own)))
    assert np.mean(held) > 0.9


@pytest.mark.system
def test_it_is_said_whether_more_coefficients_are_needed():
    found = calibrate_lens(otherwise_seen(-0.06, 0, n_view=10))
    assert set(found.unseen) == {4, 5, 8}
    assert found.unseen[5] < found.unseen[4]
    assert "k3" in found.camera.names
    assert calibrate_lens(otherwise_seen(-0.06, 0), coefficients=4).unseen == {}
