"""Simulated testbed that differs in known ways from the model to calibrate, and pushes on it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, NamedTuple, final, get_type_hints

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Channel,
    Disk,
    Experiment,
    Flag,
    PlannedExperiment,
    Polygon,
    Provenance,
    Pusher,
    Scene,
    Shape,
    Trajectory,
    fields,
)
from fixel.model.fields import whole
from fixel.model.probability import stream
from fixel.model.scene import check_push
from fixel.simulation import Simulation, simulate
from fixel.simulation.batch import simulate_batch
from fixel.simulation.simulate import fixel_version
from fixel.simulation.threads import cores
from fixel.testbed import imperfections
from fixel.typing import BoolArray, FloatArray, ProgressCallback

Ratio = Annotated[float, fields.Value(fields.positive)]  # of a true to a nominal value
NotNegative = Annotated[float, fields.Value(fields.non_negative)]
Share = Annotated[float, fields.Value(fields.fraction)]
TRUTH = "truth_"  # prefix of conditions that a real laboratory could not know


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedTestbed:
    """Simulated testbed that runs planned experiments and records them as the real one does.

    A ratio is true over nominal value. A spread is the standard deviation of the logarithm of a
    factor that is drawn for every run. Random values of a run depend on the seed and its name only.

    Parameters
    ----------
    seed : int
        Seed of the random numbers: of the plate and the undersides of the objects, which are the
        same in all runs, and of the runs.
    dataset : str
        Dataset of the experiments.
    support_friction, pusher_friction, fixel_friction : float
        Ratios of the coefficients of friction [-].
    support_spread, pusher_spread, fixel_spread : float
        Spreads of these coefficients from run to run [-].
    support_cells : int
        Approximate number of points that carry the object [-]; 0 for the planned support with its
        pressure.
    unevenness : float
        Standard deviation of the logarithm of the pressure at these points [-].
    centre_of_pressure : (float, float)
        Offset from the centre of mass, body axes [m]. Balance out of the plane would put it at the
        centre of mass; pushing above the plate moves it.
    centre_of_pressure_spread : float
        Standard deviation of either coordinate from run to run [m].
    plate_roughness : float
        Standard deviation of the logarithm of the plate's friction from place to place [-].
    plate_grain : float
        Distance over which that friction changes [m].
    uneven_table : float
        Standard deviation of the logarithm of loads from place to place [-]; 0 for a flat table.
    table_length : float
        Distance over which that load changes [m].
    table_seed : int
        Seed of the table, so that testbeds with other seeds can share it.
    size : float
        Ratio of the object's size, about the origin of its frame [-]. Above 1, an object that was
        planned to touch something does not fit.
    stall_force : float, optional
        Force at which the drive stalls [N]; None: as planned.
    ripple : float
        Amplitude of the actuator's speed, as a share of it [-].
    ripple_frequency : float
        Frequency of the ripple [Hz]; one per turn of a 5 mm screw at the thesis's 13.5 mm/s.
    speed_spread : float
        Spread of the actuator's speed from run to run [-].
    lead_in : float
        Time at rest before the actuator starts, to the nearest frame [s].
    frame_rate : float
        Rate of camera and fixels [Hz].
    position_noise, angle_noise : float
        Standard deviations of a measured pose, in each coordinate [m] and in angle [rad].
    dropped_frames : float
        Probability that a frame of the camera is lost [-].
    false_contact, missed_contact : float
        Probabilities that a fixel reads 1 without contact, and 0 with it [-]; as measured on the
        laboratory's own fixels.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> planned = [fixel.PlannedExperiment(name="push", scene=pushed_square(0.5))]
    >>> [recorded.key for recorded in fixel.SimulatedTestbed(seed=4).run(planned)]
    ['testbed/push']
    """

    seed: int = 1
    dataset: str = "testbed"
    support_friction: Ratio = 1.1
    pusher_friction: Ratio = 1.3
    fixel_friction: Ratio = 0.75
    support_spread: NotNegative = 0.05
    pusher_spread: NotNegative = 0.03
    fixel_spread: NotNegative = 0.03
    support_cells: int = 24
    unevenness: NotNegative = 0.3
    centre_of_pressure: tuple[float, float] = (0.004, -0.003)
    centre_of_pressure_spread: NotNegative = 0.0005
    plate_roughness: NotNegative = 0.1
    plate_grain: Annotated[float, fields.Value(fields.positive, "m")] = 0.06
    uneven_table: NotNegative = 0.0
    table_length: Annotated[float, fields.Value(fields.positive, "m")] = 0.05
    table_seed: int = 1
    size: Ratio = 0.998
    stall_force: Annotated[float | None, fields.Value(fields.positive, "N")] = 34.3
    ripple: Share = 0.05
    ripple_frequency: Annotated[float, fields.Value(fields.positive, "Hz")] = 2.7
    speed_spread: NotNegative = 0.01
    lead_in: NotNegative = 0.0
    frame_rate: Annotated[float, fields.Value(fields.positive, "Hz")] = 30.0
    position_noise: NotNegative = 5e-5
    angle_noise: NotNegative = 0.002
    dropped_frames: Share = 0.01
    false_contact: Share = 0.0425
    missed_contact: Share = 0.0125

    def __post_init__(self) -> None:
        fields.name_of(self.dataset, "testbed.dataset")
        for name in ("seed", "table_seed", "support_cells"):
            whole(getattr(self, name), f"testbed.{name}", 0)
        if 0 < self.support_cells < 4:
            expected = "at least 4 cells, or 0 for the support as planned"
            raise InvalidInput("testbed.support_cells", found=self.support_cells, expected=expected)
        fields.check_fields(self, "testbed")
        centre = fields.vector(
            self.centre_of_pressure, "testbed.centre_of_pressure", "x [m], y [m]"
        )
        fields.settle(self, centre_of_pressure=(float(centre[0]), float(centre[1])))

    @classmethod
    def ideal(cls, seed: int = 1) -> SimulatedTestbed:
        """Return a testbed without imperfections: the nominal model with a perfect camera."""
        usual = {Ratio: 1.0, NotNegative: 0.0, Share: 0.0}
        hints = get_type_hints(cls, include_extras=True)
        values: Any = {name: usual[hint] for name, hint in hints.items() if hint in usual}
        return cls(
            seed=seed, support_cells=0, centre_of_pressure=(0.0, 0.0), stall_force=None, **values
        )

    def run(
        self,
        planned: Sequence[PlannedExperiment],
        progress: ProgressCallback | None = None,
        threads: int | None = None,
    ) -> Iterator[Experiment]:
        """Run planned experiments and yield the results in their order.

        Parameters
        ----------
        planned : sequence of PlannedExperiment
            Plans, each with a different name.
        progress : callable, optional
            Called as `progress(done, total)` after every experiment.
        threads : int, optional
            Number of threads; all cores by default. Results are bit for bit the same for any.

        Yields
        ------
        Experiment
            Simulated experiment with the planned scene; conditions `truth_...` are the true values.

        Raises
        ------
        InvalidInput
            A name occurs twice, or a scene is no push of one body; raised before anything runs.
            With the true values, a body cannot be placed or carried; raised at its turn.
        """
        planned = tuple(planned)
        _check_plan(planned)
        if threads is not None:
            whole(threads, "threads")
        return self._run_all(planned, progress, threads or cores())

    def _run_all(
        self, planned: Sequence[PlannedExperiment], progress: ProgressCallback | None, threads: int
    ) -> Iterator[Experiment]:
        with ThreadPoolExecutor(threads) as pool:
            runs = [pool.submit(self._run_one, item) for item in planned]
            try:
                for done, run in enumerate(runs, 1):
                    experiment = run.result()
                    if progress is not None:
                        progress(done, len(runs))
                    yield experiment
            finally:  # also where the caller stops early
                pool.shutdown(cancel_futures=True)

    def _run_one(self, planned: PlannedExperiment) -> Experiment:
        try:
            scene = self.true_scene(planned)
        except InvalidInput as problem:
            raise problem.within(f"planned {planned.name!r}") from None
        simulation = simulate(scene, output_interval=1.0 / self.frame_rate)
        return self._recorded(planned, simulation)

    def true_scene(self, planned: PlannedExperiment) -> Scene:
        """Return the scene with the true values that a run of this plan has."""
        scene, drawn = planned.scene, self._draw(planned.name)
        rough = self.seed, self.plate_roughness, self.plate_grain
        uneven = self.table_seed, self.uneven_table, self.table_length
        plane = imperfections.rough_plane(scene.plane, *rough)
        plane = imperfections.uneven_table(plane, *uneven)
        return replace(
            scene,
            bodies=(self._true_body(scene.bodies[0], scene.gravity, drawn),),
            pushers=(self._true_pusher(scene.pushers[0], scene.duration, drawn),),
            fixels=tuple(
                replace(fixel, friction=fixel.friction * drawn.fixel) for fixel in scene.fixels
            ),
            plane=plane,
        )

    def _draw(self, name: str) -> _RunConditions:
        rng = stream(self.seed, "run", name)
        # All are always drawn, so that no setting changes the random value of another.
        support, pusher, fixel, speed, x, y = rng.standard_normal(6)
        aside = self.centre_of_pressure_spread
        return _RunConditions(
            support=self.support_friction * math.exp(self.support_spread * support),
            pusher=self.pusher_friction * math.exp(self.pusher_spread * pusher),
            fixel=self.fixel_friction * math.exp(self.fixel_spread * fixel),
            speed=math.exp(self.speed_spread * speed),
            centre_x=self.centre_of_pressure[0] + aside * float(x),
            centre_y=self.centre_of_pressure[1] + aside * float(y),
            phase=float(rng.uniform(0.0, 2.0 * math.pi)),
        )

    def _true_body(self, body: Body, gravity: float, drawn: _RunConditions) -> Body:
        body = replace(body, shape=_scaled(body.shape, self.size))
        if self.support_cells == 0:
            return replace(body, support=imperfections.planned_support(body.support, drawn.support))
        support = imperfections.uneven_support(
            body,
            gravity,
            self.seed,
            friction_ratio=drawn.support,
            n_cells=self.support_cells,
            unevenness=self.unevenness,
            centre=(drawn.centre_x, drawn.centre_y),
        )
        return replace(body, support=support)

    def _true_pusher(self, pusher: Pusher, duration: float, drawn: _RunConditions) -> Pusher:
        drive: Any = pusher.drive
        if self.stall_force is not None:
            drive = replace(drive, force_limit=self.stall_force)
        return imperfections.driven_unevenly(
            replace(pusher, friction=pusher.friction * drawn.pusher, drive=drive),
            duration,
            speed_ratio=drawn.speed,
            ripple=self.ripple,
            frequency=self.ripple_frequency,
            phase=drawn.phase,
        )

    def _recorded(self, planned: PlannedExperiment, simulation: Simulation) -> Experiment:
        """Record a run: poses of the camera, readings of the fixels, and the true values."""
        scene = planned.scene
        rest = round(self.lead_in * self.frame_rate)
        moving = np.flatnonzero(imperfections.frames_of(simulation, self.frame_rate))
        frame = np.concatenate((np.zeros(rest, np.int64), moving))  # nothing moves before the drive
        time = np.arange(len(frame), dtype=np.float64) / self.frame_rate
        touches = imperfections.touching(simulation)[frame]
        camera = stream(self.seed, "camera", planned.name)
        kept = camera.random(len(time)) >= self.dropped_frames
        kept[[0, -1]] = True
        tracks = [
            Trajectory(
                time=time[kept],
                pose=imperfections.seen(
                    simulation.pose[name][frame], self.position_noise, self.angle_noise, camera
                )[kept],
            )
            for name in (scene.bodies[0].name, scene.pushers[0].name)
        ]
        return Experiment(
            dataset=self.dataset,
            name=planned.name,
            real=False,
            simulated_by=f"fixel simulated testbed {fixel_version()}, seed {self.seed}",
            provenance=Provenance(
                version=fixel_version(), command="SimulatedTestbed.run", seed=self.seed
            ),
            object_name=scene.bodies[0].name,
            trajectory=tracks[0],
            pusher=tracks[1],
            scene=scene,
            channels=self._channels(planned.name, time, touches),  # also of dropped frames
            contact_mode="".join(str(int(touch)) for touch in touches[-1]),
            effective=(float(time[rest]), float(time[-1])),
            conditions={**planned.conditions, **self._truth(planned.name, simulation)},
            flags=_flags(simulation),
        )

    def _channels(self, name: str, time: FloatArray, touches: BoolArray) -> tuple[Channel, ...]:
        if touches.shape[1] == 0:
            return ()
        rng = stream(self.seed, "tactile", name)
        felt = imperfections.felt(touches, self.false_contact, self.missed_contact, rng)
        return (Channel.of_fixels(time, felt),)

    def _truth(self, name: str, simulation: Simulation) -> dict[str, str | float]:
        """Return the true values of a run, under names that end with their unit."""
        drawn = self._draw(name)
        final = simulation.pose[simulation.scene.bodies[0].name][-1]
        stall = simulation.scene.pushers[0].drive.force_limit
        truth = {
            "support_friction_ratio": drawn.support,
            "pusher_friction_ratio": drawn.pusher,
            "fixel_friction_ratio": drawn.fixel,
            "size_ratio": self.size,
            "speed_ratio": drawn.speed,
            "ripple_ratio": self.ripple,
            "ripple_phase_rad": drawn.phase,
            "final_x_m": float(final[0]),
            "final_y_m": float(final[1]),
            "final_angle_rad": float(final[2]),
        }
        if self.support_cells:
            truth |= {
                "centre_of_pressure_x_m": drawn.centre_x,
                "centre_of_pressure_y_m": drawn.centre_y,
            }
        if simulation.stopped_at is not None:
            rest = round(self.lead_in * self.frame_rate) / self.frame_rate  # as recorded
            truth["stopped_at_s"] = rest + simulation.stopped_at
        if stall is not None:
            truth["stall_force_n"] = stall
        return {TRUTH + key: value for key, value in truth.items()}


class _RunConditions(NamedTuple):
    """Random values of one run: ratios [-], centre of pressure [m], phase [rad]."""

    support: float
    pusher: float
    fixel: float
    speed: float
    centre_x: float
    centre_y: float
    phase: float


def _flags(simulation: Simulation) -> tuple[Flag, ...]:
    if simulation.converged:
        return ()
    return (Flag("stopped-early", f"{simulation.status} at {simulation.stopped_at:.3f} s"),)


def _scaled(shape: Shape, ratio: float) -> Shape:
    """Scale a shape about the origin of its frame."""
    if ratio == 1.0:
        return shape
    if isinstance(shape, Disk):
        return Disk(shape.radius * ratio)
    return Polygon(shape.vertices * ratio)


def _check_plan(planned: Sequence[PlannedExperiment]) -> None:
    seen_names: set[str] = set()
    for index, item in enumerate(planned):
        fields.instance(item, PlannedExperiment, f"planned[{index}]", "a PlannedExperiment")
        _check_scene(item)
        if item.name in seen_names:
            expected = "unique names, since the random numbers of a run depend on its name"
            raise InvalidInput(
                f"planned[{index}]", found=f"the name {item.name!r} again", expected=expected
            )
        seen_names.add(item.name)


def _check_scene(planned: PlannedExperiment) -> None:
    where, scene = f"planned {planned.name!r}", planned.scene
    check_push(scene, where)
    if scene.contact_friction:
        expected = "friction of pusher and fixels only, for which the testbed has true values"
        raise InvalidInput(
            f"{where}.contact_friction", found="friction of named pairs", expected=expected
        )
    taken = [name for name in planned.conditions if name.startswith(TRUTH)]
    if taken:
        found, expected = repr(taken[0]), f"names that do not begin with {TRUTH!r}"
        raise InvalidInput(f"{where}.conditions", found=found, expected=expected)


LATE: Final = 1.1  # duration of a push over the planned one: slow drives also reach their end


class RepeatedPushes(NamedTuple):
    """n runs of the same pushes."""

    pose: FloatArray  # (n, n_push + 1, 3) true poses of the part: at the start, after each push
    way: FloatArray  # (n, n_push, n_sample, 3) those in each push, its end last
    force: FloatArray  # (n,) largest force of the drive at the samples of all pushes [N]
    stalled: BoolArray  # (n,) whether the drive is stalled at the end of the last push
    failure: tuple[str, ...]  # (n,) why a run could not be finished; empty for others
    scene: Scene  # true scene, with the true size of the part


def repeat_pushes(
    testbed: SimulatedTestbed,
    pushes: Sequence[Scene],
    starts: FloatArray,
    *,
    name: str = "trial",
    samples: int = 1,
    threads: int | None = None,
) -> RepeatedPushes:
    """Carry out pushes one after the other, without seeing the part, n times.

    Every run has its own conditions: friction, centre of pressure and speed, which do not change
    between its pushes. The plate and the underside of the part are the same in all runs.

    Scenes have the path of the tool; instead of the part's pose in the first, `starts` (n, 3) has
    its true poses [m, m, rad]. Trials of another name have other random conditions. Each push has
    poses at `samples` evenly spaced times. A run in which the tool would be put down on the part,
    or the part does not fit between fixels, ends before that push. Results are bit for bit the same
    for any number of threads. No push, no start, or a scene that is no push of one body raises
    `InvalidInput`.

    Examples
    --------
    >>> import numpy as np
    >>> from fixel.testbed.simulated import SimulatedTestbed
    >>> from fixel.testing.scenes import grasp
    >>> starts = np.tile(grasp().bodies[0].pose, (3, 1))
    >>> repeat_pushes(SimulatedTestbed(seed=4), [grasp()], starts, threads=1).stalled
    array([ True,  True,  True])
    """
    if not pushes or not len(starts):
        raise InvalidInput("pushes", found="none", expected="one push and one start at least")
    n = len(starts)
    pose = np.repeat(np.asarray(starts, np.float64)[:, None], len(pushes) + 1, axis=1)
    way = np.repeat(pose[:, 1:, None], samples, axis=2)
    force, stalled, failure = np.zeros(n), np.zeros(n, bool), [""] * n
    true = testbed.true_scene(PlannedExperiment(name=f"{name}-0", scene=pushes[0]))
    for k, push in enumerate(pushes):
        scenes, seconds = {}, LATE * push.duration
        for r in np.flatnonzero(np.equal(failure, "")).tolist():
            try:
                part = replace(push.bodies[0], pose=pose[r, k])
                scene = replace(push, bodies=(part,), duration=seconds)
                planned = PlannedExperiment(name=f"{name}-{r}", scene=scene)
                scenes[r] = testbed.true_scene(planned)
            except InvalidInput as problem:
                failure[r] = f"push {k + 1} cannot begin: {problem}"
        times = seconds * np.arange(1, samples + 1) / samples
        done = simulate_batch(list(scenes.values()), times=times, threads=threads)
        for r, run in zip(scenes, done, strict=True):
            way[r, k], pose[r, k + 1 :] = run.pose[0, :, 0], run.pose[0, -1, 0]
            way[r, k + 1 :] = pose[r, k + 1]
            force[r], stalled[r] = max(force[r], run.peak_force[0, 0]), run.stalled[0, 0]
            failure[r] = "" if run.converged[0] else f"{run.status[0]} in push {k + 1}"
    return RepeatedPushes(pose, way, force, stalled, tuple(failure), true)
