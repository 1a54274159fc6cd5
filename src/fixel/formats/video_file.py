"""Videos in files, written and read; and pictures from photographs, folders of them, and videos."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput, check_name, require
from fixel.io.atomic import refuse_device, refuse_ending, refuse_unwritable, unfinished_path, usable
from fixel.typing import FloatArray
from fixel.vision.frame import Frame, Gray, Picture, opencv

# Time steps may differ by this share of the usual one and still be one rate: containers round.
SAME_RATE: Final = 0.1
# Matroska stores milliseconds; a step with both ends rounded differs by up to this much.
ROUNDING: Final = 2e-3  # [s]
MAX_FRAMES_A_SECOND: Final = 10_000.0

# Encoder, pixel format and options of each available codec. `h264` is visually lossless and
# decodes fast; `ffv1` is lossless and stores pixels without colour conversion; `mjpeg` encodes
# every frame independently.
CODECS: Final[dict[str, tuple[str, str, dict[str, str]]]] = {
    "h264": ("libx264", "yuv420p", {"crf": "16", "preset": "veryfast", "tune": "fastdecode"}),
    "ffv1": ("ffv1", "bgr0", {"level": "3", "slicecrc": "1"}),
    "mjpeg": ("mjpeg", "yuvj420p", {"qmin": "2", "qmax": "3"}),
}
ENDINGS: Final = (".mp4", ".mkv", ".mov", ".avi")
# Ticks per second of written files; a frame lasts a whole number of them at 24, 25, 30 and 60
# frames per second. Matroska stores milliseconds whatever is requested.
TICKS: Final = 90_000


# Decoded formats whose first plane is brightness.
BRIGHT_FIRST: Final = frozenset(
    ("yuv420p", "yuvj420p", "yuv422p", "yuvj422p", "yuv444p", "yuvj444p", "gray", "nv12")
)


@dataclass(slots=True, kw_only=True)
class VideoFile:
    """Video file that can be read frame by frame."""

    path: Path
    size: tuple[int, int]  # width and height [px]
    # Number of frames according to the container, if known; a damaged file may have fewer.
    n_frames: int | None
    duration: float | None
    codec: str
    note: str = ""  # comment in the metadata of the file
    threads: int = 0
    # Defects found on reading; complete once all frames were read.
    remarks: list[str] = field(default_factory=list)

    def frames(self) -> Iterator[Frame]:
        """Yield frames in order, with the container's times, counted from its own zero [s].

        Frames without time stamps, or times that do not increase, raise `InvalidInput`.
        """
        self.remarks.clear()
        check = _FilmCheck(self.path)
        with _opened(self.path) as container:
            stream = container.streams.video[0]
            stream.codec_context.thread_count = self.threads
            stream.codec_context.options = {"err_detect": "explode"}
            for decoded in _decoded(container, stream, check):
                instant = check.read(decoded)
                if not decoded.is_corrupt:
                    yield decoded_frame(instant, decoded)
        self.remarks += check.remarks(self)


def open_video(path: str | Path, *, threads: int = 0) -> VideoFile:
    """Open a video file with a number of decoding threads, by default chosen by the decoder.

    A file without a video, or with one whose index was never written, raises `InvalidInput`.
    """
    path = Path(path)
    with _opened(path) as container:
        if not container.streams.video or container.streams.video[0].codec_context is None:
            raise InvalidInput(str(path), found="no pictures", expected="a video file")
        stream = container.streams.video[0]
        context = stream.codec_context
        if not context.width or not context.height:
            raise InvalidInput(
                str(path),
                found="a video stream without a picture size, since the file ends before its "
                "first picture",
                expected="at least one whole picture",
            )
        return VideoFile(
            path=path,
            size=(context.width, context.height),
            n_frames=stream.frames or None,
            duration=_seconds(stream, container),
            codec=context.name,
            note=_note(container),
            threads=threads,
        )


class VideoWriter:
    """Writer of a video file; the file appears only when it is complete.

    The ending is `.mp4`, `.mkv`, `.mov` or `.avi`, the codec `h264`, `ffv1` (lossless) or `mjpeg`.
    Sizes [px] are even but for `ffv1`. The rate is approximate: each frame is written at its own
    time, rounded to 1/90,000 s in MP4, 1 ms in Matroska. `note` is a comment stored in the file;
    that of rendered videos begins with `SIMULATED`.
    """

    def __init__(
        self,
        path: str | Path,
        size: tuple[int, int],
        codec: str = "h264",
        rate: float = 30.0,
        *,
        note: str = "",
    ) -> None:
        self.path = Path(path)
        self.size = size
        _refuse_output(self.path, size, codec)
        import av

        encoder, pixels, options = CODECS[codec]
        self._temporary = unfinished_path(self.path)
        self._pixels = pixels
        self._last = -1
        self._container = av.open(str(self._temporary.absolute()), "w")
        if note:
            self._container.metadata["comment"] = note
        stream: Any = self._container.add_stream(
            encoder, rate=Fraction(rate).limit_denominator(1001), options=options
        )
        stream.width, stream.height = size
        stream.pix_fmt = pixels
        stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS)
        self._stream = stream

    def write(self, frame: Frame) -> None:
        """Append a frame; its time must be at least 0 and later than that of the previous one."""
        picture = np.ascontiguousarray(frame.picture)
        if picture.shape[1::-1] != tuple(self.size):
            found = f"a frame of {picture.shape[1]} x {picture.shape[0]}"
            raise InvalidInput(
                str(self.path), found=found, expected="{} x {} pixels, as before".format(*self.size)
            )
        tick = round(frame.time * TICKS)
        if tick <= self._last:
            found = f"a frame at {frame.time:.6f} s after one at {self._last / TICKS:.6f} s"
            raise InvalidInput(
                str(self.path), found=found, expected="frames in order of time, from 0 s"
            )
        self._last = tick
        import av

        decoded = av.VideoFrame.from_ndarray(picture, format="bgr24")
        decoded = decoded.reformat(format=self._pixels, dst_colorspace="itu601")
        decoded.pts, decoded.time_base = tick, Fraction(1, TICKS)
        self._container.mux(self._stream.encode(decoded))

    def close(self) -> None:
        """Finish the file and move it to its final path."""
        if self._last >= 0:
            self._container.mux(self._stream.encode(None))
        self._container.close()
        if self._last < 0:
            self._temporary.unlink(missing_ok=True)
            raise InvalidInput(str(self.path), found="no frames", expected="at least one to write")
        os.replace(self._temporary, self.path)

    def abandon(self) -> None:
        """Discard the unfinished file."""
        self._container.close()
        self._temporary.unlink(missing_ok=True)

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()


class _FilmCheck:
    """Check of time stamps, which must increase, and count of what could not be decoded."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.times: list[float] = []
        self._last: Fraction | None = None
        self._damaged = self._packets = 0  # frames, and packets, that could not be decoded
        self._since = 0  # damaged packets since the last good frame
        self._any_good = False

    def read(self, decoded: Any) -> float:
        where = f"{self.path}, frame {len(self.times)}"
        if decoded.pts is None or not decoded.time_base:
            raise InvalidInput(
                where,
                found="no time stamp",
                expected="one for every frame",
                hint="raw streams have no time stamps: record into a container such as .mkv or "
                ".mp4",
            )
        instant = decoded.pts * Fraction(decoded.time_base)
        if self._last is not None and instant <= self._last:
            how = "the time of the previous frame" if instant == self._last else "a decreasing time"
            found = f"{how}: {float(instant):.6f} s after {float(self._last):.6f} s"
            hint = "the film was cut or joined; track its parts one by one"
            raise InvalidInput(where, found=found, expected="increasing time stamps", hint=hint)
        self._last = instant
        self.times.append(float(instant))
        if decoded.is_corrupt:
            self._damaged += 1
        else:
            self._since, self._any_good = 0, True
        return float(instant)

    def packet(self) -> None:
        """Count a packet that cannot be decoded."""
        self._packets += 1
        self._since += 1

    def remarks(self, video: VideoFile) -> Iterator[str]:
        if not self._any_good:
            raise InvalidInput(
                str(video.path), found="no decodable picture", expected="at least one whole frame"
            )
        times = self.times
        missing = (video.n_frames or 0) - len(times)
        usual = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        short = (video.duration or 0.0) - (times[-1] + usual)
        # Some files count ticks without a picture, too; they last until their stated end.
        whole = -1.5 * usual < short < 0.5 * usual
        if (missing > 0 and not whole) or self._since or short > 2.0 * usual > 0.0:
            of = f" of {video.n_frames}" if missing > 0 else ""
            yield f"truncated: the file ends after frame {len(times) - 1}{of}, at {times[-1]:.3f} s"
        if middle := self._packets - self._since + self._damaged:
            yield f"{middle} damaged frames were left out"
        yield from self._uneven(np.diff(times))

    def _uneven(self, steps: FloatArray) -> Iterator[str]:
        if len(steps) < 2:
            return
        usual = float(np.percentile(steps, 50.0, method="lower"))
        odd = np.abs(steps - usual) > max(SAME_RATE * usual, ROUNDING)
        if usual < 1.0 / MAX_FRAMES_A_SECOND:
            yield f"{1.0 / usual:.0f} frames per second: are these times in seconds?"
        elif odd.any():
            yield (
                f"variable frame rate: {int(odd.sum())} of {len(steps)} steps differ from the usual"
                f" {usual * 1e3:.2f} ms; the longest is {steps.max() * 1e3:.1f} ms, at "
                f"{self.times[int(np.argmax(steps))]:.3f} s"
            )


