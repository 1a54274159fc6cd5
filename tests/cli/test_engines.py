"""Commands with `--engine`: which simulator answers, and which calibration is used."""

import pytest
from tests.cli.shell import json_of, refusal
from tests.fixtures import project_of

from fixel.formats import SceneFile, save_scene
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import pushed_square

pytestmark = pytest.mark.system

pytest.importorskip("pymunk")
ENGINE = "pymunk:step=0.01"


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("labs") / "lab"
    project_of(folder, example_pushes(6, duration=0.5))
    return folder


@pytest.fixture(scope="module")
def calibrated(lab):
    """Calibrations 1 by pymunk and 2 by fixel, so that the newest is not pymunk's."""
    from fixel.database.project import Project

    project = Project(lab)
    for motion in (ENGINE, "dynamic"):
        space = {"mu_pusher": (0, 1)}
        options = {"verdicts": False, "max_evaluations": 8, "progress": False}
        project.calibrate("", space, motion=motion, **options)
    return lab


def test_a_report_on_the_newest_calibration_by_an_engine(calibrated, capsys, tmp_path):
    for name, words in (("usual", ()), ("chosen", ("--engine", "pymunk"))):
        json_of(capsys, "report", "--project", calibrated, "--out", tmp_path / name, *words)
    assert "pymunk==7" in (tmp_path / "chosen" / "report.html").read_text("utf-8")
    assert "pymunk" not in (tmp_path / "usual" / "report.html").read_text("utf-8")


def test_a_map_by_an_engine(calibrated, capsys):
    found = json_of(capsys, "domain", "-p", calibrated, "--engine", ENGINE, "--folds", 2)
    assert found["calibration"] == 1
    assert json_of(capsys, "domain", "-p", calibrated, "--folds", 2)["calibration"] == 2


def test_sensitivity_by_an_engine(calibrated, capsys):
    options = ("-p", calibrated, "1", "--samples", 50)
    own = json_of(capsys, "sensitivity", *options)
    found = json_of(capsys, "sensitivity", *options, "--engine", "pymunk")
    assert own["pushes"][0]["motion"] == "dynamic"
    assert found["pushes"][0]["motion"].startswith("pymunk==7")
    ends = [answered["pushes"][0]["nominal_end"] for answered in (own, found)]
    assert ends[0] != ends[1]
    assert ends[0] == pytest.approx(ends[1], abs=5e-3)


def test_sensitivity_of_a_scene_file_by_an_engine(capsys, tmp_path):
    save_scene(SceneFile(scene=pushed_square()), tmp_path / "square.yaml")
    options = ("--engine", ENGINE, "--samples", 50)
    found = json_of(capsys, "sensitivity", tmp_path / "square.yaml", *options)
    assert found["pushes"][0]["motion"].endswith(":step=0.01")


def test_an_engine_that_calibrated_nothing(calibrated, capsys):
    err = refusal(capsys, "domain", "-p", calibrated, "--engine", "box2d")
    assert "none stored by box2d" in err
    assert "fixel calibrate --engine box2d" in err
    err = refusal(capsys, "report", "-p", calibrated, "--engine", "box2d", "--calibration", 2)
    assert "calibration 2: found one by dynamic, but fixel needs one by box2d" in err
