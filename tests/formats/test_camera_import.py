"""Cameras of other programs: read as they mean them, checked by OpenCV's own projection."""

import json
import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.fixtures import refused

from fixel.formats.camera_import import import_camera
from fixel.formats.camera_opencv import matrix_of, save_opencv, save_ros
from fixel.formats.rig_file import load_camera, save_camera
from fixel.vision.camera import Camera, MeasuredCamera
from fixel.vision.lens import Lens

CALIB_RESULTS = """
% Intrinsic and Extrinsic Camera Parameters
%-- Focal length:
fc = [ 944.700000000000045 ; 952.700000000000045 ];
%-- Principal point:
cc = [ 644.7 ; 371.2 ];
%-- Skew coefficient:
alpha_c = 0.002;
%-- Distortion coefficients:
kc = [ 0.01 ; -0.0536 ; 0.001 ; -0.0005 ; 0.02 ];
fc_error = [ 3.0 ; 3.3 ];
cc_error = [ 4.5 ; 3.9 ];
alpha_c_error = 0.000000000000000;
kc_error = [ 0.012 ; 0.03 ; 0.0015 ; 0.0018 ; 0.0 ];
nx = 1280;
ny = 720;
n_ima = 12;		% Number of calibration images
est_fc = [ 1 ; 1 ];
omc_1 = [ 2.1 ; 2.2 ; 0.1 ];
Tc_ext = [ -100.0 ; 50.0 ; 516.0 ];
omc_ext = [ 0.02 ; -0.03 ; 0.4 ];
"""

KALIBR = """
cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.27, 0.067, 0.0008, 0.0001]
  distortion_model: radtan
  intrinsics: [461.6, 460.1, 362.6, 246.0]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.004, -0.0018, 0.0001]
  distortion_model: equidistant
  intrinsics: [461.6, 460.1, 362.6, 246.0]
  resolution: [752, 480]
"""

ROS = """
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [438.7, 0.0, 305.5, 0.0, 437.3, 243.7, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361, 0.159, 0.0012, 0.0007, 0.0]
"""


def seen_by_opencv(lens, points):
    """Pixels of points in the camera's axes (n, 3), by OpenCV."""
    model = cv2.fisheye if lens.fisheye else cv2
    none = np.zeros(3)
    found = (
        model.projectPoints(points[:, None], none, none, matrix_of(lens), lens.distortion)
        if lens.fisheye
        else cv2.projectPoints(points, none, none, matrix_of(lens), lens.distortion)
    )
    return np.asarray(found[0]).reshape(-1, 2)


def points_in_view(lens, n=200):
    random = np.random.default_rng(1)
    flat = lens.direction(random.uniform((0, 0), np.array(lens.image_size) - 1.0, (n, 2)))
    return np.column_stack([flat, np.ones(n)]) * random.uniform(0.3, 2.0, (n, 1))


def test_matlab_file_is_read_as_the_toolbox_means_it(tmp_path):
    (tmp_path / "Calib_Results.m").write_text(CALIB_RESULTS)
    camera, _ = import_camera(tmp_path / "Calib_Results.m")
    lens = camera.lens
    assert camera.source == "Calib_Results.m, matlab"
    assert lens.image_size == (1280, 720)
    # The equations of the toolbox's own documentation, written out once more.
    x, y = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 50))
    k1, k2, p1, p2, k3 = 0.01, -0.0536, 0.001, -0.0005, 0.02
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = radial * x + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    yd = radial * y + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    expected = np.stack([944.7 * (xd + 0.002 * yd) + 644.7, 952.7 * yd + 371.2], axis=-1)
    np.testing.assert_allclose(lens.pixel(np.stack([x, y], axis=-1)), expected, atol=1e-9)
    assert camera.deviations["fx"] == pytest.approx(1.0)
    assert "skew" not in camera.names


def test_matlab_plane_that_looks_away_is_turned(tmp_path):
    path = tmp_path / "Calib_Results.m"
    path.write_text(CALIB_RESULTS)
    found, remarks = import_camera(path)
    camera = found.placed()
    assert camera.position[2] > 0.4
    assert any("reversed" in remark for remark in remarks)
    # A point of the file's plane, by OpenCV; in ours its y has the other sign.
    rotation, _ = cv2.Rodrigues(np.array([0.02, -0.03, 0.4]))
    seen = rotation @ [0.1, 0.05, 0.0] + [-0.1, 0.05, 0.516]
    expected = camera.lens.pixel(seen[:2] / seen[2])
    np.testing.assert_allclose(camera.project_at([0.1, -0.05], 0.0), expected, atol=1e-9)


