"""Experiments: the table, and everything about a single one."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import TYPE_CHECKING, Annotated, Final, final

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse, Response

from fixel.database.browsing import ExperimentDetails, ExperimentRow
from fixel.drawing.thumbnail import thumbnail
from fixel.errors import NotStored
from fixel.formats.trajectory_file import plain_numbers
from fixel.model import Experiment, Trajectory
from fixel.web.api._experiments import (
    CoverageAxisOut,
    CoverageOut,
    ExperimentOut,
    ExperimentPageOut,
    ExperimentRowOut,
    FlagOut,
    IdsOut,
    NoteOut,
    OutlinesOut,
    SeenOut,
    SignalOut,
    SimulationOut,
    SimulationsOut,
    TactileOut,
    TrackOut,
    TrajectoryOut,
    ValuesOut,
    VocabularyOut,
)
from fixel.web.api._values import MAX_ID, Array, Number
from fixel.web.views.browser_video import watchable
from fixel.web.views.video_outlines import seen_in_video
from fixel.workflows.project.compare import summary
from fixel.workflows.project.filters import coverage, view_of, vocabulary
from fixel.workflows.project.suggestions import meant_filter

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

MAX_ROWS: Final = 500  # on one page
MAX_THUMBNAILS: Final = 5000  # in memory; about 2 kB each
FOR_EVER: Final = "private, max-age=31536000, immutable"  # the address changes with the content

Filter = Annotated[
    str,
    Query(
        max_length=1000,
        description="words, `shape=square`, `error>5` [mm], `flag:NAME`, `is:faulty`, ...",
    ),
]


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/experiments`, `/coverage` and `/vocabulary`."""
    found = APIRouter(tags=["experiments"])
    _add_table(found, desk)
    _add_one(found, desk)
    return found


def _add_table(router: APIRouter, desk: ProjectContext) -> None:
    @router.get("/experiments", summary="One page of the table, sorted and filtered")
    def table(
        filter: Filter = "",
        sort: Annotated[str, Query(max_length=100, description="a column or a condition")] = "id",
        descending: bool = False,
        limit: Annotated[int, Query(ge=1, le=MAX_ROWS)] = 100,
        offset: Annotated[int, Query(ge=0, le=MAX_ID)] = 0,
    ) -> ExperimentPageOut:
        view = view_of(filter, sort=sort, descending=descending, limit=limit, offset=offset)
        page = desk.store.experiments(view, details=True)
        rows = [row_out(*both) for both in zip(page.rows, page.details, strict=True)]
        meant = None if page.total else meant_filter(desk.store, filter)
        return ExperimentPageOut(
            experiments=rows, total=page.total, faulty=page.faulty, meant=meant
        )

    @router.get("/experiments/ids", summary="Ids of all that match, in order")
    def ids(
        filter: Filter = "",
        sort: Annotated[str, Query(max_length=100)] = "id",
        descending: bool = False,
    ) -> IdsOut:
        view = view_of(filter, sort=sort, descending=descending)
        return IdsOut(ids=desk.store.experiment_ids(view))

    @router.get(
        "/experiments/unsimulated",
        summary="Ids of those that match and could have a simulation with nominal values",
    )
    def unsimulated(filter: Filter = "") -> IdsOut:
        return IdsOut(ids=desk.store.unsimulated_ids(view_of(filter)))

    @router.get("/vocabulary", summary="What experiments can be told apart by")
    def words() -> VocabularyOut:
        known = vocabulary(desk.store)
        return VocabularyOut(
            datasets=known.datasets,
            flags=known.flags,
            conditions={k: ValuesOut(**v._asdict()) for k, v in known.conditions.items()},
        )

    @router.get("/coverage", summary="Which configurations have been run")
    def covered(
        filter: Filter = "",
        x: Annotated[str | None, Query(max_length=100)] = None,
        y: Annotated[str | None, Query(max_length=100)] = None,
    ) -> CoverageOut:
        found = coverage(desk.store, view_of(filter), x, y)
        axes = {
            name: CoverageAxisOut(
                name=axis.name, edges=axis.edges.tolist(), centres=axis.centres.tolist()
            )
            for name, axis in (("x", found.x), ("y", found.y))
        }
        return CoverageOut(
            **axes,
            number=found.number.astype(int).tolist(),
            shapes=list(found.shapes),
            layouts=list(found.layouts),
            table=found.table.astype(int).tolist(),
            axes=list(found.axes),
            without=found.without,
        )


