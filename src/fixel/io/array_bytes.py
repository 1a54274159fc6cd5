"""Arrays as bytes, for files and for other processes: NumPy's format, without pickle.

Bytes may come from elsewhere. Sizes are compared before memory is reserved.
"""

from __future__ import annotations

import io
import math
import zipfile
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

SMALL: Final = 64_000_000  # [bytes] that any file may unpack to
RATIO: Final = 100  # of unpacked to packed size, above which a larger file is rejected
KINDS: Final = "biufcUS"  # kinds of numbers and texts


def bytes_of(**arrays: ArrayLike) -> bytes:
    """Return named arrays as the bytes of an .npz file; equal arrays give equal bytes."""
    stream = io.BytesIO()
    content: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
    np.savez(stream, **content)
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
