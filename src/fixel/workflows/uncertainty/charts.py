"""Draw the charts of an uncertainty: samples, bands, final poses, coverage."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from fixel.drawing.chart import display_unit
from fixel.drawing.uncertainty import (
    bands_chart,
    corner_chart,
    coverage_chart,
    final_pose_chart,
    label_text,
)
from fixel.uncertainty.bands import LEVELS, CoverageCurve, coverage_curve
from fixel.uncertainty.discrepancy import LABEL
from fixel.uncertainty.posterior import Posterior
from fixel.workflows.figures import Picture, banner_of
from fixel.workflows.uncertainty.sampling import ExperimentPrediction, Uncertainty

MAX_PICTURED: Final = 3  # experiments with charts
# Number of held-out experiments from which a coverage curve is informative.
MIN_FOR_CURVE: Final = 5


def pictures_of(found: Uncertainty) -> Iterator[Picture]:
    """Yield charts of the posterior, of the first predictions, and of their coverage."""
    corner = corner_chart(found.posterior, f"Posterior of {what_of(found)}")
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
        unit = display_unit(posterior.units[k])
        ends = f"{unit.text(posterior.low[k])} to {unit.text(posterior.high[k])} {unit.name}"
        log = " (of its logarithm)" * (label == LABEL)
        parts.append(f"{label_text(label)} {ends.rstrip()}{log}")
    return ", ".join(parts)


def _of_experiment(one: ExperimentPrediction, number: int) -> Iterator[Picture]:
    prediction, banner = one.prediction, _banner((one,))
    what = f"{one.experiment.key}, held out" if one.held_out else one.experiment.key
    measured = one.target.pose.copy()
    # Angles on the same turn as the simulated ones.
    off = prediction.nominal[:, 2] - measured[:, 2]
    measured[:, 2] += 2.0 * np.pi * np.round(off / (2.0 * np.pi))
    path = bands_chart(time=prediction.time, measured=measured, best=prediction.nominal,
                      bands=[prediction.bands(level) for level in LEVELS], title=what)  # fmt: skip
    yield Picture(f"bands-{number}", path, banner,
                  f"Trajectory of {what} with bands of 50 and 90 %, frame by frame.")  # fmt: skip
    body = one.target.case.scene.bodies[0]
    final = final_pose_chart(
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
    chart = coverage_chart(curves, "Coverage of the bounds by held-out experiments")
    return Picture("coverage", chart, _banner(found.held_out),
                   "Share of held-out final poses within the bounds of each level.")  # fmt: skip


def _banner(predicted: tuple[ExperimentPrediction, ...]) -> str:
    every = [one.experiment for one in predicted]
    return banner_of(["" if one.real else f"SIMULATED by {one.simulated_by}" for one in every])


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
