"""The Push-T task: push a T onto its goal with a round agent.

Spaces, control, goal, reward, keypoints and seeds are those of gym-pusht 0.1.8 (Hugging Face),
after Diffusion Policy (Chi et al., 2023); docs/how-to/environments.md lists the differences.
Lengths are pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, Literal, Unpack, get_args

import numpy as np
from gymnasium import spaces

from fixel.environments import vector as base
from fixel.environments.loops import STILL, coverage
from fixel.environments.motion import PushMotion
from fixel.environments.pictures import picture
from fixel.errors import InvalidInput, check_name
from fixel.model import Body, Disk, Ellipsoid, Fixel, PathDrive, Polygon, Pusher, Scene, rotated
from fixel.model.fields import vector, whole
from fixel.model.overlap import overlap_depth
from fixel.typing import BoolArray, FloatArray, IntArray

PIXEL: Final = 0.2 / 120.0  # [m]: the bar of a real T is 200 mm long
SIDE: Final = 512.0  # of the picture [px]
# Bar and stem in the frame of the body [px]; in this order their corners are the keypoints.
PIECES: Final = np.array(
    [
        [[-60.0, 0.0], [60.0, 0.0], [60.0, 30.0], [-60.0, 30.0]],
        [[-15.0, 30.0], [15.0, 30.0], [15.0, 120.0], [-15.0, 120.0]],
    ]
)
OUTLINE: Final = np.concatenate((PIECES[0, :3], PIECES[1, 1:], PIECES[1, :1], PIECES[0, 3:]))
AGENT_RADIUS: Final = 15.0  # [px]
WALLS: Final = (7.0, 504.0)  # inner faces [px]
THICKNESS: Final = 4.0  # of the walls [px]
AGENT_STARTS: Final = (50, 450)  # x and y of a drawn start, the second excluded [px]
T_STARTS: Final = (100, 400)  # likewise, of the frame of the T before it turns [px]
GOAL: Final = np.array([256.0, 256.0, math.pi / 4.0])
SUCCESS: Final = 0.95  # coverage above which an episode is over
MAX_STEPS: Final = 300
# gym-pusht takes the mean of the centres of both rectangles, mass 1 and inertia 3000.
LEGACY_COM: Final = np.array([0.0, 45.0])
LEGACY_ARM: Final = math.sqrt(3000.0)  # [px]
ARM: Final = 39.92  # of uniform pressure about the centroid [px]
NOMINAL_FRICTION: Final = 0.2
FRICTION_RANGE: Final = (0.15, 0.25)  # calibrated friction of plates

WorldName = Literal["legacy", "nominal", "posterior"]
ObservationName = Literal["state", "environment_state_agent_pos", "pixels", "pixels_agent_pos"]
SeedsName = Literal["0.1.8", "0.1.5"]


def push_t_scene(
    com: FloatArray | None = None, *, arm: float = ARM, friction: float = NOMINAL_FRICTION
) -> Scene:
    """Return the scene of the task, in metres.

    `com` (2,) is the centre of mass and of friction in the frame of the T, its centroid by default,
    and `arm` the largest friction torque over the largest friction force [px]. Friction is that of
    the T against the agent and the walls.
    """
    shape = Polygon(OUTLINE * PIXEL)
    centre = shape.centroid if com is None else com * PIXEL
    support = Ellipsoid(force=base.FORCE, torque=base.FORCE * arm * PIXEL, centre=centre)
    at = np.array([SIDE / 2.0, SIDE / 2.0, 0.0]) * PIXEL
    block = Body("block", shape, mass=1.0, pose=at, support=support, centre_of_mass=centre)
    still = PathDrive([[0.0, 2.0 * AGENT_RADIUS * PIXEL, 2.0 * AGENT_RADIUS * PIXEL, 0.0]])
    agent = Pusher("agent", Disk(AGENT_RADIUS * PIXEL), friction=friction, drive=still)
    low, high = WALLS
    walls = (
        ("left", low - THICKNESS, low, low - THICKNESS, high + THICKNESS),
        ("right", high, high + THICKNESS, low - THICKNESS, high + THICKNESS),
        ("bottom", low, high, low - THICKNESS, low),
        ("top", low, high, high, high + THICKNESS),
    )
    fixels = []
    for name, a, b, c, d in walls:
        wall = Polygon(np.array([[a, c], [b, c], [b, d], [a, d]]) * PIXEL)
        fixels.append(Fixel(name, wall, pose=np.zeros(3), friction=friction))
    return Scene(block, agent, fixels, duration=1.0)


def push_t_scene_of(world: str, com: FloatArray | None = None) -> Scene:
    """Return the scene of a world, with nominal values where the world draws them."""
    if world == "legacy":
        return push_t_scene(LEGACY_COM if com is None else com, arm=LEGACY_ARM, friction=0.0)
    return push_t_scene(com)


class PushTVectorEnv(base.BatchEnv):
    """The Push-T task, n times.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    obs_type : str
        ``"state"``, ``"environment_state_agent_pos"``, ``"pixels"`` or ``"pixels_agent_pos"``.
    block_cog : (2,) sequence of float, optional
        Centre of mass in the frame of the T [px]; that of the world by default.
    damping : float, optional
        Only 0: the T stops as soon as it is not pushed.
    observation_width, observation_height : int
        Size of observed pictures [px].
    visualization_width, visualization_height : int
        Size of rendered pictures [px].
    world : str
        ``"legacy"``: the mechanics of gym-pusht, without friction between agent and T.
        ``"nominal"``: friction 0.2 and uniform pressure. ``"posterior"``: friction and arm of the
        support drawn for each episode, and reported in ``info["parameters"]``.
    parameters : Belief, or what `Belief` takes as its parameters, optional
        Distribution for the world ``"posterior"``; that of calibrated plates by default.
    seeds : str
        Version of gym-pusht whose start states seeds stand for: ``"0.1.8"`` (from 0.1.6), or
        ``"0.1.5"``.
    max_episode_steps, autoreset_mode, render_mode, threads
        See `BatchEnv`.

    Raises
    ------
    InvalidInput
        An argument is not one of those above.

    Examples
    --------
    >>> env = PushTVectorEnv(num_envs=2)
    >>> observations, info = env.reset(seed=0)
    >>> observations.shape
    (2, 5)
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        obs_type: ObservationName = "state",
        block_cog: Sequence[float] | None = None,
        damping: float | None = None,
        observation_width: int = 96,
        observation_height: int = 96,
        visualization_width: int = 680,
        visualization_height: int = 680,
        world: WorldName = "legacy",
        parameters: Any = None,
        seeds: SeedsName = "0.1.8",
        max_episode_steps: int | None = MAX_STEPS,
        **options: Unpack[base.BatchOptions],
    ) -> None:
        check_name("obs_type", obs_type, get_args(ObservationName))
        check_name("world", world, get_args(WorldName))
        check_name("seeds", seeds, get_args(SeedsName))
        if damping:
            raise InvalidInput("damping", found=damping, expected="0: motion is quasi-static")
        self.obs_type, self.world, self.seeds_of = obs_type, world, seeds
        self.size = (observation_width, observation_height)
        self.shown_size = (visualization_width, visualization_height)
        for x in (*self.size, *self.shown_size):
            whole(x, "size of a picture")
        com = None if block_cog is None else vector(block_cog, "block_cog", "x [px], y [px]")
        # Start states turn about the legacy centre, so that they are the same in every world.
        self._pivot = LEGACY_COM if com is None else com
        super().__init__(
            num_envs,
            _observation_space(obs_type, self.size, self._pivot),
            spaces.Box(0.0, SIDE, (2,), np.float32),
            max_episode_steps=max_episode_steps,
            **options,
        )
        usual = base.usual_parameters(FRICTION_RANGE, ARM * PIXEL)
        self.scene = self._set_world(world, push_t_scene_of(world, com), parameters, usual)
        self._motion = PushMotion(self.scene, num_envs, unit=PIXEL, threads=self.threads)
        self._action = np.full((num_envs, 2), np.nan)  # none yet
        self._coverage = np.zeros(num_envs)
        self._goal = placed_pieces(GOAL)

    def _begin(self, which: IntArray, options: base.Info) -> None:
        states = np.array([self._start(k) for k in which.tolist()])
        given = options.get("reset_to_state")
        if given is not None:
            states = _given_states(given, len(which))
        poses = self._turned(states[:, 2:])
        sunk = np.array([max(0.0, _depth(own)) for own in np.column_stack((states[:, :2], poses))])
        self._motion.place(which, states[:, :2], poses, sunk)
        self._action[which] = np.nan
        self._measure()

    def _turned(self, poses: FloatArray) -> FloatArray:
        """Return poses (n, 3) of the T, which gym-pusht turns about a pivot after placing it."""
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x, y = self._pivot
        shift = np.column_stack((x - c * x + s * y, y - s * x - c * y))
        return np.column_stack((poses[:, :2] + shift, poses[:, 2]))

    def _start(self, k: int) -> FloatArray:
        """Draw a start state: agent, then body as gym-pusht states it."""
        rng = self.rngs[k]
        old = None
        if self.seeds_of == "0.1.5":
            own = self.seeds[k]
            old = np.random.RandomState(int(rng.integers(2**31)) if own is None else own)
        for _ in range(base.MAX_REDRAWS):
            spans = (AGENT_STARTS, AGENT_STARTS, T_STARTS, T_STARTS)
            if old is not None:
                places = [int(old.randint(*span)) for span in spans]
                angle = old.randn() * 2.0 * np.pi - np.pi
            else:
                places = [int(rng.integers(*span)) for span in spans]
                angle = rng.uniform(-np.pi, np.pi)
            state = np.array([*places, angle], np.float64)
            if self.world == "legacy" or self._is_free(state):
                break
        return state

    def _is_free(self, state: FloatArray) -> bool:
        """Whether the T of a start state overlaps neither agent nor walls."""
        pose = self._turned(state[None, 2:])[0]
        corners = placed_pieces(pose)
        inside = corners.min() > WALLS[0] and corners.max() < WALLS[1]
        return bool(inside) and _depth(np.array([*state[:2], *pose])) <= 0.0

    def _advance(self, actions: FloatArray) -> None:
        self._action[:] = actions
        self._motion.step(actions)
        self._measure()

    def _measure(self) -> None:
        coverage(self._motion.poses(), PIECES, self._goal, 0, self.num_envs, self._coverage)

    def _rewards(self) -> tuple[FloatArray, BoolArray]:
        return np.clip(self._coverage / SUCCESS, 0.0, 1.0), self._coverage > SUCCESS

    def _observations(self) -> Any:
        agent, poses = self._motion.state.agent[:, :2].copy(), self._motion.poses()
        if self.obs_type == "state":
            poses[:, 2] %= 2.0 * np.pi
            return np.concatenate((agent, poses), axis=1)
        if self.obs_type == "environment_state_agent_pos":
            return {"environment_state": keypoints(poses).reshape(-1, 16), "agent_pos": agent}
        pixels = np.array(
            [self._drawn(agent[k], poses[k], self.size) for k in range(self.num_envs)]
        )
        return pixels if self.obs_type == "pixels" else {"pixels": pixels, "agent_pos": agent}

    def _info(self) -> base.Info:
        state = self._motion.state
        return {
            "pos_agent": state.agent[:, :2].copy(),
            "vel_agent": state.agent[:, 2:].copy(),
            "block_pose": self._motion.poses(),
            "goal_pose": np.repeat(GOAL[None], self.num_envs, axis=0),
            "n_contacts": (state.outcome != STILL).astype(np.int64),
            "is_success": self._coverage > SUCCESS,
            "coverage": self._coverage.copy(),
        }

    def picture(self, k: int) -> Any:
        """Return a picture (height, width, 3) uint8 of environment k, with its last action."""
        agent, pose = self._motion.state.agent[k, :2], self._motion.poses()[k]
        return self._drawn(agent, pose, self.shown_size, self._action[k])

    def _drawn(
        self,
        agent: FloatArray,
        pose: FloatArray,
        size: tuple[int, int],
        action: FloatArray | None = None,
    ) -> Any:
        return picture(agent, placed_pieces(pose), self._goal, size, action)


