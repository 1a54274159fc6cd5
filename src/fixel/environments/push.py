"""The task to push a body of any shape to a goal pose, with goals for hindsight replay."""

from __future__ import annotations

import math
from typing import Any, Final, Literal, Unpack, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from fixel.environments import vector as base
from fixel.environments.motion import STIFFNESS, PushMotion
from fixel.environments.pictures import scene_picture
from fixel.errors import InvalidInput, check_name
from fixel.model import Body, Disk, Ellipsoid, PathDrive, Polygon, Pusher, Scene, rotated
from fixel.model.fields import positive, vector, whole
from fixel.model.trajectory import wrapped
from fixel.planning.rollout import part_overlap, tool_overlap
from fixel.typing import BoolArray, FloatArray, IntArray

MAX_STEPS: Final = 100
HALF_SIDE: Final = 0.3  # of the table [m]
START_SHARE: Final = 0.6  # of the table, on which bodies start and end
FRICTION_RANGE: Final = (0.15, 0.35)  # of the world "posterior" without parameters

WorldName = Literal["nominal", "posterior"]
RewardName = Literal["sparse", "dense"]


def push_scene(shape: Polygon | Disk | None = None, *, friction: float = 0.25) -> Scene:
    """Return the usual scene of the task: a body on uniform pressure and a round agent.

    The body is by default a rectangle of 120 mm x 80 mm; its friction is that against the agent.
    """
    shape = Polygon.rectangle(0.12, 0.08) if shape is None else shape
    body = Body("part", shape, mass=1.0, support=Ellipsoid(force=1.0, torque=1.0))
    arm = base.FORCE * base.pressure_arm(body)
    support = Ellipsoid(force=base.FORCE, torque=base.FORCE * arm, centre=shape.centroid)
    away = [[0.0, -2.0 * (shape.radius + HALF_SIDE), 0.0, 0.0]]
    agent = Pusher("agent", Disk(0.0125), friction=friction, drive=PathDrive(away))
    return Scene(Body("part", shape, mass=1.0, support=support), agent, duration=1.0)


