"""Contract of all capabilities: every door makes the same request, and shows the same result."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from string import ascii_lowercase
from types import NoneType, UnionType
from typing import Annotated, Literal, get_args, get_origin

import pytest
import typer
from hypothesis import HealthCheck, given, settings, strategies as st
from tests import laboratories
from tests.equal_pushes import over_a_table
from tests.filtering.recordings import push
from tests.fixtures import project_of, refused
from typer.testing import CliRunner

from fixel.capability.capability import Capability, named
from fixel.capability.options import FACTORS, Door, Level, Motion, Names, NoiseOption, Seed, _bare
from fixel.cli.capability import texts_of, typer_command
from fixel.cli.main import app
from fixel.database.project import Project
from fixel.errors import InvalidInput, NotStored, StoreRefused
from fixel.formats.scene_file import SceneFile, save_scene
from fixel.jobs.folder import read_job
from fixel.testing.pushes import example_parts
from fixel.workflows import jobs
from fixel.workflows.acquisition import FILM
from fixel.workflows.acquisition.camera import CAMERA
from fixel.workflows.analysis import load_analyses
from fixel.workflows.bench.run import BENCH
from fixel.workflows.calibration.stored import stored_calibration
from fixel.workflows.capabilities import CAPABILITIES, call, prepare, run
from fixel.workflows.project.export import export, import_zip


def specimen(
    scene: Annotated[Path, Door(metavar="SCENE")],
    experiments: Annotated[tuple[str, ...], Door(metavar="[EXPERIMENT]...")] = (),
    *,
    step: Annotated[float | None, Door(metavar="SECONDS", above=0.0, below=1.0)] = None,
    speed: Annotated[float | None, Door(unit="mm/s", least=0.0, usual="median")] = None,
    facets: Names = (),
    number: Annotated[int, Door(least=1, most=100, also=("-n",))] = 5,
    solver: Annotated[str, Door(among=lambda: ("lemke", "newton"))] = "newton",
    trajectory: Annotated[Path | None, Door(writes=True, effort=True)] = None,
    level: Level = 0.95,
    noise: NoiseOption = None,
    motion: Motion = None,
    seed: Seed = 0,
):
    """Do nothing, with options of every form.

    Parameters
    ----------
    scene : path
        Scene file.
    experiments : tuple of str
        Experiments.
    step, speed : float
        Step and speed.
    facets : tuple of str
        Facets.
    number, seed : int
        Numbers.
    solver : str
        Solver.
    trajectory : path
        File.
    level : float
        Level.
    noise : Noise
        Noise.
    motion : str
        Motion model, or another engine.
    """


# A capability without a project whose options have every form.
SPECIMEN = Capability(group="try", name="specimen", function=specimen)
# Those whose commands perform more than one call of their function.
PERFORMED = (BENCH, FILM)
# Those whose commands print the report of one call.
PRINTED = (*CAPABILITIES.values(), *CAMERA.values())
REGISTERED = pytest.mark.parametrize("capability", PRINTED, ids=lambda own: own.name)
EVERY = pytest.mark.parametrize(
    "capability", [SPECIMEN, *PERFORMED, *PRINTED], ids=lambda own: own.name
)
HEAVY = {"numpy", "numba", "scipy", "matplotlib", "sqlalchemy", "pyarrow", "rich"}
# Texts with a grammar of their own, which requests check.
STATED = {
    "fit": st.sampled_from([
        ("mu_pusher",), ("mu_fixel=0:1", "mass"), ("tripod_radius_mm=10:60", "start_x_mm=-1:1"),
    ]),
    "sizes": st.sampled_from([("3",), ("y=2,4", "x=5")]),
    "limit": st.sampled_from(["5", "2.2mm", "1e-3 mm^2"]),
}  # fmt: skip
NAMES = st.text(ascii_lowercase + "_", min_size=1, max_size=9).filter(lambda n: n[0] != "_")
# Capabilities whose jobs have inputs of their own store records, which make their report again.
STORED = [k for k, own in CAPABILITIES.items() if own.on_project and own.inputs is None]
STORING = pytest.mark.parametrize("name", STORED)
# One job runs every capability: those that take seconds are run once more by the system tests.
LONG = ("growth", "plan", "uncertainty")
BY_JOB = [pytest.param(name, marks=[pytest.mark.system] * (name in LONG)) for name in STORED]
STEPS = ("domain", "error-bound", "growth")  # in a project with steps along each axis
# A short run of each.
GOAL = {"pose": {"pose_mm_deg": [0, 0, 0], "position_mm": 200}}
PUSHES = {"fit": ("mu_pusher",), "folds": 2}
SHORT = {
    "compare": {"experiment": "push-1", "parameters": {"mu_support": 0.3}, "save": True},
    "domain": {**PUSHES, "axes": ("offset_x_m",), "nominal": {"offset_x_m": 0.0},
               "threshold": 2.2e-3},
    "error-bound": {**PUSHES, "groups": ("layout",), "level": 0.8},
    "calibrate": {
        "experiments": ("push-1",), "fit": ("mu_pusher",), "verdicts": False, "max_evaluations": 5
    },
    "filter": {"experiment": "push-1", "particles": 20, "occlusion": (0.5, 1.0)},
    "growth": {"limit": "2.2mm", "sizes": ("y=3", "x=2"), "motion": "quasistatic"},
    "next": {"part": "part-4", "contacts": 2, "number": 2},
    "plan": {
        "goal": json.dumps({"fixel": 1, "goal": GOAL}), "experiment": "part-1-01", "rollouts": 1000
    },
    "sensitivity": {"experiments": ("push-1",), "samples": 50},
    "uncertainty": {
        "experiments": ("push-1",), "fit": ("tripod_radius_mm=20:60",), "motion": "quasistatic",
        "samples": 50,
    },
    "table-check": {"where": ("part=part-1",), "position": 3e-3, "seed": 1},
    "table-map": {"where": ("part=part-2",)},
}  # fmt: skip


def values_of(option, kind=None):
    """Strategy for values of an option, as commands can state them."""
    if option.name in STATED and option.door.check is not None:
        return STATED[option.name]
    kind, door = option.kind if kind is None else kind, option.door
    if door.among is not None:
        return st.sampled_from(door.among())
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
    most = door.most if door.below is None else door.below
    if kind is int:
        return st.integers(-(10**6) if least is None else int(least), most or 10**9)
    if kind is float:
        low = -1e6 if least is None else least + 1e-6
        high = 1e6 if most is None else most - 1e-6
        return st.floats(low, high).map(lambda number: FACTORS.get(door.unit, 1.0) * number)
    return {bool: st.booleans(), str: NAMES, Path: NAMES.map(Path)}[kind]


@cache
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


@cache
def parser_of(specimen):
    """Parser of the program, or of the specimen alone."""
    if not specimen:
        return typer.main.get_command(app)
    program = typer.Typer()
    program.command()(typer_command(SPECIMEN))
    return typer.main.get_command(program)


def parsed(capability, command):
    """Return the request of a shell command, as the program parses it."""
    words = shlex.split(command)[1:]
    parser = parser_of(capability is SPECIMEN)
    for word in capability.path:
        assert words.pop(0) == word
        parser = parser if capability is SPECIMEN else parser.commands[word]
    context = parser.make_context(capability.name, words)
    return capability.from_texts(texts_of(capability, context.params))


def required(capability):
    """Texts of the options without a default."""
    return {name: ["push"] for name, option in capability.options.items() if option.required}


def required_values(capability):
    """Values of the options without a default, as JSON has them."""
    many = {name for name, option in capability.options.items() if option.many}
    return {k: own if k in many else own[0] for k, own in required(capability).items()}


@EVERY
@given(data=st.data())
@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
def test_every_door_makes_the_same_request(capability, data):
    request = data.draw(requests_of(capability))

    assert capability.from_json(request.model_dump_json()) == request
    assert parsed(capability, capability.command(request)) == request
    assert capability.from_texts(capability.texts(request)) == request


@EVERY
def test_defaults_are_those_of_the_signature(capability):
    values = required_values(capability)
    words = ["fixel", *capability.path]
    for name, (text,) in required(capability).items():
        option = capability.options[name]
        words += [text] if option.place else [option.flag, text]
    request = capability.request(values)

    assert parsed(capability, shlex.join(words)) == request
    assert capability.from_json(json.dumps(values)) == request
    assert capability.from_texts(required(capability)) == request
    assert shlex.split(capability.command(request)) == words
    for name, option in capability.options.items():
        assert name in values or getattr(request, name) == option.default


@EVERY
def test_every_option_has_a_meaning(capability):
    for option in capability.shown.values():
        assert option.meaning.endswith("."), option.name
        assert option.place or option.flag in capability.flags().values()


@EVERY
def test_refusals_have_the_name_of_the_door(capability):
    for number in (o for o in capability.shown.values() if o.door.least is not None):
        text = str(int(number.door.least) - 1)
        with pytest.raises(InvalidInput, match=f"^{number.name} is .* must be at least") as problem:
            capability.from_texts(required(capability) | {number.name: [text]})

        flag, label = (
            named(problem.value, names).where for names in (capability.flags(), capability.labels())
        )
        assert (flag, label) == (number.flag, number.label)
    values = required_values(capability)
    refused(capability.from_json, json.dumps({**values, "nonsense": 1}), match="nonsense")
    for text in ("", "{", "[]", "1", "null"):
        refused(capability.from_json, text, match="an object in JSON")


@pytest.mark.parametrize(("name", "values", "sentence"), [
    ("sensitivity", {"start_error": {"plce": 1e-3}},
     "start_error is 'plce', but must be one of place, angle, uniform; did you mean 'place'?"),
    ("filter", {"experiment": "push-1", "particles": 10**9},
     "particles is 1000000000, but must be at most 1000000"),
    ("uncertainty", {"samples": 10**11},
     "samples is 100000000000, but must be at most 1000000"),
    ("sensitivity", {"seed": 2**32}, "seed is 4294967296, but must be at most 4294967295"),
    ("uncertainty", {"noise": {"position_m": 1e-300, "angle_rad": 1e-3}},
     "noise.position_m is 1e-297 mm, but must be at least 1e-06"),
    ("uncertainty", {"noise": {"position": 3e-4, "angle": 4e-3}},
     "noise is 'position', but must be one of position_m, angle_rad; did you mean 'position_m'?"),
    ("domain", {"cells": {"push_angle_rad": 1e-300}},
     "cells push_angle_rad is 1e-300, but must be at least 1e-09"),
    ("calibrate", {"angle_scale": 1e300},
     "angle_scale is 1e+303 mm, but must be at most 1e+09"),
    ("calibrate", {"workers": 10**6}, "workers is 1000000, but must be at most 1000"),
    ("filter", {"experiment": "push-1", "priors": {"mu_pusher": [0.0, 0.5, 1.0]}},
     "priors mu_pusher is [0.0, 0.5, 1.0], but must be a list of 2"),
])  # fmt: skip
def test_wrong_groups_lists_and_counts_are_refused_in_own_words(name, values, sentence):
    with pytest.raises(InvalidInput) as problem:
        CAPABILITIES[name].from_json(json.dumps(values))

    assert str(problem.value) == sentence


@pytest.mark.parametrize(("words", "where", "expected"), [
    ("--noise-mm 1", "--noise-mrad", "both, or neither"),
    ("--level 1", "--level", "less than 1"),
    ("--number 101", "-n|--number", "at most 100"),
    ("-n 4 --number 5", "--number", "one value"),
    (f"--seed {2**32}", "--seed", f"at most {2**32 - 1}"),
    ("--noise-mm -1 --noise-mrad 1", "--noise-mm", "more than 0"),
    ("--motion dynamic --engine mujoco", "--motion", "one value"),
    ("--speed-mm-s -4", "--speed-mm-s", "at least 0"),
    ("--solver nweton", "--solver", "newton"),
])  # fmt: skip
def test_options_are_refused_by_the_name_of_the_flag(words, where, expected):
    with pytest.raises(InvalidInput) as problem:
        parsed(SPECIMEN, f"fixel try specimen scene.yaml {words}")

    refused = named(problem.value, SPECIMEN.flags())
    assert refused.where in where.split("|")
    assert expected in str(refused)


WRONG = [  # words of a command whose fault only the function finds, and the begin of its error
    ("sensitivity push-1 --vary nonsense=1:2", "--vary nonsense"),
    ("sensitivity push-1 --vary mu_pusher=2:1", "--vary mu_pusher"),
    ("sensitivity push-1 --set nonsense=1", "--set"),
    ("sensitivity push-1 --engine nonsense", "--engine"),
    ("sensitivity push-1 --preset nonsense", "--preset"),
    ("sensitivity push-1 --start-error-mm -1 --uniform", "--start-error-mm"),
    ("filter push-1 --prior nonsense=1:2", "--prior nonsense"),
    ("filter push-1 --prior mu_pusher=2:1", "--prior mu_pusher"),
    ("filter push-1 --motion ./engine", "--motion"),
    ("calibrate push-1 --motion ./engine", "--motion"),
    ("calibrate push-1 --motion nonsense", "--motion"),
    ("uncertainty push-1 --motion nonsense", "--motion"),
    ("compare push-1 --set nonsense=1", "--set"),
    ("next --part part-4 --surface nonsense", "--surface"),
    ("table check --where part=part-1 --surface nonsense", "--surface"),
    ("table check --where part=part-1 --session nonsense", "--session"),
]


@pytest.mark.parametrize(("words", "where"), WRONG, ids=[words for words, _ in WRONG])
def test_faults_that_a_run_finds_have_the_name_of_the_flag(words, where, project):
    answer = CliRunner().invoke(app, [*words.split(), "--project", str(project.folder)])

    assert isinstance(answer.exception, InvalidInput), answer.output
    assert answer.exception.where == where


READING = [
    (own, option)
    for own in CAPABILITIES.values()
    for option in own.options.values()
    if option.kind is Path and not option.door.writes and option.name not in ("site", "store")
]


@pytest.mark.parametrize(
    ("capability", "option"), READING, ids=[f"{own.name} {o.name}" for own, o in READING]
)
def test_a_missing_file_that_is_named_like_an_option_has_its_own_name(
    capability, option, project, tmp_path, monkeypatch
):
    """A file `seed` is not the option `--seed`."""
    monkeypatch.chdir(tmp_path)
    like = next(o for o in capability.options.values() if o is not option and not o.place)
    needed = [o.name for o in capability.options.values() if o.required and o is not option]
    words = [*capability.path, *(SHORT[capability.name][name] for name in needed)]
    words += [like.name] if option.place else [option.flag, like.name]
    folder = ["--project", str(project.folder)] if capability.on_project else []
    answer = CliRunner().invoke(app, [*words, *folder])

    assert isinstance(answer.exception, InvalidInput), answer.output
    assert answer.exception.where == like.name


def test_a_missing_plan_of_a_bench_that_is_named_like_an_option(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    answer = CliRunner().invoke(app, ["bench", "check", "--project", str(project.folder)])
    assert answer.exception.where == "check"


@pytest.mark.parametrize("name", [k for k in CAPABILITIES if CAPABILITIES[k].on_project])
def test_no_job_is_prepared_for_records_that_are_not_stored(name, project):
    capability, wrong = CAPABILITIES[name], []
    if {"experiment", "experiments"} & {*capability.options}:
        option = "experiment" if "experiment" in capability.options else "experiments"
        wrong.append({option: "push-99" if option == "experiment" else ("push-99",)})
    if "calibration" in capability.options:
        wrong.append({"calibration": 99})
    for values in wrong:
        request = capability.request(SHORT[name] | values)
        with pytest.raises(NotStored, match=r"no (experiment 'push-99'|calibration 99)"):
            prepare(capability, request, project)


@pytest.mark.parametrize(("name", "option"), [
    (k, o.name) for k, own in CAPABILITIES.items() if own.on_project
    for o in own.options.values() if o.door.program
])  # fmt: skip
def test_no_job_is_prepared_for_an_unknown_engine(name, option, project):
    capability = CAPABILITIES[name]
    request = capability.request(SHORT[name] | {option: "mujcoo"})
    with pytest.raises(InvalidInput, match="mujcoo") as problem:
        prepare(capability, request, project)
    assert capability.labels()[problem.value.where] == capability.options[option].label


SELECTING = [
    (k, {name: ("typo=1",) if name == "where" else "typo"}, name)
    for k, own in CAPABILITIES.items() if own.on_project
    for name, option in own.options.items() if name in ("where", "dataset") or option.door.condition
]  # fmt: skip


@pytest.mark.parametrize(("name", "wrong", "option"), SELECTING)
def test_no_job_is_prepared_for_names_that_no_experiment_has(name, wrong, option, project):
    capability = CAPABILITIES[name]
    every = {"experiments": ()} if name == "calibrate" else {}  # of all that are selected
    request = capability.request(SHORT[name] | every | wrong)
    with pytest.raises(InvalidInput, match="typo") as problem:
        prepare(capability, request, project)
    for names in (capability.flags(), capability.labels()):
        assert named(problem.value, names).where == names[option]


def test_conditions_of_a_table_are_options_that_a_job_checks():
    checked = {o for name in ("table-check", "table-map")
               for o, own in CAPABILITIES[name].options.items() if own.door.condition}  # fmt: skip
    assert checked == {"part", "surface", "session"}


def test_no_job_is_prepared_for_a_filter_that_selects_no_experiment(project):
    capability = CAPABILITIES["table-check"]
    with pytest.raises(InvalidInput, match="at least one experiment"):
        prepare(capability, capability.request({"where": ("duration>1000",)}), project)


def test_a_request_never_permits_a_program_by_itself(project, tmp_path):
    program = tmp_path / "engine.py"
    program.write_text("")
    compare = CAPABILITIES["compare"]
    request = compare.request({"experiment": "push-1", "motion": str(program)})
    with pytest.raises(InvalidInput, match="was named by a file, not by you") as problem:
        run(compare, request, project.folder, progress=False)
    # The user has typed no option that the error could be about.
    assert named(problem.value, compare.flags()).where == "program"


def test_hints_have_the_name_of_the_door():
    deaf = InvalidInput("tactile", found=1, expected="2", hint="filter without: tactile=False")

    assert named(deaf, CAPABILITIES["filter"].flags()).hint == "filter without: --no-tactile"
    assert named(deaf, CAPABILITIES["filter"].labels()).hint == "filter without: tactile off"
    bold = InvalidInput("looks", found=1, expected="2", hint="or plan with untrusted=True")
    assert named(bold, CAPABILITIES["plan"].flags()).hint == "or plan with --untrusted"
    mixed = InvalidInput("surface", found=2, expected="1", hint="select where=surface=plywood")
    flags = CAPABILITIES["table-check"].flags()
    assert named(mixed, flags).hint == "select --where surface=plywood"


@pytest.fixture(scope="module")
def helps():
    """Help of every capability, printed by one process, and the heavy packages loaded so far."""
    code = (
        "import contextlib, io, json, sys; from fixel.cli.main import app\n"
        "found = {}\n"
        "for path in json.loads(sys.argv[1]):\n"
        "    with contextlib.redirect_stdout(io.StringIO()) as out:\n"
        "        with contextlib.suppress(SystemExit): app([*path, '--help'])\n"
        f"    found[' '.join(path)] = out.getvalue(), sorted({HEAVY!r} & {{*sys.modules}})\n"
        "print(json.dumps(found))"
    )
    paths = json.dumps([own.path for own in PRINTED])
    words = [sys.executable, "-c", code, paths]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


@REGISTERED
def test_help_loads_no_numerics(capability, helps):
    text, heavy = helps[" ".join(capability.path)]
    shown = [option for option in capability.shown.values() if not option.place]
    assert all(option.flag in text for option in shown)
    assert heavy == []


@REGISTERED
def test_help_names_no_exception_of_python(capability, helps):
    text, _ = helps[" ".join(capability.path)]
    assert not re.search(r"\bRaises?\b|\bis raised\b|InvalidInput|NotStored", text)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return project_of_all(tmp_path_factory.mktemp("projects") / "lab")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Project with the steps of the thesis along each axis."""
    return Project(laboratories.campaign(tmp_path_factory.mktemp("campaigns") / "lab"))


