"""Recorder of camera frames, each with one reading of the fixels, on one clock."""

from __future__ import annotations

import math
import shutil
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np

from fixel.errors import FixelError, InvalidInput, counted, os_reason
from fixel.formats.recording import RecordingHeader, RecordingWriter
from fixel.testbed.frame_source import STALLED, CameraPicture, FrameQueue, FrameSource, Stream
from fixel.testbed.tactile import TactileReading
from fixel.vision.frame import Frame, Gray

LOOKS_AT_DISK: Final = 0.5  # [s]
POLL: Final = 0.1  # [s] between two checks of the stop key while no picture comes
WATCH: Final = 0.1  # [s] between two calls of `watch`
BEHIND: Final = 0.1  # [s] after which a reading does not belong to its frame
BREATH: Final = 2e-6  # [s] smallest difference between the times of two frames
Stop = Callable[[], str]
LATE: Final = 2.5  # intervals this many times the mean one are gaps
WINDOW: Final = 61  # frames over which the rate is computed
MIN_TIME: Final = 60.0  # [s] of recording that must fit on the disk
SPARE: Final = 32 * 1024 * 1024  # [bytes] of the disk that stay free
USUAL_RATE: Final = 30.0  # [frames/s] assumed for a camera that does not report its rate
# Bytes per pixel for pictures of a testbed with noise, with a margin.
ROOM: Final = {"as-it-comes": 0.45, "near": 0.45, "exact": 2.0}


class TouchReader(Protocol):
    """Reader of the fixels; `trouble` is the reason why it no longer works."""

    @property
    def trouble(self) -> str: ...
    def read(self) -> TactileReading: ...


class RecordingStatus(NamedTuple):
    """Status of a recording under way."""

    seconds: float  # time since the first frame [s]
    frames: int
    lost: int
    rate: float  # frame rate over about the last second [frames/s]
    bits: int | None  # bits of the newest reading
    free: int  # free space on the disk [bytes]
    problems: tuple[str, ...]


Watch = Callable[[CameraPicture, RecordingStatus], None]


class FrameRate:
    """Running measurement of the rate of frames and of gaps between them."""

    def __init__(self) -> None:
        # Number of intervals much longer than usual, in which frames were lost before arrival.
        self.gaps = 0
        self.longest = 0.0  # longest gap [s]
        self.longest_at = 0.0  # beginning of the longest gap [s]
        self._times: deque[float] = deque(maxlen=WINDOW)

    def tick(self, time: float) -> None:
        """Record the time of a frame [s]."""
        times = self._times
        if len(times) > WINDOW // 4:
            step, usual = time - times[-1], (times[-1] - times[0]) / (len(times) - 1)
            if step > LATE * usual:
                self.gaps += 1
                if step > self.longest:
                    self.longest, self.longest_at = step, times[-1]
        times.append(time)

    @property
    def rate(self) -> float:
        """Mean rate of the last frames [frames/s]; 0 before the second frame."""
        times = self._times
        span = times[-1] - times[0] if len(times) > 1 else 0.0
        return (len(times) - 1) / span if span > 0.0 else 0.0

    def sentence(self) -> str:
        """Return a sentence about the gaps; empty without gaps."""
        if not self.gaps:
            return ""
        longest = f"{self.longest * 1e3:.0f} ms, after t = {self.longest_at:.3f} s"
        return f"{counted(self.gaps, 'gap')} between frames; the longest is {longest}"


class RecordingSummary(NamedTuple):
    """Result of a recording."""

    folder: Path
    frames: int  # frames written
    lost: int  # frames lost because the recorder was too slow
    seconds: float  # duration from the first frame to the last [s]
    bytes: int  # size of the video
    reason: str  # why the recording ended
    without_reading: int  # number of frames for which the fixels gave no answer; 0 without fixels
    problems: tuple[str, ...]
    # Whether it ended otherwise than by key, limit, seated part or the end of a file.
    early: bool = False

    @property
    def rate(self) -> float:
        """Mean rate of the frames written [frames/s]."""
        return (self.frames - 1) / self.seconds if self.seconds > 0.0 else 0.0


