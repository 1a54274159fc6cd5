"""Base of the environments: n copies in one, with Gymnasium's autoreset modes, and one of them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Final, TypedDict

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fixel.calibration.known_pushes import KnownPushes
from fixel.errors import InvalidInput, check_name
from fixel.model import Body, Ellipsoid, Scene, Support, SupportPoints, Tripod, UniformPressure
from fixel.model.fields import whole
from fixel.model.support import cells
from fixel.planning.belief import Belief
from fixel.simulation.threads import cores
from fixel.simulation.vary import infeasible
from fixel.typing import BoolArray, FloatArray, IntArray

Info = dict[str, Any]
METADATA: Final[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 10}


class BatchOptions(TypedDict, total=False):
    """Options of every `BatchEnv`."""

    autoreset_mode: AutoresetMode | str
    render_mode: str | None
    threads: int | None


class BatchEnv(VectorEnv[Any, Any, Any]):
    """Base class of n environments that one compiled call moves.

    Environment k has a random generator of its own, seeded by ``seed + k``: its episodes depend bit
    for bit on its seed and actions, not on `num_envs` or its neighbours.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    observation_space, action_space : gymnasium.Space
        Spaces of one environment.
    max_episode_steps : int or None
        Number of steps after which an episode is truncated; None for never.
    autoreset_mode : AutoresetMode or str
        When an episode that ended is followed by the next one, as in Gymnasium.
    render_mode : str or None
        ``"rgb_array"``, or None.
    threads : int, optional
        Largest number of threads that share the environments; by default that of the cores.
    """

    _draws: WorldDraws | None = None  # those of worlds that differ between episodes
    _motion: Any = None  # `PushMotion` of tasks with an agent

    def __init__(
        self,
        num_envs: int,
        observation_space: gym.Space[Any],
        action_space: gym.Space[Any],
        *,
        max_episode_steps: int | None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = "rgb_array",
        threads: int | None = None,
    ) -> None:
        whole(num_envs, "num_envs")
        if max_episode_steps is not None:
            whole(max_episode_steps, "max_episode_steps")
        if render_mode not in (None, *METADATA["render_modes"]):
            raise InvalidInput("render_mode", found=render_mode, expected="'rgb_array' or None")
        if not isinstance(autoreset_mode, AutoresetMode):
            names = [mode.value for mode in AutoresetMode]
            check_name("autoreset_mode", autoreset_mode, names)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**METADATA, "autoreset_mode": self.autoreset_mode}
        self.render_mode = render_mode
        self.threads = threads or cores()
        self.single_observation_space = observation_space
        self.single_action_space = action_space
        self.observation_space = batch_space(observation_space, num_envs)
        self.action_space = batch_space(action_space, num_envs)
        self.rngs = [np.random.default_rng() for _ in range(num_envs)]
        # Worlds have a stream of their own: start states are those of environments without worlds.
        self.world_rngs = [np.random.default_rng() for _ in range(num_envs)]
        self.seeds: list[int | None] = [None] * num_envs  # of the episodes that begin
        self._elapsed = np.zeros(num_envs, np.int64)
        self._ended = np.ones(num_envs, bool)
        self._begun = False

    def _set_world(self, world: str, scene: Scene, parameters: Any, usual: Info) -> Scene:
        """Return the scene of a world; that of "posterior" has other parameters in each episode."""
        if world == "posterior":
            given = usual if parameters is None else parameters
            self._draws = WorldDraws(scene, given, self.num_envs)
            return self._draws.scene
        if parameters is not None:
            found = f"parameters for the world {world!r}"
            raise InvalidInput("parameters", found=found, expected="world='posterior'")
        return scene

    @abstractmethod
    def _begin(self, which: IntArray, options: Info) -> None:
        """Begin episodes of environments `which` (k,)."""

    @abstractmethod
    def _advance(self, actions: FloatArray) -> None:
        """Move all environments by one step."""

    @abstractmethod
    def _rewards(self) -> tuple[FloatArray, BoolArray]:
        """Return rewards (n,) of the last step, and whether the episodes are over (n,)."""

    @abstractmethod
    def _observations(self) -> Any:
        """Return new arrays with the observations of all environments."""

    @abstractmethod
    def _info(self) -> Info:
        """Return new arrays (n, ...) by name, or mappings of such arrays."""

    @abstractmethod
    def picture(self, k: int) -> Any:
        """Return a picture (height, width, 3) uint8 of environment k."""

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: Info | None = None
    ) -> tuple[Any, Info]:
        """Begin new episodes.

        Parameters
        ----------
        seed : int or list of int, optional
            Seed of the first environment, from which the others count up; or one for each.
        options : dict, optional
            ``"reset_mask"``: (n,) bool array of the environments to reset; all by default. Other
            options are those of the task.

        Raises
        ------
        InvalidInput
            A mask or a list of seeds has the wrong length.
        """
        options = dict(options or {})
        mask = self._mask(options.pop("reset_mask", None))
        self.seeds = self._seeds(seed)
        for k, own in enumerate(self.seeds):
            if own is not None and mask[k]:
                self.rngs[k] = seeding.np_random(own)[0]
                self.world_rngs[k] = np.random.default_rng([own, 1])
        self._restart(np.flatnonzero(mask), options)
        self.seeds = [None] * self.num_envs
        return self._observations(), self._masked_info(mask)

    def step(self, actions: Any) -> tuple[Any, FloatArray, BoolArray, BoolArray, Info]:
        """Move all environments by one step.

        Parameters
        ----------
        actions : (n, ...) array_like
            Actions of all environments.

        Raises
        ------
        InvalidInput
            An action is not finite or has the wrong shape, or an episode needs a reset.
        """
        again = np.flatnonzero(self._ended)
        if len(again) and (self.autoreset_mode == AutoresetMode.DISABLED or not self._begun):
            found = f"{len(again)} environments without a running episode"
            raise InvalidInput("step", found=found, expected="none", hint="call reset")
        self._advance(self._checked(actions))
        self._elapsed += 1
        rewards, terminated = self._rewards()
        truncated = np.zeros(self.num_envs, bool)
        if self.max_episode_steps is not None:
            truncated = self._elapsed >= self.max_episode_steps
        if len(again):
            self._restart(again, {})
            rewards[again], terminated[again], truncated[again] = 0.0, False, False
        self._ended = terminated | truncated
        final: Info = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._ended.any():
            final = self._final(self._ended.copy())
            self._restart(np.flatnonzero(self._ended), {})
        info = self._masked_info(np.ones(self.num_envs, bool)) | final
        return self._observations(), rewards, terminated, truncated, info

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture (height, width, 3) uint8 of each; None without a render mode."""
        if self.render_mode is None:
            return None
        return tuple(self.picture(k) for k in range(self.num_envs))

    def _restart(self, which: IntArray, options: Info) -> None:
        self._begin(which, options)
        if self._draws is not None:
            self._draws.redraw(which, self.world_rngs)
            if self._motion is not None:
                self._motion.set_parameters(self._draws.values)
        self._elapsed[which], self._ended[which] = 0, False
        self._begun = self._begun or len(which) == self.num_envs

    def _final(self, ended: BoolArray) -> Info:
        """Return the last observations and info of episodes that are over."""
        observations = np.full(self.num_envs, None, dtype=object)
        now = self._observations()
        for k in np.flatnonzero(ended).tolist():
            observations[k] = row(now, k)
        return {
            **{"final_obs": observations, "_final_obs": ended},
            **{"final_info": self._masked_info(ended), "_final_info": ended.copy()},
        }

    def _masked_info(self, mask: BoolArray) -> Info:
        info = self._info()
        if self._draws is not None:
            info["parameters"] = {name: x.copy() for name, x in self._draws.values.items()}
        return _masked(info, mask)

    def _mask(self, given: Any) -> BoolArray:
        if given is None:
            return np.ones(self.num_envs, bool)
        mask = np.array(given)
        if mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            found = f"{mask.dtype} of shape {mask.shape}, {np.count_nonzero(mask)} not zero"
            expected = f"bool of shape ({self.num_envs},), one of them true at least"
            raise InvalidInput("options['reset_mask']", found=found, expected=expected)
        return mask

    def _seeds(self, seed: int | list[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + k for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise InvalidInput("seed", found=f"{len(seed)} seeds", expected=f"{self.num_envs}")
        return list(seed)

    def _checked(self, actions: Any) -> FloatArray:
        found = np.asarray(actions, np.float64)
        shape = self.action_space.shape
        if found.shape != shape or not np.isfinite(found).all():
            what = f"shape {found.shape}" if found.shape != shape else "numbers that are not finite"
            raise InvalidInput("actions", found=what, expected=f"finite numbers of shape {shape}")
        return np.ascontiguousarray(found)


class SingleEnv(gym.Env[Any, Any]):
    """Base class of one environment, a `BatchEnv` of one.

    Options are those of its `kind`, without truncation and autoreset, which are Gymnasium's own.
    """

    metadata = METADATA
    kind: ClassVar[type[Any]]  # subclass of `BatchEnv`

    def __init__(self, **options: Any) -> None:
        mode = AutoresetMode.DISABLED
        batch = self.kind(1, max_episode_steps=None, autoreset_mode=mode, threads=1, **options)
        self.batch = batch
        self.render_mode = batch.render_mode
        self.observation_space = batch.single_observation_space
        self.action_space = batch.single_action_space
        self.np_random = batch.rngs[0]

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Any, Info]:
        """Begin a new episode."""
        self.batch.rngs[0] = self.np_random
        observations, info = self.batch.reset(seed=[seed], options=options)
        if seed is not None:
            self._np_random, self._np_random_seed = self.batch.rngs[0], seed
        return row(observations, 0), _one(info)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Info]:
        """Move by one step."""
        # Gymnasium lets steps follow the end of an episode, for its wrappers to complain.
        self.batch._ended[:] = not self.batch._begun
        observations, reward, terminated, _, info = self.batch.step(np.asarray(action)[None])
        return row(observations, 0), float(reward[0]), bool(terminated[0]), False, _one(info)

    def render(self) -> Any:
        """Return a picture (height, width, 3) uint8; None without a render mode."""
        return None if self.render_mode is None else self.batch.picture(0)


