"""Cameras of every kind, and what is wrong with them.
Several readers of one camera: each gets every picture from its beginning on.
"""

from __future__ import annotations

import math
import re
import socket
import threading
import time
from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from tests.fixtures import refused
from tests.jobs.helpers import await_true
from tests.testbed.films import SIZE, film, picture, record

from fixel.errors import InvalidInput
from fixel.formats.recording import RecordingHeader, RecordingWriter, open_recording
from fixel.formats.recording_video import brightness, jpeg_of, jpeg_size, shrunk
from fixel.formats.video_file import VideoWriter
from fixel.testbed.file_source import FileSource, LoopbackCamera, PlayedTactile
from fixel.testbed.frame_source import (
    HELD,
    CameraPicture,
    FrameQueue,
    FrameSource,
    SharedCamera,
    Stream,
)
from fixel.testbed.open_source import DeviceSource, UrlSource, check_size, source_of
from fixel.testbed.recorder import Recorder, RecordingStatus
from fixel.vision.frame import Frame

JPEG = jpeg_of(picture(0))


# --- files ------------------------------------------------------------------------------------


@pytest.mark.parametrize("codec", ["near", "exact"])
def test_a_recording_plays_as_it_was(tmp_path: Path, codec: str) -> None:
    folder = film(tmp_path / "film", codec=codec)
    with FileSource(folder, as_fast_as_possible=True) as source:
        stream = source.open()
        frames = list(source.frames())
    assert stream == Stream(SIZE, pytest.approx(100.0), codec != "exact", False)
    assert source.ended == "the file has ended"
    times = np.array([frame.time for frame in frames])
    np.testing.assert_allclose(times - times[0], np.arange(30) / 100.0, atol=1e-9)
    kept = open_recording(folder)
    for arrived, frame in zip(frames, kept.frames(), strict=True):
        assert np.abs(arrived.picture().astype(int) - frame.picture).max() <= 3


def test_a_video_plays_too(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "v.mkv", SIZE, codec="ffv1") as writer:
        for k in range(5):
            writer.write(Frame(k * 0.04, picture(k)))
    source = FileSource(tmp_path / "v.mkv", as_fast_as_possible=True)
    assert source.open() == Stream(SIZE, 0.0, False, False)
    assert [frame.picture().tolist() for frame in source.frames()] == [
        picture(k).tolist() for k in range(5)
    ]


def test_a_file_keeps_its_own_pace(tmp_path: Path) -> None:
    source = FileSource(film(tmp_path / "film", n=11, rate=50.0))
    assert source.open().live
    times = np.array([frame.time for frame in source.frames()])
    # Never early; a busy machine may be late.
    assert (times - times[0] - np.arange(11) / 50.0 > -0.005).all()


def test_a_file_may_begin_again(tmp_path: Path) -> None:
    source = FileSource(film(tmp_path / "film", n=3), as_fast_as_possible=True, loop=True)
    source.open()
    frames = source.frames()
    times = [next(frames).time for _ in range(7)]
    source.close()
    np.testing.assert_allclose(np.diff(times), 0.01, atol=1e-9)
    assert next(frames, None) is None


def test_a_loop_of_one_picture_waits_between_two_and_one_of_none_ends(tmp_path: Path) -> None:
    source = FileSource(film(tmp_path / "one", n=1), loop=True)
    source.open()
    assert np.diff([arrived.taken for arrived in islice(source.frames(), 4)]).min() > 0.01
    with RecordingWriter(tmp_path / "none", RecordingHeader(size=SIZE)) as writer:
        writer.write_jpeg(0.0, b"torn")
    source = FileSource(tmp_path / "none", loop=True)
    source.open()
    assert list(source.frames()) == []


