"""Plan files and trials: what is damaged, foreign or of another version is rejected by name."""

import functools
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures import project_of, refused

import fixel
from fixel.errors import InvalidInput
from fixel.io.saved import save
from fixel.planning.trials import PlanTrial
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import pushed_square
from fixel.uncertainty.predictive import EndError
from fixel.workflows.planning.request import (
    FoundPlan,
    PlanRequest,
    add_trials,
    inputs_of,
    load_plan,
    load_trials,
    plan_id,
    save_plan,
    trials_path,
)

from .plans import rig_plan, square_plan


@functools.cache
def found_plan() -> FoundPlan:
    return FoundPlan(plan=square_plan(), request=PlanRequest(goal={"fixel": 1}), calibration=7)


def test_a_plan_with_an_error_of_the_model_is_saved(tmp_path: Path):
    plan = square_plan()
    error = EndError(1e-3, 0.05)
    runs = plan.runs._replace(scenarios=plan.runs.scenarios._replace(end_error=error))
    again = fixel.load(replace(plan, runs=runs).save(tmp_path / "a.plan"))
    assert again.runs.scenarios.end_error == error


def trial(k: int, met: bool = True) -> PlanTrial:
    return PlanTrial(
        time=f"2026-11-22T21:00:{k:02d}+00:00",
        met=met,
        failure="" if met else "slid off",
        start=(0.0, 1e-3, 0.1),
        end=(0.03, 0.0, 0.0) if met else None,
        by="a person",
    )


def outcome(path: Path):
    """The plan of a file, or the file that the error names."""
    try:
        return load_plan(path).found.plan
    except InvalidInput as problem:
        return problem.where


def test_a_plan_file_has_the_plan_and_its_request(tmp_path: Path):
    written = save_plan(found_plan(), tmp_path / "a.plan")
    again = load_plan(tmp_path / "a.plan")
    assert again.found.plan == found_plan().plan
    assert again.found.calibration == 7
    assert again.found.request == {"goal": {"fixel": 1}}
    assert (again.id, again.version, again.created) == (
        written.id,
        written.version,
        written.created,
    )
    assert plan_id(rig_plan()) != written.id


def test_a_plan_that_python_saved_is_a_plan_file(tmp_path: Path):
    found_plan().plan.save(tmp_path / "a.plan")
    assert load_plan(tmp_path / "a.plan").found.plan == found_plan().plan


def test_damaged_foreign_and_newer_files_are_refused_by_name(tmp_path: Path):
    path = tmp_path / "a.plan"
    save_plan(found_plan(), path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    bad = tmp_path / "bad.plan"
    for k in range(60):
        content = bytearray(whole)
        if k % 3:
            at = int(rng.integers(len(whole)))
            content[at] ^= int(rng.integers(1, 256))
        else:
            del content[int(rng.integers(len(whole))) :]
        bad.write_bytes(bytes(content))
        assert outcome(bad) in (found_plan().plan, str(bad))  # some bytes have no meaning
    save(fixel.Disk(0.005), bad)
    refused(load_plan, bad, match="a saved Disk, but fixel needs a plan file")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(bad, "w") as new:
        for name in old.namelist():
            head = json.loads(old.read(name)) if name == "result.json" else None
            content = old.read(name) if head is None else json.dumps(head | {"format": 99})
            new.writestr(name, content)
    refused(load_plan, bad, match="install a newer one")
    refused(load_plan, tmp_path / "none.plan", match=r"none\.plan")


def test_trials_are_added_next_to_the_plan(tmp_path: Path):
    path = tmp_path / "a.plan"
    file = save_plan(found_plan(), path)
    assert load_trials(path, file).n == 0
    for k in range(3):
        add_trials(path, file, trial(k, met=k != 1))
    again = load_trials(path, file)
    assert again.trials == (trial(0), trial(1, met=False), trial(2))
    assert again.mean == pytest.approx(found_plan().plan.success.stated)
    assert again.stated == pytest.approx(found_plan().plan.success.least)
    assert not again.refuted
    assert add_trials(path, file, *(trial(k, met=False) for k in range(10, 30))).refuted


def test_damaged_trials_are_refused(tmp_path: Path):
    path = tmp_path / "a.plan"
    file = save_plan(found_plan(), path)
    add_trials(path, file, trial(0))
    where = trials_path(path)
    where.write_text(where.read_text().replace("21:00:00", "21:99:00"))
    refused(load_trials, path, file, match="line 3, time")


def test_trials_of_another_plan_are_refused(tmp_path: Path):
    path = tmp_path / "a.plan"
    add_trials(path, save_plan(found_plan(), path), trial(0))
    other = save_plan(FoundPlan(plan=rig_plan(), request=PlanRequest(goal={})), path)
    refused(load_trials, path, other, match=f"fixel needs trials of the plan {other.id}")


def test_the_scene_of_a_named_experiment_replaces_that_of_the_goal_file(tmp_path: Path):
    (push,) = example_pushes(1, duration=0.2)
    project = project_of(tmp_path / "lab", [push])
    pushed_square().save(tmp_path / "scene.yaml")
    goal = {"fixel": 1, "scene": "scene.yaml", "goal": {"pose": {"pose_mm_deg": [20, 0, 0],
            "position_mm": 5}}, "belief": {"parameters": {"mu_pusher": [0.2, 0.4]}}}  # fmt: skip
    assert inputs_of(project, goal, tmp_path).scene == pushed_square()
    assert inputs_of(project, goal, tmp_path, experiment=push.key).scene == push.scene
    with pytest.raises(InvalidInput, match="experiment: found a scene file too"):
        inputs_of(project, goal, tmp_path, tmp_path / "scene.yaml", push.key)
    with pytest.raises(InvalidInput, match="experiment: found no project"):
        inputs_of(None, goal, tmp_path, experiment=push.key)
