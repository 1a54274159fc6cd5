"""Video of a recording: a NUT file, appended packet by packet, of JPEG pictures.

NUT needs no index and no trailer, so an interrupted file can be read. It stores the packets
unchanged, with times to the microsecond, so that each can be identified by its checksum.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.errors import InvalidInput, require
from fixel.formats.recording_files import MICRO
from fixel.vision.frame import Frame, Gray, Picture

if TYPE_CHECKING:
    import av

BEGIN: Final = b"\xff\xd8"
END: Final = b"\xff\xd9"
# Markers of segments with the picture's size; the others of this range are tables.
_SIZES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
QUALITY: Final = 95  # with colours at full resolution
REDUCED: Final = 8


def jpeg_of(picture: Picture) -> bytes:
    """Encode a picture as JPEG of high quality, with colours at full resolution."""
    from PIL import Image

    height, width = picture.shape[:2]
    whole = np.ascontiguousarray(picture)
    file = io.BytesIO()
    image = Image.frombuffer("RGB", (width, height), whole, "raw", "BGR", 0, 1)
    image.save(file, "JPEG", quality=QUALITY, subsampling=0)
    return file.getvalue()


def jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height [px] of a JPEG picture; None if it is truncated or no JPEG."""
    if not data.startswith(BEGIN) or data.rfind(END) < 0:
        return None
    place = 2
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker in _SIZES:
            height = int.from_bytes(data[place + 5 : place + 7])
            return int.from_bytes(data[place + 7 : place + 9]), height
        place += 2 + int.from_bytes(data[place + 2 : place + 4])
    return None


def decoded(data: bytes, where: str = "picture") -> Picture:
    """Decode a JPEG picture: (height, width, 3) uint8, blue, green, red."""
    from PIL import Image

    try:
        image = Image.open(io.BytesIO(data), formats=["JPEG"]).convert("RGB")
        pixels = np.frombuffer(image.tobytes("raw", "BGR"), np.uint8)
    except (OSError, SyntaxError, ValueError):
        raise _spoilt(where) from None
    return pixels.reshape(image.height, image.width, 3)


