"""Steps per second of a vectorised Push-T task; any interpreter with gym-pusht or fixel runs it.

python benchmarks/push_t_process.py ID async|sync|vector_entry_point ACTIONS ENVIRONMENTS STEPS
"""

from __future__ import annotations

import importlib
import json
import sys
import time
import warnings
from typing import Any

import gymnasium
import numpy as np

WARM_UP = 5


def steps_per_second(name: str, mode: str, actions: str, n: int, steps: int) -> float:
    """Return the steps per second of all environments together.

    Parameters
    ----------
    name : str
        Name of the environment, after `gym_pusht/` or `fixel/`.
    mode : str
        Vectorisation mode of Gymnasium.
    actions : str
        ``"random"``: places on the table. ``"pushes"``: places near the T and away from the walls,
        so that most steps move it.
    n, steps : int
        Number of environments, and of steps of each.
    """
    envs: Any = gymnasium.make_vec(name, num_envs=n, vectorization_mode=mode, obs_type="state")
    rng = np.random.default_rng(0)
    seen, _ = envs.reset(seed=0)
    start = 0.0
    for step in range(-WARM_UP, steps):
        if step == 0:
            start = time.perf_counter()
        near = (seen[:, 2:4] + rng.uniform(-80.0, 80.0, (n, 2))).clip(120.0, 392.0)
        anywhere = rng.uniform(0.0, 512.0, (n, 2))
        seen, *_ = envs.step((near if actions == "pushes" else anywhere).astype(np.float32))
    taken = time.perf_counter() - start
    envs.close()
    return n * steps / taken


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    name, mode, actions = sys.argv[1:4]
    importlib.import_module(
        {"gym_pusht": "gym_pusht"}.get(name.split("/")[0], "fixel.environments")
    )
    found = steps_per_second(name, mode, actions, int(sys.argv[4]), int(sys.argv[5]))
    print(json.dumps(found))
