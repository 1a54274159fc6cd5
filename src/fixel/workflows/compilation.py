"""Compile the engine before it is used, and report whether it is compiled."""

from __future__ import annotations

from pathlib import Path

from fixel.kernels.code_cache import cache_folder, read_sealed
from fixel.model import Scene
from fixel.simulation import AbstractSolver, Newton, simulate
from fixel.simulation.simulate import is_compiled

# Duration of the start-up simulation [s]: one step of any stepper.
INSTANT = 1e-6


def engine_is_cold() -> bool:
    """Whether no usable machine code of the simulation is stored."""
    stored = Path(cache_folder()).glob("batch.rollout_batch-*")
    return not any(read_sealed(str(file)) for file in stored)


def cache_size() -> int:
    """Size of the compiled kernels of this version of the sources [bytes]."""
    return sum(f.stat().st_size for f in Path(cache_folder()).rglob("*") if f.is_file())


def get_ready(scene: Scene, solver: AbstractSolver | None = None, plain: bool = False) -> None:
    """Compile or load what a simulation needs, so that its wall time excludes compilation."""
    solver = solver or Newton()
    plain = plain or not is_compiled(solver)
    simulate(scene, duration=min(INSTANT, scene.duration), solver=solver, plain=plain)