@dataclass(slots=True, kw_only=True)
class Recorder:
    """Recorder of one experiment."""

    # Source, opened just before: what its camera sends meanwhile is stamped too late.
    source: FrameSource
    stream: Stream  # properties of the source
    folder: Path  # folder to create
    codec: str  # `as-it-comes`, `near` or `exact`
    tactile: TouchReader | None = None  # reader of the fixels, called once per frame
    rig: str = ""  # name of the rig
    limit: float | None = None  # longest duration of the recording [s]
    seating: Seating | None = None  # detector that ends the recording once the part is seated
    # Called repeatedly; returns a reason to end the recording, or an empty string.
    stop: Stop | None = None
    # Called with picture and status, at most ten times a second; must be fast.
    watch: Watch | None = None
    # Called with the folder once it exists, to add files to it.
    prepare: Callable[[Path], None] | None = None
    patience: float = STALLED + 1.0  # longest time without a picture [s]
    _problems: Counter[str] = field(default_factory=Counter, init=False)
    _without: int = field(default=0, init=False)
    _bits: int | None = field(default=None, init=False)
    _free: int = field(default=0, init=False)
    _missing: float = field(default=0.0, init=False)  # time without a picture, see `_silent` [s]
    _wanted: bool = field(default=False, init=False)
    _pace: FrameRate = field(default_factory=FrameRate, init=False)

    def run(self) -> RecordingSummary:
        """Record until the end, and return a summary.

        A folder that cannot be created, no space for a minute, or no picture raises `InvalidInput`.
        """
        check_disk_space(self.folder, self.stream, self.codec, self.limit)
        queue = FrameQueue(self.source, live=self.stream.live)
        queue.start()
        try:
            first = self._first(queue)
            started = datetime.now(UTC) - timedelta(seconds=time.monotonic() - first.taken)
            header = RecordingHeader(
                size=self.stream.size,
                codec=self.codec,
                rig=self.rig,
                source=self.source.name,
                started=started.isoformat(timespec="milliseconds"),
                rate=self.stream.rate,
                simulated_by=self.stream.simulated_by,
                about={"times": "arrival" if first.captured is None else "capture"},
            )
            writer = RecordingWriter(self.folder, header)
            try:
                if self.prepare is not None:
                    self.prepare(self.folder)
                reason = self._record(queue, writer, first)
            except BaseException:
                writer.abandon()
                raise
            return self._close(queue, writer, reason)
        finally:
            queue.close()

    def _first(self, queue: FrameQueue) -> CameraPicture:
        """Wait for the first picture; nothing is written before it."""
        since, limit = time.monotonic(), max(self.patience, STALLED)
        while (arrived := queue.get(POLL)) is None:
            why = "" if self.stop is None else self.stop()
            if queue.over or why or time.monotonic() - since > limit:
                end = f"before it was stopped ({why})" if why else f"within {limit:g} s"
                found = queue.reason if queue.over else f"no picture {end}"
                raise InvalidInput(self.source.name, found=found, expected="pictures to record")
        # The picture that was read to open the source may be old.
        while self.stream.live and queue.waiting and time.monotonic() - arrived.time > BEHIND:
            arrived = queue.get(0.0) or arrived
        return arrived

    def _record(self, queue: FrameQueue, writer: RecordingWriter, first: CameraPicture) -> str:
        """Write pictures until there is a reason to end, and return it."""
        zero, looked, watched = first.taken, -LOOKS_AT_DISK, -WATCH
        arrived: CameraPicture | None = first
        while arrived is first or not (self.stop is not None and (why := self.stop())):
            if arrived is None:
                arrived = queue.get(POLL)
                if arrived is None and (why := self._silent(queue)):
                    return why
                continue
            self._missing, now = 0.0, time.monotonic()
            at = max(arrived.taken - zero, writer.seconds + BREATH if writer.frames else 0.0)
            if why := self._unfit(arrived, at):
                return why
            try:
                self._write(writer, arrived, at, zero)
            except OSError as problem:
                return f"the disk of {self.folder} could not be written to: {os_reason(problem)}"
            self._pace.tick(at)
            if now - looked >= LOOKS_AT_DISK:
                looked, self._free = now, free_space(self.folder)
                if self._free < SPARE:
                    return f"the disk is almost full: {self._free / 1e6:.0f} MB are left"
            if self.watch is not None and now - watched >= WATCH:
                watched = now
                self._show(arrived, at, writer.frames, queue.lost)
            if why := self._over(arrived, at):
                return why
            arrived = queue.get(POLL)
        self._wanted = True
        return why

    def _silent(self, queue: FrameQueue) -> str:
        """Return why no more pictures will come; empty while they may."""
        if queue.over:
            return queue.reason
        # Where this program itself had to wait, so had its pictures: a late check counts as others.
        self._missing += POLL
        if self._missing >= self.patience:
            return f"the camera has sent nothing for {self.patience:g} s"
        return ""

    def _unfit(self, arrived: CameraPicture, at: float) -> str:
        """Return why to end the recording before a picture; empty to write it."""
        if self.limit is not None and at >= self.limit - BREATH:
            self._wanted = True
            return f"the limit of {self.limit:g} s"
        if arrived.size is not None and arrived.size != self.stream.size:
            return "the camera changed to {} x {} pixels".format(*arrived.size)
        return ""

    def _write(
        self, writer: RecordingWriter, arrived: CameraPicture, at: float, zero: float
    ) -> None:
        """Write a picture with a reading taken now."""
        when = None
        self._bits = None
        if self.tactile is not None:
            # Emulated fixels can be read at the time of a picture.
            at_time = None if self.stream.live else getattr(self.tactile, "at", None)
            reading = self.tactile.read() if at_time is None else at_time(arrived.taken)
            self._bits = reading.bits
            # A source that waits for its reader has its own clock.
            when = max(reading.time - zero, 0.0) if self.stream.live else at
            if reading.bits is None:
                when = None
            elif when > max(at, arrived.time - zero) + BEHIND:
                self._problems[f"a reading more than {BEHIND:g} s after its frame"] += 1
            self._without += reading.bits is None
            if reading.problem:
                self._problems[f"fixels: {reading.problem}"] += 1
        if self.codec == "as-it-comes":
            assert arrived.jpeg is not None
            writer.write_jpeg(at, arrived.jpeg, self._bits, when)
            return
        try:
            picture = arrived.picture()
        except InvalidInput:
            self._problems["a picture that cannot be decoded, skipped"] += 1
            self._without -= self._bits is None and self.tactile is not None
            return
        writer.write(Frame(at, picture), self._bits, when)

    def _over(self, arrived: CameraPicture, at: float) -> str:
        """Return why to end the recording after a frame; empty to continue."""
        if self.tactile is not None and self.tactile.trouble:
            return f"the tactile board no longer answers: {self.tactile.trouble}"
        if self.seating is None:
            return ""
        why = self.seating.touched(at, self._bits)
        if not why and self.seating.wants_look(at):
            with suppress(InvalidInput):  # a picture that cannot be decoded shows nothing
                why = self.seating.looked(at, arrived.small())
        self._wanted = bool(why)
        return why

    def _show(self, arrived: CameraPicture, at: float, frames: int, lost: int) -> None:
        """Call `watch` with the status; if it fails, continue the recording without it."""
        assert self.watch is not None
        status = RecordingStatus(
            at, frames, lost, self._pace.rate, self._bits, self._free, self._sentences()
        )
        try:
            self.watch(arrived, status)
        except Exception as problem:
            self.watch = None
            self._problems[f"the preview failed: {problem}"] += 1

    def _sentences(self) -> tuple[str, ...]:
        torn = Counter({"a truncated picture, skipped": self.source.torn})
        return tuple(
            sentence if n == 1 else f"{sentence} ({n} times)"
            for sentence, n in (self._problems + torn).most_common(8)
        )

    def _close(self, queue: FrameQueue, writer: RecordingWriter, reason: str) -> RecordingSummary:
        lost = queue.lost
        gaps = self._pace.sentence()
        problems = (*self._sentences(), *([gaps] if gaps else []))
        try:
            writer.close(reason, lost, problems)
        except (FixelError, OSError) as problem:
            problems = (*problems, f"the end mark could not be written: {problem}")
        return RecordingSummary(
            folder=self.folder,
            frames=writer.frames,
            lost=lost,
            seconds=writer.seconds,
            bytes=writer.bytes,
            reason=reason,
            without_reading=self._without,
            problems=problems,
            early=not (self._wanted or self.source.complete),
        )


