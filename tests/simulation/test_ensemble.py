"""Many scenes, many parameters, one call: the same as one by one, whatever else is in the call."""

from dataclasses import replace

import numpy as np
import pytest

from fixel import InvalidInput, Parameters, QuasiStatic, SupportPoints, simulate
from fixel.kernels import codes
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.rollouts import INFEASIBLE, RolloutCase
from fixel.testing.scenes import grasp, heap, micro_push

TIMES = np.linspace(0.5, 5.0, 10)


def _cases():
    scene = grasp()
    body = scene.bodies[0]
    turned = replace(
        scene, bodies=(replace(body, pose=body.pose + np.array([0.004, 0.002, 0.05])),)
    )
    fewer = replace(scene, fixels=scene.fixels[:1])
    return [
        RolloutCase(scene, TIMES),
        RolloutCase(turned, TIMES[:7]),
        RolloutCase(fewer, TIMES),
        RolloutCase(micro_push(3), TIMES[:3] / 6),
    ]


def _values(n, rng=0):
    draw = np.random.default_rng(rng)
    return {
        "mu_pusher": draw.uniform(0.1, 0.5, n),
        "mu_fixel": draw.uniform(0.1, 0.5, n),
        "registration_y": draw.uniform(-1e-3, 1e-3, n),
    }


def test_as_one_by_one():
    cases = _cases()[:3]
    which = np.array([0, 1, 2, 1, 0])
    values = _values(5)
    outcome = Ensemble(cases).simulate(which, values)
    assert outcome.converged.all()
    for r, k in enumerate(which):
        case = cases[k]
        alone = simulate(
            case.scene, Parameters({name: float(v[r]) for name, v in values.items()}),
            motion=QuasiStatic(), duration=float(case.times[-1]), output_interval=0.5,
        )  # fmt: skip
        pose = alone.pose[case.scene.bodies[0].name][1:]
        assert outcome.pose[r, : len(pose)] == pytest.approx(pose, abs=2e-4)
        assert (outcome.pose[r, len(pose) :] == outcome.pose[r, len(pose) - 1]).all()


def test_bits_depend_on_neither_company_order_nor_threads():
    cases = _cases()
    which = np.array([3, 0, 1, 2, 1, 0, 3])
    values = _values(7) | {"registration_y": np.zeros(7)}
    together = Ensemble(cases, threads=2).simulate(which, values)
    order = np.array([4, 2, 0, 6, 5, 1, 3])
    again = Ensemble(cases[::-1], threads=1).simulate(
        3 - which[order], {name: v[order] for name, v in values.items()}
    )
    assert (again.pose == together.pose[order]).all()
    alone = Ensemble([cases[1]]).simulate(
        np.zeros(1, int), {name: v[2:3] for name, v in values.items()}
    )
    assert (alone.pose[0] == together.pose[2, :7]).all()


def test_scenes_that_differ_in_start_and_path_share_a_template():
    assert len(Ensemble(_cases())._templates) == 3


def test_every_batch_is_laid_out_alike():
    # Another layout of an array would be compiled again, for half a minute.
    ensemble = Ensemble(_cases()[:2])
    values = _values(4) | {"anisotropy_xy": np.full(4, 0.1), "start_x": np.zeros(4)}
    for given in ({}, values):
        _, packed = ensemble._packed(np.arange(4), np.array([0, 1, 0, 1]), given, None)
        for part in packed:
            for array in (*part.batch, *part.batch.model):
                if isinstance(array, np.ndarray):
                    assert array.flags.writeable
                    assert array.flags.c_contiguous


def _on_net(turn):
    scene = grasp()
    net = SupportPoints(points=[(0.04, 0), (0, 0.04), (-0.04, 0), (0, -0.04)], friction=0.3)
    body = scene.bodies[0]
    body = replace(body, pose=body.pose + np.array([0.004, 0.002, turn]), support=net)
    return RolloutCase(replace(scene, bodies=(body,)), TIMES)


