"""Map where a calibrated simulator can be trusted, from experiments in memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fixel.calibration.known_pushes import KnownPushes
from fixel.calibration.objective import Comparer
from fixel.calibration.target import Target, targets_of
from fixel.calibration.usual_parameters import Space
from fixel.domain.claim import Claim
from fixel.domain.coordinates import coordinates_of
from fixel.domain.domain import DomainMap
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.trust import permit
from fixel.typing import FloatArray, ProgressCallback
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.domain.evidence import DomainEvidence, apart_of, evidence_of, gathered_from
from fixel.workflows.domain.fit_store import fit_store
from fixel.workflows.domain.held_out import (
    CalibrationModel,
    calibrated_on,
    calibration_model,
    stepper_for,
)
from fixel.workflows.domain.request import DomainRequest
from fixel.workflows.domain.run import mapped, refuse_axes


def map_domain(
    experiments: Iterable[Experiment],
    fit: Calibration | Space = None,
    *,
    threshold: float | None = None,
    relative: float | None = None,
    level: float = 0.9,
    confidence: float = 0.95,
    axes: Sequence[str] = (),
    facets: Sequence[str] = (),
    leave_out: str = "",
    nominal: Mapping[str, str | float] | None = None,
    cells: Mapping[str, float] | None = None,
    folds: int | None = None,
    motion: AbstractMotionModel | str | None = None,
    seed: int = 0,
    threads: int | None = None,
    store: str | Path | None = None,
    progress: ProgressOption = None,
) -> DomainMap:
    """Map the experiments for which one set of parameters can be trusted.

    The parameters are calibrated again without each fold of the experiments, so experiments that
    the fit has used may be given.

    Parameters
    ----------
    experiments : sequence of Experiment
        Experiments of one kind, six at least, each with a scene.
    fit : Calibration, mapping, sequence of str or None
        Calibration whose parameters and motion model are used, or parameters as for
        `fixel.calibrate`; by default the usual parameters of the scenes.
    threshold : float, optional
        Root mean square error that must not be exceeded [m], angles at 35 mm per radian; by default
        twice the median of the held-out errors.
    relative : float, optional
        Instead: how much larger the mean squared error may be than with parameters calibrated to
        the experiment itself, as a share of that error.
    level : float
        Share of new experiments that have to stay within the threshold.
    confidence : float
        Probability from which a cell is called trusted, or not trusted.
    axes : sequence of str
        Conditions that the map goes over; also `"contact_angle_rad"`, `"push_angle_rad"` and
        `"travel_m"`, which are computed from the scenes. By default the conditions that vary.
    facets : sequence of str
        Conditions with a map for each of their values.
    leave_out : str
        Condition whose values are held out as a whole, instead of random folds.
    nominal : mapping of str to str or float, optional
        Coordinates from which the domain of applicability grows [SI].
    cells : mapping of str to float, optional
        Widths of the cells along axes [SI].
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
        fits is refused there, with the difference; one with another threshold, axes or
        facets is not.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    DomainMap
        `.at(scene)` returns the verdict on a push; `.held_out`, `.next_experiment`, `.plot()`.

    Raises
    ------
    InvalidInput
        There are too few experiments, a threshold lies below the measurement noise, or an axis is
        no condition of the experiments, or the folder `store` belongs to another call.

    Notes
    -----
    There is no `workers=`: the fits of the folds follow one another, each on all `threads`.

    References
    ----------
    :cite:t:`rpi2011`; :cite:t:`rasmussen2006`.

    Examples
    --------
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(6, duration=0.2)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> trust = map_domain(pushes, space, axes=["side"], threshold=2e-3, folds=2, progress=False)
    >>> trust.at(pushes[0]).nearby
    3
    >>> trust.at(pushes[0].scene, side="left").probability
    1.00 (0.29 to 1.00, n = 3)
    """
    if threshold is not None and relative is not None:
        raise InvalidInput("relative", found="threshold too", expected="one of them")
    permit(motion)
    targets = targets_of(experiments)
    model = calibration_model(fit, targets, motion)
    asked = DomainRequest(
        axes=listed_names("axes", axes),
        by=listed_names("facets", facets),
        leave_out=leave_out,
        nominal=nominal or {},
        steps=cells or {},
        threshold=relative if threshold is None else 1e3 * threshold,
        measure="absolute" if relative is None else "relative",
        level=level,
        confidence=confidence,
        folds=folds,
        seed=seed,
    )
    Claim(
        threshold=1.0 if asked.threshold is None else asked.threshold,
        measure=asked.measure,
        level=level,
        confidence=confidence,
    )  # refused before any fit
    refuse_axes(_unknown(targets, asked), asked)
    cache = fit_store(store, targets, model, apart_of(targets, asked))
    with show_progress(progress, "holding out") as report:
        content = evidence_of(targets, model, asked, cache, report, threads)
        gathered = gathered_from(content, asked)
        if asked.measure == "relative":
            report.stage = "calibrating each alone"
            own = _own_best(targets, model, seed, threads, report)
            gathered = gathered._replace(evidence=replace(gathered.evidence, own_mm2=own))
    return replace(
        mapped(gathered, asked)[0],
        known=KnownPushes.of(targets, asked.by),
        source=content,
        question=asked.question(),
    )


def listed_names(where: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return names as a tuple; a single text is refused."""
    if isinstance(names, str):
        raise InvalidInput(where, found=repr(names), expected=f"a list: [{names!r}]")
    return tuple(names)


def _unknown(targets: Sequence[Target], asked: DomainRequest) -> DomainEvidence:
    """Return evidence without errors, with which axes can be checked."""
    n = len(targets)
    content = {
        "keys": [target.key for target in targets],
        "ids": list(range(n)),
        "coordinates": [coordinates_of(target) for target in targets],
        "error": [1.0] * n,
        "fold": [0] * n,
        "configuration": [target.key for target in targets],
        "points": {},
        "left_out": {},
        "floor_mm": None,
    }
    unknown = ("calibration", "started", "floor_from", "folds", "labels", "motion", "stepper")
    return gathered_from(dict.fromkeys((*unknown, "scale_mm"), "") | content, asked)


def _own_best(
    targets: Sequence[Target],
    model: CalibrationModel,
    seed: int,
    threads: int | None,
    report: ProgressCallback,
) -> FloatArray:
    """Return the error (n,) of each experiment with parameters of its own [mm^2]."""
    found = np.empty(len(targets))
    for k, target in enumerate(targets):
        point = calibrated_on([target], model, seed)
        stepper = stepper_for(targets)
        comparer = Comparer([target], model.space, model.error, model.motion, stepper, threads)
        found[k] = comparer.errors(np.zeros(1, np.int64), point[None]).error[0]
        report(k + 1, len(targets))
    return np.where(np.isfinite(found), found, np.nan)
