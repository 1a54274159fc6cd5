"""Results of simulations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from math import degrees
from pathlib import Path
from typing import Any, Final, NamedTuple, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput, check_name, counted
from fixel.kernels import codes
from fixel.model import (
    Body,
    BodyTrack,
    Fixel,
    Goal,
    Parameters,
    Polygon,
    Pose,
    Pusher,
    Scene,
    Trajectory,
)
from fixel.model.goals import as_goal
from fixel.model.parameters import info_of
from fixel.registry import offered
from fixel.results import Player, Result, Summary
from fixel.simulation.geometry import contact_outline, outline_tolerance
from fixel.simulation.stepping import Lemke
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray, IntArray

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


FORCED_ADVICE: Final = (
    "Without inertia, friction or contacts have to balance the force on every body. Reduce the "
    "force, or use the motion model dynamic."
)
ALTERNATING_ADVICE: Final = (
    "With support_directions, quasi-static motion may alternate between two velocities in very "
    "short steps. Leave support_directions out, use a fixed step, or a tolerance of 0.1 % of the "
    "size of the part."
)
NO_SLOPES: Final = "contact modes are lost or jump, or contacts close at the same time"
# Verdicts of `Accuracy`.
CERTIFIED: Final = "certified"
AGREED: Final = "agreed"
UNCERTAIN: Final = "uncertain"
MAX_BODIES: Final = 12  # listed for a printed result
POSE_NAMES: Final = ("x", "y", "theta")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PusherTrajectory(Trajectory):
    """Pose and force of one pusher against time.

    Parameters
    ----------
    travel : float
        Length of the path covered [m]; if the drive may stall, straight from sample to sample.
    force : (n,) float64
        Force of the bodies on it, along its path [N].
    stalled : (n,) bool
        Whether its drive stalled: a speed below 1 % of the commanded one.
    """

    travel: float
    force: FloatArray
    stalled: BoolArray


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Comparison of the end of a simulation with that of a second, independent way.

    Attributes
    ----------
    verdict : str
        ``certified``: every contact mode held, and the stepper ended at the same pose; ``agreed``:
        small fixed steps ended there; ``uncertain``: neither.
    distance : float
        Largest distance between the two ends of a free body [m].
    angle : float
        Largest angle between them [rad].
    other : (n_free, 3) float64
        End of every free body by the second way [m, m, rad].
    reason : str
        Why the verdict is not ``certified``; empty where it is.
    parted_at : float or None
        Time from which the two ways differ by more than ends that agree [s]; None if they do not.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> push = fixel.simulate(pushed_square(), motion="quasistatic", accuracy=True)
    >>> push.accuracy.verdict
    'certified'
    """

    verdict: str
    distance: float
    angle: float
    other: FloatArray
    reason: str = ""
    parted_at: float | None = None

    def __str__(self) -> str:
        apart = f"{1e3 * self.distance:.2g} mm and {degrees(self.angle):.2g} deg"
        why = f" ({self.reason})" if self.reason else ""
        return f"{self.verdict}: two ways to solve it end {apart} apart{why}"


