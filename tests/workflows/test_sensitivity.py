"""Sensitivity to the start: the public function, the command, and what projects store."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from tests.filtering.recordings import push
from tests.fixtures import calibration_record, project_of, refused
from tests.uncertainty.forks import fork
from typer.testing import CliRunner

import fixel
from fixel.cli.main import app
from fixel.database.project import Project
from fixel.errors import InvalidInput, NotStored
from fixel.formats import SceneFile, save_scene
from fixel.model import Flag
from fixel.model.records import Estimate
from fixel.testing.scenes import micro_push
from fixel.uncertainty.error_terms import ASME, StartError
from fixel.uncertainty.prediction import intervals_of
from fixel.workflows.analysis import load_analyses
from fixel.workflows.capabilities import prepare
from fixel.workflows.sensitivity.run import SENSITIVITY, sensitivity

SMALL = StartError(x=3e-4, y=3e-4, theta=math.radians(0.5), kind="uniform")
QUIET = {"progress": False, "threads": 1}


def test_a_fork_bifurcates_and_says_so():
    found = sensitivity(fork(), SMALL, samples=60, motion="quasistatic", **QUIET)
    assert found.flag == "bifurcates"
    assert "bifurcates" in repr(found)
    assert "2 separate outcomes" in repr(found)
    data = found.to_dict()
    assert len(data["end_x"]) == 60
    assert set(data["outcome"]) == {0, 1}
    # Outcomes are the two sides of the fixel.
    side = np.sign(np.array(data["end_y"]))
    assert len({(o, s) for o, s in zip(data["outcome"], side, strict=True)}) == 2


def test_reports_of_progress_end_at_the_number_of_starts():
    seen = []
    sensitivity(micro_push(1), ASME, samples=50, progress=seen.append, threads=1)
    assert (seen[-1].done, seen[-1].total) == (51, 51)


def test_wrong_input_is_refused():
    refused(sensitivity, micro_push(1), ASME, samples=20, match="at least 50", **QUIET)
    refused(sensitivity, micro_push(1), ASME, motion="slow", match="motion", **QUIET)
    refused(sensitivity, 42, ASME, match="a scene file or an Experiment", **QUIET)
    refused(sensitivity, micro_push(1), ASME, {"mu_pushr": 0.2}, match="mu_pusher", **QUIET)
    with pytest.raises(InvalidInput, match=r"vary mu_pusher is 'x', .*2 numbers: low, high"):
        sensitivity(micro_push(1), ASME, vary={"mu_pusher": "x"}, indices=True, **QUIET)


def test_a_project_stores_a_sensitivity_and_refuses_what_no_command_stores(tmp_path, monkeypatch):
    monkeypatch.setattr("fixel.workflows.analysis.write_picture", lambda *_: [])
    lab = fixel.Project.create(tmp_path / "lab")
    found = sensitivity(micro_push(1), ASME, samples=50, **QUIET)
    kept = lab.add(found)
    (stored,) = load_analyses(lab, "sensitivity")
    assert kept.folder == stored.folder
    (push,) = stored.analysis.numbers["pushes"]
    assert push["flag"] == found.flag
    assert lab.add(found).folder == kept.folder
    assert lab.add(sensitivity(micro_push(2), ASME, samples=50, **QUIET)).folder != kept.folder
    refused(lab.add, found.prediction, match=r"Prediction, which projects do not store.*\.save")


# --- the command ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("projects") / "my lab"
    recorded = push(duration=3.0)
    flag = Flag("no-fixels", "fixels not located", False)
    bare = replace(recorded, name="bare", scene=None, contact_mode="", flags=(flag,))
    project_of(place, [recorded, replace(recorded, name="again"), bare])
    return place


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    place = tmp_path_factory.mktemp("scenes") / "fork.yaml"
    save_scene(SceneFile(scene=fork(), motion="quasistatic"), place)
    return place


def call(*arguments):
    return CliRunner().invoke(app, ["sensitivity", *map(str, arguments)])


def good(*arguments):
    result = call(*arguments)
    assert result.exit_code == 0, (result.output, result.exception)
    return result.stdout


def test_a_scene_file_that_bifurcates(file, tmp_path):
    out = good(file, "--samples", "200", "--plot", tmp_path / "pictures")
    assert out.startswith("fork bifurcates: its outcomes form separate groups.")
    for words in (
        "fork has 2 outcomes (50%, 50%)",
        "Pushes, the most sensitive first",
        "01-fork-ensemble.png",
    ):
        assert words in out
    assert (tmp_path / "pictures" / "01-fork-ensemble.png").read_bytes().startswith(b"\x89PNG")
    assert out.splitlines()[-1].startswith("Next: ")


@pytest.mark.system
def test_everything_in_a_project_is_ranked_and_kept(folder):
    out = good("--project", folder, "--samples", "60")
    assert out.startswith("Warning: testbed/bare was skipped: ")
    assert "\nOf 2 pushes: " in out
    assert "stored in " in out
    (analysis,) = (one.analysis for one in load_analyses(Project(folder), "sensitivity"))
    assert len(analysis.experiments) == 2
    assert len(analysis.pictures) == 2
    assert analysis.methods


@pytest.mark.system
def test_one_experiment_as_json_with_indices(folder):
    pytest.importorskip("SALib")
    words = ("testbed/push", "-p", folder, "--samples", "60", "--base", "4", "--json")
    values = json.loads(good(*words, "--vary", "mu_pusher=0.2:0.5", "--set", "mu_fixel=0.3"))
    (found,) = values["pushes"]
    assert found["values"] == {"mu_fixel": 0.3}
    assert set(found["indices"]["outcomes"]) == {"along", "across", "angle"}
    assert set(found["indices"]["outcomes"]["angle"]["indices"]) == {
        "mu_pusher", "start_x", "start_y", "start_theta",
    }  # fmt: skip
    assert values["start_error"]["x_m"] == pytest.approx(3e-4)
    again = json.loads(good(*words, "--vary", "mu_pusher=0.2:0.5", "--set", "mu_fixel=0.3"))
    assert again["pushes"] == values["pushes"]


@pytest.mark.parametrize("quoted", [0.3, 0.32])  # the second after a misfit
def test_a_calibration_gives_values_ranges_and_motion(folder, quoted):
    pytest.importorskip("SALib")
    project = Project(folder)
    estimate = Estimate(label="mu_pusher", unit="-", value=quoted, low=0.25, high=0.4, best_fit=0.3)
    method = {"motion": "quasistatic"}
    own = {"method": method, "estimates": (estimate,)}
    record = calibration_record({1: 0.1}, {"mu_pusher": 0.3}, **own)
    with project.store() as store:
        number = store.add_calibration(record)
    words = ("testbed/push", "-p", folder, "--calibration", number, "--indices", "--base", "2")
    values = json.loads(good(*words, "--samples", "60", "--json"))
    (found,) = values["pushes"]
    assert found["values"] == {"mu_pusher": 0.3}
    assert "mu_pusher" in found["indices"]["outcomes"]["angle"]["indices"]
    (own,) = (k.analysis for k in load_analyses(project) if k.analysis.calibrations == (number,))
    assert "(quasistatic)" in own.methods[0]


def test_an_interval_is_that_of_the_surface_although_the_values_of_two_agree():
    ends = {"abs": (0.25, 0.4), "ply": (0.1, 0.9)}
    estimates = [
        Estimate(label=f"mu_support[surface={name}]", unit="-", value=0.3, low=low, high=high)
        for name, (low, high) in ends.items()
    ]
    found = {name: intervals_of(estimates, {"surface": name})["mu_support"] for name in ends}
    assert found == ends


@pytest.mark.parametrize(("words", "x", "theta", "kind"), [
    (("--preset", "asme"), 5e-6, math.radians(0.5), "uniform"),
    (("--start-error-mm", "0.1", "--start-error-deg", "0", "--normal"), 1e-4, 0.0, "normal"),
    (("--start-error-mm", "0.1", "--uniform"), 1e-4, math.radians(0.5), "uniform"),
])  # fmt: skip
def test_presets_and_sizes(file, words, x, theta, kind):
    error = json.loads(good(file, *words, "--samples", "60", "--json"))["start_error"]
    assert error == {"x_m": x, "y_m": x, "theta_rad": theta, "kind": kind}


def test_base_samples_alone_request_the_indices():
    alone = sensitivity(micro_push(1), ASME, base=4, samples=60, **QUIET)
    both = sensitivity(micro_push(1), ASME, base=4, indices=True, samples=60, **QUIET)
    assert alone.indices.table().rows == both.indices.table().rows
    assert sensitivity(micro_push(1), ASME, samples=60, **QUIET).indices is None


@pytest.mark.parametrize(("words", "sentence"), [
    (("--preset", "asmee"), "asme"),
    (("--preset", "asme", "--uniform"), "--preset: found a preset and a start"),
    (("--set", "mu_pusher"), "--set mu_pusher"),
    (("--set", "mu=1"), "mu"),
    (("--set", "mu_pusher=-1"), "--set mu_pusher is -1.0, but must be"),
    (("--base", "100"), "--base is 100, but must be a power of two"),
    (("--vary", "mu_pusher=0.1"), "--vary mu_pusher"),
    (("--start-error-mm", "-1", "--normal"), "start"),
    (("--start-error-mm", "0.1"), "--uniform (they are half-widths) or --normal"),
])  # fmt: skip
def test_refusals(file, words, sentence):
    problem = call(file, *words).exception
    assert isinstance(problem, InvalidInput)
    assert sentence in str(problem)


def test_a_job_reads_no_scene_files(folder, file):
    request = SENSITIVITY.request({"experiments": (str(file),)})
    with pytest.raises(NotStored, match=f"no experiment '{file}'"):
        prepare(SENSITIVITY, request, Project(folder))


def test_what_is_not_there(folder):
    assert isinstance(call("nothing", "--project", folder).exception, NotStored)
    assert isinstance(call("bare", "--project", folder).exception, InvalidInput)
    assert isinstance(call("--project", folder, "--calibration", 7).exception, NotStored)
