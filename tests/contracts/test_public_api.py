"""Conventions of all public names and results; a new result joins the table `CASES`."""

import functools
import inspect
import json
import math
import pickle
import pkgutil
import re
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot
from tests.equal_pushes import over_a_table
from tests.fixtures import refused

import fixel
from fixel.model import PlannedExperiment
from fixel.model.goals import BodyTrack
from fixel.planning.belief import Belief
from fixel.planning.geometric import alignment_distance, fence_pushes, flush_distance, point_push
from fixel.planning.success import lower_bound, rate_quantile
from fixel.planning.trials import evidence_against, prior_counts
from fixel.registry import offers
from fixel.results import MAX_COLUMNS, MAX_HTML, MAX_LINES, Result
from fixel.simulation import StewartTrinkle
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.pushes import example_parts, example_pushes
from fixel.testing.scenes import grasp, pushed_square
from fixel.units import deg, mm

PUBLIC = [*(name for name in fixel.__all__ if name != "__version__"), "filter"]
HEAVY = "{*'numpy numba scipy pydantic matplotlib pandas sqlalchemy pyarrow rich yaml'.split()}"
SPACE = {"mu_pusher": (0.0, 1.0), "tripod_radius": 0.038}
START = fixel.StartError(x=1 * mm, y=1 * mm, theta=1 * deg, kind="uniform")
GOAL = fixel.PoseRegion((0.0, 0.0, 0.0), position=3 * mm)
BELIEF = Belief(parameters={"mu_pusher": [0.2, 0.3]})
HILL = fixel.LoadMap(origin=(0, 0), cell=(0.1, 0.1), log_load=[[0, 0], [0, 1]])
QUIET: dict[str, Any] = {"progress": False}
pytestmark = pytest.mark.usefixtures("few_live")


@dataclass(frozen=True)
class Case:
    """Inputs of a public function, and its call."""

    inputs: Callable[[], tuple[Any, ...]]
    call: Callable[..., Any]


def grasped() -> fixel.Experiment:
    planned = PlannedExperiment(name="grasp", scene=replace(grasp("seated"), duration=1.0))
    return next(iter(SimulatedTestbed.ideal(seed=1).run([planned])))


CASES = {
    "Simulation": Case(lambda: (pushed_square(), {"mu_pusher": 0.2}), fixel.simulate),
    "BatchResult": Case(
        lambda: (pushed_square(), {"mu_pusher": np.linspace(0.1, 0.4, 500)}), fixel.simulate_batch
    ),
    "Experiment": Case(lambda: (fixel.datasets.example(),), lambda pushes: pushes[0]),
    "Experiments": Case(lambda: (fixel.datasets.example(),), lambda pushes: pushes[:30]),
    "Comparison": Case(
        lambda: (fixel.datasets.example()[:4], {"scene": None, "low": {"mu_pusher": 0.1}}),
        functools.partial(fixel.compare, **QUIET),
    ),
    "Calibration": Case(
        lambda: (example_pushes(2), SPACE), functools.partial(fixel.calibrate, **QUIET)
    ),
    "Calibrations": Case(
        lambda: (example_pushes(2), SPACE),
        functools.partial(fixel.calibrate_each, verdicts=False, **QUIET),
    ),
    "OrientingPlan": Case(
        lambda: (fixel.Polygon([(0, 0), (0.06, 0), (0.05, 0.03), (0.01, 0.04)]),),
        functools.partial(fixel.orienting_plan, angle_error=5 * deg),
    ),
    "Sensitivity": Case(
        lambda: (pushed_square(0.5), START),
        functools.partial(fixel.sensitivity, samples=60, **QUIET),
    ),
    "Prediction": Case(
        lambda: (pushed_square(0.5), {"mu_support": 0.3}),
        lambda scene, model: fixel.predict(scene, model, start=START, samples=40, **QUIET),
    ),
    "Posterior": Case(
        lambda: (example_pushes(1, duration=0.3), SPACE),
        functools.partial(fixel.posterior, model_error=False, samples=20, **QUIET),
    ),
    "DomainMap": Case(
        lambda: (example_pushes(6, duration=0.2), SPACE),
        functools.partial(fixel.map_domain, axes=["side"], threshold=2 * mm, folds=2, **QUIET),
    ),
    "ErrorBound": Case(
        lambda: (example_pushes(10, duration=0.2), SPACE),
        functools.partial(fixel.error_bound, folds=2, **QUIET),
    ),
    "PartModel": Case(lambda: (example_parts(3, 8),), functools.partial(fixel.part_model, **QUIET)),
    "TableCheck": Case(
        lambda: (over_a_table(noise=(1e-3, 0.01)),), functools.partial(fixel.table_check, level=0.9)
    ),
    "TableMap": Case(
        lambda: (example_parts(2, 6, uneven=0.8),), functools.partial(fixel.table_map, **QUIET)
    ),
    "NextPushes": Case(
        lambda: (example_parts(3, 8), fixel.push_candidates(pushed_square(0.5), contacts=4)),
        lambda pushes, candidates: fixel.part_model(pushes, **QUIET).next_pushes(
            candidates, part="square", surface="board"
        ),
    ),
    "PushPlan": Case(
        lambda: (pushed_square(), fixel.PoseRegion((0.02, 0.0, 0.0), position=9 * mm)),
        functools.partial(fixel.plan, rollouts=1_000, **QUIET),
    ),
    "FilterRun": Case(lambda: (grasped(),), functools.partial(fixel.filter, particles=10, **QUIET)),
}