@pytest.fixture(scope="module")
def labs(project, campaign):
    """Project of each capability, by its name."""
    return {name: campaign if name in STEPS else project for name in STORED}


def project_of_all(folder):
    """Project for a short run of every capability."""
    pushes = [replace(push(seed=k, duration=1.2), name=f"push-{k}") for k in (1, 2)]
    parts = example_parts(4, 8)[:-4]
    # Equal pushes of a known part, so that learning from parts has no new one.
    equal = over_a_table(places=2, turns=(0.0, 2.0), noise=(1e-3, 0.01))
    return project_of(folder, [*pushes, *parts, *equal])


@pytest.fixture(scope="module")
def here(labs, few_live):
    """Analyses of runs in this process, by the names of the capabilities."""
    return {
        name: run(own, own.request(SHORT[name]), labs[name].folder, progress=False).analysis
        for name, own in CAPABILITIES.items()
        if name in STORED
    }


@pytest.fixture(scope="module")
def printed(project, campaign, here):
    """Lines of the same, as a new process loads them."""
    code = (
        "import json, sys; from fixel.database.project import Project\n"
        "from fixel.workflows.analysis import load_analyses\n"
        "kept = [one for folder in sys.argv[1:] for one in load_analyses(Project(folder))]\n"
        "print(json.dumps({one.analysis.kind: one.analysis.lines() for one in kept}))"
    )
    words = [sys.executable, "-c", code, str(project.folder), str(campaign.folder)]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


