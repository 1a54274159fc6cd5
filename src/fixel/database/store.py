"""The only interface to a project's database; it takes and returns records, not rows."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Concatenate, Final, NamedTuple, ParamSpec, Protocol, TypeVar

import numpy as np
import sqlalchemy as sa

from fixel.database import marks, query, rows, schema
from fixel.database.engine import insert_one, open_engine, reading, set_journal, writing
from fixel.database.query import LIVE
from fixel.errors import LIST_EXPERIMENTS, NotStored, StoreRefused, closest, reason_of
from fixel.io.atomic import INVALID_CONTENT, usable
from fixel.model import Experiment, Flag, Scene, records

ABANDONED: Final = 86400.0  # [s] since its last change, an unfinished file has no program
_LIVE_CALIBRATION: Final = schema.calibration.c.deleted_at_utc.is_(None)
MAX_NAMES: Final = 20_000  # number of experiments that a mistyped name is compared with
T = TypeVar("T")
P = ParamSpec("P")


@contextmanager
def _damage_named(what: str) -> Iterator[None]:
    """Raise `StoreRefused` if a record is malformed."""
    try:
        yield
    except NotStored:
        raise
    except INVALID_CONTENT as problem:
        said = f"{what} is damaged: {reason_of(problem)}"
        raise StoreRefused(said, hint="list all errors: fixel db check") from problem


def _method(
    work: Callable[Concatenate[sa.Connection, P], T],
    transaction: Callable[[sa.Engine], AbstractContextManager[sa.Connection]] = reading,
) -> Callable[Concatenate[Store, P], T]:
    """Return the method of a store that calls a function in a transaction."""

    @functools.wraps(work)
    def method(store: Store, /, *given: P.args, **options: P.kwargs) -> T:
        with transaction(store._engine) as connection:
            return work(connection, *given, **options)

    return method


class ExperimentView(Protocol):
    """Function that changes experiments when they are loaded, as a file states."""

    path: Path
    sha256: str  # of its content

    def __call__(self, experiment: Experiment, /) -> Experiment: ...
    def of_scene(self, scene: Scene, /) -> Scene: ...


class AddResult(NamedTuple):
    """Id of an added record, and whether it was new."""

    id: int
    new: bool  # False if the same record was already stored
    replaced: int | None = None  # earlier experiment of the same name


class Store:
    """Experiments, simulations, parameters, calibrations and filter runs of one project.

    Guarantees on both SQLite and PostgreSQL:

    - Atomic: a record is stored completely or not at all, even if the power fails.
    - Durable: once a method that adds has returned, the record survives a power failure.
    - Shared: several processes may read and write at a time. Readers never wait; a writer waits for
      another for up to 20 s, then fails.
    - Frozen: stored records never change; triggers of the database reject changes. A correction is
      a new record, which listings show instead of the old one; a deletion can be undone.
    - Idempotent: adding an experiment, simulation or filter run that is stored adds nothing, also
      if two processes add it at a time, or one repeats the work of another that was killed.

    Parameters
    ----------
    url : str
        ``sqlite:///FILE`` or ``postgresql+psycopg://USER@HOST/DATABASE``.
    media : Path
        Folder of arrays and videos too large for the database. Several projects may share it.
    view : ExperimentView, optional
        Function that changes the experiments that `experiment` returns.

    Raises
    ------
    StoreRefused
        From the constructor and every method: the obstacle, and a command that helps.
    """

    def __init__(self, url: str, media: Path, view: ExperimentView | None = None) -> None:
        self.url = url
        self.media = media
        self.view = view
        self._engine = open_engine(url)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all connections to the database."""
        self._engine.dispose()

    # --- the schema -----------------------------------------------------------------------------

    def upgrade(self, version: str = "head") -> tuple[str | None, str | None]:
        """Upgrade the tables to a schema version; return the versions before and after."""
        set_journal(self._engine)
        with writing(self._engine) as connection:
            before = schema.version_of(connection)
            schema.upgrade(connection, version)
            return before, schema.version_of(connection)

    def check_version(self, command: str = "fixel db upgrade") -> None:
        """Raise `StoreRefused` if the tables have another version; `command` is the hint."""
        with reading(self._engine) as connection:
            schema.check_newest(connection, command)

    # --- experiments ----------------------------------------------------------------------------

    def add_experiment(self, experiment: Experiment) -> AddResult:
        """Store an experiment in its own transaction, unless it is stored already.

        If its dataset and name are taken, it replaces the newest experiment of that name.
        """
        row = rows.experiment_row(experiment)
        measured = rows.rows_of("experiment", rows.series_of(experiment), self.media)
        with writing(self._engine) as connection:
            known = self._known(connection, row["content_sha256"])
            if known is not None:
                return AddResult(known, False)
            return self._insert(connection, experiment, row, measured)

    def _known(self, connection: sa.Connection, content: str) -> int | None:
        key = schema.experiment.c
        found: int | None = connection.scalar(
            sa.select(key.id).where(key.content_sha256 == content)
        )
        return found

    def _insert(
        self,
        connection: sa.Connection,
        experiment: Experiment,
        row: dict[str, Any],
        measured: list[dict[str, Any]],
    ) -> AddResult:
        table = schema.experiment
        heights = experiment.height, experiment.pusher_height
        object_row, pusher_row = rows.geometries_of(row["scene"], experiment.object_name, *heights)
        replaced = connection.scalar(
            sa.select(sa.func.max(table.c.id)).where(
                table.c.dataset == experiment.dataset,
                table.c.name == experiment.name,
                table.c.deleted_at_utc.is_(None),
            )
        )
        linked = {
            "object_geometry_id": _same(connection, schema.geometry, object_row),
            "pusher_geometry_id": _same(connection, schema.geometry, pusher_row),
            "replaces_id": replaced,
        }
        experiment_id = _insert(connection, table, row | linked, measured)
        flags = [marks.flag_row(experiment_id, flag) for flag in experiment.flags]
        if flags:
            connection.execute(sa.insert(schema.flag), flags)
        return AddResult(experiment_id, True, replaced)

    def experiment(self, experiment_id: int) -> Experiment:
        """Load an experiment by its id."""
        flag = schema.flag
        with _damage_named(f"experiment {experiment_id}"), reading(self._engine) as connection:
            row = _row(connection, schema.experiment, experiment_id)
            flags = connection.execute(
                sa.select(flag.c.name, flag.c.detail, flag.c.is_fault).where(
                    flag.c.experiment_id == experiment_id, flag.c.deleted_at_utc.is_(None)
                )
            )
            measured = rows.read_all(connection, "experiment", experiment_id, self.media)
            found = rows.experiment_of(row, tuple(Flag(*f) for f in flags), measured)
        return found if self.view is None else self.view(found)

    def find(self, key: str) -> int:
        """Return the id of an experiment given as `id:7`, `7`, name or `dataset/name`.

        Raise `NotStored` if there is none, if several have the name, or if a number is the id of
        one experiment and the name of another.
        """
        number = key.removeprefix("id:")
        if key.startswith("id:") and number.isdecimal() and self._has(int(number)):
            return int(number)
        table = schema.experiment
        whole = table.c.dataset + "/" + table.c.name
        named = sa.select(table.c.id, whole).where(sa.or_(table.c.name == key, whole == key), *LIVE)
        with reading(self._engine) as connection:
            found: dict[int, str] = {row[0]: row[1] for row in connection.execute(named)}
        if key.isdecimal() and self._has(int(key)) and int(key) not in found:
            if not found:
                return int(key)
            raise NotStored(
                f"single experiment {key!r}: it is the id of one experiment and the name of "
                "another",
                hint=f"write id:{key} or {next(iter(found.values()))}",
            )
        if len(found) > 1:
            alike = len({*found.values()}) < len(found)
            names = [f"id:{number}" if alike else name for number, name in found.items()]
            raise NotStored(
                f"single experiment {key!r}: {len(found)} have that name",
                hint="write one of " + ", ".join(names[:5]),
            )
        if not found:
            raise _absent(f"experiment {key!r}", self._resembling(key))
        return next(iter(found))

    def replacement(self, experiment_id: int) -> int | None:
        """Return the id of the experiment of the same name that replaced this one, if any."""
        key = schema.experiment.c
        later = (key.replaces_id == experiment_id, key.deleted_at_utc.is_(None))
        with reading(self._engine) as connection:
            found: int | None = connection.scalar(sa.select(key.id).where(*later))
        return found

    def _resembling(self, key: str) -> str | None:
        """Hint with the stored name closest to an unknown one; None if none is close."""
        table = schema.experiment
        wanted = sa.select(table.c.dataset, table.c.name).where(*LIVE)
        with reading(self._engine) as connection:
            keys = connection.execute(wanted.order_by(table.c.id.desc()).limit(MAX_NAMES)).all()
        known = {name: f"{dataset}/{name}" for dataset, name in keys}
        known |= {whole: whole for whole in known.values()}
        meant = closest(key, known)
        return meant and f"did you mean {known[meant]!r}? {LIST_EXPERIMENTS}"

    def _has(self, experiment_id: int) -> bool:
        key = schema.experiment.c.id
        with reading(self._engine) as connection:
            return connection.scalar(sa.select(key).where(key == experiment_id)) is not None

    experiments = _method(query.browse)
    experiment_ids = _method(query.ids)
    unsimulated_ids = _method(query.unsimulated)
    tally = _method(query.tally)
    conditions = _method(query.conditions)
    checksum = _method(query.checksum)
    datasets = _method(query.datasets)
    flags = _method(query.flags)
    notes = _method(marks.notes_of)
    flag = _method(marks.flag, writing)
    unflag = _method(marks.unflag, writing)
    delete = _method(marks.delete, writing)
    annotate = _method(marks.annotate, writing)
    delete_notes = _method(marks.delete_notes, writing)

    def content(self, experiment_id: int) -> str:
        """Checksum of an experiment's content; equal only for equal experiments."""
        return str(self._experiment_row(experiment_id).content_sha256)

    def deleted(self, experiment_id: int) -> bool:
        """Whether an experiment is deleted."""
        return self._experiment_row(experiment_id).deleted_at_utc is not None

    def _experiment_row(self, experiment_id: int) -> sa.Row[Any]:
        with reading(self._engine) as connection:
            return _row(connection, schema.experiment, experiment_id)

    # --- videos ---------------------------------------------------------------------------------

    def add_video(self, file: Path) -> str:
        """Copy a video to the media folder; return its checksum, for `Experiment.video`."""
        for path in self.media.glob("??/.*"):  # left by programs that were killed
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > ABANDONED:
                    path.unlink()
        with usable(file, "a file to read"):
            return rows.keep(file.read_bytes(), self.media)

    def video(self, experiment_id: int) -> Path | None:
        """Path of an experiment's video; None if it has none."""
        digest = self._experiment_row(experiment_id).video_sha256
        return rows.media_path(digest, self.media) if digest else None

    # --- results --------------------------------------------------------------------------------

    def add_simulation(self, record: records.SimulationRecord) -> int:
        """Store a simulation of an experiment; return its id."""
        self._experiment_row(record.experiment_id)
        series = rows.paths_of(record.trajectory, record.pusher)
        with writing(self._engine) as connection:
            own = {"system_parameters_id": _parameters_id(connection, record.parameters)}
            return self._add_once(connection, schema.simulation, record, series, own)

    def simulation(self, simulation_id: int) -> records.SimulationRecord:
        """Load a simulation by its id."""
        with _damage_named(f"simulation {simulation_id}"), reading(self._engine) as connection:
            row = _row(connection, schema.simulation, simulation_id)
            series = rows.read_all(connection, "simulation", simulation_id, self.media)
            parameters = _row(connection, schema.system_parameters, row.system_parameters_id)
            paths = {name: rows.trajectory_of(values) for name, _, values in series}
            return rows.record_of(
                records.SimulationRecord,
                row,
                parameters=rows.parameters_of(parameters),
                trajectory=paths["object"],
                pusher=paths.get("pusher"),
            )

    def simulations(self, experiment_id: int) -> list[int]:
        """Ids of the simulations of an experiment, oldest first."""
        return self._ids(schema.simulation, schema.simulation.c.experiment_id == experiment_id)

    def published_simulations(self) -> dict[int, int]:
        """Ids of the simulations by the publishers of the data, by experiment."""
        table = schema.simulation
        chosen = sa.select(table.c.experiment_id, sa.func.max(table.c.id)).where(
            table.c.source_file != "", table.c.deleted_at_utc.is_(None)
        )
        with reading(self._engine) as connection:
            return {k: n for k, n in connection.execute(chosen.group_by(table.c.experiment_id))}

    def add_calibration(self, record: records.CalibrationRecord) -> int:
        """Store a finished calibration; return its id."""
        with writing(self._engine) as connection:
            return self._insert_calibration(connection, record)

    def add_calibrations(
        self,
        several: Sequence[records.CalibrationRecord],
        key: Callable[[records.CalibrationRecord], object],
    ) -> list[int]:
        """Store calibrations in one transaction, but those whose key is stored; return the ids.

        The key must not depend on evaluations, request and result.
        """
        with writing(self._engine) as connection:
            with _damage_named("a calibration"):
                stored = _calibrations(connection, _LIVE_CALIBRATION)
            known = {key(own): number for number, own in stored.items()}
            return [
                known.get(key(own)) or self._insert_calibration(connection, own) for own in several
            ]

    def _insert_calibration(
        self, connection: sa.Connection, record: records.CalibrationRecord
    ) -> int:
        tried = record.evaluations
        reasons = {} if tried is None else {str(k): r for k, r in enumerate(tried.reasons) if r}
        row = rows.columns_of(record, schema.calibration) | {
            "system_parameters_id": _parameters_id(connection, record.parameters),
            "n_evaluation": 0 if tried is None else len(tried.error),
            "n_member": len(record.members),
            "reasons": reasons,
            "estimates": [estimate.stored() for estimate in record.estimates] or None,
        }
        measured = rows.rows_of("calibration", rows.trials_of(tried), self.media)
        number = _insert(connection, schema.calibration, row, measured)
        members = [
            {"calibration_id": number, "place": place, **asdict(member)}
            for place, member in enumerate(record.members)
        ]
        connection.execute(sa.insert(schema.calibration_member), members)
        return number

    def calibration(self, calibration_id: int) -> records.CalibrationRecord:
        """Load a calibration by its id."""
        table = schema.calibration
        with _damage_named(f"calibration {calibration_id}"), reading(self._engine) as connection:
            row = _row(connection, table, calibration_id)
            record = _calibrations(connection, table.c.id == calibration_id)[calibration_id]
            series = rows.read_all(connection, "calibration", calibration_id, self.media)
            reasons = [row.reasons.get(str(k), "") for k in range(row.n_evaluation)]
            return replace(
                record,
                evaluations=rows.evaluations_of(series, reasons),
                request=row.request,
                result=row.result,
            )

    def calibration_summaries(self) -> dict[int, records.CalibrationRecord]:
        """Load all calibrations by id, oldest first, without evaluations, request and result: two
        queries and no file access, even for a thousand calibrations."""
        with _damage_named("a calibration"), reading(self._engine) as connection:
            return _calibrations(connection, _LIVE_CALIBRATION)

    def calibrations(self) -> list[int]:
        """Ids of all calibrations, oldest first."""
        return self._ids(schema.calibration)

    def record_ids(self) -> list[list[int]]:
        """Ids of all records that an analysis may read or select by; an id never changes."""
        kinds = ("experiment", "flag", "note", "simulation", "calibration")
        return [self._ids(getattr(schema, name)) for name in kinds]

    def add_filter_parameters(self, record: records.FilterParameters) -> int:
        """Store settings of a filter; return their id."""
        with writing(self._engine) as connection:
            own = {"options": dict(record.values)}
            return self._add_once(connection, schema.filter_parameters, record, [], own)

    def filter_parameters(self, filter_parameters_id: int) -> records.FilterParameters:
        """Load settings of a filter by their id."""
        with reading(self._engine) as connection:
            row = _row(connection, schema.filter_parameters, filter_parameters_id)
        return rows.record_of(records.FilterParameters, row, values=row.options)

    def add_filter_run(self, record: records.FilterRecord) -> int:
        """Store the run of a filter on an experiment; return its id."""
        self._experiment_row(record.experiment_id)
        series, hidden = rows.filtered_of(record), record.occlusion or (None, None)
        own = {"occlusion_start_s": hidden[0], "occlusion_end_s": hidden[1]}
        with writing(self._engine) as connection:
            return self._add_once(connection, schema.filter_run, record, series, own)

    def filter_run(self, filter_run_id: int) -> records.FilterRecord:
        """Load a filter run by its id."""
        with _damage_named(f"filter run {filter_run_id}"), reading(self._engine) as connection:
            row = _row(connection, schema.filter_run, filter_run_id)
            series = rows.read_all(connection, "filter_run", filter_run_id, self.media)
            found = {name: (columns, values) for name, columns, values in series}
            names, estimates = found.get("estimates", ((), np.zeros((0, 0))))
            hidden = (row.occlusion_start_s, row.occlusion_end_s)
            return rows.record_of(
                records.FilterRecord,
                row,
                trajectory=rows.trajectory_of(found["object"][1]),
                occlusion=None if hidden[0] is None else hidden,
                estimate_names=names,
                estimates=estimates,
            )

    def _ids(
        self, table: sa.Table, *where: sa.ColumnElement[bool], deleted: bool = False
    ) -> list[int]:
        """Ids of the rows of a table, oldest first, without deleted ones unless requested."""
        live = () if deleted else (table.c.deleted_at_utc.is_(None),)
        with reading(self._engine) as connection:
            wanted = sa.select(table.c.id).where(*live, *where)
            return list(connection.scalars(wanted.order_by(table.c.id)))

    def _add_once(
        self, connection: sa.Connection, table: sa.Table, record: Any,
        series: list[rows.Measured], own: dict[str, Any],
    ) -> int:  # fmt: skip
        """Insert a record with its series, unless an equal one is stored; return its id.

        The time of creation counts only if the record has one.
        """
        row = rows.columns_of(record, table) | own
        counted = [table.c[k] for k in row if k != "created_at_utc" or record.provenance.created]
        plain = [c == row[c.name] for c in counted if not isinstance(c.type, sa.JSON)]
        measured = rows.rows_of(table.name, series, self.media)
        alike = sa.select(table).where(table.c.deleted_at_utc.is_(None), *plain)
        for found in connection.execute(alike):
            same = all(found._mapping[c.name] == row[c.name] for c in counted)
            if same and rows.stored_rows(connection, table.name, found.id) == measured:
                return int(found.id)
        return _insert(connection, table, row, measured)


