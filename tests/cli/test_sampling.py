"""`fixel sample`, as another program would call it: standard output, error, exit code."""

import json

import pytest
from tests.cli.shell import fixel

from fixel.formats.plan_file import load_plan, plan_text
from fixel.sampling import eight_push_plan, thesis_plan
from fixel.workflows.sampling import planned_rows


def test_without_a_file_it_is_the_plan_of_the_thesis(capsys):
    code, out, err = fixel(capsys, "sample")

    assert (code, err) == (0, "")
    assert out.splitlines()[:6] == [
        "plan thesis",
        "",
        "shape     layouts  configurations  repetitions  experiments",
        "square         10              21            1          210",
        "pentagon       10              21            1          210",
        "2 in all                                                420",
    ]
    assert "tripod radii, frictions, mass of the pentagon, pegs  ours\n" in out
    assert "No problems, checked by geometry." in out
    assert "4 collinear-minus45" in out
    assert out.splitlines()[-1].startswith("Next: fixel sample --out ")


def test_json_has_the_keys_of_the_contract(capsys):
    answer = json.loads(fixel(capsys, "sample", "--json")[1])

    counts = {k: answer[k] for k in ("plan", "shapes", "layouts", "configurations", "total")}
    assert [*counts.values()] == ["thesis", 2, 10, 21, 420]
    assert answer["problems"] == []
    assert len(answer["experiments"]) == 420
    assert answer["experiments"][0]["axis"] == "nominal"


@pytest.mark.parametrize(
    ("words", "plan"),
    [
        pytest.param([], thesis_plan, marks=pytest.mark.system),
        (["--eight-push"], eight_push_plan),
    ],
)
def test_what_it_writes_it_reads(words, plan, tmp_path, capsys):
    file, picture = tmp_path / "my plan.yaml", tmp_path / "plan.png"
    code, out, _ = fixel(capsys, "sample", *words, "--output", file, "--plot", picture)

    assert code == 0
    assert load_plan(file) == plan()
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {file}" in out
    assert f"'{file}'" in out.splitlines()[-1]
    assert fixel(capsys, "sample", file)[0] == 0
    assert fixel(capsys, "sample", file, "--eight-push")[0] == 2


def test_the_scenes_of_a_plan_are_read_back(tmp_path, capsys):
    folder = tmp_path / "eight"
    code, out, _ = fixel(capsys, "sample", "--eight-push", "--scenes", folder)

    assert (code, f"wrote {folder}" in out) == (0, True)
    assert "speed, numbers of tests 2 to 8" in out
    place = folder / f"{eight_push_plan().experiments[0].name}.yaml"
    assert out.splitlines()[-1] == f"Next: fixel overlay {place} --rig thesis-tags"
    assert planned_rows(folder / "plan.csv") == eight_push_plan().experiments
    code, _, err = fixel(capsys, "sample", "--scenes", folder)
    assert (code, "a new or empty folder" in err) == (2, True)


def test_problems_are_told(tmp_path, capsys):
    path = tmp_path / "plan.yaml"
    path.write_text(plan_text(thesis_plan()).replace("travel: 0.15", "travel: 0.03"))

    code, out, _ = fixel(capsys, "sample", path)

    assert code == 0
    assert "420 problems, checked by geometry" in out
    assert "001-square-collinear-tight-nominal: the head stops" in out
    assert "... and 400 more" in out
    assert "source" not in out


@pytest.mark.slow
def test_simulating_finds_more(capsys):
    answer = json.loads(fixel(capsys, "sample", "--simulate", "--json")[1])

    assert answer["rehearsed"]
    assert 0 < len(answer["problems"]) <= 25


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nowhere.yaml"], "nowhere.yaml"),
        (["--plot", "plan.bmp"], "fixel needs a picture file"),
        (["--out", "plan.txt"], "fixel needs a plan file"),
        (["--out", "no/such/folder/plan.yaml"], "no folder"),
        (["bad.yaml"], "fixel: head.speed is -1"),
        (["good.yaml", "--out", "good.yaml"], "the plan file itself"),
    ],
)
def test_bad_input_exits_2(arguments, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    good = plan_text(thesis_plan())
    (tmp_path / "good.yaml").write_text(good)
    (tmp_path / "bad.yaml").write_text(good.replace("speed: 0.0135", "speed: -1.0"))

    code, out, err = fixel(capsys, "sample", *arguments)

    assert (code, out) == (2, "")
    assert sentence in err
    assert not (tmp_path / "plan.bmp").exists()


def test_a_plan_of_a_table_is_run_next(tmp_path, capsys):
    file = tmp_path / "table.yaml"
    code, out, _ = fixel(capsys, "sample", "--table", "--out", file)

    assert code == 0
    assert "54 places of the rig on the table" in out
    assert out.splitlines()[-1] == f"Next: fixel testbed run {file}"
    assert fixel(capsys, "sample", "--table", "--eight-push")[0] == 2
    assert fixel(capsys, "sample", file, "--table")[0] == 2


@pytest.mark.system
def test_a_planned_table_is_run_and_checked(tmp_path, capsys):
    lab, file = tmp_path / "lab", tmp_path / "table.yaml"
    fixel(capsys, "new", lab)
    fixel(capsys, "sample", "--table", "--out", file)
    fixel(capsys, "testbed", "run", file, "--uneven-table", "2", "--project", lab)
    words = ("table", "check", "--project", lab)
    code, out, _ = fixel(capsys, *words, "--plot", tmp_path / "pictures")
    answer = json.loads(fixel(capsys, *words, "--json")[1])

    assert code == 0
    assert out.startswith("The table is not good enough for 2 mm and 3 deg: with it 0.")
    assert (tmp_path / "pictures" / "pairs.png").is_file()
    assert answer["verdict"] == "not good enough"
    assert [own["name"] for own in answer["effects"]] == [
        "noise", "place", "orientation", "tilt", "drift"
    ]  # fmt: skip
    assert answer["effects"][1]["position_m"][1] > 0.0
    code, _, err = fixel(capsys, *words, "--where", "step=7")
    assert code == 2
    assert err.count("\n") == 1
    wide = json.loads(
        fixel(capsys, *words, "--position-mm", "20", "--angle-deg", "30", "--json")[1]
    )
    assert wide["verdict"] == "good enough"
