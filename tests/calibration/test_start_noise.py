"""Noise of measured start poses, compared with simulations and with drawn errors."""

from dataclasses import replace

import numpy as np
import pytest

import fixel
from fixel import Noise, Parameters, Trajectory, Tripod
from fixel.calibration.honest import ShiftModel, StartSensitivity, start_dispersion, start_study
from fixel.calibration.objective import Comparer
from fixel.calibration.target import targets_of
from fixel.model.space import ParameterSpace, Unknown
from fixel.testing.pushes import TRUTH, example_pushes
from fixel.workflows.calibration.request import read_targets, target_files

CAMERA = Noise(position_m=1e-4, angle_rad=2e-3)
BOUNDS = {"mu_pusher": (0, 1), "tripod_radius": (0.01, 0.06)}


def _sensitivities(rng, n=8, m=12):
    """Pushes whose start errors grow along the way."""
    growth = np.linspace(1.0, 3.0, m)[:, None, None]
    return [
        StartSensitivity(
            np.arange(m),
            rng.normal(size=(1, 3, 2)) * growth * [[[1e-3], [1e-3], [0.02]]],
            rng.normal(size=(1, 3, 3)) * growth * CAMERA.standard_deviations[:, None],
        )
        for _ in range(n)
    ]


def test_the_dispersion_is_that_of_estimates_from_drawn_errors():
    rng = np.random.default_rng(1)
    known = _sensitivities(rng)
    sd = CAMERA.standard_deviations
    columns = np.concatenate([(one.common / sd[:, None]).reshape(-1, 2) for one in known])
    inverse = np.linalg.inv(columns.T @ columns)
    found = []
    for _ in range(4000):
        errors = [
            (one.start @ rng.normal(size=3) + sd * rng.normal(size=(12, 3))) / sd for one in known
        ]
        found.append(inverse @ columns.T @ np.concatenate(errors).ravel())
    ratio = np.var(found, axis=0) / np.diag(inverse)
    dispersion = start_dispersion(known, [12] * len(known), CAMERA, CAMERA)
    assert dispersion == pytest.approx(ratio.max(), rel=0.1)
    # Twice the frames halve the weight of the white noise, not that of the start.
    assert start_dispersion(known, [24] * len(known), CAMERA, CAMERA) > 1.8 * (dispersion - 1.0)


def test_a_start_that_is_exact_adds_nothing():
    known = [
        one._replace(start=0.0 * one.start) for one in _sensitivities(np.random.default_rng(2))
    ]
    assert start_dispersion(known, [12] * 8, CAMERA, CAMERA) == pytest.approx(1.0)


def _apart(push):
    """The push, from 2 mm further away: noise must not make its bodies overlap."""
    tip = push.scene.pushers[0]
    return replace(push.scene, pushers=(replace(tip, pose=tip.pose - [2e-3, 0.0, 0.0]),))


def test_the_start_moves_the_trajectory_as_a_simulation_from_there_does():
    push = example_pushes(2)[1]
    start = push.scene.bodies[0].pose
    pose = np.vstack((start, push.trajectory.pose[1:]))
    push = replace(push, scene=_apart(push), trajectory=replace(push.trajectory, pose=pose))
    unknown = Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=TRUTH["mu_pusher"])
    comparer = Comparer(targets_of([push]), ParameterSpace(unknowns=[unknown]))
    study = start_study(ShiftModel(comparer), [0], comparer.space.nominal, CAMERA)
    rows = next(study)
    with pytest.raises(StopIteration) as end:
        study.send(ShiftModel(comparer).differences(rows))
    (found,) = end.value.value
    body = push.scene.bodies[0]
    for k, sd in enumerate(CAMERA.standard_deviations):
        ends = []
        for side in (1.0, -1.0):
            moved = body.pose + side * sd * np.eye(3)[k]
            scene = replace(push.scene, bodies=(replace(body, pose=moved),))
            values = Parameters({"mu_pusher": TRUTH["mu_pusher"]})
            ends.append(fixel.simulate(scene, values).pose["part"][-1])
        off = found.start[-1, :, k] - (ends[0] - ends[1]) / 2.0
        assert (np.abs(off) <= 0.03 * CAMERA.standard_deviations).all()


