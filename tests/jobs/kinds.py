"""Kinds of jobs under test: how to make one, and what it comes to when nothing happens to it."""

import abc
import dataclasses
from dataclasses import dataclass, field
from typing import NamedTuple

from tests import calibrating as calibrations
from tests.fixtures import project_of
from tests.jobs.helpers import blocks_written, names_in

from fixel.calibration.usual_parameters import searched_unknowns
from fixel.jobs import folder as files
from fixel.jobs.coordinator import coordinate
from fixel.jobs.work import LocalEngine, block_name
from fixel.model.selection import ExperimentQuery
from fixel.sampling.published import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.toy_work import MAKER, make_toy_work
from fixel.workflows.calibration.plan import outcome_bytes, outcome_of
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions
from fixel.workflows.jobs import prepare_job


class Undisturbed(NamedTuple):
    """Result of a job in one process that nothing disturbs."""

    result: bytes
    names: list[str]  # of the blocks of its journal


class JobKind(abc.ABC):
    """Jobs that chaos is brought upon."""

    @abc.abstractmethod
    def prepare(self, path, run=None):
        """A new job at this path or below it, and how it is to be run; its folder."""

    def undisturbed(self, folder):
        """Result of this job, run again in this process without trouble."""
        job, inputs = files.read_job(folder), (folder / "inputs").iterdir()
        again = folder.with_name(f"{folder.name}-undisturbed")
        content = {path.name: path for path in inputs}
        prepare_job(again, maker=job.maker, inputs=content, options=job.options)
        assert coordinate(again).state == "done"
        return Undisturbed((again / files.RESULT).read_bytes(), names_in(again))

    def comparable(self, result):
        """Return the part of a result that is equal in every run."""
        return result

    def assert_as_undisturbed(self, folder):
        """The same bits as without any trouble; every answer kept, and kept once."""
        expected = self.undisturbed(folder)
        assert files.read_status(folder).state == "done"
        found = (folder / files.RESULT).read_bytes()
        assert self.comparable(found) == self.comparable(expected.result)
        assert sorted(names_in(folder)) == sorted(expected.names)
        assert blocks_written(folder) == len(expected.names)


class Toy(JobKind):
    """Work that is none, with the options of `fixel.testing.toy_work`."""

    def __init__(self, **options):
        self.options = options

    def prepare(self, path, run=None):
        prepare_job(path, maker=MAKER, inputs={"offset": b"0.31"}, options=self.options)
        return _to_be_run(path, run)

    def undisturbed(self, folder):
        return toy_undisturbed(folder / "inputs", **self.options)


def toy_undisturbed(inputs, **options):
    """Result of toy work, without its sleep, which may be minutes."""
    quick = options | {"sleep_s": 0.0, "compute_s": 0.0}
    names = []
    with LocalEngine() as engine:
        work, asked = make_toy_work(inputs, options), make_toy_work(inputs, quick)
        turn, question = next(work), next(asked)
        while True:
            names += [block_name(turn.function, chunk) for chunk in turn.chunks]
            batches = engine.results(question.function, inputs, question.chunks)
            answers = dict(pair for batch in batches for pair in batch)
            try:
                turn, question = work.send(answers), asked.send(answers)
            except StopIteration as end:
                return Undisturbed(end.value, names)


@dataclass(frozen=True)
class Campaign(JobKind):
    """A calibration of pushes of the simulated testbed, prepared as `fixel calibrate` does it.

    Parameters
    ----------
    experiments : int
        The first so many of the plan of the thesis.
    fit : tuple of str
        Parameters, as `--fit` takes them.
    threshold : float
        Where a search ends, as a share of the bounds.
    changes : dict
        Of the request.
    """

    experiments: int = 8
    fit: tuple = ("mu_pusher", "tripod_radius_mm=10:60:30")
    threshold: float = 0.05
    changes: dict = field(default_factory=dict)

    def prepare(self, path, run=None):
        planned = thesis_plan().experiments[: self.experiments]
        project = project_of(path, SimulatedTestbed.ideal().run(planned))
        with project.store() as store:
            chosen = calibrations.select_experiments(store, (), ExperimentQuery())
        return _to_be_run(calibrations.prepare(project, chosen, self._request(chosen)), run)

    def _request(self, chosen):
        scenes = [target.case.scene for target in chosen.targets]
        content = {
            "mode": "campaign",
            "unknowns": searched_unknowns(self.fit, scenes),
            "optimiser": NamedOptions(
                name="pattern-search", options={"threshold_delta": self.threshold}
            ),
            # Stated, or every verdict would begin by finding it out.
            "noise_position": 5e-5,
            "noise_angle": 2e-3,
        }
        return CalibrationRequest(**content | self.changes)

    def comparable(self, result):
        """All but how long the searches took: wall time [s], another in every run."""
        outcome = outcome_of(result)
        found = tuple(dataclasses.replace(one, seconds=0.0) for one in outcome.found)
        return outcome_bytes(dataclasses.replace(outcome, found=found))


# A minute at most, every stage of a campaign in it.
QUICK = Campaign()

# All experiments of the thesis and all its parameters: some 200 chunks of seconds.
THESIS = Campaign(
    experiments=420,
    fit=("mu_pusher", "mu_fixel", "mu_support", "tripod_radius_mm=10:60:30"),
    changes={"verdicts": False},
)


def toy_job(folder, run=None, **options):
    """A prepared job of toy work."""
    return Toy(**options).prepare(folder, run)


def assert_as_undisturbed(folder, **options):
    """That a job of toy work came to what it does without trouble."""
    Toy(**options).assert_as_undisturbed(folder)


def _to_be_run(folder, run):
    if run is not None:
        files.write_run(folder, run)
    return folder
