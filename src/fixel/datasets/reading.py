"""Reading of tables and public datasets as experiments."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.resources import files
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from fixel.datasets.bag import BagImporter
from fixel.datasets.base import Importer, ImportPlan, guarded, origin_of
from fixel.datasets.cmu import CmuTripod, CmuTwoPoint
from fixel.datasets.experiments import Experiments
from fixel.datasets.files import read_table, table_rows
from fixel.datasets.mit_push import MitPush
from fixel.datasets.mit_pusher_slider import MitPusherSlider
from fixel.datasets.rpi_2dgad import Rpi2dgad
from fixel.datasets.table import DATASET as TABLE, CsvTable, plan_table
from fixel.errors import DatasetMissing, InvalidInput, check_name
from fixel.io.atomic import refuse_device
from fixel.model import Body, Disk, Polygon, Provenance, Pusher, Scene, Tripod
from fixel.model.fields import instance
from fixel.model.scene import SceneChoice
from fixel.progress import ProgressOption, show_progress

_ALL: Final = (
    Rpi2dgad(),
    MitPush(),
    MitPusherSlider(),
    CmuTripod(),
    CmuTwoPoint(),
    BagImporter(),
    CsvTable(),
)

IMPORTERS: Final[Mapping[str, Importer]] = MappingProxyType(
    {importer.name: importer for importer in _ALL}
)


def importer_for(source: Path, name: str | None = None) -> Importer:
    """Return the importer of a given name, or the first that recognises a file or folder.

    Unknown names raise `InvalidInput`; `DatasetMissing` means that none recognises the source.
    """
    if name is not None:
        check_name("format", name, IMPORTERS)
        return IMPORTERS[name]
    source = Path(source)
    refuse_device(source, "a file or a folder")
    if not source.exists():
        raise DatasetMissing(source)
    for importer in IMPORTERS.values():
        if importer.recognised(source):
            return importer
    raise DatasetMissing(source, f"data for one of {', '.join(IMPORTERS)}", _hint(source))


def _hint(source: Path) -> str:
    """Hint that names subfolders with known data, or else the option to name an importer."""
    if source.suffix.lower() in (".xlsx", ".xls", ".ods"):
        return "save the sheet as CSV"
    inside = sorted(path for path in source.iterdir() if path.is_dir()) if source.is_dir() else []
    found = [path.name for path in inside if any(x.recognised(path) for x in _ALL)]
    name_it = "name the importer: --as NAME, in Python format=NAME"
    return f"data found in: {', '.join(found)}" if found else name_it


KINDS: Final = ("time", "length", "angle")
EXAMPLE: Final = "example.csv.gz"


def plan_import(
    source: Any,
    format: str | None = None,
    *,
    scene: SceneChoice | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    split_by: str | None = None,
    options: Mapping[str, str] | None = None,
    progress: ProgressOption = False,
) -> ImportPlan:
    """Plan the reading of a file, a folder or a table in memory.

    The format is the name of an importer, by default the one that recognises the source; if none
    does, raise `DatasetMissing`. `options` are those of the importer. The other arguments are those
    of `read_experiments`, for tables of one's own.
    """
    known: dict[str, Any] = dict(options or {})
    for place, texts in (("columns", columns), ("units", units)):
        instance(texts, Mapping | None, place, "texts by name")
    in_memory = not isinstance(source, Path)
    if in_memory and format not in (None, TABLE):
        raise InvalidInput("format", found=repr(format), expected=f"{TABLE!r}, for a table")
    importer = IMPORTERS[TABLE] if in_memory else importer_for(source, format)
    if isinstance(importer, CsvTable):
        importer.check_options(known)
        file = known.pop("scene", None)
        choice = Path(file) if file is not None and scene is None else scene
        split_by = known.pop("split_by", split_by)
        for kind, unit in (units or {}).items():
            check_name("units", kind, KINDS)
            known[f"{kind}_unit"] = unit
        return _plan_table(source, known, choice, split_by, columns, progress)
    given = {"scene": scene, "columns": columns, "units": units, "split_by": split_by}
    if isinstance(importer, BagImporter):
        own = {"scene": scene, "split_by": split_by, **(columns or {})}
        known |= {name: value for name, value in own.items() if value is not None}
        given = {"units": units}
    for name, value in given.items():
        if value is not None:
            found = f"a source read as {importer.name}"
            raise InvalidInput(name, found=found, expected="a table of your own")
    return importer.read(source, **known)


def _plan_table(
    table: Any,
    options: Mapping[str, str],
    scene: SceneChoice | None,
    split_by: str | None,
    columns: Mapping[str, str] | None,
    progress: ProgressOption,
) -> ImportPlan:
    rest: Any = {"columns": columns, "progress": progress}
    if isinstance(table, Path):
        if not table.exists():
            raise DatasetMissing(table)
        if not table.is_file():
            raise InvalidInput(table.name, found="a folder", expected="one table")
        with guarded(table.name):
            rows = read_table(table, torn=split_by is not None)
            return plan_table(rows, table, origin_of(table), options, scene, split_by, **rest)
    rows = table_rows(table)
    digest = hashlib.sha256(repr(rows.columns).encode()).hexdigest()
    provenance = Provenance(version=version("fixel"), source="table in memory", sha256=digest)
    return plan_table(rows, Path("table"), provenance, options, scene, split_by, **rest)


def collected(
    plans: Sequence[ImportPlan], limit: int | None, progress: ProgressOption
) -> Experiments:
    """Read the experiments of plans, at most `limit`."""
    total = sum(plan.n_experiments for plan in plans)
    total = total if limit is None else min(limit, total)
    every = (experiment for plan in plans for experiment in plan)
    found = []
    with show_progress(progress, "reading experiments") as report:
        for done, experiment in enumerate(islice(every, limit), start=1):
            found.append(experiment)
            report(done, total)
    notes = dict.fromkeys(sentence for plan in plans for sentence in plan.understood)
    skipped = [name for plan in plans for name in plan.skipped]
    simulations = {key: one for plan in plans for key, one in plan.simulations.items()}
    return Experiments.of(found, tuple(notes), skipped, simulations)


def example() -> Experiments:
    """Return 40 pushes of a simulated laboratory, which come with fixel.

    A tip with a radius of 5 mm pushes a part of 100 mm by 80 mm over 56 mm, at 20 mm/s and 20
    poses a second. Conditions: `surface` (abs, plywood), `contact_offset_m` and `push_angle_rad`.
    The true friction of the tip is 0.22 and varies by 5 % from push to push. The true radius of
    the tripod is 38 mm; the scenes have other values. Measured positions scatter by 0.2 mm, angles
    by 0.15 degrees. The friction of the table differs between the surfaces.

    Returns
    -------
    Experiments

    Examples
    --------
    >>> import fixel
    >>> pushes = fixel.datasets.example()
    >>> pushes[0].conditions["surface"]
    'abs'
    """
    return collected([example_plan()], None, False)


def example_plan() -> ImportPlan:
    """Plan the reading of `example`."""
    support = Tripod(radius=0.025, friction=0.25)
    part = Body("part", Polygon.rectangle(0.1, 0.08), mass=0.5, support=support)
    scene = Scene((part,), (Pusher("tip", Disk(0.005), friction=0.3),))
    source = Path(str(files("fixel.datasets") / EXAMPLE))
    options = {"name": "example", "simulated_by": "fixel"}
    return plan_import(source, scene=scene, split_by="push", options=options)