class PushTEnv(base.SingleEnv):
    """The Push-T task: spaces, rewards and seeds of gym-pusht, with a choice of the world.

    Parameters
    ----------
    obs_type, **options
        Those of `PushTVectorEnv`, but for the vector environment's own.

    Examples
    --------
    >>> import gymnasium
    >>> import fixel.environments
    >>> env = gymnasium.make("fixel/PushT-v0", world="nominal")
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape
    (5,)
    """

    kind = PushTVectorEnv

    def __init__(self, obs_type: ObservationName = "state", **options: Any) -> None:
        super().__init__(obs_type=obs_type, **options)


def keypoints(poses: FloatArray) -> FloatArray:
    """Return the corners (n, 8, 2) of bar and stem of Ts at poses (n, 3) of their frames [px]."""
    return rotated(PIECES.reshape(8, 2), poses[:, 2:]) + poses[:, None, :2]


def placed_pieces(pose: FloatArray) -> FloatArray:
    """Return the corners (2, 4, 2) of bar and stem of a T at a pose (3,) of its frame [px]."""
    return keypoints(pose[None]).reshape(2, 4, 2)


def _given_states(given: Any, n: int) -> FloatArray:
    """Return start states (n, 5) of the option of a reset."""
    found = np.asarray(given, np.float64)
    if found.shape not in ((5,), (n, 5)) or not np.isfinite(found).all():
        expected = f"finite numbers of shape (5,) or ({n}, 5)"
        raise InvalidInput("options['reset_to_state']", found=found, expected=expected)
    return np.array(np.broadcast_to(found, (n, 5)))


