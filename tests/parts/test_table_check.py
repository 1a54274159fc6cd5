"""The check of a table finds components of variance that were put in, and no others."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from tests.equal_pushes import over_a_table
from tests.fixtures import refused

from fixel import InvalidInput, SimulatedTestbed, part_model, table_check, table_map
from fixel.datasets import plan_import
from fixel.sampling import table_plan
from fixel.testing.pushes import example_parts

NOISE = (0.6e-3, math.radians(0.9))


def contains(effect, position, angle):
    return (
        effect.position[1] <= position <= effect.position[2]
        and effect.angle[1] <= angle <= effect.angle[2]
    )


@pytest.mark.parametrize("seed", range(2))
def test_known_components_are_found(seed):
    """Bounds: four standard errors of the numbers of spots and orientations."""
    place, orientation = (1.5e-3, math.radians(2.0)), (3e-3, math.radians(4.0))
    pushes = over_a_table(
        seed, different=24, places=4, noise=NOISE, place=place, orientation=orientation
    )
    check = table_check(pushes)

    for name, size, bound in (
        ("noise", NOISE, 0.15),
        ("place", place, 0.2),
        ("orientation", orientation, 0.35),
    ):
        assert check[name].position[0] == pytest.approx(size[0], rel=bound)
        assert check[name].angle[0] == pytest.approx(size[1], rel=bound)
        assert check[name].is_found
    assert not check["tilt"].is_found
    assert check.verdict == "not good enough"


@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_is_nothing_else(seed):
    check = table_check(over_a_table(seed, noise=NOISE))
    assert [own.name for own in check.effects if own.is_found] == ["noise"]
    assert contains(check["noise"], *NOISE)
    assert check.verdict == "good enough"
    assert math.isnan(check["drift"].position[0])


def test_shares_are_those_of_normal_errors():
    """Within the tolerance: a distance by Rayleigh's distribution, and an angle by erf."""
    place = (1.2e-3, math.radians(1.5))
    position, angle = 1.5e-3, math.radians(2.5)
    pushes = over_a_table(3, different=40, places=8, turns=(0.0,), noise=NOISE, place=place)
    check = table_check(pushes, position=position, angle=angle)

    for name, size in (("noise", NOISE), ("place", np.hypot(NOISE, place))):
        near = 1.0 - math.exp(-((position / size[0]) ** 2))
        assert check[name].within[0] == pytest.approx(
            near * math.erf(angle / size[1] / math.sqrt(2.0)), abs=0.06
        )
    assert check.loss[0] == check["noise"].within[0] - check["place"].within[0]


def test_a_tilt_has_its_size_and_direction():
    tilt = 1.5e-3 * np.array([math.cos(0.7), math.sin(0.7)])
    check = table_check(over_a_table(4, noise=NOISE, tilt=tilt))
    low, high = check["tilt"].position[1:]
    assert low < 1.5e-3 < high < 2e-3
    (note,) = (own for own in check.notes if "drift towards" in own)
    assert abs(float(note.split()[3]) - math.degrees(0.7)) < 12.0


def test_sessions_that_differ_show_drift():
    """Two sessions that differ by d have the standard deviation d / sqrt(2)."""
    pushes = over_a_table(5, noise=NOISE, sessions=("monday", "tuesday"), drift=2e-3)
    check = table_check(pushes)
    assert check.session == "session"
    assert check["drift"].position[0] == pytest.approx(2e-3 / math.sqrt(2.0), rel=0.1)
    assert check["noise"].position[0] == pytest.approx(NOISE[0], rel=0.2)
    assert check["place"].position[0] < 0.3e-3
    still = table_check(over_a_table(5, noise=NOISE, sessions=("monday", "tuesday")))
    assert not still["drift"].is_found


