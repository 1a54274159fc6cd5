"""Calibrations and the domain, asked for by a program."""

import html
import json
import os
import re
import shutil
import time
from contextlib import ExitStack, closing
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.calibrating import collected
from tests.jobs.helpers import await_true
from tests.laboratories import trusted_laboratory
from tests.web.bench import Bench
from tests.web.conftest import unpacked
from typer.testing import CliRunner

from fixel.calibration.study import OUT_OF_BUDGET
from fixel.cli.main import app
from fixel.database.project import Project
from fixel.errors import StoreRefused
from fixel.jobs.folder import read_job
from fixel.web.views.calibration_views import ProgressReader
from fixel.web.views.domain_views import document
from fixel.workflows import jobs

ANSWERS_WITHIN = 0.2  # [s] of processor time: a map at another threshold
FIT = ["mu_pusher=0:1:0.2"]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return trusted_laboratory(tmp_path_factory.mktemp("copy") / "my_lab")


@pytest.fixture
def folder(tmp_path):
    """A laboratory that one test may damage."""
    return trusted_laboratory(tmp_path / "my_lab")


@pytest.fixture
def opened(folder):
    """Open that laboratory, in the state in which it is by then."""
    with ExitStack() as stack:
        yield lambda: stack.enter_context(closing(Bench(folder)))


# --- calibrations -------------------------------------------------------------------------------


def test_the_list_says_what_came_of_each(bench):
    answer = bench.get("/calibrations")
    (one,) = answer["calibrations"]
    assert (one["name"], one["experiments"], one["mode"]) == ("first", 6, "joint")
    assert one["after"] < one["before"]
    assert sum(one["verdicts"].values()) == 2
    assert answer["running"] == []


def test_former_addresses_of_forms_lead_to_them(bench):
    answer = bench.client.get("/calibrations/new?experiments=6,7&filter=shape=square")
    assert answer.status_code == 200
    assert answer.url.path.endswith("/run/calibrate")
    assert answer.url.query == b"experiments=6&experiments=7&where=shape%3Dsquare"
    assert bench.client.get("/next").url.path.endswith("/run/next")


def test_plots_of_one_are_pictures(bench):
    for kind in ("search", "starts", "profiles"):
        answer = bench.client.get(f"/api/v1/calibrations/1/{kind}.png")
        assert (answer.status_code, answer.content[:4]) == (200, b"\x89PNG")
    for address in ("1/other", "99/search"):
        bench.get(f"/calibrations/{address}.png", 404)


def test_one_has_parameters_starts_profiles_and_residuals(bench):
    one = bench.get("/calibrations/1")
    assert [row["label"] for row in one["parameters"]] == ["mu_pusher", "tripod_radius"]
    for row in one["parameters"]:
        assert row["bounds"][0] <= row["value"] <= row["bounds"][1]
        assert row["verdict"]
        assert row["unit"] in ("-", "m")
    assert [curve["label"] for curve in one["curves"]] == ["mu_pusher", "tripod_radius"]
    assert len(one["starts"]) == 2
    ends = [start["error"] for start in one["starts"]]
    assert ends == sorted(ends)
    after = [residual["after"] for residual in one["residuals"]]
    assert after == sorted(after, reverse=True)
    assert one["worst"] == one["residuals"][:3]
    objective = unpacked(one["objective"])
    # The smallest mean error per experiment so far, as in the list and in the waterfall.
    assert objective.min() == pytest.approx(float(np.mean(after)))
    assert objective.min() == pytest.approx(ends[0])
    assert one["complete"]
    assert one["command"].startswith("fixel calibrate")
    compile(one["python"], "page", "exec")


def test_errors_of_a_calibration_have_equal_decimals_on_its_page(bench):
    page = bench.client.get("/calibrations/1").text
    table = page[page.index("Errors of all experiments") :]
    found = re.findall(r'class="number">(?:<strong>)?([0-9.]+)<', table)

    assert len(found) >= 2
    assert {len(text.partition(".")[2]) for text in found} == {3}


