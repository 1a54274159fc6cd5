"""Steps of the past that steppers predict from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from fixel.kernels import codes
from fixel.simulation import Adaptive, QuasiStatic, simulate
from fixel.simulation.stepping import AbstractStepper
from fixel.testing.scenes import grasp


@dataclass(frozen=True)
class Listening(AbstractStepper):
    """The adaptive stepper, with a list of its inputs and answers."""

    name: ClassVar[str] = "listening"
    adaptive: ClassVar[bool] = True
    lead: ClassVar[float] = 0.5
    order: ClassVar[int] = 2
    heard: list = field(default_factory=list)

    @property
    def first_step(self):
        return None

    def advance(self, attempt, problem, past, step, limits):
        answer = Adaptive().advance(attempt, problem, past, step, limits)
        self.heard.append((past, answer))
        return answer


def test_after_a_step_is_taken_back_the_two_before_it_are_known():
    stepper = Listening()
    simulate(grasp("seated"), motion=QuasiStatic(), stepper=stepper, output_interval=11.0)
    heard = stepper.heard
    undone = [i for i, (_, answer) in enumerate(heard) if answer.status == codes.UNDO]
    assert undone
    for i in undone:
        # Given again what was known before the step that is taken back.
        known, again = heard[i - 1][0], heard[i + 1][0]
        assert (again.last, again.earlier) == (known.last, known.earlier)
        assert np.array_equal(again.velocity, known.velocity)
        assert np.array_equal(again.before, known.before)
