"""Experiments refuse what would mislead later, and compare by content."""

import json
import math
from fractions import Fraction

import numpy as np
import pytest
from tests.fixtures import bare_experiment, refused

from fixel.errors import InvalidInput
from fixel.model import Channel, Flag, PlannedExperiment, Trajectory
from fixel.model.experiment import unit_of
from fixel.testing.scenes import grasp

PATH = Trajectory(time=[0.0, 0.5, 1.0], pose=[[0, 0, 0], [1e-3, 0, 0], [2e-3, 0, 0.1]])


def experiment(**more):
    return bare_experiment(**({"dataset": "lab", "name": "1", "trajectory": PATH} | more))


def test_equal_by_content_and_hashable():
    a, b = experiment(conditions={"b": 1.0, "a": "x"}), experiment(conditions={"a": "x", "b": 1.0})
    assert a == b
    assert hash(a) == hash(b)
    assert a != experiment(conditions={"a": "y", "b": 1.0})
    assert a.key == "lab/1"
    assert a.duration == 1.0


def test_a_condition_that_is_true_or_false_is_printed_as_such():
    assert "dry=False n=1 wet=True" in repr(
        experiment(conditions={"wet": True, "dry": False, "n": 1})
    )


def test_conditions_are_texts_and_numbers_that_can_be_stored():
    numbers = experiment(conditions={"n": np.int64(3), "x": np.float32(0.5), "s": "abs"}).conditions
    assert json.loads(json.dumps(dict(numbers))) == {"n": 3, "x": 0.5, "s": "abs"}
    for wrong in ([], {}, None, b"abs", 1j):
        refused(experiment, conditions={"a": wrong}, match="conditions 'a'.* a text or a number")
        plan = {"name": "1", "scene": grasp("seated"), "conditions": {"a": wrong}}
        refused(PlannedExperiment, **plan, match="conditions 'a'.* a text or a number")
    exact = experiment(conditions={"third": Fraction(1, 3), "wide": np.longdouble(0.5)}).conditions
    assert json.loads(json.dumps(dict(exact))) == {"third": 1 / 3, "wide": 0.5}
    for wrong in (float("nan"), np.float32("inf"), 10**400, np.timedelta64(5, "s")):
        refused(experiment, conditions={"a": wrong}, match="conditions 'a'.* a finite number")
    refused(experiment, conditions={1: 2.0}, match="a name of printable characters")
    refused(experiment, conditions=[("a", 1)], match="values by name")


def test_simulated_for_ever():
    refused(experiment, real=False, match="the simulator")
    refused(experiment, simulated_by="a testbed", match="empty for a real experiment")
    assert not experiment(real=False, simulated_by="a testbed").real


def test_flags_are_sorted_and_named_plainly():
    more = experiment().flagged(Flag("late"), Flag("early", "by 2 s"))
    assert [flag.name for flag in more.flags] == ["early", "late"]
    refused(Flag, "Mis registered", match="a-z, 0-9, -")


@pytest.mark.parametrize(
    ("column", "unit"),
    [("fx_n", "N"), ("v_m_s", "m/s"), ("t_s", "s"), ("tau_nm", "N m"), ("fixel_1_bool", "-")],
)
def test_columns_carry_units(column, unit):
    assert unit_of(column) == unit


@pytest.mark.parametrize("column", ["fx", "n", "force_mm", "_n_"])
def test_columns_without_units_are_refused(column):
    refused(unit_of, column, match="with its unit as suffix")


def test_channels_check_their_arrays():
    force = Channel(name="force", time=[0, 0.1], columns=("fx_n",), values=[[1.0], [math.nan]])
    assert np.isnan(force.values[1, 0])
    assert experiment(channels=[force]).channel("force") is force
    assert experiment().channel("force") is None
    with pytest.raises(InvalidInput, match="a row of 2 values"):
        Channel(name="force", time=[0.0], columns=("fx_n", "fy_n"), values=[[1.0]])
    with pytest.raises(InvalidInput, match="decreasing times"):
        Channel(name="force", time=[1.0, 0.0], columns=("fx_n",), values=[[1.0], [1.0]])
    with pytest.raises(InvalidInput, match="infinite"):
        Channel(name="force", time=[1.0], columns=("fx_n",), values=[[math.inf]])


def test_readings_with_times_of_a_clock_are_refused_and_masked_ones_are_none():
    clock = np.array([0, 500], "timedelta64[ms]")
    given = {"name": "force", "time": [0.0, 0.5], "columns": "fx_n", "values": [[1.0], [2.0]]}
    assert Channel(**given).columns == ("fx_n",)
    for wrong in (clock, np.datetime64("2026-01-01", "ns") + clock, ["0", "1"], [0j, 1j]):
        refused(Channel, **given | {"time": wrong}, match="channel 'force'.time")
        refused(Channel, **given | {"values": np.array(wrong)[:, None]}, match="numbers, or NaN")
    refused(Channel, **given | {"columns": [1]}, match="channel.columns")
    refused(Channel, **given | {"time": np.ma.masked_greater([0.0, 0.5], 0.2)}, match="masked")
    lost = np.ma.masked_array([[1.0], [2.0]], mask=[[False], [True]])
    for values in (lost, [[1.0], [None]], [[True], [np.nan]]):
        found = Channel(**given | {"values": values}).values
        np.testing.assert_array_equal(found, [[1.0], [np.nan]])
    touch = Channel.of_fixels([0.0, 0.5], np.ma.masked_array([[1, 1], [1, 0]], [[0, 1], [0, 0]]))
    np.testing.assert_array_equal(touch.values, [[1.0, np.nan], [1.0, 0.0]])
    refused(Channel.of_fixels, [0.0, 0.5], [1, 0], match="a row of 2 values")


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("pusher", np.zeros((2, 3))), ("provenance", {"version": "1"}), ("real", "no"), ("real", None),
     ("object_name", None), ("video", 1), ("contact_mode", 10), ("contact_mode", None),
     ("flags", ["late"]), ("channels", {"force": 1}), ("effective", 1.0), ("effective", (0, 1, 2)),
     ("effective", (None, 1.0)), ("effective", np.array([0, 1], "timedelta64[s]"))],
)  # fmt: skip
def test_parts_of_another_type_are_refused_by_their_name(name, wrong):
    place = f"experiment lab/1.{name}"
    assert refused(experiment, **{name: wrong}).where.partition("[")[0] == place


def test_truth_values_of_numpy_and_one_flag_are_read():
    found = experiment(real=np.bool_(True), flags=Flag("late"))
    assert found.real is True
    assert found.flags == (Flag("late"),)


def test_scene_and_contact_mode_agree():
    scene = grasp("seated")
    good = experiment(scene=scene, object_name=scene.bodies[0].name, contact_mode="010")
    assert good.contact_mode == "010"
    with pytest.raises(InvalidInput, match="one per fixel"):
        experiment(scene=scene, object_name=scene.bodies[0].name, contact_mode="01")
    refused(experiment, scene=scene, object_name="nothing", match="a body of the scene")
    refused(experiment, contact_mode="2", match="0 or 1")


def test_heights_and_times_are_checked():
    refused(experiment, height=-0.04, match="height")
    refused(experiment, effective=(1.0, 0.5), match="increasing order")
