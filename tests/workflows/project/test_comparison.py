"""Comparisons of several experiments and models."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel.workflows.project.comparison import compare


@pytest.fixture(scope="module")
def pushes():
    return fixel.datasets.example()[:5]


@pytest.fixture(scope="module")
def found(pushes):
    models = {"scene": None, "true": {"mu_pusher": 0.22, "tripod_radius": 0.038}}
    return compare(pushes, models, progress=False)


def test_errors_are_those_of_the_poses(found):
    """Errors computed here from measured and simulated poses, angles at 35 mm per radian."""
    for row in found.rows:
        track = row.run.experiment.trajectory
        difference = row.run.simulated.at(track.time[1:]) - track.pose[1:]
        squares = (1e3 * difference[:, :2]) ** 2
        turned = (difference[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        expected = np.sqrt(np.mean(squares.sum(axis=1) + (35.0 * turned) ** 2))
        assert row.error_mm == pytest.approx(expected, rel=1e-9)


def test_true_values_fit_better(found):
    errors = {model: [row.error_mm for row in found.of(model)] for model in found.models}
    assert max(errors["true"]) < 1.0 < min(errors["scene"])


def test_it_prints_models_and_the_worst(found):
    lines = repr(found).splitlines()
    assert lines[0] == "Comparison of 5 experiments with 2 models"
    assert any(line.split()[:2] == ["true", "5"] for line in lines)
    table = found.to_arrow()
    assert table.num_rows == 10
    assert table.column("model").to_pylist()[:2] == ["scene", "true"]


def test_experiments_are_filtered_by_their_errors(found, pushes):
    with_errors = found.experiments
    limit = round(found.of("true")[2].error_mm, 9) - 1e-8  # not equal to any of them
    expected = [row.run.experiment.key for row in found.of("true") if row.error_mm >= limit]
    assert list(with_errors.where(f"error>={limit}").keys) == expected
    assert with_errors[0] == pushes[0]
    assert len(with_errors.where("before>0.1")) == 5


def test_experiments_without_a_scene_are_skipped_or_refused(pushes):
    bare = replace(pushes[0], scene=None)
    found = compare([bare, pushes[1]], progress=False)
    assert len(found.rows) == 1
    assert "no scene" in found.skipped[0]
    assert "skipped 1" in repr(compare([bare, *pushes[1:3]], progress=False))
    for experiments in (bare, [bare, bare], []):
        refused(compare, experiments, progress=False, match="scene")


@pytest.mark.parametrize(("models", "motion", "complaint"), [
    ({"mu_pushr": 0.2}, None, "mu_pushr"),
    (0.2, None, "models is 0.2"),
    ({}, None, "models is {}"),
    (None, "quasi", "motion is 'quasi'"),
])  # fmt: skip
def test_what_cannot_be_simulated_is_refused(pushes, models, motion, complaint):
    refused(compare, pushes[:2], models, motion=motion, progress=False, match=complaint)


def test_plots(found, pushes):
    from matplotlib import pyplot

    _, ax = pyplot.subplots()
    assert found.plot(ax=ax) is ax
    assert [line.get_label() for line in ax.lines] == ["scene (5)", "true (5)"]
    assert ax.lines[1].get_ydata()[-1] == 100.0
    assert len(found.plot(experiment=pushes[3].key)) == 3
    assert len(compare(pushes[0], progress=False).plot()) == 3
    refused(found.plot, experiment="nowhere", match="experiment is 'nowhere'")
    pyplot.close("all")


def test_progress_is_reported(pushes):
    seen = []
    compare(pushes[:2], progress=seen.append)
    assert [(progress.done, progress.total) for progress in seen] == [(0, 2), (1, 2), (2, 2)]


def test_simulations_of_the_laboratory_are_compared_next_to_ours(data_root):
    """E of the laboratory's simulations, computed from the files with the thesis's formula."""
    trials = fixel.read_experiments(data_root / "rpi_2dgad", progress=False)
    alone = compare(trials, {"laboratory": trials.simulations}, progress=False)
    both = compare(trials, {"fixel": None, "laboratory": trials.simulations}, progress=False)

    assert len(alone.rows) == 20
    assert both.models == ("fixel", "laboratory")
    assert [row.run.experiment.name for row in both.of("laboratory")] == ["141"]
    assert len(both.skipped) == 19
    table = np.genfromtxt(
        data_root / "rpi_2dgad" / "author_simulation_trajectory.csv.gz", delimiter=",", names=True
    )
    measured = np.genfromtxt(
        data_root / "rpi_2dgad" / "object_trajectory.csv.gz", delimiter=",", names=True
    )
    listed = np.genfromtxt(
        data_root / "rpi_2dgad" / "experiments.csv", delimiter=",", names=True, dtype=float
    )
    for row in alone.rows:
        number = float(row.run.experiment.name)
        about = listed[listed["experiment_id"] == number][0]
        if number == 141:
            continue  # from its own files
        own, theirs = (part[part["experiment_id"] == number] for part in (measured, table))
        own = own[(own["frame"] >= about["start_frame"]) & (own["frame"] <= about["end_frame"])]
        path = {
            name: np.interp(
                own["frame"],
                theirs["frame"],
                np.unwrap(theirs[name]) if name == "theta_rad" else theirs[name],
            )
            for name in ("x_mm", "y_mm", "theta_rad")
        }
        turned = (path["theta_rad"] - own["theta_rad"] + np.pi) % (2.0 * np.pi) - np.pi
        squares = (path["x_mm"] - own["x_mm"]) ** 2 + (path["y_mm"] - own["y_mm"]) ** 2
        assert row.run.error_mm2 == pytest.approx(np.mean(squares + (35.0 * turned) ** 2), rel=1e-6)


def test_different_experiments_of_the_same_name_are_refused(pushes, tmp_path):
    """Errors by name and stored experiments of one would count for the other."""
    one, other = pushes[0], replace(pushes[1], dataset=pushes[0].dataset, name=pushes[0].name)
    for experiments in ([one, other], fixel.Experiments.of([one, other])):
        refused(compare, experiments, progress=False, match=f"both named {one.key}.* dataset=")
        refused(fixel.export, experiments, tmp_path / "both.zip", match=f"both named {one.key}")
    named = [one, replace(other, dataset="second")]
    assert len(compare(named, progress=False).experiments) == 2
    assert len(compare([one, replace(one)], progress=False).rows) == 2
    written = fixel.export(named, tmp_path / "both.zip", progress=False)
    assert written.counts["experiments"] == len(fixel.read_experiments(written.target)) == 2


def test_an_experiment_of_the_same_name_as_a_fitted_one_is_held_out(pushes):
    """Tables in memory give equal names. A fitted experiment stays so with other useful times."""
    fit = fixel.calibrate(pushes[:1], ["mu_pusher"], max_evaluations=5, verdicts=False,
                          progress=False)  # fmt: skip
    namesake = replace(pushes[1], dataset=pushes[0].dataset, name=pushes[0].name)
    for experiment, use in ((pushes[0], "fitted"), (namesake, "held out"),
                            (replace(pushes[0], effective=(1.0, 3.0)), "fitted")):  # fmt: skip
        assert [row.use for row in compare(experiment, fit, progress=False).rows] == ["", use]
