"""Push-T episodes as a LeRobot dataset: the published layout, and the same when replayed."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fixel.environments.push_t import PushTVectorEnv
from fixel.environments.push_t_planner import PushTPlanner
from fixel.errors import InvalidInput
from fixel.formats.lerobot import write_push_t

# What the reader of lerobot 0.4.4 requires of a dataset v3.0, copied by hand from its source
# (`lerobot/datasets/utils.py`), and the features of the public dataset lerobot/pusht but for its
# pictures: data type and shape.
FEATURES = {
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
OURS = {"observation.environment_state": ("float32", [16]), "is_real": ("bool", [1])}
INFO = {
    "codebase_version": "v3.0",
    "total_episodes": 3,
    "total_frames": 75,
    "total_tasks": 1,
    "chunks_size": 1000,
    "data_files_size_in_mb": 100,
    "video_files_size_in_mb": 200,
    "fps": 10,
    "splits": {"train": "0:3"},
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "video_path": None,
}
EPISODE = {
    "episode_index": 1,
    "tasks": ["Push the T-shaped block onto the T-shaped target."],
    "length": 25,
    "data/chunk_index": 0,
    "data/file_index": 0,
    "dataset_from_index": 25,
    "dataset_to_index": 50,
    "meta/episodes/chunk_index": 0,
    "meta/episodes/file_index": 0,
}
STATISTICS = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}


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


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pusht")
    assert write_push_t([_episode(seed, 25) for seed in (1, 2, 3)], folder) == 75
    return folder, pq.read_table(folder / "data/chunk-000/file-000.parquet")


def test_a_dataset_has_the_published_layout(dataset):
    folder, table = dataset
    info = json.loads((folder / "meta/info.json").read_text())
    assert {key: info[key] for key in INFO} == INFO
    found = {key: (own["dtype"], own["shape"]) for key, own in info["features"].items()}
    assert found == FEATURES | OURS
    assert all("names" in own for own in info["features"].values())
    # Features of one number are columns of numbers, others of lists of a fixed length.
    kinds = {"float32": pa.float32(), "bool": pa.bool_(), "int64": pa.int64()}
    for key, (kind, (n,)) in found.items():
        expected = kinds[kind] if n == 1 else pa.list_(kinds[kind], n)
        assert table.schema.field(key).type == expected
    assert set(table.column_names) == set(found)
    tasks = pq.read_table(folder / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": EPISODE["tasks"]}
    assert tasks.schema.pandas_metadata["index_columns"] == ["task"]


def test_frames_and_episodes_refer_to_each_other(dataset):
    folder, table = dataset
    frame = np.arange(75) % 25
    assert table["index"].to_pylist() == list(range(75))
    assert table["episode_index"].to_pylist() == (np.arange(75) // 25).tolist()
    assert table["frame_index"].to_pylist() == frame.tolist()
    assert np.abs(np.array(table["timestamp"]) - frame / 10).max() < 1e-4  # LeRobot's tolerance
    assert np.flatnonzero(table["next.done"]).tolist() == [24, 49, 74]
    stored = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert {key: stored[1][key] for key in EPISODE} == EPISODE
    statistics = json.loads((folder / "meta/stats.json").read_text())
    for key, (_, (n,)) in (FEATURES | OURS).items():
        assert set(statistics[key]) == STATISTICS
        assert len(statistics[key]["mean"]) == len(stored[1][f"stats/{key}/q99"]) == n
        assert (statistics[key]["count"], stored[1][f"stats/{key}/count"]) == ([75], [25])
    actions = np.stack(table["action"].to_numpy())
    assert statistics["action"]["mean"] == pytest.approx(actions.mean(axis=0), rel=1e-5)
    assert stored[1]["stats/action/max"] == pytest.approx(actions[25:50].max(axis=0))


def test_stored_actions_replay_the_episodes(dataset):
    table = dataset[1]
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