class PushVectorEnv(base.BatchEnv):
    """The task to push a body to a goal pose, n times.

    An action is the target of the agent, (-1, -1) to (1, 1) over the table. Observations are
    mappings: ``observation`` (8,) has the agent's place and velocity and the body's pose as x, y,
    cosine and sine [m, m/s]; ``achieved_goal`` and ``desired_goal`` (4,) have poses of the body.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    scene : Scene or Polygon or Disk, optional
        Scene with one body and one round pusher, whose start and path are ignored; or the shape of
        a body in the usual scene.
    goal : (3,) array_like, optional
        Pose of the body's shape at the goal [m, m, rad]; by default drawn for each episode.
    position, angle : float
        Largest distance of the centroid [m] and rotation [rad] from the goal.
    symmetry : int
        Number of rotations that leave the body as it is, such as 2 for a rectangle. Rotations of
        a disk never count.
    half_side : float
        Half of the side of the square table about the origin [m].
    reward : str
        ``"sparse"``: 0 at the goal, else -1. ``"dense"``: minus the distance of the centroid [m],
        with rotation by the radius of gyration.
    world : str
        ``"nominal"``: friction and support of the scene. ``"posterior"``: drawn for each episode.
    parameters : Belief, or what `Belief` takes as its parameters, optional
        Distribution for the world ``"posterior"``; by default friction of 0.15 to 0.35 and an arm
        of the support of 0.55 to 1.9 times that of uniform pressure.
    render_mode, max_episode_steps, autoreset_mode, threads
        See `BatchEnv`.

    Raises
    ------
    InvalidInput
        The scene has other bodies or pushers, or an argument is not one of those above.

    Examples
    --------
    >>> env = PushVectorEnv(num_envs=2)
    >>> observations, info = env.reset(seed=0)
    >>> {name: x.shape for name, x in observations.items()}
    {'observation': (2, 8), 'achieved_goal': (2, 4), 'desired_goal': (2, 4)}
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scene: Scene | Polygon | Disk | None = None,
        goal: ArrayLike | None = None,
        position: float = 0.01,
        angle: float = math.radians(10.0),
        symmetry: int = 1,
        half_side: float = HALF_SIDE,
        reward: RewardName = "sparse",
        world: WorldName = "nominal",
        parameters: Any = None,
        max_episode_steps: int | None = MAX_STEPS,
        **options: Unpack[base.BatchOptions],
    ) -> None:
        check_name("reward", reward, get_args(RewardName))
        check_name("world", world, get_args(WorldName))
        whole(symmetry, "symmetry")
        self.goal = None if goal is None else vector(goal, "goal", "x [m], y [m], angle [rad]")
        self.position = positive(position, "position", "m")
        self.angle = positive(angle, "angle", "rad")
        self.half_side = positive(half_side, "half_side", "m")
        self.symmetry, self.reward_name = symmetry, reward
        own = scene if isinstance(scene, Scene) else push_scene(scene)
        _check_scene(own)
        body, agent = own.bodies[0], own.pushers[0]
        # The agent stays on the table, and a body at the agent.
        self._reach = self.half_side + body.shape.radius + 1.1 * agent.shape.radius
        place = max([self._reach, *([] if self.goal is None else np.abs(self.goal[:2]))])
        speed = 0.5 * math.sqrt(STIFFNESS) * 2.0 * self.half_side
        pose = [place, place, 1.0, 1.0]
        boxes: dict[str, spaces.Space[Any]] = {
            "observation": base.symmetric_box([place, place, speed, speed, *pose]),
            "achieved_goal": base.symmetric_box(pose),
            "desired_goal": base.symmetric_box(pose),
        }
        super().__init__(
            num_envs,
            spaces.Dict(boxes),
            spaces.Box(-1.0, 1.0, (2,), np.float32),
            max_episode_steps=max_episode_steps,
            **options,
        )
        usual = base.usual_parameters(FRICTION_RANGE, base.pressure_arm(body))
        self.scene = self._set_world(world, own, parameters, usual)
        self._arm = math.sqrt(body.moment_of_inertia / body.mass)
        self._motion = PushMotion(self.scene, num_envs, unit=1.0, threads=self.threads)
        self._goals = np.zeros((num_envs, 3))

    def _begin(self, which: IntArray, options: base.Info) -> None:
        drawn = np.array([self._start(k) for k in which.tolist()])
        self._motion.place(which, drawn[:, :2], drawn[:, 2:5])
        self._goals[which] = drawn[:, 5:]

    def _start(self, k: int) -> FloatArray:
        """Draw agent, body and goal without overlap, and with the body away from its goal."""
        rng, most = self.rngs[k], START_SHARE * self.half_side
        for _ in range(base.MAX_REDRAWS):
            poses = rng.uniform(-1.0, 1.0, (2, 3)) * (most, most, np.pi)
            agent = rng.uniform(-1.0, 1.0, 2) * self.half_side
            if self.goal is not None:
                poses[1] = self.goal
            tool = np.array([[*agent, 0.0]])
            depth = max(
                float(tool_overlap(self.scene, poses[:1], tool)[0]),
                float(part_overlap(self.scene, poses, None).max()),
            )
            if depth < 0.0 and not self._success(*poses[:, None]).any():
                return np.array([*agent, *poses.ravel()])
        found = f"no start without overlap in {base.MAX_REDRAWS} draws"
        hint = "increase half_side, or move the goal away from the fixels"
        raise InvalidInput("scene", found=found, expected="room on the table", hint=hint)

    def _advance(self, actions: FloatArray) -> None:
        self._motion.step(self.half_side * np.clip(actions, -1.0, 1.0))

    def _rewards(self) -> tuple[FloatArray, BoolArray]:
        now, goals = base.with_cosine(self._motion.poses()), base.with_cosine(self._goals)
        return self.compute_reward(now, goals, {}), self.compute_terminated(now, goals, {})

    def compute_reward(self, achieved: FloatArray, desired: FloatArray, info: Any) -> FloatArray:
        """Compute the rewards of achieved goals, as `gymnasium_robotics.GoalEnv`.

        Parameters
        ----------
        achieved, desired : (..., 4) float64
            Poses as x, y [m], cosine and sine.
        info : object
            Not used.

        Returns
        -------
        (...) float64
        """
        one, other = _as_pose(achieved), _as_pose(desired)
        if self.reward_name == "sparse":
            return np.where(self._success(one, other), 0.0, -1.0)
        distance, angle = self._apart(one, other)
        return -np.hypot(distance, self._arm * angle)

    def compute_terminated(self, achieved: FloatArray, desired: FloatArray, info: Any) -> BoolArray:
        """Return whether achieved goals (..., 4) end an episode: those within the tolerance."""
        return self._success(_as_pose(achieved), _as_pose(desired))

    def _apart(self, one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances of the centroid [m] and rotations [rad] between poses (..., 3)."""
        shape = self.scene.bodies[0].shape
        there, here = (rotated(shape.centroid, pose[..., 2]) for pose in (one, other))
        distance = np.hypot(*np.moveaxis((one - other)[..., :2] + there - here, -1, 0))
        if isinstance(shape, Disk):  # its rotation makes no difference
            return distance, np.zeros_like(distance)
        turn = wrapped(self.symmetry * (one - other)[..., 2]) / self.symmetry
        return distance, np.abs(turn)

    def _success(self, one: FloatArray, other: FloatArray) -> BoolArray:
        distance, angle = self._apart(one, other)
        return np.asarray((distance <= self.position) & (angle <= self.angle))

    def _observations(self) -> Any:
        achieved = base.with_cosine(self._motion.poses())
        return {
            "observation": np.concatenate((self._motion.state.agent, achieved), axis=1),
            "achieved_goal": achieved,
            "desired_goal": base.with_cosine(self._goals),
        }

    def _info(self) -> base.Info:
        poses = self._motion.poses()
        distance, angle = self._apart(poses, self._goals)
        success = self._success(poses, self._goals)
        return {"is_success": success, "distance": distance, "angle": angle}

    def picture(self, k: int) -> Any:
        """Return a picture (480, 480, 3) uint8 of environment k, with its table and goal."""
        side, view = 2.0 * self.half_side, self._reach + self.scene.bodies[0].shape.radius
        agent = np.array([*self._motion.state.agent[k, :2], 0.0])
        return scene_picture(
            self.scene, np.zeros(2), view, self._motion.poses()[k], agent,
            goal=self._goals[k], table=Polygon.rectangle(side, side),
        )  # fmt: skip