def _add_one(router: APIRouter, desk: ProjectContext) -> None:
    store = desk.store
    drawn = Thumbnails(lambda number: thumbnail(store.experiment(number)))

    @router.get("/experiments/{number}", summary="All that is known of an experiment")
    def one(number: Number) -> ExperimentOut:
        return experiment_out(desk, number)

    @router.get("/experiments/{number}/trajectory", summary="Poses that were measured")
    def trajectory(number: Number) -> TrajectoryOut:
        experiment = store.experiment(number)
        return TrajectoryOut(
            object=experiment.object_name,
            **_track(experiment.trajectory),
            pusher=None if experiment.pusher is None else TrackOut(**_track(experiment.pusher)),
            effective_s=None if experiment.effective is None else list(experiment.effective),
        )

    @router.get("/experiments/{number}/simulations", summary="Its newest stored simulations")
    def simulations(
        number: Number, limit: Annotated[int, Query(ge=1, le=100)] = 10
    ) -> SimulationsOut:
        store.content(number)  # raises if there is none
        stored = store.simulations(number)[::-1]
        return SimulationsOut(
            total=len(stored), simulations=[_simulation(desk, one) for one in stored[:limit]]
        )

    @router.get("/experiments/{number}/tactile", summary="Which fixel was touched when")
    def tactile(number: Number) -> TactileOut:
        experiment = store.experiment(number)
        scene, channel = experiment.scene, experiment.channel("tactile")
        return TactileOut(
            measured=None
            if channel is None
            else SignalOut(
                name=channel.name,
                columns=list(channel.columns),
                time=Array.of(channel.time),
                values=Array.of(channel.values),
            ),
            fixels=[] if scene is None else [fixel.name for fixel in scene.fixels],
        )

    @router.get(
        "/experiments/{number}/thumbnail.svg",
        summary="A small picture of the run",
        response_class=Response,
        responses={200: {"content": {"image/svg+xml": {}}}},
    )
    def small(
        number: Number,
        content: Annotated[
            str, Query(max_length=64, description="its checksum: then the answer may be kept")
        ] = "",
    ) -> Response:
        picture = drawn.of(number, content or store.content(number))
        headers = {"cache-control": FOR_EVER} if content else None
        return Response(picture, media_type="image/svg+xml", headers=headers)

    @router.get(
        "/experiments/{number}/video",
        summary="Its video as a browser plays it, whole or by ranges",
        response_class=FileResponse,
        responses={200: {"content": {"video/mp4": {}}}, 206: {"description": "a range of it"}},
    )
    def video(number: Number) -> Response:
        path = store.video(number)
        if path is None or not path.is_file():
            raise NotStored(f"video of experiment {number}", hint="it was recorded without one")
        found = watchable(desk.project, path)
        # The address stays when a correction brings another video, so it is validated each time.
        headers = {"cache-control": "private, no-cache"}
        return FileResponse(found.path, media_type=found.media_type, headers=headers)

    @router.get("/experiments/{number}/outlines", summary="Where the object appears in its video")
    def outlines(number: Number) -> OutlinesOut:
        seen = seen_in_video(desk.project, store.experiment(number))
        if seen is None:
            return OutlinesOut(outlines=None)
        return OutlinesOut(
            outlines=SeenOut(
                size_px=list(seen.size),
                time_s=Array.of(seen.time),
                outline_px=Array.of(seen.outline, "<f4"),
            )
        )


def row_out(row: ExperimentRow, details: ExperimentDetails) -> ExperimentRowOut:
    """Convert a row of the table for JSON."""
    conditions = row.conditions
    return ExperimentRowOut(
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
        flags=[FlagOut(name=f.name, detail=f.detail, fault=f.fault) for f in details.flags],
        notes=details.notes,
        deleted=details.deleted_at_utc is not None,
    )


def experiment_out(desk: ProjectContext, number: int) -> ExperimentOut:
    """Return everything about an experiment except its long data, for JSON."""
    experiment: Experiment = desk.store.experiment(number)
    known = plain_numbers(summary(experiment))
    return ExperimentOut(
        id=number,
        key=experiment.key,
        notes=[
            NoteOut(id=note.id, text=note.text, created_utc=note.created)
            for note in desk.store.notes(number)
        ],
        deleted=desk.store.deleted(number),
        content=desk.store.content(number)[:16],
        has_video=bool(experiment.video),
        **known,
    )


def _simulation(desk: ProjectContext, number: int) -> SimulationOut:
    record = desk.store.simulation(number)
    return SimulationOut(
        id=number,
        parameters=dict(record.parameters),
        status=record.status,
        contacts=record.contact_mode,
        error_mm=_root(record.error_mm2),
        created_utc=record.provenance.created,
        command=record.provenance.command,
        method=dict(record.method),
        track=TrackOut(**_track(record.trajectory)),
        pusher=None if record.pusher is None else TrackOut(**_track(record.pusher)),
    )


def _track(trajectory: Trajectory) -> dict[str, Array]:
    return {"time": Array.of(trajectory.time), "pose": Array.of(trajectory.pose)}


def _root(square: float | None) -> float | None:
    return None if square is None else square**0.5


def _text(value: str | float | None) -> str | None:
    return None if value is None else f"{value:g}" if isinstance(value, float) else value


@final
class Thumbnails:
    """Small pictures that have been drawn, with the newest in memory.

    Parameters
    ----------
    draw : callable
        Returns the SVG of an experiment with an id.
    most : int
        Maximum number of pictures.
    """

    def __init__(self, draw: Callable[[int], str], most: int = MAX_THUMBNAILS) -> None:
        self._draw = draw
        self._most = most
        self._kept: OrderedDict[tuple[int, str], str] = OrderedDict()
        self._lock = Lock()

    def of(self, number: int, content: str) -> str:
        """Return the picture of an experiment whose content has this checksum."""
        key = (number, content[:16])
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        picture = self._draw(number)
        with self._lock:
            self._kept[key] = picture
            while len(self._kept) > self._most:
                self._kept.popitem(last=False)
        return picture
