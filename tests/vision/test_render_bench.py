"""Where things are in the picture: against `Camera.project`, and in front of each other."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from tests.vision.rendered import AWAY, SIZE, bare_scene, small_rig, still

from fixel.model import Disk, Fixel
from fixel.model.shape import placed
from fixel.vision.marks import cells, dictionary_of
from fixel.vision.render.bench import RenderedBench
from fixel.vision.render.bodies import DELRIN, PAPER, TONER, markings
from fixel.vision.render.looks import CameraEffects
from fixel.vision.render.virtual_camera import Projection

PLAIN = CameraEffects(shadows=0.0)
RED = 2


def poses(n, seed):
    random = np.random.default_rng(seed)
    for _ in range(n):
        yield np.array([0.15, 0.008, 0.0]) + random.uniform(-1, 1, 3) * (0.03, 0.02, 3.0)


def moment(weight):
    v, u = np.indices(weight.shape)
    return np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


def test_a_sticker_is_where_the_camera_projects_it():
    rig = small_rig("thesis-stickers")
    bench = RenderedBench(bare_scene(), rig, PLAIN, 1)
    sticker = rig.parts["object"].marks[0]
    ink = markings(sticker, 5e-4)[0]
    off, area = [], []
    for pose in poses(12, 1):
        picture = bench.light([{"object": pose, "actuator": AWAY}])[..., RED].astype(float)
        ring = shapely.Polygon(rig.camera.project_at(placed(ink.points, pose), ink.height))
        v, u = np.indices(picture.shape)
        near = np.hypot(u - ring.centroid.x, v - ring.centroid.y) < 14.0
        weight = np.where(near, (picture - DELRIN[RED]) / (ink.colour[RED] - DELRIN[RED]), 0.0)
        weight[weight < 0.04] = 0.0  # the grain of the plastic
        off.append(moment(weight) - np.array(ring.centroid.coords[0]))
        area.append((weight.sum() - ring.area) / ring.length)
        centre = rig.camera.project_at(placed(sticker.place, pose), sticker.height)
        assert np.abs(moment(weight) - centre).max() < 0.015  # an ellipse's middle is no projection

    assert np.abs(np.mean(off, axis=0)).max() < 1e-3  # [px]
    assert np.abs(off).max() < 6e-3
    assert abs(np.mean(area)) < 3e-3  # [px] by which the edge lies too far out


def test_the_edges_of_a_tag_lie_where_the_camera_projects_them():
    rig = small_rig()
    bench = RenderedBench(bare_scene(), rig, PLAIN, 1)
    tag = rig.parts["object"].marks[0]
    paper, toner = markings(tag, 5e-4)
    for pose in poses(4, 2):
        picture = bench.light([{"object": pose, "actuator": AWAY}])[..., 0].astype(float)
        dark = (PAPER[0] - picture) / (PAPER[0] - TONER[0])
        pixels = rig.camera.project_at(placed(toner.points, pose), tag.height)
        cells = shapely.union_all(
            [shapely.Polygon(cell).buffer(1e-9) for cell in pixels.reshape(-1, 4, 2)]
        )
        # Well inside the paper, so that the plastic does not count.
        reach = placed(paper.points * 0.93, pose)
        inside = shapely.Polygon(rig.camera.project_at(reach, tag.height))
        v, u = np.indices(dark.shape)
        dark[~shapely.contains_xy(inside, u, v)] = 0.0

        assert dark.sum() == pytest.approx(cells.area, abs=2e-3 * cells.length)
        assert moment(dark) == pytest.approx(cells.centroid.coords[0], abs=1e-3)


def test_opencv_reads_the_tag_the_right_way_up():
    cv2 = pytest.importorskip("cv2")
    rig = small_rig()
    pose = np.array([0.15, 0.0, 0.4])
    picture = np.clip(still(rig, PLAIN, pose), 0, 255).astype(np.uint8)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(family).detectMarkers(picture)

    assert ids.ravel().tolist() == [1]
    tag = rig.parts["object"].marks[0]
    square = 0.5 * tag.size * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    assert corners[0][0] == pytest.approx(
        rig.camera.project_at(placed(square, pose), tag.height), abs=1.5
    )


def test_a_tag_has_the_cells_of_its_family():
    cv2 = pytest.importorskip("cv2")
    drawn = cv2.aruco.generateImageMarker(dictionary_of("apriltag-36h11"), 1, 8)
    white = cells("apriltag-36h11", 1)[1].reshape(8, 8)
    assert (white == (drawn >= 128)).all()
    assert not white[0].any()  # its border
    assert not white[:, -1].any()


def test_what_is_higher_leans_outward_and_hides_what_is_behind():
    """A fixel between the foot of the camera and the object stands before it."""
    rig = small_rig()
    foot = rig.camera.position[:2]
    peg = Fixel(
        name="peg", shape=Disk(0.00476), pose=np.array([foot[0] + 0.03, foot[1], 0.0]), friction=0.2
    )
    scene = replace(bare_scene(), fixels=(peg,))
    pose = np.array([foot[0] + 0.03 + 0.00476 + 0.0545, foot[1], 0.0])
    before = still(rig, PLAIN, AWAY, scene)
    after = still(rig, PLAIN, pose, scene)
    top = rig.camera.project_at(peg.pose[:2] + np.array([0.0025, 0.0]), rig.fixel_height)
    side = rig.camera.project_at(placed([-0.05, 0.03], pose), rig.parts["object"].height)

    u, v = np.rint(top).astype(int)
    assert after[v, u] == pytest.approx(before[v, u], abs=1.0)
    u, v = np.rint(side).astype(int)
    assert np.abs(after[v, u] - before[v, u]).max() > 50.0


def test_shadows_fall_on_the_plate_and_are_soft():
    rig = small_rig()
    pose = np.array([0.15, 0.008, 0.3])
    lit = still(rig, PLAIN, pose)
    shaded = still(rig, CameraEffects(shadows=0.5), pose)
    ratio = (shaded / np.maximum(lit, 1.0))[..., 0]
    assert ratio.min() < 0.75
    assert ratio.min() > 0.45
    between = ((ratio > 0.8) & (ratio < 0.97)).sum()
    assert between > 0.05 * ratio.size


def test_what_leaves_the_picture_does_not_come_back_on_the_other_side():
    """The thesis's lens folds back directions beyond 1.39; the eye holds points out there."""
    rig = small_rig()
    eye = Projection(rig.camera)
    far = eye.project_at([[5.0, 0.0], [-3.0, 2.0]], 0.09)
    inside = (far >= -0.5).all(axis=1) & (far <= np.array(SIZE) - 0.5).all(axis=1)
    near = [[0.15, 0.0], [0.2, 0.05]]
    assert not inside.any()
    assert eye.project_at(near, 0.03) == pytest.approx(rig.camera.project_at(near, 0.03), abs=1e-9)


def test_a_picture_is_the_same_in_a_small_window_and_in_a_large_one():
    """A hand in a corner makes the painted window larger; where it is not, nothing changes."""
    bench = RenderedBench(bare_scene(), small_rig(), CameraEffects(blur=1.0, shadows=0.0), 1)
    poses = {"object": np.array([0.10, -0.02, 0.7]), "actuator": AWAY}
    alone = bench.light([poses])
    together = bench.light([{**poses, "hand": np.array([0.235, 0.06, np.pi])}])
    assert np.abs(together - alone)[:80, 330:].max() > 50.0
    assert together[140:, :240] == pytest.approx(alone[140:, :240], abs=1e-3)
