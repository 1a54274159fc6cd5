"""The task to seat a part against pegs by strokes of a head on a straight axis."""

from __future__ import annotations

import math
from typing import Any, Final, Literal, Unpack, get_args

import numpy as np
from gymnasium import spaces

from fixel.environments import vector as base
from fixel.environments.pictures import scene_picture
from fixel.errors import InvalidInput, check_name
from fixel.model import Body, Disk, Fixel, Goal, LineDrive, Polygon, Pusher, Scene, Seated, Tripod
from fixel.model.fields import instance, non_negative, vector
from fixel.model.goals import BodyTrack
from fixel.planning.rollout import part_overlap, tool_overlap
from fixel.simulation.ensemble import Ensemble
from fixel.typing import BoolArray, FloatArray, IntArray

MAX_STROKES: Final = 3
# Ranges of the start, relative to the pose in the scene [m, m, rad], and of the head across its
# axis [m].
START_RANGE: Final = (0.01, 0.015, math.radians(20.0))
OFFSET: Final = 0.03
MIN_TRAVEL: Final = 0.02  # [m]
# Of the world "posterior" without parameters.
RANGES: Final = {"mu_pusher": (0.15, 0.35), "mu_fixel": (0.1, 0.3), "tripod_radius": (0.03, 0.05)}

WorldName = Literal["nominal", "posterior"]


def grasp_scene() -> Scene:
    """Return the usual scene: a square of 107.5 mm, a head with a stall force, three pegs."""
    square = Body(
        "part",
        Polygon.rectangle(0.1075, 0.1075),
        mass=0.15,
        pose=np.array([0.095, 0.0, 0.0]),
        support=Tripod(radius=0.04, friction=0.25),
    )
    head = Pusher(
        "head",
        Polygon.rectangle(0.029, 0.029),
        pose=np.zeros(3),
        friction=0.25,
        drive=LineDrive(speed=0.0135, travel=0.17, force_limit=34.3),
    )
    pegs = tuple(
        Fixel(f"peg-{k}", Disk(0.00476), pose=np.array([x, y, 0.0]), friction=0.2)
        for k, (x, y) in enumerate(((0.2, -0.03), (0.2, 0.03), (0.15, 0.085)), 1)
    )
    return Scene(square, head, pegs, duration=13.0)


