"""Where a camera is: from a board and from tags, and how right places on the plane are then."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from benchmarks.board_pictures import Studio, seen_corners
from tests.fixtures import refused
from tests.vision.test_calibrate_lens import CHARUCO, CHECKERS, LENS

from fixel.errors import InvalidInput
from fixel.formats.rig_file import rig_of
from fixel.vision.calibrate_lens import calibrate_lens
from fixel.vision.camera import PLACE, Camera, MeasuredCamera
from fixel.vision.marks import Tag, board_of
from fixel.vision.place_camera import place_by_board, place_by_points, place_by_tags
from fixel.vision.plane_errors import plane_errors, radius95, shifted

KNOWN = MeasuredCamera(lens=LENS)


def above(turned=0.3):
    return Camera.looking_down(LENS, 0.4, above=(0.1, 0.07), turned=turned, tilted=(0.04, -0.03))


@pytest.fixture(scope="module")
def studio():
    return Studio(LENS, CHARUCO)


@pytest.mark.parametrize("turned", [0.0, 0.3, 2.0])
def test_board_on_the_plate(turned, studio):
    true = above(turned)
    picture = studio.picture(true.rotation, true.translation)
    found = place_by_board(KNOWN, picture, CHARUCO)
    camera = found.camera.placed()
    deviations = found.camera.deviations
    off = np.abs(camera.translation - true.translation)
    assert (off < 4.0 * np.array([deviations[name] for name in PLACE[3:]])).all()
    assert np.hypot(*found.misfit.T).max() < 5e-4
    assert np.abs(camera.on_plane([240.0, 180.0]) - true.on_plane([240.0, 180.0])).max() < 2e-4


def test_board_elsewhere_and_thick(studio):
    true = above()
    picture = studio.picture(true.rotation, true.translation)
    plain = place_by_board(KNOWN, picture, CHARUCO).camera.placed()
    moved = place_by_board(KNOWN, picture, CHARUCO, pose=(0.2, -0.1, 0.5), height=0.004)
    # The same pixel shows the same place of the board, 4 mm above the plate.
    pixel = [200.0, 150.0]
    x, y = plain.on_plane(pixel)
    c, s = np.cos(0.5), np.sin(0.5)
    expected = [c * x - s * y + 0.2, s * x + c * y - 0.1]
    np.testing.assert_allclose(moved.camera.placed().on_plane(pixel, 0.004), expected, atol=1e-9)


def tagged(true, tags):
    """A white plate with tags, by the projection of each pixel of theirs."""
    width, height = true.lens.image_size
    fine = 4
    big = np.full((height * fine, width * fine), 230, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for tag in tags:
        cells = cv2.aruco.generateImageMarker(dictionary, tag.id, 8)
        x, y, angle = tag.pose
        c, s = np.cos(angle), np.sin(angle)
        for (row, column), value in np.ndenumerate(cells):
            if value:
                continue
            # Straight sides of a cell hardly bend; corners are exact.
            cell = np.array([column, row])
            corners = (cell + np.array([[0, 0], [1, 0], [1, 1], [0, 1]])) / 8 - 0.5
            own = tag.size * corners * [1, -1]
            at = own @ np.array([[c, s], [-s, c]]) + [x, y]
            pixels = (true.project_at(at, tag.height) + 0.5) * fine - 0.5
            cv2.fillConvexPoly(big, np.rint(pixels * 16).astype(np.int32), 20, shift=4)
    gray = big.reshape(height, fine, width, fine).mean(axis=(1, 3))
    return np.random.default_rng(0).normal(gray, 2.0).clip(0, 255).astype(np.uint8)


TAGS = tuple(
    Tag(id=k, size=0.03, pose=(x, y, 0.1 * k), height=0.0001)
    for k, (x, y) in enumerate([(0.0, 0.0), (0.2, 0.0), (0.2, 0.14), (0.0, 0.14)])
)


@pytest.fixture(scope="module")
def plate():
    return tagged(above(), TAGS)


def test_tags_on_the_plate(plate):
    found = place_by_tags(KNOWN, plate, TAGS)
    camera = found.camera.placed()
    assert found.rms < 0.2  # tags are drawn to a quarter of a pixel
    middle = [240.0, 180.0]
    np.testing.assert_allclose(camera.on_plane(middle), above().on_plane(middle), atol=1e-4)
    np.testing.assert_allclose(camera.position, above().position, atol=2e-3)


@pytest.mark.parametrize(("seen", "tags", "message"), [
    (lambda plate: plate, (*TAGS[:3], replace(TAGS[3], pose=(0.02, 0.14, 0.3))),
     "mm from its nominal"),
    (lambda plate: plate, (TAGS[0], replace(TAGS[1], id=77)), "at least 2"),
    (lambda plate: plate[:, ::-1], TAGS, "mirrored"),
    (lambda plate: plate.T, TAGS, "90 degrees"),
], ids=["a tag elsewhere", "too few tags", "mirrored", "another size"])  # fmt: skip
def test_pictures_that_do_not_show_the_plate_are_refused(plate, seen, tags, message):
    refused(place_by_tags, KNOWN, np.ascontiguousarray(seen(plate)), tags, match=message)


def test_a_tag_twice(plate):
    twice = plate.copy()
    u, v = above().project_at(TAGS[0].pose[:2], 0.0).astype(int)
    p, q = above().project_at([0.1, 0.07], 0.0).astype(int)
    twice[q - 30 : q + 30, p - 30 : p + 30] = plate[v - 30 : v + 30, u - 30 : u + 30]
    refused(place_by_tags, KNOWN, twice, TAGS, match="two positions")


def test_rig_tags_seen_by_its_own_camera():
    rig = rig_of("thesis-tags")
    picture = tagged(rig.camera, rig.plate)
    found = place_by_tags(MeasuredCamera(lens=rig.camera.lens), picture, rig.plate)
    np.testing.assert_allclose(found.camera.placed().position, rig.camera.position, atol=1e-3)


# --- errors on the plane --------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.0, 0.3, 1.0])
def test_radius_holds_95_percent(ratio):
    draws = np.random.default_rng(0).normal(size=(200_000, 2)) * [3.0, 3.0 * ratio]
    radius = radius95(np.diag([9.0, 9.0 * ratio**2]))
    assert np.mean(np.hypot(*draws.T) < radius) == pytest.approx(0.95, abs=0.002)


def flat_points():
    i, j = np.meshgrid(np.linspace(0.02, 0.2, 7), np.linspace(0.02, 0.13, 5))
    return np.column_stack([i.ravel(), j.ravel(), np.zeros(35)])


@pytest.mark.system
def test_errors_hold_95_percent_of_the_time():
    """Lens and place from noisy corners, ten times: is the truth within the radius?"""
    true, points, held, ratios = above(), flat_points(), [], []
    for seed in range(10):
        random = np.random.default_rng(seed)
        found = calibrate_lens(seen_corners(LENS, CHECKERS, 6, noise=0.05, seed=seed))
        pixels = true.project(points) + random.normal(0.0, 0.05, (len(points), 2))
        placed = place_by_points(found.camera, points, pixels, [""] * len(points)).camera
        errors = plane_errors(placed, 0.02, columns=7, rows=5)
        off = np.linalg.norm(errors.places - true.on_plane(errors.pixels, 0.02), axis=-1)
        held.append(np.mean(off <= errors.camera))
        ratios.append(np.median(off / errors.camera))
    # Places of one picture err together, so that ten pictures are about ten draws.
    assert np.mean(held) > 0.85
    # Of two independent errors, half are within 0.48 of the radius that holds 95 %.
    assert 0.25 < np.median(ratios) < 0.8


@pytest.fixture(scope="module")
def placed():
    found, points = calibrate_lens(seen_corners(LENS, CHECKERS, 6, noise=0.05)), flat_points()
    seen = above().project(points)
    return place_by_points(found.camera, points, seen, [""] * len(points)).camera


def test_errors_are_those_of_drawn_cameras(placed):
    """The linear propagation against cameras drawn from the covariance."""
    errors = plane_errors(placed, 0.02, columns=3, rows=3)
    draws = np.random.default_rng(0).multivariate_normal(
        np.zeros(len(placed.names)), placed.covariance, 400
    )
    off = [
        shifted(placed, dict(zip(placed.names, draw.tolist(), strict=True))).on_plane(
            errors.pixels, 0.02
        )
        - errors.places
        for draw in draws
    ]
    share = np.mean(np.linalg.norm(off, axis=-1) < errors.camera, axis=0)
    np.testing.assert_allclose(share, 0.95, atol=0.04)


def test_nothing_known_is_said_so():
    errors = plane_errors(MeasuredCamera(lens=LENS, camera=above()), 0.0)
    assert not errors.known
    assert not errors.whole.any()


def test_rescaled_cameras_err_the_same_on_the_plane(placed):
    half = placed.for_pictures_of((240, 180), rescale=True)
    here, there = (plane_errors(c, 0.0, columns=3, rows=3) for c in (placed, half))
    np.testing.assert_allclose(here.camera[1, 1], there.camera[1, 1], rtol=0.05)


def test_tags_of_another_family_are_named(plate):
    others = tuple(replace(tag, family="aruco-4x4-50") for tag in TAGS)
    refused(place_by_tags, KNOWN, plate, others, match="apriltag-36h11 tags 0, 1, 2, 3")


def test_a_board_of_another_dictionary_is_named():
    studio = Studio(LENS, board_of("charuco:7x5:30mm:20mm:5x5"))
    true = above()
    with pytest.raises(InvalidInput, match="a board with tags of 5x5"):
        CHARUCO.find(studio.picture(true.rotation, true.translation))
