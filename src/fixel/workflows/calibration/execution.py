"""Run calibrations in this process, in a folder, or in a project."""

from __future__ import annotations

import json
import math
import shlex
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from fixel.calibration.result import FitKind, ParameterSet, found_of
from fixel.calibration.search import VERDICTS, CalibrationSearch, CalibrationTask
from fixel.calibration.target import Target, spread_sample, target_of, targets_of
from fixel.calibration.usual_parameters import (
    Space,
    default_unknowns,
    fixed_unknowns,
    search_space,
    searched_unknowns,
)
from fixel.database.project import SETTINGS, Project, check_known_names
from fixel.database.store import Store
from fixel.errors import FixelError, Interrupted, InvalidInput, no_experiments
from fixel.formats.space_file import load_dakota, read_space
from fixel.io.array_bytes import arrays_of
from fixel.io.journal import read_journal
from fixel.jobs import folder as files
from fixel.jobs.site import Site, load_site
from fixel.jobs.work import JobProgress, LocalEngine, Round, Show, block_name, run_work, unframed
from fixel.model import Experiment, Scene
from fixel.model.fields import path_of
from fixel.model.selection import ExperimentQuery, parse_filter
from fixel.model.space import ParameterSpace
from fixel.progress import Progress, show_progress
from fixel.registry import offered
from fixel.trust import permit
from fixel.workflows import jobs
from fixel.workflows.calibration.calibration import Calibration, Calibrations, collect
from fixel.workflows.calibration.plan import (
    STORE,
    CalibrationPlan,
    answer_bytes,
    check_same,
    outcome_of,
    rounds,
)
from fixel.workflows.calibration.request import NamedOptions, named_options, options_of
from fixel.workflows.calibration.stored import add_to_project, stored_ids

if TYPE_CHECKING:
    from pydantic import BaseModel


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
    is_path = not isinstance(asked.store, Project)
    if is_path and not (path_of(asked.store, STORE) / SETTINGS).is_file():
        return _run_in_folder(plan, Path(asked.store), asked)
    project = Project(asked.store) if is_path else asked.store
    if not plan.asked:
        with project.store() as store:
            plan = replace(plan, asked=options_of(plan.request, stored_ids(store, plan.targets)))
    folder = offered("methods", "prepare")(*_job(plan), project, plan.inputs)
    return add_to_project(project, _run_job(plan, folder, asked))


def _job(plan: CalibrationPlan) -> tuple[Any, BaseModel]:
    """Return the capability and the request of the job of a plan."""
    capability = offered("capability", "calibrate")
    return capability, capability.request(plan.asked or options_of(plan.request, ()))


class LiveSearch:
    """Search of a calibration with what it has found so far, here or in the journal of its job."""

    def __init__(self, plan: CalibrationPlan, task: CalibrationTask) -> None:
        self.plan, self.task, self.search = plan, task, CalibrationSearch(task)
        self.work = rounds(self.search.steps())
        self.stage, self.n_read = "", 0  # part that was read last; blocks of the journal
        self._round: Round | None = None
        self._alone: list[bytes] = []  # answers of chunks that calibrated single experiments

    def answer(self, _: Path, payload: bytes) -> bytes:
        """Return the answer of a chunk."""
        answer = answer_bytes(self.task, payload)
        if arrays_of(payload)["kind"].item() == FitKind.ALONE:
            self._alone.append(answer)
        return answer

    def read(self, journal: Path) -> None:
        """Continue with the answers in a journal, up to the verdicts."""
        blocks = dict(read_journal(journal))
        self.n_read = len(blocks)
        with suppress(StopIteration, FixelError):  # it has ended
            while self.stage != VERDICTS:
                self._round = now = self._round or next(self.work)
                names = {block_name(now.function, chunk): chunk.name for chunk in now.chunks}
                known = {names[own]: unframed(blocks[own]) for own in names if own in blocks}
                self.stage = now.chunks[0].name.rpartition("/")[0] if known else self.stage
                if self.stage == FitKind.ALONE:
                    self._alone = [own for own in known.values() if isinstance(own, bytes)]
                if len(known) < len(names):
                    break
                self._round = self.work.send(known)

    @property
    def found(self) -> list[ParameterSet]:
        """Complete sets of parameters."""
        every = (one for own in self._alone for one in found_of(arrays_of(own)))
        return [*self.search.found] or sorted(every, key=lambda one: one.members)

    @property
    def best(self) -> Calibration | Calibrations | None:
        """Calibrations that an interrupted search has found so far; None before the first."""
        search, found = self.search, self.found
        if math.isfinite(search.best.error) and all(one.how != FitKind.DIRECT for one in found):
            own: dict[str, Any] = {"members": tuple(search.members), "point": search.best.point}
            own |= {"errors": search.comparer.errors_at(own["point"]), "trace": search.trace()}
            found.append(ParameterSet(how=FitKind.DIRECT, **own))
        if not found:
            return None
        run = Calibrations(**vars(self.plan), outcome=search.result(found), interrupted=True)
        return run[-1] if self.plan.request.mode == "joint" else run


