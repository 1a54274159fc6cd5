"""Report of an uncertainty analysis, to store: sentences, tables and charts."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from math import degrees
from typing import Any, Final

import numpy as np

from fixel.calibration.result import CalibratedValues, NearOptimal
from fixel.database.project import Project
from fixel.drawing import uncertainty
from fixel.engine_names import compare_words
from fixel.filtering.particle_filter import UniformPrior
from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import LABEL
from fixel.uncertainty.posterior import Posterior
from fixel.uncertainty.prediction import LEVELS, CoverageCurve, coverage_curve
from fixel.uncertainty.repetition import PARTS
from fixel.units import displayed
from fixel.workflows.analysis import (
    Analysis,
    AnalysisReport,
    Picture,
    StoredAnalysis,
    StoredAnswer,
    banner_over,
    store_analysis,
)
from fixel.workflows.sentences import rounded, sentences
from fixel.workflows.uncertainty.sampling import ExperimentPrediction, Uncertainty, predicted_by

JSON: Final = ("folder", "pictures")  # what `--json` has besides numbers
REFERENCES: Final = ("skilling2006", "feroz2009", "speagle2020", "kennedy2001")


def report_of(found: Uncertainty) -> AnalysisReport:
    """Return headline, warnings, tables, charts and numbers of a posterior with predictions."""
    posterior = found.posterior
    analysis = Analysis(
        kind="uncertainty",
        title=f"Uncertainty of {what_of(found)}",
        question={"experiments": list(posterior.experiments)},
        headline=_headline(found),
        warnings=_warnings(found),
        tables=tuple(_tables(found)),
        notes=(posterior.note,),
        methods=sentences("uncertainty", "methods", posterior=posterior),
        references=REFERENCES,
        numbers=numbers_of(found),
        calibrations=() if found.calibration is None else (found.calibration.id,),
        experiments=tuple(one.id for one in found.predicted),
        seed=posterior.seed,
        seconds=posterior.seconds,
    )
    arrays = {"samples": posterior.points, "log_likelihood": posterior.log_likelihood}
    return AnalysisReport(analysis, list(pictures_of(found)), arrays)


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the next command: a comparison with the likeliest values."""
    posterior, first = done.result.posterior, done.result.predicted[0].target
    columns = posterior.values(posterior.best[None], first.conditions)
    values = {name: float(column[0]) for name, column in columns.items()}
    return compare_words(first.key, values, posterior.motion)


def store_posterior(project: Project, found: Posterior) -> StoredAnalysis:
    """Store a posterior in a project, with predictions of its experiments and charts.

    An experiment that the project does not have raises `NotStored`.
    """
    report = report_of(predicted_by(project, found))
    mark = {"points": hashlib.sha256(found.points.tobytes()).hexdigest()}
    analysis = report.analysis.model_copy(update={"question": report.analysis.question | mark})
    return store_analysis(project, analysis, report.pictures, report.arrays)