def test_cases_of_one_template_meet_the_table_at_their_own_angles():
    cases = [_on_net(0.0), _on_net(0.05)]
    which = np.array([1, 0, 1])
    values = {
        "table_bend_xy": np.array([1.2, 1.2, 0.0]),
        "table_slope_x": np.array([0.3, 0.3, 0.0]),
        "start_theta": np.array([0.0, 0.01, 0.0]),
    }
    ensemble = Ensemble(cases)
    assert len(ensemble._templates) == 1

    outcome = ensemble.simulate(which, values)

    for r, k in enumerate(which):
        alone = Ensemble([cases[k]]).simulate(
            np.zeros(1, int), {name: v[r : r + 1] for name, v in values.items()}
        )
        assert (alone.pose[0] == outcome.pose[r]).all()
    assert np.abs(outcome.pose[0, -1] - outcome.pose[2, -1]).max() > 1e-4
    _, packed = ensemble._packed(np.arange(3), which, values, None)
    assert all(
        a.flags.writeable and a.flags.c_contiguous
        for a in (*packed[0].batch, *packed[0].batch.model)
        if isinstance(a, np.ndarray)
    )


def _with_moved_fixels(scene, errors):
    fixels = zip(scene.fixels, errors, strict=True)
    return replace(scene, fixels=tuple(replace(f, pose=f.pose + e) for f, e in fixels))


def test_errors_of_the_fixels_as_scenes_with_moved_fixels():
    scene = grasp()
    square = replace(scene.fixels[1], shape=scene.pushers[0].shape)  # its angle matters
    scene = replace(scene, fixels=(scene.fixels[0], square, scene.fixels[2]))
    draw = np.random.default_rng(4)
    errors = draw.normal(size=(3, 3, 3)) * (2e-3, 2e-3, 0.2)
    times = np.array([6.0, 11.0])
    outcome = Ensemble([RolloutCase(scene, times)]).simulate(np.zeros(3, int), {}, errors)
    for r in range(3):
        moved = _with_moved_fixels(scene, errors[r])
        own = Ensemble([RolloutCase(moved, times)]).simulate(np.zeros(1, int), {})
        assert (own.pose[0] == outcome.pose[r]).all()
    assert np.ptp(outcome.pose[:, -1, 0]) > 5e-4

    alone = simulate(moved, motion=QuasiStatic())
    assert outcome.pose[2, -1] == pytest.approx(alone.final["object"], abs=2e-4)
    assert outcome.stalled[2] == alone.pushers["actuator"].stalled[-1]
    assert outcome.force[2] == pytest.approx(alone.pushers["actuator"].force[-1], rel=1e-3)


def test_cases_with_fewer_fixels_and_bits_with_their_errors():
    cases, which, values = _cases(), np.array([3, 0, 1, 2, 1, 0, 3]), _values(7)
    errors = np.random.default_rng(5).normal(size=(7, 3, 3)) * (1e-3, 1e-3, 0.1)
    together = Ensemble(cases, threads=2).simulate(which, values, errors)
    again = Ensemble(cases, threads=1).simulate(
        which[::-1], {m: v[::-1] for m, v in values.items()}, errors[::-1]
    )
    assert (again.pose[::-1] == together.pose).all()
    assert (again.force[::-1] == together.force).all()
    without = Ensemble(cases, threads=1).simulate(which, values)
    zero = Ensemble(cases, threads=1).simulate(which, values, 0.0 * errors)
    assert (zero.pose == without.pose).all()
    assert (together.pose[[0, 6]] == without.pose[[0, 6]]).all()  # no fixels


def test_a_seated_grasp_stalls_and_a_push_does_not():
    cases = [RolloutCase(grasp(), np.array([3.0, 11.0])), RolloutCase(grasp(), np.array([3.0]))]
    outcome = Ensemble(cases).simulate(np.array([0, 1]), {})
    assert outcome.stalled.tolist() == [True, False]
    assert outcome.force[0] == pytest.approx(34.3, rel=0.02)  # of the drive, all of it
    assert outcome.force[1] == pytest.approx(0.25 * 0.15 * 9.81, rel=0.3)  # friction of the plane


@pytest.mark.parametrize(
    "fixels", [np.zeros((1, 2, 3)), np.zeros((2, 3, 3)), np.full((1, 3, 3), np.nan)]
)
def test_errors_of_the_fixels_that_do_not_fit_are_refused(fixels):
    with pytest.raises(InvalidInput, match="fixels"):
        Ensemble([RolloutCase(grasp(), TIMES)]).simulate(np.zeros(1, int), {}, fixels)


def test_what_cannot_be_is_not_tried_and_says_why():
    points = SupportPoints(points=[(0.03, 0.0), (-0.02, 0.03), (-0.02, -0.03)], friction=0.3)
    scene = grasp()
    scene = replace(scene, bodies=(replace(scene.bodies[0], support=points),))
    outcome = Ensemble([RolloutCase(scene, TIMES)]).simulate(
        np.zeros(2, int), {"support_1_x": np.array([0.03, -0.03])}
    )
    assert outcome.status.tolist() == [codes.CONVERGED, INFEASIBLE]
    assert outcome.reasons[0] == ""
    assert "triangle" in outcome.reasons[1]
    assert np.isfinite(outcome.pose).all()


