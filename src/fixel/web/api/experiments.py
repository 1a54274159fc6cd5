"""Experiments: the table, and everything about a single one."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse, Response
from pydantic import ConfigDict, Field

from fixel.database.project import known_names
from fixel.errors import NotStored
from fixel.io.document import plain_numbers
from fixel.model import Flag
from fixel.model.selection import ExperimentDetails, ExperimentRow, meant_filter
from fixel.web.context import Context, ProjectContext
from fixel.web.values import MAX_ID, Answer, Array, Id, Whole
from fixel.web.views.video import VideoOutlines, browser_video, outlines_in_video
from fixel.workflows.project import filters
from fixel.workflows.project.compare import summary

MAX_ROWS: Final = 500  # on one page
FOR_EVER: Final = "private, max-age=31536000, immutable"  # the address changes with the content

router = APIRouter(tags=["experiments"])

Filter = Annotated[
    str,
    Query(
        max_length=1000,
        description="filter: words, `shape=square`, `error>5` [mm], `flag:NAME`, `is:faulty`, ...",
    ),
]
Sort = Annotated[str, Query(max_length=100, description="column or condition to sort by")]


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
    start: list[float] = Field(description="pose: x [m], y [m], angle [rad]")
    end: list[float] = Field(description="pose: x [m], y [m], angle [rad]")
    moved_m: float
    turned_rad: float
    contacts: str = Field(description="measured contact mode at the end, one digit per fixel")
    conditions: dict[str, str | float]
    created_utc: str
    content: str = Field(description="first digits of the checksum of the content")
    before_mm: float | None = Field(
        description="square root of the E of the newest stored simulation with nominal values"
    )
    after_mm: float | None = Field(
        description="square root of the E in the newest calibration of this experiment"
    )
    flags: list[Flag]
    notes: int
    deleted: bool


class TablePage(Answer):
    """One page of the table."""

    experiments: list[TableRow]
    total: int = Field(description="number of matching experiments on all pages")
    faulty: int = Field(description="number of these whose data have faults")
    meant: str | None = Field(description="filter that was probably meant, if nothing matches")


class PoseTrack(Answer):
    """Poses against time."""

    time: Array = Field(description="(n,) times [s]")
    pose: Array = Field(description="(n, 3) poses: x [m], y [m], angle [rad]")


class MeasuredTrack(PoseTrack):
    """Measured poses against time."""

    object: str
    pusher: PoseTrack | None
    effective_s: list[float] | None = Field(description="first and last time of usable data")


class StoredSimulation(Answer):
    """A stored simulation of an experiment."""

    id: int
    parameters: dict[str, float]
    status: str
    contacts: str
    error_mm: float | None = Field(description="square root of the E of the thesis")
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
    time: Array = Field(description="(n,) times [s]")
    values: Array = Field(description="(n, n_column) readings; NaN if missing")


class TactileSignals(Answer):
    """Contact signals of the fixels against time."""

    measured: Signal | None
    fixels: list[str]


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
    replaced_by: int | None
    content: str
    has_video: bool


@router.get("/experiments", summary="Get a page of the table, sorted and filtered")
def table(
    context: Context,
    filter: Filter = "",
    sort: Sort = "id",
    descending: bool = False,
    limit: Annotated[Whole, Query(ge=1, le=MAX_ROWS)] = 100,
    offset: Annotated[Whole, Query(ge=0, le=MAX_ID)] = 0,
) -> TablePage:
    view = filters.view_of(filter, sort=sort, descending=descending, limit=limit, offset=offset)
    page = context.store.experiments(view, details=True)
    return TablePage(
        experiments=[_table_row(*both) for both in zip(page.rows, page.details, strict=True)],
        total=page.total,
        faulty=page.faulty,
        meant=None if page.total else meant_filter(filter, known_names(context.store)),
    )


@router.get("/experiments/ids", summary="List ids of all matching experiments, in order")
def ids(
    context: Context, filter: Filter = "", sort: Sort = "id", descending: bool = False
) -> dict[Literal["ids"], list[int]]:
    view = filters.view_of(filter, sort=sort, descending=descending)
    return {"ids": context.store.experiment_ids(view)}


@router.get(
    "/experiments/unsimulated",
    summary="List ids of matching experiments without a simulation with nominal values",
)
def unsimulated(context: Context, filter: Filter = "") -> dict[Literal["ids"], list[int]]:
    return {"ids": context.store.unsimulated_ids(filters.view_of(filter))}


@router.get("/vocabulary", summary="List conditions and their values")
def words(context: Context) -> filters.Vocabulary:
    return filters.vocabulary(context.store)


@router.get("/coverage", summary="Count experiments by configuration")
def covered(
    context: Context,
    filter: Filter = "",
    x: Annotated[str | None, Query(max_length=100)] = None,
    y: Annotated[str | None, Query(max_length=100)] = None,
) -> filters.Coverage:
    return filters.coverage(context.store, filters.view_of(filter), x, y)


@router.get("/experiments/{number}", summary="Get an experiment")
def experiment(context: Context, number: Id) -> ExperimentDetail:
    store, one = context.store, context.store.experiment(number)
    return ExperimentDetail.model_validate(
        {
            "id": number,
            "key": one.key,
            "notes": store.notes(number),
            "deleted": store.deleted(number),
            "replaced_by": store.replacement(number),
            "content": store.content(number)[:16],
            "has_video": bool(one.video),
            **plain_numbers(summary(one)),
        }
    )


@router.get("/experiments/{number}/trajectory", summary="Get the measured poses")
def trajectory(context: Context, number: Id) -> MeasuredTrack:
    one = context.store.experiment(number)
    return MeasuredTrack(
        object=one.object_name,
        time=one.trajectory.time,
        pose=one.trajectory.pose,
        pusher=None if one.pusher is None else PoseTrack.model_validate(one.pusher),
        effective_s=None if one.effective is None else list(one.effective),
    )


@router.get(
    "/experiments/{number}/simulations",
    summary="List the newest stored simulations of an experiment",
)
def simulations(
    context: Context, number: Id, limit: Annotated[Whole, Query(ge=1, le=100)] = 10
) -> StoredSimulations:
    context.store.content(number)  # raises if there is none
    stored = context.store.simulations(number)[::-1]
    return StoredSimulations(
        total=len(stored), simulations=[_simulation(context, one) for one in stored[:limit]]
    )


@router.get("/experiments/{number}/tactile", summary="Get the readings of the contact sensors")
def tactile(context: Context, number: Id) -> TactileSignals:
    one = context.store.experiment(number)
    channel = one.channel("tactile")
    return TactileSignals(
        measured=None if channel is None else Signal.model_validate(channel),
        fixels=[] if one.scene is None else [fixel.name for fixel in one.scene.fixels],
    )


@router.get(
    "/experiments/{number}/thumbnail.svg",
    summary="Get a thumbnail of the motion",
    response_class=Response,
    responses={200: {"content": {"image/svg+xml": {}}}},
)
def small_picture(
    context: Context,
    number: Id,
    content: Annotated[
        str,
        Query(
            max_length=64, description="checksum of the content; with it, the answer may be cached"
        ),
    ] = "",
) -> Response:
    picture = context.thumbnail(number, (content or context.store.content(number))[:16])
    headers = {"cache-control": FOR_EVER} if content else None
    return Response(picture, media_type="image/svg+xml", headers=headers)


@router.get(
    "/experiments/{number}/video",
    summary="Get the video in a format for browsers, whole or in ranges",
    response_class=FileResponse,
    responses={
        200: {"content": {"video/mp4": {}}},
        206: {"description": "a range within the file"},
    },
)
def video(context: Context, number: Id) -> Response:
    path = context.store.video(number)
    if path is None or not path.is_file():
        raise NotStored(
            f"video of experiment {number}", hint="this experiment was recorded without video"
        )
    playable, media_type = browser_video(context.project, path)
    # The address stays when a correction brings another video, so it is validated each time.
    headers = {"cache-control": "private, no-cache"}
    return FileResponse(playable, media_type=media_type, headers=headers)


@router.get("/experiments/{number}/outlines", summary="Get the outline of the object in the video")
def outlines(context: Context, number: Id) -> dict[Literal["outlines"], VideoOutlines | None]:
    one = context.store.experiment(number)
    return {"outlines": outlines_in_video(context.project, one)}


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