def brightness(data: bytes, reduced: int = 1, where: str = "picture") -> Gray:
    """Decode only the brightness of a JPEG picture, (height / reduced, width / reduced) uint8.

    `reduced` is 1, 2, 4 or 8; `where` names the picture in errors.
    """
    from PIL import Image

    try:
        image = Image.open(io.BytesIO(data), formats=["JPEG"])
        image.draft("L", (image.width // reduced, image.height // reduced))
        return np.asarray(image.convert("L"), dtype=np.uint8)
    except (OSError, SyntaxError, ValueError):
        raise _spoilt(where) from None


def shrunk(picture: Picture) -> Gray:
    """Brightness (height / 8, width / 8) uint8 of a picture: means of green over 8 x 8 pixels."""
    height, width = (side // REDUCED for side in picture.shape[:2])
    green = picture[: height * REDUCED, : width * REDUCED, 1]
    cells = green.reshape(height, REDUCED, width, REDUCED)
    return np.asarray(cells.mean(axis=(1, 3)), dtype=np.uint8)


def jpeg_frame(time: float, data: bytes, size: tuple[int, int], where: str = "picture") -> Frame:
    """Frame of a JPEG picture of (width, height) [px], decoded on access; `where` names it."""
    return Frame(
        time,
        size=size,
        colours=lambda: _fast(data, decoded, "IMREAD_COLOR", where),
        luma=lambda: _fast(data, brightness, "IMREAD_GRAYSCALE", where),
    )


def _fast(data: bytes, slow: Callable[..., Picture], mode: str, where: str) -> Picture:
    """Decode with OpenCV, which takes half the time for the same pixels, else with Pillow."""
    try:
        import cv2
    except ImportError:
        return slow(data, where=where)
    if data.rfind(END) < 0:  # OpenCV would return the rest of a truncated picture as grey
        raise _spoilt(where, " (truncated)")
    try:
        whole = cv2.imdecode(
            np.frombuffer(data, np.uint8), getattr(cv2, mode) | cv2.IMREAD_IGNORE_ORIENTATION
        )
    except cv2.error:
        raise _spoilt(where) from None
    if whole is None:
        raise _spoilt(where)
    return np.asarray(whole, dtype=np.uint8)


def _spoilt(where: str, more: str = "") -> InvalidInput:
    return InvalidInput(where, found=f"damaged JPEG data{more}", expected="JPEG")


MICROSECOND: Final = Fraction(1, MICRO)
LOSSLESS: Final = "magicyuv"


# Packet of a picture in the video: its size [bytes], the CRC-32 of its content, and the size of the
# video file after it was appended [bytes].
StoredPacket = tuple[int, int, int]


class VideoSink:
    """Writer of pictures of (width, height) [px] to a new video, without buffering in the process.

    It encodes without loss if `exact`, else as JPEG.
    """

    def __init__(self, path: Path, size: tuple[int, int], *, exact: bool) -> None:
        require("av", "a recording", extra="video")
        import av

        self.path = path
        self._size = size
        self._lost = False
        durable = {"flush_packets": "1", "write_index": "0"}
        self._container = av.open(str(path.absolute()), "w", format="nut", options=durable)
        width, height = size
        if exact:
            encoded = self._container.add_stream(LOSSLESS, rate=30, options={"pred": "left"})
            encoded.width, encoded.height, encoded.pix_fmt = width, height, "gbrp"
            encoded.codec_context.thread_count = 1
            encoded.codec_context.time_base = MICROSECOND
            self._encoded: av.VideoStream | None = encoded
            self._stream: av.stream.Stream = encoded
        else:
            self._encoded = None
            self._stream = self._container.add_mux_stream(
                "mjpeg", rate=30, width=width, height=height
            )
        self._stream.time_base = MICROSECOND

    def append_picture(self, time_us: int, picture: Picture) -> StoredPacket:
        """Encode a picture with the codec of this video and append it."""
        import av

        if self._encoded is None:
            return self.append_jpeg(time_us, jpeg_of(picture))
        frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
        frame.pts, frame.time_base = time_us, MICROSECOND
        (packet,) = self._encoded.encode(frame)
        return self._append(packet)

    def append_jpeg(self, time_us: int, jpeg: bytes) -> StoredPacket:
        """Append a JPEG picture unchanged."""
        import av

        packet = av.Packet(jpeg)
        packet.stream = self._stream
        packet.pts = packet.dts = time_us
        packet.time_base = MICROSECOND
        packet.is_keyframe = True
        return self._append(packet)

    def _append(self, packet: av.Packet[Any]) -> StoredPacket:
        size, crc = packet.size, zlib.crc32(packet)
        try:
            self._container.mux(packet)
        except OSError:
            self._lost = True
            raise
        return size, crc, self.path.stat().st_size

    def close(self) -> None:
        """Close the file; all pictures have already been written."""
        try:
            self._container.close()
        except OSError:
            if not self._lost:
                raise


def warm_up() -> None:
    """Import the encoders in advance, so that the first frame of a camera is not delayed."""
    require("av", "a recording", extra="video")
    import av
    from PIL import Image

    av.Codec(LOSSLESS, "w")
    Image.preinit()


def packets(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield time [µs] and data of all packets of a video; the last may be torn."""
    require("av", "a recording", extra="video")
    import av

    try:
        with av.open(str(path.absolute()), metadata_errors="replace") as container:
            for packet in container.demux(container.streams.video[0]):
                if packet.size and packet.pts is not None:
                    yield packet.pts, bytes(packet)
    except (FileNotFoundError, PermissionError) as problem:
        raise InvalidInput(str(path), found=problem, expected="the video of a recording") from None
    except (av.error.FFmpegError, IndexError):
        return  # the end is torn: all intact packets have been yielded


def stored_frame(
    time: float,
    data: bytes,
    size: tuple[int, int],
    codec: av.VideoCodecContext | None,
    where: str,
) -> Frame | None:
    """Decode a packet of a video that `VideoSink` has written, by a `lossless` codec or as JPEG.

    None if it contains no picture of (width, height) [px].
    """
    if codec is None:
        return jpeg_frame(time, data, size, where) if jpeg_size(data) == size else None
    import av

    from fixel.formats.video_file import decoded_frame

    try:
        (decoded,) = codec.decode(av.Packet(data))
    except (av.error.FFmpegError, ValueError):
        return None
    return decoded_frame(time, decoded)


def lossless(size: tuple[int, int]) -> av.VideoCodecContext:
    """Return the decoder of lossless pictures of (width, height) [px]."""
    import av

    codec = av.CodecContext.create(LOSSLESS, "r")
    assert isinstance(codec, av.VideoCodecContext)
    codec.width, codec.height = size
    codec.thread_count = 1
    return codec
