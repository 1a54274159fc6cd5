"""The interface for programs against its own description, by Schemathesis.

Few examples here; 200 of each of three kinds, or FIXEL_EXAMPLES, for every operation with

    make test-slow PYTEST_ARGS=tests/web/test_contract.py
"""

import contextlib
import os

import pytest
from hypothesis import HealthCheck, Phase, given, settings, strategies as st
from hypothesis.errors import Unsatisfiable

from fixel.testing.toy_work import MAKER
from fixel.web.api import system
from fixel.web.views import scene_editor
from fixel.workflows import jobs

schemathesis = pytest.importorskip("schemathesis", reason="pip install 'fixel[dev]'")

FEW = 2  # of each of three kinds
MANY = int(os.environ.get("FIXEL_EXAMPLES", "200"))
EXPERIMENTS = 30
PARAMETERS = ("mu_support", "mu_pusher", "mu_fixel", "tripod_radius", "mass")
CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
)


@pytest.fixture(scope="module")
def served(project, server):
    """The server of the module, with a job, and without what takes a minute."""
    jobs.prepare_job(project / "jobs" / "toy", maker=MAKER, options={"rounds": 1, "chunks": 2})
    (project / "jobs" / "toy" / "log.txt").write_text("queued\n")
    tested = {"passed": True, "max_residual": 1e-12, "seconds": 0.1, "checks": []}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(system, "self_tested", lambda: tested)
        yield server


@pytest.fixture(scope="module")
def operations(served):
    """Every operation of the description, by method and path."""
    import requests

    session = requests.Session()
    session.headers["Authorization"] = f"Bearer {served.gate.token}"
    address = f"{served.address}api/v1/openapi.json"
    described = schemathesis.openapi.from_dict(session.get(address, timeout=30).json())
    described.config.update(base_url=f"{served.address}api/v1")
    yield session, {found.ok().label: found.ok() for found in described.get_all_operations()}
    session.close()


def checked(session, case, served):
    """Ask, and hold the answer against the description."""
    answer = case.call(session=session, base_url=f"{served.address}api/v1", timeout=60)
    known = schemathesis.checks
    known.load_all_checks()
    case.validate_response(answer, checks=[known.CHECKS.get_one(name) for name in CHECKS])
    return answer


def tamed(case):
    """The same request about things that are there: what is random would be refused at once."""
    body = case.body
    if isinstance(body, dict) and isinstance(body.get("ids"), list):
        body["ids"] = sorted({1 + abs(hash(one)) % EXPERIMENTS for one in body["ids"]})
    if isinstance(body, dict) and isinstance(body.get("parameters"), dict):
        body["parameters"] = dict(zip(PARAMETERS, body["parameters"].values(), strict=False))
    return case


def exercise(operation, session, served, examples):
    """So many requests in each of three kinds: well-formed, about what is there, ill-formed."""
    modes = schemathesis.GenerationMode
    known = {}
    if "{number}" in operation.path:
        known = {"number": st.integers(1, EXPERIMENTS)}
    if "{name}" in operation.path:
        names = ("toy",) if "/jobs/" in operation.path else ("grasp", "micro_push")
        known = {"name": st.sampled_from(names)}
    answers: dict[int, int] = {}

    def ask(case):
        answer = checked(session, case, served)
        answers[answer.status_code] = answers.get(answer.status_code, 0) + 1

    def about_what_is_there(case, place):
        for name, value in place.items():
            case.path_parameters[name] = value
        ask(tamed(case))

    well, ill = (
        operation.as_strategy(generation_mode=mode) for mode in (modes.POSITIVE, modes.NEGATIVE)
    )
    many(given(case=well)(ask), examples)
    many(given(case=well, place=st.fixed_dictionaries(known))(about_what_is_there), examples)
    with contextlib.suppress(Unsatisfiable):  # nothing about it could be wrong
        many(given(case=ill)(ask), examples)
    return answers


def many(test, examples):
    """Run it with so many examples, the same ones every time."""
    settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=True,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )(test)()


@pytest.mark.system
def test_every_operation_keeps_its_word(operations, served):
    session, found = operations
    assert len(found) > 25
    for label, operation in found.items():
        assert exercise(operation, session, served, FEW), label


@pytest.mark.slow
def test_every_operation_keeps_its_word_for_long(operations, served):
    session, found = operations
    for label, operation in found.items():
        answers = exercise(operation, session, served, MANY)
        print(f"{label:60s} {sum(answers.values()):5d} {answers}")


# --- scenes: what is random is no scene, so true ones are changed in one place ----------------


