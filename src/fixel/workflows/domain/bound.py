"""Bound the errors of untried pushes, from experiments in memory."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fixel.calibration.objective import Comparer
from fixel.calibration.target import targets_of
from fixel.calibration.usual_parameters import Space
from fixel.domain.coordinates import label_of
from fixel.domain.error_bound import LEVEL, min_experiments
from fixel.domain.evidence import default_folds
from fixel.domain.push_bound import ErrorBound, features_of
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import AbstractMotionModel
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.domain.fit_store import fit_store
from fixel.workflows.domain.held_out import (
    Apart,
    HeldOut,
    calibration_model,
    held_out,
    stepper_for,
)
from fixel.workflows.domain.map import listed_names


def error_bound(
    experiments: Iterable[Experiment],
    fit: Calibration | Space = None,
    *,
    level: float = LEVEL,
    groups: Sequence[str] = (),
    folds: int | None = None,
    motion: AbstractMotionModel | str | None = None,
    seed: int = 0,
    threads: int | None = None,
    store: str | Path | None = None,
    progress: ProgressOption = None,
) -> ErrorBound:
    """Bound the error of the calibrated simulator in new pushes, with a stated probability.

    The parameters are calibrated again without each fold of the experiments, so experiments that
    the fit has used may be given.

    Parameters
    ----------
    experiments : sequence of Experiment
        Experiments like the new pushes, each with a scene: 9 at least for a level of 90 %.
    fit : Calibration, mapping, sequence of str or None
        Calibration whose parameters and motion model are used, or parameters as for
        `fixel.calibrate`; by default the usual parameters of the scenes.
    level : float
        Probability with which each bound holds.
    groups : sequence of str
        Conditions such as `"surface"`; bounds then hold for each of their values that has enough
        experiments.
    folds : int, optional
        Number of folds; 5 by default, 2 for more than 2000 experiments.
    motion : AbstractMotionModel or str, optional
        Motion model; by default that of the calibration, else `Dynamic()`.
    seed : int
        Seed of the folds.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    store : path, optional
        Folder for finished fits, so that an interrupted call continues. A call that needs other
        fits is refused there, with the difference; one with another level or groups is
        not.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    ErrorBound
        `.at(scene)` returns the bounds of a push; `.coverage`, `.plot()`.

    Raises
    ------
    InvalidInput
        There are too few experiments for the level, an experiment lacks a condition, or the folder
        `store` belongs to another call.

    Notes
    -----
    There is no `workers=`: the fits of the folds follow one another, each on all `threads`.

    References
    ----------
    :cite:t:`vovk2005`; :cite:t:`barber2021`; :cite:t:`dunn2022`.

    Examples
    --------
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(10, duration=0.2)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> bound = error_bound(pushes, space, folds=2, progress=False)
    >>> bound.at(pushes[0].scene).verdict
    'bounded'
    >>> bool(bound.at(pushes[0].scene).position < 1e-3)
    True
    """
    targets = targets_of(experiments)
    least = min_experiments(level)
    if len(targets) < least:
        raise InvalidInput(
            "experiments",
            found=len(targets),
            expected=f"{least} at least for bounds with a probability of {100.0 * level:g} %",
            hint="run more experiments, or choose a lower level",
        )
    names = listed_names("groups", groups)
    labels = tuple(label_of(target.conditions, names) for target in targets)
    model = calibration_model(fit, targets, motion)
    apart = Apart(folds=default_folds(len(targets)) if folds is None else folds, seed=seed)
    cache = fit_store(store, targets, model, apart)
    with show_progress(progress, "holding out") as report:
        found = held_out(targets, model, apart, cache, report, threads)
    comparer = Comparer(
        targets, model.space, model.error, model.motion, stepper_for(targets), threads
    )
    position, angle = _end_errors(comparer, found)
    return ErrorBound(
        keys=tuple(target.key for target in targets),
        features=features_of(targets),
        position=position,
        angle=angle,
        level=level,
        group=labels,
        groups=names,
        fold=found.fold,
        seed=seed,
    )


def _end_errors(comparer: Comparer, found: HeldOut) -> tuple[FloatArray, FloatArray]:
    """Return errors of end positions and angles (n,), each with the parameters of its fold."""
    every = np.arange(len(found.fold))
    points = np.array([found.points[f"all, fold {k + 1}"] for k in found.fold.tolist()])
    difference, good, _ = comparer.differences(every, points)
    last = comparer.length(every) - 1
    off = difference[every, last]
    return (
        np.where(good, np.hypot(off[:, 0], off[:, 1]), np.inf),
        np.where(good, np.abs(off[:, 2]), np.inf),
    )
