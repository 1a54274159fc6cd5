"""Records the reference numbers of `test_push_t.py`, with an interpreter that has gym-pusht.

    python tests/environments/record_push_t.py

Recorded with gym-pusht 0.1.8 and pymunk 6.11.1; the seeds of "0.1.5" with gym-pusht 0.1.5.
"""

from __future__ import annotations

import csv
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import gymnasium
import numpy as np
from PIL import Image

FOLDER = Path(__file__).parent
SEEDS, PUSHES, PICTURES = 60, 200, 6
STROKE, LEAD = 200.0, 0.2  # [px]; [s] the controller's lag
PIECES = np.array([[-60, 0], [60, 0], [60, 30], [15, 30], [15, 120], [-15, 120], [-15, 30]])


def _rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _corners(pose: np.ndarray) -> np.ndarray:
    return PIECES @ _rotation(pose[2]).T + pose[:2]


def _push(rng: np.random.Generator) -> tuple[np.ndarray, float, float]:
    """Draw a start state, direction and speed of a push towards the T."""
    while True:
        angle, origin = rng.uniform(-np.pi, np.pi), rng.uniform(180, 330, 2)
        towards, speed = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(20.0, 150.0)
        along = np.array([np.cos(towards), np.sin(towards)])
        middle = origin + _rotation(angle) @ [0.0, 45.0]
        agent = middle + rng.uniform(-40.0, 40.0, 2) - 120.0 * along
        ends = np.array([agent, agent + STROKE * along])
        pose = np.array([*origin, angle])
        edges = np.concatenate(
            [
                _corners(pose) + u * (np.roll(_corners(pose), -1, 0) - _corners(pose))
                for u in np.linspace(0, 1, 20)
            ]
        )
        far = np.hypot(*(edges - agent).T).min() > 17.0
        if far and ends.min() > 20.0 and ends.max() < 492.0:
            # gym-pusht places the T before it turns it about (0, 45).
            placed = origin - [0.0, 45.0] + _rotation(angle) @ [0.0, 45.0]
            return np.array([*agent, *placed, angle]), towards, speed


def actions(start: np.ndarray, towards: float, speed: float) -> np.ndarray:
    """Targets (n, 2) of an agent that moves at a speed over the stroke."""
    steps = np.arange(1, int(np.ceil(STROKE / speed * 10.0)) + 16)
    along = np.array([np.cos(towards), np.sin(towards)])
    way = np.minimum(steps * speed * 0.1, STROKE) + LEAD * speed
    return (start[:2] + along * way[:, None]).astype(np.float32)


def main() -> None:
    old = version("gym-pusht") == "0.1.5"
    import_module("gym_pusht")  # registers the environment
    env = gymnasium.make("gym_pusht/PushT-v0", obs_type="environment_state_agent_pos").unwrapped
    with open(FOLDER / f"push_t_seeds_{'0.1.5' if old else '0.1.8'}.csv", "w") as file:
        for seed in range(SEEDS):
            seen, _ = env.reset(seed=seed)
            row = [*seen["agent_pos"], *seen["environment_state"]]
            csv.writer(file, lineterminator="\n").writerow([repr(float(x)) for x in row])
    if old:
        return
    rng, rows = np.random.default_rng(5), []
    while len(rows) < PUSHES:
        start, towards, speed = _push(rng)
        _, info = env.reset(seed=0, options={"reset_to_state": start})
        inside = True
        for action in actions(start, towards, speed):
            _, _, _, _, info = env.step(action)
            corners = _corners(info["block_pose"])
            inside = inside and corners.min() > 9.0 and corners.max() < 502.0
        if inside:  # jams at walls differ
            end = [*info["pos_agent"], *info["block_pose"], info["coverage"]]
            rows.append([*start, towards, speed, *end])
    with open(FOLDER / "push_t_pushes.csv", "w") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [[repr(float(x)) for x in row] for row in rows]
        )
    env = gymnasium.make("gym_pusht/PushT-v0", obs_type="pixels").unwrapped
    pictures = [env.reset(seed=seed)[0] for seed in range(PICTURES)]
    Image.fromarray(np.concatenate(pictures, axis=1)).save(FOLDER / "push_t_pictures.png")


if __name__ == "__main__":
    main()