def test_the_plan_of_a_table_shows_whether_the_simulated_table_is_uneven():
    planned = table_plan().experiments
    flat = table_check(SimulatedTestbed(plate_roughness=0.0).run(planned))
    uneven = table_check(SimulatedTestbed(plate_roughness=0.0, uneven_table=1.5).run(planned))
    assert [own.name for own in flat.effects if own.is_found] == ["noise"]
    assert flat.verdict == "good enough"
    assert uneven["place"].position[1] > 0.5e-3
    assert uneven["noise"].position[0] == pytest.approx(flat["noise"].position[0], rel=0.2)
    assert uneven.loss[0] > flat.loss[0]
    assert not uneven.real


def test_the_order_of_pushes_and_their_places_in_the_world_do_not_matter():
    pushes = over_a_table(6, noise=NOISE, place=(1e-3, 0.02))
    one, other = table_check(pushes), table_check(pushes[::-1])
    assert [own.position[0] for own in one.effects[:4]] == pytest.approx(
        [own.position[0] for own in other.effects[:4]], abs=1e-9
    )


def test_pushes_without_repeats_are_refused_with_the_command_that_plans_them():
    with pytest.raises(InvalidInput, match="fixel sample --table") as problem:
        table_check(over_a_table(noise=NOISE, repeats=1))
    assert "\n" not in str(problem.value)
    with pytest.raises(InvalidInput, match="0 elsewhere"):
        table_check(over_a_table(noise=NOISE, places=1, turns=(0.0,), repeats=5))
    with pytest.raises(InvalidInput, match="0 pairs of equal pushes at one spot, 0 elsewhere"):
        table_check(example_parts(2, 3))
    refused(table_check, [], match="experiments: found none")
    for learn in (table_check, table_map, part_model):
        refused(learn, 3, match="experiments: found the type int")
        refused(learn, [3], match=r"experiments\[0\]: found the type int")


def test_a_condition_with_many_values_names_no_sessions():
    pushes = over_a_table(noise=NOISE)
    speeds = [
        replace(own, conditions={**own.conditions, "speed": k}) for k, own in enumerate(pushes)
    ]
    one, other = table_check(pushes), table_check(speeds)
    assert other.session == ""
    assert other["noise"] == one["noise"]


def test_several_tables_are_refused():
    pushes = over_a_table(noise=NOISE)
    others = [
        replace(own, name=f"{own.name}-steel", conditions={**own.conditions, "surface": "steel"})
        for own in pushes
    ]
    refused(table_check, [*pushes, *others], match=r"'board' and 'steel'.*where=surface=steel")


@pytest.mark.parametrize("name", ["part", "surface", "session"])
def test_conditions_that_no_experiment_has_are_refused(name):
    """A misspelled surface would count pushes on several tables as pushes on one."""
    pushes = over_a_table(noise=NOISE)
    refused(table_check, pushes, match=f"^{name} is 'nonsense', but must be", **{name: "nonsense"})


def test_repeats_of_the_mit_dataset(data_root):
    """Means of the differences of equal pushes on the board of ABS, from a separate study."""
    plan = plan_import(data_root / "mit_push_endpoints")
    repeated = re.compile(".*/abs_(rect1|ellip1|tri1)_v(10|20)_")
    check = table_check(plan.build(k) for k, name in enumerate(plan.names) if repeated.match(name))
    distance, turn, position, angle = check.pairs.T
    means = {
        "spot": (distance < 5e-3) & (turn < math.radians(5.0)),
        "20 to 40 mm": (distance > 20e-3) & (distance < 40e-3) & (turn < math.radians(10.0)),
        "farther": (distance > 40e-3) & (turn < math.radians(10.0)),
        "turned": (distance > 40e-3) & (turn > math.radians(90.0)),
    }
    found = {
        name: (1e3 * position[own].mean(), math.degrees(angle[own].mean()))
        for name, own in means.items()
    }

    assert found["spot"] == pytest.approx((0.85, 1.21), abs=0.01)
    assert found["20 to 40 mm"][0] == pytest.approx(1.4, abs=0.1)
    assert found["farther"][0] == pytest.approx(2.5, abs=0.1)
    assert found["turned"] == pytest.approx((4.1, 5.8), rel=0.06)
    assert check.session == "speed_m_s"
    assert check.verdict == "not good enough"
    assert not check["drift"].is_found
