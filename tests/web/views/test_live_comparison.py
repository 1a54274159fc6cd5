"""Sets of parameters against one experiment."""

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from tests.fixtures import project_of

import fixel
from fixel.errors import InvalidInput
from fixel.sampling import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.web.views import live_comparison

HERE = Path("my_lab")


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    experiments = SimulatedTestbed(seed=1).run(thesis_plan().experiments[:2])
    with project_of(tmp_path_factory.mktemp("compare") / "lab", experiments).store() as store:
        yield live_comparison.LiveComparison(store)


def test_the_thesis_parameters_come_first_and_all_of_them_have_a_meaning(live):
    sliders = live.sliders(1)
    names = [slider.name for slider in sliders]
    assert names[:4] == ["mu_pusher", "mu_fixel", "mu_support", "tripod_radius"]
    assert {"mass", "start_x", "friction_centre_x"} <= set(names)
    assert not {"support_1_x", "ellipsoid_force", "contact_offset", "table_bend"} & set(names)
    for slider in sliders:
        ends = {slider.low, slider.high}
        for value in ends:
            assert slider.meaning
            assert live.compared(1, {slider.name: value}, "dynamic", HERE).motion.status


def test_what_is_kept_is_offered_next_time(live):
    before = len(live.sets(2))
    kept = live.keep(2, {"mu_pusher": 0.4}, "dynamic", HERE)
    found = next(one for one in live.sets(2) if one.id == f"simulation-{kept}")
    assert len(live.sets(2)) == before + 1
    assert dict(found.parameters) == {"mu_pusher": 0.4}
    assert found.error_mm2 is not None
    again = live.compared(2, {"mu_pusher": 0.4}, "dynamic", HERE)
    stored = live.stored(2, kept, HERE)
    different = {"motion", "wall_time_s"}
    assert stored.model_dump(exclude=different) == again.model_dump(exclude=different)
    assert stored.motion.contacts is None
    with pytest.raises(InvalidInput, match="one of experiment 2"):
        live.simulated(1, kept)


def test_an_experiment_is_shown_with_its_own_calibration_among_many_newer_ones(tmp_path):
    pushes = fixel.datasets.example()[:2]
    fits = fixel.calibrate_each(pushes, {"mu_pusher": (0, 1)}, verdicts=False, progress=False)
    project = project_of(tmp_path / "lab", pushes)
    project.add(fits)
    with project.store() as store:
        of_second = store.calibration(max(store.calibrations()))
        assert [own.experiment_id for own in of_second.members] == [2]
        for _ in range(live_comparison.MAX_SETS + 5):  # a campaign of many more experiments
            store.add_calibration(of_second)
        offered = live_comparison.LiveComparison(store).sets(1)
    shown = live_comparison.calibrated_of(offered)
    assert dict(shown.parameters)["mu_pusher"] == fits[0]["mu_pusher"]
    assert "(calibrated on this experiment)" in shown.label


def test_the_command_and_the_python_say_the_same(live, tmp_path):
    experiment = live.experiment(1)
    command = live_comparison.command_of(experiment, tmp_path, {"mu_fixel": 0.25}, "first-order")
    words = shlex.split(command)
    assert words[:3] == ["fixel", "compare", experiment.key]
    assert words[-4:] == ["--set", "mu_fixel=0.25", "--motion", "first-order"]
    text = live_comparison.python_of(experiment, tmp_path, {"mu_fixel": 0.25}, "first-order")
    compile(text, "copied", "exec")
    assert "{'mu_fixel': 0.25}, motion='first-order'" in text


def test_a_name_with_quotes_does_not_leave_its_string(live, tmp_path):
    experiment = replace(live.experiment(1), name='it\'s "$(rm)" `x`')
    command = live_comparison.command_of(experiment, tmp_path, {}, "dynamic")
    assert shlex.split(command)[2] == experiment.key
    compile(live_comparison.python_of(experiment, tmp_path, {}, "dynamic"), "copied", "exec")
