"""Tests of what all environments share: episodes, copies, parameters, spaces and pictures."""

import copy
import functools
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from tests.fixtures import refused

import fixel
from fixel.environments.grasp import GraspVectorEnv
from fixel.environments.pictures import BODY
from fixel.environments.push import PushVectorEnv, push_scene
from fixel.environments.push_t import PushTVectorEnv
from fixel.errors import InvalidInput
from fixel.parts.next_pushes import push_candidates
from fixel.testing.pushes import example_pushes

KINDS = {"PushT": PushTVectorEnv, "Push": PushVectorEnv, "Grasp": GraspVectorEnv}
AT_GOAL = [450.0, 450.0, 256.0 - 45.0 * 0.5**0.5, 211.0 + 45.0 * 0.5**0.5, np.pi / 4.0]
every_task = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def _towards(env, seen):
    """Actions that move the bodies."""
    if isinstance(env, PushTVectorEnv):
        return seen[:, 2:4]
    if isinstance(env, PushVectorEnv):
        return np.clip(seen["achieved_goal"][:, :2] / env.half_side, -1.0, 1.0)
    return np.tile([0.2, -0.3], (env.num_envs, 1))


def _flat(seen):
    return np.concatenate(list(seen.values()), axis=1) if isinstance(seen, dict) else seen


def _episode(env, seen, steps=20):
    """Observations of some steps towards the bodies."""
    found = [_flat(seen)]
    for _ in range(steps):
        seen, *_ = env.step(_towards(env, seen))
        found.append(_flat(seen))
    return np.array(found)


@functools.cache
def _of_a_square(source):
    """Posterior or calibration of a push of a square of 100 mm."""
    return _calibrated(source, example_pushes(1, duration=0.3)[0])


def _calibrated(source, push):
    """Posterior or calibration of one push."""
    space = {"mu_pusher": (0.1, 0.5), "tripod_radius": (0.03, 0.05)}
    if source == "calibration":
        return fixel.calibrate([push], space, verdicts=False, progress=False)
    return fixel.posterior([push], {**space, "tripod_radius": 0.038}, samples=20, progress=False)


def _push_of_its_part(kind):
    """Simulated push of the part of an environment, on a tripod."""
    tripod = fixel.Tripod(radius=0.04, friction=0.25)
    body = replace(kind().scene.bodies[0], support=tripod, pose=np.zeros(3))
    scene = push_candidates(body, travel=0.02, contacts=4)[1]
    run = fixel.simulate(scene, output_interval=scene.duration / 5)
    track = fixel.Trajectory(time=run.time, pose=run.pose[body.name])
    return replace(
        example_pushes(1, duration=0.3)[0], scene=scene, trajectory=track, object_name=body.name
    )


@every_task
@pytest.mark.usefixtures("few_live")
@pytest.mark.parametrize("source", ["posterior", "calibration"])
def test_worlds_are_drawn_from_calibrations(kind, source):
    env = kind(40, world="posterior", parameters=_calibrated(source, _push_of_its_part(kind)))
    _, info = env.reset(seed=0)
    drawn = {name: x for name, x in info["parameters"].items() if name[0] != "_"}
    # The model's own error is no parameter of the world.
    assert set(drawn) == {"mu_pusher", "tripod_radius"}
    assert np.ptp(drawn["mu_pusher"]) > 0.0
    assert ((drawn["mu_pusher"] >= 0.1) & (drawn["mu_pusher"] <= 0.5)).all()
    assert env.scene.bodies[0].support.radius > 0.0
    env.step(env.action_space.sample())


@every_task
@pytest.mark.usefixtures("few_live")
@pytest.mark.parametrize("source", ["posterior", "calibration"])
def test_the_support_of_another_part_is_refused(kind, source):
    """A calibration on a square of 100 mm, whose friction alone any part may have."""
    with pytest.raises(InvalidInput, match="tripod_radius: found values of a part with another"):
        kind(2, world="posterior", parameters=_of_a_square(source))
    kind(2, world="posterior", parameters={"mu_pusher": (0.1, 0.5)})


@every_task
@pytest.mark.parametrize("world", ["nominal", "posterior"])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_as_its_original(kind, world, copied):
    env = kind(3, world=world, max_episode_steps=6)
    seen, _ = env.reset(seed=1)
    seen, *_ = env.step(_towards(env, seen))
    other = copied(env)
    assert (_episode(env, seen) == _episode(other, seen)).all()


@every_task
def test_environments_in_two_threads_do_not_disturb_each_other(kind):
    def run(seed):
        env = kind(64, threads=2)
        return _episode(env, env.reset(seed=seed)[0], steps=5)

    with ThreadPoolExecutor(2) as pool:
        assert all((run(k) == x).all() for k, x in enumerate(pool.map(run, range(2))))


