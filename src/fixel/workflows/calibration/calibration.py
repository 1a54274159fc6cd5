"""Calibrations as values: parameters with their estimates, errors, figures and origin."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final, overload

import numpy as np

from fixel.calibration.honest import LinearFit, draw_joint, linear_fit, quoted
from fixel.calibration.known_pushes import KnownPushes, push_target
from fixel.calibration.noise import WARNED, Noise
from fixel.calibration.objective import (
    ANGLE_SCALE,
    OPTION_UNITS,
    Comparer,
    MeanSquare,
    Robust,
    RootMeanSquare,
    combined_errors,
    lengths_of,
    outliers,
    root_mean,
)
from fixel.calibration.result import PLAIN, CalibrationResult, FitKind, ParameterSet
from fixel.calibration.study import MADE, OUT_OF_BUDGET
from fixel.calibration.target import Target, target_of
from fixel.engine_names import EngineName
from fixel.errors import InvalidInput, counted, some_of
from fixel.io.atomic import readable
from fixel.io.document import plain_numbers
from fixel.jobs import folder as files
from fixel.model import Experiment, Parameters, Scene
from fixel.model.parameters import info_of
from fixel.model.records import Estimate, estimate_table
from fixel.model.space import ParameterSpace, values_under
from fixel.results import Result, Summary
from fixel.simulation.motion import AbstractMotionModel
from fixel.table import Column, Table, shortened
from fixel.typing import FloatArray
from fixel.uncertainty.predictive import LEAST, POOL, REGION, Predictive, predictive_of
from fixel.workflows.analysis import Analysis, write_pictures
from fixel.workflows.calibration.plan import CalibrationPlan, outcome_of
from fixel.workflows.calibration.request import CalibrationRequest, call_of, enlarged_command

if TYPE_CHECKING:
    from fixel.simulation.result import Simulation

# Share of a parameter's range by which the best fit and the value to quote visibly differ.
VISIBLE: Final = 0.005
MAX_ROWS: Final = 20  # experiments in the table of a run
MAX_OUTLIERS: Final = 5


class ObjectiveValue(NamedTuple):
    """Smallest value of the function that a calibration minimised."""

    value: float
    unit: str


class MisfitStatement(NamedTuple):
    """Residuals of a calibration compared with the noise of the measurements."""

    ratio: float  # residual over noise; nan if the noise is unknown
    model_error: bool  # whether the model is wrong by much more than the noise
    reason: str  # sentences; empty without a misfit
    noise: str  # noise that the intervals assume, and its origin


class PredictionCheck(NamedTuple):
    """Recorded ends of experiments compared with predictions from the other experiments."""

    held: int  # ends inside their regions
    of: int  # experiments left out; 0 if there are too few, or none outside fixels
    probability: float = REGION  # stated for each region

    @property
    def text(self) -> str:
        """Sentence for people."""
        if not self.of:
            return f"predictions not checked: that takes {LEAST} experiments without fixels"
        regions = f"{100 * self.probability:.0f} % regions of predicted ends"
        return f"{regions} hold {self.held} of {self.of}, each left out by an approximate refit"


@final
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Calibration(Result, Mapping[str, float]):
    """Calibrated parameters, each with its interval and verdict.

    It is a mapping from names to the values that fit best, fixed ones included, and can be passed
    wherever parameters are accepted: `fixel.simulate(scene, fit)`. Values to quote in a text are
    in `estimates`, with interval and verdict; where the model is wrong, the two differ.

    Parameters
    ----------
    run : Calibrations
        Run of the calibration, with its experiments and method.
    number : int
        Index of this parameter set in the run.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> fit = fixel.calibrate(example_pushes(2), space, progress=False)
    >>> fit.identified
    ('mu_pusher',)
    >>> fit.estimates["mu_pusher"].verdict
    'identified'
    >>> fit.status
    'finished'
    """

    run: Calibrations
    number: int = 0

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __getstate__(self) -> dict[str, Any]:
        return {"run": self.run, "number": self.number}  # what is computed once is left out

    @cached_property
    def _values(self) -> dict[str, float]:
        return self.space.values(self.found.point)

    @property
    def found(self) -> ParameterSet:
        """Numbers of this parameter set, as stored."""
        return self.run.outcome.found[self.number]

    @property
    def request(self) -> CalibrationRequest:
        """Parameters and method of the run."""
        return self.run.request

    @property
    def space(self) -> ParameterSpace:
        """Parameters with the bounds of the search."""
        return self.run.request.space

    @property
    def motion(self) -> AbstractMotionModel:
        """Motion model of the simulations."""
        return self.run.request.made_motion

    @property
    def noise(self) -> Noise | None:
        """Noise of measured poses that was stated; None if it was estimated."""
        return self.run.request.noise

    @property
    def level(self) -> float | None:
        """Confidence level of the intervals; None if an earlier version stored them without it."""
        own: float | None = self.run.request.level
        return own

    @property
    def targets(self) -> list[Target]:
        """Scenes and measured poses of the experiments."""
        return [self.run.targets[m] for m in self.found.members]

    @property
    def keys_of_experiments(self) -> tuple[str, ...]:
        """Names of the experiments."""
        return tuple(self.run.outcome.keys[m] for m in self.found.members)

    @cached_property
    def estimates(self) -> Mapping[str, Estimate]:
        """Value, interval, verdict and reason of each parameter, by name."""
        known = {estimate.label: estimate for estimate in self.found.estimates}
        found: dict[str, Estimate] = {}
        for u in self.space.unknowns:
            best = self._values[u.label]
            own = known.get(u.label) or Estimate(label=u.label, unit=u.unit, value=best)
            interval = {"bounds": (u.low, u.high), "level": self.level}
            more: dict[str, Any] = {"verdict": "frozen"} if u.frozen else interval
            found[u.label] = replace(own, unit=u.unit, best_fit=best, before=u.nominal, **more)
        return MappingProxyType(found)

    @property
    def verdicts(self) -> dict[str, str]:
        """Verdict of each parameter, by name."""
        return {label: estimate.verdict for label, estimate in self.estimates.items()}

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the parameters that the experiments identify."""
        return tuple(label for label, own in self.estimates.items() if own.identified)

    @property
    def status(self) -> str:
        """End of the search: `finished`, `budget`, `interrupted` or `failed`."""
        if self.run.interrupted and not self.found.how.is_single:
            return "interrupted"
        if not np.isfinite(self.found.errors).all():
            return "failed"
        ended, note = self.found.ended, self.found.note
        limited = ended == OUT_OF_BUDGET or OUT_OF_BUDGET in note or MADE in ended
        return "budget" if limited else "finished"

    @property
    def message(self) -> str:
        """Why the search ended, in words."""
        return self.found.note or self.found.ended or str(self.found.how)

    @property
    def evaluations(self) -> int:
        """Number of parameter sets that the search simulated."""
        return 0 if self.found.trace is None else len(self.found.trace.errors)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on what is doubtful about the result."""
        slight = self.misfit.ratio < WARNED  # not if the noise is unknown
        warned = () if slight else self.found.misfit
        note = (self.found.note,) if self.found.note else ()
        return (*warned, *note, *self.run.skipped)

    @cached_property
    def rms_error(self) -> float:
        """Root mean square distance of simulated and measured poses [m], angles at 35 mm per
        radian, whatever was minimised."""
        return self._rms(self.found.errors, self.found.point)

    @property
    def nominal_errors(self) -> FloatArray:
        """Errors (n,) of the experiments before calibration, in the unit of `objective`."""
        return self.run.outcome.nominal[list(self.found.members)]

    @cached_property
    def nominal_rms_error(self) -> float:
        """The same error with the start values, before calibration [m]."""
        return self._rms(self.nominal_errors, self.space.nominal)

    def _rms(self, errors: FloatArray, point: FloatArray) -> float:
        error = self.request.made_error
        if error.angle_scale == ANGLE_SCALE and isinstance(error, MeanSquare | RootMeanSquare):
            return 1e-3 * root_mean(errors, error.unit)
        comparer = Comparer(self.targets, self.space, MeanSquare(), self.motion)
        return 1e-3 * math.sqrt(float(np.mean(comparer.errors_at(point))))

    @property
    def objective(self) -> ObjectiveValue:
        """Smallest value of the function that was minimised, with its unit."""
        (value,) = combined_errors(self.found.errors[None], self.request.combine).tolist()
        return ObjectiveValue(value, self.request.made_error.unit)

    @property
    def misfit(self) -> MisfitStatement:
        """Residuals compared with the noise of the measurements."""
        own, ratio = self.found, self.found.misfit_ratio
        return MisfitStatement(ratio, ratio >= WARNED, " ".join(own.misfit), own.noise)

    @property
    def prediction_check(self) -> PredictionCheck | None:
        """Recorded ends inside the regions predicted without them, by draws of `predictive`.

        A step of least squares leaves an experiment out. None for a calibration of one experiment
        or without verdicts.
        """
        own = self.found.prediction_check
        return None if own is None else PredictionCheck(*own)

    @property
    def solutions(self) -> list[dict[str, float]]:
        """Distinct parameter sets that fit almost equally well, the best first."""
        return [self.space.values(point) for point in self.found.solutions]

    @property
    def errors(self) -> Table:
        """Errors of the experiments before and after the calibration, one row for each."""
        unit = self.request.made_error.unit
        head = ("experiment", Column("nominal", unit, ".4g"), Column("calibrated", unit, ".4g"))
        errors = self.nominal_errors.tolist(), self.found.errors.tolist()
        return Table(head, zip(self.keys_of_experiments, *errors, strict=True))

    def values_for(
        self, experiment: Experiment | None = None, /, **conditions: str | float
    ) -> dict[str, float]:
        """Return the parameters by name for one experiment, or for its conditions.

        Parameters
        ----------
        experiment : Experiment, optional
            Experiment whose conditions decide.
        **conditions
            Conditions, such as `surface="abs"`, for parameters with a value for each of them.

        Returns
        -------
        dict from name to float
            Values in SI units, which `fixel.simulate` accepts.

        Raises
        ------
        InvalidInput
            A parameter has no value under these conditions.
        """
        known: dict[str, str | float] = dict(conditions)
        if experiment is not None:
            known = {**experiment.conditions, "experiment": experiment.key, **known}
        return values_under(self, known)

    @cached_property
    def correlation(self) -> FloatArray:
        """Correlations (n_free, n_free) of the parameters about the best fit.

        Those that the search changed, in the order of `space.labels`; simulated when first asked.
        """
        return self._linear.correlation

    @cached_property
    def _linear(self) -> LinearFit:
        comparer = Comparer(self.targets, self.space, None, self.motion)
        return linear_fit(comparer, self.found.point)

    def samples(
        self, n: int = 64, seed: int = 0, **conditions: str | float
    ) -> dict[str, FloatArray]:
        """Return n samples of the parameters for an experiment, (n,) each by name.

        Normal distributions with the values and intervals of `estimates`, within the bounds of the
        search, and the correlations of least squares. An interval with one open end has the width
        of its other half; a parameter without ends is even within its bounds.

        Parameters
        ----------
        n, seed : int
        **conditions
            Conditions, such as `surface="abs"`, for parameters with a value for each of them.
        """
        return self.space.columns(self._draw(n, seed), conditions)

    @cached_property
    def predictive(self) -> Predictive:
        """Parameter sets and the error of ends with which plans predict other pushes.

        Simulated when first asked.
        """
        value = np.array([self.estimates[label].value for label in self.space.labels])
        of = (self.targets, self.space, self.motion, self.found.point)
        return predictive_of(*of, value, self._draw(POOL, 0), self._linear.left_out())

    @property
    def _draw(self) -> Callable[[int, int], FloatArray]:
        """Function of a number and a seed that draws samples (n, n_free) of the parameters."""
        space = self.space
        value, sd = quoted(self.estimates.values(), space.labels, self.level)
        return partial(draw_joint, value, space.low, space.high, sd, self.correlation)

    @cached_property
    def known(self) -> KnownPushes:
        """Parts, surfaces, laboratories, sides and speeds of the experiments."""
        return KnownPushes.of(self.targets)

    def unseen(self, of: Scene | Experiment, /, **conditions: str | float) -> tuple[str, ...]:
        """Return what is new about a push: a part, surface, laboratory, side, speed or travel.

        Parameters
        ----------
        of : Scene or Experiment
        **conditions
            Conditions that a bare scene does not have, such as `surface="abs"`.

        Returns
        -------
        tuple of str
            Sentences; empty for a push like the experiments of the calibration.

        Raises
        ------
        InvalidInput
            An experiment has no scene or no motion.
        """
        return self.known.texts(push_target(of, conditions))

    def simulate(self, of: Scene | Experiment, /, **options: Any) -> Simulation:
        """Simulate a scene or an experiment with the calibrated parameters and motion model.

        Parameters
        ----------
        of : Scene or Experiment
        **options
            Options of `fixel.simulate`, such as `duration`.
        """
        from fixel.simulation.simulate import simulate

        scene, values = (
            (of, self.values_for())
            if isinstance(of, Scene)
            else (target_of(of).case.scene, self.values_for(of))
        )
        return simulate(scene, Parameters(values), motion=self.motion, **options)

    def compare(self, experiments: Sequence[Experiment], **options: Any) -> Any:
        """Compare experiments with simulations before and after; see `fixel.compare`."""
        return import_module("fixel").compare(experiments, self, **options)

    def residuals(self, experiment: Experiment) -> FloatArray:
        """Return simulated less measured poses (n, 3) at the measured times [m, m, rad].

        Parameters
        ----------
        experiment : Experiment
            One with a scene; it need not be one of those calibrated.

        Raises
        ------
        InvalidInput
            It has no scene, or its simulation does not reach the end.
        """
        target = target_of(experiment)
        comparer = Comparer([target], self.space, None, self.motion)
        difference, good, reasons = comparer.differences(
            np.zeros(1, np.int64), self.found.point[None]
        )
        if not good[0]:
            where, found = f"experiment {experiment.key}", f"no complete simulation ({reasons[0]})"
            raise InvalidInput(where, found=found, expected="one")
        return np.asarray(difference[0, : len(target.pose)])

    @property
    def command(self) -> str:
        """Shell command of the same calibration; empty if its experiments are in no project."""
        return self.run.command

    @property
    def call(self) -> str:
        """Python expression of the same calibration."""
        return self.run.call

    # --- what is shown --------------------------------------------------------------------------

    @cached_property
    def analysis(self) -> Analysis:
        """Report of the result, which terminal, page and `fixel report` show."""
        found, estimates = self.found, self.estimates.values()
        reasons = [f"{e.label}: {e.reason}" for e in estimates if e.reason and not e.identified]
        run, others = self.run, [note for note in self.warnings if note not in found.misfit]
        return Analysis(
            kind="calibrate",
            title=f"Calibration of {self.subject}",
            question={},
            headline=(
                self._heading(),
                self._error_note(),
                *self._prediction_notes(),
                *self._no_misfit(),
                *([self.prediction_check.text] if self.prediction_check else []),
                *run.sample_note,
            ),
            warnings=(*([self.misfit.reason] if found.misfit else []), *others),
            tables=(estimate_table(estimates, self.level),),
            notes=(*reasons, *self._outlier_notes(), *self._further_notes()),
            calibrations=tuple(run.ids[self.number : self.number + 1]),
            command=self.command,
            seconds=found.seconds,
        )

    def _summary(self) -> Summary:
        own = self.analysis
        notes = [*own.notes, *own.headline[1:], *own.warnings]
        return Summary(own.headline[0], own.tables, notes, self.details)

    @property
    def subject(self) -> str:
        """Name of the experiment, or number of several."""
        n = len(self.found.members)
        return self.keys_of_experiments[0] if n == 1 else f"{n} experiments"

    def _heading(self) -> str:
        how = self.status.replace("budget", "ended by its limit")
        engine = EngineName.of(self.request.motion).short
        of = f"Calibration of {self.subject} ({engine})"
        return f"{of}: {how} after {self.evaluations} evaluations"

    def _error_note(self) -> str:
        unit, errors = self.request.made_error.unit, self.found.errors
        before = root_mean(self.nominal_errors, unit)
        begin = "" if math.isnan(before) else f"{before:.3g} mm before, "
        words = {"end-pose": "end pose", "robust": "robust mean"}
        how = words.get(self.request.error.name, "root mean square")
        scale = 1e3 * self.request.made_error.angle_scale
        return (
            f"error: {begin}{root_mean(errors, unit):.3g} mm after calibration"
            f" ({how}; 1 rad counts as {scale:g} mm)"
        )

    def _prediction_notes(self) -> list[str]:
        """Values that predict best, where they visibly differ from those to quote."""
        fitted = [
            f"{own.label} {own.text(own.best_fit)}"
            for own in self.estimates.values()
            if own.best_fit is not None and own.bounds and own.is_known and own.is_assessed
            if abs(own.best_fit - own.value) > VISIBLE * (own.bounds[1] - own.bounds[0])
        ]
        return [f"simulations use the best fit: {', '.join(fitted)}"] if fitted else []

    def _no_misfit(self) -> list[str]:
        if self.found.misfit or math.isnan(self.misfit.ratio):
            return []
        noise = self.found.noise or "a noise that was not stored"
        return [f"no misfit detected; intervals assume {noise}"]

    def _outlier_notes(self) -> list[str]:
        """Name the outliers, and what to do about them."""
        errors, unit = self.found.errors, self.request.made_error.unit
        found = outliers(errors, unit)
        if not found:
            return []
        named = [
            f"{self.keys_of_experiments[k]} ({lengths_of(errors[k], unit):.3g} mm)" for k in found
        ]
        share = float(errors[found].sum() / errors[np.isfinite(errors)].sum())
        robust = self.request.error.name == Robust.name
        return [
            f"{counted(len(found), 'outlier')} among {len(errors)} experiments, with"
            f" {100 * share:.0f} % of the summed error: {some_of(named, MAX_OUTLIERS)}"
            + ("" if robust else f"; the error {Robust.name} reduces their weight")
        ]

    def _further_notes(self) -> list[str]:
        """Number of solutions, parameters that different parts share, and a larger model."""
        n = len(self.found.solutions)
        notes = [f"{n} distinct parameter sets fit almost equally well"] if n > 1 else []
        shapes = {own.case.scene.bodies[0].shape.outline.tobytes() for own in self.targets}
        shared = [u.name for u in self.space.free if info_of(u.name).stands_for and not u.where]
        if len(shapes) > 1 and shared:
            how = "the key where of a file for --space, or by= in Python, gives each its own"
            notes.append(f"{len(shapes)} different parts share {', '.join(shared)}; {how}")
        misfit = self.found.misfit_ratio >= WARNED
        larger = enlarged_command(self.run.asked, self.request) if misfit else ""
        return [*notes, f"a larger model may fit better: {larger}"] if larger else notes

    @property
    def details(self) -> dict[str, str]:
        """Method and origin, by name."""
        from importlib.metadata import version

        details = {
            **{name: self._worded(name, own) for name, own in self.request.listed().items()},
            "noise": self.found.noise,
            "ended": self.message,
            "took": f"{self.found.seconds:.3g} s",
            "fixel": version("fixel"),
            "call": self.call,
            "command": self.command,
        }
        return {name: value for name, value in details.items() if value}

    def _worded(self, name: str, value: str | float) -> str:
        """Return an option of the request as text, with its unit."""
        if isinstance(getattr(self.request, name, None), bool):
            return "yes" if value else "no"
        unit = OPTION_UNITS.get(name.removeprefix("error."), "")
        return value if isinstance(value, str) else f"{value:g} {unit}".rstrip()

    def _data(self) -> Table:
        names = ("value", "low", "high", "unit", "verdict", "reason", "best_fit")
        rows = [(k, *(getattr(e, name) for name in names)) for k, e in self.estimates.items()]
        return Table(("parameter", *names), rows)


@final
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Calibrations(CalibrationPlan, Result, Sequence[Calibration]):
    """Calibrations of one run: one for each experiment, or the steps of a campaign.

    Its other fields are those of the plan: parameters and method as `request`, the experiments as
    `targets`, and skipped ones as `left_out`.

    Parameters
    ----------
    outcome : CalibrationResult
        Numbers of all parameter sets.
    command : str
        Shell command of the same run.
    folder : Path, optional
        Folder of the job, if it has one.
    ids : sequence of int
        Ids of the stored calibrations, if they are in a project.
    interrupted : bool
        Whether the run was interrupted before its end.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> fits = fixel.calibrate_each(example_pushes(2), space, verdicts=False, progress=False)
    >>> len(fits)
    2
    >>> print(f"{fits[0]['mu_pusher']:.2f}")
    0.25
    """

    outcome: CalibrationResult
    command: str = ""
    folder: Path | None = field(default=None, compare=False)
    ids: Sequence[int] = field(default=(), compare=False)
    interrupted: bool = False

    @overload
    def __getitem__(self, k: int) -> Calibration: ...
    @overload
    def __getitem__(self, k: slice) -> list[Calibration]: ...
    def __getitem__(self, k: int | slice) -> Calibration | list[Calibration]:
        if isinstance(k, slice):
            return [self[own] for own in range(*k.indices(len(self)))]
        return Calibration(run=self, number=range(len(self))[k])

    def __len__(self) -> int:
        return len(self.outcome.found)

    @property
    def each(self) -> list[Calibration]:
        """Best calibration of each single experiment, its own or a neighbour's."""
        # Neighbours' sets follow the experiments' own, and only where they are better.
        return [*{fit.found.members: fit for fit in self if fit.found.how.is_single}.values()]

    @property
    def joint(self) -> Calibration | None:
        """Best calibration of all experiments together; None if there was none."""
        kinds = (FitKind.DIRECT, FitKind.STORED)
        return next((fit for fit in self if fit.found.how in kinds), None)

    @property
    def skipped(self) -> tuple[str, ...]:
        """Sentences on the experiments that were left out, one for each reason."""
        reasons: dict[str, list[str]] = {}
        for key, reason in self.left_out.items():
            reasons.setdefault(reason.removeprefix(f"{key}: "), []).append(key)
        return tuple(f"skipped {some_of(keys, 1)}: {reason}" for reason, keys in reasons.items())

    def draw(self, folder: Path) -> list[Path]:
        """Draw all charts into a folder; return PNG, PDF and CSV of each."""
        pictures = import_module("fixel.workflows.calibration.report").pictures_of(self)
        return write_pictures(folder, pictures)

    def summary(self) -> dict[str, Any]:
        """Return plain values, for `--json`; infinite errors become None."""
        outcome = self.outcome
        return {
            "name": self.request.name,
            "mode": self.request.mode,
            "job": str(self.folder),
            "experiments": list(outcome.keys),
            "left_out": dict(self.left_out),
            "sample_of": self.request.sample_of,
            "error": self.request.error.name,
            "unit": self.request.made_error.unit,
            "nominal_error": plain_numbers(outcome.nominal),
            "found": [_plain(fit, number) for fit, number in zip(self, self.ids, strict=True)],
        }

    @property
    def call(self) -> str:
        """Python expression of the same run; empty if an earlier version stored the run without
        its complete request."""
        return "" if self.request.level is None else call_of(self.request, self.source)

    @property
    def sample_note(self) -> tuple[str, ...]:
        """Sentence on the sample of the experiments; empty without one."""
        n, seed = self.request.sample_of, self.request.seed
        if n is None:
            return ()
        return (f"a random sample of {len(self.outcome.keys)} of {n} experiments (seed {seed})",)

    @cached_property
    def analysis(self) -> Analysis:
        """Report of the run, which the terminal shows."""
        if len(self) == 1:
            return self[0].analysis
        free, unit = self.request.space.free, self.request.made_error.unit
        shown = self.each or [*self]
        rows = [
            (
                one.subject if len(one.found.members) == 1 else f"{one.subject}, {one.found.how}",
                root_mean(one.nominal_errors, unit),
                root_mean(one.found.errors, unit),
                *(one.estimates[u.label].value_text for u in free),
            )
            for one in shown
        ]
        head: list[Column | str] = ["experiments", Column("before", "mm", ".3g")]
        head += [Column("error", "mm", ".3g"), *(u.label for u in free)]
        notes = shortened([], len(rows) - MAX_ROWS)
        parts = [one.analysis for one in self if not one.found.how.is_single]
        experiments = counted(len(self.outcome.keys), "experiment")
        title = f"{counted(len(self), 'calibration')} of {experiments}"
        ended = " (interrupted)" if self.interrupted else ""
        return Analysis(
            kind="calibrate",
            title=title,
            question={},
            headline=(title + ended, *self.sample_note),
            warnings=(*self.skipped, *(w for p in parts for w in p.warnings)),
            tables=(
                Table(head, rows[:MAX_ROWS]),
                *(replace(part.tables[0], title=part.headline[0]) for part in parts),
            ),
            notes=(*notes, *self._verdict_notes(), *(x for p in parts for x in p.headline[1:])),
            calibrations=tuple(self.ids),
            command=self.command,
            seconds=sum(one.found.seconds for one in self),
        )

    def _verdict_notes(self) -> list[str]:
        """Count how often each parameter of single experiments has which verdict."""
        notes, single = [], self.each
        for u in self.request.space.free:
            words = Counter(one.estimates[u.label].word for one in single)
            if any(words):
                counts = (f"{word} in {n}" for word, n in words.most_common())
                notes.append(f"{u.label}: {', '.join(counts)}")
        return notes

    def _summary(self) -> Summary:
        own = self.analysis
        return Summary(own.headline[0], own.tables, [*own.headline[1:], *own.warnings, *own.notes])

    def _data(self) -> Table:
        labels, names = self.request.space.labels, ("value", "low", "high", "verdict")
        head: list[Column | str] = ["experiments", "how", Column("rms_error", "m")]
        head += [f"{label} {name}" for label in labels for name in names]
        rows = [
            (
                ", ".join(one.keys_of_experiments),
                str(one.found.how),
                one.rms_error,
                *(getattr(one.estimates[label], name) for label in labels for name in names),
            )
            for one in self
        ]
        return Table(head, rows)


