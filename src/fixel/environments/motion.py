"""Motion of many bodies, each pushed by an agent of its own, one control step at a time.

The rollouts of all environments have the same arrays from step to step: nothing is packed between
two steps, and no Python code runs for a single environment.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Final

import numpy as np

from fixel.environments.loops import AgentState, Control, Rows, begin_step, end_step
from fixel.kernels.arrays import REACHED, SAMPLES, SMALLEST
from fixel.kernels.rollout import rollout_batch
from fixel.model import Body, Disk, PathDrive, Pusher, Scene, rotated
from fixel.simulation.motion import QuasiStatic
from fixel.simulation.pack import Template
from fixel.simulation.simulate import method_of
from fixel.simulation.stepping import Adaptive, Newton
from fixel.simulation.threads import empty_record
from fixel.simulation.vary import Variation
from fixel.typing import FloatArray, IntArray

SUBSTEPS: Final = 10  # of a control step
DT: Final = 0.01  # [s] of a substep
PERIOD: Final = SUBSTEPS * DT  # [s] of a control step
STIFFNESS: Final = 100.0  # [1/s^2] of the controller
DAMPING: Final = 20.0  # [1/s]
# Pymunk takes back 6 % of an overlap in a substep.
DECAY: Final = 0.9 ** (60.0 * PERIOD)
# Of the radius of the agent: error of the position in one step of the simulation, and the overlap
# that pymunk leaves.
TOLERANCE: Final = 0.005
SLOP: Final = 0.1 / 15.0
SHARE: Final = 32  # environments that a thread takes at a time
MAX_CONTACTS: Final = 64
# Of the simulation of one control step. Where the body cannot move, steps become ever shorter: the
# rollout ends then, and the agent stops. Limits 10 to 1,000 times as wide, which take 9 times as
# long and more, were compared over 7,680 control steps of Push-T, most of them near walls. With
# friction the agent stopped otherwise in 1 of them, and the T was more than 0.5 px away in 23 at
# most. Without friction these were 150 and 636, as they are between two of the wider limits: small
# errors decide where a T goes between agent and wall.
MAX_STEPS: Final = 100
SHORTEST: Final = 5e-3  # characteristic times, about 1 ms
USUAL_SPEED: Final = 15.0  # radii a second of the agent, for the units of the simulation

_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}


class PushMotion:
    """Quasi-static motion of n bodies under n round agents, in a unit of length of their own.

    The scene has one body and one round pusher, whose path is ignored, in metres; `unit` is the
    unit of length of the states [m]. A caller may change the states of the environments, `state`,
    between two steps. The centre of mass `com` (2,) is in the frame of the body's shape [unit].
    """

    def __init__(self, scene: Scene, n: int, *, unit: float, threads: int = 1) -> None:
        (body,), (pusher,) = scene.bodies, scene.pushers
        assert isinstance(pusher.shape, Disk)
        radius = pusher.shape.radius
        self.n, self.unit, self.com, self.radius = n, unit, body.com / unit, radius / unit
        self._path = _usual_path(pusher, radius)
        scene = replace(scene, pushers=(replace(pusher, drive=PathDrive(self._path)),))
        stepper = Adaptive(tolerance=TOLERANCE * radius, largest_step=1.0, max_steps=MAX_STEPS)
        self.scene = scene
        self._template = Template(scene, QuasiStatic(), stepper)
        self._period = PERIOD / self._template.units.time
        self._method = method_of(QuasiStatic(), stepper, Newton(), MAX_CONTACTS)
        units = self._template.units
        self._control = Control(
            STIFFNESS, DAMPING, DT, self.radius, 1.01 * _reach(body) / unit, DECAY,
            SLOP * self.radius, unit / units.length, 1.0 / units.time,
        )  # fmt: skip
        corners = np.zeros((0, 2)) if isinstance(body.shape, Disk) else body.shape.vertices
        self._outline = np.ascontiguousarray((corners - body.com) / unit)
        self.state = AgentState(
            agent=np.zeros((n, 4)),
            body=np.zeros((n, 3)),
            sunk=np.zeros(n),
            route=np.zeros((n, 1 + SUBSTEPS, 2)),
            outcome=np.zeros(n, np.int64),
            settled=np.zeros(n, np.int64),
        )
        n_share = max(1, n // SHARE)
        ends = [n * k // n_share for k in range(n_share + 1)]
        self._shares = list(itertools.pairwise(ends))
        self._threads = min(threads, n_share)
        if self._threads == 1:
            self._shares = [(0, n)]
        self.set_parameters({})

    def __reduce__(self) -> Any:
        # The rows share memory with the batch: copies of both would not.
        return _restored, (self.scene, self.n, self.unit, self._threads, self._values, self.state)

    def set_parameters(self, values: Mapping[str, FloatArray]) -> None:
        """Pack the scene again, with parameters (n,) of each environment by name [SI]."""
        self._values = values
        n, offset = self.n, values.get("contact_offset", np.zeros(self.n))
        variation = Variation(
            {**values, "contact_offset": offset},
            np.repeat(self.scene.bodies[0].pose[None, None], n, axis=0),
            np.repeat(self._path[None], n, axis=0),
        )
        packed = self._template.packed(variation, n, PERIOD)
        model = packed.batch.model._replace(plane=packed.batch.model.plane.copy())
        batch = packed.batch._replace(model=model)
        n_piece = len(model.piece_radius) // n
        batch.settings[:, SMALLEST] = SHORTEST
        self._batch = batch
        self._record = empty_record(packed, 1, 0, np.array([PERIOD]), bare=True)
        self._rows = Rows(
            begin=batch.begin,
            source=batch.begin.copy(),
            plane=model.plane,
            plane_source=model.plane.copy(),
            pose=batch.pose.reshape(n, -1, 3),
            path=model.path.reshape(n, -1, 4),
            piece_radius=model.piece_radius.reshape(n, -1),
            piece_bound=model.piece_bound.reshape(n, -1, 3),
            piece=int(np.flatnonzero(model.piece_body[:n_piece] == 1)[0]),
            extra=offset / self.unit,
            place=np.zeros(n, np.int64),
        )

    def place(
        self, which: IntArray, agent: FloatArray, body: FloatArray, sunk: FloatArray | float = 0.0
    ) -> None:
        """Place agents at rest at (k, 2), and the shapes of bodies at (k, 3) [unit, unit, rad].

        The environments are `which` (k,). The next steps take the overlap `sunk` (k,) of agent and
        body back little by little [unit].
        """
        state = self.state
        state.agent[which, :2], state.agent[which, 2:] = agent, 0.0
        state.body[which], state.sunk[which] = body + _shift(body[:, 2], self.com), sunk
        state.outcome[which] = state.settled[which] = 0

    def poses(self) -> FloatArray:
        """Return poses (n, 3) of the shapes of the bodies [unit, unit, rad]."""
        body = self.state.body
        return body + _shift(body[:, 2], -self.com)

    def step(self, action: FloatArray) -> None:
        """Move all agents towards `action` (n, 2) for one control step [unit]."""
        left = iter(self._shares)  # one for all threads

        def work() -> None:
            for share in left:
                self._share(action, *share)

        others = self._threads - 1
        waiting = [_pool(others).submit(work) for _ in range(others)]
        work()
        for one in waiting:
            one.result()

    def _share(self, action: FloatArray, first: int, last: int) -> None:
        record, rows = self._record, self._rows
        end = begin_step(self.state, self._control, rows, self._outline, action, first, last)
        if end == first:
            return
        for array in (record.count, record.total, record.status):
            array[first:end] = 0
        record.time[first:end] = self._period  # a rollout that stops early writes its own
        rollout_batch(self._batch, self._method, record, False, first, end)
        end_step(
            self.state, self._control, rows, record.pose[:, 0, 0], record.count[:, SAMPLES],
            record.status, record.total[:, REACHED], first, end,
        )  # fmt: skip


def _restored(
    scene: Scene, n: int, unit: float, threads: int, values: Any, state: AgentState
) -> PushMotion:
    motion = PushMotion(scene, n, unit=unit, threads=threads)
    motion.set_parameters(values)
    motion.state = state
    return motion


def _shift(angle: FloatArray, point: FloatArray) -> FloatArray:
    """Shifts (n, 3) of poses at angles (n,) by a point of their frames."""
    return np.column_stack((rotated(point, angle), np.zeros(len(angle))))


def _usual_path(pusher: Pusher, radius: float) -> FloatArray:
    """Path with a usual speed, which sets the units of the simulation."""
    path = np.zeros((1 + SUBSTEPS, 4))
    path[:, 0] = np.linspace(0.0, PERIOD, 1 + SUBSTEPS)
    path[:, 1:] = pusher.pose
    path[:, 1] += USUAL_SPEED * radius * path[:, 0]
    return path


def _reach(body: Body) -> float:
    """Largest distance of the outline from the centre of mass [m]."""
    if isinstance(body.shape, Disk):
        return body.shape.radius + math.hypot(*body.com)
    return float(np.hypot(*(body.shape.vertices - body.com).T).max())


def _pool(n: int) -> ThreadPoolExecutor:
    """Return a pool of `n` threads of this process; they wait for the next step."""
    if (os.getpid(), n) not in _pools:
        _pools[os.getpid(), n] = ThreadPoolExecutor(n, "fixel-environments")
    return _pools[os.getpid(), n]
