"""Plans as CSV tables: one experiment per row, as the values that differ from a scene template."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from fixel.datasets.files import CsvRows, read_table
from fixel.datasets.table import UNITS
from fixel.errors import InvalidInput, unknown_name
from fixel.formats.frames_file import folder_whole
from fixel.formats.records import within
from fixel.formats.scene_file import SceneFile, load_scene, save_scene
from fixel.model import PlannedExperiment, Scene
from fixel.sampling.rig import plain_name
from fixel.sampling.rows import DRIVE, KEYS, row_scene
from fixel.table import Table, csv_cell
from fixel.typing import FloatArray

PLAN: Final = "plan.csv"
CONDITION: Final = "condition."
SOURCES: Final = ("scene", "experiment")
POSE: Final = ("x_mm", "y_mm", "angle_deg", "offset_x_mm", "offset_y_mm", "offset_angle_deg")
KNOWN: Final = (
    "name", *SOURCES, f"{CONDITION}NAME", *POSE, *(f"head_{own}" for own in POSE), "fixel-1_x_mm",
    "direction_deg", "travel_mm", "speed_mm_s",
)  # fmt: skip
NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
TEXTS: Final = ("shape", "layout", "axis")  # conditions of plans that are text, even "12"
LONGEST: Final = 200  # characters of a name


def read_rows(
    path: Path, template: Path | None, stored: Callable[[str], Scene]
) -> tuple[PlannedExperiment, ...]:
    """Read the experiments of a CSV table, in order.

    The table has the columns `name` and any of `scene`, `experiment`, `condition.NAME` and the
    values of `row_scene`, with a unit. Empty cells are as in the template: the scene file of rows
    that name none, by default `scene.yaml` in the folder of the table. `stored` returns the scene
    of a stored experiment by its name. The first error is raised, with its row and column, before
    any row is used.
    """
    table = read_table(path)
    table = replace(table, columns={k.strip(): v for k, v in table.columns.items()})
    table.require(["name"])
    columns = _columns(table)
    loaders = cache(lambda name: load_scene(path.parent / name).scene), cache(stored)
    usual = (template or path.with_name("scene.yaml")).absolute()
    rows: dict[str, PlannedExperiment] = {}
    for row, name in enumerate(table.columns["name"]):
        plain_name(name, where := table.place("name", row), LONGEST)
        if name in rows:
            raise InvalidInput(where, found=f"{name!r} twice", expected="different names")
        scene = _template(table, row, loaders, usual)
        values = {key: float(own[row]) for key, own in columns.items() if not np.isnan(own[row])}
        with within(f"{table.source}, row {row + 1}, {name}"):
            scene = row_scene(scene, values)
        # The names of the conditions of other plans, such as axes of a domain.
        given = {key.replace("offset_angle", "offset_theta"): own for key, own in values.items()}
        stated = _conditions({title: cells[row] for title, cells in table.columns.items()})
        rows[name] = PlannedExperiment(name=name, scene=scene, conditions=given | stated)
    return tuple(rows.values())


def write_rows(folder: Path, rows: Sequence[PlannedExperiment]) -> None:
    """Write `plan.csv` and the scene file of each row into a new folder, for `read_rows`."""
    names = dict.fromkeys(name for row in rows for name in row.conditions)
    head = ("name", "scene", *(f"{CONDITION}{name}" for name in names))
    lines = [(r.name, f"{r.name}.yaml", *map(r.conditions.get, names)) for r in rows]
    with folder_whole(folder) as unfinished:
        for row in rows:
            save_scene(SceneFile(scene=row.scene), unfinished / f"{row.name}.yaml")
        (unfinished / PLAN).write_text(Table(head, lines).csv(), encoding="utf-8")


def _columns(table: CsvRows) -> dict[str, FloatArray]:
    """Return the columns of values in SI units, by their names there; NaN for empty cells."""
    columns = {}
    for title in table.columns:
        if title in ("name", *SOURCES) or title.startswith(CONDITION):
            continue
        ending = next((u for u in sorted(UNITS, key=len)[::-1] if title.endswith(f"_{u}")), "s")
        key = f"{title.removesuffix(ending)}{UNITS[ending].si}"
        if key not in DRIVE and not key.endswith(KEYS):
            own = f"; name a column of your own {CONDITION}{title}"
            raise unknown_name(f"{table.source}, header", title, KNOWN, more=own)
        if key in columns:
            found, expected = f"{title!r} in another unit too", "each value in one column"
            raise InvalidInput(f"{table.source}, header", found=found, expected=expected)
        columns[key] = UNITS[ending].scale * table.numbers(title, blank=True)
    return columns


def _template(
    table: CsvRows, row: int, loaders: Sequence[Callable[[str], Scene]], usual: Path
) -> Scene:
    """Return the scene from which a row starts."""
    named = [k for k in SOURCES if k in table.columns and table.columns[k][row]]
    where = table.place([*named, "scene"][0], row)
    if len(named) > 1:
        raise InvalidInput(where, found="an experiment too", expected="one of them")
    if not named and not usual.is_file():
        expected = f"a scene file or an experiment, or the template {usual}"
        raise InvalidInput(where, found="none", expected=expected)
    name = table.columns[named[0]][row] if named else str(usual)
    with within(where):
        return loaders[named == ["experiment"]](name)


def _conditions(cells: dict[str, str]) -> dict[str, str | float]:
    """Return the stated conditions of a row, as numbers where they are."""
    own = {k.removeprefix(CONDITION): v for k, v in cells.items() if k.startswith(CONDITION) and v}
    own = {k: v[1:] if v[0] == "'" and csv_cell(v[1:]) == v else v for k, v in own.items()}
    number = [name for name, cell in own.items() if name not in TEXTS and NUMBER.fullmatch(cell)]
    return own | {name: float(own[name]) for name in number}
