"""Trajectory files: one row per sample, as CSV or Parquet.

Columns, in this order, the same for every simulation of a scene with the same contact pairs:

- ``time_s``;
- per body and pusher ``NAME.x_m``, ``.y_m``, ``.theta_rad`` of its shape frame and ``.vx_m_per_s``,
  ``.vy_m_per_s``, ``.omega_rad_per_s`` of its centre of mass;
- per pusher ``NAME.force_N`` along its path and ``NAME.stalled``;
- per pair that ever touches ``BODY|OTHER.touching``, and of the step that ends at this sample
  ``.normal_impulse_Ns``, ``.tangential_impulse_Ns`` (along the normal, from OTHER into BODY, turned
  by +90 degrees), ``.normal_force_N`` and ``.tangential_force_N``, summed over contact points.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fixel.errors import require
from fixel.io.atomic import refuse_ending, written_whole
from fixel.io.document import plain_numbers
from fixel.simulation import Simulation
from fixel.table import csv_cell

TRAJECTORY_ENDINGS = (".csv", ".parquet")

_POSE = ("x_m", "y_m", "theta_rad")
_TWIST = ("vx_m_per_s", "vy_m_per_s", "omega_rad_per_s")


def save_trajectory(simulation: Simulation, path: str | Path) -> None:
    """Write motion, contacts and drives of a simulation to a `.csv` or `.parquet` file.

    A failed simulation is written up to where it stopped. Parquet also has the summary of the
    simulation, as JSON under the key ``fixel`` of its metadata; without pyarrow it raises
    `MissingExtra`.
    """
    path = Path(path)
    refuse_trajectory_ending(path)
    columns = trajectory_columns(simulation)
    with written_whole(path) as temporary:
        (_write_csv if path.suffix.lower() == ".csv" else _write_parquet)(
            temporary, columns, simulation
        )


def _write_csv(path: Path, columns: dict[str, NDArray[Any]], simulation: Simulation) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        head = csv.writer(stream, quoting=csv.QUOTE_ALL, lineterminator="\n")
        head.writerow(map(csv_cell, columns))
        rows = zip(*(map(_cell, column.tolist()) for column in columns.values()), strict=True)
        stream.writelines(",".join(row) + "\n" for row in rows)


def _cell(value: float) -> str:
    """Shortest text that reads back as the same number, as Arrow writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if value and not 1e-6 <= abs(value) < 1e10 and math.isfinite(value):
        return np.format_float_scientific(value, trim="-", exp_digits=1)
    return np.format_float_positional(value, trim="-")


def _write_parquet(path: Path, columns: dict[str, NDArray[Any]], simulation: Simulation) -> None:
    # Imported here since the first import of pyarrow takes a second.
    import pyarrow as pa
    import pyarrow.parquet as pa_parquet

    about = json.dumps(plain_numbers(simulation.summary()))
    table = pa.table(columns).replace_schema_metadata({"fixel": about})
    pa_parquet.write_table(table, path)


def refuse_trajectory_ending(path: str | Path) -> None:
    """Raise for a file name whose ending is no known format, or needs a missing package."""
    refuse_ending(path, TRAJECTORY_ENDINGS, "trajectory")
    if Path(path).suffix.lower() == ".parquet":
        require("pyarrow", str(path), extra="parquet")


def trajectory_columns(simulation: Simulation) -> dict[str, NDArray[Any]]:
    """Columns of a trajectory file by name, in order, each (n_sample,)."""
    columns: dict[str, NDArray[Any]] = {"time_s": simulation.time}
    for name, pose in simulation.pose.items():
        for k, label in enumerate(_POSE):
            columns[f"{name}.{label}"] = pose[:, k]
        for k, label in enumerate(_TWIST):
            columns[f"{name}.{label}"] = simulation.twist[name][:, k]
    for name, trace in simulation.pushers.items():
        columns[f"{name}.force_N"] = trace.force
        columns[f"{name}.stalled"] = trace.stalled
    return columns | _contact_columns(simulation)


def _contact_columns(simulation: Simulation) -> dict[str, NDArray[Any]]:
    table, names, n = simulation.contacts, simulation.names, len(simulation.time)
    columns: dict[str, NDArray[Any]] = {}
    sample = np.searchsorted(simulation.time, table["time"])
    pairs = np.column_stack((table["body"], table["other"]))
    for body, other in np.unique(pairs, axis=0):
        own = (pairs == (body, other)).all(axis=1)
        rows, at = table[own], sample[own]
        label = f"{names[body]}|{names[other]}"
        columns[f"{label}.touching"] = np.bincount(at, minlength=n) > 0
        for part in ("normal", "tangential"):
            force = rows[f"{part}_force"]
            columns[f"{label}.{part}_impulse_Ns"] = np.bincount(at, force * rows["step"], n)
            columns[f"{label}.{part}_force_N"] = np.bincount(at, force, n)
    return columns
