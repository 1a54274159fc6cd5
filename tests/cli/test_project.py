"""`fixel new`, `import`, `list` and `testbed run`, as typed."""

import json
from pathlib import Path

import numpy as np
import pytest

from fixel.cli.main import run


def fixel(capsys, *arguments):
    """Exit code, what was printed, and what was complained about."""
    with pytest.raises(SystemExit) as end:
        run([str(a) for a in arguments])
    said = capsys.readouterr()
    return end.value.code, said.out, said.err


def answer(capsys, *arguments):
    code, out, err = fixel(capsys, *arguments, "--json")
    assert code == 0, err
    return json.loads(out)


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
    code, _, err = fixel(capsys, "new", lab)
    assert code == 2
    assert "a project" in err
    assert answer(capsys, "new", lab.parent / "other")["name"] == "other"


def test_what_is_no_project_is_refused(tmp_path, capsys):
    code, _, err = fixel(capsys, "list", "--project", tmp_path)
    assert code == 1
    assert "fixel new" in err
    (tmp_path / "thing").write_text("x", encoding="utf-8")
    code, _, err = fixel(capsys, "new", tmp_path)
    assert code == 2
    assert "empty folder" in err


def test_settings_that_cannot_be(lab, capsys):
    (lab / "fixel.yaml").write_text("name: lab\ncolour: red\n", encoding="utf-8")
    code, _, err = fixel(capsys, "list", "--project", lab)
    assert code == 2
    assert "colour" in err


def test_import_list_and_import_again(lab, recording, capsys):
    dry = answer(capsys, "import", recording, "--project", lab, "--dry-run")
    assert dry["experiments"] == 1
    assert dry["understood"]
    assert answer(capsys, "list", "--project", lab)["total"] == 0

    done = answer(capsys, "import", recording, "--project", lab)
    assert (done["new"], done["known"]) == (1, 0)
    again = answer(capsys, "import", recording, "--project", lab)
    assert (again["new"], again["known"]) == (0, 1)

    listed = answer(capsys, "list", "--project", lab)
    (row,) = listed["experiments"]
    assert (row["dataset"], row["name"], row["is_real"]) == ("csv", "run-7", True)
    assert row["end_x_m"] == pytest.approx(0.19)

    code, out, _ = fixel(capsys, "list", "--project", lab)
    assert code == 0
    assert "csv/run-7" in out
    assert "Next: fixel show csv/run-7" in out


def test_a_dry_run_needs_no_project(recording, capsys):
    code, out, _ = fixel(capsys, "import", recording, "--dry-run")
    assert code == 0
    assert "1 experiments, read as csv" in out


def test_a_plan_on_the_simulated_testbed(lab, capsys):
    done = answer(capsys, "testbed", "run", "--project", lab, "--limit", "3", "--seed", "5")
    assert done["new"] == 3
    assert answer(capsys, "testbed", "run", "-p", lab, "--limit", "3", "--seed", "5")["known"] == 3
    code, out, _ = fixel(capsys, "list", "--project", lab)
    assert code == 0
    assert out.count("SIMULATED") == 3
    assert answer(capsys, "list", "--project", lab, "--real")["total"] == 0
    found = answer(capsys, "list", "--project", lab, "--where", "shape=square", "--limit", "2")
    assert found["total"] == 3
    assert len(found["experiments"]) == 2


def test_a_condition_needs_a_value(lab, capsys):
    code, _, err = fixel(capsys, "list", "--project", lab, "--where", "shape")
    assert code == 2
    assert "found 'shape'" in err


def test_the_environment_names_another_database(lab, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("FIXEL_DATABASE", f"sqlite:///{tmp_path}/elsewhere.db")
    code, _, err = fixel(capsys, "list", "--project", lab)
    assert code == 1
    assert f"run: fixel db upgrade '{lab}'" in err
    code, _, err = fixel(capsys, "serve", lab)
    assert code == 1
    assert f"run: fixel db upgrade '{lab}'" in err
    assert Path(lab / "experiments.db").exists()


def test_a_bundle_goes_from_one_project_to_another(lab, recording, tmp_path, capsys):
    answer(capsys, "import", recording, "--project", lab)
    answer(capsys, "testbed", "run", "-p", lab, "--limit", "2")
    assert fixel(capsys, "export", lab, tmp_path / "all.zip")[0] == 0
    other = tmp_path / "other"
    fixel(capsys, "new", other)
    dry = answer(capsys, "import", tmp_path / "all.zip", "-p", other, "--dry-run")
    assert dry["experiments"] == 3
    assert answer(capsys, "list", "-p", other)["total"] == 0
    assert answer(capsys, "import", tmp_path / "all.zip", "-p", other)["experiments"] == 3
    assert answer(capsys, "import", tmp_path / "all.zip", "-p", other)["known"] == 3
    assert answer(capsys, "list", "-p", other, "--simulated")["total"] == 2
