"""Zip file of a bundle, possibly malicious: all members are checked before any is used.

Nothing is unpacked under a name from the file. Members are named ``manifest.json``, as in `FILES`,
``series/SHA256.npy`` and ``media/SHA256``; any other is rejected.
"""

from __future__ import annotations

import hashlib
import io
import re
import stat
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, TypeVar, final

import numpy as np
from pydantic import ValidationError

from fixel.database.bundle_lines import Line, Manifest, SeriesLine
from fixel.database.rows import Measured
from fixel.errors import InvalidInput
from fixel.io.document import parse_json
from fixel.typing import FloatArray

FORMAT: Final = "fixel-bundle"
VERSION: Final = 1
MANIFEST: Final = "manifest.json"
FILES: Final = (
    "experiments.jsonl",
    "parameters.jsonl",
    "simulations.jsonl",
    "calibrations.jsonl",
    "filter_parameters.jsonl",
    "filter_runs.jsonl",
)
CHUNK: Final = 1 << 20  # [bytes]
_CONTENT = re.compile(r"series/[0-9a-f]{64}\.npy|media/[0-9a-f]{64}")
_Kind = TypeVar("_Kind", bound=Line)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BundleLimits:
    """Maximum sizes of a bundle, so that a small file cannot fill a disk or the memory."""

    members: int = 1_000_000
    total: int = 200_000_000_000  # [bytes], unpacked
    in_memory: int = 1_000_000_000  # [bytes], member that is read at once
    line: int = 10_000_000  # [bytes]
    ratio: int = 100  # unpacked to packed size, for members larger than `small`
    small: int = 1_000_000  # [bytes]


LIMITS: Final = BundleLimits()


@final
class BundleFile:
    """Bundle whose members are complete and match the checksums of its manifest.

    Raises
    ------
    InvalidInput
        From the constructor and every method: no bundle, or a damaged or malicious one.
    """

    def __init__(self, path: Path, limits: BundleLimits = LIMITS) -> None:
        self.path = path
        self._limits = limits
        try:
            self._zip = zipfile.ZipFile(path)
        except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as problem:
            raise self._refused(str(problem) or "no zip file", "a whole bundle") from None
        try:
            self._infos = self._listed()
            self.manifest = self._read_manifest()
            self._check_members()
        except BaseException:
            self._zip.close()
            raise

    def __enter__(self) -> BundleFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    # --- reading --------------------------------------------------------------------------------

    def chunks(self, name: str) -> Iterator[bytes]:
        """Read a member piece by piece; raise if it is longer than its announced size."""
        if name not in self._infos:
            raise self._refused(f"no member {name}", "all that its records name")
        left = self._infos[name].file_size
        try:
            with self._zip.open(name) as stream:
                while data := stream.read(CHUNK):
                    left -= len(data)
                    if left < 0:
                        raise self._refused(f"more in {name} than announced", "its announced size")
                    yield data
        except (OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError) as problem:
            raise self._refused(f"{name} damaged: {problem}", "a whole bundle") from None

    def lines(self, name: str, kind: type[_Kind]) -> Iterator[tuple[str, _Kind]]:
        """Read the lines of a member; yield the place of each, for errors, and its record."""
        with self._zip.open(name) as stream:
            for number, text in enumerate(self._raw_lines(stream, name), start=1):
                where = f"{self.path}: {name}, line {number}"
                yield where, parsed(text, where, kind)

    def series(self, lines: list[SeriesLine]) -> list[Measured]:
        """Load the series that a record refers to: name, columns and values."""
        return [(s.name, tuple(s.columns), self._array(s)) for s in lines]

    def _raw_lines(self, stream: IO[bytes], name: str) -> Iterator[bytes]:
        while text := stream.readline(self._limits.line + 1):
            if len(text) > self._limits.line:
                raise self._refused(f"a line too long in {name}", "a record a line")
            yield text

    def _whole(self, name: str) -> bytes:
        info = self._infos.get(name)
        if info is not None and info.file_size > self._limits.in_memory:
            raise self._refused(f"{info.file_size} bytes in {name}", "a member that fits in memory")
        return b"".join(self.chunks(name))

    def _array(self, line: SeriesLine) -> FloatArray:
        name = f"series/{line.sha256}.npy"
        values = read_npy(self._whole(name), f"{self.path}: {name}")
        if values.shape[1] != len(line.columns):
            raise self._refused(
                f"{values.shape[1]} columns in {name}", f"{len(line.columns)}, as its record says"
            )
        return values

    # --- checks ---------------------------------------------------------------------------------

    def _listed(self) -> dict[str, zipfile.ZipInfo]:
        infos = self._zip.infolist()
        if len(infos) > self._limits.members:
            raise self._refused(f"{len(infos)} members", f"at most {self._limits.members}")
        for info in infos:
            self._check_info(info)
        if sum(info.file_size for info in infos) > self._limits.total:
            raise self._refused("too much to unpack", f"at most {self._limits.total} bytes")
        names = {info.filename: info for info in infos}
        if len(names) < len(infos):
            raise self._refused("a member twice", "each member once")
        return names

    def _check_info(self, info: zipfile.ZipInfo) -> None:
        name, limits = info.filename, self._limits
        # `orig_filename` is the name in the file; Python cuts `filename` at a null byte.
        if info.orig_filename != name or not _is_member(name):
            raise self._refused(f"the member {name!r}", "only members of a bundle")
        if stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG):
            raise self._refused(f"{name} as a link or a device", "plain files")
        if info.flag_bits & 1 or info.compress_type not in (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        ):
            raise self._refused(f"{name} encrypted or packed otherwise", "stored or deflated")
        if info.file_size > max(limits.small, limits.ratio * info.compress_size):
            raise self._refused(
                f"{name} packed to less than 1/{limits.ratio}", "a bundle as fixel export writes it"
            )

    def _read_manifest(self) -> Manifest:
        where = f"{self.path}: {MANIFEST}"
        if MANIFEST not in self._infos:
            raise self._refused(f"no {MANIFEST}", "a bundle", "make one with: fixel export")
        content = decoded(self._whole(MANIFEST), where)
        version = content.get("version") if isinstance(content, dict) else None
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise self._refused("another kind of zip", "a bundle", "make one with: fixel export")
        if version != VERSION:
            raise InvalidInput(
                where,
                found=f"format version {version!r}",
                expected=str(VERSION),
                hint="import it with the version of fixel that wrote it, or a newer one",
            )
        return validated(content, where, Manifest)

    def _check_members(self) -> None:
        listed, there = set(self.manifest.members), set(self._infos) - {MANIFEST}
        for name in sorted(listed ^ there | (set(FILES) - listed)):
            how = "unlisted" if name in there else "missing"
            raise self._refused(f"{name} {how}", "exactly the members of its manifest")
        for name, check in self.manifest.members.items():
            total, size = hashlib.sha256(), 0
            for data in self.chunks(name):
                total.update(data)
                size += len(data)
            if (size, total.hexdigest()) != (check.bytes, check.sha256):
                raise self._refused(f"{name} changed", "the checksum of its manifest")
            content = re.search(r"[0-9a-f]{64}", name)
            if content is not None and content[0] != check.sha256:
                raise self._refused(f"{name} with other content", "a name that is its checksum")

    def _refused(self, found: str, expected: str, hint: str | None = None) -> InvalidInput:
        return InvalidInput(str(self.path), found=found, expected=expected, hint=hint)


