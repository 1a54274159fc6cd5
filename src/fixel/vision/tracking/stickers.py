"""Tracking of parts by coloured stickers, as in the thesis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar, Final, final

import numpy as np

from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig, Sticker
from fixel.vision.tracking.base import (
    AbstractFollower,
    AbstractTracking,
    PartFollower,
    PartFollowers,
    PartObservation,
    Thing,
    vague,
)
from fixel.vision.tracking.colour import find_patches, fit_sticker
from fixel.vision.tracking.tags import rigid

STICKER_REACH: Final = 6.0  # [px] from the expected sticker
APART: Final = 0.6e-3  # [m] at 0.55 mm per pixel: largest error of distances between stickers
MAX_RESIDUAL: Final = 0.7  # [px]
WIDER: Final = 20  # [px] added to the search margin around the last place
MIN_SHARE: Final = 0.35  # of a sticker's edge


@final
@dataclass(frozen=True, slots=True)
class Stickers(AbstractTracking):
    """Tracking by round stickers of one colour each, two or more per part.

    Stickers are found by hue and followed by their edges; see `colour.fit_sticker`. Distances that
    differ from those in the rig show that another object was taken for a sticker.

    Source
    ------
    The thesis's appendix on tracking: two coloured stickers on object and actuator.
    """

    name: ClassVar[str] = "stickers"
    needs: ClassVar[str] = "two stickers, since one does not determine an angle"

    def parts(self, rig: Rig, things: Mapping[str, Thing]) -> tuple[str, ...]:
        """Parts with at least two stickers."""
        return tuple(name for name in rig.parts if len(_stickers(rig, name)) >= 2)

    def follow(self, rig: Rig, things: Mapping[str, Thing]) -> AbstractFollower:
        """Create a follower; see `AbstractTracking.follow`."""
        everything = tuple(sticker for name in rig.parts for sticker in _stickers(rig, name))
        return PartFollowers(
            {
                name: _StickeredPart(rig.camera, _stickers(rig, name), everything)
                for name in self.parts(rig, things)
            }
        )


def _stickers(rig: Rig, name: str) -> tuple[Sticker, ...]:
    return tuple(mark for mark in rig.parts[name].marks if isinstance(mark, Sticker))


@final
class _StickeredPart(PartFollower):
    """Follower of one part from frame to frame."""

    def __init__(
        self, camera: Camera, own: tuple[Sticker, ...], everything: tuple[Sticker, ...]
    ) -> None:
        super().__init__()
        self._camera = camera
        self._own = own
        self._everything = everything
        self._scale = camera.metres_per_pixel(max(sticker.height for sticker in own))
        self._place = np.array([sticker.place for sticker in own])

    def _measured(self, frame: Frame, pose: FloatArray) -> PartObservation:
        return self._fitted(frame, placed(self._place, pose))

    def _searched(self, frame: Frame, followed: PartObservation) -> PartObservation:
        found, reason = self._found(frame)
        return PartObservation(reason=reason) if found is None else self._fitted(frame, found)

    def _fitted(self, frame: Frame, places: FloatArray) -> PartObservation:
        """Measure the pose from stickers near places (n, 2) [m]."""
        fits = [
            fit_sticker(frame, self._camera, sticker, place, STICKER_REACH)
            for sticker, place in zip(self._own, places, strict=True)
        ]
        missing = [fit for fit in fits if isinstance(fit, str)]
        good = [
            (k, fit)
            for k, fit in enumerate(fits)
            if not isinstance(fit, str) and fit.share >= MIN_SHARE and fit.residual <= MAX_RESIDUAL
        ]
        if len(good) < 2:
            return PartObservation(reason=missing[0] if missing else "its stickers are not round")
        index = [k for k, _ in good]
        seen = np.array([fit.pose[:2] for _, fit in good])
        own = self._place[index]
        wrong = self._wrong_distance(index, own, seen)
        if wrong:
            return PartObservation(reason=wrong)
        pose = rigid(own, seen)
        sd = spread_of(seen, [fit.covariance[:2, :2] for _, fit in good])
        if vague(sd, self._scale):
            return PartObservation(
                reason="too little of its stickers is visible to estimate a pose"
            )
        off = np.hypot(*(placed(own, pose) - seen).T) / self._scale
        return PartObservation(
            pose=pose,
            residual=max(_rms(off), float(np.mean([fit.residual for _, fit in good]))),
            scale=self._scale,
            sd=sd,
            marks=len(good),
            share=float(np.mean([fit.share for _, fit in good])),
        )

    def _wrong_distance(self, index: list[int], own: FloatArray, seen: FloatArray) -> str:
        slack = APART * self._scale / 0.55e-3
        for i, j in combinations(range(len(own)), 2):
            should = float(np.hypot(*(own[i] - own[j])))
            found = float(np.hypot(*(seen[i] - seen[j])))
            if abs(found - should) > slack:
                a, b = self._own[index[i]].colour, self._own[index[j]].colour
                return (
                    f"the {a} and {b} stickers are {found * 1e3:.2f} mm apart, "
                    f"not {should * 1e3:.2f} mm as in the rig"
                )
        return ""

    def _found(self, frame: Frame) -> tuple[FloatArray | None, str]:
        """Search for the stickers by colour; return places (n, 2) [m], or None and the reason."""
        rows, columns = self._where(frame)
        corner = np.array([columns.start or 0, rows.start or 0], dtype=np.float64)
        patches = find_patches(
            frame.picture[rows, columns], self._own, self._everything, self._camera, corner
        )
        places = []
        for sticker in self._own:
            candidates = patches[sticker.colour]
            if not candidates:
                return None, f"no {sticker.colour} sticker in the picture"
            if len(candidates) > 1:
                at = " and ".join(f"({u:.0f}, {v:.0f}) px" for u, v in candidates)
                return None, (
                    f"{len(candidates)} regions of the colour of the {sticker.colour} sticker, at "
                    f"{at}: remove or mask the others"
                )
            places.append(self._camera.on_plane(candidates[0], sticker.height))
        return np.array(places), ""

    def _where(self, frame: Frame) -> tuple[slice, slice]:
        last = self._search_near
        if last is None:
            return slice(None), slice(None)
        pixel = np.array(
            [
                self._camera.project_at(place, sticker.height)
                for place, sticker in zip(placed(self._place, last), self._own, strict=True)
            ]
        )
        width, height = frame.size
        margin = WIDER + self._search_margin
        low = np.maximum(pixel.min(0).astype(int) - margin, 0)
        high = np.minimum(pixel.max(0).astype(int) + margin, (width, height))
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def spread_of(seen: FloatArray, covariances: Sequence[FloatArray]) -> FloatArray:
    """Standard deviations (3,) of a pose from places (n, 2) and their covariances (2, 2)."""
    information = np.zeros((3, 3))
    for (x, y), covariance in zip(seen - seen.mean(0), covariances, strict=True):
        row = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        information += row.T @ np.linalg.inv(covariance) @ row
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))
