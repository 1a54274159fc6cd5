"""One loop records: frames and readings in pairs, and a reason for every end."""

from __future__ import annotations

import os
import resource
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures import refused
from tests.testbed.films import SIZE, Fixels, Pictures, picture, record

from fixel.formats.recording import open_recording
from fixel.formats.recording_video import jpeg_of
from fixel.testbed import recorder as recorder_module
from fixel.testbed.frame_source import CATCHING_UP, CameraPicture, FrameQueue
from fixel.testbed.recorder import RecordingStatus, Seating


@pytest.mark.parametrize("codec", ["as-it-comes", "near", "exact"])
def test_every_frame_gets_its_reading(tmp_path: Path, codec: str) -> None:
    fixels = Fixels(lambda k: None if k == 4 else k % 8)
    done = record(Pictures(12), tmp_path / "r", codec, tactile=fixels, rig="bench")
    assert (done.frames, done.lost, done.without_reading) == (12, 0, 1)
    assert done.reason == "no more pictures"
    assert done.problems == ("fixels: no answer",)
    kept = open_recording(tmp_path / "r")
    assert kept.complete
    assert kept.readings.tolist() == [-1 if k == 4 else k % 8 for k in range(12)]
    assert np.flatnonzero(np.isnan(kept.reading_time)).tolist() == [4]
    np.testing.assert_allclose(kept.time, np.arange(12) / 100.0, atol=1e-6)
    assert done.rate == pytest.approx(100.0, rel=1e-3)
    if codec == "as-it-comes":
        assert [data for _, data in kept.jpegs()] == [jpeg_of(picture(k)) for k in range(12)]


def test_a_limit_ends_it(tmp_path: Path) -> None:
    done = record(Pictures(50), tmp_path / "r", limit=0.2)
    assert done.frames == 20
    assert done.reason == "the limit of 0.2 s"


def test_a_key_ends_it(tmp_path: Path) -> None:
    seen: list[RecordingStatus] = []
    done = record(
        Pictures(10_000),
        tmp_path / "r",
        watch=lambda arrived, status: seen.append(status),
        stop=lambda: "a key" if seen else "",
    )
    assert done.reason == "a key"
    assert seen[0].frames == 1
    assert seen[0].free > 0


def test_a_stop_before_the_first_picture_leaves_no_empty_recording(tmp_path: Path) -> None:
    late = Pictures(10, before=lambda k: time.sleep(0.5))
    found = refused(record, late, tmp_path / "r", stop=lambda: "a key")
    assert "no picture before it was stopped (a key)" in str(found)
    assert not (tmp_path / "r").exists()


def test_a_stop_right_after_the_first_picture_keeps_that_picture(tmp_path: Path) -> None:
    sent: list[int] = []
    done = record(
        Pictures(10, before=sent.append), tmp_path / "r", stop=lambda: "a key" if sent else ""
    )
    assert done.frames >= 1
    assert open_recording(tmp_path / "r").n_frames == done.frames


def test_a_mode_that_stays_ends_it(tmp_path: Path) -> None:
    fixels = Fixels(lambda k: 0b010 if 10 < k < 20 or k >= 30 else 0)
    done = record(Pictures(300), tmp_path / "r", tactile=fixels, seating=Seating(0b010))
    assert done.frames == 81
    assert done.reason == "seated: contact mode 010 for 0.5 s"


def test_rest_after_motion_ends_it(tmp_path: Path) -> None:
    source = Pictures(600, lambda k: jpeg_of(picture(min(max(k - 150, 0), 60))))
    done = record(source, tmp_path / "r", seating=Seating())
    assert done.reason == "seated: no motion for 1 s"
    assert 3.0 < done.seconds < 3.5


def test_a_slow_disk_loses_frames_and_says_how_many(tmp_path: Path) -> None:
    full = threading.Event()

    class Slow:
        trouble = ""

        def read(self) -> Any:
            full.wait(60.0)
            return Fixels(lambda k: 0).read()

    def before(k: int) -> None:
        if k == 60:
            full.set()

    done = record(
        Pictures(60 + 1, live=True, before=before), tmp_path / "r", tactile=Slow(), codec="near"
    )
    assert done.lost >= 20
    assert done.frames + done.lost == 61
    assert f"{done.lost} frames lost while recording" in open_recording(tmp_path / "r").problems


def test_who_stays_behind_gives_up_what_is_old() -> None:
    queue = FrameQueue(Pictures(0), live=True)
    began = time.monotonic()
    fresh, old = CameraPicture(began + 100.0), CameraPicture(began - 100.0)

    def kept(*waiting: CameraPicture) -> list[CameraPicture]:
        for arrived in waiting:
            queue._put(arrived)
        return [arrived for _ in waiting if (arrived := queue.get(0.0)) is not None]

    assert kept(fresh, old, old) == [fresh, old, old]  # caught up with
    time.sleep(CATCHING_UP + 0.01)
    assert kept(old, old, fresh, old) == [fresh, old]
    assert queue.lost == 2