def collect(plan: CalibrationPlan, folder: Path) -> Calibrations:
    """Load the result of the finished job of a plan."""
    path = folder / files.RESULT
    with readable(path, f"delete that file, then: fixel jobs resume {shlex.quote(str(folder))}"):
        return Calibrations(**vars(plan), outcome=outcome_of(path.read_bytes()), folder=folder)


def _plain(fit: Calibration, calibration_id: int | None) -> dict[str, Any]:
    one, labels = fit.found, fit.run.outcome.labels
    return {
        "calibration": calibration_id,
        **{name: getattr(one, name) for name in PLAIN if name not in ("members", "profiles")},
        "experiments": list(fit.keys_of_experiments),
        "misfit": list(one.misfit),
        "misfit_ratio": plain_numbers(one.misfit_ratio),
        "parameters": {label: fit.estimates[label].value for label in labels},
        "best_fit": dict(zip(labels, one.point.tolist(), strict=True)),
        "errors": plain_numbers(one.errors),
        "evaluations": fit.evaluations,
        "ended": one.ended,
        "prediction_check": fit.prediction_check and fit.prediction_check._asdict(),
        "solutions": [dict(zip(labels, s, strict=True)) for s in one.solutions.tolist()],
        "estimates": [estimate.stored() for estimate in one.estimates],
    }
