"""Requests of the Compare and Simulate pages."""

import json
from dataclasses import replace

import pytest
from tests.fixtures import bare_experiment
from tests.web.conftest import unpacked

from fixel.formats.scene_file import scene_file_from_dict
from fixel.simulation import simulate
from fixel.web.views import scene_editor
from fixel.workflows.project.compare import compare_run


def test_a_motion_document_has_everything_a_drawing_needs(bench):
    story = bench.get("/experiments/1/motion?simulation=1")
    experiment = bench.context.store.experiment(1)
    measured, simulated = story["motions"]
    assert [measured["kind"], simulated["kind"]] == ["measured", "simulated"]
    pose = unpacked(measured["pose"]["object"])
    assert pose[:, :2] == pytest.approx(experiment.trajectory.pose[:, :2])
    assert unpacked(measured["touch"]["values"]).shape[1] == 3
    assert unpacked(simulated["errors"]["position_m"]).min() >= 0.0
    assert [thing["role"] for thing in story["things"]][:2] == ["object", "pusher"]
    assert len(story["box_m"]) == 4


def test_other_peoples_simulations_are_refused(bench):
    assert bench.get("/experiments/1/motion?simulation=2", 422)
    assert bench.get("/experiments/1/motion?simulation=999", 404)
    assert bench.get("/experiments/999/motion", 404)


@pytest.mark.parametrize(("query", "sentence"), [
    ("set=pinned-1&set=nothing", "values of the scene"),
    ("set=pinned-2%7Cdynamic%7Cmu_support%3D0.4", "set 2"),
    ("pin=yes&mu_pusher=0.3", "mu_pusher=0.3"),
    ("mu_pusher=x", "must be a number"),
    ("mu_pusher=-1", "invalid"),
    ("motion=/bin/true", "pages start no programs"),
    ("adopt=nothing&drop=nothing", "adjusted"),
])  # fmt: skip
def test_an_address_of_a_comparison_holds_its_sets(bench, query, sentence):
    answer = bench.client.get(f"/compare?experiment=1&base=nominal&{query}")
    assert answer.status_code in (200, 422)
    assert sentence in answer.text


def test_a_comparison_is_that_of_the_workflow(bench):
    offered = bench.get("/experiments/1/comparison")
    assert offered["sets"][0]["kind"] == "nominal"
    assert offered["sliders"][0]["unit"] == "-"
    answer = bench.post("/experiments/1/comparison", {"parameters": {"mu_support": 0.4}})
    own = compare_run(bench.context.store.experiment(1), {"mu_support": 0.4})
    assert answer["error_mm2"] == pytest.approx(own.error_mm2)
    shown = unpacked(answer["motion"]["errors"]["position_m"])
    assert shown == pytest.approx(own.position, abs=1e-6)
    contacts = answer["motion"]["contacts"]
    assert unpacked(contacts["force_n"]).shape == unpacked(contacts["point_m"]).shape
    assert "--set mu_support=0.4" in answer["command"]


def test_keeping_one_stores_it(bench):
    wanted = {"parameters": {"mu_pusher": 0.31}, "motion": "quasistatic"}
    kept = bench.post("/experiments/4/simulations", wanted)["id"]
    record = bench.context.store.simulation(kept)
    assert dict(record.parameters) == {"mu_pusher": 0.31}
    assert record.method["motion"] == "quasistatic"
    assert record.provenance.command.startswith("fixel compare testbed/")


def test_nominal_simulations_are_kept_once(bench):
    store = bench.context.store
    seeming = replace(store.experiment(9), name="ends as it starts", effective=(0.0, 0.0))
    added = (bare_experiment("one"), seeming)
    bare, stuck = (store.add_experiment(one).id for one in added)
    wanted = bench.get("/experiments/unsimulated")["ids"]
    assert not {1, bare} & set(wanted)
    assert {8, 9, stuck} <= set(wanted)
    answer = bench.post("/experiments/simulate", {"ids": [1, 8, 9, bare, stuck]})
    assert answer["stored"] == [8, 9]
    assert "found no" in answer["refused"][str(stuck)]
    assert bench.post("/experiments/simulate", {"ids": [8, 9]})["stored"] == []
    (kept,) = store.simulations(8)
    record = store.simulation(kept)
    assert record.provenance.command.endswith(" --save")
    assert record.error_mm2 == pytest.approx(compare_run(store.experiment(8)).error_mm2)
    row = bench.get("/experiments?filter=before>0&limit=1&sort=id")
    assert row["experiments"][0]["before_mm"] > 0
    store.delete([bare, stuck])


@pytest.mark.parametrize(("body", "where"), [
    ({"parameters": {"mu_suport": 0.4}}, "parameters"),
    ({"parameters": {"mu_support": -1.0}}, "mu_support"),
    ({"parameters": {"tripod_radius": 0.0}}, "tripod_radius"),
    ({"motion": "magic"}, "motion"),
    ({"motion": "./a_program.py"}, "motion"),  # pages start no programs
    ({"motion": "pymunk"}, "engine pymunk"),  # whose pusher has no force limit
    ({"parameters": {"mu_support": "much"}}, "body.parameters.mu_support"),
])  # fmt: skip
def test_what_cannot_be_simulated_is_reported_with_its_field(bench, body, where):
    assert bench.post("/experiments/1/comparison", body, 422)["where"] == where