def row(values: Any, k: int) -> Any:
    """Return row k of arrays, or of mappings of arrays."""
    if isinstance(values, dict):
        return {name: row(own, k) for name, own in values.items()}
    return values[k].copy()


def with_cosine(poses: FloatArray) -> FloatArray:
    """Return poses (n, 3) as x, y, cosine and sine (n, 4)."""
    return np.column_stack((poses[:, :2], np.cos(poses[:, 2]), np.sin(poses[:, 2])))


def symmetric_box(most: list[float]) -> gym.spaces.Box:
    """Return the box from minus to plus some numbers."""
    high = np.array(most)
    return gym.spaces.Box(-high, high, dtype=np.float64)


def _masked(info: Info, mask: BoolArray) -> Info:
    """Add a mask `_name` (n,) to every name, as Gymnasium's vector environments do."""
    found: Info = {}
    for name, values in info.items():
        found[name] = _masked(values, mask) if isinstance(values, dict) else values
        found[f"_{name}"] = mask
    return found


def _one(info: Info) -> Info:
    """Return the info of a single environment."""
    own = {name: values for name, values in info.items() if not name.startswith("_")}
    return {
        name: _one(values)
        if isinstance(values, dict)
        else (values[0].item() if values.ndim == 1 else values[0].copy())
        for name, values in own.items()
    }