@STORING
def test_a_stored_result_prints_the_same_text_in_a_new_process(name, labs, here, printed):
    project, capability = labs[name], CAPABILITIES[name]
    request = capability.request(SHORT[name])
    (kept,) = load_analyses(project, name)

    assert capability.request(kept.analysis.request) == request
    assert kept.analysis.command == capability.command(request, project.folder)
    assert printed[name] == "\n".join(here[name].lines()).splitlines()
    # Terminals print JSON from the result, and the interface for programs from what is stored.
    assert json.dumps(kept.analysis.texts()) == json.dumps(here[name].texts())


@pytest.mark.parametrize("name", BY_JOB)
def test_a_job_stores_the_same_analysis_and_shows_its_progress(name, labs, here):
    project, capability = labs[name], CAPABILITIES[name]
    request = capability.request(SHORT[name])
    shown = []
    folder = prepare(capability, request, Project(project.folder))
    status = jobs.run_here(folder, shown.append)

    (kept,) = load_analyses(project, name)
    assert (status.state, (folder / "result").read_text()) == ("done", kept.folder.name)
    assert kept.analysis.question == here[name].question
    assert [t.content() for t in kept.analysis.tables] == [t.content() for t in here[name].tables]
    assert kept.analysis.request == json.loads(request.model_dump_json())
    assert any(one.text for one in shown)


