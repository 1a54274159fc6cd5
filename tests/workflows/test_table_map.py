"""Experiments of a project on a mapped table, against pushes that were made on a known one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import project_of
from typer.testing import CliRunner

import fixel
from fixel.calibration.objective import Comparer
from fixel.cli.main import app
from fixel.drawing.parts import map_chart
from fixel.errors import InvalidInput, StoreRefused
from fixel.model import LoadMap, Pose, Trajectory
from fixel.testing.pushes import example_parts
from fixel.workflows import jobs
from fixel.workflows.calibration.stored import stored_calibration
from fixel.workflows.capabilities import CAPABILITIES, prepare, run
from fixel.workflows.planning.report import FILE
from fixel.workflows.planning.request import load_plan
from fixel.workflows.table_map import TableView

HILLS = LoadMap(
    origin=(-0.3, -0.3), cell=(0.05, 0.05),
    log_load=np.random.default_rng(2).normal(0.0, 1.5, (13, 13)),
)  # fmt: skip
TRUTH = {"mu_pusher": 0.25}
QUASISTATIC = {"motion": "quasistatic"}
DOORS = (
    "calibrate", "compare", "domain", "error-bound", "filter", "next", "plan", "sensitivity",
    "uncertainty",
)  # fmt: skip


def measured(experiment, load_map):
    """Return an experiment with the motion on a table, which its scene does not have."""
    scene = experiment.scene
    plane = replace(scene.plane, load_map=load_map)
    times = np.linspace(0.0, scene.duration, 6)
    found = fixel.simulate(
        replace(scene, plane=plane), TRUTH, output_interval=float(times[1]), **QUASISTATIC
    )
    return replace(experiment, trajectory=Trajectory(time=times, pose=found.pose["part"][:6]))


@pytest.fixture(scope="module")
def pushes():
    """Pushes of two parts on hills, and one that was made on a flat table of another name."""
    own = [measured(push, HILLS) for push in example_parts(2, 6, uneven=0.1)]
    other = replace(measured(own[0], None), name="flat", conditions={"surface": "glass"})
    return [*own, other]


@pytest.fixture(scope="module")
def fitted(pushes):
    return fixel.table_map(pushes[:-1], progress=False)


@pytest.fixture(scope="module")
def table(fitted):
    """Map with the hills themselves instead of what was fitted, seen in a circle of 250 mm."""
    y, x = np.meshgrid(*2 * [np.arange(-6, 7) * 0.05], indexing="ij")
    spread = np.diag(np.where(np.hypot(x, y) < 0.25, 0.1, 1.0).ravel())
    return replace(fitted, load_map=HILLS, spread=spread, weight=1.0)


@pytest.fixture
def lab(pushes, tmp_path):
    return project_of(tmp_path / "lab", pushes)


@pytest.fixture
def file(table, tmp_path):
    return table.save(tmp_path / "hills.fixel")


def answer(lab, name, **options):
    capability = CAPABILITIES[name]
    return run(capability, capability.request(options), lab.folder, progress=False)


def test_every_door_has_the_option():
    doors = [own for own in CAPABILITIES.values() if own.on_table]
    assert [own.name for own in doors] == [*DOORS]
    assert all(own.options["table"].flag == "--table" for own in doors)


def test_only_experiments_that_name_the_table_are_on_it(lab, pushes, file):
    seen = lab.seen_through(TableView.of(file))

    for own in (seen.experiments(), [seen.experiment(push.key) for push in pushes]):
        scenes = {push.key: push.scene for push in own}
        for push in pushes[:-1]:
            assert scenes[push.key].plane.load_map == HILLS
            assert replace(scenes[push.key], plane=push.scene.plane) == push.scene
        assert scenes["example/flat"] == pushes[-1].scene
    assert [push.scene for push in lab.experiments()] == [push.scene for push in pushes]


def test_a_push_is_simulated_on_the_table_that_it_was_made_on(lab, file):
    given = {"parameters": TRUTH, **QUASISTATIC}
    for key, flat in (("part-1-01", False), ("flat", True)):
        without, mapped = (
            answer(lab, "compare", experiment=key, **given, **more).result.run.error_mm2
            for more in ({}, {"table": file})
        )
        assert mapped < 1e-6
        assert (without < 1e-6) == flat


def test_a_filter_predicts_on_the_table_and_its_command_names_the_map(lab, pushes, file):
    scene, measured = pushes[0].scene, pushes[0].trajectory
    run = fixel.simulate(scene, output_interval=measured.time[1], **QUASISTATIC)
    tip = run.pushers[scene.pushers[0].name].pose[:6]
    seen = replace(pushes[0], name="seen", pusher=replace(measured, pose=tip))
    with lab.store() as store:
        store.add_experiment(seen)
    given = {"experiment": "seen", "particles": 20}
    flat, mapped = (answer(lab, "filter", **given, **more) for more in ({}, {"table": file}))
    assert not np.array_equal(flat.result.estimates.mean, mapped.result.estimates.mean)
    with lab.store() as store:
        commands = [store.filter_run(k).provenance.command for k in (1, 2)]
    assert [f"--table {file}" in command for command in commands] == [False, True]


def test_a_map_is_part_of_the_question(lab, table, file, tmp_path):
    other = replace(table, load_map=replace(HILLS, log_load=2.0 * HILLS.log_load))
    given = {"where": ("part!=glass", "surface=board"), "fit": ("mu_pusher",), "folds": 2}
    given |= {"level": 0.5}
    found = [
        answer(lab, "error-bound", **given, **more)
        for more in ({}, {"table": file}, {"table": other.save(tmp_path / "other.fixel")})
    ]
    questions = [one.analysis.question for one in found]

    assert len({one.folder for one in found}) == 3
    assert len({one.get("table_sha256") for one in questions}) == 3
    # Fits are not those without the map, and the same map in another file needs no others.
    medians = [float(np.median(one.result.bound.position)) for one in found]
    assert medians[1] < 1e-4 < min(medians[0], medians[2])
    again = TableView.of(table.save(tmp_path / "again.fixel"))
    assert again.sha256 == questions[1]["table_sha256"]


def test_a_job_has_the_map_and_does_not_read_the_file_again(lab, file):
    capability = CAPABILITIES["sensitivity"]
    request = capability.request({"experiments": ("part-1-01",), "samples": 50, "table": file})
    here = run(capability, request, lab.folder, progress=False)
    folder = prepare(capability, request, lab)
    file.unlink()

    assert jobs.run_here(folder).state == "done"
    (kept,) = lab.analyses
    assert (folder / "result").read_text() == kept.folder.name == here.folder.name
    assert kept.analysis.tables[0].content() == here.analysis.tables[0].content()


def test_a_plan_is_made_on_the_table(lab, pushes, file, tmp_path):
    """The scene of a goal file here, and that of an experiment in a job."""
    scene = pushes[0].scene.save(tmp_path / "scene.yaml")
    x, y, _ = (1e3 * value for value in pushes[0].scene.bodies[0].pose)
    wanted = {"pose": {"pose_mm_deg": [x + 20, y, 0], "position_mm": 8}}
    goal = json.dumps({"fixel": 1, "goal": wanted, "belief": {"parameters": {"mu_pusher": 0.25}}})
    given = {"goal": goal, "rollouts": 1000}
    here, flat = (
        answer(lab, "plan", **given, **more, scene=scene).result.found.plan
        for more in ({"table": file}, {})
    )
    assert here.scene.plane.load_map == HILLS
    assert flat.scene.plane.load_map is None
    assert not np.array_equal(here.runs.margin, flat.runs.margin)
    capability = CAPABILITIES["plan"]
    request = capability.request({**given, "experiment": "part-1-01", "table": file})
    folder = prepare(capability, request, lab)
    file.unlink()
    assert jobs.run_here(folder).state == "done"
    name = (folder / "result").read_text()
    (kept,) = (one for one in lab.analyses if one.folder.name == name)
    stored = load_plan(kept.folder / FILE).found.plan
    assert stored.scene.plane.load_map == HILLS
    assert kept.analysis.numbers["success"]["stated"] == here.success.stated
    assert np.array_equal(stored.runs.margin, here.runs.margin)
    elsewhere = capability.request({**given, "scene": scene, "table": file})
    with pytest.raises(StoreRefused, match="is not a fixel project"):
        run(capability, elsewhere, tmp_path, progress=False)


def test_a_stored_calibration_keeps_the_table(lab, file):
    given = {"fit": ("mu_pusher",), "where": ("part=part-1",), "verdicts": False, **QUASISTATIC}
    done = answer(lab, "calibrate", **given, table=file)
    file.unlink()
    (number,) = done.result.ids
    fit = stored_calibration(lab, number)

    assert fit["mu_pusher"] == pytest.approx(TRUTH["mu_pusher"], abs=1e-3)
    assert [target.case.scene.plane.load_map for target in fit.targets] == 6 * [HILLS]
    comparer = Comparer(fit.targets, fit.space, fit.request.made_error, fit.motion)
    point = np.repeat(fit.found.point[None], 6, axis=0)
    assert comparer.errors(np.arange(6), point).error.tolist() == fit.found.errors.tolist()
    assert f"--table {file}" in fit.command
    assert CAPABILITIES["calibrate"].present.next_words(done)[-2:] == ["--table", str(file)]
    # The same values on a flat table are another matter.
    compared = answer(lab, "compare", experiment="part-1-01", calibration=number)
    assert "was made with the map of a table" in compared.analysis.warnings[0]


def test_next_pushes_learn_on_the_table(lab, file):
    given = {"part": "part-2", "contacts": 4, "number": 1}
    flat, mapped, again = (
        answer(lab, "next", **given, **more).result.model.fits[0].values
        for more in ({}, {"table": file}, {})
    )

    assert np.array_equal(flat, again)
    assert not np.allclose(flat, mapped)


def test_a_push_where_no_other_was_has_a_warning(lab, pushes, file):
    push = pushes[0]
    scene, shift = push.scene, np.array([0.5, 0.0, 0.0])
    body, pusher = scene.bodies[0], scene.pushers[0]
    moved = replace(
        scene,
        bodies=(replace(body, pose=Pose(*(body.pose + shift))),),
        pushers=(replace(pusher, pose=Pose(*(pusher.pose + shift))),),
    )
    away = replace(push.trajectory, pose=push.trajectory.pose + shift)
    with lab.store() as store:
        store.add_experiment(replace(push, name="away", scene=moved, trajectory=away))

    near, far, flat = (
        answer(lab, "compare", experiment=key, table=file).analysis.warnings
        for key in ("part-1-02", "away", "flat")
    )
    assert near == ()
    assert far == ("example/away: the part stands where none of the 12 pushes of the map was",)
    assert flat == ("no experiment is on surface=board of the map",)


def test_other_files_and_laboratories_are_refused(lab, pushes, table, file, tmp_path):
    with lab.store() as store:
        store.add_experiment(replace(pushes[0], dataset="elsewhere"))
    disk = fixel.io.save(fixel.Disk(0.01), tmp_path / "disk.fixel")
    for name, options, said in (
        ("compare", {"experiment": "elsewhere/part-1-01", "table": file}, "world coordinates"),
        ("compare", {"experiment": "part-1-02", "table": disk}, "table: found a Disk"),
        ("compare", {"experiment": "part-1-02", "table": tmp_path / "none"}, "none: "),
    ):
        capability = CAPABILITIES[name]
        with pytest.raises(InvalidInput, match=said):
            run(capability, capability.request(options), lab.folder, progress=False)


def test_a_scene_file_is_not_put_on_the_table(lab, pushes, file, tmp_path):
    scene = pushes[0].scene.save(tmp_path / "scene.yaml")
    given = {"experiments": (str(scene),), "samples": 50, "table": file}
    done = answer(lab, "sensitivity", **given)
    assert "no experiment is on surface=board of the map" in done.analysis.warnings
    elsewhere = CAPABILITIES["sensitivity"].request(given)
    with pytest.raises(StoreRefused, match="is not a fixel project"):
        run(CAPABILITIES["sensitivity"], elsewhere, tmp_path, progress=False)


# --- the map itself -------------------------------------------------------------------------------


def test_a_map_of_a_project_is_that_of_its_experiments(lab, fitted, tmp_path):
    file, charts = tmp_path / "map.fixel", tmp_path / "charts"
    words = ["table", "map", "--where", "surface=board", "--out", str(file), "--plot", str(charts)]
    answer = CliRunner().invoke(app, [*words, "--project", str(lab.folder), "--json"])
    found, printed = fixel.load(file), json.loads(answer.stdout)

    assert np.array_equal(found.load_map.log_load, fitted.load_map.log_load)
    assert (printed["weight"], printed["parts"]) == (found.weight, ["part-1", "part-2"])
    mean, low, high = printed["change_of_errors"]["side"]["position_m"]
    side = found.judgement
    by_part = [
        np.mean([a - b for name, a, b in zip(side.part, side.after, side.before, strict=True)
                 if name == part], axis=0)[0]
        for part in ("part-1", "part-2")
    ]  # fmt: skip
    assert mean == pytest.approx(np.mean(by_part))
    assert low <= mean <= high
    assert {path.name for path in charts.iterdir()} == {"map.png", "map.pdf", "map.csv"}
    with pytest.raises(InvalidInput, match="surface"):
        fixel.table_map(lab.experiments(), progress=False)


def test_the_command_names_the_next_one(lab, table, tmp_path):
    capability, where = CAPABILITIES["table-map"], ("surface=board",)
    done = answer(lab, "table-map", where=where)
    helps = done._replace(result=(table, done.result[1]))
    saved = helps._replace(request=capability.request({"where": where, "out": tmp_path / "m"}))
    for helpful, said in (
        (helps, "table map --where surface=board --out table.fixel"),
        (saved, f"calibrate --where surface=board --table {tmp_path / 'm'}"),
    ):
        assert " ".join(map(str, capability.present.next_words(helpful))) == said
    without = helps._replace(result=(replace(table, weight=0.0), done.result[1]))
    assert capability.present.next_words(without) == []


def test_the_figure_shows_nodes_and_pushes(table, pushes):
    chart = map_chart(table)
    rows = chart.table().rows
    nodes, dots = ([row for row in rows if row[0] == kind] for kind in ("node", "push"))
    figure = chart.figure()

    assert len(nodes) == HILLS.log_load.size
    assert len(dots) == len(pushes) - 1
    # A part is half way between its first and its last place.
    halfway = np.array([0.5 * (p.trajectory.pose[0] + p.trajectory.pose[-1]) for p in pushes[:-1]])
    away = np.abs(np.array([row[1:3] for row in dots]) - halfway[:, :2]).max()
    assert away < 5e-3
    drawn = figure.axes[1].lines[0].get_xydata()
    assert np.allclose(drawn, 1e3 * np.array([row[1:3] for row in dots], float))
