"""What all methods share: predictions, and how sure a pose is."""

import numpy as np
import pytest

from fixel.vision.tracking.base import PartPrediction
from fixel.vision.tracking.stickers import spread_of


def test_half_a_turn_is_passed_at_any_rate():
    prediction = PartPrediction()
    prediction.seen(0.0, np.array([0.0, 0.0, 3.1]))
    prediction.seen(0.04, np.array([0.0, 0.0, 3.2 - 2.0 * np.pi]))
    assert prediction.at(0.1)[2] == pytest.approx(3.2 - 2.0 * np.pi + 2.5 * 0.06)


def test_how_sure_an_angle_is_depends_on_what_is_across_it():
    """Stickers one above the other: what they leave open along y does not turn the part."""
    seen = np.array([[0.3, -0.035], [0.3, 0.035]])
    sd = spread_of(seen, [np.diag([1e-5, 1e-4]) ** 2] * 2)
    assert sd == pytest.approx([1e-5 / np.sqrt(2), 1e-4 / np.sqrt(2), 1e-5 / 0.035 / np.sqrt(2)])


def test_a_motion_is_counted_in_frames_where_stamps_are_uneven():
    """Frames taken every 33 ms of a part at 30 mm/s; the third was held up, the fourth was not."""
    prediction = PartPrediction()
    for k, stamp in enumerate((0.0, 0.033, 0.0985)):
        prediction.at(stamp)
        prediction.seen(stamp, np.array([1e-3 * k, 0.0, 0.0]))
    expected = prediction.at(0.0999)
    assert abs(expected[0] - 3e-3) > 0.9e-3  # by the stamps
    assert prediction.by_count(expected) == pytest.approx([3e-3, 0.0, 0.0], abs=1e-12)


def test_even_stamps_need_no_second_prediction():
    prediction = PartPrediction()
    for k in range(3):
        prediction.at(k / 30.0)
        prediction.seen(k / 30.0, np.array([1e-3 * k, 0.0, 0.0]))
    assert prediction.by_count(prediction.at(0.1)) is None
