"""Experiments: the table, and everything about a single one."""

from __future__ import annotations

from typing import Annotated, Any, Final

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse, Response
from pydantic import ConfigDict, Field

from fixel.errors import NotStored
from fixel.io.document import plain_numbers
from fixel.model import Flag
from fixel.model.selection import ExperimentDetails, ExperimentRow, meant_filter
from fixel.web.context import Context, ProjectContext
from fixel.web.values import MAX_ID, Answer, Array, Number
from fixel.web.views.browser_video import browser_video
from fixel.web.views.video_outlines import VideoOutlines, outlines_in_video
from fixel.workflows.project.compare import summary
from fixel.workflows.project.filters import (
    Coverage,
    Vocabulary,
    coverage,
    known_names,
    view_of,
    vocabulary,
)

MAX_ROWS: Final = 500  # on one page
FOR_EVER: Final = "private, max-age=31536000, immutable"  # the address changes with the content

router = APIRouter(tags=["experiments"])

Filter = Annotated[
    str,
    Query(
        max_length=1000,
        description="words, `shape=square`, `error>5` [mm], `flag:NAME`, `is:faulty`, ...",
    ),
]
Sort = Annotated[str, Query(max_length=100, description="a column or a condition")]


class TableRow(Answer):
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
    flags: list[Flag]
    notes: int
    deleted: bool


class TablePage(Answer):
    """One page of the table."""

    experiments: list[TableRow]
    total: int = Field(description="that match, on this page or not")
    faulty: int = Field(description="of these, with a fault in their data")
    meant: str | None = Field(description="a filter that was perhaps meant, where nothing matches")


class ExperimentIds(Answer):
    """Ids of experiments."""

    ids: list[int]


class PoseTrack(Answer):
    """Poses against time."""

    time: Array = Field(description="(n,) [s]")
    pose: Array = Field(description="(n, 3) x [m], y [m], angle [rad]")


class MeasuredTrack(PoseTrack):
    """Measured poses against time."""

    object: str
    pusher: PoseTrack | None
    effective_s: list[float] | None = Field(description="first and last instant of useful data")


class StoredSimulation(Answer):
    """A stored simulation of an experiment."""

    id: int
    parameters: dict[str, float]
    status: str
    contacts: str
    error_mm: float | None = Field(description="root of the thesis's E")
    created_utc: str
    command: str
    method: dict[str, Any]
    track: PoseTrack
    pusher: PoseTrack | None


class StoredSimulations(Answer):
    """The newest simulations of an experiment, the newest first."""

    total: int
    simulations: list[StoredSimulation]


class Signal(Answer):
    """A channel."""

    name: str
    columns: list[str]
    time: Array = Field(description="(n,) [s]")
    values: Array = Field(description="(n, n_column); NaN where there was no reading")


class TactileSignals(Answer):
    """Contact signals of the fixels against time."""

    measured: Signal | None
    fixels: list[str]


class ExperimentOutlines(Answer):
    """Outlines over a video."""

    outlines: VideoOutlines | None = Field(description="none where the rig is not known")


class NoteText(Answer):
    """Note on an experiment."""

    id: int
    text: str
    created_utc: str = Field(validation_alias="created")


class ExperimentDetail(Answer):
    """All that is known of an experiment but for what is long."""

    model_config = ConfigDict(extra="allow")

    id: int
    key: str
    notes: list[NoteText]
    deleted: bool
    content: str
    has_video: bool


@router.get("/experiments", summary="One page of the table, sorted and filtered")
def table(
    context: Context,
    filter: Filter = "",
    sort: Sort = "id",
    descending: bool = False,
    limit: Annotated[int, Query(ge=1, le=MAX_ROWS)] = 100,
    offset: Annotated[int, Query(ge=0, le=MAX_ID)] = 0,
) -> TablePage:
    view = view_of(filter, sort=sort, descending=descending, limit=limit, offset=offset)
    page = context.store.experiments(view, details=True)
    return TablePage(
        experiments=[_table_row(*both) for both in zip(page.rows, page.details, strict=True)],
        total=page.total,
        faulty=page.faulty,
        meant=None if page.total else meant_filter(filter, known_names(context.store)),
    )


@router.get("/experiments/ids", summary="Ids of all that match, in order")
def ids(
    context: Context, filter: Filter = "", sort: Sort = "id", descending: bool = False
) -> ExperimentIds:
    view = view_of(filter, sort=sort, descending=descending)
    return ExperimentIds(ids=context.store.experiment_ids(view))


@router.get(
    "/experiments/unsimulated",
    summary="Ids of those that match and could have a simulation with nominal values",
)
def unsimulated(context: Context, filter: Filter = "") -> ExperimentIds:
    return ExperimentIds(ids=context.store.unsimulated_ids(view_of(filter)))


@router.get("/vocabulary", summary="What experiments can be told apart by")
def words(context: Context) -> Vocabulary:
    return vocabulary(context.store)


@router.get("/coverage", summary="Which configurations have been run")
def covered(
    context: Context,
    filter: Filter = "",
    x: Annotated[str | None, Query(max_length=100)] = None,
    y: Annotated[str | None, Query(max_length=100)] = None,
) -> Coverage:
    return coverage(context.store, view_of(filter), x, y)


