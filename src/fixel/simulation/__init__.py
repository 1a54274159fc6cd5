"""Simulation: motion models, steppers and solvers, and functions that combine them."""

from fixel.simulation.batch import simulate_batch as simulate_batch
from fixel.simulation.motion import (
    AbstractMotionModel as AbstractMotionModel,
    Dynamic as Dynamic,
    FirstOrder as FirstOrder,
    QuasiStatic as QuasiStatic,
)
from fixel.simulation.result import (
    Accuracy as Accuracy,
    BatchResult as BatchResult,
    PusherTrajectory as PusherTrajectory,
    Simulation as Simulation,
)
from fixel.simulation.simulate import Simulator as Simulator, simulate as simulate
from fixel.simulation.stepping import (
    AbstractSolver as AbstractSolver,
    AbstractStepper as AbstractStepper,
    Adaptive as Adaptive,
    GaussSeidel as GaussSeidel,
    Lemke as Lemke,
    Midpoint as Midpoint,
    Newton as Newton,
    StewartTrinkle as StewartTrinkle,
)
