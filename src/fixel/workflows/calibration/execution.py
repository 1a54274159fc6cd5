"""Run calibrations in this process, in a folder, or in a project."""

from __future__ import annotations

import json
import math
import shlex
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, final

from fixel.calibration.result import FitKind, ParameterSet, found_of
from fixel.calibration.search import CalibrationSearch
from fixel.calibration.target import Target, spread_sample, target_of, targets_of
from fixel.calibration.usual_parameters import Space, default_unknowns, search_space
from fixel.database.project import Project, check_known_names
from fixel.database.store import Store
from fixel.errors import FixelError, Interrupted, InvalidInput
from fixel.formats.dakota_file import load_dakota
from fixel.io.array_bytes import arrays_of
from fixel.io.journal import Journal
from fixel.jobs import folder as files
from fixel.jobs.engine import LocalEngine
from fixel.jobs.site import Site, load_site
from fixel.jobs.work import JobProgress, Show, StopRequest, run_work, unframed
from fixel.model import Experiment, Scene
from fixel.model.selection import ExperimentQuery, parse_filter
from fixel.model.space import ParameterSpace
from fixel.progress import Progress, Reporter, show_progress
from fixel.registry import offered
from fixel.simulation.trust import permit
from fixel.workflows import jobs
from fixel.workflows.calibration.calibration import Calibration, Calibrations, collect
from fixel.workflows.calibration.parameter_options import (
    fixed_unknowns,
    read_space,
    searched_unknowns,
)
from fixel.workflows.calibration.plan import (
    CalibrationPlan,
    answer_bytes,
    job_folder,
    outcome_of,
    prepare_folder,
    rounds,
)
from fixel.workflows.calibration.request import NamedOptions, named_options

if TYPE_CHECKING:
    from pydantic import BaseModel

ALONE: Final = "alone"  # stage and kind of questions that calibrate single experiments
PROJECT_FILE: Final = "fixel.yaml"  # makes a folder a project


def calibrate_in(
    mode: str, experiments: Iterable[Experiment | Target], parameters: Space = None, **options: Any
) -> Calibrations:
    """Calibrate in one of the modes of a request; the options are those of `calibrate`."""
    asked = SimpleNamespace(**options)
    permit(asked.motion)
    return run_plan(CalibrationPlan.of(mode, experiments, parameters, asked), asked)


def run_plan(plan: CalibrationPlan, asked: SimpleNamespace) -> Calibrations:
    """Run a plan in this process, or in a folder with a journal; store the result in a project.

    Options of `calibrate` decide where.
    """
    if asked.store is None and not asked.workers and asked.site is None:
        return _run_here(plan, asked)
    if asked.store is None:
        with tempfile.TemporaryDirectory(prefix="fixel-") as temporary:
            return replace(_run_in_folder(plan, Path(temporary) / "job", asked), folder=None)
    given = Path(getattr(asked.store, "folder", asked.store))
    if not (given / PROJECT_FILE).is_file():
        return _run_in_folder(plan, given, asked)
    from fixel.workflows.calibration.stored import add_to_project

    return add_to_project(Project(given), _run_in_folder(plan, job_folder(given, plan), asked))


def _run_here(plan: CalibrationPlan, asked: SimpleNamespace) -> Calibrations:
    task, alone = plan.task(asked.threads), list[bytes]()
    search = CalibrationSearch(task)

    def call(_: Path, payload: bytes) -> bytes:
        answer = answer_bytes(task, payload)
        if arrays_of(payload)["kind"].item() == ALONE:
            alone.append(answer)
        return answer

    with show_progress(asked.progress, "searching") as report:
        show, work = _reporting(report), rounds(search.steps())
        try:
            result = run_work(work, LocalEngine(call), Path(), None, progress=show)
        except KeyboardInterrupt:
            hint = "with store='FOLDER' the same call would continue"
            raise Interrupted(_best_so_far(plan, search, alone), hint) from None
    return Calibrations(**vars(plan), outcome=outcome_of(result))