def test_pulling_the_tactile_plug_ends_it(tmp_path: Path) -> None:
    fixels = Fixels(lambda k: 1)

    def answer(k: int) -> int | None:
        if k == 5:
            fixels.trouble = "/dev/ttyACM0 went away"
        return None if k >= 5 else 1

    fixels._answer = answer
    done = record(Pictures(50), tmp_path / "r", tactile=fixels)
    assert done.reason == "the tactile board no longer answers: /dev/ttyACM0 went away"
    assert open_recording(tmp_path / "r").readings.tolist() == [1] * 5 + [-1]


def test_a_camera_that_falls_silent_ends_it(tmp_path: Path) -> None:
    def wait(k: int) -> None:
        if k == 8:
            source.pulled.wait(60.0)

    source = Pictures(9, before=wait)
    done = record(source, tmp_path / "r", patience=1.0)
    assert done.frames == 8
    assert done.reason == "the camera has sent nothing for 1 s"


def test_a_camera_that_fails_ends_it(tmp_path: Path) -> None:
    def fail(k: int) -> None:
        if k == 3:
            raise OSError("it burns")

    done = record(Pictures(9, before=fail), tmp_path / "r")
    assert (done.frames, done.reason) == (3, "the camera failed: it burns")


@pytest.mark.parametrize(
    ("size", "sent", "codec"),
    [((80, 60), jpeg_of, "as-it-comes"), ((120, 160), lambda pixels: pixels, "near")],
)
def test_pictures_of_another_size_end_it(
    tmp_path: Path, size: tuple[int, int], sent: Any, codec: str
) -> None:
    source = Pictures(9, lambda k: sent(picture(k, SIZE if k < 4 else size)))
    done = record(source, tmp_path / "r", codec)
    changed = f"the camera changed to {size[0]} x {size[1]} pixels"
    assert (done.frames, done.reason) == (4, changed)


def test_a_picture_that_cannot_be_decoded_is_left_out_and_said(tmp_path: Path) -> None:
    good = jpeg_of(picture(0))
    source = Pictures(6, lambda k: good if k != 3 else good[:4] + good[-2:])
    done = record(source, tmp_path / "r", "near", tactile=Fixels(lambda k: 1))
    assert done.frames == 5
    assert "a picture that cannot be decoded, skipped" in done.problems


def test_a_source_that_ends_at_once_leaves_no_folder(tmp_path: Path) -> None:
    refused(record, Pictures(0), tmp_path / "r", match="no more pictures")
    assert not (tmp_path / "r").exists()


def test_who_watches_may_fail(tmp_path: Path) -> None:
    def watch(arrived: CameraPicture, status: RecordingStatus) -> None:
        raise ZeroDivisionError("in the browser")

    done = record(Pictures(9), tmp_path / "r", watch=watch)
    assert done.frames == 9
    assert done.problems == ("the preview failed: in the browser",)


def test_gaps_are_reported(tmp_path: Path) -> None:
    source = Pictures(40)
    frames = source.frames

    def late() -> Iterator[CameraPicture]:
        for k, arrived in enumerate(frames()):
            arrived.time += 0.1 * (k >= 30)
            yield arrived

    source.frames = late  # type: ignore[method-assign]
    done = record(source, tmp_path / "r")
    assert done.problems == ("1 gap between frames; the longest is 110 ms, after t = 0.290 s",)


# --- disks ----------------------------------------------------------------------------------


def test_a_minute_must_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "free_space", lambda folder: 40_000_000)
    refused(record, Pictures(9), tmp_path / "r", match="40 MB free on its disk, but fixel needs")
    assert not (tmp_path / "r").exists()
    assert record(Pictures(9), tmp_path / "r", limit=1.0).frames == 9


def test_it_ends_before_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = iter([10**9])  # enough at the start
    monkeypatch.setattr(recorder_module, "free_space", lambda folder: next(free, 20_000_000))
    done = record(Pictures(9), tmp_path / "r")
    assert done.reason == "the disk is almost full: 20 MB are left"
    assert open_recording(tmp_path / "r").complete


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file may grow beyond a size, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("codec", ["as-it-comes", "near", "exact"])
def test_a_disk_that_takes_no_more_leaves_what_it_took(tmp_path: Path, codec: str) -> None:
    with largest_file(100_000):
        done = record(Pictures(100), tmp_path / "r", codec)
    assert done.reason == f"the disk of {tmp_path / 'r'} could not be written to: file too large"
    assert 0 < done.frames < 100
    kept = open_recording(tmp_path / "r")
    assert kept.complete
    assert kept.problems == ()
    assert kept.n_frames == done.frames
    assert len(list(kept.frames())) == done.frames


def test_a_read_only_folder_is_refused(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("the administrator may write anywhere")
    tmp_path.chmod(0o500)
    refused(record, Pictures(3), tmp_path / "r", match="permission denied")
