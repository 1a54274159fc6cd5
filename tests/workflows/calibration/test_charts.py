"""Pictures of calibrations: which there are, and that their numbers are the calibration's."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from tests import calibrating as run
from tests.fixtures import project_of

from fixel.calibration.usual_parameters import searched_unknowns
from fixel.errors import InvalidInput
from fixel.model.records import Estimate, ProfileRecord
from fixel.model.selection import ExperimentQuery
from fixel.sampling.published import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.web.views import calibration_views
from fixel.workflows.analysis import write_picture
from fixel.workflows.calibration.report import _ChartData, pictures_of
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions

PLANNED = thesis_plan().experiments
QUICK = NamedOptions(name="pattern-search", options={"threshold_delta": 0.2})


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A project, and the four experiments in it."""
    experiments = SimulatedTestbed.ideal().run([PLANNED[k] for k in (0, 1, 2, 7)])
    project = project_of(tmp_path_factory.mktemp("pictures") / "lab", experiments)
    with project.store() as store:
        return project, run.select_experiments(store, (), ExperimentQuery())


_DONE = {}


def _done(lab, n=4, **changes):
    """Calibrate some of the experiments, once for each question."""
    question = (str(lab[0].folder), n, *changes.items())
    if question not in _DONE:
        _DONE[question] = _calibrated(lab, n, changes)
    return _DONE[question]


def _calibrated(lab, n, changes):
    project, chosen = lab
    few = replace(chosen, ids=chosen.ids[:n], targets=chosen.targets[:n])
    scenes = [target.case.scene for target in few.targets]
    unknowns = searched_unknowns(["mu_pusher", "tripod_radius_mm=10:60:30"], scenes)
    settings = {"unknowns": unknowns, "optimiser": QUICK, "verdicts": False} | changes
    return run.done(project, few, CalibrationRequest(**settings))


def _rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def _names(paths):
    assert all(path.is_file() and path.stat().st_size for path in paths)
    stems = [path.stem for path in paths]
    assert all(stems.count(stem) == 3 for stem in stems)
    return list(dict.fromkeys(stems))


@pytest.mark.usefixtures("blank")
def test_of_each_experiment_by_itself(lab, tmp_path):
    done = _done(lab, mode="each")
    folder = tmp_path / "new" / "pictures"

    assert _names(done.draw(folder)) == [
        "search",
        "seconds",
        *(f"parameters_{word}" for word in ("best", "median", "worst")),
        "parameters_by_offset",
        "errors",
        "errors_by_offset",
        *(f"overlay_{word}" for word in ("best", "median", "worst")),
    ]
    assert sorted(path.suffix for path in folder.iterdir()).count(".csv") == 11

    after = {row["experiment"]: float(row["after_mm"]) for row in _rows(folder / "errors.csv")}
    alone = run.alone(done)
    assert after == pytest.approx(
        {done.outcome.keys[o.members[0]]: o.errors[0] ** 0.5 for o in alone}
    )
    offsets = _rows(folder / "parameters_by_offset.csv")
    assert {(row["axis"], row["offset_unit"]) for row in offsets} == {("x", "m"), ("y", "m")}
    radius = {row["experiment"]: float(row["tripod_radius [m]"]) for row in offsets}
    assert radius[done.outcome.keys[0]] == run.alone(done)[0].point[1]


@pytest.mark.usefixtures("blank")
def test_of_one_set_for_all(lab, tmp_path):
    done = _done(lab, n=1, mode="joint", starts=3)
    names = _names(done.draw(tmp_path))

    assert names[:2] == ["search", "starts"]
    assert "seconds" not in names
    assert "parameters_by_offset" not in names
    trace = done.outcome.found[0].trace
    searched = _rows(tmp_path / "search.csv")
    assert [float(row["error_mm"]) ** 2 for row in searched] == pytest.approx(trace.errors.tolist())
    assert [int(row["iteration"]) for row in searched][:4] == [0, 0, 0, 1]
    starts = _rows(tmp_path / "starts.csv")
    assert float(starts[0]["error_mm"]) ** 2 == pytest.approx(trace.error)
    assert sum(int(row["evaluations"]) for row in starts) == len(trace.errors)


@pytest.mark.system
def test_of_a_campaign(lab, tmp_path):
    done = _done(lab, n=2, mode="campaign")
    names = _names(done.draw(tmp_path))

    assert {"search", "search_alone", "seconds", "parameters", "parameters_by_offset"} < {*names}
    assert "iteration" in _rows(tmp_path / "search.csv")[0]
    assert {row["iteration"] for row in _rows(tmp_path / "search.csv")} > {"0", "1", "2"}
    row = _rows(tmp_path / "parameters.csv")[0]
    ways = {one.how: one for one in run.together(done)}
    assert float(row["value"]) == ways["direct minimisation"].point[0]
    assert float(row["weighted mean of a subset"]) == ways["weighted mean of a subset"].point[0]
    columns = "experiment before_mm each_alone_mm one_set_for_all_mm"
    assert list(_rows(tmp_path / "errors.csv")[0]) == columns.split()


def test_of_one_experiment(lab, tmp_path):
    """Overlays hold the trajectories that the errors are of."""
    done = _done(lab, n=1, mode="each")

    assert _names(done.draw(tmp_path)) == ["search", "parameters", "overlay"]
    curves = {}
    for row in _rows(tmp_path / "overlay.csv"):
        curves.setdefault(row["curve"], []).append(
            [float(row[name]) for name in ("time_s", "x_m", "y_m", "theta_rad")]
        )
    recorded = np.array(curves["recorded"])[1:]
    for name, error in (
        ("before", done.outcome.nominal[0]),
        ("after", done.outcome.found[0].errors[0]),
    ):
        own = np.array(curves[name])
        off = np.column_stack([np.interp(recorded[:, 0], own[:, 0], own[:, k]) for k in (1, 2, 3)])
        off = (off - recorded[:, 1:]) * (1e3, 1e3, 35.0)
        assert np.square(off).sum(axis=1).mean() == pytest.approx(error, rel=0.05, abs=0.01)


