"""The real recordings, where they are: how many experiments, and what is known of them."""

import json
from collections import Counter

import numpy as np
import pytest

from fixel.datasets import importer_for
from fixel.model import support_points


def _imported(folder, name=None):
    if not folder.exists():
        pytest.skip(f"no recordings at {folder}")
    experiments = list(importer_for(folder, name).read(folder).experiments())
    assert len({experiment.key for experiment in experiments}) == len(experiments)
    assert all(experiment.real for experiment in experiments)
    return experiments


def _flags(experiments):
    return Counter(flag.name for experiment in experiments for flag in experiment.flags)


def test_twenty_trials(data_root):
    trials = _imported(data_root / "rpi_2dgad")

    assert len(trials) == 20
    (whole,) = (trial for trial in trials if trial.scene is not None)
    assert whole.name == "141"
    assert whole.contact_mode == "010"
    assert whole.fixel_height == pytest.approx(51.0794e-3)
    # The raw marker stops where the actuator stalls; the README gives 243.1 mm.
    assert whole.pusher.pose[-1, 1] == pytest.approx(0.2431, abs=5e-4)
    modes = {trial.name: trial.contact_mode for trial in trials}
    assert (modes["126"], modes["129"], modes["130"], modes["132"]) == ("111", "010", "000", "100")
    # Angles, and no heights of 45 mm.
    assert all(np.abs(trial.trajectory.pose[:, 2]).max() < 10.0 for trial in trials)


@pytest.mark.system
def test_all_pushes_of_the_end_point_set(data_root):
    pushes = _imported(data_root / "mit_push_endpoints")
    assert len(pushes) == 4835
    found = _flags(pushes)
    assert found["misregistered"] == 58
    assert found["no-scene"] == sum(push.scene is None for push in pushes) == 1
    assert found["pusher-moved-to-contact"] == 1336


def test_the_record_of_a_push(data_root):
    (push,) = _imported(data_root / "mit_timeseries" / "push_plywood_hex_v150.json", "mit-push")
    assert _imported(data_root / "mit_timeseries", "mit-push") == [push]
    record = data_root / "mit_timeseries" / "push_plywood_hex_v150.json"
    assert importer_for(record).name == "mit-push"

    assert push.scene is not None
    assert push.conditions["speed_m_s"] == pytest.approx(0.15)
    force = push.channel("force")
    # The impact of 5.7 N that the README gives is the y component; both together have 11.6 N.
    assert np.abs(force.values[:, 1]).max() == pytest.approx(5.7, abs=0.1)
    assert np.hypot(*force.values[:, :2].T).max() == pytest.approx(11.6, abs=0.1)


def test_five_runs(data_root):
    runs = _imported(data_root / "mit_timeseries")

    assert len(runs) == 5
    assert all(run.scene is not None for run in runs)
    assert not any(flag.fault for run in runs for flag in run.flags)
    # Rows in which the README's gap is below -3 mm, counted in the files.
    details = {run.name: flag.detail for run in runs for flag in run.flags if "left" in flag.detail}
    assert {name.split("_")[-1]: text.split(":")[0] for name, text in details.items()} == {
        "StraightLineNoPertubations": "left out 56 of 8117 rows (0.69 %)",
        "NoPerturbationsBlack": "left out 100 of 8428 rows (1.2 %)",
        "NoPerturbationsBlackDark": "left out 63 of 7686 rows (0.82 %)",
        "StraightLineNoPerturbationsPlywoodNoLighting": "left out 34 of 8609 rows (0.39 %)",
    }


@pytest.mark.system
def test_pushes_on_known_supports(data_root):
    pushes = _imported(data_root / "cmu_tripod_push")

    assert len(pushes) == 245
    assert all(push.scene is not None for push in pushes)
    assert _flags(pushes)["joined-sessions"] == 35
    setup = json.loads((data_root / "cmu_tripod_push" / "setup.json").read_text())
    for push in pushes[::35]:
        expected = setup["support_load_fraction"][push.conditions["support"]]
        body = push.scene.bodies[0]
        loads = support_points(body.support, body.shape, body.com, body.mass, 9.81)[1]
        if expected is not None:
            assert loads / loads.sum() == pytest.approx(expected, abs=1e-3)


def test_twenty_eight_runs_of_two_fingers(data_root):
    runs = _imported(data_root / "cmu_two_point_push")
    assert len(runs) == 28
    assert _flags(runs)["tracking-lost"] == 28
    # No pose of a lost object, which the file has at (0, 0, 0), is left.
    assert all((run.trajectory.pose != 0.0).any(axis=1).all() for run in runs)
