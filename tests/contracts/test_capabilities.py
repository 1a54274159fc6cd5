"""Contract of all capabilities: every door makes the same request, and shows the same result."""

import json
import shlex
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from types import NoneType, UnionType
from typing import Literal, get_args, get_origin

import pytest
import typer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.filtering.recordings import push
from tests.fixtures import project_of

from fixel.capability.capability import named
from fixel.capability.options import FACTORS, _bare
from fixel.cli.capability import texts_of
from fixel.cli.main import app
from fixel.errors import InvalidInput
from fixel.workflows.analysis import load_analyses
from fixel.workflows.capabilities import CAPABILITIES, run

EVERY = pytest.mark.parametrize("capability", CAPABILITIES.values(), ids=[*CAPABILITIES])
HEAVY = {"numpy", "numba", "scipy", "matplotlib", "sqlalchemy", "pyarrow", "rich"}
NAMES = st.from_regex(r"[a-z][a-z_]{0,8}", fullmatch=True)
FINITE = st.floats(-1e6, 1e6, allow_subnormal=False)
# A short run of each.
SHORT = {"filter": {"experiment": "push-1", "particles": 20, "occlusion": (0.5, 1.0)}}


def values_of(option, kind=None):
    """Strategy for values of an option, as commands can state them."""
    kind, door = option.kind if kind is None else kind, option.door
    inner = get_args(kind)
    if get_origin(kind) in (dict, Mapping):
        one = values_of(option, _bare(inner[1]))
        nothing = [st.none()] if NoneType in get_args(inner[1]) else []
        return st.dictionaries(NAMES, st.one_of(one, *nothing), min_size=1, max_size=3)
    if get_origin(kind) is tuple:
        if inner[1:] == (...,):
            return st.lists(values_of(option, inner[0]), min_size=1, max_size=3).map(tuple)
        return st.tuples(*(values_of(option, one) for one in inner))
    if get_origin(kind) is Literal:
        return st.sampled_from(inner)
    if get_origin(kind) is UnionType:
        return st.one_of(*(values_of(option, one) for one in inner))
    least = door.least if door.above is None else door.above
    if kind is int:
        return st.integers(-(10**6) if least is None else int(least), 10**9)
    if kind is float:
        low = -1e6 if least is None else max(least, 1e-6)
        return st.floats(low, 1e6).map(lambda number: FACTORS.get(door.unit, 1.0) * number)
    return {bool: st.booleans(), str: NAMES}[kind]


def requests_of(capability):
    """Strategy for requests whose every option is unlike its default."""
    shown = {
        name: values_of(option).filter(lambda value, own=option: value != own.default)
        for name, option in capability.shown.items()
    }

    def grouped(values):
        found = {}
        for name, value in values.items():
            group, _, own = name.partition(".")
            if own:
                found.setdefault(group, {})[own] = value
            else:
                found[group] = value
        return capability.request(found)

    return st.fixed_dictionaries(shown).map(grouped)


def parsed(capability, command):
    """Return the request of a shell command, as the program parses it."""
    words = shlex.split(command)[1:]
    parser = typer.main.get_command(app)
    for word in capability.path:
        assert words.pop(0) == word
        parser = parser.commands[word]
    context = parser.make_context(capability.name, words)
    return capability.from_texts(texts_of(capability, context.params))


@EVERY
@given(data=st.data())
@settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
def test_every_door_makes_the_same_request(capability, data):
    request = data.draw(requests_of(capability))

    assert capability.from_json(request.model_dump_json()) == request
    assert parsed(capability, capability.command(request)) == request
    assert capability.from_texts(capability.texts(request)) == request


@EVERY
def test_defaults_are_those_of_the_signature(capability):
    subject = capability.options.get(capability.subject)
    values = {subject.name: "push"} if subject and subject.required else {}
    words = ["fixel", *capability.path, *values.values()]
    request = capability.request(values)

    assert parsed(capability, shlex.join(words)) == request
    assert capability.from_json(json.dumps(values)) == request
    assert capability.from_texts({k: [v] for k, v in values.items()}) == request
    assert shlex.split(capability.command(request)) == words
    for name, option in capability.options.items():
        assert name in values or getattr(request, name) == option.default


@EVERY
def test_every_option_has_a_meaning(capability):
    for option in capability.shown.values():
        assert option.meaning.endswith("."), option.name
        assert len(capability.flags()) >= len(capability.shown) - 1


@EVERY
def test_refusals_have_the_name_of_the_door(capability):
    subject = {capability.subject: ["push"]} if capability.subject else {}
    for number in (o for o in capability.shown.values() if o.door.least is not None):
        text = str(int(number.door.least) - 1)
        with pytest.raises(InvalidInput, match=f"^{number.name}: .* expected at least") as problem:
            capability.from_texts({**subject, number.name: [text]})

        flag, label = (
            named(problem.value, names).where for names in (capability.flags(), capability.labels())
        )
        assert (flag, label) == (number.flag, number.label)
    values = {name: text for name, (text,) in subject.items()}
    with pytest.raises(InvalidInput, match="nonsense"):
        capability.from_json(json.dumps({**values, "nonsense": 1}))
    for text in ("", "{", "[]", "1", "null"):
        with pytest.raises(InvalidInput, match="an object in JSON"):
            capability.from_json(text)


def test_hints_have_the_name_of_the_door():
    deaf = InvalidInput("tactile", found=1, expected="2", hint="filter without: tactile=False")

    assert named(deaf, CAPABILITIES["filter"].flags()).hint == "filter without: --no-tactile"


@EVERY
def test_help_loads_no_numerics(capability):
    code = (
        "import sys; from fixel.cli.main import app\n"
        f"try: app([*{capability.path!r}, '--help'])\n"
        f"finally: print(*sorted({HEAVY!r} & {{*sys.modules}}), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)

    flags = {name: flag for name, flag in capability.flags().items() if name in capability.shown}
    assert all(flag in done.stdout for flag in flags.values())
    assert done.stderr.strip() == ""


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    pushes = (replace(push(seed=k, duration=2.0), name=f"push-{k}") for k in (1, 2))
    return project_of(tmp_path_factory.mktemp("projects") / "lab", pushes)


@EVERY
def test_a_stored_result_prints_the_same_text_in_a_new_process(capability, project):
    request = capability.request(SHORT[capability.name])
    done = run(capability, request, project.folder, progress=False)
    (kept,) = load_analyses(project, capability.name)

    # The subject may be stored by its full name.
    own = {k: v for k, v in SHORT[capability.name].items() if k == capability.subject}
    assert capability.request({**kept.analysis.question, **own}) == request
    assert kept.analysis.command == capability.command(request, project.folder)
    code = (
        "import sys; from fixel.database.project import Project\n"
        "from fixel.workflows.analysis import load_analyses\n"
        "(kept,) = load_analyses(Project(sys.argv[1]), sys.argv[2])\n"
        "print('\\n'.join(kept.analysis.lines()))"
    )
    words = [sys.executable, "-c", code, str(project.folder), capability.name]
    printed = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert printed.splitlines() == done.analysis.lines()
