"""Grasps that end seated, read from a table as the tutorial describes, and calibrated."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from tests.calibrating import collected

import fixel
from fixel.cli.main import run as run_command
from fixel.sampling.published import thesis_plan
from fixel.units import deg, mm
from fixel.workflows.calibration.stored import stored_calibration

SEATED = thesis_plan().experiments[0].scene
SPACE = {"mu_pusher": (0, 1)}
QUICK = {"verdicts": False, "max_evaluations": 15, "progress": False, "threads": 1}


def write(path, scene, name):
    """Write the measured run of a scene, whose part is 0.3 % smaller, as a table."""
    (body,) = scene.bodies
    small = dataclasses.replace(body, shape=fixel.Polygon(0.997 * np.array(body.shape.vertices)))
    run = fixel.simulate(dataclasses.replace(scene, bodies=(small,)), output_interval=1 / 30)
    rng = np.random.default_rng(0)
    with path.open("a", newline="") as file:
        table = csv.writer(file)
        if not path.stat().st_size:
            columns = "push time_s x_mm y_mm theta_deg pusher_x_mm pusher_y_mm"
            table.writerow(columns.split())
        noise = rng.normal(size=(len(run.time), 3)) * (0.1, 0.1, 0.1)
        part = run[body.name].pose / (mm, mm, deg) + noise
        head = run[scene.pushers[0].name].pose[:, :2] / mm
        for row in zip(run.time, *part.T, *head.T, strict=True):
            table.writerow([name, *(round(value, 5) for value in row)])


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A table of one seated grasp and two pushes that end before the part is seated."""
    path = tmp_path_factory.mktemp("seated") / "own.csv"
    path.touch()
    write(path, SEATED, "seated")
    for k in (1, 2):
        free = dataclasses.replace(thesis_plan().experiments[k].scene, duration=5.0)
        write(path, free, f"free{k}")
    return path


def read(table, drive):
    pusher = dataclasses.replace(SEATED.pushers[0], drive=drive)
    scene = dataclasses.replace(SEATED, pushers=(pusher,))
    return fixel.read_experiments(table, split_by="push", scene=scene)


def test_a_template_without_a_drive_names_the_missing_limit(table):
    words = "has no limit of force"
    assert any(words in note and "force_limit=" in note for note in read(table, None).notes)
    limited = read(table, fixel.LineDrive(speed=0.01, force_limit=34.3))
    assert not any(words in note for note in limited.notes)


def test_a_jammed_grasp_is_left_out_by_name_with_the_cure(table):
    fit = fixel.calibrate(read(table, None), SPACE, **QUICK)
    assert fit.status != "failed"
    assert np.isfinite(fit.objective.value)
    assert fit.keys_of_experiments == ("own/free1", "own/free2")
    (remark,) = fit.warnings
    assert remark.startswith("skipped own/seated: jammed at ")
    assert "force_limit" in remark
    assert "own/seated" in repr(fit)


def test_with_the_limit_of_force_nothing_is_left_out(table):
    limited = read(table, fixel.LineDrive(speed=0.01, force_limit=34.3))
    fit = fixel.calibrate(limited, SPACE, **QUICK)
    assert len(fit.keys_of_experiments) == 3
    assert fit.warnings == ()


def test_only_jammed_grasps_are_refused_with_the_cure(table):
    seated = [own for own in read(table, None) if own.name.endswith("seated")]
    with pytest.raises(fixel.InvalidInput, match=r"own/seated: jammed at .*force_limit"):
        fixel.calibrate(seated, SPACE, **QUICK)


def test_singles_name_the_experiment_and_the_cure(table):
    fits = fixel.calibrate_each(read(table, None), SPACE, **QUICK)
    failed = [fit for fit in fits if fit.status == "failed"]
    assert [fit.keys_of_experiments for fit in failed] == [("own/seated",)]
    assert "jammed at " in failed[0].message
    assert "force_limit" in failed[0].message


def test_a_comparison_names_the_cure_and_is_printed_whole(table):
    experiments = read(table, None)
    assert "own/seated: jammed. " in repr(fixel.compare(experiments, progress=False))
    one = [own for own in experiments if own.name.endswith("free1")]
    models = {"a model with a long name": {"mu_pusher": 0.2}, "other": {"mu_pusher": 0.9}}
    shown = fixel.compare(one, models, progress=False)
    text = repr(shown)
    table = shown._summary().tables[0]
    for row in table.cells:  # no value is cut off at the edge
        line = next(line for line in text.splitlines() if line.strip().startswith(row[0]))
        assert line.split()[-4:] == list(row[-4:])
    assert "force_limit" in repr(fixel.compare([experiments[0]], progress=False))


def test_a_prepared_job_states_what_was_left_out(table, tmp_path, capsys):
    lab = fixel.Project.create(tmp_path / "lab")
    lab.add(read(table, None))
    command = ["calibrate", "-p", str(lab.folder), "--mode", "joint", "--no-verdicts", "--json"]
    command += ["--fit", "mu_pusher"]
    with pytest.raises(SystemExit):
        run_command([*command, "--prepare"])
    job = json.loads(capsys.readouterr().out)["job"]
    with pytest.raises(SystemExit):
        run_command(["jobs", "resume", job])
    capsys.readouterr()
    run = collected(fixel.Project(lab.folder), Path(job))  # as the page and its jobs store it
    assert "skipped own/seated: jammed at " in repr(stored_calibration(lab, run.ids[0]))
