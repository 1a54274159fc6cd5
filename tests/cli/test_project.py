"""`fixel new`, `import`, `list` and `testbed run`, as typed."""

import math
import pickle
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.cli.shell import fixel, json_of, output, refusal
from tests.datasets import push_files, recordings

from fixel.cli.project import _records
from fixel.database.project import Project
from fixel.database.query import ALL_EXPERIMENTS
from fixel.errors import StoreRefused
from fixel.jobs.folder import read_run


@pytest.fixture
def lab(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("FIXEL_DATABASE", raising=False)
    folder = tmp_path / "my lab"
    assert fixel(capsys, "new", folder)[0] == 0
    return folder


@pytest.fixture
def recording(tmp_path):
    time = np.arange(20) / 10
    rows = ["time_s,x_mm,y_mm,theta_deg"]
    rows += [f"{t:.3f},{100 * t:.3f},5.0,{9 * t:.3f}" for t in time]
    path = tmp_path / "run-7.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_a_new_project_is_a_folder(lab, capsys):
    assert {p.name for p in lab.iterdir()} >= {"fixel.yaml", "experiments.db", "media"}
    assert "a project" in refusal(capsys, "new", lab)
    assert "a name in UTF-8" in refusal(capsys, "new", f"{lab}\udcff")
    assert json_of(capsys, "new", lab.parent / "other")["name"] == "other"


def test_what_is_no_project_is_refused(tmp_path, capsys):
    assert "fixel new" in refusal(capsys, "list", "--project", tmp_path)
    with pytest.raises(StoreRefused) as refused:
        Project(f"sqlite:///{tmp_path}/no.db")
    assert pickle.loads(pickle.dumps(refused.value)).is_input
    (tmp_path / "thing").write_text("x", encoding="utf-8")
    assert "empty folder" in refusal(capsys, "new", tmp_path)


@pytest.mark.parametrize(("words", "name"), [
    ("data --output there", "--output"), ("data --sha256 ab", "--sha256"),
    ("export lab.zip --scenes 3", "--scenes"), ("export lab.zip --seed 0", "--seed"),
    ("plan run pyproject.toml --rig thesis-tags", "--rig"),
    ("plan run pyproject.toml --driver grbl -n 3", "--trials"),
])  # fmt: skip
def test_options_that_nothing_uses_are_refused(capsys, words, name):
    assert refusal(capsys, *words.split()).startswith(f"fixel: {name}: found ")


@pytest.mark.parametrize(("settings", "words", "said"), [
    ("name: lab\ncolour: red\n", (), "colour"),
    ("name: lab\n", ("--where", "shape"), "is 'shape'"),
])  # fmt: skip
def test_settings_and_conditions_that_cannot_be(lab, capsys, settings, words, said):
    (lab / "fixel.yaml").write_text(settings, encoding="utf-8")
    assert said in refusal(capsys, "list", "--project", lab, *words)


def test_import_list_and_import_again(lab, recording, capsys):
    dry = json_of(capsys, "import", recording, "--project", lab, "--dry-run")
    assert dry["experiments"] == 1
    assert dry["understood"]
    assert json_of(capsys, "list", "--project", lab)["total"] == 0

    done = json_of(capsys, "import", recording, "--project", lab)
    assert (done["new"], done["known"]) == (1, 0)
    again = json_of(capsys, "import", recording, "--project", lab)
    assert (again["new"], again["known"]) == (0, 1)

    listed = json_of(capsys, "list", "--project", lab)
    (row,) = listed["experiments"]
    assert (row["dataset"], row["name"], row["is_real"]) == ("csv", "run-7", True)
    assert row["end_x_m"] == pytest.approx(0.19)

    out = output(capsys, "list", "--project", lab)
    assert "csv/run-7" in out
    assert "Next: fixel show csv/run-7" in out


def test_it_is_printed_how_a_table_is_read_before_it_is_stored(recording, lab, capsys, monkeypatch):
    def full(*_: object) -> None:
        raise StoreRefused("no space")

    monkeypatch.setattr("fixel.database.project.Project.add", full)
    code, out, err = fixel(capsys, "import", recording, "--project", lab)
    assert (code, "no space" in err) == (1, True)
    assert "1 experiment, read as csv" in out
    assert fixel(capsys, "import", recording, "--project", lab, "--json")[1].startswith('{"error"')


def test_an_export_of_nothing_or_to_nothing_is_refused(lab, capsys, tmp_path):
    err = refusal(capsys, "export", "--dataset", "nope", tmp_path / "a.zip", "--project", lab)
    assert "there is no experiment of dataset 'nope'" in err
    err = refusal(capsys, "export", tmp_path / "a", "--project", lab)
    assert "found a name without an ending, but fixel needs a bundle file: .zip" in err


def test_a_dry_run_needs_no_project(recording, capsys):
    assert "1 experiment, read as csv" in output(capsys, "import", recording, "--dry-run")


def test_a_command_that_simulates_nothing_loads_no_simulator(lab):
    code = f"""import sys
from fixel.cli.main import run
try:
    run(["list", "--project", {str(lab)!r}])
except SystemExit:
    print(sorted({{"alembic", "numba"}} & {{*sys.modules}}))"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_plan_on_the_simulated_testbed(lab, capsys):
    done = json_of(capsys, "testbed", "run", "--project", lab, "--limit", "3", "--seed", "5")
    assert done["new"] == 3
    assert json_of(capsys, "testbed", "run", "-p", lab, "--limit", "3", "--seed", "5")["known"] == 3
    assert "--seed" in refusal(capsys, "testbed", "run", "-p", lab, "--seed", "-1")
    assert output(capsys, "list", "--project", lab).count("SIMULATED") == 3
    assert json_of(capsys, "list", "--project", lab, "--real")["total"] == 0
    found = json_of(capsys, "list", "--project", lab, "--where", "shape=square", "--limit", "2")
    assert found["total"] == 3
    assert len(found["experiments"]) == 2


def test_experiments_that_replace_others_are_counted_and_named(lab, capsys):
    for seed in (5, 6):
        made = output(capsys, "testbed", "run", "-p", lab, "--limit", "2", "--seed", seed)
    assert "replaced 2 earlier experiments of the same name" in made
    assert json_of(capsys, "list", "-p", lab, "--where", "replaced")["total"] == 4
    shown = output(capsys, "show", "1", "-p", lab)
    assert "replaced by experiment 3 of the same name" in shown
    assert "Next: fixel show id:1 --plot" in shown
    assert "replaced" not in output(capsys, "show", "3", "-p", lab)


def test_the_environment_names_another_database(lab, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("FIXEL_DATABASE", f"sqlite:///{tmp_path}/elsewhere.db")
    for words in (("list", "--project", lab), ("serve", lab)):
        code, _, err = fixel(capsys, *words)
        assert code == 1
        assert f"run: fixel db upgrade '{lab}'" in err
    assert Path(lab / "experiments.db").exists()


def test_a_bundle_goes_from_one_project_to_another(lab, recording, tmp_path, capsys):
    json_of(capsys, "import", recording, "--project", lab)
    json_of(capsys, "testbed", "run", "-p", lab, "--limit", "2")
    output(capsys, "export", lab, tmp_path / "all.zip")
    other = tmp_path / "other"
    output(capsys, "new", other)
    dry = json_of(capsys, "import", tmp_path / "all.zip", "-p", other, "--dry-run")
    assert dry["experiments"] == 3
    assert json_of(capsys, "list", "-p", other)["total"] == 0
    assert json_of(capsys, "import", tmp_path / "all.zip", "-p", other)["experiments"] == 3
    assert json_of(capsys, "import", tmp_path / "all.zip", "-p", other)["known"] == 3
    again = output(capsys, "import", tmp_path / "all.zip", "-p", other)
    assert "added nothing; 3 were already stored" in again
    assert json_of(capsys, "list", "-p", other, "--simulated")["total"] == 2


def test_single_records_of_a_bundle_are_named_in_the_singular(lab, recording, tmp_path, capsys):
    json_of(capsys, "import", recording, "--project", lab)
    output(capsys, "export", lab, tmp_path / "one.zip")
    other = Project.create(tmp_path / "other").folder
    words = ("import", tmp_path / "one.zip", "-p", other)
    assert "added 1 experiment\n" in output(capsys, *words)
    assert "added nothing; 1 was already stored" in output(capsys, *words)
    counts = {"parameters": 1, "filter_runs": 1, "analyses": 1, "calibrations": 2, "flags": 0}
    assert _records(counts) == ["1 parameter", "1 filter run", "1 analysis", "2 calibrations"]


def test_import_lists_what_is_left_out(lab, tmp_path, capsys):
    folder = push_files.mit_push(
        tmp_path / "pushes", push_files.push(0), push_files.push(1, obj_x1="?"), push_files.push(2)
    )
    expected = "mit-push/felt_block_1: pushes.csv.gz, row 2, column obj_x1 is '?'"

    dry = json_of(capsys, "import", folder, "--project", lab, "--dry-run")
    assert (dry["experiments"], len(dry["skipped"])) == (2, 1)
    assert dry["skipped"][0].startswith(expected)

    out = output(capsys, "import", folder, "--project", lab)
    assert "skipped 1:" in out
    assert expected in out
    assert json_of(capsys, "import", folder, "--project", lab)["skipped"] == dry["skipped"]

    push_files.mit_push(folder, push_files.push(0), push_files.push(1), push_files.push(2))
    mended = json_of(capsys, "import", folder, "--project", lab)
    assert (mended["new"], mended["known"], mended["skipped"]) == (1, 2, [])


def test_import_of_nothing_sound_is_refused_and_stores_nothing(lab, tmp_path, capsys):
    folder = push_files.mit_push(tmp_path / "pushes", push_files.push(0, obj_x1="?"))
    assert "column obj_x1" in refusal(capsys, "import", folder, "--project", lab)
    assert json_of(capsys, "list", "--project", lab)["total"] == 0


def test_errors_of_an_import_name_options_of_the_command(recording, capsys):
    header, *rows = recording.read_text().splitlines()
    twice = [f"{row},{push}" for push in "ab" for row in rows]
    recording.write_text("\n".join([f"{header},push", *twice]))
    for option, error in (
        ([], 'use --option split_by="push" if'),
        (["--option", "split_by=pushh"], "--option split_by is 'pushh'"),
        (["--option", "length_unit=ell"], "--option length_unit is 'ell'"),
        (["--option", "split_by"], "--option split_by is 'split_by'"),
        (["--as", "sheet"], "--as is 'sheet'"),
    ):
        assert error in refusal(capsys, "import", recording, "--dry-run", *option)


def test_simulations_of_the_publisher_are_stored_and_compared(lab, tmp_path, capsys):
    folder = recordings.rpi_2dgad(tmp_path / "trials")
    frames = range(2, 31)
    push_files.write_table(
        folder / "author_simulation_trajectory.csv",
        [
            {"experiment_id": 9, "frame": k, "x_mm": 13.0, "y_mm": 201.0 - k, "z_mm": 45.0,
             "theta_rad": math.pi - 0.02 + 0.01 * (k - 1) - 2 * math.pi * (k > 3)}
            for k in frames
        ],
    )  # fmt: skip
    assert json_of(capsys, "import", folder, "--project", lab)["skipped"] == []
    assert json_of(capsys, "import", folder, "--project", lab)["known"] == 3

    found = json_of(capsys, "compare", "9", "--project", lab)["by_publisher"]

    # The measured path of the trial, moved by 3 mm.
    assert found["position_rms_m"] == pytest.approx(0.003)
    assert found["final_angle_rad"] == pytest.approx(0.0, abs=1e-9)
    assert found["error_mm2"] == pytest.approx(9.0)
    assert "the publisher of the data" in output(capsys, "compare", "9", "--project", lab)
    with Project(lab).store() as store:
        assert [
            store.simulations(number) for number in store.experiment_ids(ALL_EXPERIMENTS)
        ].count([]) == 1  # 7 has its own file, 9 a row of the table
        assert store.unsimulated_ids(ALL_EXPERIMENTS) == [1]  # not by fixel


def test_simulations_of_the_publisher_go_from_project_to_project(lab, tmp_path, capsys):
    folder = recordings.rpi_2dgad(tmp_path / "trials")
    json_of(capsys, "import", folder, "--project", lab)
    other = tmp_path / "other"
    json_of(capsys, "new", other)
    json_of(capsys, "export", lab, tmp_path / "all.zip")
    json_of(capsys, "import", tmp_path / "all.zip", "--project", other)
    both = [Project(place).experiments().simulations for place in (lab, other)]
    assert [*both[0]] == ["rpi-2dgad/7"]
    assert both[0]["rpi-2dgad/7"].trajectory == both[1]["rpi-2dgad/7"].trajectory


def test_options_that_would_be_ignored_are_refused(lab, tmp_path, capsys):
    output(capsys, "testbed", "run", "-p", lab, "--limit", "2")
    space = tmp_path / "space.yaml"
    space.write_text("mu_pusher: {low: 0, high: 1, start: 0.3}\n")
    bundle = tmp_path / "all.zip"
    output(capsys, "export", lab, bundle)
    project = ("--project", lab)
    for option, words in {
        "--calibration": ("export", lab, tmp_path / "other.zip", "--calibration", 1),
        "--dataset": ("export", lab, tmp_path / "to", "--to", "urdf", "--dataset", "x"),
        "--scene": ("import", bundle, *project, "--scene", space),
        "--option": ("import", bundle, *project, "--option", "a=b"),
        "--space": ("calibrate", *project, "--space", space, "--fit", "mu_pusher"),
        "--plot": ("domain", *project, "--prepare", "--plot", tmp_path / "charts"),
    }.items():
        assert f"fixel: {option}: found" in refusal(capsys, *words)


def test_a_prepared_job_has_the_workers_of_its_command(lab, capsys):
    output(capsys, "testbed", "run", "-p", lab, "--limit", "2")
    words = ("calibrate", "--project", lab, "--fit", "mu_pusher", "--prepare")
    job = Path(json_of(capsys, *words, "--workers", 3)["job"])
    assert read_run(job).workers == 3
    assert json_of(capsys, *words)["job"] == str(job)
    assert read_run(job).workers == 3


def test_the_next_command_shows_a_deleted_experiment(lab, capsys):
    output(capsys, "testbed", "run", "-p", lab, "--limit", "1")
    with Project(lab).store() as store:
        store.delete([1])
    text = output(capsys, "list", "--project", lab, "--deleted")
    assert "1 experiment\n" in text
    words = shlex.split(text.rpartition("Next: fixel ")[2])
    assert "experiment 1 of" in output(capsys, *words[:-2])
