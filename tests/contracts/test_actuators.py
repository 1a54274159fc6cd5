"""Every actuator keeps the contract of its family, on an emulated drive."""

import time

import numpy as np
import pytest

from fixel.errors import DeviceFailed, InvalidInput
from fixel.testbed.emulators.grbl import EmulatedGrbl
from fixel.testbed.motion import AbstractActuator, ManualActuator, SimulatedActuator
from fixel.testbed.motion_grbl import GrblActuator
from fixel.testing.actuator_contract import ActuatorContract


class Operator:
    """Does as values, with a drive of its own."""

    def __init__(self) -> None:
        self.drive = SimulatedActuator().connect()
        self.set_to = 0.0

    def ask(self, sentence: str) -> str:
        if "origin" in sentence:
            self.drive.home()
        elif "start button" in sentence:
            self.drive.move(to=self.set_to, speed=0.05, wait=False)
        elif "stands still" in sentence:
            while self.drive.moving:
                time.sleep(0.002)
        elif "Position" in sentence:
            return f"{1e3 * self.drive.position():.3f}"
        return ""

    def notify(self, sentence: str) -> None:
        if "Set in" in sentence:
            self.set_to = 1e-3 * float(sentence.split(" to ")[1].split(" mm")[0])
        elif "STOP" in sentence:
            self.drive.stop()


class TestSimulated(ActuatorContract):
    @pytest.fixture(params=[0.0, 0.2], ids=["even", "with ripple"])
    def actuator(self, request) -> AbstractActuator:
        return SimulatedActuator(ripple=request.param, speed_ratio=1.1, phase=0.3)


class TestSimulatedPlane(ActuatorContract):
    @pytest.fixture(params=[2, 3])
    def actuator(self, request) -> AbstractActuator:
        return SimulatedActuator(n_axes=request.param, ripple=0.2, start=0.004)

    def test_a_move_begins_on_its_line(self, actuator) -> None:
        with actuator:
            actuator.aim([0.03] * actuator.n_axes, np.eye(actuator.n_axes)[1])
            with pytest.raises(DeviceFailed, match="mm off the line"):
                actuator.move(to=0.01)

    def test_a_line_outside_the_travels_is_refused(self, actuator) -> None:
        with pytest.raises(InvalidInput, match="inside the travels"):
            actuator.aim(np.full(actuator.n_axes, -0.01), np.eye(actuator.n_axes)[0])


class TestManual(ActuatorContract):
    @pytest.fixture
    def actuator(self) -> AbstractActuator:
        operator = Operator()
        return ManualActuator(ask=operator.ask, notify=operator.notify)

    def test_who_is_interrupted_at_the_click_is_asked_to_stop_the_drive(self) -> None:
        said: list[str] = []

        def ask(sentence: str) -> str:
            if "start button" in sentence:
                raise KeyboardInterrupt
            return "0"

        drive = ManualActuator(ask=ask, notify=said.append).connect()
        with pytest.raises(KeyboardInterrupt):
            drive.move(to=0.01)
        assert said[-1].startswith("STOP THE DRIVE NOW")


class TestGrbl(ActuatorContract):
    @pytest.fixture(params=[{}, {"axes": "XY", "guard": False}], ids=["line", "plane"])
    def actuator(self, request):
        axes = 2 if request.param else 3
        with EmulatedGrbl(homing=True, acceleration=2000.0, start=3.0, axes=axes) as controller:
            driver = GrblActuator(controller.port, **request.param)
            yield driver
            driver.disconnect()
            assert controller.lost == 0
