"""Goals against the contacts of simulations, and probabilities against SciPy's intervals."""

import numpy as np
import pytest
from scipy.stats import binomtest

from fixel.errors import InvalidInput
from fixel.model import Body, Disk, Fixel, NoSupport, Probability, Scene, Seated
from fixel.testing.scenes import row

FIXELS = (
    Fixel(name="left", shape=Disk(0.01), pose=row(0.0, 0.0, 0.0), friction=0.1),
    Fixel(name="low", shape=Disk(0.01), pose=row(0.03, -0.03, 0.0), friction=0.1),
)
PUCK = Body(name="puck", shape=Disk(0.02), mass=0.1, pose=row(0.1, 0.1, 0.0), support=NoSupport())
SCENE = Scene(bodies=(PUCK,), fixels=FIXELS, duration=1.0)


def test_a_disk_is_seated_where_distances_of_centres_say_so():
    poses = np.random.default_rng(0).uniform((0.0, -0.01, -3), (0.06, 0.01, 3), (500, 3))
    poses[:100, 0] = np.sqrt(0.03**2 - poses[:100, 1] ** 2)  # on the first fixel
    apart = [np.hypot(*(poses[:, :2] - fixel.pose[:2]).T) - 0.03 for fixel in FIXELS]
    touched = [gap < 1e-3 * 0.04 for gap in apart]
    ends = {"puck": poses}

    np.testing.assert_array_equal(Seated("left").met(SCENE, ends), touched[0])
    both = np.logical_and(*touched)
    np.testing.assert_array_equal(Seated("left", "low").met(SCENE, ends), both)
    assert touched[0].sum() >= 100


def test_one_end_pose_is_enough():
    assert Seated("left").met(SCENE, {"puck": row(0.03, 0.0, 0.0)}).shape == ()
    assert Seated("left", body="puck").met(SCENE, {"puck": row(0.03, 0.0, 0.0)})


def test_goals_refuse_what_does_not_fit():
    with pytest.raises(InvalidInput, match="names of fixels"):
        Seated()
    with pytest.raises(InvalidInput, match="one of left, low"):
        Seated("right").met(SCENE, {"puck": row(0, 0, 0)})
    with pytest.raises(InvalidInput, match=r"goal\.body"):
        Seated("left", body="object").met(SCENE, {"puck": row(0, 0, 0)})
    bare = Scene(bodies=(PUCK,), duration=1.0)
    with pytest.raises(InvalidInput, match="a scene with fixels"):
        Seated("left").met(bare, {"puck": row(0, 0, 0)})


def test_a_goal_has_a_plain_text():
    assert repr(Seated("a", "b", body="part")) == "Seated('a', 'b', body='part')"
    assert Seated("a") == Seated("a")


@pytest.mark.parametrize(("good", "n"), [(0, 7), (3, 7), (7, 7), (930, 1000)])
def test_the_interval_of_a_probability_is_exact(good, n):
    exact = binomtest(good, n).proportion_ci(0.9, "exact")
    own = Probability.of(good, n, level=0.9)
    assert (own.low, own.high) == pytest.approx((exact.low, exact.high), abs=1e-12)
    assert (own.value, own.n) == (good / n, n)


def test_probabilities_of_no_cases_are_refused():
    with pytest.raises(InvalidInput):
        Probability.of(0, 0)
    with pytest.raises(InvalidInput):
        Probability.of(1, 2, level=1.0)
