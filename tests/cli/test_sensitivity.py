"""`fixel sensitivity`, as called from a shell."""

import json
from dataclasses import replace

import pytest
from tests.filtering.recordings import push
from tests.fixtures import project_of
from tests.uncertainty.forks import fork
from typer.testing import CliRunner

from fixel.cli.main import app
from fixel.database.project import Project
from fixel.errors import InvalidInput, NotStored
from fixel.formats import SceneFile, save_scene
from fixel.model import Flag, Parameters, Provenance
from fixel.model.records import CalibrationRecord, Estimate, Member
from fixel.workflows.analysis import load_analyses


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("projects") / "my lab"
    recorded = push(duration=3.0)
    flag = Flag("no-fixels", "nobody knows where", False)
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


def test_everything_in_a_project_is_ranked_and_kept(folder):
    out = good("--project", folder, "--samples", "60")
    assert out.startswith("Warning: testbed/bare was skipped: ")
    assert "\nOf 2 pushes: " in out
    assert "stored in " in out
    (analysis,) = (one.analysis for one in load_analyses(Project(folder), "sensitivity"))
    assert len(analysis.experiments) == 2
    assert len(analysis.pictures) == 2
    assert analysis.methods


def test_one_experiment_as_json_with_indices(folder):
    pytest.importorskip("SALib")
    words = ("testbed/push", "-p", folder, "--samples", "60", "--base", "4", "--json")
    told = json.loads(good(*words, "--vary", "mu_pusher=0.2:0.5", "--set", "mu_fixel=0.3"))
    (found,) = told["pushes"]
    assert found["values"] == {"mu_fixel": 0.3}
    assert set(found["indices"]["outcomes"]) == {"along", "across", "angle"}
    assert set(found["indices"]["outcomes"]["angle"]["indices"]) == {
        "mu_pusher", "start_x", "start_y", "start_theta",
    }  # fmt: skip
    assert told["start_error"]["x_m"] == pytest.approx(3e-4)
    again = json.loads(good(*words, "--vary", "mu_pusher=0.2:0.5", "--set", "mu_fixel=0.3"))
    assert again["pushes"] == told["pushes"]


def test_a_calibration_gives_values_ranges_and_motion(folder):
    pytest.importorskip("SALib")
    project = Project(folder)
    record = CalibrationRecord(
        name="one",
        parameters=Parameters(mu_pusher=0.3),
        members=(Member(1, 1.0, 0.1),),
        provenance=Provenance(version="0"),
        method={"motion": "quasistatic"},
        estimates=(Estimate(label="mu_pusher", unit="-", value=0.3, low=0.25, high=0.4),),
    )
    with project.store() as store:
        number = store.add_calibration(record)
    words = ("testbed/push", "-p", folder, "--calibration", number, "--indices", "--base", "2")
    told = json.loads(good(*words, "--samples", "60", "--json"))
    (found,) = told["pushes"]
    assert found["values"] == {"mu_pusher": 0.3}
    assert "mu_pusher" in found["indices"]["outcomes"]["angle"]["indices"]
    (own,) = (k.analysis for k in load_analyses(project) if k.analysis.calibrations == (number,))
    assert "(quasistatic)" in own.methods[0]


def test_presets_and_sizes(file):
    told = json.loads(good(file, "--preset", "asme", "--samples", "60", "--json"))
    assert told["start_error"]["x_m"] == pytest.approx(5e-6)
    words = ("--start-error-mm", "0.1", "--start-error-deg", "0", "--normal", "--json")
    told = json.loads(good(file, *words, "--samples", "60"))
    assert told["start_error"] == {
        "x_m": pytest.approx(1e-4), "y_m": pytest.approx(1e-4), "theta_rad": 0.0, "kind": "normal",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (("--preset", "asmee"), InvalidInput),
        (("--preset", "asme", "--start-error-mm", "1"), InvalidInput),
        (("--set", "mu_pusher"), InvalidInput),
        (("--set", "mu=1"), InvalidInput),
        (("--vary", "mu_pusher=0.1"), InvalidInput),
        (("--start-error-mm", "-1", "--normal"), InvalidInput),
    ],
)
def test_refusals(file, words, kind):
    assert isinstance(call(file, *words).exception, kind)


def test_a_size_needs_its_meaning(file):
    problem = call(file, "--start-error-mm", "0.1").exception
    assert "--uniform (they are half-widths) or --normal" in str(problem)
    told = json.loads(
        good(file, "--start-error-mm", "0.1", "--uniform", "--samples", "60", "--json")
    )
    assert (told["start_error"]["x_m"], told["start_error"]["kind"]) == (1e-4, "uniform")


def test_what_is_not_there(folder):
    assert isinstance(call("nothing", "--project", folder).exception, NotStored)
    assert isinstance(call("bare", "--project", folder).exception, InvalidInput)
    assert isinstance(call("--project", folder, "--calibration", 7).exception, NotStored)
