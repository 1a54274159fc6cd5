"""Uncertainty of a stored experiment, computed, stored and printed from Python and the shell."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm
from tests.filtering.recordings import push
from tests.fixtures import calibration_record, project_of
from typer.testing import CliRunner

import fixel
from fixel.calibration.noise import Noise
from fixel.calibration.result import CalibratedValues
from fixel.cli.main import app
from fixel.database.project import Project
from fixel.errors import InvalidInput, NotStored
from fixel.model.records import Estimate
from fixel.workflows.analysis import load_analyses
from fixel.workflows.capabilities import run
from fixel.workflows.uncertainty import report
from fixel.workflows.uncertainty.run import UNCERTAINTY

FIT = ("tripod_radius_mm=20:60",)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("projects") / "lab"
    pushes = (replace(push(seed=k, duration=2.0), name=f"push-{k}") for k in (1, 2))
    project_of(place, pushes)
    return place


@pytest.fixture(scope="module")
def answered(folder, few_live, tmp_path_factory):
    pictures = tmp_path_factory.mktemp("pictures")
    words = ["uncertainty", "push-1", "--held-out", "push-2", "--project", str(folder)]
    words += ["--noise-mm", "0.05", "--noise-mrad", "2", "--motion", "quasistatic"]
    words += ["--samples", "60", "--plot", str(pictures)]
    for text in FIT:
        words += ["--fit", text]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    return result.stdout, pictures


def test_the_answer_for_people(answered):
    out, pictures = answered
    for words in (
        "ends with 90 % probability in an ellipse of",
        "The model error at the end of the motion is",
        "tripod_radius",
        "held out",
        "effective samples from",
        "log evidence",
    ):
        assert words in out
    last = out.splitlines()[-1]
    assert last.startswith("Next: fixel compare testbed/push-1 --set tripod_radius=")
    assert {path.name for path in pictures.glob("*.png")} == {
        "corner.png", "bands-1.png", "final-1.png", "bands-2.png", "final-2.png",
    }  # fmt: skip


def test_it_is_kept_as_an_analysis(folder, answered):
    assert answered
    (one,) = load_analyses(Project(folder), "uncertainty")
    numbers = one.analysis.numbers
    assert numbers["experiments"] == ["testbed/push-1"]
    assert set(numbers["parameters"]) == {"tripod_radius", "model_error"}
    assert one.arrays["samples"].shape[0] >= 60
    assert one.arrays["samples"].shape[1] == 2
    assert len(one.analysis.pictures) == 5
    own = numbers["parameters"]["tripod_radius"]
    assert own["prior"] == pytest.approx([0.02, 0.06])
    assert own["low"] <= 0.04 <= own["high"]
    # A camera of 0.05 mm over a right model: no millimetre of model error.
    assert numbers["parameters"]["model_error"]["median"] < 1e-3
    assert numbers["coverage"] is None
    assert [final["held_out"] for final in numbers["final_pose"]] == [False, True]
    json.dumps(numbers, allow_nan=False)


@pytest.mark.system
@pytest.mark.usefixtures("few_live")
def test_the_cameras_noise_is_found_out(folder):
    found = _asked(folder, motion="quasistatic", samples=50)
    assert found.posterior.noise.position_m == pytest.approx(5e-5, rel=0.4)
    assert found.posterior.noise.angle_rad == pytest.approx(2e-3, rel=0.4)
    assert np.isfinite(found.posterior.points).all()


@pytest.mark.usefixtures("few_live")
def test_python_and_command_have_one_answer_for_a_calibration(tmp_path):
    """The stated noise of the calibration counts; the second parameter is of other experiments."""
    noise = Noise(position_m=2e-4, angle_rad=3e-3)
    pushes = [replace(push(seed=k, duration=0.5), name=f"push-{k}") for k in (1, 2)]
    pushes[1] = replace(pushes[1], conditions={"surface": "abs"})
    space = {"mu_pusher": (0, 1), "tripod_radius[surface=abs]": (0.02, 0.06)}
    options = {"noise": noise, "motion": "quasistatic", "verdicts": False, "progress": False}
    project = project_of(tmp_path / "lab", pushes)
    fit = fixel.calibrate(project.experiments(), space, store=project, **options)
    own = fixel.posterior(pushes[0], fit, samples=20, progress=False)
    (number,) = fit.run.ids
    request = {"experiments": ("push-1",), "calibration": number, "samples": 20}
    command = run(UNCERTAINTY, UNCERTAINTY.request(request), project.folder, progress=False)
    assert own.labels == command.result.posterior.labels == ("mu_pusher", "model_error")
    np.testing.assert_array_equal(own.points, command.result.posterior.points)
    assert own.noise == command.result.posterior.noise == noise


def _asked(folder, **changes):
    request = UNCERTAINTY.request({"experiments": ("push-1",), "fit": FIT, **changes})
    return run(UNCERTAINTY, request, folder, progress=False).result


@pytest.mark.parametrize(("changes", "words"), [
    ({"held_out": ("push-1",)}, "held_out"),
    ({"motion": "magic"}, "motion is 'magic'"),
    ({"experiments": ()}, "found none"),
    ({"experiments": ("nothing",)}, "nothing"),
])  # fmt: skip
def test_questions_that_make_no_sense_are_refused(folder, changes, words):
    with pytest.raises((InvalidInput, NotStored), match=words):
        _asked(folder, **changes)


def _compared(low, high, quantiles, of=1, level=0.95):
    """Warnings of a posterior of mu_pusher compared with a calibration of 21 experiments."""
    estimate = Estimate(
        label="mu_pusher", unit="-", value=0.256, low=low, high=high, verdict="identified"
    )
    record = calibration_record(
        dict.fromkeys(range(21), 1.0),
        {"mu_pusher": 0.2},
        method={"misfit": "model misfit: residuals of 2 mm\nmore", "misfit_ratio": 39.0},
        estimates=(estimate,),
        request={"level": level},
    )
    found = SimpleNamespace(
        compared=CalibratedValues(7, record),
        predicted=[SimpleNamespace(held_out=False, prediction=SimpleNamespace(failed=0, unseen=()))]
        * of,
        requested=1,
        posterior=SimpleNamespace(
            labels=("mu_pusher",),
            units=("-",),
            low=np.zeros(1),
            high=np.ones(1),
            quantiles=lambda *_: np.array(quantiles)[:, None],
            effective=1.0,
            model_error=True,
            failed=0,
            evaluations=1,
        ),
    )
    return list(report._warnings(found))


def test_a_posterior_repeats_the_misfit_of_the_calibration():
    assert _compared(0.15, 0.36, (0.18, 0.2, 0.22)) == [
        "Calibration 7: model misfit: residuals of 2 mm"
    ]


def test_a_posterior_does_not_contradict_the_calibration_silently():
    _, apart = _compared(0.15, 0.36, (0.4, 0.42, 0.44))
    assert apart.startswith("mu_pusher contradicts calibration 7: this posterior of 1 experiment")
    assert " (95 %), the calibration of 21 has" in apart
    assert apart.endswith("quote the calibration.")
    _, compared = _compared(0.15, None, (0.1, 0.14, 0.2), of=21)
    assert compared.startswith("mu_pusher disagrees with calibration 7")
    assert " ," not in compared  # friction has no unit
    assert "(0.15 to open)" in compared
    assert compared.endswith("quote the wider interval.")


def test_a_posterior_at_the_bound_of_its_prior_is_named():
    """The prior is from 0 to 1; an interval that fills it shows that nothing was learned."""
    warned = "mu_pusher is at the bound of its prior: use a wider one if other values are possible."
    assert _compared(0.1, 0.9, (0.9, 0.97, 0.999))[-1] == warned
    assert _compared(0.1, 0.9, (0.001, 0.02, 0.1))[-1] == warned
    assert warned not in _compared(0.1, 0.9, (0.01, 0.5, 0.99))
    assert warned not in _compared(0.1, 0.9, (0.6, 0.7, 0.8))


@pytest.mark.parametrize(("away", "verdicts"), [(1.0, 0), (1.9, 0), (2.1, 1), (5.0, 1)])
@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
def test_the_level_of_a_calibration_decides_no_contradiction(level, away, verdicts):
    deviation = 0.01
    half = deviation * norm.interval(level)[1]
    other = norm.ppf((0.025, 0.5, 0.975), 0.256 + away * deviation, 1e-3)
    assert len(_compared(0.256 - half, 0.256 + half, tuple(other), level=level)) == 1 + verdicts
