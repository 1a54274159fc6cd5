"""Journal of named blocks of bytes, each durable once `append` has returned.

The file is a header and blocks, nothing else:

    header  "fixel journal 1\\n" and 8 random bytes, the mark of this journal
    block   mark, length of the name (4), length of the data (8), CRC32 of what follows it and of
            both lengths (4), name in UTF-8, data; numbers little-endian

A block truncated by a crash is the last one, and the next `append` overwrites it. A damaged block
before the end is skipped: reading continues at the next mark. Only one process writes.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, Self

from fixel.errors import FULL, InvalidInput, JobRefused, os_reason
from fixel.io.atomic import sync_folder, written_whole
from fixel.io.lock import FileLock, Owner, holder

MAGIC: Final = b"fixel journal 1\n"
_MARK: Final = 8  # [bytes]
_LENGTHS: Final = struct.Struct("<IQ")
_CRC: Final = struct.Struct("<I")
_HEADER: Final = len(MAGIC) + _MARK
_FRONT: Final = _MARK + _LENGTHS.size + _CRC.size
_PIECE: Final = 1 << 20  # [bytes] read at once
MAX_MISSES: Final = 1000  # marks without a block; a stranger may write one at every byte


class _Position(NamedTuple):
    start: int
    length: int


class Journal:
    """Journal that is open for writing, by this process only; its file is created if missing.

    Raise `JobRefused` if another living process writes it or it cannot be written, and
    `InvalidInput` for a file that is no journal. The content of `damaged` parts is lost, and may be
    appended again.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with ExitStack() as undo:
            self._lock = undo.enter_context(FileLock(lock_of(path), f"the journal {path}"))
            self._stream = undo.enter_context(_opened(path))
            self._mark, self._places, self._end, self.damaged = _contents(self._stream, path)
            undo.pop_all()

    def __contains__(self, name: str) -> bool:
        return name in self._places

    def __len__(self) -> int:
        return len(self._places)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def get(self, name: str) -> bytes | None:
        """Return the data under a name, or None."""
        place = self._places.get(name)
        return None if place is None else _read(self._stream, place)

    def append(self, blocks: Iterable[tuple[str, bytes]]) -> int:
        """Add blocks without those whose name exists, durable on return; return how many are new.

        A full or failing disk raises `JobRefused` and leaves the journal unchanged.
        """
        new: dict[str, bytes] = {}
        for name, data in blocks:
            if name not in self._places:
                new.setdefault(name, data)
        if not new:
            return 0
        places, pieces, end = {}, [], self._end
        for name, data in new.items():
            framed = _framed(self._mark, name, data)
            places[name] = _Position(end + len(framed) - len(data), len(data))
            pieces.append(framed)
            end += len(framed)
        self._write(b"".join(pieces))
        self._places |= places
        self._end = end
        return len(new)

    def drop(self, larger_than: int) -> None:
        """Remove blocks with more bytes of data; a crash leaves the file as before or after."""
        small = {name: p for name, p in self._places.items() if p.length <= larger_than}
        if len(small) == len(self._places):
            return
        with written_whole(self._path) as unfinished, unfinished.open("wb") as file:
            file.write(MAGIC + self._mark)
            for name, place in small.items():
                file.write(_framed(self._mark, name, _read(self._stream, place)))
        self._stream.close()
        self._stream = _opened(self._path)
        self._mark, self._places, self._end, self.damaged = _contents(self._stream, self._path)

    def close(self) -> None:
        """Close the file and release its lock; all blocks are durable already."""
        self._stream.close()
        self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, data: bytes) -> None:
        try:
            self._stream.seek(self._end)
            self._stream.truncate()  # remains of a crash
            rest = memoryview(data)
            while rest:
                rest = rest[self._stream.write(rest) :]
            os.fsync(self._stream.fileno())
        except OSError as problem:
            raise _unwritable(self._path, problem) from None