@router.get("/experiments/{number}", summary="All that is known of an experiment")
def experiment(context: Context, number: Number) -> ExperimentDetail:
    store, one = context.store, context.store.experiment(number)
    return ExperimentDetail.model_validate(
        {
            "id": number,
            "key": one.key,
            "notes": store.notes(number),
            "deleted": store.deleted(number),
            "content": store.content(number)[:16],
            "has_video": bool(one.video),
            **plain_numbers(summary(one)),
        }
    )


@router.get("/experiments/{number}/trajectory", summary="Poses that were measured")
def trajectory(context: Context, number: Number) -> MeasuredTrack:
    one = context.store.experiment(number)
    return MeasuredTrack(
        object=one.object_name,
        time=one.trajectory.time,
        pose=one.trajectory.pose,
        pusher=None if one.pusher is None else PoseTrack.model_validate(one.pusher),
        effective_s=None if one.effective is None else list(one.effective),
    )


@router.get("/experiments/{number}/simulations", summary="Its newest stored simulations")
def simulations(
    context: Context, number: Number, limit: Annotated[int, Query(ge=1, le=100)] = 10
) -> StoredSimulations:
    context.store.content(number)  # raises if there is none
    stored = context.store.simulations(number)[::-1]
    return StoredSimulations(
        total=len(stored), simulations=[_simulation(context, one) for one in stored[:limit]]
    )


@router.get("/experiments/{number}/tactile", summary="Which fixel was touched when")
def tactile(context: Context, number: Number) -> TactileSignals:
    one = context.store.experiment(number)
    channel = one.channel("tactile")
    return TactileSignals(
        measured=None if channel is None else Signal.model_validate(channel),
        fixels=[] if one.scene is None else [fixel.name for fixel in one.scene.fixels],
    )


@router.get(
    "/experiments/{number}/thumbnail.svg",
    summary="A small picture of the run",
    response_class=Response,
    responses={200: {"content": {"image/svg+xml": {}}}},
)
def small_picture(
    context: Context,
    number: Number,
    content: Annotated[
        str, Query(max_length=64, description="its checksum: then the answer may be kept")
    ] = "",
) -> Response:
    picture = context.thumbnail(number, (content or context.store.content(number))[:16])
    headers = {"cache-control": FOR_EVER} if content else None
    return Response(picture, media_type="image/svg+xml", headers=headers)


@router.get(
    "/experiments/{number}/video",
    summary="Its video as a browser plays it, whole or by ranges",
    response_class=FileResponse,
    responses={200: {"content": {"video/mp4": {}}}, 206: {"description": "a range of it"}},
)
def video(context: Context, number: Number) -> Response:
    path = context.store.video(number)
    if path is None or not path.is_file():
        raise NotStored(f"video of experiment {number}", hint="it was recorded without one")
    found = browser_video(context.project, path)
    # The address stays when a correction brings another video, so it is validated each time.
    headers = {"cache-control": "private, no-cache"}
    return FileResponse(found.path, media_type=found.media_type, headers=headers)


@router.get("/experiments/{number}/outlines", summary="Where the object appears in its video")
def outlines(context: Context, number: Number) -> ExperimentOutlines:
    one = context.store.experiment(number)
    return ExperimentOutlines(outlines=outlines_in_video(context.project, one))


def _table_row(row: ExperimentRow, details: ExperimentDetails) -> TableRow:
    conditions = row.conditions
    return TableRow(
        id=row.id,
        dataset=row.dataset,
        name=row.name,
        real=row.is_real,
        shape=_text(conditions.get("shape")),
        layout=_text(conditions.get("layout")),
        frames=row.n_frame,
        duration_s=row.duration_s,
        start=[row.start_x_m, row.start_y_m, row.start_theta_rad],
        end=[row.end_x_m, row.end_y_m, row.end_theta_rad],
        moved_m=row.moved_m,
        turned_rad=row.turned_rad,
        contacts=row.contact_mode,
        conditions=conditions,
        created_utc=row.created_at_utc,
        content=details.content_sha256[:16],
        before_mm=_root(details.before_mm2),
        after_mm=_root(details.after_mm2),
        flags=list(details.flags),
        notes=len(details.notes),
        deleted=details.deleted_at_utc is not None,
    )


def _simulation(context: ProjectContext, number: int) -> StoredSimulation:
    record = context.store.simulation(number)
    return StoredSimulation(
        id=number,
        parameters=dict(record.parameters),
        status=record.status,
        contacts=record.contact_mode,
        error_mm=_root(record.error_mm2),
        created_utc=record.provenance.created,
        command=record.provenance.command,
        method=dict(record.method),
        track=PoseTrack.model_validate(record.trajectory),
        pusher=None if record.pusher is None else PoseTrack.model_validate(record.pusher),
    )


def _root(square: float | None) -> float | None:
    return None if square is None else square**0.5


def _text(value: str | float | None) -> str | None:
    return None if value is None else f"{value:g}" if isinstance(value, float) else value
