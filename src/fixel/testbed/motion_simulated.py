"""Simulated actuator, with its own clock."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import ClassVar, Self, final

import numpy as np

from fixel.errors import DeviceFailed
from fixel.model.fields import fraction, non_negative, positive
from fixel.testbed.imperfections import uneven_time
from fixel.testbed.motion import DRIVE_REACH, AbstractActuator, checked_reach


@final
class SimulatedActuator(AbstractActuator):
    """Actuator that moves as in the simulated testbed: at its own speed, with a ripple.

    Parameters
    ----------
    reach : (float, float)
        Smallest and largest position [m].
    start : float
        Initial position [m].
    speed_ratio : float
        True speed over the requested speed [-].
    ripple : float
        Amplitude of the speed about its mean, as a share of it, less than 1 [-].
    frequency : float
        Frequency of the ripple [Hz].
    phase : float
        Phase of the ripple when a move begins [rad].
    clock : callable
        Function that returns seconds; replace it to run faster than real time.
    """

    name: ClassVar[str] = "simulated"

    def __init__(
        self,
        *,
        reach: tuple[float, float] = DRIVE_REACH,
        start: float = 0.0,
        speed_ratio: float = 1.0,
        ripple: float = 0.0,
        frequency: float = 2.7,
        phase: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.reach = checked_reach(reach)
        self._speed_ratio = positive(speed_ratio, "speed_ratio")
        # Above 1 it would move backwards at times; no stepper motor does.
        self._ripple = min(fraction(ripple, "ripple"), 1.0 - 1e-9)
        self._frequency = positive(frequency, "frequency", "Hz")
        self._phase = phase
        self._clock = clock
        self._connected = False
        self._lock = threading.RLock()
        self._from = self._to = non_negative(start, "start", "m")
        self._speed, self._began = 0.0, 0.0
        self._stopped = ""

    def connect(self) -> Self:
        self._connected = True
        return self

    def disconnect(self) -> None:
        self.stop()
        self._connected = False

    @property
    def connected(self) -> bool:
        return self._connected

    def home(self) -> None:
        with self._lock:
            self._from = self._to = self.reach[0]
            self._speed = 0.0

    def position(self) -> float:
        with self._lock:
            return self._place(self._clock())

    @property
    def moving(self) -> bool:
        with self._lock:
            return self._speed > 0.0 and self._place(self._clock()) != self._to

    def wait(self) -> None:
        while self.moving:
            time.sleep(0.002)
        with self._lock:
            why, self._stopped = self._stopped, ""
            self._speed = 0.0
        if why:
            raise DeviceFailed(why)

    def stop(self) -> None:
        with self._lock:
            if self.moving:
                self._stopped = "the drive was stopped"
            self._from = self._to = self._place(self._clock())
            self._speed = 0.0

    def _begin(self, target: float, speed: float) -> None:
        with self._lock:
            now = self._clock()
            self._from, self._to = self._place(now), target
            self._speed, self._began = speed * self._speed_ratio, now
            self._stopped = ""

    def _place(self, now: float) -> float:
        if self._speed == 0.0:
            return self._to
        elapsed = np.array(now - self._began)
        even = float(uneven_time(elapsed, self._ripple, self._frequency, self._phase))
        covered = max(0.0, self._speed * even)
        whole = self._to - self._from
        return self._to if covered >= abs(whole) else self._from + math.copysign(covered, whole)
