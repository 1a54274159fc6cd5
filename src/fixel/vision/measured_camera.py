"""Camera with the covariance of its errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, frozen, instance, positive, settle
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.lens import Lens

# Parameters of the lens, with OpenCV's names.
FOCAL: Final = ("fx", "fy", "cx", "cy", "skew")
BROWN: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE: Final = ("k1", "k2", "k3", "k4")
# Parameters of the place: a small rotation about the camera's axes [rad], after the camera's own,
# and the translation [m].
PLACE: Final = ("rx", "ry", "rz", "tx", "ty", "tz")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredCamera(Comparable):
    """Lens with its place, if known, and the covariance of their errors.

    Parameters
    ----------
    lens : Lens
    camera : Camera, optional
        Lens at its place above the plate; None before it was placed.
    names : tuple of str
        Measured parameters out of `FOCAL`, the lens's coefficients and `PLACE`; empty where errors
        are unknown.
    covariance : (n, n) array_like
        Covariance of these parameters, in pixels, radians and metres.
    noise : float, optional
        Standard deviation of a corner along each axis of the picture [px].
    seen : (n_row, n_column) array_like
        Number of board corners in each cell of the picture; empty where unknown.
    source : str
        Origin of the measurement, for messages.
    """

    lens: Lens
    camera: Camera | None = None
    names: tuple[str, ...] = ()
    covariance: FloatArray = ()  # type: ignore[assignment]
    noise: float | None = None
    seen: NDArray[np.float64] = ()  # type: ignore[assignment]
    source: str = ""

    def __post_init__(self) -> None:
        instance(self.lens, Lens, "camera.lens", "a Lens")
        if self.camera is not None and self.camera.lens != self.lens:
            raise InvalidInput("camera.lens", found="two lenses", expected="one")
        names = tuple(self.names)
        known = (*FOCAL, *(FISHEYE if self.lens.fisheye else BROWN), *PLACE)
        if len(set(names)) < len(names) or not set(names) <= set(known):
            raise InvalidInput(
                "measured.names", found=list(names), expected="each once of " + ", ".join(known)
            )
        covariance = _covariance(self.covariance, len(names))
        seen = frozen(self.seen)
        if seen.size and (seen.ndim != 2 or not np.isfinite(seen).all() or seen.min() < 0.0):
            raise InvalidInput("measured.seen", found=seen.tolist(), expected="rows of counts")
        noise = None if self.noise is None else positive(self.noise, "measured.noise", "px")
        settle(self, names=names, covariance=covariance, seen=seen, noise=noise)

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of each measured parameter [px, -, rad or m]."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def placed(self) -> Camera:
        """Return the camera at its place; raise if it was not placed."""
        if self.camera is None:
            raise InvalidInput(
                "camera.place",
                found=None,
                expected="where the camera is above the plate",
                hint="run: fixel camera place CAMERA PICTURE",
            )
        return self.camera

    def for_pictures_of(self, size: tuple[int, int], *, rescale: bool = False) -> MeasuredCamera:
        """Return the camera if its lens is for this size of picture; see `Lens.for_pictures_of`."""
        lens = self.lens.for_pictures_of(size, rescale=rescale)
        if lens is self.lens:
            return self
        scale = lens.image_size[0] / self.lens.image_size[0]
        grow = np.array([scale if name in FOCAL[:4] else 1.0 for name in self.names])
        return replace(
            self,
            lens=lens,
            camera=self.camera and replace(self.camera, lens=lens),
            covariance=self.covariance * grow[:, None] * grow,
            noise=self.noise and self.noise * scale,
        )


def _covariance(values: object, count: int) -> FloatArray:
    found = frozen(np.asarray(values, dtype=np.float64).reshape(-1) if not count else values)  # type: ignore[arg-type]
    if not count and not found.size:
        return frozen(np.zeros((0, 0)))
    if found.shape != (count, count) or not np.isfinite(found).all():
        raise InvalidInput(
            "measured.covariance",
            found=f"an array of {found.shape}",
            expected=f"{count} rows of {count} finite numbers, one a name",
        )
    scale = np.sqrt(np.abs(np.diag(found)))
    scale = np.where(scale > 0.0, scale, 1.0)
    unit = found / np.outer(scale, scale)
    if np.abs(unit - unit.T).max() > 1e-9 or np.linalg.eigvalsh(unit).min() < -1e-9:
        raise InvalidInput(
            "measured.covariance",
            found="a matrix that is no covariance",
            expected="a symmetric matrix without negative eigenvalues",
        )
    return frozen(0.5 * (found + found.T))
