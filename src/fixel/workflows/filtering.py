"""Filter a stored experiment, and store the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import Any, Final, final

import numpy as np

from fixel.database.project import Project
from fixel.filtering.particle_filter import ParticleFilter, check_count
from fixel.filtering.recorded import FilterRun, run_filter
from fixel.model import Experiment, Provenance
from fixel.model.records import CalibrationRecord, FilterParameters, FilterRecord
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.typing import FloatArray

NAME: Final = "particle"  # name of the settings in the project

# Suffixes of the columns stored for every parameter.
ENDINGS: Final = ("", "_q05", "_q50", "_q95")


def filter(
    experiment: Experiment,
    priors: Mapping[str, tuple[float, float] | None] | None = None,
    *,
    particles: int = 125,
    occlusion: tuple[float, float] | None = None,
    tactile: bool = True,
    motion: AbstractMotionModel | str | None = None,
    options: ParticleFilter | None = None,
    seed: int = 0,
    threads: int = 1,
    progress: ProgressOption = None,
) -> FilterRun:
    """Estimate pose and parameters during a recorded experiment with a particle filter.

    Parameters
    ----------
    experiment : Experiment
        Experiment with a scene and the measured path of its pusher.
    priors : mapping of str to (float, float) or None, optional
        Uniform priors of parameters [SI], in addition to the usual ones; None leaves a parameter
        at the value of the scene.
    particles : int
        Number of particles, at least 2.
    occlusion : (float, float), optional
        First and last instant at which the object is hidden from the filter [s].
    tactile : bool
        Whether to use the readings of the fixels, if there are any.
    motion : AbstractMotionModel or str, optional
        `"quasistatic"` (default) or `"first-order"`.
    options : ParticleFilter, optional
        All other settings, such as the noise of the camera; `priors`, `particles`, `motion` and
        `threads` are then taken from it.
    seed : int
        Seed of the random numbers.
    threads : int
        Number of threads of the simulation. Results are the same for any number.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    FilterRun
        Pose, parameters and contacts of every frame, with their uncertainty.

    Raises
    ------
    InvalidInput
        There is no scene or no measured path of the pusher, the occlusion lies outside the
        recording, or a prior does not fit the scene.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import fixel
    >>> from fixel.model import PlannedExperiment
    >>> from fixel.testbed.simulated import SimulatedTestbed
    >>> from fixel.testing.scenes import grasp
    >>> planned = PlannedExperiment(name="grasp", scene=replace(grasp("seated"), duration=1.0))
    >>> (experiment,) = SimulatedTestbed.ideal(seed=1).run([planned])
    >>> found = fixel.filter(experiment, particles=10, progress=False)
    >>> sorted(found.parameters)
    ['mu_fixel', 'mu_pusher', 'mu_support', 'tripod_radius']
    """
    if options is None:
        check_count("particles", particles, 2)
        own: dict[str, Any] = {} if motion is None else {"motion": motion_model(motion)}
        options = ParticleFilter(n_particles=particles, priors=priors or {}, threads=threads, **own)
    with show_progress(progress, "filtering") as report:
        return run_filter(
            experiment,
            options,
            occlusion=occlusion,
            use_tactile=tactile,
            seed=seed,
            progress=report,
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FilterAnswer:
    """Result of filtering an experiment, with its measurement.

    Attributes
    ----------
    experiment_id : int
    estimates : FilterRun
    run_id : int or None
        Id of the run in the project; None if it was not stored.
    calibrations : mapping from int to CalibrationRecord
        Calibrations of the project with the experiment as a member, by id.
    """

    experiment_id: int
    estimates: FilterRun
    run_id: int | None = None
    calibrations: Mapping[int, CalibrationRecord] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return all results as plain values, for `--json`."""
        found, experiment = self.estimates, self.estimates.experiment
        return {
            "experiment": experiment.key,
            "experiment_id": self.experiment_id,
            "filter_run_id": self.run_id,
            "real": experiment.real,
            "particles": found.options.n_particles,
            "seed": found.seed,
            "frames": len(found.time),
            "from_s": float(found.time[0]),
            "to_s": float(found.time[-1]),
            "occlusion_s": None if found.occlusion is None else list(found.occlusion),
            "uses_tactile": found.uses_tactile,
            "seen": _named(found.rms(hidden=False)),
            "hidden": _named(found.rms(hidden=True)),
            "parameters": found.parameters,
            "contact_mode": {
                "measured": experiment.contact_mode,
                "estimated": found.contact_mode,
                "touch_probability": found.touch[-1].tolist(),
            },
            "misfit": {
                "residual_m": found.misfit.residual_m,
                "residual_rad": found.misfit.residual_rad,
                "noise_m": found.misfit.noise_m,
                "noise_rad": found.misfit.noise_rad,
                "ratio": found.misfit.ratio,
                "warns": found.misfit.warns,
            },
            "mean_surprise": _mean(found.surprise[1:][found.seen[1:]]),
            "calibrations": self.compared(),
            "recovered_frames": int(found.recovered.sum()),
            "failed_particles": int(found.failed.sum()),
            "mean_ess": float(found.ess.mean()),
            "frame_ms": {
                "median": 1e3 * float(np.median(found.busy[1:])),
                "max": 1e3 * float(found.busy.max()),
            },
            "real_time_factor": found.real_time_factor,
        }

    def compared(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Return value, interval and verdict by calibration id and parameter."""
        names = self.estimates.prior.names
        return {
            str(number): {
                one.label: {
                    "value": one.value,
                    "low": one.low,
                    "high": one.high,
                    "verdict": one.verdict,
                }
                for one in record.estimates
                if one.label in names
            }
            for number, record in self.calibrations.items()
        }


def store_run(project: Project, found: FilterRun, command: str = "") -> int:
    """Store a run of the filter and its settings in a project; return the id of the run.

    Raises
    ------
    NotStored
        The project has no such experiment.
    """
    with project.store() as store:
        experiment_id = store.find(found.experiment.key)
        settings = store.add_filter_parameters(_settings(found, command))
        return store.add_filter_run(_record(found, experiment_id, settings, command))


def _record(found: FilterRun, experiment_id: int, settings_id: int, command: str) -> FilterRecord:
    values = np.concatenate((found.mean[:, :, None], found.quantiles), axis=2)
    return FilterRecord(
        experiment_id=experiment_id,
        filter_parameters_id=settings_id,
        provenance=_provenance(found, command),
        trajectory=found.trajectory,
        uses_tactile=found.uses_tactile,
        occlusion=found.occlusion,
        contact_mode=found.contact_mode,
        estimate_names=tuple(n + ending for n in found.prior.names for ending in ENDINGS),
        estimates=values.reshape(len(values), -1),
    )


def _settings(found: FilterRun, command: str) -> FilterParameters:
    numbers = {
        name: float(value)
        for name in ParticleFilter.__dataclass_fields__
        if name != "threads" and isinstance(value := getattr(found.options, name), int | float)
    }
    prior = found.prior
    for name, low, high in zip(prior.names, prior.low, prior.high, strict=True):
        numbers |= {f"{name}_low": float(low), f"{name}_high": float(high)}
    return FilterParameters(
        name=f"{NAME}, {found.options.motion.name}",
        is_particle_filter=True,
        provenance=_provenance(found, command),
        values=numbers,
    )


def _provenance(found: FilterRun, command: str) -> Provenance:
    return Provenance(version=version("fixel"), command=command, seed=found.seed)


def _mean(values: FloatArray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _named(errors: tuple[float, float] | None) -> dict[str, float] | None:
    return None if errors is None else {"position_rms_m": errors[0], "angle_rms_rad": errors[1]}


def filter_experiment(
    project: Project,
    key: str,
    options: ParticleFilter | None = None,
    *,
    occlusion: tuple[float, float] | None = None,
    use_tactile: bool = True,
    seed: int = 0,
    save: bool = True,
    command: str = "",
    progress: ProgressOption = None,
) -> FilterAnswer:
    """Filter an experiment of a project and store the run.

    Parameters
    ----------
    project : Project
    key : str
        Id, name, or dataset/name.
    options : ParticleFilter, optional
    occlusion, use_tactile, seed, progress
        See `filter`.
    save : bool
        Whether to store the run and its settings in the project.
    command : str
        Command as typed.

    Raises
    ------
    NotStored
        There is no such experiment.
    InvalidInput
        The experiment cannot be filtered, or the occlusion is outside of it.
    """
    with project.store() as store:
        number = store.find(key)
        experiment = store.experiment(number)
        estimates = filter(
            experiment,
            options=options,
            occlusion=occlusion,
            tactile=use_tactile,
            seed=seed,
            progress=progress,
        )
        of_it = {
            key: record
            for key, record in store.calibration_summaries().items()
            if number in {member.experiment_id for member in record.members}
        }
        answer = FilterAnswer(experiment_id=number, estimates=estimates, calibrations=of_it)
    if not save:
        return answer
    return replace(answer, run_id=store_run(project, estimates, command))
