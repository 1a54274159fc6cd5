"""Predictions of repetitions of a measured push, with the origin of their spread.

A draw is the simulation of one posterior sample from one start, plus one random walk of the model
error with that sample's standard deviation, plus the noise of the camera. The contributions are
reported separately, to show whether better parameters, a better placed start, a better model or
a better camera would narrow the prediction.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from fixel.calibration.objective import Comparer
from fixel.errors import InvalidInput, SolveFailed
from fixel.model.trajectory import wrapped
from fixel.typing import BoolArray, FloatArray
from fixel.uncertainty.error_terms import draw_walks
from fixel.uncertainty.likelihood import expected_shares
from fixel.uncertainty.posterior import Posterior
from fixel.uncertainty.prediction import Prediction
from fixel.uncertainty.start_ensemble import START

PARTS: Final = ("parameters", "start", "model error", "noise")


def predict_repetition(
    comparer: Comparer,
    member: int,
    posterior: Posterior,
    *,
    draws: int = 400,
    seed: int | None = None,
) -> Prediction:
    """Predict a repetition of a member of a comparer from the same measured start.

    The posterior is of the comparer's space, with the noise of the camera, and has at least as many
    samples as draws. By default the seed is that of the posterior.
    """
    noise, error = posterior.noise, posterior.model_error
    if noise is None:
        expected = "a result of fixel.posterior"
        raise InvalidInput("posterior", found="a posterior without camera noise", expected=expected)
    seed = posterior.seed if seed is None else seed
    rng = np.random.default_rng([seed, member])
    rows = rng.permutation(len(posterior.points))[: max(2, draws)]
    points, k = posterior.points[rows], len(rows)
    n_free = len(comparer.space.labels)
    errors = rng.standard_normal((k, 3)) * noise.standard_deviations
    # Start errors that are among the unknowns are not drawn again.
    errors[:, np.isin(START, [u.name for u in comparer.space.free])] = 0.0
    still = np.zeros_like(errors)
    best = np.repeat(posterior.best[None], k, axis=0)
    (centre,), (fine,), _ = _simulated(comparer, member, best[:1, :n_free], still[:1])
    if not fine:
        raise SolveFailed("the sample of largest likelihood cannot be simulated")
    both, good, reasons = _simulated(comparer, member, points[:, :n_free], errors)
    only, good_only, _ = _simulated(comparer, member, points[:, :n_free], still)
    begun, good_begun, _ = _simulated(comparer, member, best[:, :n_free], errors)
    target = comparer.targets[member]
    walk = np.zeros_like(both)
    if error is not None:
        walk = draw_walks(expected_shares(comparer, member, error), points[:, -1], error.sides, rng)
    seen = rng.standard_normal(both.shape) * noise.standard_deviations
    paths = [_near(path, centre) for path in (only, begun, both)]
    truths = (paths[2] + walk)[good]
    if len(truths) < 2:
        raise SolveFailed("hardly any sample can be simulated from the starts drawn")
    return Prediction(
        scene=target.case.scene,
        error=None,
        drawn=errors,
        start=target.case.scene.bodies[0].pose + errors,
        time=np.asarray(target.case.times),
        pose=paths[2],
        nominal=centre,
        ended=good,
        reasons=tuple(reasons),
        motion=comparer.ensemble.motion.name,
        seed=seed,
        parameters=comparer.space.columns(points[:, :n_free], target.conditions),
        drift=None if error is None else walk,
        noise=seen,
        shares={
            "parameters": _spread(paths[0][good_only]),
            "start": _spread(paths[1][good_begun]),
            "model error": _spread(walk),
            "noise": _spread(seen),
            "all": _spread(truths + seen[good]),
        },
    )


def _simulated(
    comparer: Comparer, member: int, points: FloatArray, errors: FloatArray
) -> tuple[FloatArray, BoolArray, list[str]]:
    """Return paths (k, n_frame, 3) of points (k, n_free) from perturbed starts, which simulations
    converged, and why others did not."""
    target = comparer.targets[member]
    values = comparer.space.columns(points, target.conditions)
    for name, error in zip(START, errors.T, strict=True):
        if error.any() or name in values:
            values[name] = values.get(name, 0.0) + error
    which = np.full(len(points), member)
    outcome = comparer.ensemble.simulate(
        which, {name: np.ascontiguousarray(value) for name, value in values.items()}
    )
    return outcome.pose[:, : len(target.pose)], outcome.converged, outcome.reasons


def _near(paths: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the paths with angles within half a turn of the central path."""
    turned = paths.copy()
    turned[..., 2] = centre[:, 2] + wrapped(paths[..., 2] - centre[:, 2])
    return turned


def _spread(paths: FloatArray) -> FloatArray:
    return np.asarray(paths[:, -1].std(axis=0)) if len(paths) else np.zeros(3)