def test_one_whose_job_is_gone_still_says_all_of_it(bench, folder, opened):
    shutil.rmtree(folder / "jobs")
    alone = opened()
    one = alone.get("/calibrations/1")
    assert one.pop("python") != ""
    whole = bench.get("/calibrations/1")
    assert whole.pop("python") != ""
    assert one == whole
    assert one["complete"]
    assert one["starts"]


def test_the_objective_read_from_the_journal_is_the_one_that_is_stored(bench, project):
    watch = ProgressReader(Project(project), bench.context.store)
    (folder,) = (p.parent for p in (project / "jobs").glob("first-*/job.json"))
    seen = watch.look(folder)
    assert seen.stored == [1]
    one = bench.get("/calibrations/1")
    stored = unpacked(one["objective"])
    # A point that is asked for again is answered from the journal, and stands there once.
    assert set(np.round(seen.objective, 9)) == set(np.round(stored, 9))
    assert seen.best == pytest.approx(stored.min())
    assert seen.start == pytest.approx(np.mean([push["before"] for push in one["residuals"]]))


def test_jobs_that_are_not_done_are_read_without_all_calibrations(folder, tmp_path, monkeypatch):
    """Reading 500 stored calibrations took 0.1 s, and was repeated for each of 200 jobs."""
    lab = Project(shutil.copytree(folder, tmp_path / "lab"))
    (lab.folder / "experiments.db-wal").unlink(missing_ok=True)
    for k in range(3):
        copied = shutil.copytree(
            next((lab.folder / "jobs").iterdir()), lab.folder / "jobs" / f"n{k}"
        )
        (copied / "state.json").write_text('{"state": "stopped"}')
    with lab.store() as store:
        watch, asked = ProgressReader(lab, store), []
        summaries = store.calibration_summaries
        monkeypatch.setattr(store, "calibration_summaries", lambda: asked.append(1) or summaries())
        found, unreadable = watch.unfinished()
    assert (len(found), unreadable, len(asked)) == (3, [], 1)


def begun(bench, status=200, **changes):
    body = {"experiments": ["6", "7"], "fit": FIT, "mode": "joint", "verdicts": False} | changes
    return bench.post("/run/calibrate", body, status)


def awaited(bench, name, good):
    def seen():
        found = bench.get(f"/calibrations/jobs/{name}")
        return found if good(found) else None

    return await_true(seen, "the progress of a calibration")


@pytest.mark.system
def test_one_is_begun_in_a_process_of_its_own_and_stored(bench, project):
    asked = {"name": "mine", "optimiser": "nelder-mead", "max_evaluations": 12}
    job = begun(bench, **asked)["job"]
    seen = awaited(bench, job["name"], lambda seen: seen["stored"])
    assert seen["evaluations"] >= 12
    one = bench.get(f"/calibrations/{seen['stored'][0]}")
    assert one["name"].startswith("mine: 2 experiments")
    assert one["command"].split()[:4] == ["fixel", "calibrate", "6", "7"]
    assert "--fit mu_pusher=0:1:0.2" in one["command"]
    # Asked for again, it is there already.
    again = begun(bench, **asked)["job"]
    assert bench.get(f"/calibrations/jobs/{again['name']}")["stored"] == seen["stored"]


@pytest.mark.system
def test_a_sample_within_a_budget_is_the_one_that_the_command_draws(bench, project):
    ids = ["6", "7", "8", "9", "10", "11"]
    asked = {"optimiser": "least-squares", "sample": 2, "seed": 5, "budget": 1e-3}
    job = begun(bench, experiments=ids, name="few", **asked)["job"]
    seen = awaited(bench, job["name"], lambda seen: seen["stored"])
    one = bench.get(f"/calibrations/{seen['stored'][0]}")
    assert len(one["residuals"]) == 2
    assert one["ended"] == OUT_OF_BUDGET
    assert (one["method"]["sample_of"], one["method"]["budget"]) == (6, 1e-3)
    typed = f"calibrate {' '.join(ids)} --project {project} --fit mu_pusher --name typed"
    typed += " --sample 2 --seed 5 --budget 1e-3 --no-verdicts --prepare --json"
    shown = json.loads(CliRunner().invoke(app, typed.split()).stdout)
    drawn = [project / "jobs" / job["name"], Path(shown["job"])]
    assert len({(d / "inputs" / "targets.json").read_bytes() for d in drawn}) == 1
    requests = [json.loads((d / "inputs" / "request.json").read_bytes()) for d in drawn]
    assert requests[0]["sample_of"] == requests[1]["sample_of"] == 6
    assert requests[0]["budget"] == requests[1]["budget"] == 1e-3
    bench.post("/run/calibrate", {"fit": FIT, "mode": "each", "budget": 9.0}, 422)


