"""Sets of parameters against one experiment."""

import shlex

import pytest

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.model import Parameters
from fixel.sampling import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.web.views import live_comparison
from fixel.workflows.project.compare import comparison


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    project = Project.create(tmp_path_factory.mktemp("compare") / "lab")
    with project.store() as store:
        for experiment in SimulatedTestbed(seed=1).run(thesis_plan().experiments[:2]):
            store.add_experiment(experiment)
        yield live_comparison.CompareDesk(store)


def test_the_thesis_parameters_come_first_and_all_of_them_have_a_meaning(desk):
    sliders = desk.sliders(1)
    names = [slider.name for slider in sliders]
    assert names[:4] == ["mu_pusher", "mu_fixel", "mu_support", "tripod_radius"]
    assert {"mass", "start_x", "friction_centre_x"} <= set(names)
    assert not {"support_1_x", "ellipsoid_force", "contact_offset", "table_bend"} & set(names)
    for slider in sliders:
        ends = {slider.low, slider.high}
        for value in ends:
            live_comparison.info_of(slider.name)
            assert desk.compared(1, {slider.name: value}).motion.status


def test_a_set_is_the_comparison_of_the_command_line(desk):
    values = {"mu_support": 0.3, "tripod_radius": 0.03}
    answer = desk.compared(1, values, "quasistatic")
    same = comparison(
        desk.experiment(1), Parameters(values), live_comparison.motion_model("quasistatic")
    )
    assert answer.error_mm2 == same.error_mm2
    assert answer.motion.time[0] == same.simulated.time[0]
    assert answer.motion.errors.position == pytest.approx(same.position)


def test_what_is_kept_is_offered_next_time(desk):
    before = len(desk.sets(2))
    kept = desk.keep(2, {"mu_pusher": 0.4}, "dynamic", "fixel compare 2")
    found = next(one for one in desk.sets(2) if one.id == f"simulation-{kept}")
    assert len(desk.sets(2)) == before + 1
    assert dict(found.parameters) == {"mu_pusher": 0.4}
    assert found.error_mm2 is not None
    again, stored = desk.compared(2, {"mu_pusher": 0.4}), desk.stored(2, kept)
    assert stored[1:-1] == again[1:-1]
    assert stored.motion.contacts is None
    with pytest.raises(InvalidInput, match="one of experiment 2"):
        desk.simulated(1, kept)


def test_the_command_and_the_python_say_the_same(desk, tmp_path):
    experiment = desk.experiment(1)
    command = live_comparison.command_of(experiment, tmp_path, {"mu_fixel": 0.25}, "first-order")
    words = shlex.split(command)
    assert words[:3] == ["fixel", "compare", experiment.key]
    assert words[-4:] == ["--set", "mu_fixel=0.25", "--motion", "first-order"]
    text = live_comparison.python_of(experiment, tmp_path, {"mu_fixel": 0.25}, "first-order")
    compile(text, "copied", "exec")
    assert "Parameters(mu_fixel=0.25), FirstOrder()" in text


def test_a_name_with_quotes_does_not_leave_its_string(desk, tmp_path):
    from dataclasses import replace

    experiment = replace(desk.experiment(1), name='it\'s "$(rm)" `x`')
    command = live_comparison.command_of(experiment, tmp_path, {}, "dynamic")
    assert shlex.split(command)[2] == experiment.key
    compile(live_comparison.python_of(experiment, tmp_path, {}, "dynamic"), "copied", "exec")


def test_strangers_are_refused(desk):
    with pytest.raises(InvalidInput, match="mu_suport"):
        desk.compared(1, {"mu_suport": 0.3})
    with pytest.raises(InvalidInput, match="motion"):
        desk.compared(1, {}, "magic")
