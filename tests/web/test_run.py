"""Form, job and result page of every capability."""

import json
import re
from html import unescape

import pytest
from tests.contracts.test_capabilities import SHORT, project_of_all
from tests.web.bench import Bench

from fixel.jobs.folder import read_job
from fixel.web.pages.run import FORMS
from fixel.web.security import FORM, WORD_FIELD
from fixel.workflows import jobs
from fixel.workflows.capabilities import run
from fixel.workflows.table_check import table_check

EVERY = pytest.mark.parametrize("capability", FORMS.values(), ids=[*FORMS])
# Those whose results are analyses; others store records, which have pages of their own. Results of
# the domain need a campaign and minutes; the contract of capabilities computes them.
SLOW = ("domain", "error-bound", "growth")
STORING = [own for own in FORMS.values() if own.inputs is None and own.name not in SLOW]
WITH_RESULT = pytest.mark.parametrize("capability", STORING, ids=[own.name for own in STORING])
QUICK = [own for own in STORING if own.name not in ("plan", "uncertainty")]  # these take seconds
DOCUMENT = {"sec-fetch-mode": "navigate", "sec-fetch-dest": "document"}
EVIL = "<script>window.hacked = 1</script>"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    made = Bench(project_of_all(tmp_path_factory.mktemp("projects") / "lab").folder)
    yield made
    made.close()


@pytest.fixture
def begun(monkeypatch):
    """Jobs are prepared only; the folders of those that would run."""
    folders = []
    monkeypatch.setattr(jobs, "run_detached", lambda folder, then="": folders.append(folder))
    return folders


def shown(capability):
    """Return a request that a page can make."""
    every = SHORT[capability.name].items()
    return capability.request({k: v for k, v in every if capability.options[k].on_page})


def fields_of(capability, request):
    """The fields that a browser posts."""
    shown = {name: option for name, option in capability.shown.items() if option.on_page}
    texts = capability.texts(request)
    return {
        name: "\r\n".join(texts[name]) if option.many else (texts[name] or [""])[0]
        for name, option in shown.items()
    }


def filled_in(page):
    """The fields as a page shows them."""
    found = dict(re.findall(r'<input id="([^"]*)"[^>]* value="([^"]*)"', page))
    found |= dict(re.findall(r'<textarea id="([^"]*)"[^>]*>([^<]*)<', page))
    for name, inner in re.findall(r'<select id="([^"]*)"[^>]*>(.*?)</select>', page, re.S):
        found[name] = next(iter(re.findall(r"<option selected>([^<]*)<", inner)), "")
    return {name: unescape(text).replace("\n", "\r\n") for name, text in found.items()}


@EVERY
def test_a_form_shows_every_option_with_its_default_and_meaning(capability, bench):
    page = bench.client.get(f"/run/{capability.name}").text
    shown = {name: o for name, o in capability.shown.items() if o.on_page}

    assert {*filled_in(page)} == {*shown}
    for option in shown.values():
        assert f">{option.label}</label>" in page
        assert option.meaning[:30] in unescape(page)
    places = capability.request(SHORT[capability.name])
    defaults = {o.name: o.default for o in capability.options.values() if not o.required}
    usual = places.model_copy(update=defaults)
    required = {o.name for o in capability.options.values() if o.required}
    wanted = fields_of(capability, usual)
    assert {k: v for k, v in filled_in(page).items() if k not in required} == {
        k: v for k, v in wanted.items() if k not in required
    }


@WITH_RESULT
def test_a_posted_form_starts_the_job_of_the_same_request(capability, bench, begun):
    request = shown(capability)
    answer = bench.submit(f"/run/{capability.name}", **fields_of(capability, request))

    (folder,) = begun
    assert (answer.status_code, answer.headers["location"]) == (
        303,
        f"{bench.gate.root}/jobs/{folder.name}",
    )
    options = read_job(folder).options
    assert capability.from_json(json.dumps(options["request"])) == request
    assert "queued" in bench.client.get(f"/jobs/{folder.name}").text
    assert bench.submit(f"/jobs/{folder.name}", do="cancel").status_code == 303
    assert "cancelled" in bench.client.get(f"/jobs/{folder.name}").text