class PushEnv(base.SingleEnv):
    """The task to push a body of any shape to a goal pose.

    Parameters
    ----------
    **options
        Those of `PushVectorEnv`, but for the vector environment's own.

    Examples
    --------
    >>> import gymnasium
    >>> import fixel
    >>> import fixel.environments
    >>> env = gymnasium.make("fixel/Push-v0", scene=fixel.Disk(0.05), reward="dense")
    >>> observation, info = env.reset(seed=0)
    >>> sorted(observation)
    ['achieved_goal', 'desired_goal', 'observation']
    """

    kind = PushVectorEnv
    batch: PushVectorEnv

    def compute_reward(self, achieved: FloatArray, desired: FloatArray, info: Any) -> FloatArray:
        """Compute the rewards (...) of achieved goals (..., 4), as `PushVectorEnv`."""
        return self.batch.compute_reward(achieved, desired, info)

    def compute_terminated(self, achieved: FloatArray, desired: FloatArray, info: Any) -> BoolArray:
        """Return whether achieved goals (..., 4) end an episode, as `PushVectorEnv`."""
        return self.batch.compute_terminated(achieved, desired, info)

    def compute_truncated(self, achieved: FloatArray, desired: FloatArray, info: Any) -> bool:
        """Return False: only the number of steps truncates an episode."""
        return False


def _check_scene(scene: Scene) -> None:
    fits = len(scene.bodies) == len(scene.pushers) == 1
    if not fits or not isinstance(scene.pushers[0].shape, Disk):
        found = f"{len(scene.bodies)} bodies and {len(scene.pushers)} pushers"
        raise InvalidInput("scene", found=found, expected="one body and one round pusher")


def _as_pose(goals: FloatArray) -> FloatArray:
    """Inverse of `with_cosine`, for any number of axes."""
    given = np.asarray(goals, np.float64)
    angle = np.arctan2(given[..., 3], given[..., 2])
    return np.concatenate((given[..., :2], angle[..., None]), axis=-1)