def places(value, path=()):
    """Every place of a document."""
    yield path
    if isinstance(value, dict | list):
        for key, one in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(one, (*path, key))


def changed(document, path, value):
    """A document with another value in one place."""
    if not path:
        return value
    copy = dict(document) if isinstance(document, dict) else list(document)
    copy[path[0]] = changed(copy[path[0]], path[1:], value)
    return copy


STRANGE = st.one_of(
    st.none(),
    st.booleans(),
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([0, -1, 10**400, 1e308, -1e308, 5e-324, 2**63, "", "\x00", "<b>", "1e3"]),
    st.text(max_size=20),
    st.lists(st.floats(-1.0, 1.0), max_size=4),
    st.dictionaries(st.text(max_size=5), st.integers(), max_size=2),
)


@st.composite
def spoiled_scenes(draw):
    """A scene that comes with fixel, with one or two places changed."""
    scene = scene_editor.example(
        draw(st.sampled_from([one.name for one in scene_editor.examples()]))
    )
    for _ in range(draw(st.integers(1, 2))):
        path = draw(st.sampled_from(list(places(scene))))
        scene = changed(scene, path, draw(STRANGE))
    return scene


def spoil(session, served, examples, *addresses):
    answers = {}

    @settings(max_examples=examples, database=None, suppress_health_check=list(HealthCheck))
    @given(scene=spoiled_scenes(), address=st.sampled_from(addresses))
    def once(scene, address):
        address = f"{served.address}api/v1{address}"
        answer = session.post(address, json={"scene": scene}, timeout=60)
        assert answer.status_code < 500, (address, scene, answer.text)
        answers[answer.status_code] = answers.get(answer.status_code, 0) + 1
        if answer.status_code >= 400:
            assert answer.json()["sentence"], scene

    once()
    return answers


def test_spoiled_scenes_are_refused_with_a_sentence(operations, served):
    answers = spoil(operations[0], served, 60, "/scenes/check", "/scenes/write")
    assert 422 in answers
    assert len(answers) > 1  # some changes do no harm


@pytest.mark.slow
def test_spoiled_scenes_are_simulated_or_refused(operations, served):
    print(spoil(operations[0], served, MANY, "/simulate"))
    print(spoil(operations[0], served, 10 * MANY, "/scenes/check", "/scenes/write"))


BOMBS = {
    "a billion laughs": "a: &a [x,x,x,x,x,x,x,x,x]\n"
    + "\n".join(
        f"{b}: &{b} [{','.join(['*' + a] * 9)}]"
        for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    ),
    "a tag": "!!python/object/apply:os.system ['touch /tmp/hacked']",
    "deep": "[" * 50_000,
    "itself": "a: &a [*a]",
    "long": "a: " + "x" * 600_000,
    "a number": "a: " + "9" * 100_000,
    "nothing": "",
    "NaN": "duration: .nan",
    "a time": "2001-12-14t21:59:43.10-05:00",
    "a set": "!!set {a, b}",
}


@pytest.mark.parametrize("name", BOMBS)
@pytest.mark.parametrize("is_json", [False, True])
def test_bombs(operations, served, name, is_json):
    session, _ = operations
    body = {"text": BOMBS[name], "is_json": is_json}
    answer = session.post(f"{served.address}api/v1/scenes/read", json=body, timeout=20)
    assert answer.status_code in (413, 422), answer.text[:500]
    assert len(answer.text) < 5000


@pytest.mark.parametrize(("body", "kind"), [
    (b"\x80\x04cos\nsystem\n(S'touch /tmp/hacked'\ntR.", "application/octet-stream"),
    (b"\x80\x04cos\nsystem\n(S'touch /tmp/hacked'\ntR.", "application/json"),
    (b"--x\r\nContent-Disposition: form-data; name=file; filename=../../x\r\n\r\n1\r\n--x--",
     "multipart/form-data; boundary=x"),
    (b"<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><x>&a;</x>",
     "application/xml"),
    (b'{"ids": [1e400]}', "application/json"),
    (b'{"ids": [' + b"9" * 100_000 + b"]}", "application/json"),
    (b"\xff\xfe", "application/json"),
])  # fmt: skip
@pytest.mark.parametrize("path", ["/experiments/note", "/scenes/read", "/experiments/1/comparison"])
def test_strange_bodies(operations, served, path, body, kind):
    session, _ = operations
    answer = session.post(
        f"{served.address}api/v1{path}", data=body, headers={"Content-Type": kind}, timeout=20
    )
    assert 400 <= answer.status_code < 500, answer.text[:300]
    assert answer.json()["sentence"]
    assert "passwd" not in answer.text or "root:" not in answer.text
