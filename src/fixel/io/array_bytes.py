"""Arrays as bytes, for files and other processes: NumPy's format, without pickle; cache of fits.

Bytes may come from elsewhere. Sizes are compared before memory is reserved.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.io.atomic import write_whole
from fixel.model.fields import path_of
from fixel.typing import FloatArray

SMALL: Final = 64_000_000  # [bytes] that any file may unpack to
RATIO: Final = 100  # of unpacked to packed size, above which a larger file is rejected
KINDS: Final = "biufcUS"  # kinds of numbers and texts


def bytes_of(**arrays: ArrayLike) -> bytes:
    """Return named arrays as the bytes of an .npz file; equal arrays give equal bytes."""
    stream = io.BytesIO()
    content: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
    try:
        np.savez(stream, **content)
    except ValueError as problem:
        if isinstance(problem.__context__, KeyboardInterrupt):  # the file was open: not closed
            raise problem.__context__ from None
        raise
    return stream.getvalue()


def arrays_of(data: bytes) -> dict[str, NDArray[Any]]:
    """Inverse of `bytes_of`; raise `ValueError` for bytes that unpack to more."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        if sum(member.file_size for member in file.infolist()) > len(data):
            raise ValueError("compressed arrays")
        return {name.removesuffix(".npy"): array_of(file.read(name)) for name in file.namelist()}


def array_of(data: bytes) -> NDArray[Any]:
    """Return the array of an .npy file; raise `ValueError` if its header has another size."""
    stream = io.BytesIO(data)
    own = np.lib.format
    try:
        first = own.read_magic(stream) == (1, 0)
        header = (own.read_array_header_1_0 if first else own.read_array_header_2_0)(stream)
    except Exception as problem:  # a damaged header raises errors of Python's tokenizer too
        raise ValueError(f"no header of an array: {problem}") from None
    shape, _, dtype = header
    parts = [dtype] if dtype.names is None else [dtype[name] for name in dtype.names]
    if any(part.base.kind not in KINDS for part in parts):
        raise ValueError(f"an array of {dtype}")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(data) - stream.tell():
        raise ValueError(f"an array of shape {shape} in {len(data)} bytes")
    array: NDArray[Any] = np.load(io.BytesIO(data), allow_pickle=False)
    return array


# Increase it when the same settings no longer give the same fit.
VERSION: Final = 1


def stored_in(folder: str | PathLike[str] | None) -> Path | None:
    """Return the folder that an option names for results, created if missing."""
    if folder is None:
        return None
    path = path_of(folder, "store")
    path.mkdir(parents=True, exist_ok=True)
    return path


class ResultCache:
    """Results by name in a folder, each with a checksum of its inputs; without one, not stored."""

    def __init__(self, folder: str | PathLike[str] | None) -> None:
        self.folder = stored_in(folder)

    def get(self, name: str, of: object, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return the result stored under a name for the same inputs, or compute and store it.

        `of` has all inputs of the result, as plain values and arrays; results are plain values.
        """
        mark = hashlib.sha256(json.dumps([VERSION, of], default=_plain).encode()).hexdigest()
        if self.folder is None:
            return compute()
        path = self.folder / f"{name}.json"
        if (kept := _read(path)) and kept.get("of") == mark:
            return dict(kept["answer"])
        answer = compute()
        write_whole(path, json.dumps({"of": mark, "answer": answer}))
        return answer


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    good = isinstance(content, dict) and isinstance(content.get("answer"), dict)
    return content if good else None


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return [
            list(value.shape),
            hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest(),
        ]
    if isinstance(value, np.generic):
        return value.item()
    return repr(value)


def listed(table: FloatArray) -> list[Any]:
    """Return a table rounded to 9 digits (nanometres, nanoradians), for a file."""
    return list(np.round(table, 9).tolist())
