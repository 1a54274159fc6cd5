"""Comparison of measured with simulated motion, for several experiments and models."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import degrees
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.datasets.experiments import Experiments, different
from fixel.errors import InvalidInput, counted
from fixel.kernels import codes
from fixel.model import Experiment, Parameters
from fixel.model.records import SimulationRecord
from fixel.progress import ProgressOption, show_progress
from fixel.results import Result, Summary
from fixel.simulation import AbstractMotionModel
from fixel.simulation.motion import motion_model
from fixel.table import Column, Table
from fixel.trust import permit
from fixel.workflows.project.compare import PathComparison, compare_path, compare_run

Model = Mapping[str, float] | None  # values of parameters, a Calibration, or the scene's own values

NOMINAL: Final = "nominal"
CALIBRATED: Final = "calibrated"
MAX_WORST: Final = 5  # experiments with the largest errors that a summary names


class ComparedModel(NamedTuple):
    """One experiment, simulated with one model."""

    model: str
    use: str  # "fitted", "held out", or empty for a model that was not fitted
    run: PathComparison
    unseen: tuple[str, ...] = ()  # what no experiment of the calibration has

    @property
    def error_mm(self) -> float | None:
        """Root mean square error, angles at 35 mm per radian [mm]."""
        square = self.run.error_mm2
        return None if square is None else square**0.5


@final
@dataclass(frozen=True, repr=False, eq=False)
class Comparison(Result):
    """Errors of simulations of experiments, one row for each experiment and model.

    Parameters
    ----------
    rows : tuple of ComparedModel
    skipped : tuple of str
        Experiments that cannot be compared, with the reason.

    Attributes
    ----------
    models : tuple of str
        Names of the models.
    experiments : Experiments
        The experiments with their errors, which `where("error>5")` selects by.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> found = fixel.compare(example_pushes(2), {"low": {"mu_pusher": 0.1}}, progress=False)
    >>> found.models
    ('low',)
    """

    rows: tuple[ComparedModel, ...]
    skipped: tuple[str, ...] = ()

    @property
    def models(self) -> tuple[str, ...]:
        """Names of the models."""
        return tuple(dict.fromkeys(row.model for row in self.rows))

    @property
    def experiments(self) -> Experiments:
        """Experiments with their errors: before of the first model, after of the last one."""
        first, last = self.models[0], self.models[-1]
        before = {row.run.experiment.key: row.run.error_mm2 for row in self.of(first)}
        after = {row.run.experiment.key: row.run.error_mm2 for row in self.of(last)}
        found = Experiments.of([row.run.experiment for row in self.of(first)])
        entries = []
        for entry in found.entries:
            key = entry.row.key
            details = entry.details._replace(before_mm2=before[key], after_mm2=after.get(key))
            entries.append(entry._replace(details=details))
        return Experiments(tuple(entries))

    def of(self, model: str) -> list[ComparedModel]:
        """Return the rows of one model."""
        return [row for row in self.rows if row.model == model]

    def plot(self, kind: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the errors of all experiments, or the motion of a single one.

        Parameters
        ----------
        kind : str, optional
            ``"errors"``: share of the experiments below an error, for each model; ``"motion"``:
            measured and simulated motion of one experiment. By default the second for a single
            experiment.
        ax : matplotlib.axes.Axes, optional
        **options
            `experiment`, the key of the one to draw; `model`.

        Returns
        -------
        matplotlib.axes.Axes, or an array of them
        """
        single = len({row.run.experiment.key for row in self.rows}) == 1
        chosen = kind or ("motion" if single or "experiment" in options else "errors")
        return Result.plot(self, chosen, ax=ax, **options)

    def _summary(self) -> Summary:
        keys = dict.fromkeys(row.run.experiment.key for row in self.rows)
        models = counted(len(self.models), "model")
        heading = f"Comparison of {counted(len(keys), 'experiment')} with {models}"
        unseen = self._unseen()
        if len(keys) == 1:
            title = f"Comparison of experiment {next(iter(keys))}"
            distance = "position: root mean square distance; end, angle: at the last measured pose"
            return Summary(title, [self._listed()], [distance, *self._failed()], unseen=unseen)
        notes = [f"skipped {len(self.skipped)}: {self.skipped[0]}"] if self.skipped else []
        notes += ["error: root mean square, angles at 35 mm per radian", *self._failed()]
        return Summary(heading, [self._by_model(), self._worst()], notes, unseen=unseen)

    def _failed(self) -> list[str]:
        """Return advice for each status of simulations that failed, with the first experiment."""
        first = {row.run.status: row.run.experiment.key for row in reversed(self.rows)}
        known = zip(codes.STATUS_NAMES, codes.STATUS_ADVICE, strict=True)
        return [
            f"{first[status]}: {status}. {text}"
            for status, text in known
            if status in first and text
        ]

    def _unseen(self) -> list[str]:
        """Return what no experiment of a calibration has, with the number of its experiments."""
        counts = Counter(text for row in self.rows for text in row.unseen)
        one = len({row.run.experiment.key for row in self.rows}) == 1
        return [text if one else f"{text} ({n} compared)" for text, n in counts.items()]

    def _by_model(self) -> Table:
        rows = []
        for model, use in dict.fromkeys((row.model, row.use) for row in self.rows):
            errors = [row.error_mm for row in self.of(model) if row.use == use]
            good = [error for error in errors if error is not None]
            middle, high = np.quantile(good, (0.5, 0.9)) if good else (None, None)
            most = max(good, default=None)
            rows.append((model, use, len(errors), middle, high, most, len(errors) - len(good)))
        errors_of = (Column(name, "mm", ".2f") for name in ("median", "90 %", "largest"))
        head = (Column("model"), Column("use"), Column("experiments"), *errors_of, Column("failed"))
        return Table(head, rows, title="error", left=2)

    def _worst(self) -> Table:
        last = [row for row in self.of(self.models[-1]) if row.error_mm is not None]
        worst = sorted(last, key=lambda row: row.error_mm or 0.0, reverse=True)[:MAX_WORST]
        rows = [(row.run.experiment.key, row.error_mm) for row in worst]
        columns = (Column("experiment"), Column("error", "mm", ".2f"))
        return Table(columns, rows, title=f"largest errors, {self.models[-1]}")

    def _listed(self) -> Table:
        rows = [
            (
                *(row.model, row.use, row.run.status, row.error_mm),
                *(None if x is None else 1e3 * x for x in _positions(row.run)),
                None if row.run.final_angle is None else degrees(row.run.final_angle),
            )
            for row in self.rows
        ]
        names = ("error", "position", "end")
        columns = (
            *map(Column, ("model", "use", "status")),
            *(Column(n, "mm", ".2f") for n in names),
        )
        return Table((*columns, Column("angle", "deg", ".2f")), rows, left=3)

    def _data(self) -> Table:
        """Rows in SI units, apart from the error."""
        head = (
            *map(Column, ("experiment", "model", "use", "unseen", "status")),
            *(Column("error", "mm"), Column("position_rms", "m"), Column("final_position", "m")),
            *(Column("final_angle", "rad"), Column("same_contact_mode")),
        )
        rows = [
            (
                *(row.run.experiment.key, row.model, row.use, "; ".join(row.unseen)),
                *(row.run.status, row.error_mm),
                *(*_positions(row.run), row.run.final_angle, row.run.same_contact_mode),
            )
            for row in self.rows
        ]
        return Table(head, rows)


