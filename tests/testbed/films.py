"""Small films, cameras and fixels for the tests of recording."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fixel.formats.recording import RecordingHeader, RecordingWriter
from fixel.formats.recording_video import jpeg_of
from fixel.testbed.frame_source import CameraPicture, FrameSource, Stream
from fixel.testbed.recorder import Recorder, RecordingSummary
from fixel.vision.frame import Frame, Picture

SIZE = (160, 120)


def picture(k: int, size: tuple[int, int] = SIZE) -> Picture:
    """A bright block that moves to the right over a noisy plate."""
    grain = np.random.default_rng(k).integers(60, 66, (size[1], size[0], 3), dtype=np.uint8)
    grain[40:80, k % 100 : k % 100 + 40] += 150
    return grain


def film(
    folder: Path,
    n: int = 30,
    rate: float = 100.0,
    codec: str = "near",
    bits: Callable[[int], int] = lambda k: k % 8,
) -> Path:
    """A recording, whose readings count by default."""
    with RecordingWriter(folder, RecordingHeader(size=SIZE, codec=codec)) as writer:
        for k in range(n):
            writer.write(Frame(k / rate, picture(k)), bits(k), k / rate)
    return folder


def record(
    source: FrameSource, folder: Path, codec: str = "as-it-comes", **more: Any
) -> RecordingSummary:
    """Record what a source sends."""
    return Recorder(source=source, stream=source.open(), folder=folder, codec=codec, **more).run()


class Pictures(FrameSource):
    """Hands out pictures as fast as they are taken, or as a test wants."""

    name = "pictures"

    def __init__(
        self,
        n: int,
        make: Callable[[int], Picture | bytes] = lambda k: jpeg_of(picture(k)),
        rate: float = 100.0,
        live: bool = False,
        before: Callable[[int], None] = lambda k: None,
    ) -> None:
        self._n, self._make, self._rate, self._live, self._before = n, make, rate, live, before
        self.pulled = threading.Event()

    def open(self) -> Stream:
        return Stream(SIZE, self._rate, isinstance(self._make(0), bytes), self._live)

    def frames(self) -> Iterator[CameraPicture]:
        began = time.monotonic()
        for k in range(self._n):
            if self.pulled.is_set():
                break
            self._before(k)
            made = self._make(k)
            at = began + k / self._rate
            yield (
                CameraPicture(at, jpeg=made)
                if isinstance(made, bytes)
                else CameraPicture(at, pixels=made)
            )
        self.ended = "no more pictures"

    def close(self) -> None:
        self.pulled.set()


class Felt(NamedTuple):
    bits: int | None
    time: float
    problem: str = ""


class Fixels:
    """Answers what a test wants; None for no answer."""

    def __init__(self, answer: Callable[[int], int | None]) -> None:
        self.trouble = ""
        self._answer = answer
        self._k = 0

    def read(self) -> Felt:
        bits = self._answer(self._k)
        self._k += 1
        return Felt(bits, time.monotonic(), "" if bits is not None else "no answer")