@pytest.mark.parametrize("env", [
    PushTVectorEnv(32, world="nominal"),
    PushVectorEnv(32),
    PushVectorEnv(32, scene=push_scene(fixel.Disk(0.003)), goal=(0.5, 0.0, 0.0)),
    GraspVectorEnv(32, start=(0.3, 0.3, 1.0), max_episode_steps=20),
], ids=["PushT", "Push", "small", "Grasp"])  # fmt: skip
def test_observations_are_in_their_space(env):
    seen, _ = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for step in range(20):
        assert env.observation_space.contains(seen)
        action = _towards(env, seen) if step % 3 else env.action_space.sample()
        noise = 0.1 * rng.standard_normal(action.shape) * (env.single_action_space.high / 2)
        low, high = env.single_action_space.low, env.single_action_space.high
        seen, *_ = env.step(np.clip(action + noise, low, high))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_an_episode_may_end_and_be_truncated_in_one_step(mode):
    options = {"reset_to_state": AT_GOAL}
    env = PushTVectorEnv(2, max_episode_steps=1, autoreset_mode=mode)
    one = gymnasium.make("fixel/PushT-v0", max_episode_steps=1)
    env.reset(options=options), one.reset(options=options)
    action = np.array([450.0, 450.0])
    _, reward, over, cut, info = env.step([action, action])
    assert (reward[0], over[0], cut[0]) == one.step(action)[1:4] == (1.0, True, True)
    assert ("final_info" in info) == (mode == AutoresetMode.SAME_STEP)
    if mode == AutoresetMode.SAME_STEP:
        assert info["final_info"]["is_success"].all()
    if mode == AutoresetMode.DISABLED:
        env.reset(options={"reset_mask": np.array([True, False])})
        refused(env.step, [action, action], match="1 environments without")
    else:
        _, reward, over, cut, _ = env.step([action, action])
        assert not over.any()
        assert cut.any() == (mode == AutoresetMode.SAME_STEP)


OBSERVED = ("state", "environment_state_agent_pos", "pixels", "pixels_agent_pos")
CHECKED = [
    *(("PushT", {"obs_type": o, "world": w}) for o in OBSERVED for w in ("legacy", "posterior")),
    *((name, {"world": w}) for name in KINDS for w in ("nominal", "posterior")),
]


@pytest.mark.parametrize(("name", "options"), CHECKED)
def test_gymnasium_finds_no_fault_in_any_world(name, options):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        check_env(gymnasium.make(f"fixel/{name}-v0", **options).unwrapped)
    if name == "PushT":
        assert all("symmetric and normalized" in str(own.message) for own in found)


@every_task
def test_environments_close_and_render_as_gymnasium_expects(kind):
    env = kind(2, render_mode=None)
    env.reset(seed=0)
    assert env.render() is None
    env.close()
    env.close()
    name = next(name for name, own in KINDS.items() if own is kind)
    many = gymnasium.make_vec(f"fixel/{name}-v0", 2, render_mode="rgb_array")
    many.reset(seed=0)
    assert len(many.render()) == 2
    with pytest.raises(TypeError, match="autoreset_mode"):
        gymnasium.make(f"fixel/{name}-v0", autoreset_mode="SameStep")
    for wrong in ({"autoreset_mode": "Never"}, {"max_episode_steps": 0}):
        refused(kind, 1, match=next(iter(wrong)), **wrong)


def test_a_cross_marks_the_action_in_a_wide_picture():
    env = PushTVectorEnv(1, visualization_width=400, visualization_height=200)
    env.reset(options={"reset_to_state": [60.0, 60.0, 256.0, 256.0, 0.0]})
    env.step([[384.0, 64.0]])
    red = np.argwhere((env.picture(0) == (255, 0, 0)).all(axis=2))
    assert red.mean(axis=0) == pytest.approx([25.0, 300.0], abs=1.0)


def test_pictures_show_whole_bodies():
    env = PushVectorEnv(1, goal=(0.0, 0.0, 0.0))
    env.reset(seed=3)
    for action in ([[1.0, 1.0]], [[-1.0, 1.0]]):  # the agent at the border of the table
        for _ in range(10):
            env.step(action)
        blue = (env.picture(0) == (65, 105, 225)).all(axis=2).sum()
        radius = 240.0 * 0.0125 / (env._reach + env.scene.bodies[0].shape.radius)
        assert blue == pytest.approx(np.pi * radius**2, rel=0.15)
    env = GraspVectorEnv(1)
    env.reset(seed=0)
    env.step([[0.0, 1.0]])
    colour = tuple(int(BODY[k : k + 2], 16) for k in (1, 3, 5))
    grey = (env.picture(0) == colour).all(axis=2).sum()
    size = env.scene.bodies[0].shape.radius
    points = np.array([[0.2, -0.03], [0.2, 0.03], [0.15, 0.085], [0.0, 0.0]])
    scale = 480.0 / (np.ptp(points, axis=0).max() + 2.0 * size)
    assert grey == pytest.approx((0.1075 * scale) ** 2, rel=0.05)  # nothing covers it


def test_rotations_of_a_disk_do_not_count():
    env = PushVectorEnv(1, scene=fixel.Disk(0.04))
    goals = np.array([[0.1, 0.2, 1.0, 0.0], [0.1, 0.2, -1.0, 0.0]])
    assert env.compute_reward(goals, goals[[0, 0]], {}).tolist() == [0.0, 0.0]
