"""Decoded pictures whose colours are computed only in the requested window."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np

from fixel.vision.frame import LUMA, Gray, Picture

# Formats with separate colour planes, and how many pixels across and down share a value.
SHARED: Final = {
    "yuv420p": (2, 2),
    "yuvj420p": (2, 2),
    "yuv422p": (2, 1),
    "yuvj422p": (2, 1),
    "yuv444p": (1, 1),
    "yuvj444p": (1, 1),
}
BRIGHT_FIRST: Final = (*SHARED, "gray", "nv12")  # formats whose first plane is brightness

# Rec. 601: coefficients of the colour differences u and v in red, green and blue.
RED_V, GREEN_U, GREEN_V, BLUE_U = 1.402, 0.344136, 0.714136, 1.772
FULL_RANGE: Final = 2  # AVCOL_RANGE_JPEG


@final
class DecodedPlanes:
    """Planes of a decoded PyAV frame, for `Frame`.

    Parameters
    ----------
    decoded : av.VideoFrame
    """

    __slots__ = ("_decoded", "_format", "_full", "_size")

    def __init__(self, decoded: Any) -> None:
        self._decoded = decoded
        self._format: str = decoded.format.name
        self._full = self._format.startswith("yuvj") or int(decoded.color_range) == FULL_RANGE
        self._size: tuple[int, int] = (decoded.width, decoded.height)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self._size

    def luma(self) -> Gray:
        """Brightness of the picture as stored, (height, width)."""
        if self._format in BRIGHT_FIRST:
            return self._plane(0, *self._size)
        return np.asarray(np.rint(self._all() @ LUMA), dtype=np.uint8)

    def colour(self, rows: slice, columns: slice) -> Picture:
        """Colours of a window, (height, width, 3): blue, green, red."""
        width, height = self._size
        top, bottom, _ = rows.indices(height)
        left, right, _ = columns.indices(width)
        whole = (top, bottom, left, right) == (0, height, 0, width)
        if whole or self._format not in SHARED:
            return self._all()[rows, columns]
        return self._window(top, bottom, left, right)

    def _all(self) -> Picture:
        options = {"src_colorspace": "itu601"} if self._format.startswith("yuv") else {}
        return np.asarray(self._decoded.to_ndarray(format="bgr24", **options), dtype=np.uint8)

    def _plane(self, index: int, width: int, height: int) -> Gray:
        plane = self._decoded.planes[index]
        row = plane.line_size
        return np.frombuffer(plane, np.uint8, row * height).reshape(height, row)[:, :width]

    def _window(self, top: int, bottom: int, left: int, right: int) -> Picture:
        """Convert only a window to blue, green, red, with the same formula as `_all`."""
        width, height = self._size
        across, down = SHARED[self._format]
        coarse = -(-width // across), -(-height // down)
        ys = slice(top // down, -(-bottom // down))
        xs = slice(left // across, -(-right // across))
        fine = (
            slice(top % down, top % down + bottom - top),
            slice(left % across, left % across + right - left),
        )
        y = self._plane(0, width, height)[top:bottom, left:right].astype(np.float32)
        u, v = (
            self._plane(k, *coarse)[ys, xs].repeat(down, 0).repeat(across, 1)[fine]
            - np.float32(128)
            for k in (1, 2)
        )
        if not self._full:
            y = (y - 16.0) * np.float32(255.0 / 219.0)
            u *= np.float32(255.0 / 224.0)
            v *= np.float32(255.0 / 224.0)
        out = np.empty((*y.shape, 3), np.float32)
        out[..., 0] = y + BLUE_U * u
        out[..., 1] = y - GREEN_U * u - GREEN_V * v
        out[..., 2] = y + RED_V * v
        return np.clip(np.rint(out), 0.0, 255.0).astype(np.uint8)
