"""`fixel show` and `fixel compare`, as called from a shell."""

import json
import shlex

import pytest
import typer
from tests.fixtures import bare_experiment, project_of
from typer.testing import CliRunner

from fixel import InvalidInput, Project, SimulatedTestbed, StoreRefused
from fixel.cli.capability import typer_command
from fixel.cli.show import show
from fixel.errors import NotStored
from fixel.model import Flag, Parameters, PlannedExperiment, Provenance, Trajectory
from fixel.testing.scenes import grasp
from fixel.workflows.capabilities import CAPABILITIES

app = typer.Typer()
app.command("show")(show)
app.command("compare")(typer_command(CAPABILITIES["compare"]))

BARE = bare_experiment(
    "a 1",
    dataset="lab",
    provenance=Provenance(version="0", source="a.csv", sha256="ab" * 32),
    trajectory=Trajectory(time=[0.0, 2.0], pose=[[0.0, 0.0, 0.0], [0.03, 0.04, 0.5]]),
    conditions={"surface": "plywood", "speed_m_s": 0.02},
    flags=(Flag("misregistered", "4 mm inside"), Flag("no-fixels", "not kept", False)),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("projects") / "my lab"
    planned = PlannedExperiment(name="push", scene=grasp("seated"), conditions={"layout": "seated"})
    project_of(place, [BARE, *SimulatedTestbed().run([planned])])
    return place


def call(folder, *arguments):
    return CliRunner().invoke(app, [*map(str, arguments), "--project", str(folder)])


def good(folder, *arguments):
    result = call(folder, *arguments)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_show_says_what_a_real_one_is(folder):
    out = good(folder, "show", "lab/a 1")

    assert out.startswith("lab/a 1: real\n")
    for line in (
        "2 frames, 2 s",
        "end      30.00   40.00        28.65",
        "path length 50.00 mm",
        "contact mode at the end: unknown",
        "  surface    plywood",
        "flags\n  misregistered  4 mm inside",
        "remarks\n  no-fixels  not kept",
        "  source  a.csv",
    ):
        assert line in out
    assert "SIMULATED" not in out


def test_show_says_what_made_another(folder):
    out = good(folder, "show", "push")
    assert out.startswith("testbed/push: SIMULATED by fixel simulated testbed")
    assert "at 30 Hz" in out
    assert "tactile" in out


def test_show_as_json_is_one_object(folder):
    answer = json.loads(good(folder, "show", "1", "--json"))
    assert (answer["id"], answer["dataset"], answer["name"]) == (1, "lab", "a 1")
    assert answer["real"] is True
    assert answer["end"] == [0.03, 0.04, 0.5]
    assert answer["files"] == {}


def test_the_next_command_works_until_there_is_a_picture(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    for name in ("lab/a 1", "testbed/push"):
        following = good(folder, "show", name).splitlines()[-1].removeprefix("Next: ")
        assert runner.invoke(app, shlex.split(following)[1:]).exit_code == 0
    assert {path.name for path in tmp_path.iterdir()} == {"a 1.png", "push.png"}


def test_show_can_draw(folder, tmp_path):
    picture = tmp_path / "push.png"
    out = good(folder, "show", "push", "--plot", picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {picture}" in out
    assert out.splitlines()[-1].startswith("Next: fixel compare testbed/push --project ")


def test_compare_gives_errors_and_contact_modes(folder):
    out = good(folder, "compare", "push", "--set", "mu_support=0.3")
    assert "SIMULATED by" in out
    assert ["mu_support", "0.3"] in [line.split() for line in out.splitlines()]
    for word in ("position, rms", "angle, at end", "E, 35 mm/rad", "contact mode, recorded"):
        assert word in out


def test_compare_keeps_the_simulation_only_when_asked(folder):
    before = json.loads(good(folder, "compare", "push", "--json"))
    after = json.loads(
        good(folder, "compare", "push", "--set", "mu_pusher=0.2", "--save", "--json")
    )

    assert before["simulation_id"] is None
    with Project(folder).store() as store:
        assert store.simulations(after["experiment_id"]) == [after["simulation_id"]]
        record = store.simulation(after["simulation_id"])
    assert record.parameters == Parameters(mu_pusher=0.2)
    assert record.error_mm2 == pytest.approx(after["error_mm2"])
    assert "--set mu_pusher=0.2" in record.provenance.command


def test_compare_can_draw(folder, tmp_path):
    picture = tmp_path / "both.svg"
    answer = json.loads(
        good(folder, "compare", "push", "--motion", "quasistatic", "--plot", picture, "--json")
    )
    assert picture.read_text().startswith("<?xml")
    assert answer["files"] == {"plot": str(picture)}
    assert answer["method"]["motion"] == "quasistatic"


@pytest.mark.parametrize(("arguments", "sentence"), [
    (["compare", "push", "--set", "mu_support"], "NAME=NUMBER"),
    (["compare", "push", "--set", "mu_suport=0.3"], "did you mean 'mu_support'"),
    (["compare", "push", "--set", "mu_pusher=-1"], "--set mu_pusher is -1.0, but must be"),
    (["compare", "push", "--set", "ellipsoid_force=1"], "--set ellipsoid_force: found no"),
    (["compare", "push", "--plot", "a.bmp"], "a picture file"),
    (["show", "push", "--plot", "a.bmp"], "a picture file"),
    (["compare", "lab/a 1"], "no scene"),
])  # fmt: skip
def test_bad_input_is_refused(folder, arguments, sentence):
    result = call(folder, *arguments)
    assert isinstance(result.exception, InvalidInput)
    assert sentence in str(result.exception)


def test_what_is_not_there_is_said(folder, tmp_path):
    assert isinstance(call(folder, "show", "nothing").exception, NotStored)
    assert isinstance(call(tmp_path, "show", "push").exception, StoreRefused)
