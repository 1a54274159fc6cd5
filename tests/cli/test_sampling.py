"""`fixel sample`, as another program would call it: standard output, error, exit code."""

import json

import pytest

from fixel.cli import main
from fixel.formats.plan_file import load_plan, plan_text
from fixel.sampling import thesis_plan


def call(capsys, *arguments: object) -> tuple[int, str, str]:
    code = 0
    try:
        main.run([str(a) for a in arguments])
    except SystemExit as end:
        code = int(end.code or 0)
    said = capsys.readouterr()
    return code, said.out, said.err


def test_without_a_file_it_is_the_plan_of_the_thesis(capsys):
    code, out, err = call(capsys, "sample")

    assert (code, err) == (0, "")
    assert out.splitlines()[:6] == [
        "plan thesis",
        "",
        "shape     layouts  configurations  repetitions  experiments",
        "square         10              21            1          210",
        "pentagon       10              21            1          210",
        "2 in all                                                420",
    ]
    assert "No problems, checked by geometry." in out
    assert out.splitlines()[-1].startswith("Next: fixel sample --out ")


def test_json_has_the_keys_of_the_contract(capsys):
    code, out, err = call(capsys, "sample", "--json")
    answer = json.loads(out)

    assert (code, err) == (0, "")
    assert len(out.splitlines()) == 1
    assert {k: answer[k] for k in ("plan", "shapes", "layouts", "configurations", "total")} == {
        "plan": "thesis",
        "shapes": 2,
        "layouts": 10,
        "configurations": 21,
        "total": 420,
    }
    assert answer["problems"] == []
    assert len(answer["experiments"]) == 420
    assert answer["experiments"][0]["axis"] == "nominal"


def test_what_it_writes_it_reads(tmp_path, capsys):
    plan, picture = tmp_path / "my plan.yaml", tmp_path / "plan.png"

    code, out, _ = call(capsys, "sample", "--output", plan, "--plot", picture)

    assert code == 0
    assert load_plan(plan) == thesis_plan()
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {plan}" in out
    assert out.splitlines()[-1] == f"Next: fixel testbed run '{plan}'"
    assert call(capsys, "sample", plan)[0] == 0


def test_problems_are_told(tmp_path, capsys):
    path = tmp_path / "plan.yaml"
    path.write_text(plan_text(thesis_plan()).replace("travel: 0.15", "travel: 0.03"))

    code, out, _ = call(capsys, "sample", path)

    assert code == 0
    assert "420 problems, checked by geometry" in out
    assert "001-square-collinear-tight-nominal: the head stops" in out
    assert "... and 400 more" in out


@pytest.mark.slow
def test_simulating_finds_more(capsys):
    answer = json.loads(call(capsys, "sample", "--simulate", "--json")[1])

    assert answer["rehearsed"]
    assert 0 < len(answer["problems"]) <= 25


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nowhere.yaml"], "nowhere.yaml"),
        (["--plot", "plan.bmp"], "expected a picture file"),
        (["--output", "plan.txt"], "expected a plan file"),
        (["--output", "no/such/folder/plan.yaml"], "no folder"),
        (["BAD"], "fixel: head.speed: found -1"),
        (["GOOD", "--output", "GOOD"], "the plan file itself"),
    ],
)
def test_bad_input_exits_2(arguments, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    good = plan_text(thesis_plan())
    files = {"GOOD": tmp_path / "good.yaml", "BAD": tmp_path / "bad.yaml"}
    files["GOOD"].write_text(good)
    files["BAD"].write_text(good.replace("speed: 0.0135", "speed: -1.0"))

    code, out, err = call(capsys, "sample", *(files.get(a, a) for a in arguments))

    assert (code, out) == (2, "")
    assert sentence in " ".join(err.replace("│", " ").split())
    assert not (tmp_path / "plan.bmp").exists()
