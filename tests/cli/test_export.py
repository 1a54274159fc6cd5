"""`fixel export`: files another program reads, and what is said of them."""

import json
import math
from importlib.resources import files

import numpy as np
import pyarrow.parquet as pq
import pytest
import typer
from tests.cli.shell import output
from tests.fixtures import bare_experiment, project_of

from fixel.cli.project import export
from fixel.database.bundle import import_bundle
from fixel.database.project import Project
from fixel.errors import InvalidInput, NotStored, StoreRefused
from fixel.model import Flag, Trajectory

app = typer.Typer(add_completion=False)
app.command()(export)


def call(capsys, *arguments):
    app([str(a) for a in arguments], standalone_mode=False)
    return capsys.readouterr().out


def path(n, rate=50.0):
    time = 3.0 + np.arange(n) / rate
    return Trajectory(time=time, pose=np.column_stack((0.1 * time, -time, 0.5 * time)))


@pytest.fixture
def project(tmp_path):
    simulated = {"real": False, "simulated_by": "me", "flags": [Flag("late", "by 2 s")]}
    return project_of(tmp_path / "lab", [
        bare_experiment("1", dataset="lab", trajectory=path(51), pusher=path(51)),
        bare_experiment("2", dataset="lab", trajectory=path(26), **simulated),
        bare_experiment("141", dataset="cmu-tripod", trajectory=path(1)),
    ])  # fmt: skip


def test_a_bundle_is_written_and_said(project, capsys, tmp_path):
    out = call(capsys, project.folder, tmp_path / "a.zip")
    assert out.splitlines()[0] == "3 experiments, of them 1 flagged, 1 simulated"
    assert "wrote" in out.splitlines()[-2]
    following = f"fixel import {tmp_path / 'a.zip'} --dry-run --project {project.folder}"
    assert out.splitlines()[-1] == f"Next: {following}"
    assert output(capsys, *following.split()[1:]).startswith(f"{tmp_path / 'a.zip'}: contains 3")
    with Project.create(tmp_path / "other").store() as store:
        assert import_bundle(tmp_path / "a.zip", store)["experiments"] == 3


def test_json(project, capsys, tmp_path):
    answer = json.loads(call(capsys, project.folder, tmp_path / "a.zip", "--json"))
    assert answer["format"] == "bundle"
    assert answer["counts"]["flagged"] == answer["counts"]["simulated"] == 1
    assert answer["bytes"] == (tmp_path / "a.zip").stat().st_size


def test_one_dataset(project, capsys, tmp_path):
    arguments = (project.folder, tmp_path / "a.zip", "--dataset")
    assert call(capsys, *arguments, "lab").startswith("2 experiments")
    with pytest.raises(NotStored, match="'nix'"):
        call(capsys, *arguments, "nix")


def test_parquet(project, capsys, tmp_path):
    out = call(capsys, project.folder, tmp_path / "t", "--parquet")
    assert out.splitlines()[:2] == [
        "3 experiments, of them 1 flagged, 1 simulated",
        "with 78 frames",
    ]
    frames = pq.read_table(tmp_path / "t" / "frames.parquet").to_pydict()
    experiments = pq.read_table(tmp_path / "t" / "experiments.parquet").to_pylist()
    assert frames["is_real"] == [True] * 51 + [False] * 26 + [True]
    assert frames["time_s"][:51] == path(51).time.tolist()
    assert frames["pusher_x_m"][0] == pytest.approx(0.3)
    assert frames["pusher_x_m"][51:] == [None] * 27
    assert [e["is_flagged"] for e in experiments] == [False, True, False]
    assert experiments[1]["flags"] == ["late: by 2 s"]
    assert experiments[1]["simulated_by"] == "me"


def test_lerobot(project, capsys, tmp_path):
    root = tmp_path / "robot"
    call(capsys, project.folder, root, "--lerobot")
    info = json.loads((root / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 50)
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 78, 1)
    assert info["total_simulated_episodes"] == 1
    data = pq.read_table(root / info["data_path"].format(chunk_index=0, file_index=0))
    assert data.column_names == list(info["features"])
    frames = data.to_pydict()
    assert frames["index"] == list(range(78))
    assert frames["is_real"] == [True] * 51 + [False] * 26 + [True]
    assert frames["timestamp"][:51] == pytest.approx(np.arange(51) / 50)
    assert len(frames["observation.state"][0]) == 6
    assert frames["action"][0] == pytest.approx(path(51).pose[1], rel=1e-6)
    assert math.isnan(frames["action"][-1][0])
    episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"]) for e in episodes] == [
        (0, 51), (51, 77), (77, 78),
    ]  # fmt: skip
    assert [e["is_real"] for e in episodes] == [True, False, True]
    assert episodes[0]["stats/timestamp/max"] == pytest.approx([1.0])
    assert json.loads((root / "meta/stats.json").read_text())["index"]["max"] == [77.0]
    tasks = pq.read_table(root / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": ["push object"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    card = (root / "README.md").read_text()
    assert "2 measured and 1 simulated" in card
    assert "licence: Apache-2.0; cite: " in card
    assert "licence: not stated" in card


def test_another_rate(project, capsys, tmp_path):
    call(capsys, project.folder, tmp_path / "r", "--lerobot", "--fps", "10")
    assert json.loads((tmp_path / "r/meta/info.json").read_text())["total_frames"] == 11 + 6 + 1


def test_what_cannot_be(project, capsys, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    for words, arguments in (
        ("one of them", [tmp_path / "n", "--parquet", "--lerobot"]),
        ("a new or empty folder", [tmp_path / "full", "--parquet"]),
        ("a new or empty folder", [tmp_path / "full" / "x", "--lerobot"]),
        (r"\.zip", [tmp_path / "a.tar"]),
        ("no folder", [tmp_path / "none" / "a.zip"]),
        ("LeRobot", [tmp_path / "a.zip", "--fps", "10"]),
        ("1 to 1000", [tmp_path / "n", "--lerobot", "--fps", "0"]),
    ):
        with pytest.raises(InvalidInput, match=words):
            call(capsys, project.folder, *arguments)
    with pytest.raises(StoreRefused, match="is not a fixel project"):
        call(capsys, tmp_path, tmp_path / "a.zip")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["full", "lab"]


def test_a_scene_becomes_a_model_of_another_engine(tmp_path, capsys):
    scene = files("fixel.testing") / "examples" / "peg_slip.yaml"
    text = call(capsys, scene, tmp_path / "model", "--to", "pymunk", "--scenes", "3")
    assert "end poses differ from those of fixel by" in text
    assert f"wrote {tmp_path / 'model' / 'run.py'}" in text
    assert text.splitlines()[-1] == f"Next: python {tmp_path / 'model' / 'run.py'}"
    answer = json.loads(call(capsys, scene, tmp_path / "body", "--to", "urdf", "--json"))
    assert answer["files"] == ["card.json", "object.urdf"]
    assert "3 fixels" in answer["card"]["not_in_the_model"]