def _run_in_folder(plan: CalibrationPlan, folder: Path, asked: SimpleNamespace) -> Calibrations:
    """Run or continue a calibration in a folder."""
    prepare_folder(plan, folder)
    if jobs.status_of(folder).state == "done":
        return collect(plan, folder)
    site = asked.site if isinstance(asked.site, Site | None) else load_site(Path(asked.site))
    count = None if site is not None and not asked.workers else asked.workers
    local = None
    if not jobs.arrange(folder, workers=count, site=site).workers:
        task = plan.task(asked.threads)
        local = LocalEngine(lambda _, payload: answer_bytes(task, payload))
    with show_progress(asked.progress, "searching") as report:
        try:
            jobs.run_here(folder, _reporting(report), local=local)
        except KeyboardInterrupt:
            again = f"fixel jobs resume {shlex.quote(str(folder))}"
            hint = f"the same call with this store continues, or: {again}"
            raise Interrupted(_best_in(plan, folder), hint) from None
    return collect(plan, folder)


def _best_in(plan: CalibrationPlan, folder: Path) -> Calibration | Calibrations | None:
    """Return what is in the journal of an interrupted calibration."""
    search, alone = CalibrationSearch(plan.task()), list[bytes]()
    with suppress(StopRequest, FixelError), Journal(folder / files.JOURNAL) as journal:
        blocks = [journal.get(name) or b"" for name in journal if name.startswith(f"{ALONE}/")]
        alone = [own for own in map(unframed, blocks) if isinstance(own, bytes)]
        # It ends where the journal ends.
        run_work(rounds(search.steps()), LocalEngine(), folder, journal, stop=lambda: True)
    return _best_so_far(plan, search, alone)


def _best_so_far(
    plan: CalibrationPlan, search: CalibrationSearch, alone: Sequence[bytes]
) -> Calibration | Calibrations | None:
    """Return what an interrupted calibration has found; None if there is nothing yet.

    `alone` are the answers of the chunks that calibrated single experiments.
    """
    comparer = search.comparer
    single = (one for own in alone for one in found_of(arrays_of(own)))
    found = [*search.found] or sorted(single, key=lambda one: one.members)
    if not search.found and math.isfinite(search.best.error):
        point, trace = search.best.point, search.trace()
        own: dict[str, Any] = {"members": tuple(search.members), "point": point, "trace": trace}
        own["errors"] = comparer.errors_at(point)
        found.append(ParameterSet(how=FitKind.DIRECT, **own))
    if not found:
        return None
    outcome = search.result(comparer.errors_at(comparer.space.nominal), found)
    run = Calibrations(**vars(plan), outcome=outcome, interrupted=True)
    return run[-1] if plan.request.mode == "joint" else run


def _reporting(report: Reporter) -> Show:
    """Return a callback that reports the progress of rounds."""

    def show(now: JobProgress) -> None:
        total = None if now.share is None else now.total
        report.show(Progress(now.note or report.stage, now.done, total, now.best, left=now.left_s))

    return show


# --- experiments of a project -------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentSelection:
    """Experiments to calibrate."""

    ids: list[int]
    targets: list[Target]
    left_out: Mapping[str, str]  # reasons why others cannot be compared, by key
    # Number of experiments that these were drawn from at random; None where they are all.
    sample_of: int | None = None

    def __iter__(self) -> Iterator[Target]:
        return iter(self.targets)


def select_experiments(
    store: Store, keys: Sequence[str], query: ExperimentQuery
) -> ExperimentSelection:
    """Select experiments by name, or by what they have in common.

    Named ones must be fit for it, and count once under whatever names; of a listing, those that are
    not are left out with a reason.
    """
    ids = list(dict.fromkeys(store.find(key) for key in keys))
    if not ids:
        ids = [summary.id for summary in store.experiments(query).rows]
        if not ids:
            check_known_names(store, query)
    targets: dict[int, Target] = {}
    left_out: dict[str, str] = {}
    for experiment_id in ids:
        experiment = store.experiment(experiment_id)
        try:
            targets[experiment_id] = target_of(experiment)
        except InvalidInput as problem:
            if keys:
                raise
            left_out[experiment.key] = str(problem)
    if not targets:
        reason = next(iter(left_out.values()), "")
        raise InvalidInput(
            "experiments",
            found=f"none to calibrate with{f' ({reason})' if reason else ''}",
            expected="one at least with a scene and measured poses",
            hint="fixel list shows all experiments",
        )
    return ExperimentSelection(ids=list(targets), targets=list(targets.values()), left_out=left_out)