def test_what_is_missing_from_a_file_is_reported_at_its_end(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "v.mkv", SIZE, codec="ffv1") as writer:
        for k in range(9):
            writer.write(Frame(k * 0.04, picture(k)))
    whole = (tmp_path / "v.mkv").read_bytes()
    (tmp_path / "v.mkv").write_bytes(whole[: len(whole) // 2])
    (film(tmp_path / "film") / "end.json").unlink()
    for played, said in (("v.mkv", "truncated: the file ends after"), ("film", "no end mark")):
        source = FileSource(tmp_path / played, as_fast_as_possible=True)
        source.open()
        list(source.frames())
        assert source.ended.startswith("the file has ended; ")
        assert said in source.ended


def test_readings_play_with_their_film(tmp_path: Path) -> None:
    folder = film(tmp_path / "film", n=20)
    source = FileSource(folder, as_fast_as_possible=True)
    record(source, tmp_path / "r", tactile=PlayedTactile(folder, in_turn=True))
    assert open_recording(tmp_path / "r").readings.tolist() == [k % 8 for k in range(20)]
    paced = PlayedTactile(folder)
    assert paced.read().bits == 0
    time.sleep(0.2)
    assert paced.read().bits == 19 % 8


# --- network cameras --------------------------------------------------------------------------


def test_a_film_goes_round_the_loop_bit_by_bit(tmp_path: Path) -> None:
    folder = film(tmp_path / "film")
    with LoopbackCamera(folder) as camera:
        with UrlSource(camera.url) as source:
            assert source.open() == Stream(SIZE, 0.0, True, True)
        done = record(UrlSource(camera.url), tmp_path / "r")
    assert (done.frames, done.lost, done.reason) == (30, 0, "the camera ended the stream")
    sent = [data for _, data in open_recording(folder).jpegs()]
    assert [data for _, data in open_recording(tmp_path / "r").jpegs()] == sent


def test_a_pulled_network_camera_ends_the_recording(tmp_path: Path) -> None:
    camera = LoopbackCamera(film(tmp_path / "film"), loop=True).start()  # it would not end
    pull = threading.Thread(target=camera.stop)

    def pulls(_: object, status: RecordingStatus) -> None:
        if status.frames > 5 and pull.ident is None:
            pull.start()

    done = record(UrlSource(camera.url), tmp_path / "r", watch=pulls)
    pull.join()
    assert done.frames > 5
    assert done.reason.startswith("the camera")
    assert open_recording(tmp_path / "r").complete


def test_a_camera_that_was_never_started_can_be_stopped(tmp_path: Path) -> None:
    camera = LoopbackCamera(film(tmp_path / "film"))
    stopping = threading.Thread(target=camera.stop, daemon=True)
    stopping.start()
    stopping.join(60.0)
    assert not stopping.is_alive()


@contextmanager
def answering(*parts: bytes, hold: bool = False, drip: bool = False) -> Iterator[str]:
    """A server that says exactly this to whoever connects; the address of its camera.

    Then it hangs up; or holds the line for a while, or drips a byte now and then.
    """
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(60.0)  # closing it would not wake who waits for a visitor that never comes
    done = threading.Event()
    heard: list[bytes] = []

    def serve() -> None:
        try:
            talk, _ = server.accept()
        except OSError:
            return
        with talk:
            talk.settimeout(60.0)
            heard.append(talk.recv(65536))
            for part in parts:
                talk.sendall(part)
            if hold:
                done.wait(60.0)
            with suppress(OSError):
                while drip and not done.wait(0.05):
                    talk.sendall(b"x")

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.getsockname()[1]}/video"
    finally:
        done.set()
        server.close()
        thread.join()
        answering.heard = heard  # type: ignore[attr-defined]


PART = b"--x\r\nContent-Length: %d\r\n\r\n%b\r\n" % (len(JPEG), JPEG)
LONG = b"--x\r\nContent-Length: 100000\r\n\r\n"
HEAD = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=%s\r\n\r\n"


@pytest.mark.parametrize(("head", "part"), [
    (HEAD % b"x", b"--x\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%b\r\n"),
    (HEAD % b'"--x"', b"--x\r\ncontent-length:%d\r\n\r\n%b"),
    (HEAD % b"--x", b"--x\r\nContent-Length: %d\r\n\r\n%b\r\n"),
], ids=["usual", "quoted", "dashes"])  # fmt: skip
def test_dialects_of_network_cameras(head: bytes, part: bytes) -> None:
    with answering(head, *[part % (len(JPEG), JPEG)] * 3) as url:
        source = UrlSource(url)
        assert source.open().size == SIZE
        assert [arrived.jpeg for arrived in source.frames()] == [JPEG] * 3


def test_parts_without_a_length(tmp_path: Path) -> None:
    part = b"--x\r\nContent-Type: image/jpeg\r\n\r\n" + JPEG + b"\r\n"
    with answering(HEAD % b"x", part * 3 + b"--x--\r\n") as url:
        source = UrlSource(url)
        source.open()
        assert [arrived.jpeg for arrived in source.frames()][:2] == [JPEG] * 2


@pytest.mark.parametrize(("answer", "sentence"), [
    (b"HTTP/1.0 401 Unauthorized\r\n\r\n", r"401 Unauthorized.*NAME:PASSWORD"),
    (b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n<html>",
     "text/html, but fixel needs multi"),
    (b"SSH-2.0-OpenSSH_9.2\r\n", "a camera that answers"),
    (b"", "a camera that answers"),
    (HEAD % b"x", "the camera ended the stream"),
    (HEAD % b"x" + b"\x00\xff garbage" * 999, "the camera ended the stream"),
    (HEAD % b"x" + b"--x\r\nContent-Length: 3\r\n\r\nabc\r\n" * 20, "not JPEG pictures"),
    (HEAD % b"x" + b"--x\r\nContent-Length: 999\r\n\r\nabc", "the camera ended the stream"),
])  # fmt: skip
def test_what_is_no_camera_is_refused(answer: bytes, sentence: str) -> None:
    with answering(answer) as url, pytest.raises(InvalidInput, match=sentence):
        UrlSource(url).open()


def test_a_camera_that_falls_silent_says_so() -> None:
    with answering(HEAD % b"x", PART, hold=True) as url:
        source = UrlSource(url, patience=2.0)
        source.open()
        assert len(list(source.frames())) == 1
    assert source.ended == "the camera has sent nothing for 2 s"


@pytest.mark.parametrize(("parts", "way", "patience", "sentence"), [
    ((), "hold", 0.2, "no data within 0.2 s"),
    ((LONG,), "drip", 3.0, "no whole picture within 6 s"),
])  # fmt: skip
def test_a_camera_that_says_nothing_or_drips_is_refused(
    monkeypatch: pytest.MonkeyPatch, parts: tuple[bytes], way: str, patience: float, sentence: str
) -> None:
    monkeypatch.setattr("fixel.testbed.open_source.OPENS_WITHIN", 0.2)
    with (
        answering(HEAD % b"x", *parts, **{way: True}) as url,
        pytest.raises(InvalidInput, match=re.escape(sentence)),
    ):
        UrlSource(url, patience=patience).open()


def test_a_camera_that_drips_ends_the_recording(tmp_path: Path) -> None:
    with answering(HEAD % b"x", PART, LONG, drip=True) as url:
        began = time.monotonic()
        done = record(UrlSource(url), tmp_path / "r", patience=0.3)
    assert time.monotonic() - began < 60.0  # the picture would take over an hour
    assert (done.frames, done.reason) == (1, "the camera has sent nothing for 0.3 s")


def test_passwords_stay_out_of_records() -> None:
    with answering(HEAD % b"x", PART) as url:
        source = UrlSource(url.replace("//", "//me:se%20cret@") + "?token=t")
        source.open()
        source.close()
    assert source.name == url
    assert b"Authorization: Basic bWU6c2UgY3JldA==" in answering.heard[0]  # type: ignore[attr-defined]


@pytest.mark.parametrize("url", [
    "rtsp://cam/1", "http://", "ftp://cam/video", "http://cam:x/", "http://cam:99999/", "http://[",
])  # fmt: skip
def test_other_addresses_are_refused(url: str) -> None:
    refused(source_of, url, match="http://")


def test_a_camera_that_is_not_there_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    refused(UrlSource(f"http://127.0.0.1:{port}/").open, match="connection refused")


# --- cameras at this computer -----------------------------------------------------------------


class Webcam:
    """Answers as OpenCV does: JPEG data in one row of bytes, or pixels."""

    def __init__(
        self,
        n: int = 5,
        raw: bool = True,
        opens: bool = True,
        torn: Container[int] = (),
        missing: Container[int] = (),
    ) -> None:
        self.n, self.raw, self.opens, self.torn, self.missing = n, raw, opens, torn, missing
        self.k = -1
        self.settings: dict[int, float] = {}
        self.released = False

    def isOpened(self) -> bool:
        return self.opens

    def set(self, what: int, value: float) -> bool:
        self.settings[what] = value
        return True

    def get(self, what: int) -> float:
        return self.settings.get(what, 0.0)

    def grab(self) -> bool:
        self.k += 1
        return self.k < self.n and self.k not in self.missing

    def retrieve(self) -> tuple[bool, Any]:
        if self.raw and not self.settings[cv2.CAP_PROP_CONVERT_RGB]:
            data = JPEG[:999] if self.k in self.torn else JPEG
            return True, np.frombuffer(data + bytes(99), np.uint8)[None]
        return True, picture(0)

    def release(self) -> None:
        self.released = True


def test_a_webcam_hands_on_its_jpeg() -> None:
    webcam = Webcam()
    source = DeviceSource("0", size=SIZE, rate=30.0, capture=lambda device: webcam)
    assert source.open() == Stream(SIZE, 30.0, True, True)
    assert [arrived.jpeg for arrived in list(source.frames())] == [JPEG] * 5
    assert webcam.settings[cv2.CAP_PROP_FRAME_WIDTH] == SIZE[0]
    assert source.ended == "the camera sends no more pictures"
    assert webcam.released


@pytest.mark.parametrize("torn", [range(2), [2], [1, 3]])
@pytest.mark.parametrize("codec", ["as-it-comes", "near"])
def test_torn_pictures_of_a_webcam_are_left_out_and_counted(
    tmp_path: Path, torn: list[int], codec: str
) -> None:
    webcam = Webcam(torn=torn)
    source = DeviceSource("0", capture=lambda device: webcam)
    stream = source.open()
    done = Recorder(source=source, stream=stream, folder=tmp_path / "r", codec=codec).run()
    assert (done.frames, done.reason) == (5 - len(torn), "the camera sends no more pictures")
    kept = open_recording(tmp_path / "r")
    assert (kept.n_frames, kept.complete) == (done.frames, True)
    if 0 not in torn:  # a camera that wakes up may begin with half a picture
        times = f" ({len(torn)} times)" if len(torn) > 1 else ""
        assert f"a truncated picture, skipped{times}" in done.problems


def test_a_webcam_that_fails_now_and_then_goes_on() -> None:
    webcam = Webcam(missing=[1, 2])
    source = DeviceSource("0", capture=lambda device: webcam)
    source.open()
    assert len(list(source.frames())) == 3


def test_an_unread_webcam_is_released() -> None:
    webcam = Webcam(n=10**6)
    queue = FrameQueue(source := DeviceSource("0", capture=lambda device: webcam), live=True)
    source.open()
    queue.start()
    queue.get(1.0)
    queue.close()
    assert webcam.released


def test_a_webcam_without_jpeg_gives_pixels() -> None:
    source = DeviceSource("0", capture=lambda device: Webcam(raw=False))
    assert not source.open().jpeg
    assert all(np.array_equal(arrived.picture(), picture(0)) for arrived in source.frames())


def test_webcams_that_do_not_work_are_refused() -> None:
    with pytest.raises(InvalidInput, match="does not open"):
        DeviceSource("0", capture=lambda device: Webcam(opens=False)).open()
    webcam = Webcam(n=0)
    refused(DeviceSource("0", capture=lambda device: webcam).open, match="no pictures")
    assert webcam.released
    refused(source_of("/dev/video9").open, match=r"/dev/video9: found no such device")
    refused(source_of("7").open, match=r"/dev/video7: found no such device")


def test_files_that_are_no_film_are_refused(tmp_path: Path) -> None:
    refused(source_of(str(tmp_path / "nothing.mp4")).open, match="no such file")
    (tmp_path / "text.mkv").write_text("no film")
    refused(source_of(str(tmp_path / "text.mkv")).open, match="no video")
    refused(source_of(str(tmp_path)).open, match="a folder")


def test_another_size_than_the_rigs_is_refused() -> None:
    stream = Stream((640, 480), 30.0, True, True)
    with pytest.raises(InvalidInput, match="640 x 480 pixels, but fixel needs 1280 x 720"):
        check_size(stream, (1280, 720), "camera 0")


def test_jpeg_sizes() -> None:
    assert jpeg_size(JPEG) == SIZE
    assert jpeg_size(JPEG[:-2]) is None
    assert jpeg_size(b"\xff\xd8\xff") is None
    assert jpeg_size(b"") is None
    small = brightness(JPEG, 8)
    assert small.shape == (SIZE[1] // 8, SIZE[0] // 8)
    assert np.abs(small.astype(int) - shrunk(picture(0))).max() < 6


class Counting(FrameSource):
    """Camera whose pictures are numbered, at most `n` of them."""

    def __init__(self, n=10**9, live=False, pause=0.0):
        self.name, self.n, self.live, self.pause = "counting", n, live, pause
        self.closed = threading.Event()

    def open(self):
        return Stream((4, 3), 30.0, jpeg=False, live=self.live)

    def frames(self):
        for number in range(self.n):
            if self.closed.wait(self.pause):
                break
            yield CameraPicture(time.monotonic(), pixels=np.full((3, 4, 3), number % 251, np.uint8))
        self.ended = "unplugged"

    def close(self):
        self.closed.set()


def numbers(view, count):
    return [int(one.pixels[0, 0, 0]) for one in islice(view.frames(), count)]


def test_two_readers_lose_no_picture_of_a_camera_that_waits():
    camera = SharedCamera(Counting)
    first, second = camera.view(), camera.view()
    found = {}
    threads = [
        threading.Thread(target=lambda view=view: found.update({view: numbers(view, 200)}))
        for view in (first, second)
    ]
    [thread.start() for thread in threads]
    [thread.join(60.0) for thread in threads]
    for view in (first, second):
        assert found[view] == [(found[view][0] + k) % 251 for k in range(200)]
    assert found[first][0] == 0  # the camera waited for its first reader
    camera.close()


def test_a_reader_that_leaves_does_not_hold_up_the_others():
    camera = SharedCamera(Counting)
    lazy, keen = camera.view(), camera.view()
    threading.Timer(0.3, lazy.close).start()
    assert len(numbers(keen, 150)) == 150
    camera.close()


def test_a_slow_reader_of_a_live_camera_loses_pictures_alone():
    ahead = threading.Semaphore(0)  # a reader whose thread is late is not slow

    class Waiting(Counting):
        def frames(self):
            for arrived in super().frames():
                ahead.acquire()
                yield arrived

        def close(self):
            super().close()
            ahead.release()

    camera = SharedCamera(lambda: Waiting(live=True))
    lazy, keen = camera.view(), camera.view()
    ahead.release(HELD)
    for _ in islice(keen.frames(), 300):
        ahead.release()
    dropped = lazy.dropped
    assert dropped >= 300 - HELD - 1
    assert len(numbers(lazy, 30)) == 30
    assert keen.dropped == 0
    camera.close()
    queue = FrameQueue(lazy, live=True)
    assert queue.lost >= dropped  # a recording states them


def test_a_view_counts_the_torn_pictures_of_its_own_time():
    camera = SharedCamera(lambda: Counting(live=True, pause=0.01))
    camera.source.torn = 3
    view = camera.view()
    assert len(numbers(view, 5)) == 5
    assert view.torn == 0
    camera.source.torn = 5
    assert len(numbers(camera.view(), 3)) == 3
    await_true(lambda: view.torn == 2, "the torn pictures")
    camera.close()


def test_the_end_of_the_camera_ends_every_view_and_it_can_be_opened_again():
    camera = SharedCamera(lambda: Counting(n=5))
    view = camera.view()
    assert numbers(view, 100) == [0, 1, 2, 3, 4]
    assert view.ended == camera.reason == "unplugged"

    camera.restart()
    assert numbers(camera.view(), 100) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("live", [True, False])
def test_a_queue_of_frames_can_be_closed_and_begun_again(live):
    camera = SharedCamera(lambda: Counting(live=live, pause=0.001))
    for _ in range(3):
        queue = FrameQueue(camera.view(), live=live)
        queue.start()
        assert queue.get(60.0) is not None
        queue.close()
    camera.close()


@pytest.mark.parametrize(
    ("interval", "allowed"), [(0.01, 0.5), (1 / 30, 0.5), (0.2, 1.0), (0.5, 2.5), (2.0, 4.0)]
)
def test_the_silence_of_a_live_camera_is_judged_by_its_rate(monkeypatch, interval, allowed):
    """On a clock of the test: five pictures, at least 0.5 s and at most 4 s."""
    now, sent = [0.0], threading.Event()
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr("fixel.testbed.frame_source.time", clock)

    class Regular(Counting):
        def frames(self):
            for arrived, _ in zip(super().frames(), range(200), strict=False):
                now[0] += interval
                yield arrived
            sent.set()
            self.closed.wait(60.0)

    for live in (True, False):
        sent.clear()
        camera = SharedCamera(lambda live=live: Regular(live=live))
        if not live:  # it waits for a reader
            assert len(numbers(camera.view(), 199)) == 199
        assert sent.wait(60.0)
        assert camera.patience == pytest.approx(allowed if live else math.inf)
        now[0] += 0.95 * allowed
        assert not camera.lost
        now[0] += 0.1 * allowed
        assert ("has sent nothing for" in camera.lost) == live
        camera.close()
        assert camera.lost == "the camera was closed"
