"""Stated against measured distance of exported models from fixel, on fresh scenes.

    python -m benchmarks.model_export [--scenes 100] [--engines drake]

A card states the median distance between end poses of an engine and of fixel on scenes around the
exported one. Here the model is read back: its own program simulates fresh scenes, drawn with
another seed. Stated and measured medians should differ by at most 10 %, or by less than their
bootstrap intervals. Rows of engines that are not run, or not installed, stay in the results.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import itertools
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import numpy as np

import fixel
from fixel.engine_names import installed_engines
from fixel.model import Scene, pose_error
from fixel.simulation import Dynamic
from fixel.testing.scenes import grasp, pushed_square
from fixel.typing import FloatArray
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.workflows.model_export.run import start_error_of

RESULTS = Path(__file__).parent / "results" / "model_export.csv"
ENGINES = ("pymunk", "box2d", "mujoco", "drake")
COLUMNS = ("scene", "engine", "scenes", "stated_mm", "measured_mm", "difference", "overlap")
SCENES = {"push": pushed_square(), "slip grasp": grasp("slip", None)}
FRESH_SEED = 4711


def measured(scene: Scene, engine: str, folder: Path, n: int) -> tuple[dict[str, Any], FloatArray]:
    """Export a scene, and return the stated position distance and fresh ones (n,) [mm].

    The centre of mass of the body must be the origin of its frame.
    """
    done = fixel.export_model(scene, folder, to=engine, scenes=n, progress=False)
    program = _program(folder)
    model = json.loads((folder / "model.json").read_text("utf-8"))
    fresh = simulate_starts(
        scene, start_error_of(scene), n, times=[scene.duration], motion=Dynamic(), seed=FRESH_SEED
    )
    found = []
    for start, end in zip(fresh.start, fresh.pose[:, -1], strict=True):
        model["body"]["start"] = start.tolist()
        distance, _ = pose_error(np.array(list(program.simulate(model))[-1]), end)
        found.append(1e3 * float(distance))
    stated: dict[str, Any] = done.card["distance_from_fixel"]["position_mm"]
    return stated, np.array(found)


def _program(folder: Path) -> ModuleType:
    """Load `run.py` of an export, with its own `drive.py`."""
    sys.path.insert(0, str(folder))
    try:
        sys.modules.pop("drive", None)
        found = importlib.util.spec_from_file_location("exported_run", folder / "run.py")
        assert found is not None
        assert found.loader is not None
        program = importlib.util.module_from_spec(found)
        found.loader.exec_module(program)
    finally:
        sys.path.remove(str(folder))
    return program


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--engines", nargs="+", choices=ENGINES, default=ENGINES)
    options = parser.parse_args()
    n, installed = options.scenes, installed_engines()
    with RESULTS.open(newline="", encoding="utf-8") as file:
        rows: dict[tuple[str, str], Sequence[Any]]
        rows = {(row[0], row[1]): row for row in list(csv.reader(file))[1:]}
    for name, scene in SCENES.items():
        for engine in (own for own in options.engines if own in installed):
            with TemporaryDirectory() as folder:
                stated, found = measured(scene, engine, Path(folder) / "model", n)
            rng = np.random.default_rng(1)
            medians = np.median(found[rng.integers(n, size=(1000, n))], axis=1)
            low, high = np.quantile(medians, (0.025, 0.975))
            median = float(np.median(found))
            apart = median / stated["median"] - 1.0
            overlap = low <= stated["median_high"] and stated["median_low"] <= high
            rows[name, engine] = [name, engine, n, stated["median"], median, apart, overlap]
            print(
                f"{name:10} {engine:7} stated {stated['median']:.4f} mm"
                f" ({stated['median_low']:.4f} to {stated['median_high']:.4f}),"
                f" measured {median:.4f} mm ({low:.4f} to {high:.4f}), {100 * apart:+.1f} %,"
                f" intervals {'overlap' if overlap else 'do not overlap'}"
            )
    with RESULTS.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        table.writerows(rows[key] for key in itertools.product(SCENES, ENGINES) if key in rows)


if __name__ == "__main__":
    main()
