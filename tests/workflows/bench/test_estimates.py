"""Live estimates, against calibrations of other experiments and against later experiments."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel.calibration.objective import Comparer
from fixel.errors import InvalidInput
from fixel.model import Disk, LineDrive, PlannedExperiment, Pusher
from fixel.parts.next_pushes import push_candidates
from fixel.sampling.published import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.pushes import TRUTH, example_pushes
from fixel.workflows.bench.estimates import Until, choose, estimate

SPACE = {"mu_pusher": (0, 1), "tripod_radius": (0.01, 0.06)}
WIDER = {
    "mu_pusher": (0, 1),
    "pressure_spread": (-2, 2),
    "friction_centre_x": (-0.005, 0.005),
    "friction_centre_y": (-0.005, 0.005),
}


@cache
def pushes():
    return tuple(example_pushes(8))


@cache
def right(n=4):
    """Estimates after n experiments, from those after one less; the first are after two."""
    return estimate(pushes()[:n], SPACE, previous=right(n - 1) if n > 2 else None, threads=1)


@cache
def rows():
    square = thesis_plan().experiments[0].scene.bodies[0]
    scenes = push_candidates(square, radius=4.75e-3, speed=13.5e-3, friction=0.2, contacts=8)
    return tuple(
        PlannedExperiment(name=f"row-{k:02d}", scene=scene) for k, scene in enumerate(scenes)
    )


@cache
def done():
    """A laboratory that differs from the model in every way that a testbed can."""
    return tuple(SimulatedTestbed(seed=3).run(rows()[:10], threads=1))


@cache
def imperfect():
    return estimate(done(), WIDER, threads=1)


def planned(experiments):
    return [PlannedExperiment(name=own.name, scene=own.scene) for own in experiments]


def test_intervals_of_a_right_model_are_those_of_profiles():
    found = right()
    fit = fixel.calibrate(pushes()[:4], SPACE, progress=False, threads=1)
    for label, truth in TRUTH.items():
        own, theirs = found.calibration.estimates[label], fit.estimates[label]
        assert own.low < truth < own.high
        assert own.verdict == theirs.verdict == "identified"
        assert own.high - own.low == pytest.approx(theirs.high - theirs.low, rel=0.3)
        assert found.half_widths[label] == pytest.approx(0.5 * (own.high - own.low), rel=1e-9)


def test_held_out_errors_are_those_of_calibrations_without_the_experiment():
    found, used = imperfect(), done()
    for k in (4, 9):
        others = [own for own in used if own is not used[k]]
        fit = fixel.calibrate(
            others, WIDER, optimiser="least-squares", verdicts=False, progress=False, threads=1
        )
        alone = fixel.calibrate(
            used[k : k + 1],
            {name: fit[name] for name in list(WIDER)[1:]} | {"mu_pusher": (0, 1)},
            start=dict(fit),
            max_evaluations=1,
            verdicts=False,
            progress=False,
            threads=1,
        )
        assert alone["mu_pusher"] == pytest.approx(fit["mu_pusher"])
        assert found.held_out[used[k].key] == pytest.approx(alone.rms_error, rel=0.35)
    assert found.held_out_error > found.calibration.rms_error


def test_one_experiment_is_not_predicted_from_others():
    one = replace(imperfect(), held_out={"first": 0.001})
    assert one.held_out_error is None


def test_one_more_experiment_gives_the_same_from_the_previous_estimates():
    alone = estimate(pushes()[:4], SPACE, threads=1)
    for label, own in alone.half_widths.items():
        assert alone.calibration[label] == pytest.approx(right().calibration[label], rel=2e-3)
        assert own == pytest.approx(right().half_widths[label], rel=0.1)


def test_estimates_leave_the_wrong_valley_of_previous_ones():
    """Live estimates end in the valley of the best value of a dense grid."""
    bench = SimulatedTestbed(seed=4, pusher_friction=2.0, fixel_friction=1.2, support_friction=1.2)
    done, space = tuple(bench.run(thesis_plan().experiments[:2], threads=1)), {"mu_pusher": (0, 1)}
    options = {"motion": "quasistatic", "threads": 1}
    wrong = fixel.calibrate(
        done, space, start={"mu_pusher": 0.97}, optimiser="least-squares", max_evaluations=1,
        verdicts=False, progress=False, **options,
    )  # fmt: skip
    previous = replace(estimate(done, space, **options), calibration=wrong)
    found = estimate(done, space, previous=previous, **options).calibration
    comparer = Comparer(found.targets, found.space, motion=found.motion, threads=1)
    grid = np.linspace(0.0, 1.0, 51)
    errors = [np.mean(comparer.errors_at(np.array([value]))) for value in grid]
    assert wrong["mu_pusher"] == pytest.approx(0.97)
    assert found["mu_pusher"] == pytest.approx(grid[np.argmin(errors)], abs=0.03)
    assert np.mean(found.found.errors) < 1.05 * min(errors)


def test_expected_widths_are_those_that_the_experiments_give():
    expected = right(3).ahead(planned(pushes()[3:]), 5)
    for label, own in estimate(pushes(), SPACE, threads=1).half_widths.items():
        assert own < right(3).half_widths[label]
        assert expected[label] == pytest.approx(own, rel=0.3)


def test_intervals_of_a_wrong_model_hold_the_truth():
    found = imperfect()
    truth = 0.2 * np.mean([own.conditions["truth_pusher_friction_ratio"] for own in done()])
    own = found.calibration.estimates["mu_pusher"]
    assert own.low < truth < own.high
    assert found.calibration.misfit.ratio > 3.0
    assert own.noise_high - own.noise_low < 0.5 * (own.high - own.low)


def test_a_push_that_slides_is_chosen_to_learn_friction():
    """A tip that meets the part head on sticks: every friction gives the same motion."""
    body = pushes()[0].scene.bodies[0]
    centred, aside = (
        replace(
            pushes()[0].scene,
            bodies=(replace(body, pose=np.zeros(3)),),
            pushers=(
                Pusher(
                    "finger",
                    Disk(0.005),
                    pose=(-0.0551, y, 0.0),
                    drive=LineDrive(direction=way, speed=0.03),
                    friction=0.4,
                ),
            ),
        )
        for y, way in ((0.0, (1.0, 0.0)), (0.01, (np.cos(0.6), -np.sin(0.6))))
    )
    one, two = (PlannedExperiment(name=name, scene=own)
                for name, own in (("centred", centred), ("aside", aside)))  # fmt: skip
    wanted = {"mu_pusher": 1e-4}
    found = choose(right(), [one, two, one], wanted)
    assert found.index == 1
    assert found.half_widths["mu_pusher"] < 0.95 * right().half_widths["mu_pusher"]
    assert "mu_pusher" in found.reason
    none = choose(right(), [one, one], wanted)
    assert none.index is None
    assert "hardly narrow mu_pusher" in none.reason


def test_nothing_is_chosen_where_nothing_is_wanted_or_left():
    met = choose(right(), planned(pushes()[4:]), {"mu_pusher": 0.5})
    assert met.index is None
    assert "as narrow as wanted" in met.reason
    assert choose(right(), [], {"mu_pusher": 1e-4}).index is None


def test_the_widest_interval_is_narrowed_first():
    candidates = planned(pushes()[4:])
    half = right().half_widths
    for label, other in (("mu_pusher", "tripod_radius"), ("tripod_radius", "mu_pusher")):
        wanted = {label: half[label] / 5.0, other: half[other] / 2.0}
        assert f"narrows {label}" in choose(right(), candidates, wanted).reason


def test_a_push_that_misses_informs_nothing_and_any_other_is_chosen():
    tip = rows()[0].scene.pushers[0]
    aside = replace(rows()[0].scene, pushers=(replace(tip, pose=np.array([1.0, 1.0, 0.0])),))
    miss = PlannedExperiment(name="miss", scene=aside)
    found = estimate(SimulatedTestbed(seed=3).run([miss], threads=1), WIDER, threads=1)
    assert found.calibration.verdicts["mu_pusher"] == "not excited"
    for label, (low, high) in WIDER.items():
        assert found.half_widths[label] > 0.9 * (high - low)
    assert choose(found, [miss, rows()[1], miss], {"mu_pusher": 0.02}).index == 1


def test_a_repetition_does_not_remove_an_error_of_the_model():
    again, new = replace(rows()[0], name="again"), rows()[13]
    information = imperfect().informed_by([again, new, replace(new, name="new")])
    size = [float(np.trace(own)) for own in information]
    assert size[0] == size[2] == 0.0 < size[1]


@pytest.mark.parametrize(("text", "wanted"), [
    ("mu_pusher=0.02", {"mu_pusher": 0.02}),
    ("mu_pusher=2e-2, tripod_radius=1.5mm", {"mu_pusher": 0.02, "tripod_radius": 0.0015}),
    ("friction_centre_x=500 um", {"friction_centre_x": 5e-4}),
    ("registration_theta=1deg", {"registration_theta": np.pi / 180}),
    ("mu_pusher[surface=abs]=.1", {"mu_pusher[surface=abs]": 0.1}),
])  # fmt: skip
def test_wanted_widths_are_read(text, wanted):
    assert Until.parse(text).wanted == pytest.approx(wanted)


@pytest.mark.parametrize("text", [
    "", "mu_pusher", "mu_pusher=", "mu_pusher=0", "mu_pusher=-1", "mu_pusher=1mm",
    "mu_pusher=1.2.3", "tripod_radius=1deg", "tripod_radius=nan", "friction=0.1",
    "mu_pusher=0.02;tripod_radius=1mm", "mu_pusher=1e999", "=0.1", "mu_pushr=0.02",
    "mu_pusher[surface=0.1", "mu_pusher=0.1,mu_pusher=0.2",
])  # fmt: skip
def test_wanted_widths_that_mean_nothing_are_refused_at_their_option(text):
    assert refused(Until.parse, text).where == "until"


def test_a_campaign_ends_when_all_are_as_narrow_as_wanted():
    half = right().half_widths
    wide = {label: 1.01 * own for label, own in half.items()}
    assert not Until(wide).met(right())  # a single narrow interval may be so by chance
    assert Until(wide).met(replace(right(), settled=half))
    narrow = wide | {"mu_pusher": 0.99 * half["mu_pusher"]}
    assert not Until(narrow).met(replace(right(), settled=half))
    before = right(3).half_widths
    assert right().settled == {label: max(own, before[label]) for label, own in half.items()}
    assert "mu_pusher ±" in Until(wide).words(right())
    with pytest.raises(InvalidInput, match="mu_fixel"):
        Until({"mu_fixel": 0.1}).met(right())
