"""Units that are left out, and what no push has, on squares pushed from known sides."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fixel.calibration.known_pushes import KnownPushes, push_target, with_units
from fixel.calibration.target import target_of
from fixel.model import Disk, LineDrive
from fixel.testing.pushes import example_pushes

SPEEDS = (0.01, 0.011, 0.02, 0.05)


def turned(push, degrees):
    body = replace(push.scene.bodies[0], pose=[0.0, 0.0, math.radians(degrees)])
    return replace(push, scene=replace(push.scene, bodies=(body,)), name=f"{push.name}-{degrees}")


def driven(push, speed):
    own = push.scene.pushers[0]
    drive = LineDrive(speed=speed, direction=own.drive.direction)
    pusher = replace(own, drive=drive)
    return replace(push, scene=replace(push.scene, pushers=(pusher,)), name=f"{push.name} {speed}")


@pytest.fixture(scope="module")
def pushes():
    return example_pushes(4, duration=0.2)


def numbers(targets, name):
    labels = [target.conditions[name] for target in targets]
    return [list(dict.fromkeys(labels)).index(label) for label in labels]


def test_each_side_of_a_part_is_a_unit(pushes):
    plain = [replace(push, conditions={}) for push in pushes]
    targets = [target_of(turned(push, angle)) for angle in (0, 90, 180, 270) for push in plain]
    own = numbers(with_units(targets, "side"), "side")
    assert own == [k for k in range(4) for _ in plain]


def test_a_round_part_has_quarters(pushes):
    body = replace(pushes[0].scene.bodies[0], shape=Disk(0.04))
    push = replace(pushes[1], scene=replace(pushes[1].scene, bodies=(body,)), conditions={})
    targets = [target_of(turned(push, angle)) for angle in range(0, 360, 5)]
    own = np.array(numbers(with_units(targets, "side"), "side"))
    assert 4 <= own.max() + 1 <= 5
    for unit in range(own.max() + 1):
        assert np.ptp(np.flatnonzero(own == unit)) * 5 <= 90 or 0 in np.flatnonzero(own == unit)


def test_speeds_within_a_factor_are_one_unit_and_conditions_win(pushes):
    targets = [target_of(driven(push, speed)) for speed in SPEEDS for push in pushes]
    assert numbers(with_units(targets, "speed"), "speed") == [
        k for k in (0, 0, 1, 2) for _ in pushes
    ]
    assert set(numbers(with_units(targets, "side"), "side")) == {0, 1}  # their own condition
    assert {t.conditions["dataset"] for t in with_units(targets, "dataset")} == {"example"}


def test_texts_that_differ_everywhere_are_no_labels(pushes):
    own = [replace(push, conditions={"note": f"note {k}"}) for k, push in enumerate(pushes)]
    known = KnownPushes.of([target_of(push) for push in own])
    assert "note" not in known.labels
    assert known.unseen(push_target(own[0].scene, {"note": "another"})) == ()
    named = KnownPushes.of([target_of(push) for push in own], ["note"])
    (new,) = named.unseen(push_target(own[0].scene, {"note": "another"}))
    assert (new.what, new.is_given) == ("note", True)


def test_a_pusher_that_does_not_move_has_no_contact(pushes):
    known = KnownPushes.of([target_of(push) for push in pushes])
    still = replace(pushes[0].scene, pushers=())
    assert known.unseen(push_target(still, {})) == ()
    nothing = KnownPushes.of([push_target(still, {})] * 4)
    (new,) = nothing.unseen(push_target(pushes[0].scene, {}))
    assert new.text == "side: no experiment with a moving pusher"