@pytest.mark.system
def test_one_is_stopped_and_goes_on(bench, project):
    long = {"name": "long", "max_evaluations": 1_000_000, "starts": 20}
    long |= {"optimiser": "pattern-search"}
    name = begun(bench, **long)["job"]["name"]
    folder = project / "jobs" / name
    seen = awaited(bench, name, lambda seen: seen["evaluations"] >= 5)
    assert seen["state"] == "running"
    assert (seen["most"], seen["at_most"]) == (1_000_000, True)
    pid = json.loads((folder / "state.json").read_text())["pid"]
    # Ctrl-C in the server's terminal goes to the server's session.
    assert os.getsid(pid) != os.getsid(0)
    assert begun(bench, 409, **long)
    assert bench.post(f"/jobs/{name}/cancel")["job"]["state"] == "cancelled"
    kept = bench.get(f"/calibrations/jobs/{name}")
    assert kept["ended"]
    assert kept["evaluations"] >= seen["evaluations"]
    assert name in [one["name"] for one in bench.get("/calibrations")["running"]]
    bench.post(f"/jobs/{name}/resume")
    awaited(bench, name, lambda seen: seen["evaluations"] > kept["evaluations"])
    bench.post(f"/jobs/{name}/cancel")
    assert jobs.status_of(folder).state == "cancelled"


def test_what_was_computed_elsewhere_is_stored_once_by_who_looks(folder, opened):
    (job,) = (p.parent for p in (folder / "jobs").glob("first-*/job.json"))
    inputs = {path.name: path.read_bytes() for path in (job / "inputs").iterdir()}
    inputs["request.json"] = inputs["request.json"].replace(b'"first"', b'"away"')
    elsewhere = folder.parent / "elsewhere"
    made = read_job(job)
    jobs.prepare_job(elsewhere, maker=made.maker, inputs=inputs, options=made.options)
    assert jobs.run_here(elsewhere).state == "done"
    brought = elsewhere.rename(folder / "jobs" / "brought")
    alone = opened()
    for _ in range(2):
        one, _ = alone.get("/calibrations")["calibrations"]
        assert (one["id"], one["sets"]) == (2, 1)
        assert one["name"].startswith("away")
    assert collected(Project(folder), brought).ids == (2,)
    assert collected(Project(folder), job).ids == (1,)


def test_a_damaged_result_is_made_again_out_of_the_journal(folder, opened):
    (job,) = (p.parent for p in (folder / "jobs").glob("first-*/job.json"))
    whole = (job / "result").read_bytes()
    (job / "result").write_bytes(whole[:100])
    alone = opened()
    assert alone.get("/calibrations/1")["complete"]  # which is stored with it
    with pytest.raises(StoreRefused, match="delete that file, then: fixel jobs resume"):
        collected(Project(folder), job)
    (job / "result").unlink()
    assert jobs.status_of(job).state == "lost"
    assert jobs.run_here(job).state == "done"
    assert alone.get("/calibrations/1")["complete"]
    assert len(alone.get("/calibrations")["calibrations"]) == 1


