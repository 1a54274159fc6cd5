"""Models of answers about experiments."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from fixel.web.api._values import Array


class FlagOut(BaseModel):
    """Something one should know before using an experiment."""

    name: str
    detail: str
    fault: bool = Field(description="whether analyses leave the experiment out")


class NoteOut(BaseModel):
    """Note on an experiment."""

    id: int
    text: str
    created_utc: str


class ExperimentRowOut(BaseModel):
    """A line of the table."""

    id: int
    dataset: str
    name: str
    real: bool
    shape: str | None
    layout: str | None
    frames: int
    duration_s: float
    start: list[float] = Field(description="x [m], y [m], angle [rad]")
    end: list[float] = Field(description="x [m], y [m], angle [rad]")
    moved_m: float
    turned_rad: float
    contacts: str = Field(description="measured at the end, a digit a fixel")
    conditions: dict[str, str | float]
    created_utc: str
    content: str = Field(description="beginning of the checksum of its content")
    before_mm: float | None = Field(
        description="root of the thesis's E, of the newest stored simulation with nominal values"
    )
    after_mm: float | None = Field(description="the same, of the newest calibration it is part of")
    flags: list[FlagOut]
    notes: int
    deleted: bool


class ExperimentPageOut(BaseModel):
    """One page of the table."""

    experiments: list[ExperimentRowOut]
    total: int = Field(description="that match, on this page or not")
    faulty: int = Field(description="of these, with a fault in their data")
    meant: str | None = Field(description="a filter that was perhaps meant, where nothing matches")


class IdsOut(BaseModel):
    """Ids of experiments."""

    ids: list[int]


class ValuesOut(BaseModel):
    """Values of a condition."""

    texts: dict[str, int]
    low: float | None
    high: float | None
    total: int


class VocabularyOut(BaseModel):
    """Names and values by which experiments can be filtered."""

    datasets: dict[str, int]
    flags: dict[str, int]
    conditions: dict[str, ValuesOut]


class CoverageAxisOut(BaseModel):
    """An axis of the coverage."""

    name: str
    edges: list[float]
    centres: list[float]


class CoverageOut(BaseModel):
    """Number of experiments at each place of a plane of configurations."""

    x: CoverageAxisOut
    y: CoverageAxisOut
    number: list[list[int]] = Field(description="a row for each place along x")
    shapes: list[str]
    layouts: list[str]
    table: list[list[int]] = Field(description="a row a shape, a column a layout")
    axes: list[str] = Field(description="names that an axis may have")
    without: int = Field(description="experiments that have no such value")


class TrackOut(BaseModel):
    """Poses against time."""

    time: Array = Field(description="(n,) [s]")
    pose: Array = Field(description="(n, 3) x [m], y [m], angle [rad]")


class TrajectoryOut(TrackOut):
    """Measured poses against time."""

    object: str
    pusher: TrackOut | None
    effective_s: list[float] | None = Field(description="first and last instant of useful data")


class SimulationOut(BaseModel):
    """A stored simulation of an experiment."""

    id: int
    parameters: dict[str, float]
    status: str
    contacts: str
    error_mm: float | None = Field(description="root of the thesis's E")
    created_utc: str
    command: str
    method: dict[str, Any]
    track: TrackOut
    pusher: TrackOut | None


class SimulationsOut(BaseModel):
    """The newest simulations of an experiment, the newest first."""

    total: int
    simulations: list[SimulationOut]


class SignalOut(BaseModel):
    """A channel."""

    name: str
    columns: list[str]
    time: Array = Field(description="(n,) [s]")
    values: Array = Field(description="(n, n_column); NaN where there was no reading")


class TactileOut(BaseModel):
    """Which fixel was touched when."""

    measured: SignalOut | None
    fixels: list[str]


class SeenOut(BaseModel):
    """Outlines of the object in pictures of this size."""

    size_px: list[int] = Field(description="width, height")
    time_s: Array = Field(description="(n,)")
    outline_px: Array = Field(description="(n, m, 2) closed lines; the first pixel's middle is 0")


class OutlinesOut(BaseModel):
    """Outlines over a video."""

    outlines: SeenOut | None = Field(description="none where the rig is not known")


class ExperimentOut(BaseModel):
    """All that is known of an experiment but for what is long."""

    model_config = ConfigDict(extra="allow")

    id: int
    key: str
    notes: list[NoteOut]
    deleted: bool
    content: str
    has_video: bool