@pytest.mark.parametrize(
    "options", [{"capability": "export", "request": {}}, {}, {"capability": []}]
)
def test_a_job_of_an_unknown_capability_is_refused(project, tmp_path, options):
    capability = CAPABILITIES["calibrate"]
    other = Project(shutil.copytree(project.folder, tmp_path / "other"))
    folder = prepare(capability, capability.request(SHORT["calibrate"]), other)
    job = json.loads((folder / "job.json").read_text())
    (folder / "job.json").write_text(json.dumps(job | {"options": options}))
    with pytest.raises(StoreRefused, match=r"job\.json cannot be read"):
        jobs.run_here(folder)


def test_a_job_of_a_calibration_stores_what_a_run_here_does(project, tmp_path):
    capability = CAPABILITIES["calibrate"]
    request = capability.request(SHORT["calibrate"])
    other = Project(shutil.copytree(project.folder, tmp_path / "other"))
    done, shown = run(capability, request, project.folder, progress=False), []
    assert jobs.run_here(prepare(capability, request, other), shown.append).state == "done"

    (mine,), (theirs,) = (done.result.ids, list(other.calibrations)[-1:])
    ours, own = stored_calibration(project, mine), stored_calibration(other, theirs)
    assert own == replace(ours, run=replace(ours.run, command=own.command))
    assert own.command == capability.command(request, other.folder)
    assert own.analysis.lines()[:-1] == ours.analysis.lines()[:-1]
    assert any(one.text for one in shown)
    assert run(capability, request, other.folder, progress=False).result.ids == (theirs,)


