"""Projects: folders with settings, a database, and media too large for the database.

my_lab/
    fixel.yaml          settings: a name, and where the database is
    experiments.db      SQLite, unless the settings or FIXEL_DATABASE name a server
    media/              videos and long arrays, named by their content
"""

from __future__ import annotations

import copy
import hashlib
import json
import os
import shlex
import sqlite3
import sys
import time
from collections.abc import Iterable, Mapping, Sequence, Sized
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, final

import sqlalchemy as sa
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fixel.database.store import ExperimentView, Store
from fixel.datasets.experiments import ExperimentEntry, Experiments
from fixel.errors import InvalidInput, StoreRefused, counted, machine_failure, refused_value
from fixel.io.atomic import write_whole
from fixel.io.document import read_document
from fixel.model import Experiment
from fixel.model.fields import instance, path_of, settle
from fixel.model.records import CalibrationRecord, SimulationRecord
from fixel.model.selection import ExperimentQuery, KnownNames, parse_filter, refuse_unknown
from fixel.progress import ProgressOption, show_progress
from fixel.registry import offered, offers
from fixel.results import Result, Summary
from fixel.table import Table
from fixel.typing import ProgressCallback

SETTINGS: Final = "fixel.yaml"
DATABASE: Final = "experiments.db"
DATABASE_FILES: Final = (DATABASE, f"{DATABASE}-wal", f"{DATABASE}-shm", f"{DATABASE}-journal")
MEDIA: Final = "media"
ANALYSES: Final = "analyses"  # folder of stored analyses, each a folder of its own
MAX_NAME: Final = 200  # characters
VARIABLE: Final = "FIXEL_DATABASE"  # environment variable; overrides the database of the settings


def analysis_name(kind: str, question: Mapping[str, Any]) -> str:
    """Return the name of the folder of an analysis, the same for the same question."""
    asked = json.dumps([kind, question], sort_keys=True, allow_nan=False)
    return f"{kind}-{hashlib.sha256(asked.encode()).hexdigest()[:10]}"


