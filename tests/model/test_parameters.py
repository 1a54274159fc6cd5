"""Parameters: known names, sane values, an immutable mapping."""

import pickle

import pytest
from tests.fixtures import refused

from fixel.model import KNOWN_PARAMETERS, Parameters
from fixel.model.parameters import info_of


def test_parameters_are_an_immutable_mapping():
    made = Parameters({"mu_support": 0.25}, mu_fixel=0.2)
    assert dict(made) == {"mu_support": 0.25, "mu_fixel": 0.2}
    assert made == Parameters(mu_fixel=0.2, mu_support=0.25)
    assert hash(made) == hash(Parameters(mu_fixel=0.2, mu_support=0.25))
    assert made | {"mu_fixel": 0.3} == Parameters(mu_support=0.25, mu_fixel=0.3)
    assert pickle.loads(pickle.dumps(made)) == made
    assert repr(made) == "Parameters(mu_support=0.25, mu_fixel=0.2)"
    with pytest.raises(TypeError):
        made["mu_support"] = 1.0


def test_every_parameter_has_a_unit_and_a_meaning():
    assert {"mu_support", "mu_fixel", "mu_pusher", "tripod_radius"} <= set(KNOWN_PARAMETERS)
    assert all(info.unit and info.meaning for info in KNOWN_PARAMETERS.values())


def test_every_point_of_a_net_has_a_load_and_shifts_may_be_negative():
    assert "point 12" in info_of("load_12").meaning
    assert Parameters(load_12=0.5)["load_12"] == 0.5
    assert Parameters(registration_x=-1e-3)["registration_x"] == -1e-3


def test_an_unknown_name_is_refused_with_the_nearest_or_the_known_ones():
    refused(Parameters, mu_suport=0.2, match=r"'mu_suport'.*did you mean 'mu_support'")
    refused(Parameters, xyz=0.2, match=r"mu_pusher.*tripod_radius")


@pytest.mark.parametrize(("name", "value"), [
    *(("mu_fixel", value) for value in (-0.1, float("nan"), float("inf"), "0.2", True, None)),
    ("tripod_radius", 0.0),
    ("ellipsoid_force", 0.0),
    ("load_0", 0.5),
])  # fmt: skip
def test_a_value_that_cannot_be_is_refused(name, value):
    refused(Parameters, {name: value}, match=name)
