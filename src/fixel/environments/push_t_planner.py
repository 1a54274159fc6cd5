"""Scripted policy for the Push-T task: the best of many simulated pushes, one after another."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import shapely

from fixel.environments import push_t
from fixel.environments.motion import PushMotion
from fixel.model import rotated
from fixel.typing import FloatArray, IntArray

CANDIDATES: Final = 192  # pushes simulated for each choice
CLEARANCE: Final = 3.0  # [px] between agent and T where a push begins
WAY_RADIUS: Final = 135.0  # [px] of the circle about the T on which the agent goes round
MAX_TURN: Final = math.radians(50.0)  # about the T in one control step
NEAR: Final = 4.0  # [px] from a place that counts as reached
PUSH_STEPS: Final = 7  # control steps of a push
MAX_LENGTH: Final = 110.0  # of a push [px]
MIN_LENGTH: Final = 4.0
MARGIN: Final = 8.0  # [px] between a start of a push and the border of the table

# Phases of an agent.
CHOOSE, LEAVE, TURN, ENTER, PUSH = range(5)


class PushTPlanner:
    """Policy that simulates many pushes in a world, and carries out the best one.

    The agent leaves the T, goes round it, and pushes it straight. The pushes start at random places
    of its outline, in directions about the inward normal. The best one has the corners of the T
    closest to those of its goal. It is planned in `world`, whatever the world of the environment.

    Parameters
    ----------
    n : int
        Number of environments.
    world : str
        ``"legacy"`` or ``"nominal"``.
    seed : int
        Seed of the candidates.

    Examples
    --------
    >>> from fixel.environments.push_t import PushTVectorEnv
    >>> env, planner = PushTVectorEnv(2), PushTPlanner(2)
    >>> observations, info = env.reset(seed=0)
    >>> planner.actions(observations).shape
    (2, 2)
    """

    def __init__(self, n: int, *, world: push_t.WorldName = "legacy", seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self._motion = PushMotion(push_t.push_t_scene_of(world), CANDIDATES, unit=push_t.PIXEL)
        self._goal = push_t.keypoints(push_t.GOAL[None])[0]
        self._phase = np.full(n, CHOOSE)
        self._steps = np.zeros(n, np.int64)
        self._start = np.zeros((n, 2))
        self._end = np.zeros((n, 2))

    def restart(self, which: IntArray) -> None:
        """Forget the pushes of environments whose episode ended."""
        self._phase[which] = CHOOSE

    def actions(self, observations: FloatArray, which: IntArray | None = None) -> FloatArray:
        """Return actions for observations (n, 5) of the type ``"state"``.

        Parameters
        ----------
        observations : (n, 5) float64
        which : (k,) int, optional
            Environments to plan for; all by default.

        Returns
        -------
        (k, 2) float64
            Targets of the agents [px].
        """
        own = range(len(observations)) if which is None else which.tolist()
        return np.array([self._action(k, observations[k]) for k in own])

    def _action(self, k: int, state: FloatArray) -> FloatArray:
        agent, pose = state[:2], state[2:]
        # Centre of a circle of 75 px about the T.
        middle = pose[:2] + 45.0 * np.array([-math.sin(pose[2]), math.cos(pose[2])])
        if self._phase[k] == PUSH and self._steps[k] >= PUSH_STEPS:
            self._phase[k] = CHOOSE
        if self._phase[k] == CHOOSE:
            self._start[k], self._end[k] = self._choose(pose)
            self._phase[k] = LEAVE
        if self._phase[k] == LEAVE:
            if math.hypot(*(agent - middle)) > WAY_RADIUS - NEAR:
                self._phase[k] = TURN
            else:
                return _on_circle(middle, _angle(agent - middle))
        along = self._start[k] - self._end[k]
        outside = middle + _exit(self._start[k] - middle, along)
        if self._phase[k] == TURN:
            turn = _angle(outside - middle) - _angle(agent - middle)
            turn = math.remainder(turn, 2.0 * math.pi)
            if abs(turn) > math.radians(4.0):
                step = min(max(turn, -MAX_TURN), MAX_TURN)
                return _on_circle(middle, _angle(agent - middle) + step)
            self._phase[k] = ENTER
        if self._phase[k] == ENTER:
            if math.hypot(*(agent - self._start[k])) > 1.0:
                return np.array(self._start[k])
            self._phase[k], self._steps[k] = PUSH, 0
        self._steps[k] += 1
        return np.array(self._end[k])

    def _choose(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return start and end of the agent in the push that brings the T closest to its goal."""
        start, end = self._candidates(pose)
        self._motion.place(np.arange(CANDIDATES), start, np.tile(pose, (CANDIDATES, 1)))
        for _ in range(PUSH_STEPS):
            self._motion.step(end)
        off = ((push_t.keypoints(self._motion.poses()) - self._goal) ** 2).mean(axis=(1, 2))
        best = int(off.argmin())
        return start[best], end[best]

    def _candidates(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Draw starts and ends (CANDIDATES, 2) of the agent."""
        rng, n = self._rng, 8 * CANDIDATES
        edge = np.roll(push_t.OUTLINE, -1, axis=0) - push_t.OUTLINE
        length = np.hypot(*edge.T)
        k = rng.choice(len(edge), n, p=length / length.sum())
        inward = np.column_stack((-edge[k, 1], edge[k, 0])) / length[k, None]
        touched = push_t.OUTLINE[k] + rng.uniform(0.03, 0.97, (n, 1)) * edge[k]
        start = touched - (push_t.AGENT_RADIUS + CLEARANCE) * inward
        aside = math.radians(35.0) * rng.uniform(-1.0, 1.0, n)
        way = rotated(inward, aside)
        # Lengths of every order of magnitude: a last push may have to be short.
        far = np.exp(rng.uniform(math.log(MIN_LENGTH), math.log(MAX_LENGTH), n))
        end = start + way * far[:, None]
        outline = shapely.LinearRing(push_t.OUTLINE)
        apart = shapely.distance(outline, shapely.points(start))
        free = apart > push_t.AGENT_RADIUS + 0.5 * CLEARANCE
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        turn = np.array([[cos, sin], [-sin, cos]])
        start, end = start @ turn, end @ turn
        start, end = start + pose[:2], end + pose[:2]
        both = np.concatenate((start, end), axis=1)
        free &= (both > MARGIN).all(axis=1) & (both < push_t.SIDE - MARGIN).all(axis=1)
        rows = np.resize(np.flatnonzero(free), CANDIDATES)
        return start[rows], end[rows]


def _angle(way: FloatArray) -> float:
    return math.atan2(way[1], way[0])


def _on_circle(middle: FloatArray, angle: float) -> FloatArray:
    """Return the place on the agent's circle about a T."""
    return middle + WAY_RADIUS * np.array([math.cos(angle), math.sin(angle)])


def _exit(start: FloatArray, way: FloatArray) -> FloatArray:
    """Return where a ray from a place inside the agent's circle leaves it, about its centre."""
    unit = way / math.hypot(*way)
    along = float(start @ unit)
    return start + unit * (
        math.sqrt(max(0.0, along**2 + WAY_RADIUS**2 - float(start @ start))) - along
    )