class ProjectSettings(BaseModel):
    """Content of `fixel.yaml`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1, max_length=MAX_NAME)
    database: str | None = None  # URL of a server; None for the file in the folder
    bench: dict[str, Any] = {}  # devices, as options of `fixel bench`


class AddSummary(NamedTuple):
    """Number of experiments that were added to a project."""

    new: int
    known: int  # stored before, and left unchanged
    faulty: int  # of the new, those that listings leave out by default
    wall_time_s: float
    replaced: int = 0  # earlier experiments with the names of new ones


@final
@dataclass(frozen=True, init=False, repr=False)
class Project:
    """Folder that stores experiments and what was computed from them.

    It is opened, never created: `Project.create` does that. Calibrations, maps and other results
    are computed by the functions of `fixel`; the methods of the same names store them, too.

    Parameters
    ----------
    place : path or str
        Folder of the project; or the URL of its database,
        ``postgresql+psycopg://USER@HOST/NAME`` or ``sqlite:///FILE``.
    media : path, optional
        Folder of long arrays and videos, for a URL.

    Attributes
    ----------
    folder : Path
    settings : ProjectSettings
    view : ExperimentView, optional
        Function that changes experiments when they are loaded; set by `seen_through`.

    Raises
    ------
    StoreRefused
        There is no project; the error has the command that creates one.

    Examples
    --------
    >>> import fixel, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> lab = fixel.Project.create(folder.name)
    >>> lab.add(fixel.datasets.example()).new
    40
    >>> lab.experiments("surface=abs moved>50").keys[:2]
    ('example/06', 'example/12')
    >>> lab.experiment("example/12").conditions["surface"]
    'abs'
    >>> folder.cleanup()
    """

    folder: Path
    settings: ProjectSettings
    view: ExperimentView | None = None

    def __init__(self, place: str | os.PathLike[str], *, media: Path | None = None) -> None:
        if "://" in str(place):
            folder, settings = _server(str(place), media)
            settle(self, folder=folder, settings=settings)
            return
        folder = path_of(place, "place")
        path = folder / SETTINGS
        if not path.is_file():
            name = str(folder)
            raise StoreRefused(
                f"{folder} is not a fixel project (no {SETTINGS})",
                hint=f"make one with: {shlex.join(['fixel', 'new', name])}, or in Python"
                f" fixel.Project.create({name!r})",
                is_input=True,
            )
        content = read_document(path)
        try:
            settle(self, folder=folder, settings=ProjectSettings.model_validate(content))
        except ValidationError as problem:
            known = ProjectSettings.model_fields
            raise refused_value(problem, str(path), "settings", known) from None
        offered("project", "check_place")(folder, self.settings.database)

    def seen_through(self, view: ExperimentView | None) -> Project:
        """Return the project with experiments that a function changes when they are loaded."""
        found = copy.copy(self)
        settle(found, view=view)
        return found

    @classmethod
    def create(cls, folder: str | os.PathLike[str], *, database: str | None = None) -> Project:
        """Create a project with an empty database, in a new or empty folder.

        Parameters
        ----------
        folder : path
        database : str, optional
            URL of the database on a server, ``postgresql+psycopg://USER@HOST/NAME``; by default a
            file in the folder.

        Raises
        ------
        InvalidInput
            The folder is not empty.
        StoreRefused
            The database cannot be created.
        """
        folder = Path(folder)
        if (folder / SETTINGS).exists():
            raise InvalidInput(str(folder), found="a project", expected="a new folder")
        whole = str(folder.resolve())
        if whole.encode(errors="ignore").decode() != whole:
            raise InvalidInput(whole, found="bytes of no UTF-8", expected="a name in UTF-8")
        was_there = folder.exists()
        if was_there and not (folder.is_dir() and _is_empty(folder)):
            raise InvalidInput(str(folder), found="other files", expected="a new or empty folder")
        name = folder.resolve().name[:MAX_NAME] or "project"
        project = object.__new__(cls)
        settle(project, folder=folder, settings=ProjectSettings(name=name, database=database))
        try:
            (folder / MEDIA).mkdir(parents=True, exist_ok=True)
            with Store(project.url, project.media) as store:
                store.upgrade()
            # Last, since this file makes the folder a project.
            write_whole(folder / SETTINGS, _settings_text(project.settings))
            if database is not None:
                offered("project", "trust_place")(folder)
        except BaseException as problem:
            _clear(folder, keep=was_there)
            if isinstance(problem, OSError) and (failure := machine_failure(problem)) is not None:
                raise failure from None
            raise
        return project

    # --- experiments ----------------------------------------------------------------------------

    def add(self, what: Any, *, progress: ProgressOption = None) -> Any:
        """Store experiments, or the result of a calibration or of an analysis.

        Each experiment is stored completely or not at all; one that is stored already is skipped.

        Parameters
        ----------
        what : Experiments, Experiment, iterable of Experiment, or result
        progress : bool or callable, optional

        Returns
        -------
        AddSummary
            For a result, what its own module returns: ids, or the stored analysis.

        Raises
        ------
        InvalidInput
            Something that cannot be stored, or a result of experiments that are not stored.
        """
        if type(what).__name__ in offers("stores"):
            return offered("stores", type(what).__name__)(self, what)
        several = [what] if isinstance(what, Experiment) else what
        if isinstance(what, Result) and not isinstance(several, Iterable):
            found = f"{type(what).__name__}, which projects do not store"
            expected = "a Calibration, DomainMap, Posterior, Sensitivity or FilterRun"
            hint = "write it to a file: .save(path)"
            raise InvalidInput("what", found=found, expected=expected, hint=hint)
        instance(several, Iterable, "what", "experiments, or a result")
        with self.store() as store, show_progress(progress, "storing experiments") as report:
            return add_experiments(store, several, report)

    def experiments(
        self,
        *filters: str,
        flagged: bool = False,
        sort: str = "id",
        descending: bool = False,
        limit: int | None = None,
    ) -> Experiments:
        """Return the stored experiments that match a filter, without reading their series.

        Parameters
        ----------
        *filters : str
            Terms such as `surface=abs error>5 real`, as in `Experiments.where`.
        flagged : bool
            Include experiments with faults in their data.
        sort : str
            Column or condition to sort by, such as `error`.
        descending : bool
        limit : int, optional
            Maximum number of experiments.

        Raises
        ------
        InvalidInput
            An unknown name or value, with the one that resembles it most.
        """
        query = parse_filter(
            *filters, include_faulty=flagged, sort=sort, descending=descending, limit=limit
        )
        with self.store() as store:
            found = stored_experiments(store, query)
            if filters:
                check_known_names(store, query, found=bool(found))
            return found

    def experiment(self, key: str | int) -> Experiment:
        """Load one experiment by its id, its name, or dataset/name.

        Raises
        ------
        NotStored
            No experiment has this name, or several have; the error names the closest one.
        """
        with self.store() as store:
            return store.experiment(store.find(str(key)))

    # --- results --------------------------------------------------------------------------------

    @property
    def calibrations(self) -> Mapping[int, CalibrationRecord]:
        """Stored calibrations by id, oldest first, without their evaluations."""
        with self.store() as store:
            return MappingProxyType(store.calibration_summaries())

    @property
    def analyses(self) -> Sequence[Any]:
        """Stored analyses, such as domain maps, newest first."""
        found: Sequence[Any] = offered("project", "analyses")(self)
        return found

    @property
    def jobs(self) -> Sequence[Any]:
        """Status of the jobs of the project."""
        found: Sequence[Any] = offered("project", "jobs")(self.folder)
        return found

    def calibrate(
        self, experiments: str | Iterable[Experiment] = "", parameters: Any = None, **options: Any
    ) -> Any:
        """Calibrate experiments with `fixel.calibrate`, and store the result.

        Parameters
        ----------
        experiments : str or experiments
            Filter, or experiments of the project.
        parameters : mapping or sequence, optional
            Parameters with their bounds, as for `fixel.calibrate`.
        **options
            Options of `fixel.calibrate`.
        """
        chosen = self.experiments(experiments) if isinstance(experiments, str) else experiments
        return self.add(offered("project", "calibrate")(chosen, parameters, **options))

    def map_domain(self, filter: str = "", fit: Any = None, **options: Any) -> Any:
        """Map where a calibration can be trusted, as `fixel domain` does, and store the map.

        Parameters
        ----------
        filter : str
            Filter of the experiments.
        fit : Calibration or int, optional
            Calibration, or the id of a stored one; by default the newest for several experiments.
        **options
            Options of `fixel.map_domain`, such as `threshold`, `axes` and `facets`.

        Returns
        -------
        DomainMap
        """
        where = (filter,) if filter else ()
        return self._with_fit("domain", fit, where=where, **options).domain

    def posterior(self, filter: str = "", fit: Any = None, **options: Any) -> Any:
        """Sample a posterior, as `fixel uncertainty` does, and store it with its predictions.

        Parameters
        ----------
        filter : str
            Filter of the experiments; by default those of the calibration.
        fit : Calibration or int, optional
            Calibration, or the id of a stored one, whose parameters and motion model are used.
        **options
            `samples`, `model_error`, `seed` and `progress`, as for `fixel.posterior`.

        Returns
        -------
        Posterior
        """
        keys = self.experiments(filter).keys if filter else ()
        return self._with_fit("uncertainty", fit, experiments=keys, **options).posterior

    def _with_fit(self, capability: str, fit: Any, **options: Any) -> Any:
        """Run a capability with a calibration, which is stored if it is not yet."""
        if hasattr(fit, "run"):
            stored = fit if fit.run.ids else self.add(fit)
            fit = int(stored.run.ids[stored.number])
        return offered("project", "call")(self, capability, calibration=fit, **options)

    # --- files ----------------------------------------------------------------------------------

    def report(self, path: str | os.PathLike[str] = "report", **options: Any) -> Any:
        """Write a report on the newest calibration with `fixel.report`.

        Parameters
        ----------
        path : path
            Folder to write to.
        **options
            Options of `fixel.report`.
        """
        return offered("project", "report")(self, path, **options)

    def export(self, path: str | os.PathLike[str], **options: Any) -> Any:
        """Write experiments for other programs with `fixel.export`.

        Parameters
        ----------
        path : path
            A ``.zip`` that another project imports, or a new folder.
        **options
            Options of `fixel.export`.
        """
        return offered("project", "export")(self, path, **options)

    def check(self) -> Any:
        """Read everything that is stored, and return what is wrong with it."""
        return offered("project", "check")(self)

    def backup(self, path: str | os.PathLike[str]) -> Any:
        """Copy the database to a file, while other programs may use it."""
        return offered("project", "backup")(self, Path(path))

    def upgrade(self) -> Any:
        """Upgrade the tables of the database to this version of fixel."""
        return offered("project", "upgrade")(self)

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()

    def _summary(self) -> Summary:
        heading = f"Project {self.settings.name!r} in {self.folder}"
        try:
            with self.store() as store:
                datasets, n_fit = store.datasets(), len(store.calibrations())
        except StoreRefused as refused:
            return Summary(heading, notes=[str(refused)])
        table = Table(("dataset", "experiments"), [*datasets.items()])
        return Summary(heading, [table] if datasets else [], [counted(n_fit, "calibration")])

    # --- database -------------------------------------------------------------------------------

    @property
    def url(self) -> str:
        """URL of the database: from the environment, the settings, or of the file in the folder."""
        named = os.environ.get(VARIABLE) or self.settings.database
        file = str(self.folder.absolute() / DATABASE)
        return named or str(sa.URL.create("sqlite", database=file))

    @property
    def media(self) -> Path:
        """Folder of long arrays and videos."""
        return self.folder / MEDIA

    @property
    def upgrade_command(self) -> str:
        """Shell command that upgrades the tables to this version of fixel."""
        return shlex.join(["fixel", "db", "upgrade", str(self.folder)])

    def store(self) -> Store:
        """Open the project's store; raise `StoreRefused` if its tables have another version."""
        store = Store(self.url, self.media, self.view)
        try:
            store.check_version(self.upgrade_command)
        except StoreRefused:
            store.close()
            raise
        return store