class GraspVectorEnv(base.BatchEnv):
    """The task to seat a part against pegs by a few strokes, n times.

    A step is a stroke: the head is placed across its axis, moves along it until its travel ends or
    it stalls, and is taken away. The part stays where it is. An action has the offset of the head
    and its travel, each from -1 to 1 over its range. The observation (4,) is the pose of the part:
    x, y [m], cosine and sine. The reward is 1 if the part is seated at the end of the stroke, which
    ends the episode, else 0.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    scene : Scene, optional
        Scene with one body, one pusher on a `LineDrive` with a force limit, and fixels.
    goal : Goal, optional
        Condition at the end of a stroke; by default the part touches at least two of the fixels,
        the first two of the scene.
    start : (float, float, float)
        Largest differences of the start from the pose in the scene [m, m, rad].
    offset : float
        Largest offset of the head across its axis [m].
    world : str
        ``"nominal"``: friction and support of the scene. ``"posterior"``: drawn for each episode.
    parameters : Belief, or what `Belief` takes as its parameters, optional
        Distribution for the world ``"posterior"``; by default intervals about the usual scene's
        values.
    render_mode, max_episode_steps, autoreset_mode, threads
        See `BatchEnv`.

    Raises
    ------
    InvalidInput
        The scene has no such pusher, or an argument is not one of those above.

    Examples
    --------
    >>> env = GraspVectorEnv(num_envs=2)
    >>> observations, info = env.reset(seed=0)
    >>> _, rewards, *_ = env.step([[0.0, 1.0], [0.0, -1.0]])
    >>> float(rewards[1])
    0.0
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scene: Scene | None = None,
        goal: Goal | None = None,
        start: tuple[float, float, float] = START_RANGE,
        offset: float = OFFSET,
        world: WorldName = "nominal",
        parameters: Any = None,
        max_episode_steps: int | None = MAX_STROKES,
        **options: Unpack[base.BatchOptions],
    ) -> None:
        check_name("world", world, get_args(WorldName))
        instance(goal, Goal | None, "goal", "a Goal")
        self.scene = grasp_scene() if scene is None else scene
        self._drive = _stroke(self.scene)
        self._range = np.abs(vector(start, "start", "x [m], y [m], angle [rad]"))
        self._offset = non_negative(offset, "offset", "m")
        super().__init__(
            num_envs,
            base.symmetric_box([*self._limits(), 1.0, 1.0]),
            spaces.Box(-1.0, 1.0, (2,), np.float32),
            max_episode_steps=max_episode_steps,
            **options,
        )
        self.scene = self._set_world(world, self.scene, parameters, RANGES)
        names = [fixel.name for fixel in self.scene.fixels]
        self.goal = Seated(*names[:2]) if goal is None else goal
        self._pose = np.tile(self.scene.bodies[0].pose, (num_envs, 1))
        self._tool = np.tile(self.scene.pushers[0].pose, (num_envs, 1))
        self._success = np.zeros(num_envs, bool)
        self._simulated = np.ones(num_envs, bool)

    def _limits(self) -> FloatArray:
        """Largest distances (2,) of the part from the origin: at the start, or at the head."""
        part, head = self.scene.bodies[0], self.scene.pushers[0]
        at_start = np.abs(part.pose[:2]) + self._range[:2]
        reach = self._drive.travel + self._offset + head.shape.radius + part.shape.radius
        return np.asarray(np.maximum(at_start, 1.1 * (np.abs(head.pose[:2]) + reach)))

    def _begin(self, which: IntArray, options: base.Info) -> None:
        self._success[which], self._simulated[which] = False, True
        self._tool[which] = self.scene.pushers[0].pose
        for k in which.tolist():
            self._pose[k] = self._start(self.rngs[k])

    def _start(self, rng: np.random.Generator) -> FloatArray:
        """Draw a start that overlaps neither the head nor a fixel."""
        body, tool = self.scene.bodies[0], self.scene.pushers[0].pose[None]
        for _ in range(base.MAX_REDRAWS):
            pose = body.pose + self._range * rng.uniform(-1.0, 1.0, 3)
            depth = part_overlap(self.scene, pose[None], None)[0]
            if max(depth, tool_overlap(self.scene, pose[None], tool)[0]) <= 0.0:
                return np.asarray(pose)
        found = f"no start without overlap in {base.MAX_REDRAWS} draws"
        raise InvalidInput("start", found=found, expected="a smaller range")

    def _advance(self, actions: FloatArray) -> None:
        along = np.asarray(self._drive.direction)
        across = np.array([-along[1], along[0]])
        action = np.clip(actions, -1.0, 1.0)
        travel = MIN_TRAVEL + 0.5 * (action[:, 1] + 1.0) * (self._drive.travel - MIN_TRAVEL)
        path = np.zeros((self.num_envs, 2, 4))
        path[:, :, 1:] = self.scene.pushers[0].pose
        path[:, :, 1:3] += (self._offset * action[:, :1] * across)[:, None]
        path[:, 1, 1:3] += travel[:, None] * along
        path[:, 1, 0] = travel / self._drive.speed
        self._tool = path[:, 0, 1:]
        free = tool_overlap(self.scene, self._pose, path[:, 0, 1:]) <= 0.0
        self._simulate(np.flatnonzero(free), path)

    def _simulate(self, which: IntArray, path: FloatArray) -> None:
        """Simulate the strokes of some environments; the others fail, and move nothing."""
        self._simulated[:] = self._success[:] = False
        if not len(which):
            return
        ensemble = Ensemble.of_pushes(
            self.scene, self._pose[which], path[which], 1, threads=self.threads
        )
        values = {} if self._draws is None else self._draws.values
        own = {name: x[which] for name, x in values.items()}
        outcome = ensemble.simulate(np.arange(len(which)), own)
        ready = outcome.converged
        which, pose = which[ready], outcome.pose[ready]
        self._simulated[which] = True
        self._pose[which] = pose[:, -1]
        track = BodyTrack(pose, outcome.stalled[ready], outcome.force[ready])
        self._success[which] = self.goal.met(self.scene, track)

    def _rewards(self) -> tuple[FloatArray, BoolArray]:
        return self._success.astype(np.float64), self._success.copy()

    def _observations(self) -> FloatArray:
        return base.with_cosine(self._pose)

    def _info(self) -> base.Info:
        return {
            "is_success": self._success.copy(),
            "pose": self._pose.copy(),
            "simulated": self._simulated.copy(),
        }

    def picture(self, k: int) -> Any:
        """Return a picture (480, 480, 3) uint8 of environment k, with the head taken back."""
        size = self.scene.bodies[0].shape.radius
        points = np.array([f.pose for f in self.scene.fixels] + [self.scene.pushers[0].pose])
        low, high = points[:, :2].min(axis=0) - size, points[:, :2].max(axis=0) + size
        half = 0.5 * float((high - low).max())
        return scene_picture(self.scene, 0.5 * (low + high), half, self._pose[k], self._tool[k])


class GraspEnv(base.SingleEnv):
    """The task to seat a part against pegs by a few strokes.

    Parameters
    ----------
    **options
        Those of `GraspVectorEnv`, but for the vector environment's own.

    Examples
    --------
    >>> import gymnasium
    >>> import fixel.environments
    >>> env = gymnasium.make("fixel/Grasp-v0", world="posterior")
    >>> observation, info = env.reset(seed=0)
    >>> sorted(info["parameters"])
    ['mu_fixel', 'mu_pusher', 'tripod_radius']
    """

    kind = GraspVectorEnv


def _stroke(scene: Scene) -> LineDrive:
    """Return the drive of the one pusher of a scene; raise for others."""
    drive = scene.pushers[0].drive if len(scene.pushers) == 1 else None
    if (
        len(scene.bodies) != 1
        or len(scene.fixels) < 2
        or not isinstance(drive, LineDrive)
        or drive.force_limit is None
        or not MIN_TRAVEL < drive.travel < math.inf
        or drive.speed == 0.0
    ):
        found = "a scene without one body, one such pusher or two fixels"
        expected = "a LineDrive with a force limit and a travel of more than 20 mm"
        raise InvalidInput("scene", found=found, expected=expected)
    return drive
