"""The Push-T task: equal to gym-pusht where it says so, and to itself for any number of copies.

The numbers of gym-pusht are recorded by `record_push_t.py`. Tolerances are those of
docs/how-to/environments.md.
"""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
import shapely
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from PIL import Image
from tests.environments.record_push_t import PICTURES, actions
from tests.fixtures import refused

import fixel.environments  # noqa: F401
from fixel.environments.loops import coverage
from fixel.environments.push_t import GOAL, PIECES, PushTVectorEnv, placed_pieces
from fixel.environments.push_t_planner import PushTPlanner

HERE = Path(__file__).parent
MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)


@pytest.mark.parametrize("version", ["0.1.5", "0.1.8"])
def test_a_seed_stands_for_the_start_that_it_has_in_gym_pusht(version):
    recorded = np.loadtxt(HERE / f"push_t_seeds_{version}.csv", delimiter=",")
    env = PushTVectorEnv(len(recorded), seeds=version, obs_type="environment_state_agent_pos")
    found, _ = env.reset(seed=0)
    assert np.abs(found["agent_pos"] - recorded[:, :2]).max() < 1e-9
    assert np.abs(found["environment_state"] - recorded[:, 2:]).max() < 1e-9


def test_scripted_pushes_end_where_those_of_gym_pusht_do():
    recorded = np.loadtxt(HERE / "push_t_pushes.csv", delimiter=",")
    start, (towards, speed), end = recorded[:, :5], recorded[:, 5:7].T, recorded[:, 7:]
    paths = [actions(*own) for own in zip(start, towards, speed, strict=True)]
    env = PushTVectorEnv(len(start), max_episode_steps=None)
    env.reset(options={"reset_to_state": start})
    found = np.zeros((len(start), 6))
    for step in range(max(map(len, paths))):
        *_, info = env.step(np.array([path[min(step, len(path) - 1)] for path in paths]))
        last = [step == len(path) - 1 for path in paths]
        seen = [info[name] for name in ("pos_agent", "block_pose", "coverage")]
        found[last] = np.column_stack(seen)[last]
    assert np.abs(found[:, :2] - end[:, :2]).max() < 1e-9
    away = np.hypot(*(found - end)[:, 2:4].T)
    assert np.median(away) <= 0.3
    assert away.max() <= 2.0
    assert np.degrees(np.abs(found - end)[:, 4]).max() < 1.0
    # The coverage at the recorded pose, which no motion separates from the recorded one.
    own = np.zeros(len(end))
    coverage(end[:, 2:5].copy(), PIECES, placed_pieces(GOAL), 0, len(own), own)
    assert np.abs(own - end[:, 5]).max() < 1e-9


def test_pictures_are_those_of_gym_pusht():
    recorded = np.split(np.asarray(Image.open(HERE / "push_t_pictures.png")), PICTURES, axis=1)
    found, _ = PushTVectorEnv(PICTURES, obs_type="pixels").reset(seed=0)
    off = np.abs(found.astype(float) - np.array(recorded)).mean(axis=(1, 2, 3))
    assert off.max() <= 2.0


def test_coverage_is_the_area_that_shapely_computes():
    rng = np.random.default_rng(0)
    poses = np.column_stack((rng.uniform(150, 350, (300, 2)), rng.uniform(-9, 9, 300)))
    poses[0] = GOAL
    found = np.zeros(300)
    coverage(poses, PIECES, placed_pieces(GOAL), 0, 300, found)
    goal = shapely.unary_union([shapely.Polygon(own) for own in placed_pieces(GOAL)])
    for pose, share in zip(poses, found, strict=True):
        t = shapely.unary_union([shapely.Polygon(own) for own in placed_pieces(pose)])
        assert share == pytest.approx(goal.intersection(t).area / goal.area, abs=1e-9)


