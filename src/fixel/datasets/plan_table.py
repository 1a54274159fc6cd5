"""Plans as CSV tables: one experiment per row, as the values that differ from a scene template."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from fixel.datasets.files import CsvRows, read_table
from fixel.datasets.table import UNITS
from fixel.errors import InvalidInput, unknown_name
from fixel.formats.frames_file import folder_whole
from fixel.formats.scene_file import SceneFile, load_scene, save_scene
from fixel.model import PlannedExperiment, Scene
from fixel.sampling.rig import plain_name
from fixel.sampling.rows import row_keys, row_scene
from fixel.table import Table

TEMPLATE: Final = "scene.yaml"
PLAN: Final = "plan.csv"
CONDITION: Final = "condition."
NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
PLAIN: Final = ("name", "scene", "experiment")
TEXTS: Final = ("shape", "layout", "axis")  # conditions of plans that are text, even "12"
LONGEST: Final = 200  # characters of a name


def read_rows(
    path: Path, template: Path | None, stored: Callable[[str], Scene]
) -> tuple[PlannedExperiment, ...]:
    """Read the experiments of a CSV table, in order.

    Parameters
    ----------
    path : Path
        Table with the columns `name` and any of `scene`, `experiment`, `condition.NAME` and the
        values of `row_scene`, with a unit. Empty cells are as in the template.
    template : Path, optional
        Scene file of rows that name none; by default `scene.yaml` in the folder of the table.
    stored : callable
        Returns the scene of a stored experiment, by its name.

    Raises
    ------
    InvalidInput
        The first error with its row and column, before any row is used.
    """
    table = read_table(path)
    table = replace(table, columns={k.strip("\ufeff "): v for k, v in table.columns.items()})
    table.require(["name"])
    names = table.columns["name"]
    for row, name in enumerate(names):
        plain_name(name, where := table.place("name", row), LONGEST)
        if name in names[:row]:
            raise InvalidInput(where, found=f"{name!r} twice", expected="different names")
    scenes = [*_templates(table, path, template or path.with_name(TEMPLATE), stored)]
    rows = []
    for row, values in enumerate([*_values(table, [row_keys(scene) for scene in scenes])]):
        try:
            scene = row_scene(scenes[row], values)
        except InvalidInput as problem:
            raise problem.within(f"{table.source}, row {row + 1}, {names[row]}") from None
        # The names of the conditions of other plans, such as axes of a domain.
        own = {key.replace("offset_angle", "offset_theta"): value for key, value in values.items()}
        conditions = own | dict(_conditions(table, row))
        rows.append(PlannedExperiment(name=names[row], scene=scene, conditions=conditions))
    return tuple(rows)


def write_rows(folder: Path, rows: Sequence[PlannedExperiment]) -> None:
    """Write `plan.csv` and the scene file of each row into a new folder, for `read_rows`."""
    names = dict.fromkeys(name for row in rows for name in row.conditions)
    head = ("name", "scene", *(f"{CONDITION}{name}" for name in names))
    lines = [(r.name, f"{r.name}.yaml", *map(r.conditions.get, names)) for r in rows]
    with folder_whole(folder) as unfinished:
        for row in rows:
            save_scene(SceneFile(scene=row.scene), unfinished / f"{row.name}.yaml")
        (unfinished / PLAN).write_text(Table(head, lines).csv(), encoding="utf-8")


def _templates(
    table: CsvRows, path: Path, usual: Path, stored: Callable[[str], Scene]
) -> Iterator[Scene]:
    """Yield the scene from which each row starts."""
    load = cache(lambda name: load_scene(path.parent / name).scene)
    loaders = {"scene": load, "experiment": cache(stored)}
    for row in range(len(table)):
        named = {k: cells[row] for k in loaders if (cells := table.columns.get(k)) and cells[row]}
        where = table.place([*named, "scene"][0], row)
        if len(named) > 1:
            raise InvalidInput(where, found="an experiment too", expected="one of them")
        if not named and not usual.is_file():
            expected = f"a scene file or an experiment, or the template {usual}"
            raise InvalidInput(where, found="none", expected=expected)
        kind, name = next(iter(named.items()), ("scene", str(usual.absolute())))
        try:
            yield loaders[kind](name)
        except InvalidInput as problem:
            raise problem.within(where) from None


def _values(table: CsvRows, keys: Sequence[Sequence[str]]) -> Iterator[dict[str, float]]:
    """Yield the values of each row in SI units, out of its keys; empty cells have none."""
    every = dict.fromkeys(key for own in keys for key in own)
    columns = {}
    for title in table.columns:
        if title in PLAIN or title.startswith(CONDITION):
            continue
        ending = next((u for u in sorted(UNITS, key=len)[::-1] if title.endswith(f"_{u}")), None)
        key = f"{title.removesuffix(ending)}{UNITS[ending].si}" if ending else ""
        if ending is None or key not in every:
            shown = [re.sub("_m(?=$|_s)", "_mm", re.sub("_rad$", "_deg", one)) for one in every]
            known = (*PLAIN, f"{CONDITION}NAME", *shown)
            raise unknown_name(f"{table.source}, header", title, known)
        columns[title] = key, UNITS[ending].scale * table.numbers(title, blank=True)
    for row, own in enumerate(keys):
        values = {}
        for title, (key, cells) in columns.items():
            if np.isnan(value := float(cells[row])):
                continue
            wrong = key in ("travel_m", "speed_m_s") and value <= 0.0
            if wrong or key not in own:
                expected = "a number greater than 0" if wrong else "no value: no such fixel here"
                found = table.columns[title][row]
                raise InvalidInput(table.place(title, row), found=found, expected=expected)
            values[key] = value
        yield values


def _conditions(table: CsvRows, row: int) -> Iterator[tuple[str, str | float]]:
    """Yield the stated conditions of a row, as numbers where they are."""
    for title, cells in table.columns.items():
        if title.startswith(CONDITION) and (cell := cells[row]):
            name = title.removeprefix(CONDITION)
            number = name not in TEXTS and NUMBER.fullmatch(cell)
            yield name, float(cell) if number else cell
