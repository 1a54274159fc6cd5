"""Error bounds from held-out errors, their report, and their place in a project."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from fixel.calibration.known_pushes import KnownPushes, with_units
from fixel.calibration.objective import Comparer
from fixel.calibration.target import Target, same_configuration
from fixel.database.project import ANALYSES, Project
from fixel.domain.cells import label_of
from fixel.domain.error_bound import min_experiments
from fixel.domain.evidence import default_folds
from fixel.domain.held_out import Apart, CalibrationModel, end_errors, held_out, stepper_for
from fixel.domain.push_bound import ErrorBound, LeftOutErrors, features_of
from fixel.drawing.domain import bound_chart
from fixel.errors import InvalidInput, counted
from fixel.progress import Reporter
from fixel.typing import FloatArray, IntArray
from fixel.workflows.analysis import Analysis, AnalysisReport, Picture, StoredAnswer
from fixel.workflows.calibration.execution import select_experiments
from fixel.workflows.domain.evidence import FOLDER, mark_of
from fixel.workflows.domain.fits import ProjectRequest, fit_store, stored_model

JSON: Final = ("folder", "pictures")  # what `--json` has besides numbers
# Largest number of fits with groups left out; more groups are left out several at a time.
MAX_FOLDS: Final = 24


class BoundAnswer(NamedTuple):
    """Error bounds of experiments of a project."""

    bound: ErrorBound
    experiments: list[int]  # ids
    calibration: int | None  # calibration at which the fits started
    left_out: dict[str, str]  # reason why an experiment cannot be compared, by its name
    is_real: bool


def bound_experiments(project: Project, asked: Any, progress: Reporter) -> BoundAnswer:
    """Return the error bounds of the requested experiments of a project."""
    with project.store() as store:
        of = ProjectRequest(project, store, asked)
        chosen = select_experiments(store, (), of.query)
        started = stored_model(of, chosen.targets)
        folder = project.folder / ANALYSES / FOLDER / f"bound-{mark_of(of, chosen.ids)}"
        bound = bound_of(chosen.targets, started.model, asked, folder, progress)
        real = all(row.is_real for row in store.experiments(of.query).rows)
    return BoundAnswer(bound, chosen.ids, started.calibration, dict(chosen.left_out), real)


def report_of(answer: BoundAnswer) -> AnalysisReport:
    """Return headline, warnings, table, chart and numbers of error bounds."""
    bound, n = answer.bound, len(answer.left_out)
    summary = bound._summary()
    medians = [f"{row[2]:.2g}" for row in summary.tables[0].rows]
    why = next(iter(answer.left_out.values()), "")
    caption = "Held-out errors of end positions against their bounds; those below the line hold."
    banner = "" if answer.is_real else "SIMULATED"
    return AnalysisReport(
        Analysis(
            kind="error-bound",
            title="Error bounds of untried pushes",
            question={},
            headline=(
                f"The errors of {100.0 * bound.level:g} % of new pushes stay within their bounds,"
                f" at the median {medians[0]} mm and {medians[1]} deg ({len(bound.keys)}"
                " experiments, held out).",
            ),
            warnings=(f"{counted(n, 'experiment')} cannot be compared: {why}",) if n else (),
            tables=tuple(summary.tables),
            notes=tuple(summary.notes),
            references=("vovk2005", "barber2021", "dunn2022", "lee2023"),
            numbers={
                "level": bound.level,
                "coverage": {name: [*share] for name, share in bound.coverage.items()},
                "experiments": bound.to_dict(),
            },
            calibrations=() if answer.calibration is None else (answer.calibration,),
            experiments=tuple(answer.experiments),
        ),
        [Picture("bounds", bound_chart(bound), banner, caption)],
    )


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that most users need next."""
    return ["report"] if done.drawn else [*done.again, "--plot", "bounds"]


# --- computation --------------------------------------------------------------------------------


def bound_of(
    targets: Sequence[Target],
    model: CalibrationModel,
    asked: Any,
    store: str | Path | None,
    progress: Reporter,
) -> ErrorBound:
    """Return the error bounds of experiments; `store` is a folder for finished fits."""
    features = features_of(targets)
    judged = _first_of_repeated(targets, features)
    n, least = len(targets), min_experiments(asked.level)
    if len(judged) < least:
        raise InvalidInput(
            "experiments",
            found=f"{n}" if n == len(judged) else f"{n}, of {len(judged)} different pushes",
            expected=f"{least} at least for bounds with a probability of {100 * asked.level:g} %",
            hint="run more experiments, or choose a lower level",
        )
    labels = tuple(label_of(target.conditions, asked.groups) for target in targets)
    for name in asked.leave_out:
        _check_units(with_units(targets, name), name, model)
    apart = Apart(
        folds=default_folds(len(targets)) if asked.folds is None else asked.folds, seed=asked.seed
    )
    position, angle, fold = _errors(targets, model, apart, asked, store, progress)
    left = []
    for name in asked.leave_out:
        progress.stage = f"leaving out {name}"
        left.append(_left_out(targets, name, model, asked, store, progress))
    return ErrorBound(
        keys=tuple(targets[k].key for k in judged),
        features=features[judged],
        position=position[judged],
        angle=angle[judged],
        level=asked.level,
        group=tuple(labels[k] for k in judged),
        groups=asked.groups,
        fold=fold[judged],
        seed=asked.seed,
        known=KnownPushes.of([targets[k] for k in judged], asked.groups),
        left_out=tuple(own.rows(judged) for own in left),
    )


def _errors(
    targets: Sequence[Target],
    model: CalibrationModel,
    apart: Apart,
    asked: Any,
    store: str | Path | None,
    progress: Reporter,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return held-out errors of end positions and angles (n,), and the fold of each."""
    finished = fit_store(store, targets, model, apart)
    found = held_out(targets, model, apart, finished, progress, asked.threads)
    comparer = Comparer(
        targets, model.space, model.error, model.motion, stepper_for(targets), asked.threads
    )
    return *end_errors(comparer, found), found.fold


def _left_out(
    targets: Sequence[Target],
    name: str,
    model: CalibrationModel,
    asked: Any,
    store: str | Path | None,
    progress: Reporter,
) -> LeftOutErrors:
    """Return errors under fits without the values of a condition."""
    own = with_units(targets, name)
    units = tuple(label_of(target.conditions, (name,)) for target in own)
    apart = Apart(out=name, folds=min(len(set(units)), MAX_FOLDS), seed=asked.seed)
    place = None if store is None else Path(store) / f"without-{name}"
    position, angle, _ = _errors(own, model, apart, asked, place, progress)
    return LeftOutErrors(name, units, position, angle)


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