@pytest.mark.parametrize("world", ["legacy", "nominal", "posterior"])
@pytest.mark.parametrize("mode", MODES)
def test_copies_are_bit_for_bit_as_many_single_environments(world, mode):
    n, steps = 12, 40
    many = gymnasium.make_vec(
        "fixel/PushT-v0", n, world=world, autoreset_mode=mode, max_episode_steps=25
    )
    single = SyncVectorEnv(
        [lambda: gymnasium.make("fixel/PushT-v0", world=world, max_episode_steps=25)] * n,
        autoreset_mode=mode,
    )
    (seen, _), (own, _) = many.reset(seed=7), single.reset(seed=7)
    assert (seen == own).all()
    assert many.observation_space == single.observation_space
    rng = np.random.default_rng(1)
    for _ in range(steps):
        # Towards the T, so that it moves.
        target = seen[:, 2:4] + rng.uniform(-60, 60, (n, 2))
        one, other = many.step(target), single.step(target.astype(np.float64))
        for a, b in zip(one[:4], other[:4], strict=True):
            assert (a == b).all()
        for name in ("block_pose", "coverage", "is_success", "n_contacts"):
            assert (one[4][name] == other[4][name]).all()
            assert (one[4][f"_{name}"] == other[4][f"_{name}"]).all()
        assert ("final_info" in one[4]) == ("final_info" in other[4])
        if "final_info" in one[4]:
            for a, b in zip(one[4]["final_obs"], other[4]["final_obs"], strict=True):
                assert a is b is None or (a == b).all()
        seen = one[0]


def test_an_episode_does_not_depend_on_threads():
    seen = []
    for threads in (1, 3):
        env = PushTVectorEnv(64, threads=threads)
        seen.append([env.reset(seed=0)[0]])
        for _ in range(10):
            seen[-1].append(env.step(seen[-1][-1][:, 2:4])[0])
    assert np.array_equal(*map(np.array, seen))


@pytest.mark.parametrize("block_cog", [None, (30.0, 150.0)])
@pytest.mark.parametrize("seeds", ["0.1.5", "0.1.8"])
@pytest.mark.parametrize("kind", ["state", "environment_state_agent_pos"])
def test_every_start_is_in_the_space_of_the_observations(kind, seeds, block_cog):
    """Also starts with a corner outside the picture, which gym-pusht draws now and then."""
    env = PushTVectorEnv(1000, obs_type=kind, seeds=seeds, block_cog=block_cog)
    found, _ = env.reset(seed=0)
    assert env.observation_space.contains(found)


def test_a_t_at_its_goal_ends_the_episode():
    env = gymnasium.make("fixel/PushT-v0")
    # gym-pusht places the T before it turns it about (0, 45).
    c = s = np.sqrt(0.5)
    placed = np.array([256.0 - 45.0 * s, 256.0 + 45.0 * c - 45.0])
    env.reset(options={"reset_to_state": [450.0, 450.0, *placed, np.pi / 4.0]})
    _, reward, over, cut, info = env.step(np.array([450.0, 450.0]))
    assert (reward, over, cut, info["is_success"]) == (1.0, True, False, True)
    assert info["coverage"] == pytest.approx(1.0)


def test_an_overlap_at_the_start_is_taken_back_as_gym_pusht_does():
    env = PushTVectorEnv(1, autoreset_mode="Disabled")
    seen, _ = env.reset(options={"reset_to_state": [256.0, 245.0, 256.0, 256.0, 0.0]})
    overlap = []
    for _ in range(8):
        overlap.append(245.0 + 15.0 - seen[0, 3])  # the T lies below the agent, y down
        seen, *_ = env.step(np.array([[256.0, 245.0]]))
    assert overlap[0] == pytest.approx(4.0)
    expected = 0.1 + 3.9 * 0.9 ** (0.6 * 10 * np.arange(8))
    assert overlap == pytest.approx(expected, abs=0.02)


def test_an_agent_stalls_at_a_t_that_lies_against_a_wall():
    env = PushTVectorEnv(1)
    # The bar's long edge towards the wall at the top, the agent below the stem's end.
    env.reset(options={"reset_to_state": [256.0, 330.0, 256.0, 502.0 - 45.0 - 45.0, np.pi]})
    for _ in range(30):
        seen, *_, info = env.step(np.array([[256.0, 500.0]]))
    corners = placed_pieces(info["block_pose"][0])
    assert corners.max() == pytest.approx(504.0, abs=0.05)
    assert seen[0, 1] + 15.0 == pytest.approx(corners[..., 1].min(), abs=0.2)
    assert np.abs(info["vel_agent"]).max() < 60.0
    *_, info = env.step(np.array([[256.0, 100.0]]))
    assert info["pos_agent"][0, 1] < seen[0, 1] - 5.0