@functools.cache
def called(name: str) -> tuple[Any, bool]:
    """Result of a case, and whether its inputs are unchanged."""
    inputs = CASES[name].inputs()
    before = pickle.dumps(inputs)
    result = CASES[name].call(*inputs)
    return result, pickle.dumps(inputs) == before


def result_of(name: str) -> Any:
    return called(name)[0]


results = pytest.mark.parametrize("name", CASES)


# ---- names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_is_documented_with_an_example(name: str) -> None:
    documented = inspect.getdoc(getattr(fixel, name)) or ""

    assert len(documented.splitlines()[0]) > 10
    assert "Examples\n--------\n" in documented


def test_no_name_is_that_of_a_module() -> None:
    modules = [info.name for info in pkgutil.iter_modules(fixel.__path__)]
    for module in modules:
        import_module(f"fixel.{module}")

    assert not set(modules) & set(PUBLIC)
    assert not [name for name in PUBLIC if inspect.ismodule(getattr(fixel, name))]


def test_every_public_result_is_in_the_table() -> None:
    classes = [getattr(fixel, name) for name in PUBLIC]
    public = {c.__name__ for c in classes if isinstance(c, type) and issubclass(c, Result)}

    assert public == set(CASES)


def test_dir_lists_public_names_and_a_star_import_hides_no_built_in() -> None:
    assert "filter" not in fixel.__all__
    assert {*dir(fixel)} == {*fixel.__all__, "datasets", "filter", "units"}


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'sceen'"):
        fixel.sceen  # noqa: B018


@pytest.mark.parametrize("module", ["fixel", "fixel.units", "fixel.errors", "fixel.cli.main"])
def test_import_is_light(module: str) -> None:
    code = (
        "import sys, time; start = time.process_time();"
        f"import {module}; print(time.process_time() - start, *({HEAVY} & set(sys.modules)))"
    )
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    seconds, *heavy = min(run.stdout.split() for run in runs)

    assert heavy == []
    assert module == "fixel.cli.main" or float(seconds) <= 0.1


