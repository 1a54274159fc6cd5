"""The plan of equal pushes over a table."""

import math
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.formats.plan_file import load_plan, plan_text
from fixel.sampling import table_plan, thesis_plan


def seen_from_the_part(experiment):
    """Tip and its direction as complex numbers in the frame of the part."""
    body, tip = experiment.scene.bodies[0], experiment.scene.pushers[0]
    back = complex(math.cos(body.pose[2]), -math.sin(body.pose[2]))
    return (
        back * complex(*(tip.pose[:2] - body.pose[:2])),
        back * complex(*tip.drive.direction),
    )


def test_all_pushes_are_equal_in_the_frame_of_the_part():
    plan = table_plan()
    pushes = np.array([seen_from_the_part(own) for own in plan.experiments])

    assert plan.total == len(plan.experiments) == 54
    assert np.abs(pushes - pushes[0]).max() < 1e-12
    assert pushes[0] == pytest.approx([-60.15e-3 - 25e-3j, 1.0], abs=1e-9)
    assert plan.check() == ()


def test_every_spot_has_two_runs_that_do_not_follow_one_another():
    poses = [tuple(own.scene.bodies[0].pose.round(9)) for own in table_plan().experiments]
    spots = Counter(poses)

    assert len(spots) == 27
    assert set(spots.values()) == {2}
    assert len({pose[:2] for pose in poses}) == 9
    assert sum(a == b for a, b in pairwise(poses)) < 4
    # A drift in time must not look like a place.
    x = np.array([pose[0] for pose in poses])
    assert abs(np.corrcoef(x, np.arange(len(x)))[0, 1]) < 0.3


def test_places_have_conditions_and_survive_a_file(tmp_path):
    plan = table_plan()
    first = plan.experiments[0].conditions

    (tmp_path / "plan.yaml").write_text(plan_text(plan))
    assert load_plan(tmp_path / "plan.yaml") == plan
    assert [first[f"place_{name}"] for name in ("x_m", "y_m", "theta_rad")] == [*plan.places[0]]
    assert "places" not in plan_text(thesis_plan())
    assert not any(name.startswith("place_") for name in thesis_plan().experiments[0].conditions)


def test_problems_of_a_plan_do_not_depend_on_the_place():
    plan = replace(table_plan(), places=((0.1, 0.2, 1.0),), schemes=thesis_plan().schemes)
    there = replace(plan, places=((0.0, 0.0, 0.0),))

    assert [p.sentence for p in plan.check()] == [p.sentence for p in there.check()] != []
    moved = replace(thesis_plan(), places=((0.1, 0.2, 1.0),)).experiments[7].scene
    plain = thesis_plan().experiments[7].scene
    for a, b in zip(moved.fixels, plain.fixels, strict=True):
        x, y, _ = b.pose
        z = 0.1 + 0.2j + complex(math.cos(1.0), math.sin(1.0)) * complex(x, y)
        assert complex(*a.pose[:2]) == pytest.approx(z, abs=1e-12)


def test_a_plan_needs_a_place():
    with pytest.raises(InvalidInput, match="places: found none"):
        replace(table_plan(), places=())
