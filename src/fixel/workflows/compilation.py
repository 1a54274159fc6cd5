"""Compile the engine before it is used, and report whether it is compiled."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final, final

import numpy as np

from fixel.kernels import jit
from fixel.kernels.code_cache import BEAT_S, cache_folder, is_stored, share_compiled
from fixel.model import Trajectory
from fixel.progress import ProgressOption, show_progress
from fixel.simulation import Lemke, Simulator, simulate
from fixel.simulation.first_code import ENTRY
from fixel.simulation.simulate import INSTANT
from fixel.testing import scenes


def engine_is_cold() -> bool:
    """Whether no usable machine code of the simulation is stored."""
    return not is_stored(ENTRY)


def cache_size() -> int:
    """Size of the compiled kernels of this version of the sources [bytes]."""
    return sum(f.stat().st_size for f in Path(cache_folder()).rglob("*") if f.is_file())


@final
@dataclass(frozen=True, slots=True)
class CompiledPart:
    """Part of the numerical code, compiled in a process of its own."""

    name: str
    seconds: float  # wall time of compiling [s]; 0 if the code was stored before
    problem: str  # why it failed; empty if it did not


def compile_kernels(progress: ProgressOption = None) -> list[CompiledPart]:
    """Compile all numerical code and store it, in two processes; return its parts.

    Those that were stored before took no time. Those of extras that are not installed are left out.
    """
    with ThreadPoolExecutor(2) as pool, show_progress(progress, "compiling") as report:
        names = [name for name in _PARTS if find_spec(_NEEDED.get(name, "numba"))]
        running = [pool.submit(_compiled, name) for name in names]
        while not all(one.done() for one in running):
            done = sum(one.done() for one in running)
            share = 0.0 if running[0].done() else share_compiled(ENTRY) or 0.0
            report(int(100 * (done + share)), 100 * len(running), f"{done} of {len(running)} parts")
            time.sleep(BEAT_S)
        return [one.result() for one in running]


def _compiled(name: str) -> CompiledPart:
    command = [sys.executable, "-P", "-m", "fixel.workflows.compilation", name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"ended with status {done.returncode}"])[-1]
        return CompiledPart(name, 0.0, last)
    return CompiledPart(name, float(done.stdout.split()[-1]), "")


def _rollouts() -> None:
    Simulator(scenes.sliding_block()).ends(duration=INSTANT)


def _environments() -> None:
    from fixel.environments.push_t import PushTEnv

    _rollouts()  # waits for the other process
    task = PushTEnv(render_mode="rgb_array")
    task.reset(seed=1)
    task.step(np.zeros(2))
    task.render()


def _vision() -> None:
    from fixel.formats.rig_file import rig_of
    from fixel.vision.render import changed, film_scene, looks_named
    from fixel.vision.tracking import track

    scene, times = scenes.grasp(), np.arange(12) / 30.0
    poses = {own.name: own.pose for own in scene.bodies}
    poses |= {own.name: own.pose for own in scene.pushers}
    rest = {name: Trajectory(time=[0, 1], pose=[pose] * 2) for name, pose in poses.items()}
    looks = changed(looks_named("thesis"), ["occlusion=0.1"])  # a hand covers part of a tag
    for rig in map(rig_of, ("thesis-tags", "thesis-stickers")):
        track(film_scene(scene, rest, rig, looks, times), rig, scene)


# The longest is first; the others, in the other process, do not wait for its code.
_PARTS: Final[dict[str, Callable[[], object]]] = {
    "rollouts, with all motion models and solvers": _rollouts,
    "single steps: plain loop and Lemke's method": lambda: simulate(
        scenes.grasp(support_directions=8), solver=Lemke(), plain=True
    ),
    "contact modes: accuracy and derivatives": lambda: simulate(
        scenes.pushed_square(), motion="quasistatic", accuracy=True, derivatives=["mu_pusher"]
    ),
    "films: rendering and tracking": _vision,
    "environments": _environments,
}
# Package of an extra that a part needs; without it the part is left out.
_NEEDED: Final = {"films: rendering and tracking": "cv2", "environments": "gymnasium"}

if __name__ == "__main__":
    _PARTS[sys.argv[1]]()
    print(jit.compiled_s)