def _insert(
    connection: sa.Connection, table: sa.Table, row: dict[str, Any], measured: list[dict[str, Any]]
) -> int:
    """Insert a record with the rows of its series; return its id."""
    number = insert_one(connection, table, row)
    if measured:
        series = [one | {"owner_id": number} for one in measured]
        connection.execute(sa.insert(schema.series), series)
    return number


def _calibrations(
    connection: sa.Connection, *where: sa.ColumnElement[bool]
) -> dict[int, records.CalibrationRecord]:
    """Load calibrations by id, oldest first, without their evaluations, request and result."""
    table, member, sets = schema.calibration, schema.calibration_member, schema.system_parameters
    shown = [c for c in table.c if c.name not in ("request", "result")]
    wanted = (
        sa.select(*shown, *(c for c in sets.c if c.name not in ("id", "content_sha256")))
        .join(sets, sets.c.id == table.c.system_parameters_id)
        .where(*where)
        .order_by(table.c.id)
    )
    of = (
        sa.select(
            member.c.calibration_id, member.c.experiment_id, member.c.weight, member.c.error_mm2
        )
        .where(member.c.calibration_id.in_(sa.select(table.c.id).where(*where)))
        .order_by(member.c.calibration_id, member.c.place)
    )
    members: dict[int, list[records.Member]] = {}
    for calibration_id, *one in connection.execute(of):
        members.setdefault(calibration_id, []).append(records.Member(*one))
    return {
        row.id: rows.record_of(
            records.CalibrationRecord,
            row,
            parameters=rows.parameters_of(row),
            members=tuple(members[row.id]),
            estimates=rows.estimates_of(row.estimates),
        )
        for row in connection.execute(wanted)
    }


def _same(connection: sa.Connection, table: sa.Table, row: dict[str, Any] | None) -> int | None:
    """Id of the row with the same content, which is inserted if there is none."""
    if row is None:
        return None
    found = connection.scalar(
        sa.select(table.c.id).where(table.c.content_sha256 == row["content_sha256"])
    )
    return insert_one(connection, table, row) if found is None else int(found)


def _parameters_id(connection: sa.Connection, parameters: Mapping[str, float]) -> int:
    number = _same(connection, schema.system_parameters, rows.parameters_row(parameters))
    assert number is not None
    return number


def _row(connection: sa.Connection, table: sa.Table, number: int) -> sa.Row[Any]:
    row = connection.execute(sa.select(table).where(table.c.id == number)).one_or_none()
    if row is None:
        listed = "fixel calibrations lists those that are stored"
        what = f"{table.name.replace('_', ' ')} {number}"
        raise _absent(what, listed if table is schema.calibration else None)
    return row


def _absent(what: str, hint: str | None = None) -> NotStored:
    return NotStored(what, hint=hint or LIST_EXPERIMENTS)
