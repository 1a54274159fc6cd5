"""Files damaged at random are read or refused; no other error, and the process never ends."""

import io
import random
from contextlib import suppress

import cv2
import pytest
from scipy.io import savemat
from tests.formats import test_camera_import, test_trials_file, test_video_file
from tests.formats.test_outline_file import svg

import fixel
from fixel.errors import InvalidInput
from fixel.formats.camera_import import import_camera
from fixel.formats.trials_file import read_trials
from fixel.formats.video_file import open_video, read_picture

VALUES = {"fc": [[944.7], [952.7]], "cc": [[644.7], [371.2]], "nx": 1280, "ny": 720, "note": "a"}


def matlab(path, compressed):
    stream = io.BytesIO()
    savemat(stream, VALUES, do_compression=compressed)
    path.write_bytes(stream.getvalue())
    return path


def frames(path):
    for frame in open_video(path).frames():
        assert frame.picture.shape == (*frame.luma.shape, 3)


def picture(path):
    path.write_bytes(cv2.imencode(path.suffix, test_video_file.picture(0))[1].tobytes())
    return path


def film(path):
    test_video_file.write(path, [k / 30 for k in range(8)])
    return path


def text(path, content):
    path.write_text(content)
    return path


def damaged(data, rng):
    """Return a truncated copy, or one with other bytes, often in its head."""
    if rng.random() < 0.25:
        return data[: rng.randrange(len(data))]
    changed = bytearray(data)
    for _ in range(rng.choice([1, 2, 5, 20])):
        changed[rng.randrange(rng.choice([200, len(data)])) % len(data)] = rng.randrange(256)
    return bytes(changed)


@pytest.mark.parametrize(("make", "read"), [
    (lambda folder: picture(folder / "a.png"), read_picture),
    (lambda folder: picture(folder / "a.jpg"), read_picture),
    (lambda folder: picture(folder / "a.tif"), read_picture),
    (lambda folder: film(folder / "a.mp4"), frames),
    (lambda folder: film(folder / "a.mkv"), frames),
    (lambda folder: matlab(folder / "a.mat", False), import_camera),
    (lambda folder: matlab(folder / "a.mat", True), import_camera),
    (lambda folder: text(folder / "a.yaml", test_camera_import.ROS), import_camera),
    (lambda folder: test_trials_file.written(folder / "a.csv"), read_trials),
    (lambda folder: svg(folder / "a.svg", '<path d="M0 0L10 0V10H0Z"/>'), fixel.Polygon.from_file),
], ids=["png", "jpg", "tif", "mp4", "mkv", "mat", "packed", "ros", "trials", "svg"])  # fmt: skip
def test_random_damage_is_refused_or_read(make, read, tmp_path):
    path, rng = make(tmp_path), random.Random(27)
    whole = path.read_bytes()
    read(path)
    for _ in range(80):
        path.write_bytes(damaged(whole, rng))
        with suppress(InvalidInput):  # damage of pixels and of names may leave a file readable
            read(path)


@pytest.mark.parametrize("read", [fixel.load, fixel.read_experiments, open_video, read_picture])
def test_names_that_are_too_long_are_refused(read, tmp_path):
    with pytest.raises(InvalidInput, match="file name too long"):
        read(tmp_path / ("a" * 300))


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_truncated_pictures_are_refused(ending, tmp_path):
    path = picture(tmp_path / f"a{ending}")
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InvalidInput, match="not a picture"):
        read_picture(path)
