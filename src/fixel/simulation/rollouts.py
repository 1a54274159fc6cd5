"""Rollouts of an ensemble: what is simulated, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fixel.kernels import codes
from fixel.model import Scene
from fixel.simulation.motion import AbstractMotionModel, OtherEngine
from fixel.simulation.stepping import AbstractStepper
from fixel.typing import FloatArray, IntArray


class RolloutCase(NamedTuple):
    """Scene with one free body, and the times at which it is sampled."""

    scene: Scene
    times: FloatArray  # (n_sample,) increasing, above 0 [s]; the last is the end


class EnsembleOutcome(NamedTuple):
    """Results of the rollouts of one call.

    Forces between two samples are not recorded: add samples where a peak matters.
    """

    status: IntArray  # (n,) index into codes.STATUS_NAMES; INFEASIBLE where not simulated
    pose: FloatArray  # (n, n_sample, 3) of the body; the last one repeated where a case has fewer
    stopped_at: FloatArray  # (n,) time reached [s]
    force: FloatArray  # (n,) largest force of the drive in the steps that hold the samples [N]
    stalled: NDArray[np.bool_]  # (n,) whether a force-limited drive is stalled at the last sample
    reasons: list[str]  # why there is no simulation, or it ended early; empty for others
    others: FloatArray  # (n, n_free - 1, 3) last poses of further free bodies [m, m, rad]

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Return (n,) bool: simulations that reached their end."""
        return np.equal(self.status, codes.CONVERGED)


INFEASIBLE = -1  # status of a rollout whose parameters cannot be


class Rollouts(Protocol):
    """Set of scenes that are simulated many times, by fixel or by another engine."""

    motion: AbstractMotionModel
    stepper: AbstractStepper
    cases: tuple[RolloutCase, ...]

    @property
    def n_sample(self) -> int: ...

    def simulate(
        self, which: IntArray, values: Mapping[str, FloatArray], fixels: FloatArray | None = None
    ) -> EnsembleOutcome: ...

    def simulate_into(
        self,
        use: Callable[[IntArray, FloatArray], None],
        which: IntArray,
        values: Mapping[str, FloatArray],
    ) -> tuple[NDArray[np.bool_], list[str]]: ...

    def refused(self, which: IntArray, values: Mapping[str, FloatArray]) -> list[str]: ...


def ensemble_of(
    cases: Sequence[RolloutCase],
    motion: AbstractMotionModel | None = None,
    stepper: AbstractStepper | None = None,
    threads: int | None = None,
) -> Rollouts:
    """Return the ensemble that simulates cases by a motion model or by another engine."""
    # Imported here: each ensemble needs the classes above.
    if isinstance(motion, OtherEngine):
        made = import_module("fixel.simulation.engines.ensemble").EngineEnsemble
    else:
        made = import_module("fixel.simulation.ensemble").Ensemble
    rollouts: Rollouts = made(cases, motion, stepper, threads=threads)
    return rollouts