@EVERY
def test_a_wrong_value_is_refused_next_to_its_field(capability, bench, begun):
    request = capability.request(SHORT[capability.name])
    for option in capability.shown.values():
        if option.door.least is None or not option.on_page:
            continue
        wrong = {**fields_of(capability, request), option.name: str(option.door.least - 1)}
        answer = bench.submit(f"/run/{capability.name}", **wrong)
        assert answer.status_code == 422
        about = answer.text.partition(f'id="about-{option.name}">')[2].partition("</small>")[0]
        assert f"{option.label} is" in unescape(about)
        assert filled_in(answer.text) == wrong
    assert begun == []


@pytest.mark.parametrize(
    "capability",
    [pytest.param(own, marks=[] if own in QUICK else pytest.mark.system) for own in STORING],
    ids=[own.name for own in STORING],
)
def test_a_result_page_has_all_that_the_terminal_prints(capability, bench):
    request = capability.request(SHORT[capability.name])
    done = run(capability, request, bench.folder, progress=False)
    page = bench.client.get(f"/results/{done.folder.name}").text
    analysis = done.analysis

    for sentence in (*analysis.warnings, *analysis.headline, *analysis.notes, analysis.command):
        assert sentence in unescape(page)
    cells = [cell for table in analysis.tables for row in table.cells for cell in row]
    assert all(f">{cell}</t" in unescape(page) for cell in cells)
    assert bench.client.get("/results").text.count(f"/results/{done.folder.name}") == 1
    stored = bench.get(f"/analyses/{done.folder.name}")
    assert stored["numbers"] == json.loads(json.dumps(analysis.numbers))
    again = bench.client.get(f"/run/{capability.name}?from={done.folder.name}").text
    assert filled_in(again) == fields_of(capability, request)


def test_a_form_computes_again_whenever_the_experiments_changed(bench, monkeypatch):
    monkeypatch.setattr(jobs, "run_detached", jobs.run_here)
    project, chosen = bench.context.project, "part=part-1"
    ids = [bench.context.store.find(key) for key in project.experiments(chosen).keys[:9]]

    def shown():
        begun = bench.submit("/run/table-check", where=chosen).headers["location"]
        page = bench.client.get(begun.removeprefix(bench.gate.root)).text
        (result,) = set(re.findall(r"/results/([\w-]+)", page))
        effects = bench.get(f"/analyses/{result}")["numbers"]["effects"]
        return [(own["name"], own["pairs"]) for own in effects]

    def now():
        return [(own.name, own.pairs) for own in table_check(project.experiments(chosen)).effects]

    before = now()
    assert shown() == before
    for change in ("flag", "unflag"):
        bench.post(f"/experiments/{change}", {"ids": ids, "name": "late"})
        assert (now() == before) == (change == "unflag")
        assert shown() == now()


def test_texts_of_people_are_shown_as_text(bench, begun):
    fields = {"experiment": EVIL, "particles": EVIL}
    answer = bench.submit("/run/filter", **fields)
    assert answer.status_code == 422
    assert EVIL not in answer.text


@pytest.mark.parametrize(("fields", "status"), [
    ({WORD_FIELD: "guess"}, 403),
    ({WORD_FIELD: ""}, 403),
    ({WORD_FIELD: "x" * 70_000}, 403),
    ({"nonsense": "1"}, 422),
    ({"experiment": ""}, 422),
])  # fmt: skip
def test_forms_of_others_are_refused(fields, status, bench, begun):
    answer = bench.submit("/run/filter", **{"experiment": "push-1", **fields})
    assert answer.status_code == status
    assert begun == []