def _positions(run: PathComparison) -> tuple[float | None, float | None]:
    return run.position_rms, run.final_position


def compare(
    experiments: Experiment | Iterable[Experiment],
    models: Model | Mapping[str, Model] = None,
    *,
    motion: AbstractMotionModel | str | None = None,
    progress: ProgressOption = None,
) -> Comparison:
    """Simulate experiments from their first pose on, and compare with the measured poses.

    Parameters
    ----------
    experiments : Experiment or iterable of Experiment
        Experiments with a scene.
    models : mapping, Calibration or mapping of str to one of them, optional
        Values of parameters, such as `{"mu_pusher": 0.2}`; or a calibration, which is compared with
        the nominal values of the scenes; simulations by another program, as a `SimulationRecord`
        for each experiment by its full name; or several of these by name. None: the nominal values.
    motion : AbstractMotionModel or str, optional
        Motion model, such as `"quasistatic"`; by default that of the calibration, else dynamic.
    progress : bool or callable, optional
        None: a bar in terminals and notebooks; False: nothing; or a function that is called.

    Returns
    -------
    Comparison
        Rows are "fitted" or "held out" for models that are calibrations.

    Raises
    ------
    InvalidInput
        No experiment has a scene and motion to compare with, or a parameter changes nothing.

    Examples
    --------
    >>> import fixel
    >>> pushes = fixel.datasets.example()[:4]
    >>> found = fixel.compare(pushes, {"scene": None, "low": {"mu_pusher": 0.1}}, progress=False)
    >>> found.models
    ('scene', 'low')
    >>> len(found.experiments.where("before<3"))
    3
    """
    permit(motion)
    named = _named(models)
    several = different(experiments)
    rows: list[ComparedModel] = []
    skipped: list[str] = []
    total = len(several) * len(named)
    with show_progress(progress, "comparing") as report:
        report(0, total)
        for k, experiment in enumerate(several):
            try:
                rows += [_compared(experiment, name, named, motion) for name in named]
            except InvalidInput as problem:
                if len(several) == 1 or problem.where.startswith("parameters"):
                    raise
                skipped.append(str(problem))
            report((k + 1) * len(named), total)
    if not rows:
        raise InvalidInput(
            "experiments",
            found=f"none ({skipped[0]})" if skipped else "none",
            expected="at least one with a scene and motion to compare with",
            hint="give scenes with read_experiments(..., scene=...) or experiments.with_scene(...)",
        )
    return Comparison(tuple(rows), tuple(skipped))


