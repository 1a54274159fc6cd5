"""Pushes to a pose and grasps: equal to single simulations, and to themselves for any number."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import shapely
from gymnasium.vector import SyncVectorEnv

import fixel.environments  # noqa: F401
from fixel import Adaptive, Disk, Fixel, PathDrive, Polygon, Scene, Seated, simulate
from fixel.environments.grasp import GraspVectorEnv, grasp_scene
from fixel.environments.loops import STILL
from fixel.environments.motion import PushMotion
from fixel.environments.push import PushVectorEnv, push_scene
from fixel.errors import InvalidInput
from fixel.model import placed
from fixel.testing.scenes import pushed_square

ELL = Polygon([[0.0, 0.0], [0.1, 0.0], [0.1, 0.04], [0.04, 0.04], [0.04, 0.12], [0.0, 0.12]])


@pytest.mark.parametrize("name", ["Push", "Grasp"])
@pytest.mark.parametrize("world", ["nominal", "posterior"])
def test_copies_are_bit_for_bit_as_many_single_environments(name, world):
    n = 64 if name == "Push" else 16
    many = gymnasium.make_vec(f"fixel/{name}-v0", n, world=world)
    single = SyncVectorEnv([lambda: gymnasium.make(f"fixel/{name}-v0", world=world)] * n)
    many.action_space.seed(0)
    (one, _), (other, _) = many.reset(seed=3), single.reset(seed=3)
    for _ in range(12):
        if name == "Push":
            assert all((one[key] == other[key]).all() for key in one)
            action = np.clip(one["achieved_goal"][:, :2] / 0.3, -1.0, 1.0)
        else:
            assert (one == other).all()
            action = many.action_space.sample().astype(float)
        (one, *rest, info), (other, *again, same) = many.step(action), single.step(action)
        assert all((a == b).all() for a, b in zip(rest, again, strict=True))
        assert (info["is_success"] == same["is_success"]).all()


@pytest.mark.parametrize("shape", [None, ELL, Disk(0.04)])
def test_a_push_ends_where_one_simulation_of_it_does(shape):
    env = PushVectorEnv(6, scene=shape, autoreset_mode="Disabled")
    seen, _ = env.reset(seed=4)
    start, agent = env._motion.poses(), [seen["observation"][:, :2]]
    route = []
    for _ in range(12):
        action = seen["achieved_goal"][:, :2] / env.half_side
        seen, *_ = env.step(np.clip(action, -1.0, 1.0))
        route.append(env._motion.state.route[:, 1:].copy())
    agent = np.concatenate((agent[0][:, None], *route), axis=1)
    time = 0.01 * np.arange(agent.shape[1])
    for k in range(6):
        path = np.column_stack((time, agent[k], np.zeros(len(time))))
        scene = replace(
            env.scene,
            bodies=(replace(env.scene.bodies[0], pose=start[k]),),
            pushers=(replace(env.scene.pushers[0], pose=path[0, 1:], drive=PathDrive(path)),),
            duration=time[-1],
        )
        one = simulate(scene, motion="quasistatic", stepper=Adaptive(tolerance=1e-7))
        assert one.converged
        off = env._motion.poses()[k] - one.pose["part"][-1]
        assert np.hypot(*off[:2]) < 1e-3
        if not isinstance(shape, Disk):
            assert abs(off[2]) < np.radians(1.0)
        assert np.hypot(*(env._motion.poses()[k] - start[k])[:2]) > 0.0 or k > 0


def test_rewards_are_those_of_the_goals():
    env = PushVectorEnv(32, reward="dense", symmetry=2, position=0.05, angle=0.5)
    seen, _ = env.reset(seed=0)
    over = np.zeros(32, bool)
    for _ in range(30):
        action = seen["achieved_goal"][:, :2] / env.half_side
        seen, reward, over, _, info = env.step(np.clip(action, -1.0, 1.0))
        if not env._elapsed.all():
            continue
        again = env.compute_reward(seen["achieved_goal"], seen["desired_goal"], {})
        assert again == pytest.approx(reward, abs=1e-12)
        assert (info["is_success"] == over).all()
        assert (-reward >= info["distance"]).all()
    one = gymnasium.make("fixel/Push-v0", symmetry=2).unwrapped
    goals = np.array([[0.1, 0.2, 1.0, 0.0], [0.1, 0.2, -1.0, 0.0], [0.15, 0.2, 1.0, 0.0]])
    assert one.compute_reward(goals, goals[:1].repeat(3, 0), None).tolist() == [0.0, 0.0, -1.0]
    assert one.compute_terminated(goals[2], goals[0], None) == False  # noqa: E712
    assert one.compute_truncated(goals[2], goals[0], None) is False


def test_a_goal_can_be_fixed_and_fixels_are_avoided():
    scene = push_scene()
    peg = Fixel("peg", Disk(0.03), pose=np.zeros(3), friction=0.2)
    part = replace(scene.bodies[0], pose=np.array([1.0, 0.0, 0.0]))
    scene = Scene(part, scene.pushers, (peg,), duration=1.0)
    env = PushVectorEnv(20, scene=scene, goal=(0.15, 0.1, 0.0))
    seen, _ = env.reset(seed=0)
    assert seen["desired_goal"] == pytest.approx(np.tile([0.15, 0.1, 1.0, 0.0], (20, 1)))
    assert np.hypot(*seen["achieved_goal"][:, :2].T).min() > 0.03
    with pytest.raises(InvalidInput, match="no start without overlap"):
        PushVectorEnv(1, scene=scene, goal=(0.0, 0.0, 0.0)).reset(seed=0)


def test_a_stroke_ends_as_one_simulation_of_it():
    env = GraspVectorEnv(40, autoreset_mode="Disabled")
    env.reset(seed=0)
    start, scene = env._pose.copy(), grasp_scene()
    rng = np.random.default_rng(0)
    action = np.column_stack((rng.uniform(-1, 1, 40), np.ones(40)))
    _, reward, over, _, info = env.step(action)
    assert info["simulated"].all()
    assert (reward == over).all()
    assert 0.1 < reward.mean() < 0.95
    for k in range(0, 40, 5):
        head = replace(scene.pushers[0], pose=np.array([0.0, 0.03 * action[k, 0], 0.0]))
        part = replace(scene.bodies[0], pose=start[k])
        one = simulate(
            replace(scene, bodies=(part,), pushers=(head,)),
            motion="quasistatic",
            duration=0.17 / 0.0135,
        )
        assert info["pose"][k] == pytest.approx(one.pose["part"][-1], abs=2e-4)
        assert bool(reward[k]) == one.meets(Seated("peg-1", "peg-2"))


def test_a_head_put_down_on_the_part_moves_nothing():
    scene = grasp_scene()
    near = replace(scene.bodies[0], pose=np.array([0.07, 0.0, 0.0]))
    scene = replace(scene, bodies=(near,))
    env = GraspVectorEnv(1, scene=scene, start=(0.0, 0.0, 0.0), offset=0.0)
    env.reset(seed=0)
    before = env._pose.copy()
    env._pose[:, 0] -= 0.03
    seen, reward, *_, info = env.step([[0.0, 1.0]])
    assert (reward[0], info["simulated"][0]) == (0.0, False)
    assert seen[0, 0] == pytest.approx(before[0, 0] - 0.03)


@pytest.mark.parametrize(("kind", "wrong", "where"), [
    (PushVectorEnv, {"scene": grasp_scene()}, "one round pusher"),
    (PushVectorEnv, {"reward": "half"}, "reward"),
    (PushVectorEnv, {"symmetry": 0}, "symmetry"),
    (PushVectorEnv, {"position": -1.0}, "position"),
    (PushVectorEnv, {"goal": (0.0, 0.0)}, "goal"),
    (PushVectorEnv, {"parameters": {"mu_pusher": 0.2}}, "parameters"),
    (GraspVectorEnv, {"scene": pushed_square()}, "force limit"),
    (GraspVectorEnv, {"start": (1.0, 0.0)}, "start"),
    (GraspVectorEnv, {"goal": "seated"}, "goal"),
])  # fmt: skip
def test_bad_arguments_are_refused(kind, wrong, where):
    with pytest.raises(InvalidInput, match=where):
        kind(1, **wrong)


def test_a_body_that_covers_itself_after_a_rotation_is_at_its_goal_wherever_its_frame_is():
    corner = Polygon([(0.0, 0.0), (0.12, 0.0), (0.12, 0.08), (0.0, 0.08)])
    env = PushVectorEnv(1, scene=corner, symmetry=2, reward="dense")
    one, same = np.array([[0.0, 0.0, 1.0, 0.0]]), np.array([[0.12, 0.08, -1.0, 0.0]])
    assert env.compute_terminated(one, same, {}).all()
    assert env.compute_reward(one, same, {}) == pytest.approx(0.0, abs=1e-12)
    aside = np.array([[0.123, 0.084, -1.0, 0.0]])
    assert env.compute_reward(one, aside, {}) == pytest.approx(-0.005)


def test_an_agent_that_grazes_a_corner_on_a_large_table_moves_the_body():
    rng, n, radius = np.random.default_rng(3), 2000, 0.0125
    scene = push_scene(Polygon.rectangle(0.1, 0.1))
    motion = PushMotion(scene, n, unit=1.0)
    body = np.column_stack((np.zeros((n, 2)), rng.uniform(-np.pi, np.pi, n)))
    outward = body[:, 2] + 0.25 * np.pi  # from the middle to a corner
    corner = 0.1 * np.sqrt(0.5) * np.column_stack((np.cos(outward), np.sin(outward)))
    aside = np.column_stack((np.cos(outward), np.sin(outward)))
    along = np.column_stack((-aside[:, 1], aside[:, 0]))
    gap, before = rng.uniform(0.9, 0.95, (n, 1)) * radius, rng.uniform(0.007, 0.03, (n, 1))
    start = corner + gap * aside - before * along
    motion.place(np.arange(n), start, body)
    motion.step(start)
    motion.step(start + rng.uniform(2.0, 5.0, (n, 1)) * along)
    route = shapely.linestrings(motion.state.route)
    part = [shapely.Polygon(placed(scene.bodies[0].shape.vertices, pose)) for pose in body]
    assert (shapely.distance(route, part) < 0.96 * radius).all()
    # At 20 m/s the simulation itself misses one in a thousand.
    assert np.mean(motion.state.outcome == STILL) < 0.002
