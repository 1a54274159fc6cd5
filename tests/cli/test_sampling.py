"""`fixel sample`, as another program would call it: standard output, error, exit code."""

import pytest
from tests.cli.shell import fixel, json_of, output, refusal

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
    answer = json_of(capsys, "sample")
    counts = {k: answer[k] for k in ("plan", "shapes", "layouts", "configurations", "total")}
    assert [*counts.values()] == ["thesis", 2, 10, 21, 420]
    assert answer["problems"] == []
    assert len(answer["experiments"]) == 420
    assert answer["experiments"][0]["axis"] == "nominal"


@pytest.mark.parametrize(
    ("words", "plan"),
    [pytest.param([], thesis_plan, marks=pytest.mark.system), (["--eight-push"], eight_push_plan)],
)
def test_what_it_writes_it_reads(words, plan, tmp_path, capsys):
    file, picture = tmp_path / "my plan.yaml", tmp_path / "plan.png"
    out = output(capsys, "sample", *words, "--output", file, "--plot", picture)
    assert load_plan(file) == plan()
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {file}" in out
    assert f"'{file}'" in out.splitlines()[-1]
    output(capsys, "sample", file)
    refusal(capsys, "sample", file, "--eight-push")


def test_the_scenes_of_a_plan_are_read_back(tmp_path, capsys):
    folder = tmp_path / "eight"
    out = output(capsys, "sample", "--eight-push", "--scenes", folder)
    assert f"wrote {folder}" in out
    assert "speed, numbers of tests 2 to 8" in out
    place = folder / f"{eight_push_plan().experiments[0].name}.yaml"
    assert out.splitlines()[-1] == f"Next: fixel overlay {place} --rig thesis-tags"
    assert planned_rows(folder / "plan.csv") == eight_push_plan().experiments
    assert "a new or empty folder" in refusal(capsys, "sample", "--scenes", folder)


def test_problems_are_reported(tmp_path, capsys):
    path = tmp_path / "plan.yaml"
    path.write_text(plan_text(thesis_plan()).replace("travel: 0.15", "travel: 0.03"))
    out = output(capsys, "sample", path)
    assert "420 problems, checked by geometry" in out
    assert "001-square-collinear-tight-nominal: the head stops" in out
    assert "... and 400 more" in out
    assert "source" not in out


@pytest.mark.slow
def test_simulating_finds_more(capsys):
    answer = json_of(capsys, "sample", "--simulate")
    assert answer["rehearsed"]
    assert 0 < len(answer["problems"]) <= 25


@pytest.mark.parametrize(("arguments", "sentence"), [
    (["nowhere.yaml"], "nowhere.yaml"),
    (["--plot", "plan.bmp"], "fixel needs a picture file"),
    (["--out", "plan.txt"], "fixel needs a plan file"),
    (["--out", "no/such/folder/plan.yaml"], "no folder"),
    (["bad.yaml"], "fixel: bad.yaml: head.speed is -1"),
    (["good.yaml", "--out", "good.yaml"], "the plan file itself"),
    (["--eight-push", "--table"], "--eight-push: found another plan too"),
    (["good.yaml", "--table"], "--table: found another plan too"),
    (["rows.csv"], "fixel import rows.csv; or perform its rows: fixel bench rows.csv"),
])  # fmt: skip
def test_bad_input_exits_2(arguments, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    good = plan_text(thesis_plan())
    (tmp_path / "good.yaml").write_text(good)
    (tmp_path / "rows.csv").write_text("name,x_mm\none,3\n")
    (tmp_path / "bad.yaml").write_text(good.replace("speed: 0.0135", "speed: -1.0"))
    assert sentence in refusal(capsys, "sample", *arguments)
    assert not (tmp_path / "plan.bmp").exists()


def test_no_command_proposes_itself(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["sample", "--eight-push", "--out", "eight.yaml"]
    for _ in range(4):
        follows = output(capsys, *words).splitlines()[-1].removeprefix("Next: fixel ").split()
        assert follows != words
        words = follows
        if words[0] != "sample":
            break
    assert words[0] == "overlay"
    assert (tmp_path / words[1]).is_file()


def test_a_plan_of_a_table_is_run_next(tmp_path, capsys):
    file = tmp_path / "table.yaml"
    out = output(capsys, "sample", "--table", "--out", file)
    assert "54 places of the rig on the table" in out
    assert out.splitlines()[-1] == f"Next: fixel testbed run {file}"
    refusal(capsys, "sample", "--table", "--eight-push")
    refusal(capsys, "sample", file, "--table")


@pytest.mark.system
def test_a_planned_table_is_run_and_checked(tmp_path, capsys):
    lab, file = tmp_path / "lab", tmp_path / "table.yaml"
    fixel(capsys, "new", lab)
    fixel(capsys, "sample", "--table", "--out", file)
    fixel(capsys, "testbed", "run", file, "--uneven-table", "2", "--project", lab)
    words = ("table", "check", "--project", lab)
    out = output(capsys, *words, "--plot", tmp_path / "pictures")
    answer = json_of(capsys, *words)
    assert out.startswith("The table is not good enough for 2 mm and 3 deg: with it 0.")
    assert (tmp_path / "pictures" / "pairs.png").is_file()
    assert answer["verdict"] == "not good enough"
    assert [own["name"] for own in answer["effects"]] == [
        "noise", "place", "orientation", "tilt", "drift"
    ]  # fmt: skip
    assert answer["effects"][1]["position_m"][1] > 0.0
    assert refusal(capsys, *words, "--where", "step=7").count("\n") == 1
    wide = json_of(capsys, *words, "--position-mm", "20", "--angle-deg", "30")
    assert wide["verdict"] == "good enough"