def free_space(folder: Path) -> int:
    """Free space [bytes] on the disk of a folder, which need not exist yet."""
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    return shutil.disk_usage(place).free


def check_disk_space(folder: Path, stream: Stream, codec: str, limit: float | None) -> None:
    """Raise if a minute of recording, or the shorter limit, does not fit on the disk."""
    duration = MIN_TIME if limit is None else min(limit, MIN_TIME)
    growth = math.prod(stream.size) * ROOM[codec] * (stream.rate or USUAL_RATE)  # [bytes/s]
    needed = growth * duration + SPARE
    free = free_space(folder)
    if free < needed:
        raise InvalidInput(
            str(folder),
            found=f"{free / 1e6:.0f} MB free on its disk",
            expected=f"{needed / 1e6:.0f} MB, for {duration:.0f} s of video ({codec})",
            hint="free disk space, or record to another disk"
            + ", or with --codec near" * (codec == "exact"),
        )


STEADY: Final = 0.5  # [s] for which the fixels must report the same
REST_SECONDS: Final = 1.0  # [s] without motion, once something has moved
LOOK: Final = 0.2  # [s] between two pictures compared
CHANGE: Final = 6  # [grey levels] of a cell of 8 x 8 pixels: noise is less than one
CELLS: Final = 3  # must change for motion; a part of one centimetre is about two cells wide


