"""Results of simulations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.kernels import codes
from fixel.model import Parameters, Scene, Seated, Trajectory
from fixel.typing import FloatArray, IntArray

CONTACT_FIELDS = np.dtype(
    [
        ("time", np.float64),  # [s]
        ("body", np.int64),  # index into `names`
        ("other", np.int64),
        ("gap", np.float64),  # [m]
        ("normal", np.float64, (2,)),  # unit, from `other` into `body`
        ("point", np.float64, (2,)),  # [m]
        ("normal_force", np.float64),  # [N]
        ("tangential_force", np.float64),  # [N], along the normal turned by +90 degrees
        ("step", np.float64),  # [s] of the step; force times step is the impulse
    ]
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PusherTrace:
    """Travel and force of one pusher.

    Attributes
    ----------
    travel : float
        Length of the path covered [m].
    force : (n_sample,) float64
        Force of the bodies on it, along its path [N].
    stalled : (n_sample,) bool
        Whether its drive stalled: a speed below 1 % of the commanded one.
    """

    travel: float
    force: FloatArray
    stalled: NDArray[np.bool_]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation:
    """Record of one simulation: scene, method and results.

    Attributes
    ----------
    status : str
        ``converged``, or the reason of an early end (`fixel.kernels.codes.STATUS_NAMES`).
    advice : str
        Remedy for an early end; empty when converged.
    stopped_at : float or None
        Time of an early end [s], up to which results are stored.
    time : (n_sample,) float64
        Times of the samples [s].
    pose, twist : mapping from name to (n_sample, 3) float64
        Pose of every body's shape frame, twist of its centre of mass [m, m, rad; m/s, m/s, rad/s].
    contacts : (n_contact,) structured, see CONTACT_FIELDS
        Touching contacts of every sample.
    max_residual : float
        Worst natural-map residual of any step, in the scene's scaled units.
    """

    scene: Scene
    parameters: Parameters | None
    method: Mapping[str, Any]
    status: str
    stopped_at: float | None
    duration: float
    time: FloatArray
    pose: Mapping[str, FloatArray]
    twist: Mapping[str, FloatArray]
    contacts: NDArray[np.void]
    pushers: Mapping[str, PusherTrace]
    steps: int
    fallbacks: int
    max_residual: float
    wall_time_s: float
    version: str = field(default="")

    @property
    def advice(self) -> str:
        return codes.STATUS_ADVICE[codes.STATUS_NAMES.index(self.status)]

    @property
    def converged(self) -> bool:
        return self.status == codes.STATUS_NAMES[codes.CONVERGED]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all bodies: free, then pushers, then fixels; contacts use these indices."""
        return self.scene.names

    @property
    def final(self) -> dict[str, FloatArray]:
        """Last pose of every free and driven body."""
        return {name: poses[-1] for name, poses in self.pose.items()}

    @property
    def touching(self) -> list[tuple[str, str]]:
        """Pairs of bodies that touch at the end."""
        last = self.contacts[self.contacts["time"] == self.time[-1]]
        pairs = sorted({(int(c["body"]), int(c["other"])) for c in last})
        names = self.names
        return [(names[a], names[b]) for a, b in pairs]

    def meets(self, goal: Seated) -> bool:
        """Return whether the end of the simulation meets a goal."""
        return bool(goal.met(self.scene, self.final))

    def trajectory(self, name: str) -> Trajectory:
        """Return the pose of one body against time."""
        return Trajectory(time=self.time, pose=self.pose[name])

    def summary(self) -> dict[str, Any]:
        """Return the output of `fixel simulate --json` as plain values (scene.md)."""
        answer: dict[str, Any] = {"status": self.status}
        if self.stopped_at is not None:
            answer["stopped_at"] = self.stopped_at
            answer["advice"] = self.advice
        answer |= {
            "duration": self.duration,
            "steps": self.steps,
            "max_residual": self.max_residual,
            "wall_time_s": self.wall_time_s,
            "final": {name: pose.tolist() for name, pose in self.final.items()},
            "pushers": {
                name: {
                    "travel": trace.travel,
                    "force": float(trace.force[-1]),
                    "stalled": bool(trace.stalled[-1]),
                }
                for name, trace in self.pushers.items()
            },
            "touching": [list(pair) for pair in self.touching],
            "fallbacks": self.fallbacks,
            "method": dict(self.method),
        }
        return answer


MAX_NAMES: Final = 12  # bodies listed for a printed batch


@final
@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class BatchResult:
    """Results of many rollouts.

    Attributes
    ----------
    status : (n,) int64
        Index into `fixel.kernels.codes.STATUS_NAMES`; 0 is converged.
    time : (n_sample,) float64
        Times of the samples [s]; the last is the end.
    pose : (n, n_sample, n_moving, 3) float64
        Poses of the shape frames of free bodies, then pushers [m, m, rad]. The last pose of a
        rollout that stopped early is repeated.
    stopped_at : (n,) float64
        Time reached [s].
    steps, fallbacks : (n,) int64
    max_residual : (n,) float64
    force : (n, n_driven) float64
        Force on each pusher along its path at the end [N].
    stalled : (n, n_driven) bool
    """

    names: tuple[str, ...]
    status: IntArray
    time: FloatArray
    pose: FloatArray
    stopped_at: FloatArray
    steps: IntArray
    fallbacks: IntArray
    max_residual: FloatArray
    force: FloatArray
    stalled: NDArray[np.bool_]

    @property
    def final(self) -> FloatArray:
        """Poses (n, n_moving, 3) at the end."""
        return self.pose[:, -1]

    @property
    def converged(self) -> NDArray[np.bool_]:
        return np.equal(self.status, codes.CONVERGED)

    def pose_of(self, name: str) -> FloatArray:
        """Return the poses (n, n_sample, 3) of one body."""
        return self.pose[:, :, self.names.index(name)]

    def __repr__(self) -> str:
        """Summarise in a few lines the counts by status and the final poses."""
        n, n_sample = self.pose.shape[:2]
        ended = Counter(codes.STATUS_NAMES[int(code)] for code in self.status)
        lines = [
            f"BatchResult of {n} rollouts, {n_sample} samples up to {self.time[-1]:g} s"
            if n_sample
            else f"BatchResult of {n} rollouts without samples",
            "  " + ", ".join(f"{name} {count}" for name, count in ended.most_common()),
            f"  {self.steps.sum()} steps, {self.fallbacks.sum()} fallbacks; worst residual"
            f" {np.max(self.max_residual, initial=0.0):.1e}",
        ]
        if n and n_sample:
            shown = self.names[:MAX_NAMES]
            rows = [(name, np.median(self.final[:, k], axis=0)) for k, name in enumerate(shown)]
            lines += [
                f"  {name}: median end x {x:.6g} m, y {y:.6g} m, angle {angle:.6g} rad"
                for name, (x, y, angle) in rows
            ]
            left_out = len(self.names) - len(shown)
            lines += [f"  ... and {left_out} more bodies"] if left_out else []
        return "\n".join(lines)
