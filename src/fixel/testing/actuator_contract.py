"""Contract of actuators, as a test suite to inherit from.

Subclass it, override its one fixture, and pytest runs the suite on your driver. Use an emulated
drive, since the suite moves it by some millimetres at up to 50 mm/s.

    class TestMyDrive(ActuatorContract):
        @pytest.fixture
        def actuator(self):
            return MyDrive()
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from fixel.errors import DeviceFailed, InvalidInput
from fixel.testbed.motion import AbstractActuator

SPEED = 0.05  # [m/s]
SLOW = 0.01  # [m/s] of a move of 10 s, which a stop comes in time for, also on a busy machine
EXACT = 5e-5  # [m]


def aimed(drive: AbstractActuator, angle: float) -> None:
    """Go 20 mm along every axis, and aim from there in a direction that depends on an angle."""
    if drive.travels is None:
        pytest.skip("its line is fixed")
    origin = drive.travels[:, 0] + 0.02
    way = np.resize([np.cos(angle), np.sin(angle)], drive.n_axes)
    drive.go(origin, speed=SPEED)
    drive.aim(origin, way / np.linalg.norm(way))


def once_moving(drive: AbstractActuator, act: Callable[[], object]) -> threading.Thread:
    """Return a thread that calls a function 50 ms after the drive has begun to move."""

    def watch() -> None:
        while not drive.moving:
            time.sleep(0.005)
        time.sleep(0.05)
        act()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread


class ActuatorContract:
    """Tests of an actuator: connecting, moving, rejecting input, stopping, reporting position."""

    @pytest.fixture
    def actuator(self) -> AbstractActuator:
        """Driver under test, not connected, with its drive withdrawn or nearly so."""
        raise NotImplementedError

    @pytest.fixture
    def ready(self, actuator: AbstractActuator) -> Iterator[AbstractActuator]:
        """Driver under test, connected and homed."""
        with actuator:
            actuator.home()
            yield actuator

    def test_does_not_move_without_a_connection(self, actuator: AbstractActuator) -> None:
        assert not actuator.connected
        assert not actuator.moving
        with pytest.raises(DeviceFailed, match="not connected"):
            actuator.move(to=0.001)
        actuator.disconnect()

    def test_connects_and_lets_go_again(self, actuator: AbstractActuator) -> None:
        for _ in range(2):
            with actuator as same:
                assert same is actuator
                assert actuator.connected
            assert not actuator.connected

    def test_goes_to_a_place(self, ready: AbstractActuator) -> None:
        for place in (0.006, 0.003):
            ready.move(to=place, speed=SPEED)
            assert ready.position() == pytest.approx(place, abs=EXACT)
            assert not ready.moving

    def test_goes_by_a_distance(self, ready: AbstractActuator) -> None:
        before = ready.position()
        ready.move(by=0.004, speed=SPEED)
        ready.move(by=-0.001, speed=SPEED)
        assert ready.position() == pytest.approx(before + 0.003, abs=EXACT)

    def test_going_where_it_is_takes_no_time(self, ready: AbstractActuator) -> None:
        ready.move(to=ready.position(), speed=SPEED)
        assert not ready.moving

    @pytest.mark.parametrize(
        "asked",
        [{}, {"to": 0.001, "by": 0.001}, {"to": 1.0}, {"to": -0.01}, {"by": -1.0},
         {"to": float("nan")}, {"to": 0.001, "speed": 0.0}, {"to": 0.001, "speed": -1.0},
         {"to": 0.001, "speed": float("inf")}],
    )  # fmt: skip
    def test_refuses_what_cannot_be(self, ready: AbstractActuator, asked: dict[str, float]) -> None:
        before = ready.position()
        with pytest.raises(InvalidInput):
            ready.move(**{"speed": SPEED, **asked})  # type: ignore[arg-type]
        assert not ready.moving
        assert ready.position() == pytest.approx(before, abs=EXACT)

    def test_does_one_thing_at_a_time(self, ready: AbstractActuator) -> None:
        ready.move(to=0.1, speed=SLOW, wait=False)
        assert ready.moving
        with pytest.raises(DeviceFailed, match="already moving"):
            ready.move(to=0.002, speed=SPEED)
        ready.stop()

    def test_stops_on_the_way_and_goes_on_from_there(self, ready: AbstractActuator) -> None:
        ready.move(to=0.1, speed=SLOW, wait=False)
        time.sleep(0.05)
        ready.stop()
        there = ready.position()
        assert not ready.moving
        with pytest.raises(DeviceFailed, match="stop"):
            ready.wait()
        time.sleep(0.02)
        assert ready.position() == pytest.approx(there, abs=EXACT)
        assert there < 0.09
        ready.move(by=0.002, speed=SPEED)
        assert ready.position() == pytest.approx(there + 0.002, abs=EXACT)

    def test_stopping_twice_or_at_rest_harms_nothing(self, ready: AbstractActuator) -> None:
        ready.stop()
        ready.move(to=0.1, speed=SLOW, wait=False)
        ready.stop()
        ready.stop()
        assert not ready.moving

    def test_may_be_stopped_from_another_thread(self, ready: AbstractActuator) -> None:
        other = once_moving(ready, ready.stop)
        with pytest.raises(DeviceFailed, match="stop"):
            ready.move(to=0.1, speed=SLOW)
        other.join()
        assert ready.position() < 0.09

    def test_ctrl_c_stops_it(self, ready: AbstractActuator) -> None:
        pressed = once_moving(ready, lambda: os.kill(os.getpid(), signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            ready.move(to=0.1, speed=SLOW)
        pressed.join()
        assert not ready.moving

    def test_leaving_the_context_stops_it(self, ready: AbstractActuator) -> None:
        ready.move(to=0.1, speed=SLOW, wait=False)
        ready.disconnect()
        assert not ready.moving
        assert not ready.connected

    @pytest.mark.parametrize("angle", [0.6, 2.2, 3.3])
    def test_moves_along_a_line_in_any_direction(
        self, ready: AbstractActuator, angle: float
    ) -> None:
        aimed(ready, angle)
        line = ready.line
        for position in (0.005, -0.003):
            ready.move(to=position, speed=SPEED)
            assert ready.place() == pytest.approx(line.at(position), abs=EXACT)
            assert ready.position() == pytest.approx(position, abs=EXACT)
        assert ready.travels is not None
        for end in ready.reach:
            low, high = ready.travels.T
            outside = np.maximum(low - line.at(end), line.at(end) - high)
            assert outside.max() == pytest.approx(0.0, abs=1e-9)
            with pytest.raises(InvalidInput):
                ready.move(to=end + np.copysign(0.001, end), speed=SPEED)

    def test_stops_on_a_line_without_leaving_it(self, ready: AbstractActuator) -> None:
        aimed(ready, 0.6)
        ready.move(to=0.05, speed=SLOW, wait=False)
        time.sleep(0.05)
        ready.stop()
        there = ready.position()
        assert ready.place() == pytest.approx(ready.line.at(there), abs=EXACT)
        ready.move(by=0.002, speed=SPEED)
        assert ready.place() == pytest.approx(ready.line.at(there + 0.002), abs=EXACT)

    def test_checks_a_move_without_moving(self, ready: AbstractActuator) -> None:
        before = ready.place()
        ready.check(to=0.1, speed=SPEED)
        for refused in ({"to": 1.0}, {"to": 0.1, "speed": -1.0}, {}):
            with pytest.raises(InvalidInput):
                ready.check(**refused)
        assert not ready.moving
        assert ready.place() == pytest.approx(before, abs=EXACT)

    def test_refuses_what_is_no_line(self, ready: AbstractActuator) -> None:
        before, n = ready.reach, ready.n_axes
        for origin, way in (
            (np.zeros(n), np.full(n, 0.3)),
            (np.zeros(n), np.zeros(n)),
            (np.zeros(n), np.ones(n + 1)),
            (np.full(n, np.nan), np.eye(n)[0]),
        ):
            with pytest.raises(InvalidInput):
                ready.aim(origin, way)
        assert ready.reach == before
