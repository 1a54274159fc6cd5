"""Export and import of bundles: experiments and all results computed from them, in one file.

A bundle is a project folder in a zip: a SQLite database with the exported records, and the long
series and videos, named by their checksum. The same records give the same bytes, with the same
version of SQLite.

A bundle includes flagged experiments and those replaced by a correction, but not deleted ones:
a deletion means that the experiment should not be passed on.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
import zipfile
import zlib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import sqlalchemy as sa

from fixel.database import bundle_file, rows, schema
from fixel.database.engine import reading, translated, writing
from fixel.database.project import ANALYSES, DATABASE, MEDIA, analysis_name
from fixel.database.query import ALL_EXPERIMENTS
from fixel.database.store import Store
from fixel.errors import NotStored
from fixel.io.atomic import INVALID_CONTENT, write_whole, written_whole
from fixel.model import Experiment, Flag
from fixel.model.selection import ExperimentQuery
from fixel.typing import ProgressCallback

# Earliest date of the zip format, so that bundles of the same records are equal bit for bit.
_INSTANT: Final = (1980, 1, 1, 0, 0, 0)
_FILE_MODE: Final = 0o100644 << 16
# Kinds of records in a bundle, in the order in which they are copied.
KINDS: Final = {
    "experiments": schema.experiment,
    "parameters": schema.system_parameters,
    "simulations": schema.simulation,
    "calibrations": schema.calibration,
    "filter_parameters": schema.filter_parameters,
    "filter_runs": schema.filter_run,
}


# --- export -------------------------------------------------------------------------------------


def export_bundle(
    store: Store,
    path: Path,
    *,
    dataset: str | None = None,
    progress: ProgressCallback | None = None,
) -> tuple[dict[str, int], dict[str, int]]:
    """Write a bundle of a project's experiments, or of one dataset, and the results from them.

    It replaces `path`, a ``.zip``, once it is complete. `progress` is called with the number of
    exported experiments and their total. A series or a video that is missing in the media folder,
    or has changed, raises `StoreRefused`.

    Return the numbers of records of each kind, where ``flagged`` and ``replaced`` count experiments
    with these marks, and those of omitted records: ``deleted`` experiments, and ``calibrations``
    that use an experiment outside the bundle.
    """
    every = ExperimentQuery(dataset=dataset, include_faulty=True, marks=("replaced",))
    ids = store.experiment_ids(every)
    videos: list[str] = []
    with (
        written_whole(path, durable=True) as unfinished,
        TemporaryDirectory(prefix=".bundle-", dir=unfinished.parent) as name,
    ):
        folder = Path(name)
        with Store(bundle_file.private_url(folder / "work.db"), folder / MEDIA) as target:
            target.upgrade()
            copy = _Copy(store, target, videos.append)
            copy.run(ids, progress, whole=dataset is None)
            counts = record_counts(target) | {"analyses": copy.new["analyses"]}
            with translated(target._engine), target._engine.connect() as connection:
                raw: Any = connection.connection.dbapi_connection
                raw.execute("VACUUM INTO ?", (str(folder / DATABASE),))
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
            _add_member(archive, folder / DATABASE, DATABASE)
            for file in sorted((folder / MEDIA).glob("*/*")):
                _add_member(archive, file, f"{MEDIA}/{file.parent.name}/{file.name}")
            for file in sorted((folder / ANALYSES).glob("*/*")):
                _add_member(archive, file, f"{ANALYSES}/{file.parent.name}/{file.name}")
            for digest in dict.fromkeys(videos):
                _add_video(archive, digest, store.media)
    gone = dataclasses.replace(every, marks=("deleted", "replaced"), limit=0)
    page = store.experiments(ExperimentQuery(dataset=dataset, limit=0))
    counts |= {"flagged": page.left_out, "replaced": len(ids) - page.total - page.left_out}
    left_out = {"calibrations": copy.n_left_out, "deleted": store.experiments(gone).total}
    return counts, left_out


def record_counts(store: Store) -> dict[str, int]:
    """Number of records of each kind in a bundle."""
    with reading(store._engine) as connection:
        count = sa.func.count()
        return {
            kind: connection.scalar(sa.select(count).select_from(table)) or 0
            for kind, table in KINDS.items()
        }


def _add_member(archive: zipfile.ZipFile, file: Path, name: str) -> None:
    """Add a file, packed unless `import_bundle` would reject it as a zip bomb."""
    packer, packed, size = zlib.compressobj(6), 0, file.stat().st_size
    with file.open("rb") as stream:
        while size > bundle_file.LIMITS.small and (data := stream.read(bundle_file.CHUNK)):
            packed += len(packer.compress(data))
    is_like_a_bomb = (
        size > bundle_file.LIMITS.small and packed * bundle_file.LIMITS.ratio < 2 * size
    )
    packing = zipfile.ZIP_STORED if is_like_a_bomb else zipfile.ZIP_DEFLATED
    with (
        file.open("rb") as stream,
        archive.open(_info(name, packing), "w", force_zip64=True) as member,
    ):
        shutil.copyfileobj(stream, member, bundle_file.CHUNK)


def _add_video(archive: zipfile.ZipFile, digest: str, media: Path) -> None:
    source, total = rows.media_path(digest, media), hashlib.sha256()
    info = _info(f"{MEDIA}/{digest[:2]}/{digest}", zipfile.ZIP_STORED)
    try:
        with source.open("rb") as stream, archive.open(info, "w", force_zip64=True) as member:
            while data := stream.read(bundle_file.CHUNK):
                total.update(data)
                member.write(data)
    except FileNotFoundError:
        raise rows.lost(source, "is missing") from None
    if total.hexdigest() != digest:
        raise rows.lost(source, "has changed")


def _info(name: str, packing: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, _INSTANT)
    info.compress_type = packing
    info.external_attr = _FILE_MODE
    return info


# --- import -------------------------------------------------------------------------------------


def import_bundle(
    path: Path,
    store: Store,
    *,
    limits: bundle_file.BundleLimits = bundle_file.LIMITS,
    progress: ProgressCallback | None = None,
) -> dict[str, int]:
    """Add the records of a bundle to a project; return the number of new ones by kind.

    The whole bundle is checked before the first record is added; one that is damaged or malicious
    raises `InvalidInput`. Each experiment and each result is added in its own transaction.
    Importing again after an interruption adds only the missing records.

    ``known`` counts experiments already in the project, ``flags`` the flags added to those,
    ``replaced`` those of the same name as new ones, and ``outdated`` new experiments of which the
    project has a newer version. They are added as deleted: a listing shows the one added last.
    """
    store.media.mkdir(parents=True, exist_ok=True)
    with bundle_file.opened_bundle(path, store.media.parent, limits) as source:
        ids = source.experiment_ids(ALL_EXPERIMENTS)
        copy = _Copy(source, store, lambda digest: _copy_video(digest, source, store))
        with bundle_file.damage_refused(path):
            outdated = copy.check(ids)
        copy.run(ids, progress, whole=True, outdated=outdated)
        return copy.new


def _copy_video(digest: str, source: Store, target: Store) -> None:
    file, path = (rows.media_path(digest, store.media) for store in (source, target))
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path, durable=True) as unfinished:
            shutil.copyfile(file, unfinished)


# --- records ------------------------------------------------------------------------------------


class _Copy:
    """Copy of records from one store to another, each in its own transaction.

    `add_video` gets the checksum of each video of a copied experiment.
    """

    def __init__(self, source: Store, target: Store, add_video: Callable[[str], None]) -> None:
        self._source = source
        self._target = target
        self._add_video = add_video
        self._ids: dict[int, int] = {}  # ids of experiments in the source -> in the target
        self._fits: dict[int, int] = {}  # the same of calibrations
        self._last = max(target._ids(schema.experiment), default=0)  # newest one before the copy
        # Copied records by kind, and counts of the experiments that the target has.
        self.new = dict.fromkeys((*KINDS, "analyses", "known", "flags", "outdated", "replaced"), 0)
        self.n_left_out = 0  # calibrations that use an experiment that is not copied

    def check(self, experiment_ids: Sequence[int]) -> set[int]:
        """Load all records of the source; return the experiments the target has newer ones of."""
        for table, load in (
            (schema.simulation, self._source.simulation),
            (schema.calibration, self._source.calibration),
            (schema.filter_parameters, self._source.filter_parameters),
            (schema.filter_run, self._source.filter_run),
        ):
            for number in self._source._ids(table):
                load(number)
        heads = []
        for number in experiment_ids:
            row = rows.experiment_row(self._original(number)[0])
            with reading(self._target._engine) as connection:
                is_known = self._target._known(connection, row["content_sha256"]) is not None
            heads.append((number, (row["dataset"], row["name"]), is_known))
        newer, outdated = set[tuple[str, str]](), set[int]()
        for number, name, is_known in reversed(heads):
            if name in newer:
                outdated.add(number)
            elif is_known:
                newer.add(name)
        return outdated

    def run(
        self,
        experiment_ids: Sequence[int],
        progress: ProgressCallback | None,
        *,
        whole: bool,
        outdated: Collection[int] = (),
    ) -> None:
        """Copy experiments and all results from them; `whole` also copies unused filter settings.

        Experiments that are `outdated` are added as deleted.
        """
        for done, number in enumerate(experiment_ids, start=1):
            self._ids[number] = self._experiment(number, number in outdated)
            if progress is not None:
                progress(done, len(experiment_ids))
        self._simulations()
        self._calibrations(whole)
        self._filter_runs(whole)
        self._analyses()

    def _original(self, number: int) -> tuple[Experiment, list[dict[str, Any]]]:
        """Load an experiment as first stored, and the rows of all its flags."""
        found = self._source.experiment(number)
        flags = _rows_of(self._source, schema.flag, number)
        with reading(self._source._engine) as connection:
            table = schema.experiment
            n_import = connection.scalar(
                sa.select(table.c.n_import_flag).where(table.c.id == number)
            )
        first = [Flag(row["name"], row["detail"], row["is_fault"]) for row in flags[:n_import]]
        return dataclasses.replace(found, flags=tuple(first)), flags

    def _experiment(self, number: int, outdated: bool) -> int:
        """Copy an experiment, its flags and its notes; return its id in the target."""
        experiment, flags = self._original(number)
        every = _rows_of(self._source, schema.note, number)
        notes = [row for row in every if row["deleted_at_utc"] is None]
        if experiment.video:
            self._add_video(experiment.video)
        row = rows.experiment_row(experiment)
        series = rows.rows_of("experiment", rows.series_of(experiment), self._target.media)
        with writing(self._target._engine) as connection:
            copied = self._target._known(connection, row["content_sha256"])
            is_new, replaced = copied is None, None
            if copied is None:
                bare = dataclasses.replace(experiment, flags=())  # flags follow, with their times
                copied, _, replaced = self._target._insert(connection, bare, row, series)
            else:
                flags = [flag for flag in flags if flag["deleted_at_utc"] is None]
            added = _add_missing(connection, schema.flag, copied, flags, ("name", "detail"))
            _add_missing(connection, schema.note, copied, notes, ("text", "created_at_utc"))
            if is_new and outdated:
                table = schema.experiment
                connection.execute(
                    sa.update(table).where(table.c.id == copied).values(deleted_at_utc=rows.now())
                )
        self.new["experiments"] += is_new
        self.new["outdated"] += is_new and outdated
        self.new["known"] += not is_new
        self.new["replaced"] += not outdated and 0 < (replaced or 0) <= self._last
        self.new["flags"] += 0 if is_new else added
        return copied

    def _simulations(self) -> None:
        known, copied = self._target._ids(schema.simulation), set()
        for number in self._source._ids(schema.simulation):
            record = self._source.simulation(number)
            if record.experiment_id in self._ids:
                record = dataclasses.replace(record, experiment_id=self._ids[record.experiment_id])
                copied.add(self._target.add_simulation(record))
        self.new["simulations"] += len(copied.difference(known))

    def _calibrations(self, whole: bool) -> None:
        stored = self._target._ids(schema.calibration, deleted=True)
        known = {self._target.calibration(k): k for k in stored}
        for number in self._source._ids(schema.calibration):
            record = self._source.calibration(number)
            here = [member.experiment_id in self._ids for member in record.members]
            if not all(here):
                self.n_left_out += any(here) or whole
                continue
            members = tuple(
                dataclasses.replace(member, experiment_id=self._ids[member.experiment_id])
                for member in record.members
            )
            record = dataclasses.replace(record, members=members)
            if record not in known:
                known[record] = self._target.add_calibration(record)
                self.new["calibrations"] += 1
            self._fits[number] = known[record]

    def _filter_runs(self, whole: bool) -> None:
        """Copy runs of filters, and their settings; all settings if `whole`."""
        every = map(self._source.filter_run, self._source._ids(schema.filter_run))
        runs = [run for run in every if run.experiment_id in self._ids]
        used = None if whole else {run.filter_parameters_id for run in runs}
        settings = self._filter_parameters(used)
        known, copied = self._target._ids(schema.filter_run), set()
        for run in runs:
            record = dataclasses.replace(
                run,
                experiment_id=self._ids[run.experiment_id],
                filter_parameters_id=settings[run.filter_parameters_id],
            )
            copied.add(self._target.add_filter_run(record))
        self.new["filter_runs"] += len(copied.difference(known))

    def _analyses(self) -> None:
        """Copy analyses whose experiments and calibrations are copied, with their ids there."""
        source, target = (one.media.parent / ANALYSES for one in (self._source, self._target))
        ids = {"experiments": self._ids, "calibrations": self._fits}
        for file in sorted(source.glob("*/analysis.json")):
            try:
                content = dict(json.loads(file.read_bytes()))
                own: dict[str, Any] = {k: [ids[k][one] for one in content[k]] for k in ids}
                own |= {k: self._renumbered(content.get(k, {})) for k in ("question", "request")}
                kind = file.parent.name.rpartition("-")[0]
                place = target / analysis_name(kind, own["question"])
            except (*INVALID_CONTENT, OSError, NotStored):  # damaged, or of records not copied
                continue
            if place.exists():
                continue
            place.mkdir(parents=True)
            for other in sorted(file.parent.iterdir()):
                if bundle_file.ANALYSIS_FILE.fullmatch(other.name) and other != file:
                    shutil.copyfile(other, place / other.name)
            write_whole(place / file.name, json.dumps(content | own, indent=1))  # last, as a mark
            self.new["analyses"] += 1

    def _renumbered(self, request: dict[str, Any]) -> dict[str, Any]:
        """Return a request with the ids that its experiments and calibration have in the target."""

        def there(text: str) -> str:
            is_id = text.removeprefix("id:").isdecimal()
            return f"id:{self._ids[self._source.find(text)]}" if is_id else text

        found = dict(request)
        if found.get("calibration") is not None:
            found["calibration"] = self._fits[found["calibration"]]
        for name in found.keys() & {"experiments", "held_out"}:
            found[name] = list(map(there, found[name]))
        return found | ({"experiment": there(found["experiment"])} if "experiment" in found else {})

    def _filter_parameters(self, used: set[int] | None) -> dict[int, int]:
        """Copy settings of filters; return their ids in the target by those in the source."""
        known = self._target._ids(schema.filter_parameters)
        copied = {}
        for number in self._source._ids(schema.filter_parameters):
            if used is None or number in used:
                record = self._source.filter_parameters(number)
                copied[number] = self._target.add_filter_parameters(record)
        self.new["filter_parameters"] += len({*copied.values()}.difference(known))
        return copied


def _rows_of(store: Store, table: sa.Table, experiment_id: int) -> list[dict[str, Any]]:
    """Flags or notes of an experiment without their ids, oldest first."""
    columns = [column for column in table.c if column.name not in ("id", "experiment_id")]
    wanted = sa.select(*columns).where(table.c.experiment_id == experiment_id).order_by(table.c.id)
    with reading(store._engine) as connection:
        return [row._asdict() for row in connection.execute(wanted)]


def _add_missing(
    connection: sa.Connection,
    table: sa.Table,
    experiment_id: int,
    given: Sequence[dict[str, Any]],
    key: tuple[str, str],
) -> int:
    """Add flags or notes that an experiment never had here, so that removed ones stay removed."""
    wanted = sa.select(*(table.c[name] for name in key))
    wanted = wanted.where(table.c.experiment_id == experiment_id)
    here = {tuple(row) for row in connection.execute(wanted)}
    missing = [row for row in given if tuple(row[name] for name in key) not in here]
    if missing:
        connection.execute(
            sa.insert(table), [row | {"experiment_id": experiment_id} for row in missing]
        )
    return len(missing)
