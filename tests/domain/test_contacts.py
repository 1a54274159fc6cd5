"""Bounds where a side or a speed is new: a made-up laboratory in which every side is biased."""

import math

import numpy as np
import pytest
from tests.fixtures import refused

from fixel import InvalidInput, Polygon
from fixel.calibration.known_pushes import (
    Configurations,
    PushedContacts,
    TouchedPlaces,
    contacts_of,
)
from fixel.domain.error_bound import ConformalBound

SIDES = 4
EACH = 16  # pushes of a side


class Laboratory:
    """Parts with four sides; a side that the calibration has not seen is biased.

    Features are where a push is along its side and how long it is, not which side it is on.
    """

    def __init__(self, parts, bias, seed):
        self.rng = np.random.default_rng(seed)
        self.bias = bias * self.rng.standard_normal((parts, SIDES))
        self.parts = parts

    def push(self, part, side, seen):
        """Features, errors and contacts of the pushes of one side."""
        features = self.rng.uniform(-0.4, 0.4, (EACH, 2))
        noise = self.rng.standard_normal(EACH) * np.exp(features[:, 0])
        errors = np.abs(noise + (0.0 if seen else self.bias[part, side]))
        return features, errors, contacts_on(side, features[:, 0])

    def pushes(self, cells, seen):
        found = [self.push(part, side, seen) for part, side in cells]
        labels = [cell for cell in cells for _ in range(EACH)]
        return (
            np.concatenate([own[0] for own in found]),
            np.concatenate([own[1] for own in found]),
            TouchedPlaces.joined([own[2] for own in found]),
            [part for part, _ in labels],
            labels,
        )


def contacts_on(side, along, speed=0.01):
    angle = np.full(len(along), 0.5 * math.pi * side)
    c, s = np.cos(angle), np.sin(angle)
    return TouchedPlaces(angle, np.column_stack((c - s * along, s + c * along)),
                    np.full(len(along), speed))  # fmt: skip


def coverage(bias, repeats=12):
    """Shares of the pushes of new sides, and of known ones, within 90 % bounds; mean bounds."""
    rows = []
    for seed in range(repeats):
        lab = Laboratory(10, bias, seed)
        known = [(part, side) for part in range(10) for side in range(3)]
        left_out = lab.pushes(known, seen=False)
        beyond = ConformalBound.fit(
            *left_out[:2], left_out[3], units=left_out[4], model="neighbours"
        )
        x, e, contacts, parts, _ = lab.pushes(known, seen=True)
        blind = ConformalBound.fit(x, e, parts, model="neighbours")
        promise = blind.for_contacts(contacts, parts, beyond)
        x, e, contacts, parts, _ = lab.pushes([(part, 3) for part in range(10)], seen=False)
        bound = promise.bounds(x, parts, contacts)
        old = blind.bounds(x, parts)
        x, off, contacts, parts, _ = lab.pushes(known, seen=True)
        same = promise.bounds(x, parts, contacts)
        assert np.array_equal(same, blind.bounds(x, parts))
        rows.append((np.mean(e <= bound), np.mean(e <= old), np.mean(off <= same),
                     bound.mean(), old.mean()))  # fmt: skip
    names = ("new", "blind", "known", "new_mean", "blind_mean")
    return dict(zip(names, np.mean(rows, axis=0), strict=True))


@pytest.mark.system
def test_bounds_hold_on_a_new_side_where_every_side_is_biased():
    found = coverage(bias=2.0)
    assert found["blind"] < 0.75
    assert found["new"] >= 0.88
    assert found["known"] == pytest.approx(0.905, abs=0.025)


@pytest.mark.system
def test_without_a_bias_bounds_on_a_new_side_are_hardly_wider():
    found = coverage(bias=0.0)
    assert 0.88 <= found["new"] <= 0.97
    assert found["new_mean"] < 1.25 * found["blind_mean"]