DRAWS: Final = 1024  # of the parameters, from which episodes choose
FORCE: Final = 1.0  # [N] of an ellipsoid; quasi-static motion does not depend on it
FRICTION: Final = 0.25  # against the plane, which quasi-static motion does not depend on either
MAX_REDRAWS: Final = 1000  # of a start with overlap
# Ratio of the arms of calibrated plates to that of uniform pressure.
ARM_RANGE: Final = (0.55, 1.9)
# Errors of the experiments of a calibration, which are no properties of the world.
_OF_EXPERIMENTS: Final = ("registration_", "outline_", "start_")
# Parameters in metres, which no part shares with one of another outline.
_OF_ONE_PART: Final = ("tripod_", "support_", "ellipsoid_")


class WorldDraws:
    """Parameters of a scene in n environments, drawn again for each episode.

    Raise `InvalidInput` if no draw can be simulated with the scene, a name does not suit it, or the
    support was calibrated on a part with another outline.
    """

    def __init__(self, scene: Scene, parameters: Any, n: int) -> None:
        belief = parameters if isinstance(parameters, Belief) else Belief(parameters=parameters)
        found = belief.scenarios(scene, worlds=DRAWS, runs=1).values
        draws = {
            name: np.asarray(x, np.float64)
            for name, x in found.items()
            if not name.startswith(_OF_EXPERIMENTS)
        }
        _refuse_other_part(scene, belief, draws)
        # The scene, with a support that the parameters can describe.
        self.scene = _with_support(scene, draws)
        reasons = infeasible(self.scene, draws) if draws else []
        ready = np.flatnonzero([not reason for reason in reasons])
        if not len(ready):
            what = f"no draw that can be simulated: {reasons[0]}" if reasons else "none"
            raise InvalidInput("parameters", found=what, expected="parameters that suit the scene")
        self._draws = {name: x[ready] for name, x in draws.items()}
        self._count = len(ready)
        # Parameters of the episodes [SI].
        self.values = {name: np.full(n, x[0]) for name, x in self._draws.items()}

    def redraw(self, which: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the parameters of the episodes that begin in environments `which` (k,)."""
        for k in which.tolist():
            row = int(rngs[k].integers(self._count))
            for name, x in self._draws.items():
                self.values[name][k] = x[row]


def usual_parameters(friction: tuple[float, float], arm: float) -> dict[str, tuple[float, float]]:
    """Return the ranges of friction and support, about an arm of uniform pressure [m]."""
    low, high = ARM_RANGE
    return {"mu_pusher": friction, "ellipsoid_torque": (low * FORCE * arm, high * FORCE * arm)}


def _refuse_other_part(scene: Scene, belief: Belief, names: Iterable[str]) -> None:
    """Raise for the support of a calibrated part whose outline is not that of the scene's body."""
    known = getattr(belief.parameters, "known", None)
    own = [name for name in names if name.startswith(_OF_ONE_PART)]
    if own and isinstance(known, KnownPushes) and not known.has_outline(scene):
        found = "values of a part with another outline than the one that is pushed here"
        expected = "a calibration of this part"
        hint = "or ranges by name, such as parameters={'mu_pusher': (0.1, 0.3)}"
        raise InvalidInput(f"parameters.{own[0]}", found=found, expected=expected, hint=hint)


def _with_support(scene: Scene, names: Iterable[str]) -> Scene:
    """Return the scene with the support that parameters of these names describe."""
    body, arm = scene.bodies[0], pressure_arm(scene.bodies[0])
    support: Support | None = None
    for name in names:
        if name == "tripod_radius":
            support = Tripod(radius=arm, friction=FRICTION)
        elif name.startswith("support_"):
            turns = 2.0 * np.pi * np.arange(3) / 3.0
            points = body.com + arm * np.column_stack((np.cos(turns), np.sin(turns)))
            support = SupportPoints(points=points, friction=FRICTION)
        elif name.startswith("pressure_"):
            support = UniformPressure(friction=FRICTION)
        elif name.startswith("ellipsoid_"):
            support = Ellipsoid(force=FORCE, torque=FORCE * arm, centre=body.com)
    return scene if support is None else replace(scene, bodies=(replace(body, support=support),))


def pressure_arm(body: Body) -> float:
    """Compute the mean distance of the outline's area from the centre of mass [m].

    It is the ratio of largest friction torque to largest friction force under uniform pressure.
    """
    points, share = cells(body.shape, 4000)
    return float(share @ np.hypot(*(points - body.com).T) / share.sum())