def _server(url: str, media: Path | None) -> tuple[Path, ProjectSettings]:
    """Return folder and settings of a project that is opened by the URL of its database."""
    file = url.removeprefix("sqlite:///")
    if file == url and media is None:
        found = "none for a database on a server"
        expected = "a folder of long arrays and videos"
        hint = "open the folder of the project, or give media=FOLDER"
        raise InvalidInput("media", found=found, expected=expected, hint=hint)
    if file != url and not Path(file).is_file():
        raise StoreRefused(
            f"there is no database {file}", hint="create a project: fixel new FOLDER", is_input=True
        )
    folder = Path(file).parent if media is None else Path(media).parent
    name = url.rpartition("/")[2].partition("?")[0] or "project"
    return folder, ProjectSettings(name=name[:MAX_NAME], database=url)


MAX_STORES: Final = 8  # open at a time, for sequences of experiments


@lru_cache(MAX_STORES)
def _store(url: str, media: Path, _: tuple[int, int] | None) -> Store:
    return Store(url, media)


def _stored_experiment(url: str, media: Path, view: ExperimentView | None, k: int) -> Experiment:
    file = None  # on a server; other files may follow under the same name
    with suppress(OSError):
        now = os.stat(sa.make_url(url).database or "")
        file = now.st_dev, now.st_ino
    found = _store(url, media, file).experiment(k)
    return found if view is None else view(found)