def test_a_project_is_read_and_simulated_without_the_geometry_of_scipy() -> None:
    """It would be a fifth of what each process loads; only bags and plans need it."""
    code = (
        "import fixel.database.project, fixel.workflows.simulation, sys;"
        "sys.exit('scipy.spatial' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


# ---- results -------------------------------------------------------------------------------------


@results
def test_inputs_are_not_modified(name: str) -> None:
    assert called(name)[1]


@results
def test_printed_result_fits_on_a_screen(name: str) -> None:
    result = result_of(name)
    begun = time.process_time()
    lines, page = repr(result).splitlines(), result._repr_html_()
    seconds = time.process_time() - begun

    assert len(lines) <= MAX_LINES
    assert max(map(len, lines)) <= MAX_COLUMNS
    assert len(page.encode()) <= MAX_HTML
    assert "<script" not in page
    assert not re.search(r"\bnan\b", repr(result))
    assert seconds <= 0.1


@results
def test_result_is_frozen(name: str) -> None:
    result = result_of(name)
    attribute = fields(result)[0].name

    with pytest.raises(AttributeError):
        setattr(result, attribute, None)


@results
def test_result_survives_a_process_and_a_file(name: str, tmp_path: Path) -> None:
    result = result_of(name)

    assert pickle.loads(pickle.dumps(result)) == result
    assert fixel.load(result.save(tmp_path / "saved")) == result
    assert hash(fixel.load(tmp_path / "saved")) == hash(result)
    assert [file.name for file in tmp_path.iterdir()] == ["saved"]


@results
def test_data_are_columns_without_missing_units(name: str) -> None:
    columns = result_of(name).to_dict()
    table = result_of(name).to_arrow()

    assert table.column_names == list(columns)
    assert {len(values) for values in columns.values()} == {table.num_rows}
    assert table.num_rows > 0
    assert not any(
        isinstance(value, float) and math.isnan(value)
        for values in columns.values()
        for value in values
    )


@results
def test_pandas_is_named_where_it_is_missing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)

    with pytest.raises(fixel.MissingExtra, match="pip install pandas"):
        result_of(name).to_pandas()


@results
def test_plot_returns_axes_and_changes_no_setting(name: str) -> None:
    before = dict(mpl.rcParams)

    if not offers(f"plots of {type(result_of(name)).__name__}"):
        refused(result_of(name).plot, match="no plot")
        return
    axes = np.atleast_1d(result_of(name).plot())

    assert all(isinstance(own, mpl.axes.Axes) for own in axes.flat)
    assert dict(mpl.rcParams) == before
    pyplot.close("all")


# ---- saved files ---------------------------------------------------------------------------------


def rewritten(path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """Change the head of a saved result."""
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    head = json.loads(members["result.json"])
    change(head)
    members["result.json"] = json.dumps(head).encode()
    with zipfile.ZipFile(path, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)
    return path


@pytest.mark.parametrize(("change", "reason"), [
    (lambda head: head.update(format=2, fixel="9.0.0"), r"fixel 9\.0\.0 in format 2.*newer"),
    (lambda head: head["content"].update({"class": "os:system"}), "is 'system', but must be one"),
    (lambda head: head["content"].update({"class": "fixel:simulate"}),
     "is 'simulate', but must be one"),
    (lambda head: head["content"]["items"].append(["new", 1]), "another kind of file"),
    (lambda head: head.pop("format"), "another kind of file"),
])  # fmt: skip
def test_other_saved_files_are_refused_in_one_sentence(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], reason: str
) -> None:
    path = rewritten(result_of("Simulation").save(tmp_path / "push"), change)
    assert "\n" not in str(refused(fixel.load, path, match=reason))


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"surface: abs\n"])
def test_files_that_are_no_results_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "file").write_bytes(data)

    for path in (tmp_path / "file", tmp_path / "missing", tmp_path):
        refused(fixel.load, path, match="fixel needs a result saved by fixel")


def test_a_result_is_saved_whole_or_not_at_all(tmp_path: Path) -> None:
    refused(result_of("Simulation").save, tmp_path / "nowhere" / "push", match="no folder")
    (tmp_path / "old").write_text("old")
    with pytest.raises(TypeError, match="a function cannot be saved"):
        replace(result_of("Simulation"), method={"f": grasped}).save(tmp_path / "old")
    assert (tmp_path / "old").read_text() == "old"


# ---- scenes and simulations ----------------------------------------------------------------------


def test_scene_in_three_lines() -> None:
    part = fixel.Body(
        "part",
        fixel.Polygon.rectangle(100 * mm, 100 * mm),
        mass=0.15,
        support=fixel.Tripod(radius=38 * mm, friction=0.25),
    )
    finger = fixel.Pusher(
        "finger",
        fixel.Disk(5 * mm),
        pose=(-55 * mm, 20 * mm, 0),
        friction=0.3,
        drive=fixel.LineDrive(speed=20 * mm),
    )
    scene = fixel.Scene(part, finger, duration=2.0)

    x, y, theta = fixel.simulate(scene).final["part"]

    assert scene == pushed_square()
    assert (x / mm, y / mm, theta / deg) == pytest.approx((32.0, -13.9, -17.4), abs=0.05)


