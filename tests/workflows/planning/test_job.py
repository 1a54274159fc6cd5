"""Searches for plans as jobs: the same plan as in one call, in chunks, resumed and with workers."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import fixel
from fixel.errors import JobRefused
from fixel.testing.scenes import pushed_square
from fixel.workflows import jobs
from fixel.workflows.analysis import load_analyses
from fixel.workflows.capabilities import prepare
from fixel.workflows.planning.report import FILE
from fixel.workflows.planning.request import load_plan
from fixel.workflows.planning.run import PLAN, plan_goal

GOAL = {
    "fixel": 1,
    "scene": "scene.yaml",
    "goal": {"pose": {"pose_mm_deg": [20, 0, 0], "position_mm": 5, "angle_deg": 5}},
    "belief": {"start": {"x_mm": 1, "y_mm": 1, "theta_deg": 1, "kind": "normal"}},
}


@pytest.fixture
def job(tmp_path: Path) -> Path:
    project = fixel.Project.create(tmp_path / "lab")
    pushed_square().save(tmp_path / "scene.yaml")
    goal = tmp_path / "goal.yaml"
    goal.write_text(json.dumps(GOAL))
    folder = prepare(PLAN, PLAN.request({"goal": str(goal), "rollouts": 1_000}), project)
    goal.write_text("changed after the job was prepared")
    return folder


def planned(job: Path) -> fixel.PushPlan:
    (stored,) = load_analyses(fixel.Project(job.parents[1]), "plan")
    return load_plan(stored.folder / FILE).found.plan


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> fixel.PushPlan:
    """Plan of one call."""
    folder = tmp_path_factory.mktemp("call")
    pushed_square().save(folder / "scene.yaml")
    goal = json.dumps(GOAL | {"scene": str(folder / "scene.yaml")})
    project = fixel.Project.create(folder / "lab")
    return plan_goal(project, goal, rollouts=1_000, progress=False).found.plan


def test_a_job_finds_the_plan_of_the_same_call(job: Path, expected: fixel.PushPlan):
    assert jobs.run_here(job).state == "done"
    assert planned(job) == expected


@pytest.mark.system
def test_a_stopped_job_continues_to_the_same_plan(job: Path, expected: fixel.PushPlan):
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
    assert planned(job) == expected


@pytest.mark.parametrize("by_option", [False, True])
def test_a_job_does_not_compute_with_another_scene(by_option: bool, tmp_path: Path, monkeypatch):
    """A scene edited after a job was prepared is refused; the prepared one continues."""
    monkeypatch.chdir(tmp_path)
    project, file = fixel.Project.create(tmp_path / "lab"), Path("scene.yaml")
    pushed_square().save(file)
    scene = {"scene": file} if by_option else {}
    request = PLAN.request({"goal": json.dumps(GOAL), "rollouts": 1_000} | scene)
    folder, content = prepare(PLAN, request, project), file.read_bytes()
    monkeypatch.chdir(project.folder)
    (tmp_path / file).write_bytes(content.replace(b"mass: 0.15", b"mass: 0.30"))
    with pytest.raises(JobRefused, match="changed since the job was prepared"):
        jobs.run_here(folder)
    (tmp_path / file).write_bytes(content)
    assert jobs.run_here(folder).state == "done"


@pytest.mark.parametrize("by_option", [False, True])
def test_a_changed_scene_makes_another_job(by_option: bool, tmp_path: Path):
    """The journal of the scene before does not answer for simulations of the changed scene."""
    project, file = fixel.Project.create(tmp_path / "lab"), tmp_path / "scene.yaml"
    goal = json.dumps(GOAL | {"scene": str(file)})
    request = PLAN.request({"goal": goal, **({"scene": file} if by_option else {})})
    folders = []
    for scene in (pushed_square(), pushed_square(), pushed_square(), pushed_square()):
        mass = 0.1 * (1 + len(folders) // 2)
        replace(scene, bodies=(replace(scene.bodies[0], mass=mass),)).save(file)
        folders.append(prepare(PLAN, request, project))
    assert folders[0] == folders[1] != folders[2] == folders[3]
