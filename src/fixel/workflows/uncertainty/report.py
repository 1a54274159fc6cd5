"""Report of an uncertainty analysis, to store: sentences, tables and charts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from math import degrees
from typing import Any, Final

import numpy as np

from fixel.database.project import Project
from fixel.drawing.chart import readable
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.uncertainty.bands import PARTS
from fixel.uncertainty.discrepancy import LABEL
from fixel.workflows.analysis import Analysis, StoredAnalysis, keep, rounded
from fixel.workflows.calibration.detail import misfit_of
from fixel.workflows.uncertainty.charts import curves_of, pictures_of, what_of
from fixel.workflows.uncertainty.run import ExperimentPrediction, Uncertainty

_FEW: Final = "Few experiments cannot show how results vary: quote the calibration."
_SAME: Final = "The two allow for model error differently: quote the wider interval."
REFERENCES: Final = ("skilling2006", "feroz2009", "speagle2020", "kennedy2001")


def keep_uncertainty(project: Project, found: Uncertainty, command: str = "") -> StoredAnalysis:
    """Store the result in its project, with charts."""
    posterior = found.posterior
    analysis = Analysis(
        kind="uncertainty",
        title=f"Uncertainty of {what_of(found)}",
        question=_question(found),
        headline=tuple(_headline(found)),
        warnings=tuple(_warnings(found)),
        tables=tuple(_tables(found)),
        methods=tuple(_methods(found)),
        references=REFERENCES,
        numbers=numbers_of(found),
        calibrations=() if found.calibration is None else (found.calibration.id,),
        experiments=tuple(one.id for one in found.predicted),
        command=command,
        seed=found.request.seed,
        seconds=posterior.seconds,
    )
    arrays = {"samples": posterior.samples, "log_likelihood": posterior.log_likelihood}
    return keep(project, analysis, list(pictures_of(found)), arrays)


def numbers_of(found: Uncertainty) -> dict[str, Any]:
    """Return plain values in SI units, for `--json`."""
    posterior, request = found.posterior, found.request
    low, middle, high = posterior.quantiles()
    return {
        "experiments": [one.experiment.key for one in found.predicted if not one.held_out],
        "motion": found.motion,
        "noise": {
            "position_m": found.noise.position_m,
            "angle_rad": found.noise.angle_rad,
            "source": found.noise.source,
            "correlation": found.noise.correlation,
        },
        "model_error": request.model_error,
        "parameters": {
            label: {
                "unit": posterior.units[k],
                "low": float(low[k]),
                "median": float(middle[k]),
                "high": float(high[k]),
                "best": float(posterior.best[k]),
                "prior": [float(posterior.low[k]), float(posterior.high[k])],
            }
            for k, label in enumerate(posterior.labels)
        },
        "modes": [
            {"weight": mode.weight, "best": dict(zip(posterior.labels, mode.best.tolist(),
                                                     strict=True))}
            for mode in posterior.modes
        ],
        "log_evidence": posterior.log_evidence,
        "log_evidence_error": posterior.log_evidence_error,
        "effective_samples": posterior.effective,
        "information_nats": posterior.information,
        "evaluations": posterior.evaluations,
        "failed": posterior.failed,
        "seconds": posterior.seconds,
        "seed": posterior.seed,
        "final_pose": [_final(one) for one in found.predicted],
        "coverage": _coverage(found),
        "near_optimal": _near(found),
    }  # fmt: skip


def _final(one: ExperimentPrediction) -> dict[str, Any]:
    bounds = one.prediction.bounds(0.9)
    shares = one.prediction.shares
    return {
        "experiment": one.experiment.key,
        "held_out": one.held_out,
        "measured": one.target.pose[-1].tolist(),
        "centre_m": bounds.position.centre.tolist(),
        "radii_90_m": bounds.position.radii.tolist(),
        "turn_rad": bounds.position.angle,
        "angle_90_rad": list(bounds.angle),
        "level_of_position": one.levels[0],
        "level_of_angle": one.levels[1],
        "standard_deviations": {name: value.tolist() for name, value in shares.items()},
        "failed_draws": one.prediction.failed,
    }


def _coverage(found: Uncertainty) -> dict[str, Any] | None:
    both = curves_of(found)
    if both is None:
        return None
    position, angle = both
    return {
        "levels": position.levels.tolist(),
        "position_held": position.held.tolist(),
        "angle_held": angle.held.tolist(),
        "outcomes": position.outcomes,
    }


def _near(found: Uncertainty) -> dict[str, Any] | None:
    near = found.near
    if near is None:
        return None
    return {
        "least_mm2": near.least,
        "rise_mm2": near.rise,
        "evaluations": near.size,
        "low": dict(zip(found.near_names, near.low.tolist(), strict=True)),
        "high": dict(zip(found.near_names, near.high.tolist(), strict=True)),
        "clusters": [
            {"size": c.size, "best": dict(zip(found.near_names, c.point.tolist(), strict=True))}
            for c in near.clusters
        ],
    }


# --- sentences ------------------------------------------------------------------------------------


def _question(found: Uncertainty) -> dict[str, Any]:
    request = found.request
    return {
        "experiments": list(request.experiments),
        "held_out": list(request.held_out),
        "calibration": request.calibration,
        "fit": list(request.fit),
        "motion": found.motion,
        "noise": None if request.noise is None else list(request.noise),
        "model_error": request.model_error,
        "samples": request.samples,
        "seed": request.seed,
    }


def _headline(found: Uncertainty) -> Iterator[str]:
    posterior = found.posterior
    first = found.predicted[0]
    bounds = first.prediction.bounds(0.9)
    wide = degrees(bounds.angle[1] - bounds.angle[0])
    a, b = (2e3 * bounds.position.radii).tolist()
    yield (
        f"Done again, {first.experiment.key} ends with 90 % probability in an ellipse of {a:.3g} by"
        f" {b:.3g} mm and within {wide:.3g} degrees."
    )
    shares = first.prediction.shares
    size = {name: float(np.hypot(*shares[name][:2])) for name in PARTS}
    most = max(size, key=lambda name: size[name])
    yield f"Most of the spread of the final position comes from {_MEANT[most]}."
    if len(posterior.modes) > 1:
        parts = ", ".join(f"{100.0 * mode.weight:.0f} %" for mode in posterior.modes)
        yield f"{len(posterior.modes)} separate sets of values explain the data ({parts})."
    if LABEL in posterior.labels:
        k = posterior.labels.index(LABEL)
        low, middle, high = (1e3 * posterior.quantiles()[:, k]).tolist()
        yield (
            f"The model's own error at the end of the way is {middle:.3g} mm (95 %: {low:.3g} to"
            f" {high:.3g} mm)."
        )
    both = curves_of(found)
    if both is not None:
        at = int(np.argmin(np.abs(both[0].levels - 0.9)))
        yield (
            f"Of {both[0].outcomes} held-out experiments the 90 % bounds hold"
            f" {100.0 * both[0].held[at]:.0f} % of the final positions and"
            f" {100.0 * both[1].held[at]:.0f} % of the angles."
        )


_MEANT: Final = {
    "parameters": "uncertain parameters: more experiments would narrow it",
    "start": "the start: a better measured first pose would narrow it",
    "model error": "the model's own error: more experiments would not narrow it",
    "noise": "the camera's noise",
}


def _warnings(found: Uncertainty) -> Iterator[str]:
    posterior = found.posterior
    yield from _beside_calibration(found)
    if posterior.effective < found.request.samples:
        yield (
            f"{posterior.effective:.0f} effective samples in place of {found.request.samples}:"
            " tails are rough."
        )
    share = posterior.failed / max(1, posterior.evaluations)
    if share > 0.1:
        yield f"{100.0 * share:.0f} % of the simulations failed and count as impossible."
    lost = sum(one.prediction.failed for one in found.predicted)
    if lost:
        yield f"{lost} draws could not be simulated and are left out of the bounds."
    if not found.request.model_error:
        yield "Without model error as a term parameters look more certain than they are."
    if LABEL in posterior.labels:
        k = posterior.labels.index(LABEL)
        if posterior.quantiles((0.5,))[0, k] > 0.5 * posterior.high[k]:
            yield "Model error is as large as its prior allows: this model does not fit."


def _beside_calibration(found: Uncertainty) -> Iterator[str]:
    """Sentences on the misfit of the calibration, and where the posterior contradicts it."""
    if found.compared is None:
        return
    record, number = found.compared.record, found.compared.id
    yield from (f"Calibration {number}: {sentence}" for sentence in misfit_of(record)[:1])
    own = sum(not one.held_out for one in found.predicted)
    few = own < len(record.members)
    of = f"{own} experiment{'s' * (own != 1)}"
    low, middle, high = found.posterior.quantiles()
    estimates = {estimate.label: estimate for estimate in record.estimates}
    for k, label in enumerate(found.posterior.labels):
        estimate = estimates.get(label)
        if estimate is None or not estimate.verdict or estimate.verdict == "frozen":
            continue
        bottom = -math.inf if estimate.low is None else estimate.low
        top = math.inf if estimate.high is None else estimate.high
        if bottom <= middle[k] <= top:
            continue
        unit = readable(found.posterior.units[k])
        apart = high[k] < bottom or low[k] > top
        ends = f"{unit.text(low[k])} to {unit.text(high[k])} {unit.name}"
        yield (
            f"{label} {'contradicts' if apart else 'disagrees with'} calibration {number}: this"
            f" posterior of {of} has {ends.rstrip()}, the calibration of {len(record.members)} has"
            f" {unit.text(estimate.value)} ({_end(unit, estimate.low)} to"
            f" {_end(unit, estimate.high)}). " + (_FEW if few else _SAME)
        )


def _end(unit: Any, value: float | None) -> str:
    return "open" if value is None else str(unit.text(value))


def _methods(found: Uncertainty) -> Iterator[str]:
    posterior = found.posterior
    yield (
        f"The posterior of {len(posterior.labels)} unknowns was sampled by dynesty"
        f" ({posterior.method}; {posterior.evaluations} simulated points, seed {posterior.seed}),"
        f" with priors uniform within bounds; {posterior.effective:.0f} effective samples."
    )
    noise = found.noise
    yield (
        f"Measured poses were taken to scatter by {1e3 * noise.position_m:.3g} mm and"
        f" {degrees(noise.angle_rad):.3g} degrees."
    )
    if found.request.model_error:
        yield (
            "Model error was a random walk in the distance travelled, of a standard deviation that"
            " was sampled with the parameters."
        )


# --- tables ---------------------------------------------------------------------------------------


def _tables(found: Uncertainty) -> Iterator[Table]:
    posterior = found.posterior
    low, middle, high = posterior.quantiles()
    rows = []
    for k, label in enumerate(posterior.labels):
        unit = readable(posterior.units[k])
        ends = f"{unit.text(posterior.low[k])} .. {unit.text(posterior.high[k])}"
        numbers = (unit.text(x) for x in (middle[k], low[k], high[k], posterior.best[k]))
        rows.append((label, *numbers, ends, unit.name or "-"))
    head = ("parameter", "median", "2.5 %", "97.5 %", "likeliest", "prior", "unit")
    yield Table(head, rows, title="Parameters")
    if len(posterior.modes) > 1:
        yield _mode_table(found)
    yield _parts_table(found)
    yield _bounds_table(found)
    if found.near is not None:
        yield _near_table(found)


def _mode_table(found: Uncertainty) -> Table:
    posterior = found.posterior
    units = [readable(unit) for unit in posterior.units]
    rows = [
        (
            str(k),
            f"{100.0 * mode.weight:.0f}",
            *(f"{u.text(a)} .. {u.text(b)}" for u, a, b in zip(units, mode.low, mode.high,
                                                              strict=True)),
        )
        for k, mode in enumerate(posterior.modes, 1)
    ]  # fmt: skip
    names = [unit.on(label) for unit, label in zip(units, posterior.labels, strict=True)]
    return Table(("mode", "probability [%]", *names), rows, title="Separate modes, 95 % of each")


def _parts_table(found: Uncertainty) -> Table:
    first = found.predicted[0]
    rows = tuple((name, *_spread(first.prediction.shares[name])) for name in (*PARTS, "all"))
    return Table(
        ("from", "x [mm]", "y [mm]", "theta [deg]"),
        rows,
        title=f"Standard deviation of the final pose of {first.experiment.key}, by origin",
    )


def _spread(value: FloatArray) -> tuple[str, str, str]:
    return rounded(1e3 * value[0]), rounded(1e3 * value[1]), rounded(degrees(value[2]))


def _bounds_table(found: Uncertainty) -> Table:
    rows = []
    for one in found.predicted:
        bounds = one.prediction.bounds(0.9)
        centre, radii = 1e3 * bounds.position.centre, 1e3 * bounds.position.radii
        angles = " .. ".join(f"{degrees(end):.2f}" for end in bounds.angle)
        rows.append(
            (
                one.experiment.key,
                "held out" if one.held_out else "",
                f"{centre[0]:.2f}, {centre[1]:.2f}",
                f"{radii[0]:.3g} x {radii[1]:.3g}",
                angles,
                f"{100.0 * one.levels[0]:.0f}",
                f"{100.0 * one.levels[1]:.0f}",
            )
        )
    head = (
        *("experiment", "", "centre [mm]", "half axes [mm]", "theta [deg]"),
        *("position at [%]", "theta at [%]"),
    )
    title = "Bounds of 90 % on the final pose; levels that just hold the measured one"
    return Table(head, rows, title=title)


def _near_table(found: Uncertainty) -> Table:
    near = found.near
    assert near is not None
    rows = tuple(
        (str(k), str(c.size), f"{c.error:.4g}", *(f"{x:.4g}" for x in c.point))
        for k, c in enumerate(near.clusters[:10], 1)
    )
    return Table(
        ("cluster", "points", "error [mm²]", *found.near_names),
        rows,
        title=f"Evaluations of the calibration within {near.rise:.3g} mm² of its best, in clusters",
    )
