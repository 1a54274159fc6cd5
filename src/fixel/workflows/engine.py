"""The compiled engine: whether it is there yet, and getting it ready."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fixel.kernels.jit import cache_folder
from fixel.model import Scene
from fixel.simulation import simulate

Say = Callable[[str], None]

COMPILING = "Compiling the engine, once; this takes about a minute."
# Of the start-up scene [s]: one step of any stepper.
INSTANT = 1e-6


def engine_is_cold() -> bool:
    """Whether the first simulation will have to compile the kernels."""
    return not any(Path(cache_folder()).rglob("*.nbc"))


def cache_size() -> int:
    """Of the compiled kernels of these very sources [bytes]."""
    return sum(f.stat().st_size for f in Path(cache_folder()).rglob("*") if f.is_file())


def get_ready(scene: Scene, say: Say | None = None, plain: bool = False) -> None:
    """Compile or load what a simulation needs, so that its wall time is that of the simulation."""
    if say and engine_is_cold():
        say(COMPILING)
    simulate(scene, duration=min(INSTANT, scene.duration), plain=plain)