def known_names(store: Store) -> KnownNames:
    """Return the names and values that a filter of a store's experiments can use."""
    known = store.conditions()
    conditions = {name: values.texts for name, values in known.items()}
    texts = [name for name, values in known.items() if not values.numbers]
    return KnownNames(store.datasets(), store.flags(), conditions, texts)


def check_known_names(store: Store, query: ExperimentQuery, *, found: bool = False) -> None:
    """Raise if a query has a dataset, flag, condition or value that no experiment has.

    With `found`, only for a condition: other names are then known.
    """
    refuse_unknown(query, known_names(store), found=found)


def stored_experiments(store: Store, query: ExperimentQuery) -> Experiments:
    """Return the experiments that match a query, in its order; none of them is read yet."""
    page = store.experiments(query, details=True)
    entries = tuple(map(ExperimentEntry, page.rows, page.details))
    skipped = [f"{page.left_out} with faults in their data"] if page.left_out else []
    published = store.published_simulations()
    simulations = {
        entry.row.key: store.simulation(published[entry.row.id])
        for entry in entries
        if entry.row.id in published
    }
    load = partial(_stored_experiment, store.url, store.media.absolute(), store.view)
    return Experiments(entries, load, (), tuple(skipped), simulations)


def add_experiments(
    store: Store,
    experiments: Iterable[Experiment],
    report: ProgressCallback | None = None,
    total: int = 0,
) -> AddSummary:
    """Store experiments with the command as typed in their provenance, each whole or not at all.

    `total` is their number, for the progress of an iterator.
    """
    begun = time.monotonic()
    command = typed()
    published: Mapping[str, SimulationRecord] = getattr(experiments, "simulations", {})
    total = len(experiments) if isinstance(experiments, Sized) else total
    new = known = faulty = replaced = 0
    for made in experiments:
        instance(made, Experiment, "what", "experiments, or a result")
        experiment = replace(made, provenance=replace(made.provenance, command=command))
        stored = store.add_experiment(experiment)
        if (simulation := published.get(experiment.key)) is not None:
            _add_published(store, stored.id, simulation)
        if stored.new:
            new += 1
            replaced += stored.replaced is not None
            faulty += any(flag.fault for flag in experiment.flags)
        else:
            known += 1
        if report is not None:
            report(new + known, max(total, new + known))
    return AddSummary(new, known, faulty, time.monotonic() - begun, replaced)


