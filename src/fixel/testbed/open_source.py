"""Frame source from an argument of a command."""

from __future__ import annotations

from fixel.errors import InvalidInput
from fixel.testbed.device_source import DeviceSource
from fixel.testbed.file_source import FileSource
from fixel.testbed.frame_source import FrameSource, Stream
from fixel.testbed.url_source import UrlSource


def source_of(
    text: str,
    *,
    size: tuple[int, int] | None = None,
    rate: float = 30.0,
    as_fast_as_possible: bool = False,
) -> FrameSource:
    """Choose the frame source for a camera, an address, a file or a recording.

    Parameters
    ----------
    text : str
        `0` or `/dev/video0` for a camera, `http://...` for a network camera, else a video file or
        the folder of a recording.
    size : (int, int), optional
        Size requested from a camera [px].
    rate : float
        Frame rate requested from a camera [frames/s].
    as_fast_as_possible : bool
        Whether a file is played faster than it was recorded; frames then have the file's times.
    """
    if text.isdecimal() or text.startswith("/dev/"):
        return DeviceSource(text, size=size, rate=rate)
    if "://" in text:
        return UrlSource(text)
    return FileSource(text, as_fast_as_possible=as_fast_as_possible)


def check_size(stream: Stream, size: tuple[int, int], name: str) -> None:
    """Raise for pictures of another size than the rig's, before recording starts."""
    if stream.size != size:
        raise InvalidInput(
            name,
            found="pictures of {} x {} pixels".format(*stream.size),
            expected="{} x {}, as the rig was calibrated".format(*size),
            hint="set the camera to that size, or calibrate it at this one",
        )