def test_mat_file_says_the_same_as_the_m_file(tmp_path):
    from scipy.io import savemat

    (tmp_path / "a.m").write_text(CALIB_RESULTS)
    rotation, _ = cv2.Rodrigues(np.array([0.02, -0.03, 0.4]))
    savemat(
        tmp_path / "a.mat",
        {
            "fc": [[944.7], [952.7]],
            "cc": [[644.7], [371.2]],
            "alpha_c": 0.002,
            "kc": [[0.01], [-0.0536], [0.001], [-0.0005], [0.02]],
            "nx": 1280,
            "ny": 720,
            "Rc_ext": rotation,
            "Tc_ext": [[-100.0], [50.0], [516.0]],
            "comment": "hello",
        },
    )
    one, other = (import_camera(tmp_path / name)[0] for name in ("a.m", "a.mat"))
    assert one.lens == other.lens
    np.testing.assert_allclose(one.placed().rotation, other.placed().rotation, atol=1e-12)


@pytest.mark.parametrize(("text", "which"), [(KALIBR, "cam0"), (KALIBR, "cam1"), (ROS, "")])
def test_cameras_of_kalibr_and_ros_project_as_opencv_does(text, which, tmp_path):
    (tmp_path / "a.yaml").write_text(text)
    lens = import_camera(tmp_path / "a.yaml", **({"which": which} if which else {}))[0].lens
    assert lens.fisheye == (which == "cam1")
    points = points_in_view(lens)
    ours = lens.pixel(points[:, :2] / points[:, 2:])
    np.testing.assert_allclose(ours, seen_by_opencv(lens, points), atol=1e-8)


OPENCV = """%YAML:1.0
---
image_width: 640
image_height: 480
mtx: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 438.7, 0., 305.5, 0., 437.3, 243.7, 0., 0., 1. ]
dist: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.361, 0.159, 0.0012, 0.0007, 0. ]
"""


@pytest.mark.parametrize(("name", "content"), [
    ("echo.yaml", (ROS + "---\n").encode()),  # as `ros2 topic echo --once` ends
    ("bom.yaml", b"\xef\xbb\xbf" + ROS.encode()),
    ("tutorial.yml", OPENCV.encode()),  # names of OpenCV's own tutorial in Python
    ("bom.yml", b"\xef\xbb\xbf" + OPENCV.encode()),  # as Windows editors begin a text
    ("crlf.yml", OPENCV.replace("\n", "\r\n").encode()),
])  # fmt: skip
def test_other_endings_beginnings_and_names_give_the_same_lens(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    lens = import_camera(tmp_path / name)[0].lens
    assert (lens.focal.tolist(), lens.centre.tolist()) == ([438.7, 437.3], [305.5, 243.7])
    assert lens.distortion[:4].tolist() == [-0.361, 0.159, 0.0012, 0.0007]


LENSES = [
    Lens(image_size=(640, 480), focal=(500.0, 502.0), centre=(321.0, 238.0),
         distortion=(-0.2, 0.05, 0.001, -0.002, 0.01)),
    Lens(image_size=(640, 480), focal=(500.0, 502.0), centre=(321.0, 238.0),
         distortion=(0.2, 0.05, 0.001, -0.002, 0.01, 0.3, 0.02, 0.01)),
    Lens(image_size=(640, 480), focal=(300.0, 301.0), centre=(321.0, 238.0), fisheye=True,
         distortion=(-0.02, 0.005, 0.001, -0.002)),
]  # fmt: skip


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("name", ["a.yml", "a.xml", "a.json", "ros.yaml"])
def test_exported_lenses_come_back(lens, name, tmp_path):
    path = tmp_path / name
    (save_ros if name == "ros.yaml" else save_opencv)(lens, path)
    assert import_camera(path)[0].lens == lens


@given(
    numbers=st.lists(st.floats(-0.01, 0.01), min_size=4, max_size=4),
    shift=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 3)),
)
@settings(max_examples=20, deadline=None)
def test_camera_files_read_back(numbers, shift, tmp_path_factory):
    lens = Lens(image_size=(64, 48), focal=(50, 51), centre=(31, 22), distortion=numbers)
    placed = Camera.looking_down(
        lens, shift[2], above=shift[:2], turned=shift[0], tilted=(0.1, 0.2)
    )
    measured = MeasuredCamera(
        lens=lens, camera=placed, names=("fx", "k1", "tz"), covariance=np.diag([1.0, 1e-4, 1e-8]),
        noise=0.1, seen=np.arange(8).reshape(2, 4), source="a test",
    )  # fmt: skip
    path = tmp_path_factory.mktemp("camera") / "camera.yaml"
    save_camera(measured, path)
    again = load_camera(path)
    assert again.lens == lens
    assert (again.names, again.noise, again.source) == (measured.names, 0.1, "a test")
    np.testing.assert_array_equal(again.seen, measured.seen)
    np.testing.assert_allclose(again.placed().translation, placed.translation, atol=1e-14)