def read_journal(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield every complete block of a journal, also while another process writes it."""
    with path.open("rb", buffering=0) as stream:
        _, places, _, _ = _contents(stream, path)
        for name, place in places.items():
            yield name, _read(stream, place)


def writer_of(path: Path) -> Owner | None:
    """Return the process that writes a journal, or None."""
    return holder(lock_of(path))


def lock_of(path: Path) -> Path:
    """Return the file whose lock the writer of a journal has."""
    return path.with_name(f"{path.name}.lock")


def _opened(path: Path) -> BinaryIO:
    """Open the file; write its header if that is incomplete."""
    try:
        with ExitStack() as undo:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
            stream: BinaryIO = undo.enter_context(os.fdopen(descriptor, "r+b", buffering=0))
            if os.fstat(descriptor).st_size < _HEADER:
                _begin(stream, path)
            undo.pop_all()
    except OSError as problem:
        raise _unwritable(path, problem) from None
    return stream


def _begin(stream: BinaryIO, path: Path) -> None:
    """Write the header, also over one truncated by a crash."""
    if not MAGIC.startswith(stream.read(len(MAGIC))):
        raise _other(path)
    stream.seek(0)
    stream.truncate()
    stream.write(MAGIC + os.urandom(_MARK))
    os.fsync(stream.fileno())
    with suppress(OSError):  # not every file system can
        sync_folder(path.parent)


def _framed(mark: bytes, name: str, data: bytes) -> bytes:
    label = name.encode()
    lengths = _LENGTHS.pack(len(label), len(data))
    crc = zlib.crc32(data, zlib.crc32(label, zlib.crc32(lengths)))
    return b"".join((mark, lengths, _CRC.pack(crc), label, data))


def _contents(stream: BinaryIO, path: Path) -> tuple[bytes, dict[str, _Position], int, int]:
    """Return the mark of blocks, their places, the position of the next, and the number of
    unreadable parts that are followed by blocks."""
    size = stream.seek(0, os.SEEK_END)
    header = _read(stream, _Position(0, _HEADER))
    if not MAGIC.startswith(header[: len(MAGIC)]):
        raise _other(path)
    if len(header) < _HEADER:  # another process is creating it
        return b"", {}, _HEADER, 0
    mark = header[len(MAGIC) :]
    places: dict[str, _Position] = {}
    position = end = _HEADER
    damaged = misses = 0
    while position < size:
        found = _block(stream, mark, position, size)
        if found is None:
            misses += 1
            if misses > MAX_MISSES:
                raise InvalidInput(str(path), found="damage in all of it", expected="a journal")
            position = _next_mark(stream, mark, position + 1, size)
            continue
        damaged += position > end
        name, place = found
        places.setdefault(name, place)
        position = end = place.start + place.length
    return mark, places, end, damaged


def _block(stream: BinaryIO, mark: bytes, position: int, size: int) -> tuple[str, _Position] | None:
    front = _read(stream, _Position(position, _FRONT))
    if len(front) < _FRONT or not front.startswith(mark):
        return None
    lengths = front[_MARK : _MARK + _LENGTHS.size]
    n_label, n_data = _LENGTHS.unpack(lengths)
    (expected,) = _CRC.unpack(front[-_CRC.size :])
    start = position + _FRONT
    if start + n_label + n_data > size:
        return None
    label = _read(stream, _Position(start, n_label))
    place = _Position(start + n_label, n_data)
    crc = zlib.crc32(label, zlib.crc32(lengths))
    for piece in _pieces(stream, place):
        crc = zlib.crc32(piece, crc)
    return (label.decode(), place) if crc == expected else None


def _next_mark(stream: BinaryIO, mark: bytes, position: int, size: int) -> int:
    """Return the position of the next mark, or the end of the file."""
    while position < size:
        piece = _read(stream, _Position(position, _PIECE))
        found = piece.find(mark)
        if found >= 0:
            return position + found
        if len(piece) < _PIECE:
            return size
        position += _PIECE - _MARK + 1
    return size


def _pieces(stream: BinaryIO, place: _Position) -> Iterator[bytes]:
    for start in range(place.start, place.start + place.length, _PIECE):
        yield _read(stream, _Position(start, min(_PIECE, place.start + place.length - start)))


def _read(stream: BinaryIO, place: _Position) -> bytes:
    """Return the bytes at a place; fewer if the file ends there."""
    stream.seek(place.start)
    parts, left = [], place.length
    while left > 0:
        part = stream.read(left)
        if not part:
            break
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def _other(path: Path) -> InvalidInput:
    return InvalidInput(str(path), found="something else", expected="a journal of fixel")


def _unwritable(path: Path, problem: OSError) -> JobRefused:
    hint = "free disk space, then resume the job" if problem.errno in FULL else None
    return JobRefused(f"{path} cannot be written: {os_reason(problem)}", hint)