def _add_published(store: Store, experiment_id: int, simulation: SimulationRecord) -> None:
    """Store a simulation by the publisher of an experiment, if it is not stored yet."""
    known = [store.simulation(one).provenance for one in store.simulations(experiment_id)]
    if all(own.sha256 != simulation.provenance.sha256 for own in known):
        store.add_simulation(replace(simulation, experiment_id=experiment_id))


def typed() -> str:
    """Return the running command line, as it could be typed again."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def _is_empty(folder: Path) -> bool:
    """Whether a folder is empty, or has only the remains of an interrupted `create`."""
    left = {path.name for path in folder.iterdir()}
    if not left <= {MEDIA, *DATABASE_FILES} or any((folder / MEDIA).glob("*")):
        return False
    file = folder / DATABASE
    if not file.is_file() or file.stat().st_size == 0:
        return True
    try:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as raw:
            tables = raw.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
            rows = ["alembic_version"] if tables else []
            rows += [t for (t,) in tables if raw.execute(f'SELECT 1 FROM "{t}" LIMIT 1').fetchone()]
    except sqlite3.Error:
        return False
    return set(rows) <= {"alembic_version"}


def _clear(folder: Path, *, keep: bool) -> None:
    """Remove the remains of a failed `create`, so that it can be repeated."""
    with suppress(OSError):
        for name in DATABASE_FILES:
            (folder / name).unlink(missing_ok=True)
        (folder / MEDIA).rmdir()
        if not keep:
            folder.rmdir()


def _settings_text(settings: ProjectSettings) -> str:
    named = settings.database
    lines = [
        "# Settings of a fixel project.\n",
        yaml.safe_dump({"name": settings.name}, allow_unicode=True),
        "# The database of a laboratory: postgresql+psycopg://USER@HOST/DATABASE\n",
        "# database:\n" if named is None else yaml.safe_dump({"database": named}),
    ]
    return "".join(lines)