@pytest.mark.parametrize(("name", "text", "word"), [
    ("a.m", CALIB_RESULTS.replace("nx = 1280;", ""), "nx"),
    ("a.m", CALIB_RESULTS.replace("fc = [ 944", "fc = [ -944"), "above 0"),
    ("a.m", CALIB_RESULTS.replace("516.0", "0.5160").replace("100.0 ; 50.0", "0.1 ; 0.05"), "unit"),
    ("a.m", CALIB_RESULTS.replace("nx = 1280", "nx = 320"), "another resolution"),
    ("a.m", "fc = inv(K);", "fc"),
    ("a.m", "\x00\xff", "fc"),
    ("a.mat", "not a mat file", "MATLAB"),
    ("a.mat", "MATLAB 7.3 MAT-file" + " " * 105 + "\x00\x02IM", "MATLAB"),
    ("a.yaml", ROS.replace("image_height: 480", "image_height: []"), "must be a number"),
    ("a.yaml", KALIBR, "--which"),
    ("a.yaml", KALIBR.replace("pinhole", "omni"), "--which"),
    ("a.yaml", KALIBR[: KALIBR.index("cam1")].replace("pinhole", "omni"), "pinhole"),
    ("a.yaml", KALIBR[: KALIBR.index("cam1")].replace("radtan", "fov"), "radtan"),
    ("a.yaml", KALIBR[: KALIBR.index("cam1")].replace("[461.6, ", "["), "4 numbers"),
    ("a.yaml", ROS.replace("plumb_bob", "fov"), "plumb_bob"),
    ("a.yaml", ROS.replace("0.0007, 0.0", "0.0007, 0.0, 0.1"), "at most 5"),
    ("a.yaml", ROS.replace("438.7", "0.0"), "calibrated"),
    ("a.yaml", ROS.replace("438.7, 0.0", "438.7, 1.0"), "skew"),
    ("a.yaml", ROS + "binning_x: 2\n", "binned"),
    ("a.yaml", ROS + "roi: {x_offset: 12, width: 320}\n", "cropped"),
    ("a.yaml", ROS.replace("640", "many"), "image_width"),
    ("a.yaml", KALIBR[: KALIBR.index("cam1")].replace("461.6, 460.1", "0.61, 0.96"), "pixels"),
    ("a.yaml", ROS.replace("438.7", ".nan"), "9 numbers"),
    ("a.yaml", ROS + "---" + ROS, "second document"),
    ("a.yaml", "hello: world", "unknown format"),
    ("a.yml", "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3\n", "OpenCV"),
    ("a.xml", '<?xml version="1.0"?>\n<opencv_storage><a>1</a></opencv_storage>', "camera matrix"),
    ("a.json", json.dumps({"x": "opencv-matrix"}), "camera matrix"),
])  # fmt: skip
def test_what_cannot_be_read_is_refused(name, text, word, tmp_path):
    path = tmp_path / name
    path.write_bytes(text.encode("latin-1"))
    assert word in str(refused(import_camera, path))


NESTED = {
    "a.yml": "%YAML:1.0\n# opencv-matrix\n---\na: " + "[" * 100_000,
    "a.json": '{"opencv-matrix": ' + "[" * 100_000,
    "a.xml": '<?xml version="1.0"?>\n<opencv_storage>' + "<a>" * 100_000,
}


@pytest.mark.parametrize("name", NESTED)
def test_nesting_of_which_the_parser_of_opencv_dies_is_refused(name, tmp_path):
    (tmp_path / name).write_text(NESTED[name])
    refused(import_camera, tmp_path / name, match="more than 10000 brackets")


def test_a_mat_file_that_unpacks_to_much_is_refused(tmp_path):
    """Gigabytes of zeros, and a cell array of a billion cells in its header alone."""
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"fc": np.zeros(13_000_000)}, do_compression=True)
    assert (tmp_path / "a.mat").stat().st_size < 200_000
    refused(import_camera, tmp_path / "a.mat", match="more than 100 MB, unpacked")
    savemat(tmp_path / "b.mat", {"fc": np.full((1, 7), "x", dtype=object)})
    data = (tmp_path / "b.mat").read_bytes()
    size, giant = np.array([1, 7], "<i4").tobytes(), np.array([1, 2**30], "<i4").tobytes()
    assert data.count(size) == 1
    (tmp_path / "b.mat").write_bytes(data.replace(size, giant))
    tracemalloc.start()
    refused(import_camera, tmp_path / "b.mat", match="fc is missing")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


def test_sizes_are_checked(tmp_path):
    path = tmp_path / "ost.yaml"
    path.write_text(ROS)
    refused(import_camera, path, size=(480, 640), match="turned by 90")
    lens = import_camera(path)[0].lens
    refused(lens.for_pictures_of, (320, 240), match="rescale")
    half = lens.for_pictures_of((320, 240), rescale=True)
    # The same direction is seen at the same place of the picture: pixel edges, not middles, scale.
    np.testing.assert_allclose(half.pixel([0.1, 0.2]) + 0.5, (lens.pixel([0.1, 0.2]) + 0.5) / 2)
    refused(lens.for_pictures_of, (640, 360), rescale=True, match="cropped")


def test_opencv_file_without_a_size_needs_one(tmp_path):
    path = tmp_path / "a.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("K", np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]))
    storage.write("D", np.zeros((1, 5)))
    storage.release()
    refused(import_camera, path, match="--size")
    assert import_camera(path, size=(640, 480))[0].lens.image_size == (640, 480)