def _depth(state: FloatArray) -> float:
    """Overlap of an agent at ``state[:2]`` and a T at the pose ``state[2:]`` [px]."""
    if math.hypot(*(state[:2] - state[2:4])) > 140.0:  # further than any corner
        return 0.0
    agent = np.array([*state[:2], 0.0])
    return overlap_depth(_T, state[2:], _AGENT, agent)


_T: Final = Polygon(OUTLINE)
_AGENT: Final = Disk(AGENT_RADIUS)


def _observation_space(name: ObservationName, size: tuple[int, int], pivot: FloatArray) -> Any:
    agent = spaces.Box(np.zeros(2), np.full(2, SIDE), dtype=np.float64)
    picture = spaces.Box(0, 255, (size[1], size[0], 3), np.uint8)
    if name == "state":
        low, high = _places(np.zeros(2), pivot)
        turn = 2.0 * np.pi
        return spaces.Box(
            np.array([0.0, 0.0, *low, 0.0]), np.array([SIDE, SIDE, *high, turn]), dtype=np.float64
        )
    if name == "environment_state_agent_pos":
        low, high = np.transpose([_places(own, pivot) for own in PIECES.reshape(8, 2)], (1, 0, 2))
        corners = spaces.Box(low.ravel(), high.ravel(), dtype=np.float64)
        return spaces.Dict({"environment_state": corners, "agent_pos": agent})
    if name == "pixels":
        return picture
    return spaces.Dict({"pixels": picture, "agent_pos": agent})


def _places(point: FloatArray, pivot: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bounds (2,) of a point of the T: the picture, and where it may be at a start."""
    reach = math.hypot(*(point - pivot))
    low, high = T_STARTS
    return np.minimum(0.0, low + pivot - reach), np.maximum(SIDE, high + pivot + reach)
