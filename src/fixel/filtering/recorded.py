"""A filter run over a recorded experiment, as if it went on now, and its model misfit."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Final, final

import numpy as np

from fixel.calibration.noise import WARNED, noise_from_differences
from fixel.calibration.target import Target, scene_of
from fixel.errors import InvalidInput
from fixel.filtering.head_path import smoothed
from fixel.filtering.particle_filter import ParticleFilter, UniformPrior
from fixel.filtering.running import FilterEstimate, FilterFrame, RunningFilter, start_filter
from fixel.model import Experiment, Scene, Trajectory, pose_error, wrapped
from fixel.model.shape import length_scale
from fixel.results import Result, Summary
from fixel.simulation import StewartTrinkle, simulate_batch
from fixel.simulation.rollouts import RolloutCase
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray, IntArray, ProgressCallback

SAME_INSTANT: Final = 1e-6  # [s]; clocks of two sensors are the same frames, rounded differently
DRAWS: Final = 400  # of the parameters at the end
TACTILE: Final = "tactile"  # the channel of the fixels


@final
@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class FilterRun(Result):
    """Estimates of a filter for a recorded experiment, frame by frame.

    Made by `fixel.filter`.

    Attributes
    ----------
    experiment : Experiment
    options : ParticleFilter
    seed : int
    prior : UniformPrior
        Prior, as it applied to the scene.
    occlusion : (float, float) or None
        First and last instant in which the object was hidden [s].
    uses_tactile : bool
        Whether tactile readings were used; False if there were none.
    time : (n,) float64
        [s]
    pose : (n, 3) float64
        [m, m, rad]
    covariance : (n, 3, 3) float64
    mean : (n, n_name) float64
        Means of the parameters of `prior`.
    quantiles : (n, n_name, 3) float64
        Quantiles of the parameters at 5, 50 and 95 %.
    touch : (n, n_fixel) float64
        Probability that the object touches each fixel [-].
    ess : (n,) float64
    failed : (n,) int64
        Particles that could not be simulated.
    surprise : (n,) float64
        See `FilterEstimate.surprise`.
    seen, recovered : (n,) bool
        Whether the camera saw the object, and whether the filter had lost it.
    draws : (n_draw, n_name) float64
        Parameters of the particles at the end, drawn in proportion to their weights.
    misfit : FilterMisfit
        Distance of the model alone from the measured poses.
    busy : (n,) float64
        Wall time of each frame [s]; only this differs between equal runs.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import fixel
    >>> from fixel.model import PlannedExperiment
    >>> from fixel.testbed.simulated import SimulatedTestbed
    >>> from fixel.testing.scenes import grasp
    >>> planned = PlannedExperiment(name="grasp", scene=replace(grasp("seated"), duration=1.0))
    >>> (experiment,) = SimulatedTestbed.ideal(seed=1).run([planned])
    >>> run = fixel.filter(experiment, particles=10, progress=False)
    >>> run.pose.shape == (len(run.time), 3)
    True
    """

    experiment: Experiment
    options: ParticleFilter
    seed: int
    prior: UniformPrior
    occlusion: tuple[float, float] | None
    uses_tactile: bool
    time: FloatArray
    pose: FloatArray
    covariance: FloatArray
    mean: FloatArray
    quantiles: FloatArray
    touch: FloatArray
    ess: FloatArray
    failed: IntArray
    surprise: FloatArray
    seen: BoolArray
    recovered: BoolArray
    draws: FloatArray
    misfit: FilterMisfit
    busy: FloatArray = field(compare=False)

    @property
    def trajectory(self) -> Trajectory:
        """Estimated poses of the object."""
        return Trajectory(time=self.time, pose=self.pose)

    @property
    def hidden(self) -> BoolArray:
        """Whether each frame lies in the occlusion, (n,) bool."""
        return _within(self.time, self.occlusion)

    @property
    def contact_mode(self) -> str:
        """Contact mode at the end, one digit per fixel: 1 if it is probably touched."""
        return "".join(str(int(probability > 0.5)) for probability in self.touch[-1])

    @property
    def real_time_factor(self) -> float:
        """Recorded time divided by the time that filtering took [-]."""
        return float((self.time[-1] - self.time[0]) / max(float(self.busy.sum()), 1e-12))

    @property
    def excited(self) -> dict[str, bool]:
        """Whether the run has informed each parameter, by name."""
        low, _, high = self.quantiles[-1].T
        return dict(zip(self.prior.names, self.prior.excited(low, high).tolist(), strict=True))

    @property
    def at_bound(self) -> dict[str, bool]:
        """By parameter, whether its interval ends at a bound of its prior, so that the bound and
        not the run may have decided it."""
        low, _, high = self.quantiles[-1].T
        near = zip(self.excited.items(), self.prior.touched(low, high).tolist(), strict=True)
        return {name: excited and touched for (name, excited), touched in near}

    @property
    def parameters(self) -> dict[str, dict[str, float | bool]]:
        """Estimates at the end, by name: mean, quantiles, and whether the run informs them [SI]."""
        keys = ("mean", "q05", "q50", "q95")
        numbers = np.column_stack((self.mean[-1], self.quantiles[-1])).tolist()
        excited, bound = self.excited, self.at_bound
        return {
            name: dict(zip(keys, row, strict=True))
            | {"excited": excited[name], "at_bound": bound[name]}
            for name, row in zip(self.prior.names, numbers, strict=True)
        }

    def rms(self, hidden: bool) -> tuple[float, float] | None:
        """Root mean square errors [m, rad] inside or outside the occlusion; None without poses."""
        position, angle, inside = self.errors(self.experiment.trajectory)
        wanted = inside == hidden
        if not wanted.any():
            return None
        return _rms(position[wanted]), _rms(angle[wanted])

    def tables(self) -> list[Table]:
        """Return the errors, and the estimates at the end with a remark on each."""
        found = {"while seen": self.rms(hidden=False), "while hidden": self.rms(hidden=True)}
        errors = [(k, 1e3 * e[0], math.degrees(e[1])) for k, e in found.items() if e is not None]
        head = ("error, rms", Column("position", "mm", ".3f"), Column("angle", "deg", ".3f"))
        numbers = (Column(name, format=".3g") for name in ("mean", "5 %", "95 %"))
        rows = []
        for name, own in self.parameters.items():
            remark = "" if own["excited"] else "not excited: about the same as the prior"
            if own["at_bound"]:
                remark = "at the bound of its prior: use a wider one"
            label, factor = label_and_factor(name)
            rows.append((label, *(factor * own[key] for key in ("mean", "q05", "q95")), remark))
        return [Table(head, errors), Table(("at the end", *numbers, ""), rows)]

    def modes(self) -> list[str]:
        """Return a sentence on the contact modes at the end; none without fixels."""
        if self.touch.shape[1] == 0:
            return []
        measured, estimated = self.experiment.contact_mode, self.contact_mode
        verdict = "" if not measured else ", the same" if measured == estimated else ", different"
        what = "measured" if self.experiment.real else "recorded"
        return [f"contact mode, {what} {measured or 'unknown'}, estimated {estimated}{verdict}"]

    def _summary(self) -> Summary:
        notes = self.modes()
        if self.misfit.warns and self.misfit.ratio is not None:
            notes.append(f"misfit: residuals are {self.misfit.ratio:.2g} times the noise")
        return Summary(
            f"FilterRun of {self.experiment.key}: {len(self.time)} frames,"
            f" {self.options.n_particles} particles ({self.options.motion.name})",
            [table for table in self.tables() if table.rows],
            notes,
            {
                "seed": str(self.seed),
                "tactile readings": "used" if self.uses_tactile else "not used",
            },
        )

    def _data(self) -> Table:
        """Estimated pose and parameters, one row per frame."""
        names = [f"{name}{end}" for name in self.prior.names for end in ("", "_q05", "_q95")]
        values = np.stack((self.mean, self.quantiles[:, :, 0], self.quantiles[:, :, 2]), axis=2)
        columns = [Column("time", "s"), Column("x", "m"), Column("y", "m"), Column("theta", "rad")]
        table = np.column_stack((self.time, self.pose, values.reshape(len(self.time), -1)))
        return Table((*columns, *names), table.tolist())

    def errors(self, measured: Trajectory) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Distance [m] and angle [rad] to the measured poses, and which of them were hidden.

        The first frame is left out: there the filter is given the pose.
        """
        kept = (measured.time > self.time[0] + SAME_INSTANT) & (
            measured.time <= self.time[-1] + SAME_INSTANT
        )
        instants = measured.time[kept]
        position, angle = pose_error(self.trajectory.at(instants), measured.pose[kept])
        return position, angle, _within(instants, self.occlusion)