def _is_member(name: str) -> bool:
    return name in (MANIFEST, *FILES) or _CONTENT.fullmatch(name) is not None


def decoded(data: bytes, where: str) -> Any:
    """Parse JSON in UTF-8; `where` names it in errors."""
    try:
        return parse_json(data.decode("utf-8"), where)
    except UnicodeDecodeError:
        raise InvalidInput(where, found="bytes that are no UTF-8", expected="JSON") from None


def parsed(data: bytes, where: str, kind: type[_Kind]) -> _Kind:
    """Parse and validate one JSON line of a bundle."""
    return validated(decoded(data, where), where, kind)


def validated(content: Any, where: str, kind: type[_Kind]) -> _Kind:
    """Validate parsed JSON as a line of a kind."""
    try:
        return kind.model_validate(content)
    except ValidationError as problem:
        raise first_of(problem, where) from None


def first_of(problem: ValidationError, where: str) -> InvalidInput:
    """First error of a validation, as `InvalidInput`."""
    first = problem.errors()[0]
    place = ".".join(map(str, first["loc"]))
    return InvalidInput(f"{where}: {place}", found=first["msg"].lower(), expected="a fixel record")


def npy_of(values: FloatArray) -> bytes:
    """Return (n, k) numbers as an npy file; equal numbers always give equal bytes."""
    stream = io.BytesIO()
    np.save(stream, np.ascontiguousarray(values, dtype="<f8"), allow_pickle=False)
    return stream.getvalue()


def read_npy(data: bytes, where: str) -> FloatArray:
    """Inverse of `npy_of`: accepts only a 2-D float64 array of exactly the size in its header."""
    # np.load would allocate the size given in the header before it checks the size of the data.
    stream = io.BytesIO(data)
    expected = "a table of little-endian float64"
    try:
        if np.lib.format.read_magic(stream) != (1, 0):
            raise ValueError("another version of npy")
        shape, by_column, dtype = np.lib.format.read_array_header_1_0(stream)
    except Exception as problem:  # a header is Python text, whose parser raises various errors
        raise InvalidInput(where, found=str(problem), expected=expected) from None
    if dtype.hasobject or dtype.str != "<f8" or by_column or len(shape) != 2:
        raise InvalidInput(where, found=f"{dtype} of shape {shape}", expected=expected)
    n_row, n_column = shape
    body = data[stream.tell() :]
    if min(shape) < 0 or len(body) != 8 * n_row * n_column:
        raise InvalidInput(where, found=f"{len(body)} bytes for {shape}", expected=expected)
    return np.frombuffer(body, dtype="<f8").reshape(n_row, n_column).astype(np.float64)