def decoded_frame(time: float, decoded: Any) -> Frame:
    """Frame of a decoded PyAV picture, whose colours are converted on access."""
    name, width, height = decoded.format.name, decoded.width, decoded.height

    def colours() -> Picture:
        options = {"src_colorspace": "itu601"} if name.startswith("yuv") else {}
        return np.asarray(decoded.to_ndarray(format="bgr24", **options), dtype=np.uint8)

    def luma() -> Gray:
        plane = decoded.planes[0]
        row = plane.line_size
        return np.frombuffer(plane, np.uint8, row * height).reshape(height, row)[:, :width]

    bright_first = name in BRIGHT_FIRST
    return Frame(time, size=(width, height), colours=colours, luma=luma if bright_first else None)


def _decoded(container: Any, stream: Any, check: _FilmCheck) -> Iterator[Any]:
    """Yield the frames of all packets; count packets that cannot be decoded."""
    import av

    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except StopIteration:
            return
        except av.FFmpegError:  # the file ends in the middle of a packet
            check.packet()
            return
        try:
            yield from packet.decode()
        except av.FFmpegError:
            check.packet()


def _opened(path: Path) -> Any:
    refuse_device(path, "a video file")
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise InvalidInput(str(path), found=found, expected="a video or a recording")
    if path.stat().st_size == 0:
        raise InvalidInput(str(path), found="an empty file", expected="a video file")
    require("av", str(path), extra="video")
    import av

    try:
        return av.open(str(path.absolute()), metadata_errors="replace")
    except av.FFmpegError:
        with path.open("rb") as stream:
            mp4 = b"ftyp" in stream.read(16)
        raise InvalidInput(
            str(path),
            found="no index, since the recording was interrupted" if mp4 else "no video",
            expected="a complete video file",
            hint="record into .mkv, which survives interruptions" if mp4 else None,
        ) from None