def test_a_command_can_only_prepare_its_job(project):
    words = ["filter", "push-1", "--seed", "3", "--prepare", "--project", str(project.folder)]
    answer = CliRunner().invoke(app, [*words, "--json"])

    job = read_job(Path(json.loads(answer.stdout)["job"]))
    assert CAPABILITIES["filter"].request(job.options["request"]).seed == 3


def test_stored_results_print_the_same_text_after_export_and_import(project, tmp_path):
    run(CAPABILITIES["compare"], CAPABILITIES["compare"].request(SHORT["compare"]), project.folder)
    export(project, tmp_path / "all.zip", progress=False)
    other = project_of(tmp_path / "other", [replace(push(seed=9, duration=1.0), name="first")])
    import_zip(other, tmp_path / "all.zip")

    ours, theirs = ({one.folder.name: one.analysis for one in load_analyses(own)}
                    for own in (project, other))  # fmt: skip
    assert {k: own.lines() for k, own in theirs.items()} == {k: o.lines() for k, o in ours.items()}
    for name, own in ours.items():
        with project.store() as a, other.store() as b:
            assert [a.experiment(n).key for n in own.experiments] == [
                b.experiment(n).key for n in theirs[name].experiments
            ]


def test_the_same_question_has_the_same_folder_at_each_door(tmp_path, monkeypatch):
    """A command without a calibration uses the newest; a page and a job name it."""
    own = project_of(tmp_path / "lab", [replace(push(seed=1, duration=0.4), name="push-1")])
    own.calibrate("", {"mu_pusher": (0, 1)}, max_evaluations=4, verdicts=False, progress=False)
    start = {"x_mm": 0.1, "kind": "uniform"}
    text = json.dumps({"fixel": 1, "goal": GOAL, "scene": "scene.yaml", "belief": {"start": start}})
    (tmp_path / "goal.json").write_text(text)
    save_scene(SceneFile(scene=own.experiment("push-1").scene), tmp_path / "scene.yaml")
    monkeypatch.chdir(tmp_path)
    plan = CAPABILITIES["plan"].request({"goal": "goal.json", "rollouts": 1000})
    sensitivity = {"experiments": ("1",), "samples": 50}

    call(own, "sensitivity", **sensitivity, progress=False)
    call(own, "sensitivity", calibration=1, **sensitivity, progress=False)
    run(CAPABILITIES["plan"], plan, own.folder, progress=False)
    assert jobs.run_here(prepare(CAPABILITIES["plan"], plan, own)).state == "done"
    assert len(load_analyses(own, "sensitivity")) == len(load_analyses(own, "plan")) == 1