def _named(models: Any) -> dict[str, Any]:
    """Return models by name."""
    if models is None:
        return {NOMINAL: None}
    if hasattr(models, "values_for"):
        return {NOMINAL: None, CALIBRATED: models}
    if not isinstance(models, Mapping) or not models:
        found, expected = models, "values of parameters, a calibration, or several by name"
        raise InvalidInput("models", found=found, expected=expected)
    several = any(model is None or isinstance(model, Mapping) for model in models.values())
    return dict(models) if several else {"given": models}


def _compared(
    experiment: Experiment,
    name: str,
    models: Mapping[str, Any],
    motion: AbstractMotionModel | str | None,
) -> ComparedModel:
    """Simulate an experiment with one of the models; nominal values move as calibrated ones do."""
    model = models[name]
    if isinstance(model, Mapping) and any(isinstance(v, SimulationRecord) for v in model.values()):
        if experiment.key not in model:
            found = f"no simulation by {name!r}"
            raise InvalidInput(f"experiment {experiment.key}", found=found, expected="one")
        return ComparedModel(name, "", compare_path(experiment, model[experiment.key]))
    fitted = model if hasattr(model, "values_for") else None
    like = fitted or next((m for m in models.values() if hasattr(m, "values_for")), None)
    own = like.motion if motion is None and like is not None else motion
    chosen = None if own is None else motion_model(own)
    if fitted is None:
        return ComparedModel(name, "", compare_run(experiment, Parameters(model or {}), chosen))
    values = Parameters(fitted.values_for(experiment))
    ends = [own.pose[-1] for own in fitted.targets if own.key == experiment.key]
    known = any((experiment.trajectory.pose == end).all(axis=1).any() for end in ends)
    run = compare_run(experiment, values, chosen)
    return ComparedModel(name, "fitted" if known else "held out", run, fitted.unseen(experiment))
