"""Push-T episodes as a LeRobot dataset: the published layout, and the same when replayed."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from fixel.environments.push_t import PushTVectorEnv
from fixel.environments.push_t_planner import PushTPlanner
from fixel.errors import InvalidInput
from fixel.formats.lerobot import write_push_t

# Features of the public dataset lerobot/pusht (v3.0), but for its pictures.
PUBLISHED = {
    "observation.state": ("float32", [2]),
    "action": ("float32", [2]),
    "next.reward": ("float32", [1]),
    "next.done": ("bool", [1]),
    "next.success": ("bool", [1]),
    "timestamp": ("float32", [1]),
    "frame_index": ("int64", [1]),
    "episode_index": ("int64", [1]),
    "index": ("int64", [1]),
    "task_index": ("int64", [1]),
}


def _episode(seed, steps):
    env = PushTVectorEnv(1, obs_type="environment_state_agent_pos", max_episode_steps=steps)
    planner = PushTPlanner(1)
    seen, info = env.reset(seed=seed)
    rows = []
    for _ in range(steps):
        pose = info["block_pose"].copy()
        pose[:, 2] %= 2.0 * np.pi
        action = planner.actions(np.concatenate((seen["agent_pos"], pose), axis=1))
        action = action.astype(np.float32)
        state = [seen["agent_pos"][0], seen["environment_state"][0], action[0]]
        seen, reward, over, cut, info = env.step(action)
        rows.append([*state, reward[0], (over | cut)[0], info["is_success"][0]])
        if rows[-1][4]:
            break
    names = ("observation.state", "observation.environment_state", "action", "next.reward")
    columns = zip(*rows, strict=True)
    return dict(zip((*names, "next.done", "next.success"), map(np.array, columns), strict=True))


def test_episodes_have_the_published_layout_and_replay(tmp_path):
    episodes = [_episode(seed, 25) for seed in (1, 2, 3)]
    assert write_push_t(episodes, tmp_path) == 75
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 10, 3)
    features = info["features"]
    assert {key: (features[key]["dtype"], features[key]["shape"]) for key in PUBLISHED} == PUBLISHED
    table = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet")
    assert set(table.column_names) == set(features)
    done = np.array(table["next.done"])
    assert np.flatnonzero(done).tolist() == [24, 49, 74]
    stored = pq.read_table(tmp_path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [row["dataset_to_index"] for row in stored] == [25, 50, 75]
    assert stored[1]["stats/next.reward/count"] == [25]
    tasks = pq.read_table(tmp_path / "meta/tasks.parquet").to_pydict()
    assert tasks["task"] == ["Push the T-shaped block onto the T-shaped target."]
    # The stored actions, from the same seed, give the stored rewards.
    env = PushTVectorEnv(3)
    env.reset(seed=[1, 2, 3])
    actions = np.stack(table["action"].to_numpy()).reshape(3, 25, 2)
    rewards = np.array(table["next.reward"]).reshape(3, 25)
    for step in range(24):
        _, reward, *_ = env.step(actions[:, step])
        assert reward == pytest.approx(rewards[:, step], abs=1e-6)


def test_incomplete_episodes_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"next\.success"):
        write_push_t([{"action": np.zeros((2, 2))}], tmp_path)
    episode = _episode(1, 3)
    with pytest.raises(InvalidInput, match="different lengths"):
        write_push_t([{**episode, "next.done": np.zeros(2, bool)}], tmp_path)