def test_saved_scene_is_the_same(tmp_path: Path) -> None:
    path = pushed_square().save(tmp_path / "square.yaml")

    assert fixel.load_scene(path).scene == pushed_square()
    assert fixel.simulate(path).final == fixel.simulate(pushed_square()).final


def test_template_is_refused_with_what_is_missing() -> None:
    part = pushed_square().bodies[0]
    scene = fixel.Scene(part, fixel.Pusher("tip", fixel.Disk(5 * mm), friction=0.3))

    for call in (fixel.simulate, fixel.simulate_batch, lambda s: s.save("scene.yaml")):
        refused(call, scene, match="no drive of pusher 'tip', no duration")


def test_pusher_has_forces_and_bodies_have_trajectories() -> None:
    push = result_of("Simulation")

    assert push["finger"].travel == pytest.approx(40 * mm)
    assert push["finger"].force[-1] > 0.0
    assert push["part"].final == push.final["part"]
    with pytest.raises(fixel.InvalidInput, match="did you mean 'part'"):
        push["prt"]


def test_runs_of_a_batch_agree_with_single_simulations() -> None:
    sets = [{"mu_pusher": 0.1}, {"mu_pusher": 0.4}]
    scene = grasp("seated")
    runs = fixel.simulate_batch(scene, sets)
    for k, values in enumerate(sets):
        one = fixel.simulate(scene, values, output_interval=scene.duration)
        assert runs["object"].final.x[k] == one.final["object"].x
        for a, b in one.touching:
            assert runs.touching(a, b)[k]
        fixels = [f.name for f in scene.fixels]
        mode = "".join(str(int(("object", name) in one.touching)) for name in fixels)
        assert runs.contact_mode[k] == mode
        assert "1" in mode


def test_some_runs_of_a_batch() -> None:
    runs = result_of("BatchResult")
    mask = runs.parameters["mu_pusher"] > 0.3

    assert len(runs[7]) == 1
    assert runs[7].parameters["mu_pusher"][0] == runs.parameters["mu_pusher"][7]
    assert runs[-1] == runs[len(runs) - 1]
    assert len(runs[mask]) == mask.sum()
    assert np.array_equal(runs[10:20].final, runs.final[10:20])
    with pytest.raises(IndexError):
        runs[500]


def test_contacts_of_many_samples_are_those_of_the_last() -> None:
    scene = pushed_square()
    times = np.linspace(0.0, 2.0, 50)
    apart = replace(
        scene, pushers=(replace(scene.pushers[0], drive=fixel.LineDrive((-1, 0), speed=0.02)),)
    )

    assert fixel.simulate_batch(scene, times=times).touching("part", "finger").all()
    assert not fixel.simulate_batch(apart, times=times).touching("finger", "part").any()
    assert fixel.simulate_batch(scene, stepper=StewartTrinkle(step=0.1), times=times).touching(
        "part", "finger"
    )


def test_polygons_about_their_origin() -> None:
    hexagon = fixel.Polygon.regular(6, 0.05)

    assert fixel.Polygon.rectangle(0.04, 0.02).area == pytest.approx(8e-4)
    assert hexagon.area == pytest.approx(1.5 * math.sqrt(3.0) * 0.05**2)
    assert np.abs(hexagon.centroid).max() < 1e-15
    for call in (lambda: fixel.Polygon.regular(2, 1.0), lambda: fixel.Polygon.rectangle(0.0, 1.0)):
        refused(call)


