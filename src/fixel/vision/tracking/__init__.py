"""Tracking of parts in films, by tags, stickers or silhouettes."""

from fixel.vision.tracking.base import (
    AbstractFollower as AbstractFollower,
    AbstractTracking as AbstractTracking,
    FilmTracks as FilmTracks,
    FoundFixel as FoundFixel,
    PartObservation as PartObservation,
    PartTrack as PartTrack,
)
from fixel.vision.tracking.follow import AUTO as AUTO, METHODS as METHODS, track as track
from fixel.vision.tracking.silhouette import Silhouette as Silhouette
from fixel.vision.tracking.stickers import Stickers as Stickers
from fixel.vision.tracking.tags import Tags as Tags