@final
@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Simulation(Result):
    """Result of one simulation: scene, method and motion.

    `simulation["part"]` is the trajectory of a body; for a pusher it has also `force`, `travel` and
    `stalled`.

    Another engine reports neither contacts nor forces: `contacts` and `pushers` are empty then,
    twists are differences of the poses, and `steps` and `max_residual` are zero.

    Attributes
    ----------
    scene : Scene
        Scene that was simulated.
    parameters : Parameters or None
        Values that replaced those of the scene.
    method : mapping
        Names and options of motion model, stepper and solver; requested names that have no
        derivative as `lacking`.
    status : str
        ``converged``, or the reason of an early end (`fixel.kernels.codes.STATUS_NAMES`).
    stopped_at : float or None
        Time of an early end [s], up to which results are stored.
    duration : float
        Simulated time [s].
    time : (n_sample,) float64
        Times of the samples [s].
    pose, twist : mapping from name to (n_sample, 3) float64
        Pose of every body's shape frame, twist of its centre of mass [m, m, rad; m/s, m/s, rad/s].
    contacts : (n_contact,) structured, see CONTACT_FIELDS
        Touching contacts of every sample.
    pushers : mapping from name to PusherTrajectory
        Motion, travel and forces of the pushers.
    steps, fallbacks : int
        Number of steps, and of those that needed another solver.
    max_residual : float
        Worst natural-map residual of any step, in the scene's scaled units.
    wall_time_s : float
        Computing time [s]; as plain Python until the code is compiled, a hundred times as long.
    version : str
        Version of fixel.
    accuracy : Accuracy or None
        Confirmation of the end by a second, independent method; None if not requested.
    derivatives : mapping from name to (3,) float64, or None
        Derivative of x, y and theta of the part at the end, by each requested name [SI units];
        empty if there are none, because contact modes are lost, jump, or end elsewhere than the
        stepper. Names that change which of two contacts closes first, where both close at the
        same time, have none.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> push = fixel.simulate(pushed_square())
    >>> x, y, theta = push.final["part"]
    >>> print(f"moved {1e3 * x:.1f} mm")
    moved 32.0 mm
    >>> push.touching
    [('part', 'finger')]
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
    pushers: Mapping[str, PusherTrajectory]
    steps: int
    fallbacks: int
    max_residual: float
    wall_time_s: float
    version: str = field(default="")
    accuracy: Accuracy | None = None
    derivatives: Mapping[str, FloatArray] | None = None

    @property
    def advice(self) -> str:
        """Remedy for an early end; empty when converged."""
        status = codes.STATUS_NAMES.index(self.status)
        longest = self.method.get("solver") == Lemke.name and self.steps >= Lemke.MAX_STEPS
        if status == codes.MAX_STEPS and longest:
            return f"Lemke's method is for at most {Lemke.MAX_STEPS} steps. Use the solver newton."
        advice = codes.STATUS_ADVICE[status]
        quasistatic = self.method.get("motion") == "quasistatic"
        if status == codes.MAX_STEPS and quasistatic and self.scene.support_directions:
            return ALTERNATING_ADVICE
        forced = any(body.force.any() or body.spring for body in self.scene.bodies)
        if status == codes.MAX_ITERATIONS and quasistatic and forced:
            return FORCED_ADVICE
        pushers = self.scene.pushers
        if status == codes.JAMMED and pushers and all(p.drive.force_limit for p in pushers):
            advice = codes.JAMMED_AT_LIMIT
        reason = self.method.get("reason")
        return f"{reason}. {advice}" if reason else advice

    @property
    def simplified(self) -> list[str]:
        """Sentences on outlines that were simplified for contacts, and how far; usually none."""
        if "engine" in self.method:
            return []
        scene, notes = self.scene, []
        items: list[Body | Pusher | Fixel] = [*scene.bodies, *scene.pushers, *scene.fixels]
        for item in items:
            full, used = item.shape, contact_outline(item.shape)
            if used is not full and isinstance(full, Polygon) and isinstance(used, Polygon):
                notes.append(
                    f"outline of {item.name} for contacts: {len(used.vertices)} of its "
                    f"{len(full.vertices)} corners, within {1e3 * outline_tolerance(full):.2g} mm"
                )
        return notes

    @property
    def converged(self) -> bool:
        """Whether the simulation reached its end."""
        return self.status == codes.STATUS_NAMES[codes.CONVERGED]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all bodies: free, then pushers, then fixels; contacts use these indices."""
        return self.scene.names

    @property
    def final(self) -> dict[str, Pose]:
        """Last pose of every free and driven body."""
        return {name: Pose(*poses[-1].tolist()) for name, poses in self.pose.items()}

    @property
    def touching(self) -> list[tuple[str, str]]:
        """Pairs of bodies that touch at the end."""
        last = self.contacts[self.contacts["time"] == self.time[-1]]
        pairs = sorted({(int(c["body"]), int(c["other"])) for c in last})
        names = self.names
        return [(names[a], names[b]) for a, b in pairs]

    def meets(self, goal: Goal) -> bool:
        """Return whether the simulation meets a goal."""
        traces = self.pushers.values()
        stalled = np.array([any(trace.stalled[-1] for trace in traces)])
        force = np.array([max((np.abs(trace.force).max() for trace in traces), default=0.0)])
        tracks = {name: BodyTrack(pose[None], stalled, force) for name, pose in self.pose.items()}
        return bool(as_goal(goal).met(self.scene, tracks)[0])

    def __getitem__(self, name: str) -> Trajectory:
        """Return the trajectory of a free or driven body, with forces for a pusher."""
        pose = self.pose[_known(name, list(self.pose))]
        return self.pushers.get(name) or Trajectory(time=self.time, pose=pose)

    @overload
    def animate(self, path: None = None, *, progress: Any = None) -> Player: ...
    @overload
    def animate(self, path: str | Path, *, progress: Any = None) -> Path: ...
    def animate(self, path: str | Path | None = None, *, progress: Any = None) -> Path | Player:
        """Show the motion in a notebook, or write an animation of it.

        Parameters
        ----------
        path : str or path, optional
            File to write: `.mp4` or `.gif`. Without it, a player is returned, which a notebook
            shows: play, pause, a slider for the time, contact forces.
        progress : bool or callable, optional
            As for `fixel.progress.show_progress`.

        Returns
        -------
        pathlib.Path or Player
            The file, or the player. Its `page` is HTML that works offline.

        Raises
        ------
        InvalidInput
            The file name has another ending, or the file cannot be written.

        Examples
        --------
        >>> import fixel
        >>> from fixel.testing.scenes import pushed_square
        >>> push = fixel.simulate(pushed_square())
        >>> player = push.animate()  # the last line of a cell shows it
        >>> "<script" in player.page
        True
        """
        if path is None:
            player: Player = offered("methods", "player")(self)
            return player
        offered("methods", "animate")(self, path, progress=progress)
        return Path(path)

    def _summary(self) -> Summary:
        names = (self.method["motion"], self.method["stepper"])
        taken = f" in {self.steps} steps ({', '.join(names)})"
        quality = f"worst residual {self.max_residual:.1e}"
        if not self.steps and "engine" in self.method:
            taken = f" by {self.method['engine']}"
            quality = "contacts and forces are not known from another engine"
        ended = f"{self.duration:g} s"
        if self.stopped_at is not None:
            ended = f"stopped at {self.stopped_at:.4g} s"
        partners: dict[str, list[str]] = {name: [] for name in self.names}
        for a, b in self.touching:
            partners[a].append(b)
            partners[b].append(a)
        unit, factor = _length_unit(np.concatenate(list(self.pose.values())))
        rows = [
            (
                *(name, factor * pose.x, factor * pose.y, degrees(pose.theta)),
                ", ".join(partners[name]) or None,
            )
            for name, pose in self.final.items()
        ]
        place = (Column("x", unit, ".2f"), Column("y", unit, ".2f"), Column("angle", "deg", ".2f"))
        traces = [
            (
                *(name, factor * own.travel, float(own.force[-1])),
                "stalled" if own.stalled[-1] else "",
            )
            for name, own in self.pushers.items()
        ]
        columns = ("pusher", Column("travel", unit, ".2f"), Column("force", "N", ".4g"), "")
        lacking = self.method.get("lacking", ())
        return Summary(
            f"Simulation: {self.status}, {ended}{taken}",
            [
                Table(("body, at the end", *place, "touching"), rows),
                *([Table(columns, traces)] if traces else []),
                *([self._slopes()] if self.derivatives else []),
            ],
            [
                *([self.advice] if self.advice else []),
                *([str(self.accuracy)] if self.accuracy else []),
                *([f"no derivatives by {', '.join(lacking)}: {NO_SLOPES}"] if lacking else []),
                *self.simplified,
                quality,
            ],
            {
                "parameters": ", ".join(f"{k} = {v:g}" for k, v in (self.parameters or {}).items()),
                "solver": str(self.method["solver"]),
                "version": f"fixel {self.version}",
            },
        )

    def _slopes(self) -> Table:
        """Derivatives of the end, each in units of the part's pose per unit of the parameter."""
        units = dict(zip(POSE_NAMES, ("m", "m", "rad"), strict=True))
        rows = [
            (name, units.get(name) or info_of(name).unit, *slope.tolist())
            for name, slope in (self.derivatives or {}).items()
        ]
        ends = (Column(name, f"{unit} per unit", ".4g") for name, unit in units.items())
        return Table(("derivative of the end, by", "unit", *ends), rows)

    def _data(self) -> Table:
        rows = (
            (float(t), name, *pose, *twist)
            for name, poses in self.pose.items()
            for t, pose, twist in zip(
                self.time, poses.tolist(), self.twist[name].tolist(), strict=True
            )
        )
        units = (("x", "m"), ("y", "m"), ("theta", "rad"))
        return Table(
            (
                *(Column("time", "s"), Column("body")),
                *(Column(name, unit) for name, unit in units),
                *(Column(f"v{name}", f"{unit}/s") for name, unit in units[:2]),
                Column("omega", "rad/s"),
            ),
            rows,
        )

    def summary(self) -> dict[str, Any]:
        """Return the output of `fixel simulate --json` as plain values."""
        answer: dict[str, Any] = {"status": self.status}
        if self.stopped_at is not None:
            answer["stopped_at"] = self.stopped_at
            answer["advice"] = self.advice
        answer |= {
            "duration": self.duration,
            "steps": self.steps,
            "max_residual": self.max_residual,
            "wall_time_s": self.wall_time_s,
            "final": {name: list(pose) for name, pose in self.final.items()},
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
        if self.simplified:
            answer["simplified"] = self.simplified
        if self.accuracy:
            answer["accuracy"] = asdict(self.accuracy) | {"other": self.accuracy.other.tolist()}
        if self.derivatives is not None:
            answer["derivatives"] = {k: v.tolist() for k, v in self.derivatives.items()}
        return answer


class BodyRuns(NamedTuple):
    """Poses of one body in many runs.

    Attributes
    ----------
    time : (n_sample,) float64
        Times of the samples [s]; the last is the end.
    pose : (n, n_sample, 3) float64
        Poses in the world [m, m, rad].
    """

    time: FloatArray
    pose: FloatArray

    @property
    def x(self) -> FloatArray:
        """Position x (n, n_sample) [m]."""
        return self.pose[..., 0]

    @property
    def y(self) -> FloatArray:
        """Position y (n, n_sample) [m]."""
        return self.pose[..., 1]

    @property
    def theta(self) -> FloatArray:
        """Angle (n, n_sample) [rad]."""
        return self.pose[..., 2]

    @property
    def final(self) -> Pose:
        """Last pose of every run, as arrays (n,)."""
        return Pose(*self.pose[:, -1].T)


@final
@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class BatchResult(Result):
    """Results of many runs.

    `runs["part"]` has the poses of a body in all runs; `runs[7]`, `runs[10:20]` and `runs[mask]`
    are the results of some runs.

    Attributes
    ----------
    scene : Scene
        Scene that was varied.
    parameters : mapping of name to (n,) float64
        Parameters of the runs.
    status : (n,) str
        ``converged``, or the reason of an early end (`fixel.kernels.codes.STATUS_NAMES`).
    time : (n_sample,) float64
        Times of the samples [s]; the last is the end.
    pose : (n, n_sample, n_moving, 3) float64
        Poses of the shape frames of free bodies, then pushers [m, m, rad]. The last pose of a
        run that stopped early is repeated.
    stopped_at : (n,) float64
        Time reached [s].
    steps, fallbacks : (n,) int64
        Number of steps, and of those that needed another solver.
    max_residual : (n,) float64
        Worst residual of any step.
    force : (n, n_driven) float64
        Force on each pusher along its path at the end [N].
    peak_force : (n, n_driven) float64
        Largest such force at the samples [N]; those between two of them are not stored.
    stalled : (n, n_driven) bool
        Whether each pusher's drive stalled at the end.
    contacts : (n, n_moving, n_body) bool or None
        Whether two bodies touch at the end; None if contacts were not recorded.
    accuracy : (n,) str or None
        ``certified``, ``agreed`` or ``uncertain``, as `Accuracy.verdict`; None if not requested.
    apart : (n, 2) float64 or None
        Largest distance [m] and angle [rad] between the ends by two independent ways.
    parted_at : (n,) float64 or None
        Times from which the two ways differ [s], as `Accuracy.parted_at`; NaN if they do not.
    derivatives : mapping from name to (n, 3) float64, or None
        Derivatives of the last poses [m, m, rad] by each requested parameter or start coordinate;
        NaN where there are none.
    differentiable : (n,) bool or None
        Whether there are derivatives by all names; see `Simulation.derivatives`.
    version : str
        Version of fixel.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> runs = fixel.simulate_batch(pushed_square(), {"mu_pusher": [0.1, 0.2, 0.3]})
    >>> runs["part"].final.theta.shape
    (3,)
    >>> runs.touching("part", "finger")
    array([ True,  True,  True])
    >>> runs[2].parameters["mu_pusher"]
    array([0.3])
    """

    scene: Scene
    parameters: Mapping[str, FloatArray] = field(default_factory=dict)
    status: NDArray[np.str_]
    time: FloatArray
    pose: FloatArray
    stopped_at: FloatArray
    steps: IntArray
    fallbacks: IntArray
    max_residual: FloatArray
    force: FloatArray
    peak_force: FloatArray
    stalled: BoolArray
    contacts: BoolArray | None = None
    accuracy: NDArray[np.str_] | None = None
    apart: FloatArray | None = None
    parted_at: FloatArray | None = None
    derivatives: Mapping[str, FloatArray] | None = None
    differentiable: BoolArray | None = None
    version: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free bodies, then of the pushers, as in `pose`."""
        return self.scene.names[: len(self.scene.bodies) + len(self.scene.pushers)]

    @property
    def final(self) -> FloatArray:
        """Poses (n, n_moving, 3) at the end."""
        return self.pose[:, -1]

    @property
    def converged(self) -> BoolArray:
        """Whether each run reached its end, (n,) bool."""
        return np.equal(self.status, codes.STATUS_NAMES[codes.CONVERGED])

    @property
    def contact_mode(self) -> NDArray[np.str_]:
        """Contact mode (n,) at the end: a digit per fixel, 1 where a free body touches it."""
        free = [body.name for body in self.scene.bodies]
        touched = [
            np.any([self.touching(name, fixel.name) for name in free], axis=0)
            for fixel in self.scene.fixels
        ]
        digits = np.array(touched, dtype=np.int64).reshape(len(touched), len(self)).T
        return np.array(["".join(map(str, row)) for row in digits.tolist()], dtype=np.str_)

    def touching(self, a: str, b: str) -> BoolArray:
        """Return whether two bodies touch at the end of each run.

        Parameters
        ----------
        a, b : str
            Names of free bodies, pushers or fixels, in either order.

        Returns
        -------
        (n,) bool
            False where a run stopped early.
        """
        if self.contacts is None:
            raise InvalidInput("contacts", found="none recorded", expected="those of a batch")
        names = self.scene.names
        first, second = sorted(names.index(_known(name, names)) for name in (a, b))
        if first >= self.contacts.shape[1]:
            return np.zeros(len(self), dtype=np.bool_)
        return self.contacts[:, first, second]

    def meets(self, goal: Goal) -> BoolArray:
        """Return whether each run meets a goal, (n,) bool.

        A run that stopped early does not, unless its rigid pusher was jammed. Events are looked for
        at the sampled `times`; forces between them are not stored, so `ForceAbove` is rejected.
        """
        stalled = np.asarray(self.stalled.any(axis=1))
        tracks = {name: BodyTrack(self.pose[:, :, k], stalled) for k, name in enumerate(self.names)}
        jammed = np.equal(self.status, codes.STATUS_NAMES[codes.JAMMED])
        return np.asarray(as_goal(goal).met(self.scene, tracks) & (self.converged | jammed))

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, key: str | int | slice | ArrayLike) -> Any:
        """Return the poses of a body by its name, or the results of some runs."""
        if isinstance(key, str):
            place = self.names.index(_known(key, self.names))
            return BodyRuns(self.time, self.pose[:, :, place])
        if isinstance(key, int | np.integer):
            if not -len(self) <= key < len(self):
                raise IndexError(f"run {key} of {len(self)}")
            key = slice(int(key) % len(self), int(key) % len(self) + 1)
        index: Any = key if isinstance(key, slice) else np.asarray(key)
        values = {name: getattr(self, name) for name in PER_RUN}
        own: dict[str, Any] = {k: None if v is None else v[index] for k, v in values.items()}
        for name in ("parameters", "derivatives"):
            columns = getattr(self, name)
            own[name] = columns and {k: v[index] for k, v in columns.items()}
        return replace(self, **own)

    def _summary(self) -> Summary:
        n, n_sample = self.pose.shape[:2]
        varied = f", varying {', '.join(self.parameters)}" if self.parameters else ""
        counts = Counter(self.status.tolist()).most_common()
        notes = [
            f"{self.steps.sum()} steps, {self.fallbacks.sum()} fallbacks;"
            f" worst residual {np.max(self.max_residual, initial=0.0):.1e}"
        ]
        if self.accuracy is not None:
            verdicts = Counter(self.accuracy.tolist()).most_common()
            notes.append("accuracy: " + ", ".join(f"{count} {own}" for own, count in verdicts))
        if self.differentiable is not None:
            notes.append(f"derivatives of {self.differentiable.sum()} runs")
        tables = []
        if n and n_sample:
            unit, factor = _length_unit(self.final)
            shown = [
                (f"{body.name}, {axis} [{own}]", scale * self.final[:, k, j])
                for k, body in enumerate(self.scene.bodies[:MAX_BODIES])
                for j, (axis, own, scale) in enumerate(
                    (("x", unit, factor), ("y", unit, factor), ("angle", "deg", degrees(1.0)))
                )
            ]
            heads = [Column(head, "", ".2f") for head in ("5 %", "median", "95 %")]
            rows = [(head, *np.percentile(values, (5, 50, 95))) for head, values in shown]
            tables = [Table(("at the end", *heads), rows)]
        return Summary(
            f"BatchResult: {counted(n, 'run')}{varied};"
            f" {', '.join(f'{count} {name}' for name, count in counts)}",
            tables,
            notes,
            {"version": f"fixel {self.version}"},
        )

    def _data(self) -> Table:
        columns: list[Column] = [Column("run"), Column("status"), Column("stopped_at", "s")]
        values: list[Iterable[Any]] = [range(len(self)), self.status, self.stopped_at]
        for name, own in self.parameters.items():
            columns.append(Column(name))
            values.append(own)
        for k, body in enumerate(self.names):
            for j, axis in enumerate(POSE_NAMES):
                columns.append(Column(f"{body}_{axis}", "rad" if j == 2 else "m"))
                values.append(self.final[:, k, j])
        return Table(columns, zip(*values, strict=True))


_SHARED: Final = ("scene", "parameters", "time", "derivatives", "version")
PER_RUN: Final = tuple(own.name for own in fields(BatchResult) if own.name not in _SHARED)


def finite_track(simulation: Simulation, name: str, start: float = 0.0) -> Trajectory:
    """Return the poses of a body or pusher until the simulation ended, from a time [s] on."""
    pose = simulation.pose[name]
    known = np.isfinite(pose).all(axis=1)
    return Trajectory(time=start + simulation.time[known], pose=pose[known])


def _known(name: str, names: Sequence[str]) -> str:
    check_name("name", name, names)
    return name


def _length_unit(poses: FloatArray) -> tuple[str, float]:
    """Return the unit in which positions (..., 3) are shown, and its factor from metres."""
    known = poses[np.isfinite(poses).all(axis=-1)][..., :2]
    size = float(np.abs(known).max(initial=0.0))
    return ("um", 1e6) if 0.0 < size < 2e-3 else ("mm", 1e3)