@pytest.mark.parametrize(("headers", "status"), [
    ({"origin": "null", "sec-fetch-site": "same-origin"}, 303),
    ({"origin": "null", "sec-fetch-site": "cross-site", **DOCUMENT}, 403),
    ({"origin": "null", "sec-fetch-site": "none", **DOCUMENT}, 403),
    ({"origin": "null"}, 403),
    ({"origin": "http://127.0.0.1:9000", "sec-fetch-site": "same-site", **DOCUMENT}, 403),
    ({"sec-fetch-site": "same-site", **DOCUMENT}, 403),
    ({"sec-fetch-site": "cross-site", **DOCUMENT}, 403),
    ({"authorization": "Bearer guess"}, 401),
])  # fmt: skip
def test_a_form_must_come_from_a_page_of_this_server(headers, status, bench, begun):
    client = bench.opened(follow_redirects=False)
    fields = {WORD_FIELD: bench.gate.word, "experiment": "push-1", "seed": "3"}
    answer = client.request("POST", "/run/filter", headers=headers, data=fields)
    assert answer.status_code == status
    assert len(begun) == (status == 303)
    assert bench.stranger().request("POST", "/run/filter", data=fields).status_code == 403
    assert FORM in answer.request.headers["content-type"]


@pytest.mark.parametrize(("name", "field", "texts", "words"), [
    ("uncertainty", "fit", ["mu_pusher=0.5:0.1"], "fit mu_pusher: found bounds 0.5 to 0.1"),
    ("uncertainty", "fit", ["mu_pusher=-1:2"], "fit mu_pusher: found bounds -1 to 2"),
    ("uncertainty", "fit", ["mu_pusher=0:nan"], "fit mu_pusher is 'nan'"),
    ("error-bound", "fit", ["mu_pushr"], "did you mean 'mu_pusher'?"),
    ("domain", "fit", ["mass", "mu_fixel=0.2:0.3:0.5"], "fit mu_fixel.start: found 0.5 outside"),
    ("growth", "limit", ["2 furlongs"], "limit is '2 furlongs'"),
    ("growth", "sizes", ["z=3"], "sizes is 'z=3'"),
    ("filter", "motion", ["dynamic"], "motion is 'dynamic'"),
    ("compare", "parameters", ["mu_pusher=-1"], "parameters mu_pusher is -1.0"),
    ("sensitivity", "values", ["mass=0"], "values mass is 0.0"),
])  # fmt: skip
def test_a_value_that_no_run_accepts_starts_no_job(name, field, texts, words, bench, begun):
    fields = fields_of(FORMS[name], shown(FORMS[name])) | {field: "\r\n".join(texts)}
    answer = bench.submit(f"/run/{name}", **fields)
    about = answer.text.partition(f'id="about-{field}">')[2].partition("</small>")[0]
    assert (answer.status_code, words in unescape(about)) == (422, True), about

    plain = json.loads(shown(FORMS[name]).model_dump_json())
    pairs = {
        k: float(v)
        for k, v in (text.split("=") for text in texts if name in ("compare", "sensitivity"))
    }
    value = pairs or (texts if FORMS[name].options[field].many else texts[0])
    refusal = bench.post(f"/run/{name}", plain | {field: value}, 422)
    assert words in refusal["sentence"]
    assert refusal["where"].split()[0] == field
    assert begun == []


@EVERY
def test_programs_start_the_same_job(capability, bench, begun):
    request = shown(capability)
    kept = bench.post(f"/run/{capability.name}", json.loads(request.model_dump_json()))

    assert kept["job"]["name"] == begun[0].name
    assert capability.name in bench.get("/run")


@pytest.mark.parametrize(("name", "more", "status"), [
    ("filter", {"seed": -1}, 422),
    ("filter", {"nonsense": 1}, 422),
    ("plan", {"goal": "/etc/passwd"}, 422),
    ("nothing", {}, 404),
    ("compare", {"motion": "./mine.py"}, 422),
])  # fmt: skip
def test_requests_of_programs_are_refused(name, more, status, bench, begun):
    refusal = bench.post(f"/run/{name}", {"experiment": "push-1", **more}, status)
    assert status == 404 or {refusal["where"].split()[0]} <= {*more, "option"}
    assert begun == []