def draw_sample(chosen: ExperimentSelection, count: int, seed: int) -> ExperimentSelection:
    """Return `count` random experiments of those chosen, or all of fewer ones.

    Every condition has the same share of them as before.
    """
    n = len(chosen.ids)
    if count >= n:
        return chosen
    kept = spread_sample([target.conditions for target in chosen.targets], count, seed)
    ids, targets = zip(*((chosen.ids[k], chosen.targets[k]) for k in kept), strict=True)
    return replace(chosen, ids=list(ids), targets=list(targets), sample_of=n)


def stored_points(project: Project, space: ParameterSpace) -> list[list[float]]:
    """Values of the free parameters in all stored calibrations that have them, each set once."""
    labels = space.labels
    points: dict[tuple[float, ...], None] = {}
    with project.store() as store:
        for record in store.calibration_summaries().values():
            best = record.best_fit
            if all(label in best for label in labels):
                points[tuple(best[label] for label in labels)] = None
    return [list(point) for point in points]


def plan_in_project(project: Project, request: BaseModel) -> CalibrationPlan:
    """Return the plan of a calibration of experiments of a project, checked and rehearsed."""
    from fixel.simulation.simulate import get_ready

    asked = SimpleNamespace(**offered("capability", "calibrate").arguments(request), start=None)
    given = "dataset" if asked.dataset else "where" if asked.where else ""
    if asked.experiments and given:
        raise InvalidInput(given, found="names of experiments too", expected="one of them")
    query = parse_filter(*asked.where, dataset=asked.dataset or None, include_faulty=asked.flagged)
    with project.store() as store:
        chosen = select_experiments(store, asked.experiments, query)
    if asked.sample is not None:
        chosen = draw_sample(chosen, asked.sample, asked.seed)
    mode = asked.mode or ("each" if len(chosen.targets) == 1 else "joint")
    asked.optimiser, space = _search_and_space(asked, [t.case.scene for t in chosen.targets])
    asked.error = {"name": asked.error, "angle_scale": asked.angle_scale}
    if mode == "stored":
        asked.stored = stored_points(project, search_space(space, targets_of(chosen)))
        asked.verdicts = False
    get_ready(chosen.targets[0].case.scene)  # before the clock runs
    plain = request.model_dump(mode="json") | {"project": str(project.folder)}
    return replace(CalibrationPlan.of(mode, chosen, space, asked), asked=plain)


def _search_and_space(
    asked: SimpleNamespace, scenes: list[Scene]
) -> tuple[NamedOptions, ParameterSpace]:
    search = NamedOptions(name=asked.optimiser, options=dict(map(_setting, asked.option)))
    if asked.dakota is not None:
        file = load_dakota(asked.dakota)
        search, unknowns = named_options(file.optimiser, "dakota"), list(file.space.unknowns)
    elif asked.space is not None:
        unknowns = list(read_space(asked.space).unknowns)
    else:
        unknowns = searched_unknowns(asked.fit, scenes) or default_unknowns(scenes)
    fixed = fixed_unknowns(asked.fixed)
    names = {unknown.name for unknown in fixed}
    free = [unknown for unknown in unknowns if unknown.name not in names]
    return search, ParameterSpace(unknowns=(*free, *fixed))


def _setting(text: str) -> tuple[str, Any]:
    """Parse NAME=VALUE; a value is JSON, or else text."""
    name, equals, value = text.partition("=")
    if not equals:
        raise InvalidInput("option", found=repr(text), expected="NAME=VALUE")
    try:
        return name.strip(), json.loads(value)
    except json.JSONDecodeError:
        return name.strip(), value