def test_worlds_differ_and_say_what_they_drew():
    ends, drawn = [], []
    for world in ("legacy", "nominal", "posterior"):
        env = PushTVectorEnv(8, world=world)
        seen, info = env.reset(options={"reset_to_state": [180.0, 270.0, 256.0, 256.0, 1.0]})
        for _ in range(15):
            seen, *_, info = env.step(np.full((8, 2), [330.0, 290.0]))
        ends.append(seen[:, 2:])
        drawn.append(info.get("parameters"))
    assert np.ptp(ends[0], axis=0).max() == np.ptp(ends[1], axis=0).max() == 0.0
    assert np.abs(ends[0] - ends[1]).max() > 1.0
    assert np.ptp(ends[2], axis=0).max() > 1.0
    assert drawn[:2] == [None, None]
    assert (np.abs(drawn[2]["mu_pusher"] - 0.2) <= 0.05).all()
    assert np.ptp(drawn[2]["ellipsoid_torque"]) > 0.0


def test_parameters_of_the_posterior_world_are_what_a_belief_takes():
    sets = [{"mu_pusher": 0.1, "tripod_radius": 0.05}, {"mu_pusher": 0.3, "tripod_radius": 0.08}]
    env = PushTVectorEnv(6, world="posterior", parameters=sets)
    _, info = env.reset(seed=1)
    rows = set(zip(*(info["parameters"][n].tolist() for n in sets[0]), strict=True))
    assert rows == {(0.1, 0.05), (0.3, 0.08)}
    _, info = PushTVectorEnv(20, world="posterior").reset(seed=2)
    legacy, _ = PushTVectorEnv(20).reset(seed=2)
    assert not np.isnan(info["block_pose"]).any()
    assert (info["pos_agent"] == legacy[:, :2]).mean() > 0.5  # others overlapped, and are redrawn


def test_a_mask_resets_some_environments():
    env = PushTVectorEnv(4, autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=3)
    before, _ = env.reset(seed=0)
    after, info = env.reset(seed=9, options={"reset_mask": np.array([False, True, False, False])})
    assert (after[[0, 2, 3]] == before[[0, 2, 3]]).all()
    assert (after[1] != before[1]).any()
    assert info["_block_pose"].tolist() == [False, True, False, False]
    for _ in range(3):
        *_, cut, _ = env.step(after[:, :2])
    assert cut.all()
    refused(env.step, after[:, :2], match="call reset")


@pytest.mark.parametrize(("wrong", "where"), [
    ({"obs_type": "stat"}, "obs_type"),
    ({"world": "real"}, "world"),
    ({"seeds": "1"}, "seeds"),
    ({"damping": 0.5}, "damping"),
    ({"render_mode": "human"}, "render_mode"),
    ({"num_envs": 0}, "num_envs"),
    ({"observation_width": 0}, "picture"),
    ({"parameters": {"mu_pusher": 0.2}}, "parameters"),
    ({"world": "posterior", "parameters": {"mu_pushr": 0.2}}, "mu_pushr"),
])  # fmt: skip
def test_bad_arguments_are_refused(wrong, where):
    refused(PushTVectorEnv, match=where, **{"num_envs": 1, **wrong})


def test_bad_actions_and_states_are_refused():
    env = PushTVectorEnv(2)
    refused(env.step, np.zeros((2, 2)), match="call reset")
    env.reset(seed=0)
    for actions_given in (np.zeros(2), np.full((2, 2), np.nan)):
        refused(env.step, actions_given, match="actions")
    for options in ({"reset_to_state": [1.0, 2.0]}, {"reset_to_state": [np.inf] * 5}):
        refused(env.reset, options=options, match="reset_to_state")
    refused(env.reset, options={"reset_mask": np.zeros(2, bool)}, match="reset_mask")
    refused(env.reset, seed=[1], match="seed")


@pytest.mark.system
def test_planner_solves_most_episodes():
    n = 12
    env, planner = PushTVectorEnv(n), PushTPlanner(n)
    seen, _ = env.reset(seed=100_000)
    solved = np.zeros(n, bool)
    for _ in range(300):
        seen, _, over, cut, _ = env.step(planner.actions(seen))
        planner.restart(np.flatnonzero(over | cut))
        solved |= over
    assert solved.mean() > 0.8
