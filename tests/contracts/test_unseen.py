"""Public results name parts, surfaces, laboratories, sides and speeds without experiments."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
from tests.cli.shell import fixel as command
from tests.fixtures import project_of

import fixel
from fixel.errors import InvalidInput
from fixel.model import Polygon
from fixel.testing.pushes import example_pushes
from fixel.web.views.live_comparison import LiveComparison

SPACE = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
QUIET = {"progress": False}
CALIBRATION = "1"


@functools.cache
def pushes(n=12):
    """Pushes of two shapes on two surfaces in two laboratories, of one outline and one side."""
    found = []
    for k, push in enumerate(example_pushes(n, duration=0.2)):
        own = {"shape": "rect1" if k % 2 else "rect2", "surface": "abs" if k % 4 < 2 else "plywood"}
        found.append(replace(push, conditions={**push.conditions, **own},
                             dataset="here" if k < n // 2 else "there"))  # fmt: skip
    return found


def changed(push, **body):
    return replace(push.scene, bodies=(replace(push.scene.bodies[0], **body),))


def driven(push, speed, seconds):
    own = push.scene.pushers[0]
    pusher = replace(own, drive=replace(own.drive, speed=speed))
    return replace(push.scene, pushers=(pusher,), duration=seconds)


WHAT_IS_NEW = ("shape", "surface", "dataset", "outline", "side", "speed", "travel")


@functools.cache
def new_pushes():
    """Push by what no experiment has, with the word that has to name it."""
    push = replace(pushes()[5], name="new")
    speed, seconds = push.scene.pushers[0].drive.speed, push.scene.duration
    thin = Polygon([[-0.05, -0.02], [0.05, -0.02], [0.05, 0.02], [-0.05, 0.02]])
    clock = replace(push.trajectory, time=3.0 * push.trajectory.time)
    return {
        "shape": (replace(push, conditions={**push.conditions, "shape": "hex"}), "shape 'hex'"),
        "surface": (replace(push, conditions={**push.conditions, "surface": "felt"}), "'felt'"),
        "dataset": (replace(push, dataset="elsewhere"), "dataset 'elsewhere'"),
        "outline": (replace(push, scene=changed(push, shape=thin)), "part: its outline"),
        "side": (
            replace(push, scene=changed(push, pose=[0.0, 0.0, 0.5 * np.pi])),
            "side never pushed",
        ),
        "speed": (replace(push, scene=driven(push, 2.0 * speed, seconds)), "speed never pushed"),
        "travel": (
            replace(push, scene=driven(push, speed, 3.0 * seconds), trajectory=clock),
            "travel never pushed",
        ),
    }


@pytest.fixture(scope="module")
def fit():
    return fixel.calibrate(pushes(), SPACE, verdicts=False, **QUIET)


@pytest.fixture(scope="module")
def answers(fit, few_live):
    """Function by public entry point, from a push to the unseen texts and the printed answer."""
    bound = fixel.error_bound(pushes(), SPACE, folds=2, **QUIET)
    trust = fixel.map_domain(pushes(), SPACE, axes=["offset_m"], folds=2, threshold=2e-3, **QUIET)
    conditions = {"shape": "rect1", "surface": "abs"}
    plain = [replace(p, dataset="here", conditions=conditions) for p in pushes(6)]
    posterior = fixel.posterior(plain[2:5], SPACE, model_error=False, samples=20, **QUIET)

    def predicted(model):
        start = fixel.StartError(x=1e-4, y=1e-4, kind="uniform")
        return lambda push: fixel.predict(push, model, start=start, samples=4, **QUIET)

    return {
        "error_bound": bound.at,
        "map_domain": trust.at,
        "predict with a calibration": predicted(fit),
        "predict with a posterior": predicted(posterior),
        "compare": lambda push: fixel.compare(push, fit, **QUIET),
    }


def texts_of(answer):
    if hasattr(answer, "rows"):
        return tuple(text for row in answer.rows for text in row.unseen)
    return answer.unseen


@pytest.mark.parametrize("what", WHAT_IS_NEW)
def test_what_is_new_is_named_first_by_every_entry_point(what, answers, fit):
    push, word = new_pushes()[what]
    assert word in fit.unseen(push)[0]
    for name, ask in answers.items():
        answer = ask(push)
        texts = texts_of(answer)
        assert word in texts[0], name
        first = repr(answer).splitlines()[0].lower()
        assert first.startswith("unseen: "), name
        assert texts[0].lower().startswith(first.removeprefix("unseen: ")[:40]), name
        if hasattr(answer, "to_dict"):
            assert any(texts[0] in str(own) for own in answer.to_dict()["unseen"]), name
            assert "Unseen" in answer._repr_html_().split("</p>")[0], name
        else:
            assert answer.verdict == "no data"
            assert texts[0] in answer.reason


def test_a_push_like_the_experiments_is_not_called_unseen(answers, fit):
    push = replace(pushes()[5], name="new")
    assert fit.unseen(push) == ()
    for name in ("error_bound", "map_domain", "predict with a calibration", "compare"):
        answer = answers[name](push)
        assert texts_of(answer) == (), name
        assert "unseen" not in repr(answer).lower(), name


def test_conditions_that_a_scene_lacks_are_named(answers, fit):
    scene = pushes()[5].scene
    texts = ("shape not given (experiments have rect1, rect2)",
             "surface not given (experiments have abs, plywood)",
             "dataset not given (experiments have here, there)")  # fmt: skip
    assert set(fit.unseen(scene)) == set(texts)
    assert set(answers["error_bound"](scene).unseen) == set(texts)
    assert fit.unseen(scene, shape="rect1", surface="abs", dataset="here") == ()


def test_known_values_that_never_came_together_are_new():
    push = pushes()[1]
    other = [replace(p, conditions={**p.conditions, "surface": "felt"})
             if p.conditions["shape"] == "rect1" else p for p in pushes()]  # fmt: skip
    own = fixel.calibrate(other, SPACE, verdicts=False, **QUIET)
    (text,) = own.unseen(push.scene, shape="rect2", surface="felt", dataset="here")
    assert "no experiment with all of these" in text


def test_a_laboratory_with_one_experiment_is_as_good_as_none(fit):
    one = [*pushes()[:-1], replace(pushes()[-1], dataset="lonely")]
    bound = fixel.error_bound(one, SPACE, folds=2, **QUIET)
    answer = bound.at(one[-1])
    assert answer.verdict == "no data"
    assert "only 1 of 12 experiments" in answer.reason


def test_experiments_of_one_part_say_nothing_of_another_and_cannot_be_left_out():
    same = [replace(p, conditions={**p.conditions, "shape": "rect1"}) for p in pushes()]
    with pytest.raises(InvalidInput, match="1 value of shape, but fixel needs at least 2"):
        fixel.error_bound(same, SPACE, leave_out="shape", folds=2, **QUIET)


def test_repeated_pushes_count_once():
    repeated = [replace(p, name=f"{p.name}-{k}") for p in pushes(3) for k in range(6)]
    with pytest.raises(InvalidInput, match="18, of 3 different pushes, but fixel needs 9 at least"):
        fixel.error_bound(repeated, SPACE, folds=2, **QUIET)


@pytest.mark.parametrize("left", ["shape", "surface", "dataset"])
def test_left_out_groups_give_two_bounds_and_what_they_prove(left):
    bound = fixel.error_bound(pushes(), SPACE, leave_out=left, folds=2, **QUIET)
    answer = bound.at(new_pushes()[left][0])
    assert answer.verdict == "unseen"
    assert answer.proved == pytest.approx(2 / 3)
    assert "prove at most 66.7 %; a guarantee of 90 % needs 9" in answer.reason
    assert f"bounds from calibrations without each {left}, 2 in all" in repr(answer).splitlines()[1]
    assert repr(answer).splitlines()[2].startswith("typical bound: ")
    assert 0.0 < answer.position <= answer.cautious_position < np.inf
    assert 0.0 < answer.angle <= answer.cautious_angle < np.inf
    other = next(name for name in ("shape", "surface") if name != left)
    assert bound.at(new_pushes()[other][0]).verdict == "no data"


@pytest.mark.system
def test_commands_and_pages_name_it_first(tmp_path, fit, capsys):
    new = {what: new_pushes()[what] for what in ("shape", "side", "dataset")}
    folder = tmp_path / "lab"
    own = [replace(push, name=f"new-{what}") for what, (push, _) in new.items()]
    project = project_of(folder, [*pushes(), *own])
    project.add(fit)
    where = ("--project", folder)
    for push, (_, word) in zip(own, new.values(), strict=True):
        call = ("compare", push.key, "--calibration", CALIBRATION, *where)
        code, out, _ = command(capsys, *call)
        assert (code, out.startswith("Unseen: ")) == (0, True)
        assert word in out.splitlines()[0]
        content = json.loads(command(capsys, *call, "--json")[1])
        assert next(iter(content)) == "unseen"
        assert word in content["unseen"][0]
    call = ("domain", "--axes", "offset_m", "--folds", 2, "--threshold-mm", 2, *where)
    code, out, _ = command(capsys, *call)
    assert (code, out.splitlines()[0]) == (0, (
        "Unseen by calibration 1: shape 'hex': no experiment with it, only rect1, rect2"
        " (1 experiment)"
    ))  # fmt: skip
    content = json.loads(command(capsys, *call, "--json")[1])
    assert next(iter(content)) == "unseen"
    assert len(content["unseen"]) == len(new)
    with project.store() as store:
        live = LiveComparison(store)
        for push, (_, word) in zip(own, new.values(), strict=True):
            sets = live.sets(store.find(push.key))
            (one,) = [own for own in sets if own.kind == "calibration"]
            assert word in one.unseen[0]


def turned(push, degrees):
    pose = [0.0, 0.0, np.radians(degrees)]
    return replace(push, scene=changed(push, pose=pose), name=f"{push.name}-{degrees}",
                   trajectory=replace(push.trajectory, pose=push.trajectory.pose + pose),
                   dataset="here", conditions={"shape": "rect1", "surface": "abs"})  # fmt: skip


def test_left_out_sides_bound_a_side_never_pushed():
    own = [turned(push, angle) for angle in (0, 90, 180) for push in pushes(8)]
    bound = fixel.error_bound(own, SPACE, leave_out="side", folds=2, **QUIET)
    new = turned(pushes(5)[1], 270)
    answer = bound.at(new)
    assert answer.verdict == "unseen"
    assert "side never pushed" in answer.unseen[0]
    assert answer.proved == pytest.approx(3 / 4)
    assert 0.0 < answer.position <= answer.cautious_position < np.inf
    assert bound.at(own[3]).verdict == "bounded"
    faster = replace(new, scene=driven(new, 0.1, new.scene.duration))
    assert bound.at(faster).verdict == "no data"  # new in side and speed
