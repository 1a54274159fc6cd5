"""Data of a finished calibration, computed once for its charts and report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np

from fixel.calibration.study import NOMINAL
from fixel.calibration.target import Target
from fixel.database.project import Project
from fixel.database.query import ALL_EXPERIMENTS
from fixel.drawing.calibration import OffsetSeries
from fixel.model.records import Estimate
from fixel.model.space import ParameterSpace
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibrations
from fixel.workflows.calibration.request import CalibrationRequest
from fixel.workflows.calibration.result import CalibrationResult, FitKind, ParameterSet
from fixel.workflows.figures import banner_of

# Axes of a sampling plan, with the units of their offsets among an experiment's conditions.
OFFSETS: Final = {"x": "m", "y": "m", "theta": "rad"}


class CalibrationReportData:
    """Cached data of a calibration.

    Parameters
    ----------
    calibration : Calibrations
    project : Project, optional
        Project that contains the experiments; by default that of the job's folder.
    """

    def __init__(self, calibration: Calibrations, project: Project | None = None) -> None:
        self.calibration = calibration
        self._project = project
        self.request: CalibrationRequest = calibration.request
        self.outcome: CalibrationResult = calibration.outcome
        self.space: ParameterSpace = calibration.request.space
        self.keys: Sequence[str] = calibration.outcome.keys
        self.unit: str = calibration.request.made_error.unit

    def lengths(self, errors: FloatArray, members: int = 1) -> FloatArray:
        """Convert errors to lengths [mm], the unit of all charts and tables.

        Parameters
        ----------
        errors : array
            Errors in the unit of the calibration.
        members : int
            Number of experiments in each error; a sum is divided by it.
        """
        shared = errors / members if self.request.combine == "sum" else errors
        return np.asarray(np.sqrt(shared) if self.unit == "mm^2" else shared)

    @cached_property
    def targets(self) -> Sequence[Target]:
        """Experiments of the calibration."""
        return self.calibration.targets

    @cached_property
    def alone(self) -> list[ParameterSet]:
        """Best set of each single experiment: its own, or a neighbour's."""
        # Neighbours' sets follow the experiments' own, and only where they are better.
        best = {one.members[0]: one for one in self.outcome.alone}
        return [best[member] for member in sorted(best)]

    @cached_property
    def searched(self) -> list[ParameterSet]:
        """Sets for single experiments that were searched for."""
        return [one for one in self.outcome.alone if one.trace is not None]

    @cached_property
    def together(self) -> ParameterSet | None:
        """Best set for all experiments."""
        return next(
            (one for one in self.outcome.together if one.how in (FitKind.DIRECT, FitKind.STORED)),
            None,
        )

    @cached_property
    def banners(self) -> list[str]:
        """Banner over charts of each experiment; empty for real ones."""
        folder, project = self.calibration.folder, self._project
        if project is None and folder is not None and self.calibration.ids:
            project = Project(folder.parents[1])
        if project is None:
            return [""] * len(self.keys)
        with project.store() as store:
            ids = [store.find(key) for key in self.keys]
            listed = store.experiments(ALL_EXPERIMENTS).rows
            real = {summary.id for summary in listed if summary.is_real}
            makers = {k: store.experiment(k).simulated_by for k in set(ids) - real}
        return [f"SIMULATED by {makers[k]}" if makers.get(k) else "" for k in ids]

    @cached_property
    def banner(self) -> str:
        """Banner over charts of all experiments."""
        return banner_of(self.banners)

    @cached_property
    def groups(self) -> list[str]:
        """Shape and layout of each experiment."""
        return [
            " ".join(str(own[name]) for name in ("shape", "layout") if name in own)
            for own in (target.conditions for target in self.targets)
        ]

    @cached_property
    def offset_axes(self) -> list[OffsetSeries]:
        """Axes along which experiments were offset; each contains the nominal ones."""
        found = []
        conditions = [target.conditions for target in self.targets]
        for name, unit in OFFSETS.items():
            offset = f"offset_{name}_{unit}"
            members = [
                k for k, own in enumerate(conditions)
                if own.get("axis") in (name, NOMINAL) and offset in own
            ]  # fmt: skip
            values = np.array([float(conditions[k][offset]) for k in members])
            if len(np.unique(values)) > 1:
                found.append(OffsetSeries(name, unit, np.array(members), values))
        return found

    def estimates(self, known: Sequence[Estimate], one: ParameterSet) -> list[Estimate]:
        """Return an estimate for each free parameter of a set, with the bounds of the search.

        Parameters
        ----------
        known : sequence of Estimate
            Those of the parameters that were assessed.
        one : ParameterSet
        """
        assessed = {estimate.label: estimate for estimate in known}
        return [
            replace(
                assessed.get(u.label) or Estimate(label=u.label, unit=u.unit, value=best),
                unit=u.unit,
                best_fit=best,
                bounds=(u.low, u.high),
                before=u.nominal,
            )
            for u, best in zip(self.space.free, one.point.tolist(), strict=True)
        ]


def title_of(data: CalibrationReportData, one: ParameterSet, word: str = "") -> str:
    """Title of a set: its experiments, and why it was selected."""
    if len(one.members) > 1:
        return f"{len(one.members)} experiments, {one.how}"
    name = data.keys[one.members[0]]
    return f"{name} ({word})" if word else name
