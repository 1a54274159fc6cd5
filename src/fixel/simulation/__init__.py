"""Simulation: motion models, steppers and solvers, and functions that combine them."""

from fixel.simulation.batch import simulate_batch
from fixel.simulation.motion import AbstractMotionModel, Dynamic, FirstOrder, QuasiStatic
from fixel.simulation.result import Accuracy, BatchResult, PusherTrajectory, Simulation
from fixel.simulation.simulate import Simulator, simulate
from fixel.simulation.stepping import (
    AbstractSolver,
    AbstractStepper,
    Adaptive,
    GaussSeidel,
    Lemke,
    Midpoint,
    Newton,
    StewartTrinkle,
)

__all__ = [
    "AbstractMotionModel",
    "AbstractSolver",
    "AbstractStepper",
    "Accuracy",
    "Adaptive",
    "BatchResult",
    "Dynamic",
    "FirstOrder",
    "GaussSeidel",
    "Lemke",
    "Midpoint",
    "Newton",
    "PusherTrajectory",
    "QuasiStatic",
    "Simulation",
    "Simulator",
    "StewartTrinkle",
    "simulate",
    "simulate_batch",
]
