"""Video of a recording: a NUT file, appended packet by packet.

NUT needs no index and no trailer, so an interrupted file can be read. It stores the packets
unchanged, with times to the microsecond, so that each can be identified by its checksum.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

from fixel.errors import InvalidInput
from fixel.formats.jpeg import jpeg_frame, jpeg_of, jpeg_size
from fixel.formats.recording_files import MICRO
from fixel.vision.frame import Frame, Picture

if TYPE_CHECKING:
    import av

MICROSECOND: Final = Fraction(1, MICRO)
LOSSLESS: Final = "magicyuv"


class StoredPacket(NamedTuple):
    """Packet of a picture in the video: size, checksum and place."""

    size: int  # size of its packet [bytes]
    crc: int  # CRC-32 of its packet
    end: int  # size of the video file after it was appended [bytes]


@final
class VideoSink:
    """Writer of pictures to a new video, without buffering in the process.

    Parameters
    ----------
    path : Path
    size : (int, int)
        Width and height [px].
    exact : bool
        Whether to encode without loss instead of as JPEG.
    """

    def __init__(self, path: Path, size: tuple[int, int], *, exact: bool) -> None:
        import av

        self.path = path
        self._size = size
        self._lost = False
        self._container = av.open(
            str(path), "w", format="nut", options={"flush_packets": "1", "write_index": "0"}
        )
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
        return StoredPacket(size, crc, self.path.stat().st_size)

    def close(self) -> None:
        """Close the file; all pictures have already been written."""
        try:
            self._container.close()
        except OSError:
            if not self._lost:
                raise


def warm_up() -> None:
    """Import the encoders in advance, so that the first frame of a camera is not delayed."""
    import av
    from PIL import Image

    av.Codec(LOSSLESS, "w")
    Image.preinit()


def packets(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield time [µs] and data of all packets of a video; the last may be torn."""
    import av

    try:
        with av.open(str(path)) as container:
            for packet in container.demux(container.streams.video[0]):
                if packet.size and packet.pts is not None:
                    yield packet.pts, bytes(packet)
    except (FileNotFoundError, PermissionError) as problem:
        raise InvalidInput(
            str(path), found=str(problem.strerror).lower(), expected="the video of a recording"
        ) from None
    except (av.error.FFmpegError, IndexError):
        return  # the end is torn: all intact packets have been yielded


@final
class PictureDecoder:
    """Decoder of the packets of a video into frames.

    Parameters
    ----------
    size : (int, int)
        Width and height [px].
    exact : bool
        Whether the video was written without loss.
    """

    def __init__(self, size: tuple[int, int], *, exact: bool) -> None:
        self._size = size
        self._codec = _lossless(size) if exact else None

    def frame(self, time: float, data: bytes, where: str) -> Frame | None:
        """Decode a packet; None if it contains no picture of the expected size."""
        if self._codec is None:
            fits = jpeg_size(data) == self._size
            return jpeg_frame(time, data, self._size, where) if fits else None
        import av

        from fixel.formats.video_file import decoded_frame

        try:
            (decoded,) = self._codec.decode(av.Packet(data))
        except (av.error.FFmpegError, ValueError):
            return None
        return decoded_frame(time, decoded)


def _lossless(size: tuple[int, int]) -> av.VideoCodecContext:
    import av

    codec = av.CodecContext.create(LOSSLESS, "r")
    assert isinstance(codec, av.VideoCodecContext)
    codec.width, codec.height = size
    codec.thread_count = 1
    return codec
