"""A process that imports, for tests that end it: `python importing.py URL MEDIA ROUND`.

Says the number of each experiment on standard output once the store has said that it is there.
"""

import sys
from pathlib import Path

import numpy as np

from fixel.database import rows
from fixel.database.store import Store
from fixel.model import Channel, Experiment, Flag, Provenance, Trajectory
from fixel.testing.scenes import grasp

N = 40
LONG = 7  # every so many experiments one has a series that is a file
SMALL_MEDIA_BYTES = 2000


def experiment(batch, k):
    """The k-th experiment of a batch, the same in every process."""
    scene = grasp("seated")
    chance = np.random.default_rng([batch, k])
    n = 200 if k % LONG == 0 else 20
    time = np.linspace(0.0, 1.0, n)
    return Experiment(
        dataset=f"batch-{batch}",
        name=str(k),
        real=True,
        provenance=Provenance(version="0.1", command="import", source="a.csv", created="2026"),
        trajectory=Trajectory(time=time, pose=chance.normal(size=(n, 3))),
        scene=scene,
        object_name=scene.bodies[0].name,
        channels=(
            Channel(
                name="force", time=[0.0, 0.5], columns=("fx_n",), values=chance.normal(size=(2, 1))
            ),
        ),
        conditions={"surface": "plywood", "speed_m_s": 0.02},
        flags=[Flag("late", f"by {k} s", fault=False)],
    )


def main(url, media, batch):
    rows.MEDIA_BYTES = SMALL_MEDIA_BYTES
    # Made beforehand, so that a random moment is mostly one within a transaction.
    experiments = [experiment(int(batch), k) for k in range(N)]
    with Store(url, Path(media)) as store:
        store.check_version()
        print("ready", flush=True)
        for k, added in enumerate(map(store.add_experiment, experiments)):
            assert added.new
            print(k, flush=True)
    sys.stdin.read()  # until killed or ended by a line


if __name__ == "__main__":
    main(*sys.argv[1:])
