"""Map an uneven table from pushes of parts on it: in memory, or of a project."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability.capability import Capability
from fixel.capability.options import TABLE, ConditionName, Dataset, Door, Flagged, Threads, Where
from fixel.errors import InvalidInput, counted

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model import Experiment, Scene
    from fixel.model.selection import ExperimentRow
    from fixel.parts.model import PartModel
    from fixel.parts.table_map import TableMap
    from fixel.progress import ProgressOption
    from fixel.workflows.analysis import AnalysisReport, StoredAnswer
    from fixel.workflows.calibration.calibration import Calibration

FITS: Final = Path("cache") / "parts"  # finished fits, in the project; of `fixel next` too
JSON: Final = ("folder", "files")  # what `--json` has besides numbers


def table_map(
    experiments: Iterable[Experiment],
    calibrations: Mapping[str, Mapping[str, float] | Calibration] | PartModel | None = None,
    *,
    part: ConditionName = None,
    surface: ConditionName = None,
    threads: Threads = None,
    store: str | Path | None = None,
    progress: ProgressOption = None,
) -> TableMap:
    """Map the unevenness of a table from pushes of parts on it.

    The same push ends elsewhere when it is made at another place or orientation, because no table
    is flat. The map states where parts press more. It is tested on left-out parts, or on left-out
    sides of fewer than three parts, and has weight 0 if it does not help.

    Parameters
    ----------
    experiments : sequence of Experiment
        Pushes on one table of single parts by a round pusher, slow enough to be quasi-static.
        Experiments without a scene are left out.
    calibrations : mapping of str to Calibration, or PartModel, optional
        Calibrated values of each part by its name, or a model that has fitted the parts. By default
        the twelve values of `fixel.part_model` are fitted to each.
    part : str, optional
        Condition that names the part; by default the first of `shape`, `part`, `object` and
        `object_id` that the experiments have.
    surface : str, optional
        Condition that names the table; by default the first of `surface` and `table`.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    store : path, optional
        Folder for finished fits, so that an interrupted call continues.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    TableMap
        `.on(scene)` puts the table into a scene or an experiment; `.moved(experiments)` estimates
        how far it has moved since.

    Raises
    ------
    InvalidInput
        The experiments are of several tables, none has a scene, a part has no calibration, or a
        part stands on three points, which press the same on every table.

    References
    ----------
    :cite:t:`rasmussen2006` for the prior of the map.

    Examples
    --------
    >>> from fixel.testing.pushes import example_parts
    >>> table = table_map(example_parts(3, 8, uneven=0.8), progress=False)
    >>> table.name, table.frame
    ('board', ('example',))
    """
    from fixel.io.array_bytes import ResultCache
    from fixel.parts.fit import NAMES
    from fixel.parts.table_map import TableMap, by_part, fitted_map
    from fixel.progress import show_progress
    from fixel.workflows.parts import fitted_values, pushes_of_parts

    used, part, surface = pushes_of_parts(experiments, part, surface)
    names = sorted({str(own.conditions.get(surface, "")) for own in used})
    if len(names) > 1:
        what, expected = f"{surface}={' and '.join(names)}", "experiments on one table"
        raise InvalidInput("experiments", found=what, expected=expected, hint="make a map of each")
    groups = by_part(used, part, threads)
    cache = ResultCache(store)
    values = {}
    with show_progress(progress, "fitting parts") as report:
        for done, (name, group) in enumerate(groups.items()):
            if calibrations is None:
                found = fitted_values(group, 0, cache, f"{names[0]}_{name}")[0]
                values[name] = dict(zip(NAMES, found.tolist(), strict=True))
            else:
                values[name] = _values(calibrations, name, names[0], group.targets[0].conditions)
            report(done + 1, len(groups), name)
    with show_progress(progress, "differentiating pushes") as report:
        found_map = fitted_map(groups, values, report)
    return TableMap(
        surface=surface,
        name=names[0],
        frame=tuple(sorted({own.dataset for own in used})),
        part=part,
        values=values,
        experiments=tuple(own.key for own in used),
        **found_map,
    )


def _values(
    calibrations: Mapping[str, Mapping[str, float] | Calibration] | PartModel,
    part: str,
    surface: str,
    conditions: Mapping[str, str | float],
) -> dict[str, float]:
    """Return the calibrated values of a part on a surface."""
    from fixel.model.fields import instance
    from fixel.parts.fit import NAMES
    from fixel.parts.model import PartModel

    instance(calibrations, PartModel | Mapping, "calibrations", "values of parts, or a part model")
    if isinstance(calibrations, PartModel):
        for own in calibrations.fits:
            if (own.part, own.surface) == (part, surface):
                return dict(zip(NAMES, own.values.tolist(), strict=True))
    elif part in calibrations:
        given = calibrations[part]
        found = given.values_for(**conditions) if hasattr(given, "values_for") else given
        return {name: float(value) for name, value in found.items()}
    raise InvalidInput(
        "calibrations", found=f"none of part {part!r}", expected="a calibration of every part"
    )


def table_map_stored(
    project: Project,
    *,
    dataset: Dataset = "",
    where: Where = (),
    flagged: Flagged = False,
    out: Annotated[Path | None, Door(writes=True, effort=True)] = None,
    progress: ProgressOption = None,
    **options: Any,
) -> tuple[TableMap, list[ExperimentRow]]:
    """Map the unevenness of a table from pushes of parts on it.

    The map is tested on parts, or on sides, that were left out. Pass the file of --out to other
    commands as --table.

    Parameters
    ----------
    out : Path, optional
        File to which the map is saved.
    **options
        Options of `fixel.table_map`.
    """
    one = [f'"dataset:{dataset}"'] if dataset else []
    experiments = project.experiments(*where, *one, flagged=flagged)
    found = table_map(experiments, store=project.folder / FITS, progress=progress, **options)
    if out is not None:
        found.save(out)
    rows = {entry.row.key: entry.row for entry in experiments.entries}
    return found, [rows[key] for key in found.experiments]


def report_of(found: tuple[TableMap, list[ExperimentRow]]) -> AnalysisReport:
    """Return headline, tables, notes, figure and numbers of a map."""
    from fixel.drawing.parts import map_chart
    from fixel.workflows.analysis import AnalysisReport, Picture, analysis_of

    (table, rows), names = found, ("position_m", "angle_rad")
    gains = {  # mean of the changes of errors, and its interval
        table.judgement.left_out: dict(zip(names, table.judgement.gain().T.tolist(), strict=True))
    }
    numbers = {name: getattr(table, name) for name in ("surface", "name", "part", "weight")}
    numbers |= {"frame": [*table.frame], "parts": [*table.values], "change_of_errors": gains}
    said, *notes = table._summary().notes
    verdict = f"helps, with weight {table.weight:g}" if table.weight else "does not help"
    pushes = f"{counted(len(rows), 'push')} of {counted(len(table.values), 'part')}"
    analysis = analysis_of(
        TABLE_MAP.name,
        table,
        title=f"Map of {_named(table)}",
        headline=(f"The map from {pushes} on {_named(table)} {verdict}.", said),
        notes=tuple(notes),
        numbers=numbers,
        experiments=tuple(row.id for row in rows),
    )
    caption = "Map, its standard deviation, and the places of the pushes."
    banner = "" if all(row.is_real for row in rows) else "SIMULATED"
    return AnalysisReport(analysis, [Picture("map", map_chart(table), banner, caption)])


def next_words(done: StoredAnswer) -> list[object]:
    """Return the words of the command that uses the map, or that saves it."""
    table, out = done.result[0], done.request.out
    if not table.weight:
        return []
    if out is None:
        return [*done.again, "--out", "table.fixel"]
    return ["calibrate", *(["--where", _named(table)] if table.name else []), "--table", out]


def _named(table: TableMap) -> str:
    return f"{table.surface}={table.name}" if table.name else "the table"


TABLE_MAP: Final = Capability(
    name="table-map",
    title="Table map",
    function=table_map_stored,
    of=table_map,
    leave_out=("experiments", "calibrations", "store"),
    group="table",
    verb="map",
)


# --- experiments of a project on a mapped table -------------------------------------------------


@dataclass(slots=True, eq=False)
class TableView:
    """Function that puts experiments that name a table on the map of it."""

    path: Path
    table: TableMap
    sha256: str
    # Why the map knows little about an experiment, by the name of each that was put on it.
    unseen: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, path: Path, copy: Path | None = None) -> TableView:
        """Load a saved map, from its copy if there is one."""
        from fixel.io.saved import load
        from fixel.parts.table_map import TableMap

        table = load(copy or path)
        if not isinstance(table, TableMap):
            hint = "make one with: fixel table map --out FILE"
            found = f"a {type(table).__name__} in {path}"
            raise InvalidInput(TABLE.name, found=found, expected="a TableMap", hint=hint)
        grid = table.load_map
        arrays = [own.tolist() for own in (grid.origin, grid.cell, grid.log_load)]
        content = repr((table.surface, table.name, table.frame, arrays))
        return cls(path, table, hashlib.sha256(content.encode()).hexdigest())

    def __call__(self, experiment: Experiment, /) -> Experiment:
        table = self.table
        if str(experiment.conditions.get(table.surface, "")) != table.name:
            return experiment
        found = table.on(experiment)
        self.unseen[experiment.key] = table.unseen(found)
        return found

    def of_scene(self, scene: Scene, /) -> Scene:
        """Put a scene, which names no table, on the map."""
        found = self.table.on(scene)
        self.unseen["the scene"] = self.table.unseen(found)
        return found

    def warnings(self, project: Project, experiments: Sequence[int]) -> list[str]:
        """Return what a reader must know about the experiments, which may not be loaded yet."""
        if not self.unseen:
            with project.store() as store:
                for number in experiments:
                    store.experiment(number)
        reasons = {key: reason for key, reason in self.unseen.items() if reason}
        if not reasons:
            return [] if self.unseen else [f"no experiment is on {_named(self.table)} of the map"]
        key, n = next(iter(reasons)), len(reasons)
        more = f" and {n - 1} more of {len(self.unseen)} experiments" if n > 1 else ""
        return [f"{key}{more}: {reasons[key]}"]