def numbers_of(found: Uncertainty) -> dict[str, Any]:
    """Return plain values in SI units, for `--json`."""
    posterior = found.posterior
    low, middle, high = posterior.quantiles()
    noise = posterior.noise
    assert noise is not None  # measured poses have noise
    return {
        "unseen": [text for one in found.predicted for text in one.prediction.unseen],
        "experiments": [one.experiment.key for one in found.predicted if not one.held_out],
        "motion": posterior.motion,
        "noise": {
            "position_m": noise.position_m, "angle_rad": noise.angle_rad,
            "source": noise.source, "correlation": noise.correlation,
        },
        "model_error": posterior.model_error is not None,
        "parameters": {
            label: {
                "unit": posterior.units[k], "low": low[k], "median": middle[k], "high": high[k],
                "best": posterior.best[k], "prior": [posterior.low[k], posterior.high[k]],
            }
            for k, label in enumerate(posterior.labels)
        },
        "modes": [
            {"weight": mode.weight, "best": dict(zip(posterior.labels, mode.best, strict=True))}
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
        "near_optimal": _near(found.near),
    }  # fmt: skip


def _final(one: ExperimentPrediction) -> dict[str, Any]:
    bounds = one.prediction.region(0.9)
    shares = one.prediction.shares
    return {
        "experiment": one.experiment.key,
        "unseen": one.prediction.unseen,
        "held_out": one.held_out,
        "measured": one.target.pose[-1],
        "centre_m": bounds.position.centre,
        "radii_90_m": bounds.position.radii,
        "turn_rad": bounds.position.angle,
        "angle_90_rad": bounds.angle,
        "level_of_position": one.levels[0],
        "level_of_angle": one.levels[1],
        "standard_deviations": dict(shares),
        "failed_draws": one.prediction.failed,
    }


def _coverage(found: Uncertainty) -> dict[str, Any] | None:
    both = curves_of(found)
    if both is None:
        return None
    position, angle = both
    return {
        "levels": position.levels,
        "position_held": position.held,
        "angle_held": angle.held,
        "outcomes": position.outcomes,
    }


def _near(near: NearOptimal | None) -> dict[str, Any] | None:
    if near is None:
        return None

    def named(values: FloatArray) -> dict[str, float]:
        return dict(zip(near.names, values, strict=True))

    return {
        "least_mm2": near.least,
        "rise_mm2": near.rise,
        "evaluations": near.size,
        "low": named(near.low),
        "high": named(near.high),
        "clusters": [{"size": c.size, "best": named(c.point)} for c in near.clusters],
    }


def _headline(found: Uncertainty) -> tuple[str, ...]:
    posterior, first = found.posterior, found.predicted[0]
    shares = first.prediction.shares
    held = None
    if (both := curves_of(found)) is not None:
        at = int(np.argmin(np.abs(both[0].levels - 0.9)))
        position, angle = (100.0 * curve.held[at] for curve in both)
        held = {"outcomes": both[0].outcomes, "position": position, "angle": angle}
    k = posterior.labels.index(LABEL) if LABEL in posterior.labels else None
    return sentences(
        "uncertainty",
        "headline",
        posterior=posterior,
        first=first,
        bounds=first.prediction.region(0.9),
        largest_part=max(PARTS, key=lambda name: float(np.hypot(*shares[name][:2]))),
        tau=None if k is None else posterior.quantiles()[:, k].tolist(),
        held=held,
    )


def _warnings(found: Uncertainty) -> tuple[str, ...]:
    posterior = found.posterior
    k = posterior.labels.index(LABEL) if LABEL in posterior.labels else None
    at_bound = k is not None and posterior.quantiles((0.5,))[0, k] > 0.5 * posterior.high[k]
    compared = found.compared
    return sentences(
        "uncertainty",
        "warnings",
        unseen=[
            f"{one.experiment.key}, {text}"
            for one in found.predicted
            for text in one.prediction.unseen
        ],
        posterior=posterior,
        requested=found.requested,
        number=None if compared is None else compared.id,
        misfit=[] if compared is None else compared.record.misfit[:1],
        contradictions=[] if compared is None else list(_contradictions(found, compared)),
        own=sum(not one.held_out for one in found.predicted),
        calibrated=0 if compared is None else len(compared.record.members),
        failed=posterior.failed / max(1, posterior.evaluations),
        lost=sum(one.prediction.failed for one in found.predicted),
        at_bound=at_bound,
        crowded=_crowded(posterior),
    )


def _crowded(posterior: Posterior) -> list[str]:
    """Return the parameters that a bound of their prior, and not the data, may have decided."""
    low, _, high = posterior.quantiles((0.05, 0.5, 0.95))
    prior = UniformPrior(posterior.labels, posterior.low, posterior.high)
    found = prior.excited(low, high) & prior.touched(low, high)
    return [k for k, own in zip(posterior.labels, found, strict=True) if own and k != LABEL]


def _contradictions(found: Uncertainty, compared: CalibratedValues) -> Iterator[dict[str, Any]]:
    """Parameters whose median is outside the 95 % interval of a calibration, if it were normal."""
    from scipy.special import ndtri

    level = (compared.record.request or {}).get("level") or 0.95  # earlier records lack it
    wider = float(ndtri(0.975) / ndtri(0.5 + 0.5 * level))
    low, middle, high = found.posterior.quantiles()
    estimates = {estimate.label: estimate for estimate in compared.record.estimates}
    for k, label in enumerate(found.posterior.labels):
        own = estimates.get(label)
        if own is None or not own.verdict or own.verdict == "frozen":
            continue
        bottom = -math.inf if own.low is None else own.value + wider * (own.low - own.value)
        top = math.inf if own.high is None else own.value + wider * (own.high - own.value)
        if bottom <= middle[k] <= top:
            continue
        unit = displayed(found.posterior.units[k])
        yield {
            "label": label,
            "apart": high[k] < bottom or low[k] > top,
            "ends": f"{unit.text(low[k])} to {unit.text(high[k])} {unit.name}".rstrip(),
            "value": unit.text(own.value),
            "low": "open" if own.low is None else unit.text(bottom),
            "high": "open" if own.high is None else unit.text(top),
        }


def _tables(found: Uncertainty) -> Iterator[Table]:
    yield from found.posterior.tables()
    yield _parts_table(found)
    yield _bounds_table(found)
    if found.near is not None:
        yield _near_table(found.near)


def _parts_table(found: Uncertainty) -> Table:
    first = found.predicted[0]
    rows = []
    for name in (*PARTS, "all"):
        x, y, theta = first.prediction.shares[name].tolist()
        rows.append((name, rounded(1e3 * x), rounded(1e3 * y), rounded(degrees(theta))))
    return Table(
        ("from", "x [mm]", "y [mm]", "theta [deg]"),
        rows,
        title=f"Standard deviation of the final pose of {first.experiment.key}, by origin",
    )


def _bounds_table(found: Uncertainty) -> Table:
    rows = []
    for one in found.predicted:
        bounds = one.prediction.region(0.9)
        x, y = 1e3 * bounds.position.centre
        a, b = 1e3 * bounds.position.radii
        angles = " .. ".join(f"{degrees(end):.2f}" for end in bounds.angle)
        place, held = (one.experiment.key, "held out" if one.held_out else "")
        levels = [100.0 * level for level in one.levels]
        rows.append((place, held, f"{x:.2f}, {y:.2f}", f"{a:.3g} x {b:.3g}", angles, *levels))
    head: tuple[Column | str, ...] = (
        *("experiment", "", "centre [mm]", "half axes [mm]", "theta [deg]"),
        *(Column(f"{name} at", "%", ".0f") for name in ("position", "theta")),
    )
    title = (
        "Bounds of 90 % on the final pose, and the smallest levels that contain the measured pose"
    )
    return Table(head, rows, title=title)


def _near_table(near: NearOptimal) -> Table:
    rows = [(k, c.size, c.error, *c.point) for k, c in enumerate(near.clusters[:10], 1)]
    values = [Column(name, format=".4g") for name in near.names]
    title = f"Evaluations of the calibration within {near.rise:.3g} mm² of its best, in clusters"
    head: tuple[Column | str, ...] = ("cluster", "points", Column("error", "mm²", ".4g"), *values)
    return Table(head, rows, title=title)


MAX_PICTURED: Final = 3  # experiments with charts
# Number of held-out experiments from which a coverage curve is informative.
MIN_FOR_CURVE: Final = 5


def pictures_of(found: Uncertainty) -> Iterator[Picture]:
    """Yield charts of the posterior, of the first predictions, and of their coverage."""
    corner = uncertainty.corner_chart(found.posterior, f"Posterior of {what_of(found)}")
    yield Picture("corner", corner, _banner(found.predicted),
                  f"Samples of the posterior. The prior was uniform: {_priors(found.posterior)}."
                  )  # fmt: skip
    chosen = [*found.predicted[:1], *found.held_out][:MAX_PICTURED]
    for number, predicted in enumerate(dict.fromkeys(one.id for one in chosen), 1):
        one = next(p for p in chosen if p.id == predicted)
        yield from _of_experiment(one, number)
    both = curves_of(found)
    if both is not None:
        yield _curve_picture(found, both)


def _priors(posterior: Posterior) -> str:
    """Ranges of the priors, which are mostly much wider than the axes."""
    parts = []
    for k, label in enumerate(posterior.labels):
        unit = displayed(posterior.units[k])
        ends = f"{unit.text(posterior.low[k])} to {unit.text(posterior.high[k])} {unit.name}"
        log = " (of its logarithm)" * (label == LABEL)
        parts.append(f"{uncertainty.label_text(label)} {ends.rstrip()}{log}")
    return ", ".join(parts)


def _of_experiment(one: ExperimentPrediction, number: int) -> Iterator[Picture]:
    prediction, banner = one.prediction, _banner((one,))
    what = f"{one.experiment.key}, held out" if one.held_out else one.experiment.key
    measured = one.target.pose.copy()
    # Angles on the same turn as the simulated ones.
    off = prediction.nominal[:, 2] - measured[:, 2]
    measured[:, 2] += 2.0 * np.pi * np.round(off / (2.0 * np.pi))
    path = uncertainty.bands_chart(time=prediction.time, measured=measured, best=prediction.nominal,
                      bands=[prediction.bands(level) for level in LEVELS], title=what)  # fmt: skip
    yield Picture(f"bands-{number}", path, banner,
                  f"Trajectory of {what} with bands of 50 and 90 %, frame by frame.")  # fmt: skip
    body = one.target.case.scene.bodies[0]
    final = uncertainty.final_pose_chart(
        outline=body.shape.outline,
        start=body.pose,
        measured=measured[-1],
        draws=prediction.ends,
        regions=[prediction.region(level) for level in LEVELS],
        title=what,
    )
    yield Picture(f"final-{number}", final, banner,
                  f"Final pose of {what} with bounds of 50 and 90 %.")  # fmt: skip


def _curve_picture(found: Uncertainty, both: tuple[CoverageCurve, CoverageCurve]) -> Picture:
    curves = dict(zip(("final position", "final angle"), both, strict=True))
    chart = uncertainty.coverage_chart(curves, "Coverage of the bounds by held-out experiments")
    return Picture("coverage", chart, _banner(found.held_out),
                   "Share of held-out final poses within the bounds of each level.")  # fmt: skip


def _banner(predicted: tuple[ExperimentPrediction, ...]) -> str:
    return banner_over(one.experiment for one in predicted)


def what_of(found: Uncertainty) -> str:
    own = [one.experiment.key for one in found.predicted if not one.held_out]
    return own[0] if len(own) == 1 else f"{len(own)} experiments"


def curves_of(found: Uncertainty) -> tuple[CoverageCurve, CoverageCurve] | None:
    """Coverage curves of held-out final positions and angles; None for few experiments."""
    held = found.held_out
    if len(held) < MIN_FOR_CURVE:
        return None
    levels = np.array([one.levels for one in held])
    return coverage_curve(levels[:, 0]), coverage_curve(levels[:, 1])