def run_filter(
    experiment: Experiment,
    options: ParticleFilter | None = None,
    *,
    occlusion: tuple[float, float] | None = None,
    use_tactile: bool = True,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> FilterRun:
    """Filter a recorded experiment, frame by frame from its first useful one on.

    The arguments are those of `fixel.filter`; `progress(done, total)` is called after every frame.
    """
    options = options or ParticleFilter()
    scene = scene_of(experiment)
    frames = _frames(experiment, scene, use_tactile, occlusion)
    running = start_filter(
        options, scene, seed, pose=frames[0].seen, pusher=frames[0].pusher, time=frames[0].time
    )
    estimates, busy, span = [running.estimate], [0.0], (frames[0].time, frames[-1].time)
    for done, frame in enumerate(frames[1:], 2):
        begun = time.perf_counter()
        estimates.append(running.step(frame))
        busy.append(time.perf_counter() - begun)
        if progress is not None:
            progress(done, len(frames))
    return _gathered(
        estimates,
        experiment=experiment,
        options=options,
        seed=seed,
        prior=running.prior,
        occlusion=occlusion,
        uses_tactile=any(frame.touches is not None for frame in frames),
        draws=running.draws(DRAWS),
        misfit=misfit_of(
            running, during(experiment.trajectory, span), during(_pusher(experiment), span), seed
        ),
        seen=np.array([frame.seen is not None for frame in frames]),
        busy=np.array(busy),
    )


def label_and_factor(name: str) -> tuple[str, float]:
    """Return the name of a parameter with its unit for display, and the factor to that unit."""
    return (f"{name} [mm]", 1e3) if name == "tripod_radius" else (name, 1.0)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def during(track: Trajectory, interval: tuple[float, float]) -> Trajectory:
    """Return the part of a measured path within an interval [s]."""
    kept = _within(track.time, interval)
    return Trajectory(time=track.time[kept], pose=track.pose[kept])


def _gathered(estimates: list[FilterEstimate], **rest: object) -> FilterRun:
    columns = {
        name: np.array([getattr(estimate, name) for estimate in estimates])
        for name in FilterEstimate._fields
        if name != "names"
    }
    return FilterRun(**columns, **rest)  # type: ignore[arg-type]


def _frames(
    experiment: Experiment, scene: Scene, use_tactile: bool, occlusion: tuple[float, float] | None
) -> list[FilterFrame]:
    """Return the frames that a filter receives, in order. The first one always sees the object."""
    track, pusher = experiment.trajectory, _pusher(experiment)
    first, last = experiment.effective or (track.time[0], track.time[-1])
    first = max(float(first), float(track.time[0]))
    instants = _instants(track, pusher, first, min(float(last), float(pusher.time[-1])))
    if len(instants) < 2:
        found = f"{len(instants)} measured instants from {first:g} to {last:g} s"
        expected = "at least two, of object and pusher"
        raise InvalidInput(f"experiment {experiment.key}.effective", found=found, expected=expected)
    occlusion = _checked_occlusion(experiment, occlusion, instants)
    hidden = _within(instants, occlusion)
    nearest = np.abs(track.time[:, None] - instants).argmin(axis=0)
    in_view = np.abs(track.time[nearest] - instants) < SAME_INSTANT
    touches = _touches(experiment, scene, instants) if use_tactile else [None] * len(instants)
    driven = pusher.at(instants)
    frames = [
        FilterFrame(
            float(instant),
            driven[k],
            track.pose[nearest[k]] if in_view[k] and not hidden[k] else None,
            touches[k],
        )
        for k, instant in enumerate(instants)
    ]
    # Somebody put the object there and knows where, even if the camera is blind from the start.
    frames[0] = frames[0]._replace(seen=track.at(instants[0]))
    return frames


def _pusher(experiment: Experiment) -> Trajectory:
    if experiment.pusher is None:
        raise InvalidInput(
            f"experiment {experiment.key}.pusher",
            found="no measured path of the pusher",
            expected="a path of the pusher on the clock of the experiment",
            hint="fixel compare simulates the planned motion",
        )
    return experiment.pusher


def _instants(track: Trajectory, pusher: Trajectory, first: float, last: float) -> FloatArray:
    """(n,) instants at which the object or the pusher was measured [s]."""
    every = np.sort(np.concatenate((track.time, pusher.time)))
    every = every[(every >= first - SAME_INSTANT) & (every <= last + SAME_INSTANT)]
    if len(every) == 0:
        return every
    return every[np.concatenate(([True], np.diff(every) > SAME_INSTANT))]


def _checked_occlusion(
    experiment: Experiment, occlusion: tuple[float, float] | None, instants: FloatArray
) -> tuple[float, float] | None:
    if occlusion is None:
        return None
    start, end = occlusion
    first, last = float(instants[0]), float(instants[-1])
    if not first <= start < end <= last + SAME_INSTANT:
        raise InvalidInput(
            f"experiment {experiment.key}, occlusion",
            found=f"{start:g} to {end:g} s",
            expected=f"an interval within the recording, {first:g} to {last:g} s",
        )
    return start, end


def _within(instants: FloatArray, interval: tuple[float, float] | None) -> BoolArray:
    if interval is None:
        return np.zeros(len(instants), np.bool_)
    start, end = interval
    return np.asarray((instants >= start - SAME_INSTANT) & (instants <= end + SAME_INSTANT))


def _touches(experiment: Experiment, scene: Scene, instants: FloatArray) -> list[FloatArray | None]:
    """The last readings of the fixels since the frame before; None where there are none."""
    channel = experiment.channel(TACTILE)
    if channel is None or not scene.fixels:
        return [None] * len(instants)
    if len(channel.columns) != len(scene.fixels):
        raise InvalidInput(
            f"experiment {experiment.key}, channel {TACTILE!r}",
            found=f"{len(channel.columns)} columns",
            expected=f"{len(scene.fixels)}, one per fixel",
            hint="filter without tactile readings: tactile=False",
        )
    upto = np.searchsorted(channel.time, instants + SAME_INSTANT)
    fresh = np.diff(upto, prepend=0) > 0
    readings = np.where(np.isnan(channel.values), np.nan, channel.values > 0.5)
    return [readings[k - 1] if new else None for k, new in zip(upto, fresh, strict=True)]


TRIES: Final = 64  # simulations, of which the best counts
STEP: Final = 5e-4  # [m] of the pusher's way in one step of these simulations
KNOWN: Final = 1e-9  # [m], [rad]: deviations below it say that the noise is not known


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterMisfit:
    """Residuals of a simulation without correction by the camera, and the noise of the camera."""

    # Root mean square in either coordinate and in angle, of the best of 64 simulations.
    residual_m: float
    residual_rad: float
    # Standard deviations of the measured poses, from second differences; zero where unknown.
    noise_m: float
    noise_rad: float

    @property
    def ratio(self) -> float | None:
        """Residual over noise, the larger of position and angle [-]; None without noise."""
        pairs = ((self.residual_m, self.noise_m), (self.residual_rad, self.noise_rad))
        known = [residual / noise for residual, noise in pairs if noise > KNOWN]
        return max(known, default=None)

    @property
    def warns(self) -> bool:
        """Whether the model is wrong by more than the noise explains."""
        return self.ratio is not None and self.ratio >= WARNED


def noise_of(scene: Scene, track: Trajectory) -> FloatArray:
    """Return standard deviations (2,) of white noise [m, rad]; zeros if unknown."""
    if len(track.time) < 2:
        return np.zeros(2)
    case = RolloutCase(scene, track.time[1:] - track.time[0])
    found = noise_from_differences([Target("", {}, case, track.pose[1:])])
    return np.zeros(2) if found is None else np.array([found.position_m, found.angle_rad])


def misfit_of(
    running: RunningFilter, track: Trajectory, pusher: Trajectory, seed: int
) -> FilterMisfit:
    """Measure the misfit of a filter's scene with the parameters at the end of its run.

    The tracks of the object and of the pusher were measured over that run.
    """
    random = np.random.default_rng([seed, 1])
    noise = noise_of(running.scene, track)
    _, values, weight = running.particles
    drawn = values[random.choice(len(values), TRIES, p=weight)]
    start = track.pose[0] + random.standard_normal((TRIES, 3)) * noise[[0, 0, 1]]
    clock = pusher.time - track.time[0]
    path, _ = smoothed(clock, pusher.pose)
    inside = clock > 0.0
    waypoints = np.column_stack((clock, path))[inside]
    first = [0.0, *Trajectory(time=clock, pose=path).at(max(0.0, float(clock[0])))]
    waypoints = np.concatenate(([first], waypoints))
    moments = track.time[1:] - track.time[0]
    duration = float(moments[-1])
    way = float(np.sum(np.hypot(*np.diff(waypoints[:, 1:3], axis=0).T)))
    step = length_scale(running.scene.bodies[0].shape) * STEP
    steps = max(len(moments), math.ceil(way / step))
    result = simulate_batch(
        running.scene,
        running.prior.columns(drawn) or None,
        start=start,
        waypoints=np.broadcast_to(waypoints, (TRIES, *waypoints.shape)),
        motion=running.options.motion,
        stepper=StewartTrinkle(step=duration / steps),
        duration=duration,
        times=moments,
        threads=running.options.threads,
    )
    away = result.pose[:, :, 0] - track.pose[1:]
    position = np.sqrt(0.5 * np.mean(np.sum(away[:, :, :2] ** 2, axis=2), axis=1))
    angle = np.sqrt(np.mean(wrapped(away[:, :, 2]) ** 2, axis=1))
    scale = np.where(noise > KNOWN, noise, 1.0)
    best = int(np.argmin((position / scale[0]) ** 2 + (angle / scale[1]) ** 2))
    return FilterMisfit(
        residual_m=float(position[best]),
        residual_rad=float(angle[best]),
        noise_m=float(noise[0]),
        noise_rad=float(noise[1]),
    )