def _note(container: Any) -> str:
    """Comment in a file's metadata; some containers store its name in capitals."""
    kept = {name.lower(): words for name, words in container.metadata.items()}
    return str(kept.get("comment", ""))


def _seconds(stream: Any, container: Any) -> float | None:
    """Duration according to the container [s]."""
    if stream.duration is not None and stream.time_base:
        return float(((stream.start_time or 0) + stream.duration) * stream.time_base)
    return None if container.duration is None else container.duration / 1e6


def _refuse_output(path: Path, size: tuple[int, int], codec: str) -> None:
    refuse_ending(path, ENDINGS, "video")
    check_name("codec", codec, CODECS)
    if min(size) < 1 or (codec != "ffv1" and (size[0] % 2 or size[1] % 2)):
        raise InvalidInput(
            "size", found=f"{size[0]} x {size[1]}", expected="an even width and height [px]"
        )
    require("av", str(path), extra="video")
    refuse_unwritable(path)


PHOTO_ENDINGS: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
VIDEO_ENDINGS: Final = (*ENDINGS, ".nut")  # of a recording too
FROM_VIDEO: Final = 40  # frames used of a video
MAX_BYTES: Final = 200_000_000


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return files, and those of folders sorted by name; raise unless pictures or videos."""
    known = (*PHOTO_ENDINGS, *VIDEO_ENDINGS)
    files: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InvalidInput(str(path), found="no such file", expected="pictures or a video")
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in known)
            if not inside:
                raise InvalidInput(
                    str(path), found="a folder without pictures", expected="files such as .png"
                )
            files += inside
        elif path.suffix.lower() not in known:
            raise InvalidInput(
                str(path), found=f"the ending {path.suffix!r}", expected=", ".join(known)
            )
        else:
            files.append(path)
    return files


def pictures_of(files: Sequence[Path]) -> Iterator[tuple[str, Picture]]:
    """Yield every picture with its name; of a video, frames spread over its length."""
    for file in files:
        if file.suffix.lower() in VIDEO_ENDINGS:
            yield from _frames_of(file)
        else:
            yield file.name, read_picture(file)


def first_picture(path: Path) -> Picture:
    """Load a picture, or the first frame of a video."""
    (file,) = files_of([path])[:1]
    if file.suffix.lower() in VIDEO_ENDINGS:
        for frame in open_video(file).frames():
            return frame.picture
        raise InvalidInput(str(path), found="no frames", expected="a video with pictures")
    return read_picture(file)


def read_picture(path: Path) -> Picture:
    """Load a picture as the sensor recorded it, without the rotation noted in its file."""
    from PIL import Image

    cv2 = opencv()
    with usable(path, "a picture"):
        if path.stat().st_size > MAX_BYTES:
            raise InvalidInput(str(path), found="more than 200 MB", expected="a picture")
        data = path.read_bytes()
    found = "a file that is not a picture"
    picture: Picture | None = None
    try:
        with warnings.catch_warnings(action="ignore"):
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(io.BytesIO(data))  # reads only the header, with the size
            image.verify()  # checksums of PNG
        if image.format == "JPEG" and b"\xff\xd9" not in data:
            raise ValueError("truncated: OpenCV would return the rest as grey")
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        found = "more than 89 million pixels"  # 2**28 bytes of colours
    except Exception:  # Pillow lets any error of its parsers pass
        picture = None
    if picture is None:
        raise InvalidInput(str(path), found=found, expected="a picture such as .png or .jpg")
    return picture


def _frames_of(file: Path) -> Iterator[tuple[str, Picture]]:
    video = open_video(file)
    every = max(1, (video.n_frames or sum(1 for _ in video.frames())) // FROM_VIDEO)
    for number, frame in enumerate(video.frames()):
        if number % every == 0:
            yield f"{file.name} at {frame.time:.2f} s", frame.picture
