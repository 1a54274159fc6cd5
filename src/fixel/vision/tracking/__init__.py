"""Tracking of parts in films, by tags, stickers or silhouettes."""

from fixel.vision.tracking.base import (
    AbstractFollower,
    AbstractTracking,
    FilmTracks,
    FoundFixel,
    PartObservation,
    PartTrack,
)
from fixel.vision.tracking.follow import AUTO, METHODS, track
from fixel.vision.tracking.silhouette import Silhouette
from fixel.vision.tracking.stickers import Stickers
from fixel.vision.tracking.tags import Tags

__all__ = [
    "AUTO",
    "METHODS",
    "AbstractFollower",
    "AbstractTracking",
    "FilmTracks",
    "FoundFixel",
    "PartObservation",
    "PartTrack",
    "Silhouette",
    "Stickers",
    "Tags",
    "track",
]
