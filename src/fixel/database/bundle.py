"""Export and import of bundles: experiments and all results computed from them, in one file.

A bundle is a zip of a manifest with the checksums of all members, a file of JSON lines for each
kind of record, numeric tables as npy files, and videos; both are named by their checksum. The
same records always give the same bytes.

A bundle includes flagged experiments and those replaced by a correction, but not deleted ones:
a deletion means that the experiment should not be passed on.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar, final

import sqlalchemy as sa
from pydantic import ValidationError

import fixel
from fixel.database import arrays, rows, tables
from fixel.database.bundle_file import (
    CHUNK,
    FILES,
    FORMAT,
    LIMITS,
    MANIFEST,
    VERSION,
    BundleFile,
    BundleLimits,
    first_of,
    npy_of,
)
from fixel.database.bundle_lines import (
    CalibrationLine,
    ExperimentLine,
    FilterParametersLine,
    FilterRunLine,
    FlagLine,
    NoteLine,
    ParametersLine,
    SimulationLine,
)
from fixel.database.engine import reading, writing
from fixel.database.query import ExperimentQuery
from fixel.database.rows import Measured
from fixel.database.store import Store
from fixel.errors import InvalidInput, StoreRefused
from fixel.io.atomic import written_whole
from fixel.model import Parameters
from fixel.model.records import CalibrationRecord, FilterRun, SimulationRecord
from fixel.typing import Progress

_T = TypeVar("_T")

# Earliest date of the zip format, so that bundles of the same records are equal bit for bit.
_INSTANT: Final = (1980, 1, 1, 0, 0, 0)
_FILE_MODE: Final = 0o100644 << 16


# --- export -------------------------------------------------------------------------------------


@final
@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class ExportSummary:
    """Numbers of exported and of omitted records.

    Attributes
    ----------
    counts : dict of str to int
        Records of each kind; ``flagged`` and ``replaced`` count experiments with these marks.
    left_out : dict of str to int
        ``deleted`` experiments, and ``calibrations`` that use an experiment outside the bundle.
    """

    counts: dict[str, int]
    left_out: dict[str, int]


def export_bundle(
    store: Store,
    path: Path,
    *,
    dataset: str | None = None,
    progress: Progress | None = None,
) -> ExportSummary:
    """Write a bundle of a project's experiments, or of one dataset, and the results from them.

    Parameters
    ----------
    store : Store
    path : Path
        Bundle to write, a ``.zip``; replaced atomically once it is complete.
    dataset : str, optional
    progress : callable, optional
        Called with the number of exported experiments and their total.

    Raises
    ------
    InvalidInput
        The file cannot be written.
    StoreRefused
        A series or a video is missing in the media folder, or has changed.
    """
    ids = _ids(store, dataset)
    with written_whole(path) as unfinished:
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
            found = _Writer(store, archive, ids, whole=dataset is None).write(progress)
        _to_disk(unfinished)
    deleted = store.experiments(
        ExperimentQuery(dataset=dataset, marks=("deleted", "replaced"), limit=0)
    ).total
    found.left_out["deleted"] = deleted
    found.counts["flagged"] = store.experiments(ExperimentQuery(dataset=dataset, limit=0)).left_out
    current = store.experiments(
        ExperimentQuery(dataset=dataset, include_faulty=True, limit=0)
    ).total
    found.counts["replaced"] = len(ids) - current
    return found


def _ids(store: Store, dataset: str | None) -> list[int]:
    query = ExperimentQuery(dataset=dataset, include_faulty=True, marks=("replaced",))
    return store.experiment_ids(query)


def _to_disk(path: Path) -> None:
    with path.open("rb+") as stream:
        os.fsync(stream.fileno())


@final
class _Writer:
    """Writer of one bundle into a zip archive."""

    def __init__(
        self, store: Store, archive: zipfile.ZipFile, ids: list[int], *, whole: bool
    ) -> None:
        self._store = store
        self._archive = archive
        self._ids = ids
        self._place = {number: place for place, number in enumerate(ids)}
        self._whole = whole  # also export filter settings that no run has used
        self._members: dict[str, dict[str, Any]] = {}
        self._parameters: dict[Parameters, int] = {}

    def write(self, progress: Progress | None) -> ExportSummary:
        """Write all records, then the manifest."""
        kept, left_out = self._calibrations()
        settings = self._settings()
        files: dict[str, Iterable[dict[str, Any]]] = {
            "experiments.jsonl": self._experiments(progress),
            "simulations.jsonl": self._simulations(),
            "calibrations.jsonl": map(self._calibration, kept),
            "filter_parameters.jsonl": map(self._filter_parameters, settings),
            "filter_runs.jsonl": self._filter_runs(settings),
        }
        counts = {name.removesuffix(".jsonl"): self._file(name, x) for name, x in files.items()}
        # Last, since the parameters are collected from the other records.
        counts["parameters"] = self._file(
            "parameters.jsonl", [{"values": dict(p)} for p in self._parameters]
        )
        self._manifest(counts)
        return ExportSummary(counts=counts, left_out={"calibrations": left_out})

    # --- records as lines

    def _experiments(self, progress: Progress | None) -> Iterator[dict[str, Any]]:
        for done, number in enumerate(self._ids, start=1):
            yield self._experiment(number)
            if progress is not None:
                progress(done, len(self._ids))

    def _experiment(self, number: int) -> dict[str, Any]:
        experiment = self._store.experiment(number)
        row = rows.experiment_row(experiment)
        if experiment.video:
            self._video(experiment.video)
        own = {"flags", "series", "video_sha256", "notes"}
        plain = ExperimentLine.model_fields.keys() - own
        notes = [
            {"text": note.text, "created_at_utc": note.created}
            for note in self._store.notes(number)
        ]
        return {name: row[name] for name in sorted(plain)} | {
            "video_sha256": experiment.video or None,
            "flags": self._flags(number),
            "series": self._series(rows.series_of(experiment)),
            **({"notes": notes} if notes else {}),
        }

    def _flags(self, number: int) -> list[dict[str, Any]]:
        flag, table = tables.flag, tables.experiment
        wanted = sa.select(flag).where(flag.c.experiment_id == number).order_by(flag.c.id)
        with reading(self._store._engine) as connection:
            of_import = connection.scalar(
                sa.select(table.c.n_import_flag).where(table.c.id == number)
            )
            found = connection.execute(wanted).all()
        return [
            {
                "name": row.name,
                "detail": row.detail,
                "is_fault": row.is_fault,
                "is_of_import": place < (of_import or 0),
                "created_at_utc": row.created_at_utc,
                "deleted_at_utc": row.deleted_at_utc,
            }
            for place, row in enumerate(found)
        ]

    def _simulations(self) -> Iterator[dict[str, Any]]:
        for number in self._of_experiments(tables.simulation):
            record = self._store.simulation(number)
            yield {
                "experiment": self._place[record.experiment_id],
                "parameters": self._parameters_place(record.parameters),
                "method": dict(record.method),
                "status": record.status,
                "contact_mode": record.contact_mode,
                "error_mm2": record.error_mm2,
                "series": self._series(rows.paths_of(record.trajectory, record.pusher)),
                **rows.provenance_row(record.provenance),
            }

    def _calibrations(self) -> tuple[list[CalibrationRecord], int]:
        """Calibrations whose experiments are all exported, and the number of those left out."""
        kept, left_out = [], 0
        for number in self._live(tables.calibration):
            record = self._store.calibration(number)
            here = [member.experiment_id in self._place for member in record.members]
            if all(here):
                kept.append(record)
            elif any(here) or self._whole:
                left_out += 1
        return kept, left_out

    def _calibration(self, record: CalibrationRecord) -> dict[str, Any]:
        tried = record.evaluations
        return {
            "name": record.name,
            "parameters": self._parameters_place(record.parameters),
            "method": dict(record.method),
            "members": [
                {
                    "experiment": self._place[member.experiment_id],
                    "weight": member.weight,
                    "error_mm2": member.error_mm2,
                }
                for member in record.members
            ],
            "reasons": [] if tried is None else list(tried.reasons),
            "estimates": rows.estimates_row(record.estimates),
            "series": self._series(rows.trials_of(tried)),
            **rows.provenance_row(record.provenance),
        }

    def _settings(self) -> list[int]:
        """Ids of the filter parameters to export: all, or those used with these experiments."""
        every = self._live(tables.filter_parameters)
        if self._whole:
            return every
        runs = map(self._store.filter_run, self._of_experiments(tables.filter_run))
        used = {run.filter_parameters_id for run in runs}
        return [number for number in every if number in used]

    def _filter_parameters(self, number: int) -> dict[str, Any]:
        record = self._store.filter_parameters(number)
        return {
            "name": record.name,
            "is_particle_filter": record.is_particle_filter,
            "options": dict(record.values),
            **rows.provenance_row(record.provenance),
        }

    def _filter_runs(self, settings: list[int]) -> Iterator[dict[str, Any]]:
        place = {number: k for k, number in enumerate(settings)}
        for number in self._of_experiments(tables.filter_run):
            record = self._store.filter_run(number)
            yield {
                "experiment": self._place[record.experiment_id],
                "filter_parameters": place[record.filter_parameters_id],
                "uses_tactile": record.uses_tactile,
                "occlusion": record.occlusion,
                "contact_mode": record.contact_mode,
                "series": self._series(rows.filtered_of(record)),
                **rows.provenance_row(record.provenance),
            }

    def _parameters_place(self, parameters: Parameters) -> int:
        return self._parameters.setdefault(parameters, len(self._parameters))

    def _live(self, table: sa.Table) -> list[int]:
        wanted = sa.select(table.c.id).where(table.c.deleted_at_utc.is_(None))
        with reading(self._store._engine) as connection:
            return list(connection.scalars(wanted.order_by(table.c.id)))

    def _of_experiments(self, table: sa.Table) -> list[int]:
        wanted = sa.select(table.c.id, table.c.experiment_id).where(
            table.c.deleted_at_utc.is_(None)
        )
        with reading(self._store._engine) as connection:
            found = connection.execute(wanted.order_by(table.c.id)).all()
        return [number for number, experiment in found if experiment in self._place]

    # --- members

    def _series(self, measured: list[Measured]) -> list[dict[str, Any]]:
        lines = []
        for name, columns, values in measured:
            data = npy_of(values)
            digest = hashlib.sha256(data).hexdigest()
            self._member(f"series/{digest}.npy", data, digest)
            lines.append({"name": name, "columns": list(columns), "sha256": digest})
        return lines

    def _member(self, name: str, data: bytes, digest: str) -> None:
        if name in self._members:
            return
        packing = zipfile.ZIP_STORED if _looks_like_a_bomb(data) else zipfile.ZIP_DEFLATED
        self._archive.writestr(_info(name, packing), data)
        self._members[name] = {"bytes": len(data), "sha256": digest}

    def _video(self, digest: str) -> None:
        name = f"media/{digest}"
        if name in self._members:
            return
        source = arrays.media_path(digest, self._store._media)
        total, size = hashlib.sha256(), 0
        try:
            with (
                source.open("rb") as stream,
                self._archive.open(_info(name, zipfile.ZIP_STORED), "w", force_zip64=True) as out,
            ):
                while data := stream.read(CHUNK):
                    total.update(data)
                    size += len(data)
                    out.write(data)
        except FileNotFoundError:
            raise _lost(source, "is missing") from None
        if total.hexdigest() != digest:
            raise _lost(source, "has changed")
        self._members[name] = {"bytes": size, "sha256": digest}

    def _file(self, name: str, lines: Iterable[dict[str, Any]]) -> int:
        # Collect the lines first: their series are written meanwhile, one zip member at a time.
        texts = [_json(line) for line in lines]
        data = "".join(text + "\n" for text in texts).encode()
        self._member(name, data, hashlib.sha256(data).hexdigest())
        return len(texts)

    def _manifest(self, counts: dict[str, int]) -> None:
        content = {
            "format": FORMAT,
            "version": VERSION,
            "fixel_version": fixel.__version__,
            "counts": counts,
            "members": self._members,
        }
        data = json.dumps(content, indent=1).encode()
        self._archive.writestr(_info(MANIFEST, zipfile.ZIP_DEFLATED), data)


def _json(line: dict[str, Any]) -> str:
    # Errors of calibrations may be infinite, which Python writes and reads as Infinity.
    return json.dumps(line, sort_keys=True, ensure_ascii=False, allow_nan=True)


def _info(name: str, packing: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, _INSTANT)
    info.compress_type = packing
    info.external_attr = _FILE_MODE
    return info


def _looks_like_a_bomb(data: bytes) -> bool:
    """Whether data compress so well that `import_bundle` would reject them as a zip bomb."""
    return len(data) > LIMITS.small and len(zlib.compress(data, 6)) * LIMITS.ratio < 2 * len(data)


def _lost(path: Path, how: str) -> StoreRefused:
    return StoreRefused(f"the file {path} {how}", "restore it from a backup of the media folder")


# --- import -------------------------------------------------------------------------------------


def import_bundle(
    path: Path,
    store: Store,
    *,
    limits: BundleLimits = LIMITS,
    progress: Progress | None = None,
) -> dict[str, int]:
    """Add the records of a bundle to a project; return the number of new ones by kind.

    All members are checked before the first record is added. Each experiment and each result is
    added in its own transaction. Importing again after an interruption adds only the missing
    records.

    Returns
    -------
    counts : dict of str to int
        New records by kind; ``known``: experiments already in the project; ``flags``: flags added
        to those; ``outdated``: new experiments of which the project has a newer version. They are
        added as deleted, since a listing shows the experiment added last.

    Raises
    ------
    InvalidInput
        The file is no bundle, is damaged, or is malicious.
    StoreRefused
        The project cannot be written to.
    """
    with BundleFile(path, limits) as bundle:
        return _Reader(bundle, store).read(progress)


@final
class _Reader:
    """Reader of one bundle into a project."""

    def __init__(self, bundle: BundleFile, store: Store) -> None:
        self._bundle = bundle
        self._store = store
        self._ids: list[int] = []  # of experiments, by their places
        self._new = dict.fromkeys((name.removesuffix(".jsonl") for name in FILES), 0)
        self._new |= {"known": 0, "flags": 0, "outdated": 0}

    def read(self, progress: Progress | None) -> dict[str, int]:
        """Add all records, each after those it refers to; return the counts of new ones."""
        self._experiments(progress)
        parameters = [
            self._made(where, lambda line=line: Parameters(line.values))  # type: ignore[misc]
            for where, line in self._bundle.lines("parameters.jsonl", ParametersLine)
        ]
        self._simulations(parameters)
        self._calibrations(parameters)
        self._filter_runs(self._filter_parameters())
        return self._new

    # --- experiments

    def _experiments(self, progress: Progress | None) -> None:
        total = self._bundle.manifest.counts.get("experiments", 0)
        outdated = self._outdated()
        lines = self._bundle.lines("experiments.jsonl", ExperimentLine)
        for place, (where, line) in enumerate(lines):
            self._ids.append(self._experiment(where, line, place in outdated))
            if progress is not None and place < total:
                progress(place + 1, total)

    def _outdated(self) -> set[int]:
        """Places of experiments that the bundle replaces by one the project already has."""
        newer: set[tuple[str, str]] = set()
        found = set()
        heads = []
        for where, line in self._bundle.lines("experiments.jsonl", ExperimentLine):
            heads.append(((line.dataset, line.name), self._row(where, line)["content_sha256"]))
        for place in reversed(range(len(heads))):
            name, content = heads[place]
            if name in newer:
                found.add(place)
            elif self._known(content) is not None:
                newer.add(name)
        return found

    def _known(self, content: str) -> int | None:
        with reading(self._store._engine) as connection:
            return self._store._known(connection, content)

    def _row(self, where: str, line: ExperimentLine) -> dict[str, Any]:
        measured = self._bundle.series(line.series)
        return rows.experiment_row(self._made(where, lambda: line.record(measured)))

    def _experiment(self, where: str, line: ExperimentLine, outdated: bool) -> int:
        measured = self._bundle.series(line.series)
        experiment = self._made(where, lambda: line.record(measured))
        self._made(where, lambda: [flag.flag for flag in line.flags])
        if line.video_sha256 is not None:
            self._video(line.video_sha256)
        row = rows.experiment_row(experiment)
        media = self._store._media
        series = [
            arrays.row_of("experiment", place, *one, media)
            for place, one in enumerate(rows.series_of(experiment))
        ]
        bare = dataclasses.replace(experiment, flags=())  # inserted below, with their times
        with writing(self._store._engine) as connection:
            number = self._store._known(connection, row["content_sha256"])
            if number is not None:
                self._new["known"] += 1
                self._new["flags"] += _add_missing(connection, number, line.flags)
                _add_notes(connection, number, line.notes)
                return number
            number = self._store._insert(connection, bare, row, series)
            _insert_flags(connection, number, line.flags)
            _add_notes(connection, number, line.notes)
            if outdated:
                table = tables.experiment
                connection.execute(
                    sa.update(table).where(table.c.id == number).values(deleted_at_utc=rows.now())
                )
        self._new["experiments"] += 1
        self._new["outdated"] += outdated
        return number

    def _video(self, digest: str) -> None:
        """Copy a video to the media folder; its checksum has been verified on opening."""
        path = arrays.media_path(digest, self._store._media)
        if path.exists():
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as unfinished, unfinished.open("wb") as stream:
            for data in self._bundle.chunks(f"media/{digest}"):
                stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())

    # --- results

    def _simulations(self, parameters: list[Parameters]) -> None:
        known: dict[int, set[SimulationRecord]] = {}
        for where, line in self._bundle.lines("simulations.jsonl", SimulationLine):
            number = _at(self._ids, line.experiment, where)
            values = _at(parameters, line.parameters, where)
            measured = self._bundle.series(line.series)
            record = self._made(where, lambda: line.record(number, values, measured))  # noqa: B023
            if number not in known:
                found = self._store.simulations(number)
                known[number] = {self._store.simulation(k) for k in found}
            if record not in known[number]:
                self._store.add_simulation(record)
                self._new["simulations"] += 1

    def _calibrations(self, parameters: list[Parameters]) -> None:
        known = {self._store.calibration(k) for k in self._all(tables.calibration)}
        for where, line in self._bundle.lines("calibrations.jsonl", CalibrationLine):
            for member in line.members:
                _at(self._ids, member.experiment, where)
            values = _at(parameters, line.parameters, where)
            measured = self._bundle.series(line.series)
            record = self._made(where, lambda: line.record(self._ids, values, measured))  # noqa: B023
            if record not in known:
                self._store.add_calibration(record)
                self._new["calibrations"] += 1

    def _filter_parameters(self) -> list[int]:
        """Add new filter parameters; return the ids of all, in the order of the bundle."""
        numbers = self._all(tables.filter_parameters)
        known = {self._store.filter_parameters(k): k for k in reversed(numbers)}
        ids = []
        for where, line in self._bundle.lines("filter_parameters.jsonl", FilterParametersLine):
            record = self._made(where, line.record)
            if record not in known:
                known[record] = self._store.add_filter_parameters(record)
                self._new["filter_parameters"] += 1
            ids.append(known[record])
        return ids

    def _filter_runs(self, settings: list[int]) -> None:
        known: set[FilterRun] = {self._store.filter_run(k) for k in self._all(tables.filter_run)}
        for where, line in self._bundle.lines("filter_runs.jsonl", FilterRunLine):
            number = _at(self._ids, line.experiment, where)
            used = _at(settings, line.filter_parameters, where)
            measured = self._bundle.series(line.series)
            record = self._made(where, lambda: line.record(number, used, measured))  # noqa: B023
            if record not in known:
                self._store.add_filter_run(record)
                self._new["filter_runs"] += 1

    def _all(self, table: sa.Table) -> list[int]:
        with reading(self._store._engine) as connection:
            return list(connection.scalars(sa.select(table.c.id).order_by(table.c.id)))

    def _made(self, where: str, make: Callable[[], _T]) -> _T:
        with _refusing(where):
            return make()


@contextmanager
def _refusing(where: str) -> Iterator[None]:
    """Report any error in a line as `InvalidInput` with its place."""
    try:
        yield
    except ValidationError as problem:
        raise first_of(problem, where) from None
    except InvalidInput as problem:
        raise problem.within(where) from None
    except (KeyError, ValueError, IndexError, StopIteration) as problem:
        raise InvalidInput(where, found=str(problem), expected="a whole record") from None


def _at(found: list[_T], place: int, where: str) -> _T:
    if place >= len(found):
        raise InvalidInput(where, found=f"place {place}", expected=f"one of {len(found)}")
    return found[place]


def _insert_flags(connection: sa.Connection, number: int, lines: list[FlagLine]) -> None:
    if lines:
        given = [line.model_dump(exclude={"is_of_import"}) for line in lines]
        connection.execute(
            sa.insert(tables.flag), [row | {"experiment_id": number} for row in given]
        )


def _add_missing(connection: sa.Connection, number: int, lines: list[FlagLine]) -> int:
    """Add flags that the experiment never had here, so that removed flags stay removed."""
    flag = tables.flag
    wanted = sa.select(flag.c.name, flag.c.detail).where(flag.c.experiment_id == number)
    here = {(row.name, row.detail) for row in connection.execute(wanted)}
    missing = [
        line
        for line in lines
        if line.deleted_at_utc is None and (line.name, line.detail) not in here
    ]
    _insert_flags(connection, number, missing)
    return len(missing)


def _add_notes(connection: sa.Connection, number: int, lines: list[NoteLine]) -> None:
    """Add notes that the experiment never had here, so that deleted notes stay deleted."""
    note = tables.note
    wanted = sa.select(note.c.text, note.c.created_at_utc).where(note.c.experiment_id == number)
    here = {(row.text, row.created_at_utc) for row in connection.execute(wanted)}
    missing = [line for line in lines if (line.text, line.created_at_utc) not in here]
    if missing:
        connection.execute(
            sa.insert(tables.note),
            [line.model_dump() | {"experiment_id": number} for line in missing],
        )