@pytest.mark.system
def test_a_new_side_or_speed_has_no_data_and_says_why():
    lab = Laboratory(1, 2.0, 0)
    x, e, contacts, _, _ = lab.pushes([(0, side) for side in range(3)], seen=True)
    ways = (contacts_on(1, np.zeros(1)), contacts_on(3, np.zeros(1)),
            contacts_on(1, np.zeros(1), 0.02), contacts_on(3, np.zeros(1), 0.02),
            contacts_on(1, np.full(1, 1.5)))  # fmt: skip
    asked = (np.zeros((5, 2)), None, TouchedPlaces.joined(ways))
    promise = ConformalBound.fit(x, e).for_contacts(contacts)
    reasons = promise.reasons(*asked)
    assert np.isfinite(promise.bounds(*asked)).tolist() == [True, False, False, False, False]
    why = ("", "90 degrees from those of all pushed", "speed never pushed: 20 mm/s, nearest 10",
           "side never pushed", "contact point never pushed")  # fmt: skip
    assert all(part in reason for part, reason in zip(why, reasons, strict=True))
    assert reasons[0] == ""
    assert "speed never pushed" in reasons[3]


def test_what_is_new_in_both_or_of_a_new_part_has_no_data_even_with_left_out_sides():
    lab = Laboratory(10, 1.0, 0)
    known = [(part, side) for part in range(10) for side in range(3)]
    x, e, contacts, parts, units = lab.pushes(known, seen=True)
    beyond = ConformalBound.fit(x, e, parts, units=units, model="neighbours")
    promise = ConformalBound.fit(x, e, parts, model="neighbours").for_contacts(
        contacts, parts, beyond
    )
    asked = TouchedPlaces.joined([
        contacts_on(side, np.zeros(1), v)
        for side, v in ((3, 0.01), (1, 0.02), (3, 0.02), (1, 0.01))
    ])  # fmt: skip
    labels = [0, 0, 0, 99]
    assert np.isfinite(promise.bounds(np.zeros((4, 2)), labels, asked)).tolist() == [
        True, True, False, False,
    ]  # fmt: skip
    assert [bool(text) for text in promise.reasons(np.zeros((4, 2)), labels, asked)] == [
        False, False, True, True,
    ]  # fmt: skip


def test_a_finite_bound_takes_nine_left_out_sides():
    lab = Laboratory(4, 0.0, 0)
    for sides, good in ((8, False), (9, True)):
        cells = [(k % 4, k // 4) for k in range(sides)]
        x, e, _, parts, units = lab.pushes(cells, seen=True)
        if good:
            assert np.isfinite(ConformalBound.fit(x, e, parts, units=units).bounds(x[:1])).all()
        else:
            said = r"8 left out, but fixel needs at least 9.*8 prove at most 88\.9 %"
            refused(ConformalBound.fit, x, e, parts, units=units, match=said)


def test_contacts_are_asked_for_and_refused():
    lab = Laboratory(1, 0.0, 0)
    x, e, contacts, parts, _ = lab.pushes([(0, 0), (0, 1)], seen=True)
    plain = ConformalBound.fit(x, e, parts, model="neighbours")
    refused(plain.for_contacts(contacts, parts).bounds, x, parts, match="contacts")
    refused(plain.bounds, x, parts, contacts, match="contacts")
    refused(plain.for_contacts, contacts, parts, plain, match="without units")
    with pytest.raises(InvalidInput, match="positive speeds"):
        PushedContacts(contacts._replace(speed=np.zeros(len(e))), parts)


def test_contacts_of_a_turned_square():
    """The finger stands 3 mm off the middle of each side, whichever way the square lies."""
    half, radius = 0.05, 0.005
    square = Polygon(half * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]))
    turn = np.array([0.0, 0.4, -2.0, 3.0])
    side = 0.5 * np.pi * np.array([0, 1, 2, -1])
    out = half + radius + 0.003
    tip = 0.3 + out * np.column_stack((np.cos(turn + side), np.sin(turn + side)))
    start = np.column_stack((np.full((4, 2), 0.3), turn))
    found = contacts_of(Configurations(square, radius, start, tip, tip), np.full(4, 0.02))
    assert np.cos(found.normal - side) == pytest.approx(1.0)
    point = math.sqrt(math.pi) / 2.0 * np.column_stack((np.cos(side), np.sin(side)))
    assert found.place == pytest.approx(point, abs=1e-9)