def test_a_pusher_that_parameters_put_into_the_body_pushes_it_out():
    """Tracker and robot do not quite agree: nothing is refused, and nothing flies away."""
    scene = grasp()
    touching = replace(scene.bodies[0], pose=(0.5 * (0.029 + 0.1075), 0.0, 0.0))
    scene = replace(scene, bodies=(touching,))
    values = {"start_x": np.array([0.0, -1e-3, -3e-3])}
    outcome = Ensemble([RolloutCase(scene, TIMES)]).simulate(np.zeros(3, int), values)
    assert outcome.converged.all()
    assert outcome.pose[1:, -1, 0] == pytest.approx(outcome.pose[0, -1, 0], abs=1e-3)


def test_a_simulation_that_stops_early_says_when():
    scene = grasp(force_limit=None)
    outcome = Ensemble([RolloutCase(scene, np.array([5.0, scene.duration]))]).simulate(
        np.zeros(1, int), {}
    )
    assert outcome.reasons[0].startswith("jammed at ")
    assert np.isfinite(outcome.pose).all()


def test_many_rollouts_run_in_several_passes(monkeypatch):
    whole = Ensemble(_cases()).simulate(np.arange(4).repeat(3), _values(12))
    monkeypatch.setattr("fixel.simulation.ensemble.MAX_POSES", 50)
    parts = Ensemble(_cases()).simulate(np.arange(4).repeat(3), _values(12))
    assert (whole.pose == parts.pose).all()
    assert (whole.status == parts.status).all()
    assert whole.reasons == parts.reasons


@pytest.mark.parametrize("threads", [1, 2])
def test_poses_passed_on_are_those_of_simulations(monkeypatch, threads):
    jammed = replace(grasp(force_limit=None), duration=12.0)
    cases = [*_cases(), RolloutCase(jammed, np.array([1.0, 5.0, 12.0]))]
    which = np.array([4, *np.arange(4).repeat(10), 1])
    values = _values(len(which))
    values["mu_pusher"][-1] = -0.1
    ensemble = Ensemble(cases, threads=threads)
    whole = ensemble.simulate(which, values)
    monkeypatch.setattr("fixel.simulation.ensemble.MAX_BARE_POSES", 200)
    monkeypatch.setattr("fixel.simulation.threads.MAX_RANGE", 4)
    found = np.full(whole.pose.shape, np.nan)

    def use(rollouts, pose):
        assert np.isnan(found[rollouts]).all()
        found[rollouts] = pose

    converged, reasons = ensemble.simulate_into(use, which, values)

    assert reasons == whole.reasons
    assert reasons[0].startswith("jammed")
    assert (converged == whole.converged).all()
    assert (found[:-1] == whole.pose[:-1]).all()
    assert np.isnan(found[-1]).all()  # infeasible


def test_poses_may_be_used_by_another_ensemble(monkeypatch):
    monkeypatch.setattr("fixel.simulation.threads.MAX_RANGE", 2)
    ensemble, other = Ensemble(_cases(), threads=2), Ensemble(_cases()[:1], threads=2)
    ends = []

    def use(rollouts, pose):
        ends.append(other.simulate(np.zeros(4, int), _values(4)).pose)

    assert ensemble.simulate_into(use, np.arange(4).repeat(3), _values(12))[0].all()
    assert (np.array(ends) == ends[0]).all()


def test_an_error_in_the_use_of_poses_is_raised(monkeypatch):
    monkeypatch.setattr("fixel.simulation.threads.MAX_RANGE", 2)

    def use(rollouts, pose):
        raise ValueError("no use")

    for threads in (1, 2):
        with pytest.raises(ValueError, match="no use"):
            Ensemble(_cases(), threads=threads).simulate_into(use, np.arange(4), _values(4))


@pytest.mark.parametrize(("cases", "where"), [
    ([], "cases"),
    ([RolloutCase(heap(4), TIMES)], "case.scene"),
    ([RolloutCase(grasp(), np.zeros(1))], "case.times"),
    ([RolloutCase(grasp(), np.zeros(0))], "case.times"),
])  # fmt: skip
def test_what_is_no_case_is_refused(cases, where):
    with pytest.raises(InvalidInput, match=where):
        Ensemble(cases)