@pytest.mark.parametrize(("where", "call"), [
    ("start", lambda p: fixel.calibrate(p, {"mu_pusher": (0, 1)}, start={"mu_pushr": 0.3})),
    ("mu_pusher.start", lambda p: fixel.calibrate(p, ["mu_pusher"], start={"mu_pusher": 7})),
    ("noise of poses", lambda p: fixel.calibrate(p, ["mu_pusher"], noise=0.0002)),
    ("store", lambda p: fixel.calibrate(p, ["mu_pusher"], store=3)),
    ("store", lambda p: fixel.map_domain(p, ["mu_pusher"], store=3)),
    ("store", lambda p: fixel.plan(p[0].scene, GOAL, store=3)),
    ("experiments", lambda p: fixel.calibrate(p[0], ["mu_pusher"])),
    ("experiments", lambda _: fixel.compare(5)),
    ("experiment", lambda p: fixel.filter(p)),
    ("seed", lambda p: fixel.posterior(p[0], ["mu_pusher"], seed=-1)),
    ("noise of poses", lambda p: fixel.posterior(p[0], ["mu_pusher"], noise=0.001)),
    ("seed", lambda p: fixel.table_check(p, seed=-1)),
    ("threshold", lambda p: fixel.map_domain(p, threshold="3")),
    ("what", lambda _: fixel.report(3)),
    ("goal", lambda p: fixel.simulate(p[0].scene, duration=0.1).meets(3)),
    ("goal", lambda p: fixel.simulate_batch(p[0].scene, {"mass": [1]}, duration=0.1).meets(3)),
    ("trials", lambda _: fixel.run_on_testbed("push.plan", trials="a")),
    ("max_contacts", lambda p: fixel.Simulator(p[0].scene, max_contacts="a")),
    ("mu_pusher", lambda p: fixel.simulate_batch(p[0].scene, {"mu_pusher": [0.1, "a"]})),
    ("parameters[0]", lambda p: fixel.simulate_batch(p[0].scene, [3])),
    ("times", lambda p: fixel.simulate_batch(p[0].scene, times="a")),
    ("stepper", lambda p: fixel.simulate(p[0].scene, stepper=0.01)),
    ("stepper", lambda p: fixel.simulate(p[0].scene, stepper=np.zeros(2))),
    ("solver", lambda p: fixel.simulate(p[0].scene, solver=np.zeros(2))),
    ("trajectory.time", lambda p: fixel.Trajectory(time=[[1, 2], [3]], pose=np.zeros((2, 3)))),
    ("duration", lambda p: fixel.simulate(p[0].scene, duration="3")),
    ("parameters", lambda p: fixel.simulate(p[0].scene, ["mu_pusher"])),
    ("variations", lambda p: fixel.simulate_batch(p[0].scene, {"mu_pusher": []})),
    ("threads", lambda p: fixel.simulate_batch(p[0].scene, {"mass": [1, 2]}, threads="2")),
    ("choose.length", lambda _: fixel.FreePushes(length=0.05)),
    ("choose.fixels", lambda _: fixel.RigPushes(fixels=3)),
    ("bodies", lambda _: fixel.Scene(3)),
    ("Adaptive.tolerance", lambda _: fixel.Adaptive(tolerance="a")),
    ("scene", lambda p: fixel.simulate_batch([p[0].scene, 3])),
    ("motion", lambda p: fixel.calibrate(p, ["mu_pusher"], motion=3)),
    ("derivatives", lambda p: fixel.simulate(p[0].scene, derivatives=3)),
    ("max_contacts", lambda p: fixel.simulate(p[0].scene, max_contacts=10**30)),
    ("parameters", lambda p: fixel.calibrate(p, [["mu_pusher"]])),
    ("site", lambda p: fixel.calibrate(p, ["mu_pusher"], site=3)),
    ("filter.priors", lambda p: fixel.filter(p[0], priors=[1])),
    ("leave_out", lambda p: fixel.error_bound(p, leave_out=3)),
    ("samples", lambda p: fixel.predict(p[0], samples="3")),
    ("samples", lambda p: fixel.posterior(p[0], ["mu_pusher"], samples=2**40)),
    ("vary", lambda p: fixel.sensitivity(p[0], START, vary=3)),
    ("base", lambda p: fixel.sensitivity(p[0], START, samples=50, indices=True, base="a")),
    ("seed", lambda p: fixel.plan(p[0].scene, fixel.ForceAbove(1), seed=2**32)),
    ("rollouts", lambda p: fixel.plan(p[0].scene, fixel.ForceAbove(1), rollouts=10**10)),
    ("lost_views", lambda p: fixel.plan(p[0].scene, GOAL, looks=1, lost_views="a")),
    ("part", lambda p: fixel.part_model(p, part="prat")),
    ("part", lambda p: fixel.table_map(p, part=[math.nan])),
    ("experiments", lambda _: fixel.learn_run_to_run(3, {"mu_pusher": 0.2})),
    ("to", lambda p: fixel.export_model(p[0].scene, "a", to=3)),
    ("folder", lambda p: fixel.export_model(p[0].scene, 3, to="urdf")),
    ("scenes", lambda p: fixel.export_model(p[0].scene, "a", to="urdf", scenes="3")),
    ("contacts", lambda p: fixel.push_candidates(p[0].scene.bodies[0], contacts=10**7)),
    ("fixels", lambda _: fixel.Seated(3)),
    ("goal.never", lambda _: fixel.AllOf(GOAL, never=3)),
    ("noise.source", lambda _: fixel.Noise(position_m=1e-3, angle_rad=1e-3, source=[])),
    ("noise.freedom", lambda _: fixel.Noise(position_m=1e-3, angle_rad=1e-3, freedom="a")),
    ("parameter.prior", lambda _: fixel.Parameter(0, 1, prior=3)),
    ("parameter.by", lambda _: fixel.Parameter(0, 1, by=3)),
    ("experiment example/00.scene", lambda p: replace(p[0], scene=3)),
    ("tolerance", lambda _: fixel.Polygon.from_file("a.svg", tolerance="a")),
    ("format", lambda p: fixel.export(p, "a", format=["bundle"])),
    ("path", lambda _: fixel.load(3)),
    ("path", lambda _: fixel.Polygon.from_file(3)),
    ("path", lambda p: fixel.export(p, "\0")),
    ("path", lambda _: fixel.report([], 3)),
    ("path", lambda _: fixel.run_on_testbed(3)),
    ("place", lambda _: fixel.Project(3)),
    ("test", lambda p: p.split("a")),
    ("test", lambda p: p.split(math.nan)),
    ("n", lambda p: p.sample("a")),
    ("filter", lambda p: p.where(3)),
    ("regular.n", lambda _: fixel.Polygon.regular(math.nan, 1.0)),
    ("time", lambda p: p[0].trajectory.at(math.nan)),
    ("time", lambda _: fixel.PathDrive([[0, 0, 0, 0], [1, 1, 0, 0]]).pose_at(math.nan)),
    ("duration", lambda _: fixel.LineDrive(speed=0.02).distance(math.nan)),
    ("position", lambda _: HILL.at((0, math.nan))),
    ("worlds", lambda p: BELIEF.scenarios(p[0].scene, worlds="a", runs=1)),
    ("poses", lambda _: BodyTrack.of_ends([[0, 0, math.nan]])),
    ("successes", lambda _: lower_bound(3, 2)),
    ("n", lambda _: lower_bound(0, math.inf)),
    ("successes", lambda _: rate_quantile([math.nan], 3)),
    ("mean", lambda _: prior_counts(math.nan, 0.8)),
    ("stated", lambda _: evidence_against(math.inf, [True])),
    ("contact", lambda _: point_push((math.nan, 0), 0, 0.02, 0.04)),
    ("length", lambda _: point_push((0.05, 0), 0, math.inf, 0.04)),
    ("start", lambda _: alignment_distance(0.08, -1, 0.7, 0.08)),
    ("angles", lambda _: flush_distance(fixel.Polygon.rectangle(0.1, 0.1), math.nan)),
    ("most", lambda p: fence_pushes(p[0].scene.bodies[0], 0, most=math.nan, length=(0.02, 0.1))),
])  # fmt: skip
def test_values_of_another_kind_are_refused_by_name(where, call):
    assert refused(call, result_of("Experiments")[:2]).where == where


def test_the_class_of_a_method_means_its_usual_options():
    scene = result_of("Experiment").scene
    of_class = fixel.simulate(scene, solver=fixel.GaussSeidel, motion=fixel.QuasiStatic)
    of_name = fixel.simulate(scene, solver="gauss-seidel", motion="quasistatic")
    assert of_class.final == of_name.final
