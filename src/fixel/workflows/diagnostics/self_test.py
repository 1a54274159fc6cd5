"""Solve problems with known answers by every solver, to test an installation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from fixel.simulation import (
    GaussSeidel,
    Lemke,
    Newton,
    QuasiStatic,
    Simulation,
    StewartTrinkle,
    simulate,
    simulate_batch,
)
from fixel.testing import scenes

# Largest natural-map residual of any step, as published collections of problems require.
RESIDUAL = 1e-8
# Largest distance of the solvers' results after the same steps [m]: rounding.
AGREEMENT = 1e-7
# Largest relative error of the adaptive stepper against a closed-form answer.
CLOSED_FORM = 2e-3


@final
@dataclass(frozen=True, slots=True)
class SelfCheck:
    """Result of one check of the self-test.

    Attributes
    ----------
    name : str
        Property that was checked.
    passed : bool
    detail : str
        Result in words.
    residual : float or None
        Largest residual of any step, if steps were solved.
    """

    name: str
    passed: bool
    detail: str
    residual: float | None = None


def self_test() -> list[SelfCheck]:
    """Run all checks; one that raises has failed."""
    return [_guarded(name, check) for name, check in _CHECKS.items()]


def worst_residual(checks: list[SelfCheck]) -> float:
    """Largest residual of all checks that solved steps."""
    return max((c.residual for c in checks if c.residual is not None), default=float("nan"))


def _guarded(name: str, check: Callable[[], tuple[bool, str, float | None]]) -> SelfCheck:
    try:
        passed, detail, residual = check()
    except Exception as problem:  # whatever it is, the other checks run and this one reports it
        return SelfCheck(name, False, f"{type(problem).__name__}: {problem}")
    fine = residual is None or residual <= RESIDUAL
    return SelfCheck(name, passed and fine, detail, residual)


Found = tuple[bool, str, float | None]


def _seats() -> Found:
    run = simulate(scenes.grasp("seated"))
    trace = run.pushers["actuator"]
    fine = run.converged and bool(trace.stalled[-1])
    fine = fine and abs(float(trace.force[-1]) - scenes.STALL_FORCE) < 1e-6 * scenes.STALL_FORCE
    return fine, f"{run.status}, {trace.force[-1]:.6g} N", run.max_residual


def _jams() -> Found:
    run = simulate(scenes.grasp("seated", force_limit=None))
    when = "" if run.stopped_at is None else f" at {run.stopped_at:.3f} s"
    return run.status == "jammed", run.status + when, run.max_residual


def _slides() -> Found:
    run = simulate(scenes.sliding_block(speed=0.5, friction=0.25))
    return _compared(run, float(run.final["block"][0]), 0.5**2 / (2.0 * 0.25 * 9.81), "m")


def _spins() -> Found:
    run = simulate(scenes.spinning_disk(spin=10.0, friction=0.25))
    # At constant deceleration it turns by half of what it would turn at full speed.
    stop = 3.0 * 0.05 * 10.0 / (4.0 * 0.25 * 9.81)
    return _compared(run, float(run.final["disk"][2]), 0.5 * 10.0 * stop, "rad")


def _compared(run: Simulation, found: float, expected: float, unit: str) -> Found:
    off = abs(found / expected - 1.0)
    detail = f"{found:.6g} {unit}, {100.0 * off:.2g} % off"
    return run.converged and off < CLOSED_FORM, detail, run.max_residual


def _micro() -> Found:
    run = simulate(scenes.micro_push(), motion=QuasiStatic())
    return run.converged, f"{run.status}, {run.steps} steps", run.max_residual


def _heap() -> Found:
    run = simulate(scenes.heap(9, duration=0.5))
    return run.converged, f"{run.status}, {run.steps} steps", run.max_residual


def _agree() -> Found:
    scene = scenes.grasp("slip", support_directions=8)
    stepper = StewartTrinkle(step=0.05)
    runs = [simulate(scene, stepper=stepper, solver=s()) for s in (Newton, GaussSeidel, Lemke)]
    ends = np.array([run.final["object"] for run in runs])
    apart = float(np.abs(ends - ends[0]).max())
    worst = max(run.max_residual for run in runs)
    fine = all(run.converged for run in runs) and apart < AGREEMENT
    return fine, f"at most {apart:.1e} m apart", worst


def _same_bits() -> Found:
    radii = {"tripod_radius": np.linspace(0.03, 0.05, 16)}
    one, two = (simulate_batch(scenes.grasp("slip"), radii, threads=n) for n in (1, 2))
    assert not isinstance(one, list)
    assert not isinstance(two, list)
    same = bool(np.array_equal(one.pose, two.pose))
    return same, "the same bits" if same else "different", float(one.max_residual.max())


_CHECKS: dict[str, Callable[[], Found]] = {
    "grasp seats, drive stalls at 34.3 N": _seats,
    "rigid drive jams, and says so": _jams,
    "block stops after v^2 / 2 mu g": _slides,
    "disk stops spinning after 3 R w / 4 mu g": _spins,
    "push of a 1.6 mm part, without inertia": _micro,
    "heap of nine bodies": _heap,
    "newton, gauss-seidel, lemke agree": _agree,
    "one thread and two agree": _same_bits,
}
