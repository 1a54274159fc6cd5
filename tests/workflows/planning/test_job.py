"""Searches for plans as jobs: the same plan as in one call, in chunks, resumed and with workers."""

from pathlib import Path

import pytest

import fixel
from fixel.testing.scenes import pushed_square
from fixel.workflows import jobs
from fixel.workflows.analysis import load_analyses
from fixel.workflows.planning.job import MAKER
from fixel.workflows.planning.report import FILE
from fixel.workflows.planning.request import PlanRequest, find_plan
from fixel.workflows.planning.stored import load_plan

GOAL = {
    "fixel": 1,
    "scene": "scene.yaml",
    "goal": {"pose": {"pose_mm_deg": [20, 0, 0], "position_mm": 5, "angle_deg": 5}},
    "belief": {"start": {"x_mm": 1, "y_mm": 1, "theta_deg": 1, "kind": "normal"}},
}


def request_in(folder: Path) -> PlanRequest:
    return PlanRequest(goal=GOAL, folder=str(folder), rollouts=2_000)


@pytest.fixture
def job(tmp_path: Path) -> Path:
    project = fixel.Project.create(tmp_path / "lab")
    pushed_square().save(tmp_path / "scene.yaml")
    request = request_in(tmp_path)
    folder = project.folder / jobs.JOBS / "plan-1"
    jobs.prepare_job(
        folder, maker=MAKER, options={"question": vars(request), "command": "fixel plan"}
    )
    jobs.arrange(folder)
    return folder


def planned(job: Path) -> fixel.PushPlan:
    (stored,) = load_analyses(fixel.Project(job.parents[1]), "plan")
    return load_plan(stored.folder / FILE).found.plan


def expected(job: Path) -> fixel.PushPlan:
    project = fixel.Project(job.parents[1])
    return find_plan(project, request_in(project.folder.parent), progress=False).plan


def test_a_job_finds_the_plan_of_the_same_call(job: Path):
    assert jobs.run_here(job).state == "done"
    assert planned(job) == expected(job)


def test_a_stopped_job_continues_to_the_same_plan(job: Path):
    class Stop(Exception):
        pass

    seen = []

    def stop(progress):
        seen.append(progress)
        if progress.done >= 3:
            raise Stop

    with pytest.raises(Stop):
        jobs.run_here(job, progress=stop)
    assert jobs.run_here(job).state == "done"
    assert planned(job) == expected(job)
