"""`fixel demo`: its table, its claims, and what it prints of them."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from fixel.cli import main
from fixel.errors import InvalidInput
from fixel.formats.goal_file import goal_file_from_dict
from fixel.model import Trajectory
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import pushed_square
from fixel.workflows.demo import story_demo
from fixel.workflows.demo.story_demo import GOAL, DemoClaim, DemoStep, expected, write_table


def test_the_range_of_chance_is_that_of_drawn_pushes():
    rng = np.random.default_rng(3)
    n, new = 24, 60
    errors = np.sort(rng.random((20_000, n)), axis=1)
    bound = errors[:, int(np.ceil(0.9 * (n + 1))) - 1]
    inside = (rng.random((20_000, new)) <= bound[:, None]).sum(axis=1)

    low, high = expected(0.9, n, new)

    assert abs(low - np.quantile(inside, 0.025)) <= 1
    assert abs(high - np.quantile(inside, 0.975)) <= 1


def test_the_table_has_the_noise_of_camera_and_clock(tmp_path):
    time = np.arange(2000) * 0.1
    still = Trajectory(time=time, pose=np.zeros((2000, 3)))
    push = replace(example_pushes(1, duration=0.1)[0], trajectory=still, pusher=still)

    write_table(tmp_path / "table.csv", [push], seed=5)

    rows = list(csv.DictReader((tmp_path / "table.csv").read_text().splitlines()))
    read = np.array([[float(x) for x in list(row.values())[2:]] for row in rows])
    assert np.std(read[:, 0] - time) == pytest.approx(2e-3, rel=0.1)  # s
    assert np.std(read[:, 1:], axis=0) == pytest.approx([0.2, 0.2, 0.15, 0.01, 0.01], rel=0.1)
    assert {row["use"] for row in rows} == {"fit"}


@pytest.mark.parametrize("right", [True, False])
def test_a_wrong_claim_is_printed_and_ends_with_an_error(tmp_path, capsys, monkeypatch, right):
    step = DemoStep(
        "Weigh", ("a line",), ("fixel list",), (DemoClaim("mass", "1 kg", "2 kg", right),)
    )
    monkeypatch.setattr(story_demo, "tell_story", lambda *_: iter([step]))

    def demo(*options):
        with pytest.raises(SystemExit) as end:
            main.run(("demo", "--out", str(tmp_path), *options))
        return int(end.value.code or 0), capsys.readouterr().out

    code, out = demo()
    assert code == (0 if right else 1)
    verdict = "right" if right else "WRONG"
    assert f"  {verdict}  mass: fixel states 1 kg; in truth 2 kg" in out
    code, out = demo("--json")
    assert code == (0 if right else 1)
    assert json.loads(out)["claims"][0]["right"] is right
    assert json.loads(out)["wrong"] == (0 if right else 1)


def test_the_goal_file_states_scatter_of_friction_alone():

    content = yaml.safe_load(GOAL)
    scatter = goal_file_from_dict(content).belief.run_to_run
    n = 4000
    runs = scatter.drawn(n, seed=1, scene=pushed_square(), values={"mu_pusher": np.full(n, 0.3)})
    assert np.std(np.log(runs.values["mu_pusher"])) == pytest.approx(0.2, rel=0.05)
    assert not runs.start.any()
    assert not runs.rest.any()
    assert not runs.values["friction_centre_x"].any()
    content["belief"]["run_to_run"] = "learned"
    with pytest.raises(InvalidInput, match="scatter"):
        goal_file_from_dict(content)
