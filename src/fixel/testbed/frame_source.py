"""Common interface of frame sources: cameras, network cameras and files."""

from __future__ import annotations

import abc
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple, final

from fixel.formats.jpeg import REDUCED, brightness, decoded, jpeg_size, shrunk
from fixel.vision.frame import Gray, Picture

STALLED: Final = 3.0  # [s] without data after which a camera counts as unplugged


class Stream(NamedTuple):
    """Properties of an open source."""

    size: tuple[int, int]  # width and height [px]
    rate: float  # nominal frame rate [frames/s], 0 where unknown
    jpeg: bool  # whether pictures are JPEG data
    live: bool  # whether the source does not wait for its reader; one that waits loses no picture
    simulated_by: str = ""  # program that rendered the pictures; empty for a camera


@final
@dataclass(slots=True)
class CameraPicture:
    """Picture as it arrived."""

    time: float  # time of arrival, on `time.monotonic` [s]
    jpeg: bytes | None = None  # JPEG data as they arrived
    pixels: Picture | None = None  # pixels, in the order blue, green, red, where it arrived as such
    # Time of capture on the same clock [s], where the camera reports it.
    captured: float | None = None

    @property
    def taken(self) -> float:
        """Time of capture, or of arrival where the camera does not report it [s]."""
        return self.time if self.captured is None else self.captured

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height [px]; None for an incomplete picture."""
        if self.jpeg is not None:
            return jpeg_size(self.jpeg)
        if self.pixels is None or self.pixels.ndim != 3:
            return None
        return self.pixels.shape[1], self.pixels.shape[0]

    def picture(self) -> Picture:
        """Return the pixels (height, width, 3) uint8, decoded at the first call.

        Raises
        ------
        InvalidInput
            A JPEG that cannot be decoded.
        """
        if self.pixels is None:
            self.pixels = decoded(self.jpeg or b"")
        return self.pixels

    def small(self) -> Gray:
        """Return the brightness (height / 8, width / 8) uint8, without full decoding of a JPEG."""
        if self.jpeg is None:
            return shrunk(self.picture())
        return brightness(self.jpeg, REDUCED)


class FrameSource(abc.ABC):
    """Abstract camera, or a substitute for one."""

    name: str  # name for messages and records, without passwords
    ended: str = ""  # reason why the pictures ended; empty before
    complete: bool = False  # whether a file was read to its end, without damage
    torn: int = 0  # number of incomplete pictures, which are skipped

    @abc.abstractmethod
    def open(self) -> Stream:
        """Open the source and read the first picture.

        Raises
        ------
        InvalidInput
            No such source, no permission, or no pictures.
        """

    @abc.abstractmethod
    def frames(self) -> Iterator[CameraPicture]:
        """Yield every whole picture once, the first included; then set `ended`."""

    @abc.abstractmethod
    def close(self) -> None:
        """Close the source, which ends `frames`; may be called from another thread."""

    def __enter__(self) -> FrameSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