def test_verdicts_and_profiles_are_drawn(lab, tmp_path):
    done = _done(lab, n=1, mode="each")
    values = np.linspace(0.1, 0.5, 7)
    curve = ProfileRecord(
        label="mu_pusher",
        values=values,
        deviances=(values - 0.3) ** 2,
        slice_values=values,
        slice_deviances=2.0 * (values - 0.3) ** 2,
        low=0.2,
        high=None,
        threshold=0.01,
    )
    estimate = Estimate(
        label="mu_pusher", unit="-", value=0.3, low=0.2, high=None, verdict="at bound", reason=""
    )
    found = replace(
        done.outcome.found[0],
        estimates=(estimate,),
        profiles=(curve,),
        solutions=np.array([[0.3, 0.02], [0.7, 0.03]]),
    )
    judged = replace(done, outcome=replace(done.outcome, found=(found,)))

    assert "profiles" in _names(judged.draw(tmp_path))
    row = _rows(tmp_path / "parameters.csv")[0]
    assert (row["interval_low"], row["interval_high"], row["verdict"]) == ("0.2", "", "at bound")
    assert float(row["solution 2, nearly as good"]) == 0.7
    profiles = _rows(tmp_path / "profiles.csv")
    assert [row["curve"] for row in profiles] == ["profile"] * 7 + ["slice"] * 7


def test_what_could_not_be_calibrated_is_drawn_too(lab):
    done = _done(lab, mode="each")
    lost = replace(done.outcome.found[3], errors=np.array([np.inf]), trace=None, note="crashed")
    outcome = replace(done.outcome, found=(*done.outcome.found[:3], lost))

    pictures = {p.name: p.chart for p in pictures_of(replace(done, outcome=outcome))}
    for chart in pictures.values():
        chart.figure()

    rows = {row[0]: row[-1] for row in pictures["errors"].table().rows}
    assert rows[done.outcome.keys[3]] is None
    assert sum(error is None for error in rows.values()) == 1


def test_simulated_experiments_never_look_real(lab):
    desk = _ChartData(_done(lab, mode="each"))

    assert desk.banner.startswith("SIMULATED by ")
    assert all(banner == desk.banner for banner in desk.banners)


def test_iterations_and_starts_of_a_search_are_stored(lab):
    done = _done(lab, n=1, mode="each", starts=2)
    trace = done.outcome.found[0].trace
    assert trace.begins[:2].tolist() == [0, 2]  # a point of each start
    assert len(trace.ends()) == 2
    assert min(end.error for end in trace.ends()) == trace.error

    single = _done(lab, n=1, mode="each").outcome.found[0].trace
    assert single.begins[:2].tolist() == [0, 1]
    assert single.ends() == []


@pytest.mark.system
@pytest.mark.usefixtures("blank")
def test_each_search_by_least_squares_has_its_own_end(lab, tmp_path):
    options = {"mode": "joint", "optimiser": NamedOptions(name="least-squares")}
    several, single = (_calibrated(lab, 4, options | {"starts": n}) for n in (3, 1))
    trace, alone = (done.outcome.found[0].trace for done in (several, single))

    np.testing.assert_array_equal(trace.points[trace.starts == 0], alone.points)
    assert {*trace.starts.tolist()} == {0, 1, 2}
    assert min(end.error for end in trace.ends()) == trace.error
    assert "starts" in _names(several.draw(tmp_path))
    with lab[0].store() as store:
        detail = calibration_views.load_detail(lab[0], store, several.ids[0])
    assert sum(start.evaluations for start in detail.starts) == len(trace.points)
    assert detail.note == ""


def test_results_without_the_ends_of_their_searches_are_explained(lab, monkeypatch):
    done = _done(lab, n=1, mode="each", starts=2)
    one = done.outcome.found[0]
    old = replace(one, trace=one.trace._replace(starts=np.zeros(0, np.int64)))
    earlier = replace(done, outcome=replace(done.outcome, found=(old,)))
    with lab[0].store() as store:
        assert calibration_views.load_detail(lab[0], store, done.ids[0]).starts
        monkeypatch.setattr(calibration_views, "stored_in_run", lambda *_: earlier[0])
        detail = calibration_views.load_detail(lab[0], store, done.ids[0])
    assert detail.starts == []
    assert "earlier version" in detail.note


def test_a_folder_that_cannot_be_made_is_refused(lab, tmp_path):
    done = _done(lab, n=1, mode="each")
    (tmp_path / "file").touch()

    with pytest.raises(InvalidInput, match="a folder to write to"):
        done.draw(tmp_path / "file" / "pictures")


def test_pictures_of_a_search_with_failed_evaluations(lab, tmp_path):
    """A failed one has no error: it must not stand on the axis as the largest float there is."""
    done = _done(lab, mode="joint", combine="mean")
    (one,) = done.outcome.found
    errors = one.trace.errors.copy()
    errors[1::3] = np.inf
    failed = replace(one, trace=one.trace._replace(errors=errors))
    broken = replace(done, outcome=replace(done.outcome, found=(failed,)))
    search = next(p for p in pictures_of(broken) if p.name == "search")
    low, high = search.chart.figure().axes[0].get_ylim()
    assert high < 10.0 * np.sqrt(errors[np.isfinite(errors)].max())
    assert low > 0.0
    assert _names(write_picture(tmp_path, search)) == ["search"]
