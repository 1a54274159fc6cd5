"""Sequences of experiments: filters, samples, splits, and how they print themselves."""

import pickle
import time
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.datasets import Experiments, example
from fixel.model import Flag


@pytest.fixture(scope="module")
def pushes():
    return example()


def test_the_example_is_what_its_docstring_says(pushes):
    tracks = [push.trajectory for push in pushes]
    assert {len(track.time) for track in tracks} == {61}
    assert {push.conditions["surface"] for push in pushes} == {"abs", "plywood"}
    offsets = [push.conditions["contact_offset_m"] for push in pushes]
    assert min(offsets) < -0.02
    assert max(offsets) > 0.02
    # Scatter about a parabola through neighbouring poses: 0.2 mm and 0.15 degrees.
    second = np.concatenate([np.diff(track.pose[30:], 2, axis=0) for track in tracks])
    scatter = second.std(axis=0) / np.sqrt(6.0)
    assert scatter == pytest.approx([2e-4, 2e-4, np.radians(0.15)], rel=0.15)


def test_a_filter_selects_like_a_loop(pushes):
    found = pushes.where("surface=plywood moved>50", "turned<0")
    by_hand = [
        push.key
        for push in pushes
        if push.conditions["surface"] == "plywood"
        and np.hypot(*(push.trajectory.pose[-1] - push.trajectory.pose[0])[:2]) > 0.05
        and push.trajectory.pose[-1, 2] < push.trajectory.pose[0, 2]
    ]
    assert list(found.keys) == by_hand
    assert 0 < len(by_hand) < 20
    assert pushes.where("simulated example/0").keys == pushes.keys[:10]
    assert len(pushes.where("real")) == 0


def test_an_experiment_is_found_by_its_name(pushes):
    assert pushes["07"] == pushes["example/07"] == pushes[7]
    refused(lambda: pushes["exmple/07"], match="did you mean 'example/07'")
    others = Experiments.of([*pushes, replace(pushes[7], dataset="other")])
    assert others["other/07"].dataset == "other"
    refused(lambda: others["07"], match="must be one of example/07, other/07$")


@pytest.mark.parametrize(("text", "complaint"), [
    ("surfce=abs", "did you mean 'surface'"),
    ("surface=plywod", "did you mean 'plywood'"),
    ("error>5", "errors of simulations; use fixel.compare"),
    ("moved>far", "must be a number"),
])  # fmt: skip
def test_filters_that_cannot_be_met_are_refused(pushes, text, complaint):
    refused(pushes.where, text, match=complaint)


def test_samples_and_splits_repeat_and_partition(pushes):
    sample = pushes.sample(7, seed=3)
    assert sample.keys == pushes.sample(7, seed=3).keys != pushes.sample(7, seed=4).keys
    assert list(sample.keys) == sorted(sample.keys)
    for test, n in ((10, 10), (0.25, 10), (0.001, 1)):
        train, held_out = pushes.split(test, seed=2)
        assert (len(train), len(held_out)) == (40 - n, n)
        assert sorted((*train.keys, *held_out.keys)) == list(pushes.keys)
    train, held_out = pushes.split(1, by="surface")
    assert len({push.conditions["surface"] for push in held_out}) == 1
    assert len(train) == len(held_out) == 20
    for wrong in (0, 40, 1.0, True):
        refused(pushes.split, wrong, match="test is")
    refused(pushes.sample, 41, match="n is 41")


def test_groups(pushes):
    groups = pushes.groupby("surface")
    assert {surface: len(own) for surface, own in groups.items()} == {"abs": 20, "plywood": 20}
    refused(pushes.groupby, "surfaces", match="did you mean 'surface'")


def test_slices_and_single_experiments(pushes):
    assert pushes[-1].key == "example/39"
    assert pushes[2:4].keys == ("example/02", "example/03")
    assert Experiments.of(pushes[0]).keys == ("example/00",)
    assert Experiments.of(pushes) is pushes
    refused(Experiments.of, [pushes[0], "example/01"], match=r"experiments\[1\]")


def test_nothing_is_modified(pushes):
    before = pickle.dumps(pushes)
    pushes.where("turned>20").sample(2).with_scene(lambda conditions: pushes[0].scene)
    assert pickle.dumps(pushes) == before


def test_thousands_print_within_the_limits(pushes):
    many = Experiments.of([replace(pushes[k % 40], name=f"{k}") for k in range(5000)])
    repr(many[:1]), many[:1]._repr_html_()  # so that nothing is imported below
    begun = time.process_time()
    text, page = repr(many), many._repr_html_()
    assert time.process_time() - begun < 0.5  # a twentieth on a free core
    lines = text.splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 100
    assert len(page.encode()) <= 50_000
    assert "<script" not in page
    assert lines[0].startswith("Experiments: 5000 of dataset 'example' (simulated)")


def test_an_experiment_prints_what_matters(pushes):
    push = pushes[0].flagged(Flag("late", "by 0.2 s"))
    lines = repr(push).splitlines()
    assert lines[0] == "Experiment example/00, simulated by fixel: 61 frames, 3.00 s"
    assert any("surface=abs" in line for line in lines)
    assert lines[-1].strip() == "late: by 0.2 s"
    assert max(map(len, lines)) <= 100
    page = push._repr_html_()
    assert "<svg" in page
    assert len(page) < 50_000
    assert "no scene: it can be drawn, but not simulated" in repr(replace(push, scene=None))


def test_tables_have_si_units_and_conditions(pushes):
    table = pushes.to_arrow()
    assert table.num_rows == 40
    assert table.schema.field("moved").metadata == {b"unit": b"m"}
    assert table.column("surface").to_pylist()[:2] == ["abs", "plywood"]
    poses = pushes[0].to_dict()
    assert poses["time"][-1] == 3.0
    assert poses["x"] == pushes[0].trajectory.pose[:, 0].tolist()


def test_an_experiment_is_simulated_with_other_values(pushes):
    slow, like_the_scene = pushes[0].simulate({"mu_pusher": 0.0}), pushes[0].simulate()
    assert like_the_scene.converged
    assert not np.allclose(slow.pose["part"][-1], like_the_scene.pose["part"][-1], atol=1e-4)
    refused(replace(pushes[0], scene=None).simulate, match="no scene")


def test_plots_return_axes_and_change_no_settings(pushes):
    import matplotlib as mpl
    from matplotlib import pyplot

    before = dict(mpl.rcParams)
    _, ax = pyplot.subplots()
    assert pushes.plot(ax=ax) is ax
    assert pushes[0].plot("path", ax=ax) is ax
    assert len(pushes[0].plot()) == 4
    assert pushes[:2].plot().get_xlabel() == "x [mm]"
    assert dict(mpl.rcParams) == before
    refused(pushes.plot, "tracks", match="kind is 'tracks'")
    pyplot.close("all")


def test_a_share_may_be_a_number_of_numpy(pushes):
    assert [len(part) for part in pushes.split(np.float32(0.25))] == [
        len(part) for part in pushes.split(0.25)
    ]