def _run_here(plan: CalibrationPlan, asked: SimpleNamespace) -> Calibrations:
    live = LiveSearch(plan, plan.task(asked.threads))
    with _watched(live, asked, "with store='FOLDER' the same call would continue") as show:
        result = run_work(live.work, LocalEngine(live.answer), Path(), None, progress=show)
    return Calibrations(**vars(plan), outcome=outcome_of(result))


def _run_in_folder(plan: CalibrationPlan, folder: Path, asked: SimpleNamespace) -> Calibrations:
    """Run or continue a calibration in a folder that the user has named."""
    check_same(plan, folder)
    offered("methods", "prepare_in")(folder, *_job(plan), plan.inputs)
    return _run_job(plan, folder, asked)


def _run_job(plan: CalibrationPlan, folder: Path, asked: SimpleNamespace) -> Calibrations:
    """Run or continue a prepared job."""
    if jobs.status_of(folder).state == "done":
        return collect(plan, folder)
    site = asked.site if isinstance(asked.site, Site | None) else load_site(asked.site)
    count = None if site is not None and not asked.workers else asked.workers
    here = not jobs.arrange(folder, workers=count, site=site).workers
    live = LiveSearch(plan, plan.task(asked.threads))
    local = LocalEngine(live.answer) if here else None
    again = f"fixel jobs resume {shlex.quote(str(folder))}"
    hint = f"finished evaluations are stored; the same request continues, or: {again}"
    with _watched(live, asked, hint, folder / files.JOURNAL) as show:
        jobs.run_here(folder, show, local=local)
    return collect(plan, folder)


@contextmanager
def _watched(
    live: LiveSearch, asked: SimpleNamespace, hint: str, journal: Path | None = None
) -> Iterator[Show]:
    """Report the progress of rounds; after Ctrl-C raise `Interrupted` with what is found so far."""
    with show_progress(asked.progress, "searching") as report:

        def show(now: JobProgress) -> None:
            total, note = None if now.share is None else now.total, now.note or report.stage
            report.show(Progress(note, now.done, total, now.best, left=now.left_s))

        try:
            yield show
        except KeyboardInterrupt:
            if journal is not None:
                live.read(journal)
            raise Interrupted(live.best, hint) from None


# --- experiments of a project -------------------------------------------------------------------


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
    ids = list(dict.fromkeys(map(store.find, dict.fromkeys(keys))))
    ids = ids or [summary.id for summary in store.experiments(query).rows]
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
        found = f"none to calibrate with{f' ({reason})' if reason else ''}"
        raise no_experiments(found, "one at least with a scene and measured poses")
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
    own = space.labels
    with project.store() as store:
        found = [record.best_fit for record in store.calibration_summaries().values()]
    points = dict.fromkeys(tuple(best[k] for k in own) for best in found if {*own} <= {*best})
    return [list(point) for point in points]


def plan_in_project(project: Project, request: BaseModel) -> CalibrationPlan:
    """Return the plan of a calibration of experiments of a project, checked and rehearsed."""
    from fixel.simulation.simulate import get_ready

    asked = SimpleNamespace(**offered("capability", "calibrate").arguments(request), start=None)
    given = "dataset" if asked.dataset else "where" if asked.where else ""
    if asked.experiments and given:
        raise InvalidInput(given, found="names of experiments too", expected="one of them")
    for file, name in (*combinations(("dakota", "space", "fit"), 2), ("dakota", "option")):
        if getattr(asked, file) is not None and getattr(asked, name):
            raise InvalidInput(file, found=f"{name} too", expected="one of them")
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
    plain = request.model_dump(mode="json")
    return replace(CalibrationPlan.of(mode, chosen, space, asked), asked=plain)


def _search_and_space(
    asked: SimpleNamespace, scenes: list[Scene]
) -> tuple[NamedOptions, ParameterSpace]:
    search = NamedOptions(name=asked.optimiser, options=dict(map(_setting, asked.option)))
    if asked.dakota is not None:
        optimiser, space, _ = load_dakota(asked.dakota)
        search, unknowns = named_options(optimiser, "dakota"), list(space.unknowns)
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
