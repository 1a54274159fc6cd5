"""`fixel domain growth`, as called from a shell."""

import json

import pytest
from tests.laboratories import campaign
from typer.testing import CliRunner

from fixel.cli.main import app
from fixel.errors import InvalidInput


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return campaign(tmp_path_factory.mktemp("projects") / "my lab")


def call(folder, *arguments):
    return CliRunner().invoke(app, ["domain", "growth", "-p", str(folder), *map(str, arguments)])


@pytest.mark.system
def test_the_answer_for_people(folder, tmp_path):
    result = call(folder, "--threshold", "1.5mm", "--plot", tmp_path / "drawn")
    assert result.exit_code == 0, result.output
    for words in (
        "Largest error in the domain [mm²]",
        "square collinear-tight",
        "step 5",
        "Domain along each axis at 2.25 mm²",
        "set of 3 samples:",
        "at E = 2.25 mm²",
        "Warning: SIMULATED by",
        f"Next: fixel report --project '{folder}'",
    ):
        assert words in result.stdout
    names = {path.name for path in (tmp_path / "drawn").iterdir()}
    assert {"growth_matrix.png", "growth_matrix.pdf", "axis_square_y.csv"} <= names


@pytest.mark.system
def test_the_answer_for_programs(folder):
    result = call(folder, "--json", "--index", "printed", "--sizes", "2", "--sizes", "y=3,4")
    answer = json.loads(result.stdout)
    assert answer["index"] == "printed"
    assert len(answer["groups"][0]["largest_error"]) == 6
    assert [(a["axis"], a["size"]) for a in answer["axes"]] == [
        ("x", 2), ("y", 3), ("y", 4), ("theta", 2),
    ]  # fmt: skip
    assert answer["step_length"]["y"] == pytest.approx(8e-3)


@pytest.mark.parametrize(("arguments", "words"), [
    (("--index", "other"), "corrected' or 'printed'"),
    (("--sizes", "z=3"), "--sizes"),
    (("--sizes", "y=many"), "--sizes"),
    (("--sizes", "y=7"), "2 to 5"),
    (("--threshold", "0"), "--limit is '0', but must be a positive number"),
    (("--limit", "-1mm"), "--limit is '-1mm', but must be a positive number"),
    (("--shape", "disc"), "--shape is 'disc', but must be one of square"),
    (("--dataset", "none"), "--dataset is 'none', but must be one of testbed"),
    (("--motion", "dynamic"), "--motion is 'dynamic', but must be one of quasistatic"),
    (("--error", "ends"), "--error is 'ends', but must be one of "),
])  # fmt: skip
def test_what_cannot_be_is_refused(folder, arguments, words):
    result = call(folder, *arguments)
    assert isinstance(result.exception, InvalidInput)
    assert words in str(result.exception)
