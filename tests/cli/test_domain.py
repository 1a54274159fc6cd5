"""`fixel domain` from the shell: table, JSON, pictures, refusals; fits are done once."""

import json

import pytest
from tests.cli.shell import json_of, missing, output, refusal
from tests.fixtures import project_of

from fixel import Project, SimulatedTestbed
from fixel.domain import held_out
from fixel.sampling.published import thesis_plan
from fixel.workflows.analysis import load_analyses

FIT = ("--fit", "mu_pusher", "--fit", "tripod_radius")


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab") / "lab"
    planned = [
        p
        for p in thesis_plan().experiments[:21]
        if p.conditions["axis"] in ("nominal", "x", "theta")
    ]
    project_of(folder, SimulatedTestbed().run(planned))
    return folder


def test_a_map_its_pictures_and_the_next_command(capsys, project, tmp_path):
    plot = tmp_path / "pictures"
    options = ("--folds", 2, "--threshold-mm", 4, "--plot", plot)
    out = output(capsys, "domain", "-p", project, *FIT, *options)
    lines = out.splitlines()
    assert any(line.startswith("Within 4 mm for 90 % of new experiments:") for line in lines)
    assert any(line.startswith("map") and "offset_theta_rad [deg]" in line for line in lines)
    assert lines[-1] == (
        "Next: fixel domain --threshold-mm 2.0 --folds 2 --fit mu_pusher --fit tripod_radius "
        f"--project {project}"
    )
    names = {path.stem for path in plot.glob("*.png")}
    assert names == {"map-offset_x_m", "map-offset_theta_rad", "size"}
    (one, *_) = load_analyses(Project(project), "domain")
    assert one.analysis.numbers["threshold"] == 4.0
    assert len(one.analysis.numbers["cells"]) == 11
    assert all(picture.caption for picture in one.analysis.pictures)


def test_json_has_the_tables_and_warnings_of_the_text(capsys, project):
    words = ("domain", "-p", project, *FIT, "--folds", 2, "--threshold-mm", 4)
    text, out = output(capsys, *words), output(capsys, *words, "--json")
    lines, answer = text.splitlines(), json.loads(out)
    assert {table["title"] for table in answer["tables"]} <= {*lines}
    rows = [[str(cell) for cell in row] for table in answer["tables"] for row in table["rows"]]
    assert rows
    for cells in rows:
        assert any(all(cell in line for cell in cells if cell[:1].isalpha()) for line in lines)
    assert answer["tables"][0]["rows"][0][0] == "all"
    warned = [line for line in lines if line.startswith("Warning: ")]
    assert warned == [f"Warning: {own}" for own in answer["warnings"]]
    assert len(warned) > 0
    assert answer["headline"] == lines[len(warned) :][: len(answer["headline"])]
    assert missing(text, out) == []


def test_another_threshold_needs_no_fit(capsys, project, monkeypatch):
    words = ("domain", "-p", project, *FIT, "--folds", 2, "--threshold-mm")
    first = json_of(capsys, *words, 4)["numbers"]["cells"]

    def refuse(*_):
        raise AssertionError("a fit")

    monkeypatch.setattr(held_out, "_fold_answer", refuse)
    second = json_of(capsys, *words, 9)["numbers"]["cells"]
    assert [cell["error"] for cell in first] == [cell["error"] for cell in second]

    def green(cells):
        return sum(cell["colour"] == "trusted" for cell in cells)

    assert green(second) >= green(first)


def test_what_was_offset_elsewhere_is_left_out_and_said(capsys, project):
    options = ("--folds", 2, "--axes", "offset_x_m")
    answer = json_of(capsys, "domain", "-p", project, *FIT, *options)
    assert sum(cell["members"] for cell in answer["numbers"]["cells"]) == 6
    assert any("5 experiments were skipped" in sentence for sentence in answer["warnings"])


@pytest.mark.parametrize(("arguments", "said"), [
    (("--threshold-mm", "0.01"), "below the error that measurement noise alone causes"),
    (("--threshold-mm", "2", "--relative", "1"), "one of them"),
    (("--threshold-mm", "0"), "--threshold-mm is 0 mm, but must be more than 0"),
    (("--relative", "1"), "fixel calibrate --mode each"),
    (("--axes", "offset_z_m"), "axis offset_z_m"),
    (("--nominal", "offset_x_m"), "AXIS=VALUE"),
    (("--nominal", "offset_x_m=0.5"), "a value with experiments"),
    (("--step", "offset_x_m=wide"), "a number"),
    (("--by", "colour"), "without colour"),
    (("--facets", "colour"), "without colour"),
    (("--cells", "offset_x_m=-1"), "--cells offset_x_m is -1.0, but must be more than 0"),
    (("--where", "shape=disc"), "--where shape is 'disc', but must be one of square"),
    (("--folds", "40"), "at least 40"),
    (("--calibration", "7"), "no calibration"),
    (("--where", "axis=nominal"), "at least 2"),
])  # fmt: skip
def test_what_cannot_be_is_refused_in_a_sentence(capsys, project, arguments, said):
    fit = () if "--calibration" in arguments else FIT
    folds = () if "--folds" in arguments else ("--folds", "2")
    assert said in refusal(capsys, "domain", "-p", project, *fit, *folds, *arguments)
