"""Compile the engine before it is used, and report whether it is compiled."""

from __future__ import annotations

from pathlib import Path

from fixel.kernels.jit import cache_folder
from fixel.model import Scene
from fixel.simulation import AbstractSolver, Newton, simulate
from fixel.simulation.simulate import is_compiled
from fixel.typing import Notify

COMPILING = "Compiling the simulator (only once); this takes about a minute."
COMPILING_PARTS = (
    "Compiling the parts of the plain loop (only once); this takes about half a minute."
)
# Duration of the start-up simulation [s]: one step of any stepper.
INSTANT = 1e-6


def engine_is_cold(plain: bool = False) -> bool:
    """Whether the first simulation, or the first one in the plain loop, will compile kernels."""
    entry = "samples.write_samples" if plain else "batch.rollout_batch"
    return not any(Path(cache_folder()).rglob(f"{entry}*.nbc"))


def cache_size() -> int:
    """Size of the compiled kernels of this version of the sources [bytes]."""
    return sum(f.stat().st_size for f in Path(cache_folder()).rglob("*") if f.is_file())


def get_ready(
    scene: Scene,
    notify: Notify | None = None,
    solver: AbstractSolver | None = None,
    plain: bool = False,
) -> None:
    """Compile or load what a simulation needs, so that its wall time excludes compilation."""
    solver = solver or Newton()
    plain = plain or not is_compiled(solver)
    if notify and engine_is_cold(plain):
        notify(COMPILING_PARTS if plain else COMPILING)
    simulate(scene, duration=min(INSTANT, scene.duration), solver=solver, plain=plain)
