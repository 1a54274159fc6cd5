"""A recording is readable up to wherever it broke off, or refused with the reason."""

import errno
import json
import subprocess
import sys

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.errors import InvalidInput
from fixel.formats import recording as recording_module
from fixel.formats.recording import (
    VIDEO,
    RecordingHeader,
    RecordingWriter,
    is_recording,
    open_recording,
    repair_recording,
)
from fixel.formats.recording_files import CODECS, END, HEADER, ROWS
from fixel.formats.recording_video import jpeg_of
from fixel.vision.frame import LUMA, Frame

SIZE = (64, 48)
STEP = 1.0 / 30.0
N = 12


def picture(k):
    """A picture that no other frame has."""
    grain = np.random.default_rng(k).integers(0, 30, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    grain[10:30, k : k + 20] += 150
    return grain


def write(folder, codec="near", n=N, end=True, seed=0):
    writer = RecordingWriter(folder, RecordingHeader(size=SIZE, codec=codec, rig="bench"))
    for k in range(n):
        time = 0.01 + k * STEP + (k % 3) * 1e-3
        reading = None if k == 2 else k % 8
        if codec == "as-it-comes":
            writer.write_jpeg(time, jpeg_of(picture(k + seed)), reading, time + 2e-3)
        else:
            writer.write(Frame(time, picture(k + seed)), reading, time + 2e-3)
    if end:
        writer.close()
    else:
        writer.abandon()
    return writer


@pytest.mark.parametrize("codec", CODECS)
def test_what_was_written_is_read(tmp_path, codec):
    write(tmp_path / "r", codec)
    recording = open_recording(tmp_path / "r")
    assert recording.complete
    assert recording.problems == ()
    assert recording.header.rig == "bench"
    assert recording.header.size == SIZE
    k = np.arange(N)
    np.testing.assert_allclose(recording.time, 0.01 + k * STEP + (k % 3) * 1e-3, atol=5e-7)
    assert recording.readings.tolist() == [-1 if i == 2 else i % 8 for i in k]
    np.testing.assert_allclose(recording.reading_time - recording.time, 2e-3, atol=1.1e-6)
    frames = list(recording.frames())
    assert [frame.time for frame in frames] == recording.time.tolist()
    worst = 0 if codec == "exact" else 40
    for i, frame in enumerate(frames):
        assert np.abs(frame.picture.astype(int) - picture(i)).max() <= worst


def test_pictures_that_come_as_jpeg_stay_as_they_are(tmp_path):
    write(tmp_path / "r", "as-it-comes")
    kept = [data for _, data in open_recording(tmp_path / "r").jpegs()]
    assert kept == [jpeg_of(picture(k)) for k in range(N)]


@pytest.mark.parametrize("codec", CODECS)
def test_wherever_either_file_is_cut_the_rest_is_read(tmp_path, codec):
    folder = tmp_path / "r"
    write(folder, codec, end=False)
    assert open_recording(folder).n_frames == N
    rows, video = (folder / ROWS).read_bytes(), (folder / VIDEO).read_bytes()
    lines = rows.splitlines(keepends=True)
    ends = [int(line.split(b",")[5]) for line in lines[1:]]
    rng = np.random.default_rng(1)
    for k in range(30):
        cut_video = int(rng.integers(ends[0], len(video) + 1))
        cut_rows = int(rng.integers(len(lines[0]) + len(lines[1]), len(rows) + 1))
        (folder / VIDEO).write_bytes(video if k < 10 else video[:cut_video])
        (folder / ROWS).write_bytes(rows[:cut_rows] if k % 2 else rows)
        held = sum(end <= (len(video) if k < 10 else cut_video) for end in ends)
        noted = rows[:cut_rows].count(b"\n") - 1 if k % 2 else N
        recording = open_recording(folder)
        assert recording.n_frames == min(held, noted)
        assert "interrupted at t = " in recording.problems[0]
        assert len(list(recording.frames())) == recording.n_frames


def test_repair_cuts_both_files_to_what_belongs_together(tmp_path):
    folder = tmp_path / "r"
    write(folder, end=False)
    video = folder / VIDEO
    video.write_bytes(video.read_bytes()[:-100])
    before = open_recording(folder)
    assert not before.complete
    after = repair_recording(folder)
    assert after.complete
    assert after.n_frames == before.n_frames == N - 1
    assert after.end.reason.startswith("interrupted at t = ")
    assert (folder / ROWS).read_bytes().count(b"\n") == N
    assert repair_recording(folder).problems == after.problems


def test_repair_reads_the_video_once_before_and_once_after(tmp_path, monkeypatch):
    write(tmp_path / "r", end=False)
    packets, read = recording_module.packets, []

    def counted(video):
        read.append(video)
        return packets(video)

    monkeypatch.setattr(recording_module, "packets", counted)
    assert repair_recording(tmp_path / "r").complete
    assert len(read) == 2


def test_repair_says_everything_once(tmp_path):
    folder = tmp_path / "r"
    with RecordingWriter(folder, RecordingHeader(size=SIZE)) as writer:
        for k in range(N):
            writer.write(Frame(k / 10, picture(k)))
        writer.close("a key", 3, ("it rained",))
    (folder / VIDEO).write_bytes((folder / VIDEO).read_bytes()[:-100])
    found = open_recording(folder).problems
    assert repair_recording(folder).problems == found
    assert len(set(found)) == len(found) == 4


def test_a_recording_that_lost_its_end_later_says_so(tmp_path):
    folder = tmp_path / "r"
    write(folder)
    video = folder / VIDEO
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    recording = open_recording(folder)
    assert not recording.complete
    assert f"{recording.n_frames} of {N} frames are left" in recording.problems[0]


def swap_video(folder):
    write(folder.with_name("other"), seed=50)
    (folder / VIDEO).write_bytes((folder.with_name("other") / VIDEO).read_bytes())


def spoil_picture(folder):
    data = bytearray((folder / VIDEO).read_bytes())
    data[len(data) // 2] ^= 0xFF
    (folder / VIDEO).write_bytes(data)


def edit_rows(change):
    def edit(folder):
        lines = (folder / ROWS).read_bytes().splitlines(keepends=True)
        (folder / ROWS).write_bytes(b"".join(change(lines)))

    return edit


def edit_json(name, **values):
    def edit(folder):
        content = json.loads((folder / name).read_text())
        (folder / name).write_text(json.dumps(content | values))

    return edit


@pytest.mark.parametrize(("spoil", "sentence"), [
    (swap_video, "does not match its row"),
    (spoil_picture, "does not match its row"),
    (edit_rows(lambda x: [*x[:4], *x[5:]]), "frame 4, but fixel needs frame 3"),
    (edit_rows(lambda x: [*x[:4], x[4].replace(b",3,", b",5,"), *x[5:]]), "damaged row"),
    (edit_rows(lambda x: [*x[:4], x[5], x[4], *x[6:]]), "fixel needs frame 3"),
    (edit_rows(lambda x: x[1:]), "an unexpected first line"),
    (edit_rows(lambda x: x[:1]), "before its first frame"),
    (lambda folder: (folder / VIDEO).write_bytes(b""), "before its first frame"),
    (lambda folder: (folder / VIDEO).write_bytes(b"no video" * 99), "before its first frame"),
    (lambda folder: (folder / VIDEO).unlink(), "no such file"),
    (lambda folder: (folder / ROWS).unlink(), "no such file"),
    (lambda folder: (folder / HEADER).unlink(), "no recording.json"),
    (lambda folder: (folder / HEADER).write_text("{"), "fixel needs a JSON file"),
    (edit_json(HEADER, version=9), "version 9"),
    (edit_json(HEADER, codec="h266"), "recording.codec"),
    (edit_json(HEADER, size=None), "fixel needs a header"),
    (edit_json(END, frames=3), "12 rows"),
])  # fmt: skip
def test_what_does_not_fit_is_refused(tmp_path, spoil, sentence):
    folder = tmp_path / "r"
    write(folder)
    spoil(folder)
    refused(open_recording, folder, match=sentence)


def test_writing_refuses_what_cannot_be(tmp_path):
    folder = tmp_path / "r"
    with RecordingWriter(folder, RecordingHeader(size=SIZE)) as writer:
        writer.write(Frame(0.0, picture(0)), 7)
        refused(writer.write, Frame(0.1, np.zeros((4, 4, 3), np.uint8)), match="picture of shape")
        refused(writer.write, Frame(0.0, picture(1)), match="increasing times")
        refused(writer.write, Frame(float("nan"), picture(1)), match="increasing times")
        refused(writer.write, Frame(0.1, picture(1)), 256, match="a byte")
        refused(writer.write_jpeg, 0.1, b"", match="found no bytes")
    assert open_recording(folder).n_frames == 1
    assert is_recording(folder)
    refused(RecordingWriter, folder, RecordingHeader(size=SIZE), match="found a recording")
    refused(RecordingWriter, tmp_path, RecordingHeader(size=SIZE), match="a new folder")
    (tmp_path / "file").touch()
    with pytest.raises(InvalidInput, match="not a directory"):
        RecordingWriter(tmp_path / "file" / "r", RecordingHeader(size=SIZE))
    refused(RecordingHeader, size=SIZE, codec="h266", match=r"recording\.codec")
    refused(RecordingHeader, size=(20_000, 20_000), match="at most 89 megapixels")


def test_a_picture_the_camera_sent_spoilt_is_named(tmp_path):
    good = jpeg_of(picture(0))
    with RecordingWriter(tmp_path / "r", RecordingHeader(size=SIZE, codec="as-it-comes")) as writer:
        writer.write_jpeg(0.0, good)
        writer.write_jpeg(0.1, good[:200] + good[-2:])
        writer.write_jpeg(0.2, jpeg_of(picture(0)[:8]))
    frames = open_recording(tmp_path / "r").frames()
    assert next(frames).luma.shape == (SIZE[1], SIZE[0])
    spoilt = next(frames)
    with pytest.raises(InvalidInput, match=r"video\.nut, frame 1: found damaged JPEG data"):
        _ = spoilt.picture
    refused(next, frames, match=r"video\.nut, frame 2: found no picture")


def test_brightness_is_that_of_the_colours(tmp_path):
    write(tmp_path / "r", n=1)
    (frame,) = open_recording(tmp_path / "r").frames()
    # Colours end at 0, brightness comes from before that.
    assert np.abs(frame.luma - frame.picture @ LUMA).mean() < 0.5


def test_a_disk_without_room_for_the_beginning_is_refused(tmp_path, monkeypatch):
    def full(**_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("fixel.formats.recording.TemporaryFile", full)
    with pytest.raises(InvalidInput, match="no space left on device"):
        RecordingWriter(tmp_path / "r", RecordingHeader(size=SIZE))


def test_nothing_hidden_stays_after_a_kill(tmp_path):
    begin = """if True:
        import os, sys
        from fixel.formats.recording import RecordingHeader, RecordingWriter
        RecordingWriter(sys.argv[1], RecordingHeader(size=(64, 48)))
        os.kill(os.getpid(), 9)
    """
    subprocess.run([sys.executable, "-c", begin, str(tmp_path / "r")], check=False)
    assert {path.name for path in (tmp_path / "r").iterdir()} <= {HEADER, ROWS, VIDEO}


def test_an_error_while_writing_leaves_no_mark_of_a_good_end(tmp_path):
    def fail():
        with RecordingWriter(tmp_path / "r", RecordingHeader(size=SIZE)) as writer:
            writer.write(Frame(0.0, picture(0)))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert open_recording(tmp_path / "r").end is None
