"""Picture and choices of the page of next pushes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from pydantic import BaseModel

from fixel.calibration.known_pushes import PARTS, SURFACES
from fixel.database.store import Store

ARROW: Final = 0.28  # largest length of an arrow, as a share of the part
HEAD: Final = 0.05  # length of its head, likewise
MARGIN: Final = 0.09  # beyond the numbers, likewise


class PushArrow(BaseModel):
    """Arrow of one push, in the coordinates of the picture [mm], y down."""

    number: int
    x1: float
    y1: float
    x2: float
    y2: float
    head: str
    text_x: float
    text_y: float


class PushPicture(BaseModel):
    """Outline of a part with arrows, for an SVG in millimetres, y down."""

    box: str
    outline: str
    radius: float
    size: float
    arrows: list[PushArrow]


def push_picture(numbers: Mapping[str, Any]) -> PushPicture:
    """Return the picture of a stored proposal from its numbers."""
    flip = np.array([1e3, -1e3])
    outline = np.array(numbers["outline_m"]) * flip
    size = float(np.ptp(outline, axis=0).max())
    arrows, corners = [], [outline]
    for k, push in enumerate(numbers["pushes"], 1):
        start, end = (np.array(push[name]) * flip for name in ("start_m", "end_m"))
        length = math.dist(start, end) or 1.0
        way = (end - start) / length
        side = np.array([-way[1], way[0]])
        tail = start - min(length, ARROW * size) * way
        text = tail - 0.05 * size * way
        neck = start - HEAD * size * way
        head = [start, neck + 0.4 * HEAD * size * side, neck - 0.4 * HEAD * size * side]
        arrows.append(
            PushArrow(
                number=k, x1=tail[0], y1=tail[1], x2=neck[0], y2=neck[1], head=_points(head),
                text_x=text[0], text_y=text[1],
            )
        )  # fmt: skip
        corners.append(text[None])
    every = np.concatenate(corners)
    low, high = every.min(axis=0) - MARGIN * size, every.max(axis=0) + MARGIN * size
    box = " ".join(f"{x:.1f}" for x in (*low, *(high - low)))
    radius = 1e3 * float(numbers["radius_m"])
    return PushPicture(box=box, outline=_points(outline), radius=radius, size=size, arrows=arrows)


def _points(rows: Sequence[Any] | np.ndarray) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in rows)


def choices(store: Store) -> tuple[list[str], list[str]]:
    """Return the parts and the surfaces of the stored experiments."""
    known = store.conditions()

    def texts(names: tuple[str, ...]) -> list[str]:
        counts = {name: sum(known[name].texts.values()) for name in names if name in known}
        most = max(counts, key=lambda name: counts[name], default="")
        return sorted(known[most].texts) if most else []

    return texts(PARTS), texts(SURFACES)