DAMAGE = {"cut short": lambda data: data[: len(data) // 2], "else": lambda data: b'{"a": 1}'}
SEEN = [
    "/calibrations", "/calibrations/1", "/run/calibrate", "/domain", "/jobs", "/system",
    "/api/v1/calibrations", "/api/v1/calibrations/1", "/api/v1/domain/{map}",
    "/api/v1/analyses", "/api/v1/jobs",
]  # fmt: skip


@pytest.mark.parametrize("how", DAMAGE)
@pytest.mark.parametrize("path", [
    "analyses/domain-*/analysis.json", "analyses/domain-*/arrays.npz",
    "analyses/held-out/*/evidence.json", "jobs/first-*/inputs/request.json",
    "jobs/first-*/inputs/targets.json", "jobs/first-*/inputs/about.json",
    "jobs/first-*/inputs/poses.npz", "jobs/first-*/job.json", "jobs/first-*/state.json",
    "jobs/first-*/run.json", "jobs/first-*/journal", "jobs/first-*/result",
])  # fmt: skip
def test_a_damaged_file_is_named_and_hides_nothing_else(folder, opened, path, how):
    (file,) = folder.glob(path)
    file.write_bytes(DAMAGE[how](file.read_bytes()))
    alone = opened()
    (name,) = (p.name for p in (folder / "analyses").glob("domain-*"))
    seen = {place: alone.client.get(place.format(map=name)) for place in SEEN}
    for place, answer in seen.items():
        assert answer.status_code < 500, (place, answer.text)
        assert answer.status_code == 200 or "{map}" in place, (place, answer.text)
    (one,) = alone.get("/calibrations")["calibrations"]
    assert one["after"] < one["before"]
    if file.name in ("analysis.json", "evidence.json"):
        texts = [answer.text for answer in seen.values()]
        assert any(file.name in text or "compute the map again" in text for text in texts)


@pytest.mark.parametrize(("changes", "where"), [
    ({"fit": ["nonsense=0:1"]}, "nonsense"),
    ({"fit": ["mu_pusher=1:0"]}, "mu_pusher"),
    ({"fit": FIT * 2}, "mu_pusher"),
    ({"name": "../../x"}, "name"),
    ({"experiments": [], "where": ["shape=none"]}, "shape"),
    ({"max_evaluations": 0}, "max_evaluations"),
    ({"optimiser": "least-squares", "mode": "each"}, "least-squares"),
    ({"space": "/etc/passwd"}, "space"),
    ({"motion": "/bin/true"}, "program"),
    ({"colour": "red"}, "colour"),
])  # fmt: skip
def test_what_cannot_be_is_refused(bench, project, changes, where):
    before = sorted((project / "jobs").iterdir())
    body = {"experiments": ["6", "7"], "fit": FIT} | changes
    assert where in bench.post("/run/calibrate", body, 422)["sentence"]
    assert sorted((project / "jobs").iterdir()) == before


@pytest.mark.parametrize("name", ["%2e%2e", "..%2f..", "nothing", "first-", "*"])
def test_no_part_of_an_address_becomes_a_path(bench, name):
    assert bench.client.get(f"/api/v1/calibrations/jobs/{name}").status_code in (404, 405)
    assert bench.client.get(f"/calibrations/running/{name}").status_code == 404
    assert bench.client.get(f"/api/v1/analyses/{name}/{name}.png").status_code in (404, 405)
    assert bench.client.get(f"/api/v1/domain/{name}/map").status_code in (404, 405)


def test_texts_of_an_address_are_shown_as_text(bench):
    assert bench.client.get("/calibrations/999").status_code == 404
    asked = bench.client.get('/run/calibrate?where="><script>alert(1)</script>&experiments=6')
    assert "<script>alert" not in asked.text
    assert ">6</textarea>" in asked.text


# --- the domain ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def name(bench):
    (one,) = bench.get("/analyses?kind=domain")["analyses"]
    return one["name"]


def test_a_map_for_every_threshold(bench, name):
    view = bench.get(f"/domain/{name}")
    assert (view["unit"], view["simulated"]) == ("mm", True)
    (panel,) = view["panels"]
    assert (panel["across"]["name"], panel["up"]["name"]) == ("offset_y_m", "shape")
    assert len(panel["rows"]) == len(panel["up"]["ticks"]) == 2
    assert len(panel["rows"][0]) == len(panel["across"]["ticks"])
    (cells,) = view["verdicts"]
    assert all(
        one["within"] == (one["error"] <= view["claim"]["threshold"])
        for cell in cells
        for one in cell["experiments"]
    )
    assert any("Measurement noise" in remark for remark in view["remarks"])
    for below in ("threshold=0", "threshold=nan", "level=1"):
        assert bench.get(f"/domain/{name}?{below}", 422)
        assert 'role="alert"' in bench.client.get(f"/domain?{below}").text
    text = html.unescape(bench.client.get("/domain?threshold=x").text)
    assert re.search(r"threshold is 'x', but must be a number\s*<", text)


def test_one_experiment_that_is_left_out_is_one(bench, name, project):
    view = bench.context.domain(name, bench.get(f"/analyses/{name}")["created"])
    remarks = document(view._replace(n_aside=1), view.domain.claimed, project).remarks
    assert "Skipped 1 experiment: offset along a coordinate without an axis." in remarks


def test_more_is_within_a_larger_threshold(bench, name):
    chances = []
    for threshold in (1.0, 3.0, 10.0, 30.0):
        shown = bench.get(f"/domain/{name}?threshold={threshold}")
        values = [
            cell["chance"] for cell in chain(*shown["verdicts"]) if cell["chance"] is not None
        ]
        assert all(0.0 <= p <= 1.0 for p in values)
        chances.append(np.array(values))
        assert sum(int(n) for _, n in shown["figures"][:-1]) == sum(map(len, shown["verdicts"]))
        assert f"--threshold-mm {threshold}" in shown["command"]
    assert all((b >= a - 1e-3).all() for a, b in pairwise(chances))


def test_it_is_the_map_that_was_kept(bench, name, project):
    kept = json.loads((project / "analyses" / name / "analysis.json").read_text())["numbers"]
    cells = list(chain(*bench.get(f"/domain/{name}")["verdicts"]))
    assert [cell["colour"] for cell in cells] == [cell["colour"] for cell in kept["cells"]]
    for shown, cell in zip(cells, kept["cells"], strict=True):
        assert shown["chance"] == (
            None if cell["confidence"] is None else pytest.approx(cell["confidence"], abs=1e-4)
        )
    assert [cell["inside"] for cell in cells] == [cell["in_domain"] for cell in kept["cells"]]
    suggested = bench.get(f"/domain/{name}/next")["proposals"]
    assert [one["where"] for one in suggested] == [one["cell"] for one in kept["next"][:3]]


def test_another_threshold_answers_at_once(bench, name):
    bench.get(f"/domain/{name}")
    begun = time.process_time()
    for k in range(5):
        bench.get(f"/domain/{name}?threshold={3 + k}")
    each = (time.process_time() - begun) / 5
    print(f"{1e3 * each:.0f} ms")
    assert each < ANSWERS_WITHIN


def test_pictures_of_analyses(bench, name):
    (one,) = bench.get("/analyses")["analyses"]
    assert one["name"] == name
    assert one["warnings"]
    for picture in one["pictures"]:
        for ending, start in (("png", b"\x89PNG"), ("pdf", b"%PDF")):
            path = f"/api/v1/analyses/{name}/{picture['name']}.{ending}"
            assert bench.client.get(path).content.startswith(start)
    bench.get(f"/analyses/{name}/analysis.json", 404)
    bench.get(f"/analyses/{name}/nothing.png", 404)


def test_a_map_whose_evidence_is_gone_says_so(folder, opened):
    shutil.rmtree(folder / "analyses" / "held-out")
    alone = opened()
    (one,) = alone.get("/analyses?kind=domain")["analyses"]
    assert "fixel domain" in alone.get(f"/domain/{one['name']}", 409)["hint"]
    assert alone.client.get("/domain").status_code == 200


def test_a_map_of_an_earlier_version_says_so(folder, opened):
    (stored,) = (folder / "analyses").glob("domain-*/analysis.json")
    content = json.loads(stored.read_text())
    stored.write_text(json.dumps({**content, "request": {}, "question": {"by": []}}))
    alone = opened()
    refused = alone.get(f"/domain/{stored.parent.name}", 409)
    assert "earlier version" in refused["sentence"]
    assert "fixel domain" in refused["hint"]


def test_the_map_is_computed_again_from_its_form(bench, name, project):
    """Other facets than any experiment has: the form ends in a job that refuses them."""
    page = bench.client.get(f"/run/domain?from={name}")
    assert page.status_code == 200
    assert 'value="6.0"' in page.text
    assert bench.client.get(f"/results/{name}").text.count(f"/domain?map={name}") == 1
