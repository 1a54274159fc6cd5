"""Which experiments join a domain when: corrected, and as the thesis's code is printed."""

import pytest
from tests.fixtures import refused

from fixel.domain.growth import NOMINAL, ROWS, AxisPlace, ExperimentGroup, domain, interval, joining
from fixel.errors import InvalidInput


def _rows(step, index):
    """Numbers of the rows that join, from 1, as in appendix C.6."""
    return [ROWS.index(place) + 1 for place in joining(step, index)]


def test_rows_of_the_printed_code():
    assert len(ROWS) == len(set(ROWS)) == 21
    assert [_rows(step, "printed") for step in range(1, 6)] == [
        [2, 11, 12, 16], [3, 10, 13, 17], [4, 9, 14, 18], [5, 8, 15, 19], [6, 7, 16, 20],
    ]  # fmt: skip


def test_corrected_rows_take_theta_one_later():
    for step in range(1, 6):
        printed, corrected = _rows(step, "printed"), _rows(step, "corrected")
        assert corrected[:3] == printed[:3]
        assert corrected[3] == printed[3] + 1 == 16 + step


def test_the_corrected_domain_has_every_row_once_the_printed_one_has_row_16_twice():
    assert sorted(domain(5)) == sorted(ROWS)
    printed = domain(5, "printed")
    assert len(printed) == 21
    assert printed.count(AxisPlace("y", -5)) == 2
    assert AxisPlace("theta", 5) not in printed
    assert AxisPlace("y", -5) in domain(1, "printed")
    assert [len(domain(k)) for k in range(6)] == [1, 5, 9, 13, 17, 21]


@pytest.mark.parametrize(("axis", "size", "ends"), [
    ("x", 2, (0, 1)), ("theta", 4, (0, 3)), ("y", 3, (-1, 1)), ("y", 5, (-2, 2)),
    ("y", 2, (0, 1)), ("y", 4, (-1, 2)),
])  # fmt: skip
def test_intervals_hold_the_nominal_sample(axis, size, ends):
    assert interval(axis, size) == ends
    assert ends[0] <= 0 <= ends[1]


def test_what_cannot_be_is_refused():
    refused(interval, "x", 1, match="at least 2")
    refused(interval, "z", 3, match="x, y or theta")
    refused(joining, 6, "printed", match="as printed")
    refused(joining, 1, "other", match="corrected or printed")
    with pytest.raises(InvalidInput, match="no nominal"):
        ExperimentGroup(shape="square", layout="a", at={AxisPlace("x", 1): 0})


def test_a_group_says_what_it_lacks():
    group = ExperimentGroup(shape="square", layout="a", at={NOMINAL: 0, AxisPlace("x", 1): 1})
    assert [place.name for place in group.missing(domain(1))] == ["y1", "y-1", "theta1"]
    assert group.found(domain(1)) == (0, 1)