class Seating:
    """Detector of a part seated in a contact mode (bits); without one, only pictures decide."""

    def __init__(self, mode: int | None = None) -> None:
        self.mode = mode
        self._same_since = 0.0
        self._bits: int | None = None
        self._looked = -LOOK
        self._before: Gray | None = None
        self._moved_at: float | None = None

    def touched(self, time: float, bits: int | None) -> str:
        """Return why the part is seated by the fixels at a time [s]; empty if it is not."""
        if bits is None:  # a missing reading changes nothing
            return ""
        if bits != self._bits:
            self._bits, self._same_since = bits, time
        if self.mode is None or bits != self.mode or time - self._same_since < STEADY:
            return ""
        return f"seated: contact mode {bits:03b} for {STEADY:g} s"

    def wants_look(self, time: float) -> bool:
        """Whether it is time to compare the next picture."""
        return time - self._looked >= LOOK

    def looked(self, time: float, small: Gray) -> str:
        """Return why the part is seated by the pictures; empty if it is not."""
        before, self._before, self._looked = self._before, small, time
        if before is None:
            return ""
        if _moved(before, small):
            self._moved_at = time
        if self._moved_at is None or time - self._moved_at < REST_SECONDS:
            return ""
        return f"seated: no motion for {REST_SECONDS:g} s"


def _moved(before: Gray, now: Gray) -> bool:
    """Whether two pictures differ by more than light and noise."""
    change = now.astype(np.int16) - before
    change -= np.int16(np.median(change))
    return int((np.abs(change) > CHANGE).sum()) > CELLS