def test_far_too_large_values_have_an_answer_all_the_same(bench):
    for value in (1e-300, 1e3, 1e300):
        body = json.dumps({"parameters": {"mu_support": value}})
        answer = bench.send("/experiments/1/comparison", body)
        assert answer.status_code in (200, 422)
        json.loads(answer.text, parse_constant=pytest.fail)


def test_scenes_come_from_examples_experiments_and_files(bench):
    names = [one["name"] for one in bench.get("/scenes/examples")]
    assert bench.get(f"/scenes/examples/{names[0]}")["scene"]["bodies"]
    own = bench.get("/experiments/1/scene")["scene"]
    assert own["fixels"]
    text = bench.post("/scenes/write", {"scene": own})["text"]
    assert bench.post("/scenes/read", {"text": text})["scene"] == own
    as_json = {"text": json.dumps(own), "is_json": True}
    assert bench.post("/scenes/read", as_json)["scene"] == own


def test_a_scene_is_simulated_in_a_process_of_its_own(bench):
    scene = scene_editor.example("grasp")
    answer = bench.post("/simulate", {"scene": scene})
    story, summary = answer["story"], answer["summary"]
    assert summary["status"] == "converged"
    here = simulate(scene_file_from_dict(scene).scene).pose["object"][-1]
    assert unpacked(story["motions"][0]["pose"]["object"])[-1] == pytest.approx(here, abs=1e-12)
    assert summary["final"]["object"] == pytest.approx(here.tolist())


def test_problems_of_a_scene_name_their_key(bench):
    scene = scene_editor.example("grasp")
    scene["bodies"][0]["mass"] = -1.0
    for path in ("/scenes/check", "/scenes/write", "/simulate"):
        assert bench.post(path, {"scene": scene}, 422)["where"] == "bodies[0].mass"
    scene["bodies"][0]["mass"] = 0.15
    bench.post("/scenes/check", {"scene": scene}, 204)
    scene["fixels"][0]["pose"] = scene["bodies"][0]["pose"]
    refusal = bench.post("/scenes/check", {"scene": scene}, 422)
    assert refusal["where"] == "'object' and 'fixel-1'"


@pytest.mark.parametrize("body", [
    '{"scene": {"bodies": [{"name": "\\ud800"}]}}',
    '{"scene": {"\\ud800": 1}}',
    '{"\\ud800": 1}',
    '{"scene": {"duration": NaN}}',
    '{"scene": {"duration": 1e999}}',
    '{"scene": {"duration": 1' + 400 * "0" + "}}",
    '{"scene": {"bodies": ' + 900 * "[" + 900 * "]" + "}}",
    '{"scene": {"bodies": ' + 90_000 * "[" + 90_000 * "]" + "}}",
    '{"scene": {"fixels": [{"name": "a", "shape": {"disk": true}}]}}',
    '{"scene": []}',
    "{",
    "",
])  # fmt: skip
def test_no_body_is_too_strange_for_an_answer(bench, body):
    for path in ("/scenes/check", "/simulate", "/scenes/write", "/experiments/1/comparison"):
        answer = bench.send(path, body)
        assert 400 <= answer.status_code < 500
        assert answer.json()["sentence"]


def test_the_pages_name_what_they_show(bench):
    assert "testbed/" in bench.client.get("/compare?experiment=2").text
    assert bench.client.get("/compare?experiment=unknown").status_code == 404
    assert 'data-example="grasp"' in bench.client.get("/simulate").text
    strange = bench.client.get("/simulate?example=<script>alert(1)</script>").text
    assert "<script>alert" not in strange


@pytest.mark.parametrize("speed", [1e308, 1e200, 1e-200, 5e-324])
def test_speeds_that_no_pusher_has_are_no_mistake_of_ours(bench, speed):
    scene = scene_editor.example("grasp")
    scene["pushers"][0]["drive"]["speed"] = speed
    answer = bench.post("/simulate", {"scene": scene}, 422 if speed > 1.0 else 200)
    if speed > 1.0:
        assert "fastest motion" in answer["sentence"]


def test_a_body_of_very_many_keys_is_one_complaint(bench):
    """Unknown keys are not listed: 120,000 took 1.5 s until the answer."""
    taking = [
        path
        for path, kinds in bench.api.openapi()["paths"].items()
        if "requestBody" in kinds.get("post", {})
    ]
    assert "/simulate" in taking
    for path in taking:
        keys = {f"key{k}": k for k in range(1001)}
        answer = bench.post(path.format(number=1, name="filter"), keys, 422)
        assert "1001 keys" in answer["sentence"], path
