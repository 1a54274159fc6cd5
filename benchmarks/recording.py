"""What recording costs: processor time a frame of 1280 x 720 pixels, by codec, there and back."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.figures import FULL, Figure, Size, at_most
from fixel.formats.recording import RecordingHeader, RecordingWriter, open_recording
from fixel.formats.recording_video import jpeg_of
from fixel.vision.frame import Frame, Picture

PIXELS = (1280, 720)
RATE = 30.0
BUDGET = 1e3 / RATE  # [ms] a frame has at 30 frames a second


def plate(k: int, size: tuple[int, int] = PIXELS) -> Picture:
    """A plate with holes, noise of two steps of brightness, and a part that moves."""
    width, height = size
    y, x = np.mgrid[:height, :width]
    gray = np.where(((x % 46) - 23) ** 2 + ((y % 46) - 23) ** 2 < 40, 60, 160)
    gray[height // 3 : height // 2, width // 4 + k : width // 2 + k] = 40
    noise = np.random.default_rng(k).normal(0.0, 2.0, (height, width, 3))
    return np.clip(gray[..., None] + noise, 0, 255).astype(np.uint8)


def run(size: Size) -> list[Figure]:
    """Milliseconds of processor time a frame, and megabytes a second at 30 frames a second."""
    pictures = [plate(k) for k in range(30 if size is FULL else 2)]
    return [
        figure
        for codec in ("as-it-comes", "near", "exact")
        for figure in _figures(codec, pictures, size.repeats)
    ]


def _figures(codec: str, pictures: list[Picture], repeats: int) -> list[Figure]:
    jpegs = [jpeg_of(picture) for picture in pictures] if codec == "as-it-comes" else []
    written, checked, read, luma = [], [], [], []
    with tempfile.TemporaryDirectory() as place:
        for k in range(repeats):
            folder = Path(place) / f"{k}"
            start = time.process_time()
            with RecordingWriter(folder, RecordingHeader(size=PIXELS, codec=codec)) as writer:
                for n, picture in enumerate(pictures):
                    if jpegs:
                        writer.write_jpeg(n / RATE, jpegs[n], n % 8, n / RATE)
                    else:
                        writer.write(Frame(n / RATE, picture), n % 8, n / RATE)
            written.append(time.process_time() - start)
            start = time.process_time()
            recording = open_recording(folder)
            checked.append(time.process_time() - start)
            start = time.process_time()
            worst = max(
                int(np.abs(frame.picture.astype(np.int16) - picture).max())
                for frame, picture in zip(recording.frames(), pictures, strict=True)
            )
            read.append(time.process_time() - start)
            start = time.process_time()
            for frame in recording.frames():
                assert frame.luma.shape == PIXELS[::-1]
            luma.append(time.process_time() - start)
        room = writer.bytes / len(pictures) * RATE / 1e6
    each = 1e3 / len(pictures)
    return [
        Figure(f"{codec}, write", "ms", _times(each, written), at_most(BUDGET)),
        Figure(f"{codec}, check", "ms", _times(each, checked)),
        Figure(f"{codec}, read colours and compare", "ms", _times(each, read)),
        Figure(f"{codec}, read brightness", "ms", _times(each, luma)),
        Figure(f"{codec}, on the disk", "MB/s", (room,)),
        Figure(f"{codec}, worst pixel", "-", (float(worst),)),
    ]


def _times(factor: float, values: list[float]) -> tuple[float, ...]:
    return tuple(factor * value for value in values)
