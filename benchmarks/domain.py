"""Maps of the simulated laboratory, where the truth is known: new experiments with fresh noise in
every cell tell whether it was coloured rightly."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.figures import Figure, Size, at_least
from fixel.calibration.objective import Comparer, MeanSquare
from fixel.calibration.target import Target, same_configuration, targets_of
from fixel.calibration.usual_parameters import default_unknowns
from fixel.domain.cells import cells_of, coordinates_of
from fixel.domain.claim import NOT_TRUSTED, TRUSTED, Claim
from fixel.domain.domain import DomainMap, domain_map
from fixel.domain.evidence import HeldOutErrors
from fixel.domain.held_out import Apart, CalibrationModel, calibrated_on, held_out
from fixel.io.array_bytes import ResultCache
from fixel.model import PlannedExperiment
from fixel.model.space import ParameterSpace
from fixel.sampling.published import thesis_plan
from fixel.simulation import Dynamic
from fixel.testbed.simulated import SimulatedTestbed
from fixel.typing import FloatArray

# Not those on which the settings of the surface were chosen.
LAYOUTS = ("collinear-wide", "collinear-minus45", "concave-tight", "asymmetric-b")
AXES = ("offset_x_m", "offset_y_m", "offset_theta_rad")
THRESHOLDS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 8.0)  # [mm]
BY = ("shape",)


class Truth(NamedTuple):
    """What a map says, and what is so."""

    domain: DomainMap
    quantile_mm: FloatArray  # (n_group, n_cell) of new experiments; nan where none was made


def run(size: Size) -> list[Figure]:
    """Shares of cells that are coloured rightly, over several thresholds."""
    full = size.rollouts >= 500
    layouts, new = (LAYOUTS, 20) if full else (LAYOUTS[:1], 2)
    begun = time.perf_counter()
    found = []
    for repetitions in (1, 3) if full else (1,):
        truth = judged(_planned(layouts, None if full else 6), repetitions, new, level=0.9)
        found += figures(truth, f"{repetitions} a cell", bar=full)
    return [*found, Figure("domain map, wall time", "s", (time.perf_counter() - begun,))]


def figures(truth: Truth, name: str, *, bar: bool) -> list[Figure]:
    """Decided cells that are right, and decided and right ones of all [%]."""
    right, decided, known = 0, 0, 0
    for threshold in THRESHOLDS:
        verdicts = truth.domain.verdicts(Claim(threshold=threshold))
        colour = np.array([[one.colour for one in own] for own in verdicts])
        there = ~np.isnan(truth.quantile_mm)
        said = there & np.isin(colour, (TRUSTED, NOT_TRUSTED))
        right += int((said & ((colour == TRUSTED) == (truth.quantile_mm <= threshold))).sum())
        decided += int(said.sum())
        known += int(there.sum())
    share = 100.0 * right / max(1, decided)
    limit = at_least(95.0) if bar else None
    return [
        Figure(f"domain, right of decided cells, {name}", "%", (share,), limit),
        Figure(f"domain, decided cells, {name}", "%", (100.0 * decided / known,)),
        Figure(f"domain, decided and right of all, {name}", "%", (100.0 * right / known,)),
    ]


def _planned(layouts: Sequence[str], most: int | None) -> list[PlannedExperiment]:
    wanted = [p for p in thesis_plan().experiments if p.conditions["layout"] in layouts]
    return wanted if most is None else wanted[:most] + wanted[-most:]


def judged(planned: Sequence[PlannedExperiment], repetitions: int, new: int, level: float) -> Truth:
    """Make experiments, map them, and make new ones in every cell."""
    targets = _made(planned, repetitions, "")
    space = ParameterSpace(unknowns=tuple(default_unknowns([targets[0].case.scene])))
    model = CalibrationModel(space=space, motion=Dynamic(), error=MeanSquare())
    apart = Apart(by=BY, folds=5 if len(planned) > 20 else 2)
    errors = held_out(targets, model, apart, ResultCache(None).get).error
    rows = [coordinates_of(target) for target in targets]
    evidence = HeldOutErrors(
        keys=tuple(target.key for target in targets),
        ids=tuple(range(len(targets))),
        coordinates={name: tuple(row[name] for row in rows) for name in AXES},
        error_mm2=errors,
        group=tuple(_group(target) for target in targets),
        configuration=tuple(same_configuration(target) for target in targets),
    )
    domain = domain_map(evidence, cells_of(evidence, AXES))
    return Truth(domain, _quantiles(domain, planned, targets, model, new, level))


def _made(planned: Sequence[PlannedExperiment], repetitions: int, word: str) -> list[Target]:
    """Runs of a plan; a name of its own gives each its own noise, on the same bench."""
    runs = [
        replace(
            one,
            name=f"{one.name}-{word}{r}",
            conditions={**one.conditions, "repetition": float(r + 1)},
        )
        for one in planned
        for r in range(repetitions)
    ]
    return targets_of(SimulatedTestbed().run(runs))


def _group(target: Target) -> str:
    return f"{target.conditions['shape']} {target.conditions['layout']}"


def _quantiles(
    domain: DomainMap,
    planned: Sequence[PlannedExperiment],
    targets: Sequence[Target],
    model: CalibrationModel,
    new: int,
    level: float,
) -> FloatArray:
    """(n_group, n_cell) what a share of new experiments stays below, under parameters from all."""
    fresh = _made(planned, new, "new")
    points = {
        shape: calibrated_on([t for t in targets if t.conditions["shape"] == shape], model)
        for shape in dict.fromkeys(target.conditions["shape"] for target in targets)
    }
    comparer = Comparer(fresh, model.space, model.error, model.motion)
    table = np.array([points[target.conditions["shape"]] for target in fresh])
    rms = np.sqrt(comparer.errors(np.arange(len(fresh)), table).error)
    found = np.full(domain.counts.shape, np.nan)
    place = {key: k for k, key in enumerate(domain.evidence.keys)}
    first = {same_configuration(target): place[target.key] for target in targets}
    for k in range(0, len(fresh), new):
        row = first[same_configuration(fresh[k])]
        g = domain.groups.index(domain.evidence.group[row])
        ordered = np.sort(rms[k : k + new])
        found[g, domain.place[row]] = ordered[int(np.ceil(level * new)) - 1]
    return found
