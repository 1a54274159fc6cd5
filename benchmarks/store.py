"""How fast a store takes experiments in and lists them.

``python -m benchmarks.store [--n 10000] [--url URL]``: 330 frames each, with pusher path and
tactile signals; a new SQLite file unless the URL of an empty database is given.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fixel.database.store import Store
from fixel.model import Channel, Experiment, Flag, Provenance, Trajectory
from fixel.model.selection import Bound, ExperimentQuery
from fixel.testing.scenes import grasp

FRAMES = 330
QUERIES = {
    "all": ExperimentQuery(),
    "by condition": ExperimentQuery(bounds=(Bound("surface", "=", "abs"),)),
    "by name": ExperimentQuery(name="*77*"),
    "by flag": ExperimentQuery(flags=("odd",)),
}


def experiments(n: int) -> Iterator[Experiment]:
    """Random experiments, every tenth with a fault."""
    random = np.random.default_rng(0)
    scene = grasp("seated")
    instants = np.arange(FRAMES) / 30.0
    for k in range(n):
        touch = (random.random((FRAMES, 3)) > 0.5).astype(float)
        columns = ("fixel_1_bool", "fixel_2_bool", "fixel_3_bool")
        yield Experiment(
            dataset="benchmark",
            name=f"{k:06d}",
            real=False,
            simulated_by="benchmarks.store",
            provenance=Provenance(version="0"),
            trajectory=Trajectory(time=instants, pose=random.normal(size=(FRAMES, 3))),
            pusher=Trajectory(time=instants, pose=random.normal(size=(FRAMES, 3))),
            scene=scene,
            object_name=scene.bodies[0].name,
            channels=(Channel(name="tactile", time=instants, columns=columns, values=touch),),
            contact_mode="010",
            conditions={"surface": "abs" if k % 2 else "plywood"},
            flags=(Flag("odd"),) if k % 10 == 0 else (),
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=10_000)
    parser.add_argument("--url")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        url = given.url or f"sqlite:///{folder}/experiments.db"
        with Store(url, Path(folder) / "media") as store:
            store.upgrade()
            begun = time.perf_counter()
            for experiment in experiments(given.n):
                store.add_experiment(experiment)
            print(f"{given.n} experiments in {time.perf_counter() - begun:.1f} s")
            for name, query in QUERIES.items():
                begun = time.perf_counter()
                listing = store.experiments(query)
                spent = 1e3 * (time.perf_counter() - begun)
                print(f"{name:13s} {len(listing.rows):6d} listed in {spent:6.1f} ms")


if __name__ == "__main__":
    main()
