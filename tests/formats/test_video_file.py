"""Video files: exact times, and a reason for what cannot be read."""

import struct
import zlib
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from tests.fixtures import refused

from fixel.formats.video_file import VideoWriter, open_video, read_picture
from fixel.vision.frame import Frame

SIZE = (64, 48)


def picture(index):
    """A gradient with colours that change slowly from frame to frame."""
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    return np.stack([40 + 2 * x, 200 - 2 * y, 60 + x + y + index], axis=-1).astype(np.uint8)


def write(path, times, codec="h264"):
    with VideoWriter(path, SIZE, codec) as writer:
        for index, time in enumerate(times):
            writer.write(Frame(time, picture(index)))
    return path


@pytest.mark.parametrize(
    ("codec", "ending", "close"), [("h264", ".mp4", 12), ("ffv1", ".mkv", 0), ("mjpeg", ".mkv", 8)]
)
def test_frames_come_back_at_their_times(tmp_path, monkeypatch, codec, ending, close):
    times = np.arange(12) / 30.0
    monkeypatch.chdir(tmp_path)
    name = Path(f"film:1{ending}")  # what FFmpeg takes for a protocol
    video = open_video(write(name, times, codec))
    frames = list(video.frames())
    assert video.size == SIZE
    assert [f.time for f in frames] == pytest.approx(times, abs=1e-9 if ending == ".mp4" else 6e-4)
    for index, frame in enumerate(frames):
        assert np.abs(frame.picture.astype(int) - picture(index)).max() <= close
    assert video.remarks == []


def test_brightness_is_that_of_the_picture():
    frame = Frame(0.0, np.full((4, 6, 3), 77, np.uint8))
    assert frame.luma.tolist() == [[77] * 6] * 4
    assert frame.size == (6, 4)


def test_variable_rate_is_read_exactly_and_said(tmp_path):
    times = [0.0, 0.033, 0.066, 0.1, 0.4, 0.433, 0.466]
    video = open_video(write(tmp_path / "film.mp4", times))
    assert [f.time for f in video.frames()] == pytest.approx(times, abs=1e-9)
    assert "variable frame rate: 1 of 6" in video.remarks[0]
    video = open_video(write(tmp_path / "half.mp4", [0.0, 0.1, 0.3, 0.4, 0.6]))
    assert len(list(video.frames())) == 5
    assert "variable frame rate: 2 of 4 steps differ from the usual 100.00 ms" in video.remarks[0]


@pytest.mark.parametrize("codec", ["h264", "ffv1", "mjpeg"])
def test_truncated_matroska_is_read_to_its_last_whole_frame(tmp_path, codec):
    times = np.arange(60) / 30.0
    path = write(tmp_path / "film.mkv", times, codec)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.6 * len(whole))])
    video = open_video(path)
    frames = list(video.frames())
    assert 5 < len(frames) < 60
    assert np.abs(frames[-1].picture.astype(int) - picture(len(frames) - 1)).max() <= 12
    assert video.remarks[0].startswith("truncated: the file ends after frame")


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_ticks_without_a_picture_are_no_missing_frames(tmp_path, share):
    path = tmp_path / "film.avi"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=1000)
        stream.width, stream.height = SIZE
        stream.pix_fmt, stream.time_base = "yuvj420p", Fraction(1, 1000)
        for index in range(30):
            frame = av.VideoFrame.from_ndarray(picture(index), format="bgr24")
            frame.pts, frame.time_base = 33 * index, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    video = open_video(path)
    n = len(list(video.frames()))
    assert n == 30 if share == 1.0 else 5 < n < 30
    assert any(remark.startswith("truncated") for remark in video.remarks) == (share < 1.0)


def test_mp4_without_its_index_is_refused(tmp_path):
    path = write(tmp_path / "film.mp4", np.arange(30) / 30.0)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refused(open_video, path, match="no index")
    path.write_text("<html>404</html>")
    refused(open_video, path, match="no video")


@pytest.mark.parametrize(
    ("stamp", "found"), [(33, "the time of the previous frame"), (5, "decreasing")]
)
def test_time_that_does_not_grow_is_refused(tmp_path, stamp, found):
    path = write(tmp_path / "film.mkv", [0.0, 0.033, 0.066, 0.1], "ffv1")
    track = b"\x81"
    block = track + (66).to_bytes(2)
    assert path.read_bytes().count(block) == 1
    path.write_bytes(path.read_bytes().replace(block, track + stamp.to_bytes(2)))
    refused(list, open_video(path).frames(), match=found)


def test_raw_streams_have_no_times(tmp_path):
    path = tmp_path / "film.h264"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for index in range(5):
            frame = av.VideoFrame.from_ndarray(picture(index), format="bgr24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    refused(list, open_video(path).frames(), match="time stamp")


def test_what_is_no_video_is_refused(tmp_path):
    for name, content, reason in (
        ("text.mkv", b"not a film at all", "no video"),
        ("empty.mkv", b"", "an empty file"),
    ):
        (tmp_path / name).write_bytes(content)
        refused(open_video, tmp_path / name, match=reason)
    refused(open_video, tmp_path / "nothing.mkv", match="no such file")
    sound = tmp_path / "sound.wav"
    with av.open(str(sound), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
    refused(open_video, sound, match="no pictures")


def test_a_writer_that_fails_leaves_nothing(tmp_path):
    def fails():
        with VideoWriter(tmp_path / "film.mp4", SIZE) as writer:
            writer.write(Frame(0.0, picture(0)))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fails()
    refused(write, tmp_path / "film.mp4", [0.1, 0.1], match="in order of time")
    assert list(tmp_path.iterdir()) == []
    refused(VideoWriter, tmp_path / "film.mp4", (63, 48), match="even")
    refused(VideoWriter, tmp_path / "film.mp4", SIZE, "vp9", match="codec")


def test_small_files_of_giant_pictures_are_refused(tmp_path):
    """A PNG of 900 million pixels has 0.1 MB."""
    head = struct.pack(">IIBBBBB", 30_000, 30_000, 1, 0, 0, 0, 0)
    pixels = zlib.compress(bytes(30_000 * 3751), 9)
    path = tmp_path / "a.png"
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"".join(
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
            for kind, data in ((b"IHDR", head), (b"IDAT", pixels), (b"IEND", b""))
        )
    )
    refused(read_picture, path, match=r"found more than \d+ million pixels")
