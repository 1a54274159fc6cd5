"""Filter a stored experiment, and store the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import Any, Final, final

import numpy as np

from fixel.database.project import Project
from fixel.filtering.particle_filter import ParticleFilter
from fixel.filtering.recorded import FilterEstimates, run_filter
from fixel.model import Experiment, Provenance
from fixel.model.records import CalibrationRecord, FilterParameters, FilterRun
from fixel.typing import FloatArray, ProgressCallback

NAME: Final = "particle"  # name of the settings in the project

# Suffixes of the columns stored for every parameter.
ENDINGS: Final = ("", "_q05", "_q50", "_q95")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FilterAnswer:
    """Result of filtering an experiment, with its measurement.

    Attributes
    ----------
    experiment_id : int
    experiment : Experiment
    estimates : FilterEstimates
    run_id : int or None
        Id of the run in the project; None if it was not stored.
    calibrations : mapping from int to CalibrationRecord
        Calibrations of the project with the experiment as a member, by id.
    """

    experiment_id: int
    experiment: Experiment
    estimates: FilterEstimates
    run_id: int | None = None
    calibrations: Mapping[int, CalibrationRecord] = field(default_factory=dict)

    def rms(self, hidden: bool) -> tuple[float, float] | None:
        """Root mean square errors [m, rad] inside or outside the occlusion; None without poses."""
        position, angle, inside = self.estimates.errors(self.experiment.trajectory)
        wanted = inside == hidden
        if not wanted.any():
            return None
        return _rms(position[wanted]), _rms(angle[wanted])

    def summary(self) -> dict[str, Any]:
        """Return all results as plain values, for `--json`."""
        found, experiment = self.estimates, self.experiment
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
            "seen": _named(self.rms(hidden=False)),
            "hidden": _named(self.rms(hidden=True)),
            "parameters": self._parameters(),
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

    def _parameters(self) -> dict[str, dict[str, float | bool]]:
        found = self.estimates
        rows = zip(found.prior.names, found.mean[-1], found.quantiles[-1], strict=True)
        return {
            name: {
                "mean": float(mean),
                "q05": float(low),
                "q50": float(middle),
                "q95": float(high),
                "excited": found.excited[name],
                "at_bound": found.at_bound[name],
            }
            for name, mean, (low, middle, high) in rows
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

    def record(self, filter_parameters_id: int, command: str = "") -> FilterRun:
        """Return the record of the run for a project; `command` is the command as typed."""
        found = self.estimates
        values = np.concatenate((found.mean[:, :, None], found.quantiles), axis=2)
        return FilterRun(
            experiment_id=self.experiment_id,
            filter_parameters_id=filter_parameters_id,
            provenance=_provenance(found, command),
            trajectory=found.trajectory,
            uses_tactile=found.uses_tactile,
            occlusion=found.occlusion,
            contact_mode=found.contact_mode,
            estimate_names=tuple(n + ending for n in found.prior.names for ending in ENDINGS),
            estimates=values.reshape(len(values), -1),
        )

    def settings(self, command: str = "") -> FilterParameters:
        """Return the record of the options for a project."""
        found = self.estimates
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


def _provenance(found: FilterEstimates, command: str) -> Provenance:
    return Provenance(version=version("fixel"), command=command, seed=found.seed)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


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
    progress: ProgressCallback | None = None,
) -> FilterAnswer:
    """Filter an experiment of a project and store the run.

    Parameters
    ----------
    project : Project
    key : str
        Id, name, or dataset/name.
    options : ParticleFilter, optional
    occlusion, use_tactile, seed, progress
        See `run_filter`.
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
        estimates = run_filter(
            experiment,
            options,
            occlusion=occlusion,
            use_tactile=use_tactile,
            seed=seed,
            progress=progress,
        )
        of_it = {
            key: record
            for key, record in store.calibration_summaries().items()
            if number in {member.experiment_id for member in record.members}
        }
        answer = FilterAnswer(
            experiment_id=number, experiment=experiment, estimates=estimates, calibrations=of_it
        )
        if not save:
            return answer
        settings = store.add_filter_parameters(answer.settings(command))
        run = store.add_filter_run(answer.record(settings, command))
    return replace(answer, run_id=run)