def _pushes(support, noise, smooth=1, n=8):
    """Pushes seen by a camera, also where they start; smoothed over some frames."""
    rng = np.random.default_rng(5)
    found = []
    for one in example_pushes(n, duration=2.0):
        apart = _apart(one)
        scene = replace(apart, bodies=(replace(apart.bodies[0], support=support),))
        run = fixel.simulate(scene, {"mu_pusher": 0.25}, motion="quasistatic", output_interval=0.02)
        pose = run.pose["part"] + noise * rng.normal(size=run.pose["part"].shape)
        kernel = np.hanning(smooth + 2)[1:-1]
        kernel /= kernel.sum()
        kept = slice(smooth // 2, len(pose) - smooth // 2)
        pose = np.column_stack([np.convolve(c, kernel, "valid") for c in pose.T])
        time = run.time[kept]
        tip = run.pose["finger"][kept]
        path = fixel.PathDrive(waypoints=np.column_stack((time - time[0], tip)))
        scene = replace(
            apart,
            bodies=(replace(apart.bodies[0], pose=pose[0]),),
            pushers=(replace(apart.pushers[0], pose=tip[0], drive=path),),
            duration=float(time[-1] - time[0]),
        )
        track = Trajectory(time=time - time[0], pose=pose)
        found.append(replace(one, scene=scene, trajectory=track))
    return found


def _fit(pushes):
    return fixel.calibrate(pushes, BOUNDS, motion="quasistatic", progress=False, threads=1)


def test_a_right_model_has_no_misfit_where_the_start_was_measured():
    pushes = _pushes(Tripod(radius=0.038, friction=0.25), CAMERA.standard_deviations)
    fit = _fit(pushes)
    residuals = np.concatenate([fit.residuals(one) for one in pushes])
    size = np.sqrt(np.mean(residuals**2, axis=0)) / CAMERA.standard_deviations
    assert size.max() > 1.5  # more than the camera's noise alone explains
    assert fit.misfit.reason == ""
    assert fit.misfit.ratio == pytest.approx(1.0, abs=0.25)
    assert fit.identified == ("mu_pusher", "tripod_radius")
    for name, truth in TRUTH.items():
        assert fit.estimates[name].low <= truth <= fit.estimates[name].high


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_without_known_noise_a_wrong_model_identifies_nothing_that_is_false(noise):
    points = np.array([[-0.045, -0.045], [0.045, 0.045], [0.01, -0.02], [0.02, -0.03]])
    support = fixel.SupportPoints(points=points, friction=0.25)
    fit = _fit(_pushes(support, noise * CAMERA.standard_deviations, smooth=7))
    assert fit.warnings[0].startswith("noise unknown")
    assert np.isnan(fit.misfit.ratio)
    assert fit.estimates["tripod_radius"].verdict != "identified"  # there is no tripod
    pusher = fit.estimates["mu_pusher"]
    low = 0.0 if pusher.low is None else pusher.low
    high = 1.0 if pusher.high is None else pusher.high
    assert low <= 0.25 <= high


def test_a_planned_start_has_no_noise_and_a_stored_target_remembers_which_it_has(tmp_path):
    measured = targets_of(_pushes(Tripod(radius=0.038, friction=0.25), 1e-4, n=1))[0]
    assert measured.starts_measured
    moved = example_pushes(1)[0]
    later = moved.trajectory.pose + 1e-4
    planned = targets_of([replace(moved, trajectory=replace(moved.trajectory, pose=later))])[0]
    assert not planned.starts_measured
    turned = moved.trajectory.pose + np.array([0.0, 0.0, 2.0 * np.pi])
    (again,) = targets_of([replace(moved, trajectory=replace(moved.trajectory, pose=turned))])
    assert again.starts_measured  # a whole turn is the same pose
    for name, content in target_files([measured, planned]).items():
        (tmp_path / name).write_bytes(content)
    assert [one.starts_measured for one in read_targets(tmp_path)] == [True, False]
