"""Arrays as bytes, for files and for other processes: NumPy's format, without pickle."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def bytes_of(**arrays: ArrayLike) -> bytes:
    """Return named arrays as the bytes of an .npz file; equal arrays give equal bytes."""
    stream = io.BytesIO()
    content: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
    np.savez(stream, **content)
    return stream.getvalue()


def arrays_of(data: bytes) -> dict[str, NDArray[Any]]:
    """Inverse of `bytes_of`."""
    with np.load(io.BytesIO(data), allow_pickle=False) as content:
        return {name: content[name] for name in content.files}
