"""The way of a newcomer: a CSV file of one's own, its scene, a calibration."""

import json
import shlex

import numpy as np
import pytest
from tests.cli.shell import json_of, output, refusal
from tests.closed_form import SIDE, push, table_text

MU = 0.15
HALF = SIDE / 2
SQUARE = (
    f"{{polygon: [[-{HALF}, -{HALF}], [{HALF}, -{HALF}], [{HALF}, {HALF}], [-{HALF}, {HALF}]]}}"
)
LIMIT = f"{{ellipsoid: {{force: 1.0, torque: {0.3826 * SIDE}}}}}"  # as the closed form has it


def test_from_a_table_to_a_friction(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    noise = np.random.default_rng(5)
    for run, (offset, angle) in enumerate(((0.02, 0.0), (0.03, 0.3), (-0.03, -0.2))):
        time, pose, tip = push(MU, offset, angle=angle, rate=25.0)
        pose = pose + noise.normal(size=pose.shape) * (5e-5, 5e-5, 5e-4)
        (tmp_path / f"run {run}.csv").write_text(table_text(time, pose, tip))
    output(capsys, "new", "my lab")

    out = output(capsys, "import", "run 0.csv", "--project", "my lab")
    words = shlex.split(out.splitlines()[-1].removeprefix("Next: "))
    assert words[-2:] == ["--scene", "run 0.scene.yaml"]
    assert "FILL_IN" in refusal(capsys, *words[1:])
    scene = tmp_path / "run 0.scene.yaml"
    text = scene.read_text().replace("shape: FILL_IN", f"shape: {SQUARE}", 1)
    text = text.replace("shape: FILL_IN", "shape: {disk: 0.005}").replace("FILL_IN", "0.5")
    scene.write_text(text.replace("uniform: {friction: 0.25}", LIMIT.strip("{}") + "}"))

    for run in range(3):
        command = ("import", f"run {run}.csv", "--project", "my lab", "--scene", scene)
        assert "stored 1 experiment in" in output(capsys, *command)
    options = ("--motion", "quasistatic", "--fit", "mu_pusher", "--no-verdicts")
    (found,) = json_of(capsys, "calibrate", "--project", "my lab", *options)["found"]
    assert found["parameters"]["mu_pusher"] == pytest.approx(MU, abs=0.02)

    compared = json_of(capsys, "compare", "csv/run 0", "--project", "my lab", "--calibration", "1")
    assert compared["parameters"] == found["parameters"]
    assert compared["method"]["motion"] == "quasistatic"


def test_errors_of_a_log_of_tags_name_the_option(capsys, tmp_path):
    log = tmp_path / "tags.jsonl"
    flat = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    with log.open("w") as file:
        for k in range(20):
            at = {i: [0.1 * i + 1e-3 * k, 0, 0.8] for i in (7, 9)}
            seen = [{"tag_id": i, "pose_t": own, "pose_R": flat} for i, own in at.items()]
            file.write(json.dumps({"time_s": 0.05 * k, "detections": seen}) + "\n")
    words = ("import", log, "--dry-run")
    assert "add --option part=NAME" in refusal(capsys, *words)
    output(capsys, *words, "--option", "part=tag:7", "--option", "pusher=tag:9")
    assert "--option part is '7', but" in refusal(capsys, *words, "--option", "part=7")
    wrong = ("--option", "part=tag:7", "--option", "pusher=tag:8")
    assert "--option pusher is 'tag:8', but" in refusal(capsys, *words, *wrong)
    wrong = ("--option", "part=tag:7", "--option", "reference=plate")
    assert "--option reference is 'plate', but" in refusal(capsys, *words, *wrong)