def test_an_imported_request_names_its_own_experiments_and_calibration(tmp_path):
    """Both projects have a calibration 1 and an experiment 1, which are not the same."""
    lab, other = (
        project_of(tmp_path / name, [replace(push(seed=k, duration=0.4), name=f"{name}-{k}")])
        for name, k in (("lab", 1), ("other", 2))
    )
    for own in (other, lab):
        own.calibrate("", {"mu_pusher": (0, 1)}, max_evaluations=4, verdicts=False, progress=False)
        call(own, "sensitivity", experiments=("1",), calibration=1, samples=50, progress=False)
    export(lab, tmp_path / "lab.zip", progress=False)
    for _ in range(2):
        import_zip(other, tmp_path / "lab.zip")

    wanted = {}
    for one in load_analyses(other):
        request = CAPABILITIES["sensitivity"].request(one.analysis.request)
        (key,) = request.experiments
        experiment = other.experiment(key).name
        (member,) = other.calibrations[request.calibration].members
        assert other.experiment(member.experiment_id).name == experiment
        assert one.analysis.calibrations == (request.calibration,)
        wanted[experiment] = one.folder.name
    assert {*wanted} == {"lab-1", "other-2"}
    call(other, "sensitivity", experiments=("id:2",), calibration=2, samples=50, progress=False)
    assert {one.folder.name for one in load_analyses(other)} == {*wanted.values()}
