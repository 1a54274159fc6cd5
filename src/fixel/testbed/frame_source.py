"""Where pictures come from: cameras, network cameras, files, behind one interface."""

from __future__ import annotations

import abc
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple, final

from fixel.formats.jpeg import REDUCED, brightness, decoded, jpeg_size, shrunk
from fixel.vision.frame import Gray, Picture

STALLED: Final = 3.0  # [s] a camera that sends nothing for so long was unplugged


class Stream(NamedTuple):
    """What a source says of itself once it is open.

    Attributes
    ----------
    size : (int, int)
        Width and height [px].
    rate : float
        Frames a second it promises, 0 for unknown.
    jpeg : bool
        Whether pictures come as JPEG.
    live : bool
        Whether they come when they come; a source that waits for its reader loses none.
    simulated_by : str
        What made the pictures, where no camera did.
    """

    size: tuple[int, int]
    rate: float
    jpeg: bool
    live: bool
    simulated_by: str = ""


@final
@dataclass(slots=True)
class CameraPicture:
    """A picture as it arrived.

    Parameters
    ----------
    time : float
        Of its arrival, on `time.monotonic` [s].
    jpeg : bytes, optional
        As it came.
    pixels : (height, width, 3) uint8, optional
        Where it came as pixels: blue, green, red.
    captured : float, optional
        When it was taken, on the same clock, where the camera says so [s].
    """

    time: float
    jpeg: bytes | None = None
    pixels: Picture | None = None
    captured: float | None = None

    @property
    def taken(self) -> float:
        """Time of capture, or of arrival where the camera does not say it [s]."""
        return self.time if self.captured is None else self.captured

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height [px]; None where it is no whole picture."""
        if self.jpeg is not None:
            return jpeg_size(self.jpeg)
        if self.pixels is None or self.pixels.ndim != 3:
            return None
        return self.pixels.shape[1], self.pixels.shape[0]

    def picture(self) -> Picture:
        """(height, width, 3) uint8; decoded when first asked for.

        Raises
        ------
        InvalidInput
            A JPEG that cannot be decoded.
        """
        if self.pixels is None:
            self.pixels = decoded(self.jpeg or b"")
        return self.pixels

    def small(self) -> Gray:
        """(height / 8, width / 8) uint8 of brightness; cheap."""
        if self.jpeg is None:
            return shrunk(self.picture())
        return brightness(self.jpeg, REDUCED)


class FrameSource(abc.ABC):
    """A camera, or something that stands in for one.

    Attributes
    ----------
    name : str
        For people, and for the record: without passwords.
    ended : str
        Why the pictures ended, once they have.
    complete : bool
        Whether they ended where they should: a file at its end.
    torn : int
        How many came that were no whole pictures, and were left out.
    """

    name: str
    ended: str = ""
    complete: bool = False
    torn: int = 0

    @abc.abstractmethod
    def open(self) -> Stream:
        """Get ready, and look at the first picture.

        Raises
        ------
        InvalidInput
            Nothing there, no permission, no pictures.
        """

    @abc.abstractmethod
    def frames(self) -> Iterator[CameraPicture]:
        """Every whole picture once, the first included; then says why there are no more."""

    @abc.abstractmethod
    def close(self) -> None:
        """Let go of it; from another thread too, which ends `frames`."""

    def __enter__(self) -> FrameSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
