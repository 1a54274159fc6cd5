"""The solver chain of one step: Newton first, and what to do when it fails."""

import math

from fixel.kernels import codes
from fixel.kernels.arrays import FloatArray, Problem, Workspace
from fixel.kernels.gauss_seidel import gauss_seidel
from fixel.kernels.jit import kernel
from fixel.kernels.newton import newton
from fixel.kernels.residual import residual

TOLERANCE = 1e-9  # natural-map residual that a step must reach


@kernel
def solve(problem: Problem, work: Workspace, guess: FloatArray, stat: FloatArray) -> float:
    r, its = newton(problem, work, 1e-11, 10)
    stat[2] += its
    res = residual(problem, work.right)
    if res <= 1e-9:
        return res
    stat[9]+=1
    for i in range(problem.size[0]):
        problem.velocity[i] = guess[i]
    for i in range(problem.size[1]):
        problem.impulse[i, 0] = 0.0
        problem.impulse[i, 1] = 0.0
    for i in range(problem.size[2]):
        for k in range(3):
            problem.element_impulse[i, k] = 0.0
    r, its = newton(problem, work, 1e-11, 40, 1.0)
    stat[2] += its
    res = residual(problem, work.right)
    if res <= 1e-9:
        return res
    for attempt in range(5):
        stat[4 + attempt] += 1
        for i in range(problem.size[0]):
            problem.velocity[i] = guess[i]
        for i in range(problem.size[1]):
            problem.impulse[i, 0] = 0.0
            problem.impulse[i, 1] = 0.0
        for i in range(problem.size[2]):
            for k in range(3):
                problem.element_impulse[i, k] = 0.0
        for i in range(problem.size[0]):
            problem.stiffness[i] *= 6.0
        r, its = newton(problem, work, 1e-11, 60, 1.0)
        stat[2] += its
        res = residual(problem, work.right)
        if res <= 1e-9:
            return res
        gauss_seidel(problem, work, 1e-13, 100)
        stat[3] += 100
        r, its = newton(problem, work, 1e-11, 60, 1.0)
        stat[2] += its
        res = residual(problem, work.right)
        if res <= 1e-9:
            return res
    return res
