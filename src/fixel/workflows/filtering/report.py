"""Report of a filter run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from importlib.metadata import version
from math import degrees
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.database.project import Project
from fixel.drawing.chart import save_figure
from fixel.drawing.filtering import filter_figure
from fixel.filtering.particle_filter import ParticleFilter
from fixel.filtering.recorded import FilterRun, label_and_factor
from fixel.model import Provenance
from fixel.model.records import CalibrationRecord, FilterParameters, FilterRecord
from fixel.table import Column, Table
from fixel.workflows.analysis import Analysis, AnalysisReport, StoredAnswer
from fixel.workflows.sentences import origin_of

BELIEF_FAR: Final = 3.0  # times the camera's noise: a belief beyond it is worth a line
NOISE_FAR: Final = 1.5  # times the belief: ellipsoids are too small beyond it


def report_of(answer: FilterAnswer) -> AnalysisReport:
    """Return headline, warnings, tables and numbers of a run."""
    found, lost = answer.estimates, int(answer.estimates.recovered.sum())
    numbers = _numbers(answer)
    times = "{median:.3g} ms per frame (at most {max:.3g} ms)".format(**numbers["frame_ms"])
    pace = f"{found.real_time_factor:.3g} times real time"
    notes = [f"{found.options.n_particles} particles, {times}: {pace}"]
    notes += [f"lost the object in {lost} frames and was restarted there"] if lost else []
    notes += [] if answer.run_id is None else [f"stored as filter run {answer.run_id}"]
    return AnalysisReport(
        Analysis(
            kind="filter",
            title=f"Filter run of {found.experiment.key}",
            question={"experiment": found.experiment.key},
            headline=(origin_of(found.experiment), _input(found), *found.modes()),
            warnings=(*_misfit(found), *_noise(numbers["noise_ratio"])),
            tables=tuple(table for table in _tables(answer) if table.rows),
            notes=tuple(notes),
            numbers=numbers,
            calibrations=tuple(answer.calibrations),
            experiments=(answer.experiment_id,),
            seconds=float(found.busy.sum()),
        )
    )


def draw(answer: FilterAnswer, path: Path) -> None:
    """Draw a run into a file."""
    save_figure(lambda: filter_figure(answer.estimates), path)


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that most users need next."""
    found, again = done.result.estimates, done.again
    experiment = found.experiment
    if not done.drawn:
        return [*again, "--plot", f"{experiment.name.replace('/', '-')}-filter.png"]
    if found.occlusion is None:
        start, end = found.time[0], found.time[-1]
        third = (end - start) / 3.0
        return [*again, "--occlude", f"{start + third:.3g}:{end - third:.3g}"]
    values = dict(zip(found.prior.names, found.mean[-1], strict=True))
    excited = [name for name, known in found.excited.items() if known]
    settings = [word for name in excited for word in ("--set", f"{name}={values[name]:.3g}")]
    return ["compare", experiment.key, *settings]


def _numbers(answer: FilterAnswer) -> dict[str, Any]:
    """Return all results as plain values, for `--json`."""
    found, experiment = answer.estimates, answer.estimates.experiment
    misfit, surprise = found.misfit, found.surprise[1:][found.seen[1:]]
    position, angle = found.options.position_deviation, found.options.angle_deviation
    noises = (misfit.noise_m, position), (misfit.noise_rad, angle)
    return {
        "experiment": experiment.key,
        "experiment_id": answer.experiment_id,
        "filter_run_id": answer.run_id,
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
        "misfit": asdict(misfit) | {"ratio": misfit.ratio, "warns": misfit.warns},
        "noise_ratio": max(noise / assumed for noise, assumed in noises),
        "mean_surprise": surprise.mean() if len(surprise) else None,
        "calibrations": _compared(answer),
        "recovered_frames": int(found.recovered.sum()),
        "failed_particles": int(found.failed.sum()),
        "mean_ess": float(found.ess.mean()),
        "frame_ms": {
            "median": 1e3 * float(np.median(found.busy[1:])),
            "max": 1e3 * float(found.busy[1:].max()),
        },
        "real_time_factor": found.real_time_factor,
    }


def _compared(answer: FilterAnswer) -> dict[str, dict[str, dict[str, Any]]]:
    """Return value, interval and verdict by calibration id and parameter."""
    names = answer.estimates.prior.names
    return {
        str(number): {
            one.label: {name: getattr(one, name) for name in ("value", "low", "high", "verdict")}
            for one in record.estimates
            if one.label in names
        }
        for number, record in answer.calibrations.items()
    }


def _named(errors: tuple[float, float] | None) -> dict[str, float] | None:
    return None if errors is None else {"position_rms_m": errors[0], "angle_rms_rad": errors[1]}


def _misfit(found: FilterRun) -> list[str]:
    """Return how far the intervals of the result can be trusted."""
    misfit = found.misfit
    if misfit.ratio is None or not misfit.warns:
        return []
    lines = [
        f"model misfit: residuals of {1e3 * misfit.residual_m:.2g} mm and"
        f" {degrees(misfit.residual_rad):.2g} deg are {misfit.ratio:.2g} times the noise of"
        f" {1e3 * misfit.noise_m:.2g} mm and {degrees(misfit.noise_rad):.2g} deg"
        " (second differences of the measured poses).",
        "The model is wrong by more than the noise explains, so the values below are effective "
        "values.",
    ]
    believed = found.options.position_deviation / max(misfit.noise_m, 1e-12)
    if believed > BELIEF_FAR:
        lines.append(
            f"The filter assumes {believed:.2g} times the estimated camera noise; its intervals "
            "include the misfit only in this way."
        )
    return lines


def _noise(ratio: float) -> list[str]:
    if ratio < NOISE_FAR:
        return []
    return [
        f"The camera noise is {ratio:.2g} times the value that the filter assumes, so its "
        "intervals are too narrow. Set position_deviation and angle_deviation of ParticleFilter "
        "in Python."
    ]


def _input(found: FilterRun) -> str:
    hidden = "never hidden"
    if found.occlusion is not None:
        hidden = "hidden from {:g} to {:g} s".format(*found.occlusion)
    felt = "with tactile readings" if found.uses_tactile else "without tactile readings"
    first, last = found.time[0], found.time[-1]
    return f"{len(found.time)} frames from {first:.4g} to {last:.4g} s, {hidden}, {felt}"


def _tables(answer: FilterAnswer) -> Iterator[Table]:
    yield from answer.estimates.tables()
    rows: list[tuple[Any, ...]] = []
    for number, parameters in _compared(answer).items():
        for name, one in parameters.items():
            label, factor = label_and_factor(name)
            ends = ("open" if x is None else f"{factor * x:.3g}" for x in (one["low"], one["high"]))
            verdict = one["verdict"] or "not assessed"
            rows.append((f"calibration {number}", label, factor * one["value"], *ends, verdict))
    columns = ("of this experiment", "", Column("value", format=".3g"), "low", "high", "verdict")
    yield Table(columns, rows)


NAME: Final = "particle"  # name of the settings in the project
# Suffixes of the columns stored for every parameter.
ENDINGS: Final = ("", "_q05", "_q50", "_q95")


class FilterAnswer(NamedTuple):
    """Run of the filter on an experiment of a project."""

    experiment_id: int
    estimates: FilterRun
    run_id: int | None  # id of the run in the project; None if it was not stored
    # Calibrations of the project with the experiment as a member, by id.
    calibrations: Mapping[int, CalibrationRecord]


def store_run(project: Project, found: FilterRun, command: str = "") -> int:
    """Store a run of the filter and its settings, for an experiment of a project; return its id."""
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
