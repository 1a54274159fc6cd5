"""Bound the errors of untried pushes, from experiments in memory."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from fixel.calibration.known_pushes import KnownPushes, with_units
from fixel.calibration.objective import Comparer
from fixel.calibration.target import Target, same_configuration, targets_of
from fixel.calibration.usual_parameters import Space
from fixel.domain.coordinates import label_of
from fixel.domain.error_bound import LEVEL, min_experiments
from fixel.domain.evidence import default_folds
from fixel.domain.push_bound import ErrorBound, LeftOutErrors, features_of
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import AbstractMotionModel
from fixel.typing import FloatArray, ProgressCallback
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.domain.fit_store import fit_store
from fixel.workflows.domain.held_out import (
    Apart,
    CalibrationModel,
    HeldOut,
    calibration_model,
    held_out,
    stepper_for,
)
from fixel.workflows.domain.map import listed_names

# Largest number of fits with groups left out; more groups are left out several at a time.
MAX_FOLDS: Final = 24


def error_bound(
    experiments: Iterable[Experiment],
    fit: Calibration | Space = None,
    *,
    level: float = LEVEL,
    groups: Sequence[str] = (),
    leave_out: str | Sequence[str] = (),
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
    leave_out : str or sequence of str
        Conditions whose values are left out as a whole, each in fits of its own, such as
        `"shape"`; also `"dataset"`, `"side"` and `"speed"`. Pushes with a new value then have two
        bounds, a typical and a cautious one; without it they have none.
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
        `.at(scene)` returns the bounds of a push; ``.coverage`` is the measured coverage.

    Raises
    ------
    InvalidInput
        There are too few different experiments for the level, an experiment lacks a condition, a
        condition to leave out has a single value, or the folder `store` belongs to another call.

    Notes
    -----
    There is no `workers=`: the fits of the folds follow one another, each on all `threads`.

    References
    ----------
    :cite:t:`vovk2005`; :cite:t:`barber2021`; :cite:t:`dunn2022`; :cite:t:`lee2023`.

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
    names = listed_names("groups", groups)
    features = features_of(targets)
    judged = _first_of_repeated(targets, features)
    least = min_experiments(level)
    if len(judged) < least:
        raise InvalidInput(
            "experiments",
            found=_counted(len(targets), len(judged)),
            expected=f"{least} at least for bounds with a probability of {100.0 * level:g} %",
            hint="run more experiments, or choose a lower level",
        )
    labels = tuple(label_of(target.conditions, names) for target in targets)
    model = calibration_model(fit, targets, motion)
    without = list(filter(None, [leave_out] if isinstance(leave_out, str) else leave_out))
    for name in without:
        _check_units(with_units(targets, name), name, model)
    apart = Apart(folds=default_folds(len(targets)) if folds is None else folds, seed=seed)
    cache = fit_store(store, targets, model, apart)
    with show_progress(progress, "holding out") as report:
        found = held_out(targets, model, apart, cache, report, threads)
        left = []
        for name in without:
            report.stage = f"leaving out {name}"
            left.append(_left_out(targets, name, model, seed, store, report, threads))
    comparer = Comparer(
        targets, model.space, model.error, model.motion, stepper_for(targets), threads
    )
    position, angle = _end_errors(comparer, found)
    return ErrorBound(
        keys=tuple(targets[k].key for k in judged),
        features=features[judged],
        position=position[judged],
        angle=angle[judged],
        level=level,
        group=tuple(labels[k] for k in judged),
        groups=names,
        fold=found.fold[judged],
        seed=seed,
        known=KnownPushes.of([targets[k] for k in judged], names),
        left_out=tuple(own.rows(judged) for own in left),
    )


def _left_out(
    targets: Sequence[Target],
    name: str,
    model: CalibrationModel,
    seed: int,
    store: str | Path | None,
    report: ProgressCallback,
    threads: int | None,
) -> LeftOutErrors:
    """Return errors under fits without the values of a condition."""
    own = with_units(targets, name)
    units = tuple(label_of(target.conditions, (name,)) for target in own)
    apart = Apart(out=name, folds=min(len(set(units)), MAX_FOLDS), seed=seed)
    cache = fit_store(None if store is None else Path(store) / f"without-{name}", own, model, apart)
    found = held_out(own, model, apart, cache, report, threads)
    comparer = Comparer(own, model.space, model.error, model.motion, stepper_for(own), threads)
    return LeftOutErrors(name, units, *_end_errors(comparer, found))


def _check_units(targets: Sequence[Target], name: str, model: CalibrationModel) -> None:
    """Raise if a condition has one value only, or a parameter for each of its values."""
    n = len({label_of(target.conditions, (name,)) for target in targets})
    if n < 2:
        raise InvalidInput("leave_out", found=f"{n} value of {name}", expected="at least 2",
                           hint="one value does not show how much others differ")  # fmt: skip
    own = [u.label for u in model.space.unknowns if name in u.where and not u.frozen]
    if own:
        raise InvalidInput("leave_out", found=f"{own[0]}, a parameter for each {name}",
                           expected=f"parameters that a new {name} shares")  # fmt: skip


def _first_of_repeated(targets: Sequence[Target], features: FloatArray) -> list[int]:
    """Return one experiment of each configuration: repetitions do not show how pushes differ."""
    found: dict[object, int] = {}
    for k, target in enumerate(targets):
        label = same_configuration(target)
        start = target.case.scene.bodies[0].pose
        pose = (*features[k].tolist(), *start.tolist(), *target.conditions.items())
        plain = tuple(value for value in pose if value != ("experiment", target.key))
        found.setdefault(plain if label == target.key else label, k)
    return sorted(found.values())


def _counted(n: int, different: int) -> str:
    return f"{n}" if n == different else f"{n}, of {different} different pushes"


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
