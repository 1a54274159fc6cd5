"""An installation of fixel: compile the engine before it is used, and check what is installed."""

from __future__ import annotations

import functools
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel import simulation
from fixel.errors import MissingExtra, os_reason
from fixel.kernels import jit
from fixel.kernels.code_cache import BEAT_S, cache_folder, is_stored, print_once, share_compiled
from fixel.model import Trajectory
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.first_code import ENTRY
from fixel.simulation.simulate import INSTANT, get_ready
from fixel.testing import scenes


def engine_is_cold() -> bool:
    """Whether no usable machine code of the simulation is stored."""
    return not is_stored(ENTRY)


def cache_size() -> int:
    """Size of the compiled kernels of this version of the sources [bytes]."""
    return sum(f.stat().st_size for f in Path(cache_folder()).rglob("*") if f.is_file())


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
    command = [sys.executable, "-P", "-m", "fixel.workflows.installation", name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"ended with status {done.returncode}"])[-1]
        return CompiledPart(name, 0.0, last)
    return CompiledPart(name, float(done.stdout.split()[-1]), "")


def _rollouts() -> None:
    simulation.Simulator(scenes.sliding_block()).ends(duration=INSTANT)


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
    "single steps: plain loop and Lemke's method": lambda: simulation.simulate(
        scenes.grasp(support_directions=8), solver=simulation.Lemke(), plain=True
    ),
    "contact modes: accuracy and derivatives": lambda: simulation.simulate(
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


PACKAGES = ("numpy", "numba", "scipy", "shapely", "matplotlib", "pillow", "pyarrow", "av")

# Largest natural-map residual of any step, as published collections of problems require.
RESIDUAL = 1e-8
# Largest distance of the solvers' results after the same steps [m]: rounding.
AGREEMENT = 1e-7
# Largest relative error of the adaptive stepper against a closed-form answer.
CLOSED_FORM = 2e-3
Found = tuple[bool, str, float | None]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Result of checking the installation."""

    versions: dict[str, str]
    machine: dict[str, Any]  # platform, cores that this process may use, threads of a batch
    # Folder of compiled kernels, its size [bytes], and whether they were compiled before.
    cache: dict[str, Any]
    checks: list[SelfCheck]
    seconds: float  # duration of all checks [s]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    def summary(self) -> dict[str, Any]:
        """Return the answer of `fixel doctor --json`."""
        worst = worst_residual(self.checks)
        return {"passed": self.passed, "max_residual": worst, **asdict(self)}


def examine() -> Diagnosis:
    """Collect versions, cores and the cache of compiled kernels, and run the self-test."""
    start = time.perf_counter()
    stored = _cache_check()
    if not stored.passed:
        print_once(f"Every process compiles all code again, which takes minutes: {stored.detail}")
    warm = not engine_is_cold()
    get_ready(scenes.sliding_block())
    get_ready(scenes.grasp(support_directions=8), simulation.Lemke())
    checks = [stored, _film_check(), _bench_check(), *self_test()]
    cache = {"folder": cache_folder(), "bytes": cache_size(), "warm": warm}
    return Diagnosis(versions(), machine(), cache, checks, time.perf_counter() - start)


def versions() -> dict[str, str]:
    """Versions of fixel, Python and the packages that fixel uses."""
    found = {"fixel": _version("fixel"), "python": platform.python_version()}
    return found | {name: _version(name) for name in PACKAGES}


@functools.cache  # they do not change while this process runs
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


def machine() -> dict[str, Any]:
    """Platform, cores that this process may use, threads of a batch."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    threads = os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()
    return {"platform": platform.platform(terse=True), "cores": usable, "threads": threads}


def _cache_check() -> SelfCheck:
    name = "compiled kernels can be stored"
    folder = Path(cache_folder())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as problem:
        reason = os_reason(problem)
        hint = "set FIXEL_CACHE_DIR to a folder with write permission"
        return SelfCheck(name, False, f"{folder}: {reason}; {hint}")
    return SelfCheck(name, True, "the cache folder can be written to")


def _film_check() -> SelfCheck:
    name = "films can be written"
    try:
        import av
        from av.codec import Codec
    except ModuleNotFoundError:
        return SelfCheck(name, True, "as .gif; .mp4 needs pip install 'fixel[video]'")
    except ImportError as problem:
        return SelfCheck(name, False, f"{problem}")
    for codec, what in (("libx264", "H.264"), ("mpeg4", "MPEG-4, as H.264 is missing")):
        try:
            Codec(codec, "w")
        except (av.FFmpegError, ValueError):
            continue
        return SelfCheck(name, True, what)
    return SelfCheck(name, False, "PyAV came without H.264 and MPEG-4; write .gif files")


def _bench_check() -> SelfCheck:
    """Report cameras and serial ports; having none is no failure."""
    from fixel.testbed.serial_port import found_ports

    found = [f"/dev/{path.name}" for path in sorted(Path("/dev").glob("video*"))]
    with suppress(MissingExtra):
        found += [port.port for port in found_ports()]
    return SelfCheck("cameras and serial ports", True, ", ".join(found) or "none; optional")


@dataclass(frozen=True, slots=True)
class SelfCheck:
    """Result of one check of the self-test."""

    name: str  # property that was checked
    passed: bool
    detail: str  # result in words
    residual: float | None = None  # largest residual of any step, if steps were solved


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


def _steps(run: simulation.Simulation) -> Found:
    return run.converged, f"{run.status}, {run.steps} steps", run.max_residual


def _seats() -> Found:
    run = simulation.simulate(scenes.grasp("seated"))
    trace = run.pushers["actuator"]
    fine = run.converged and bool(trace.stalled[-1])
    fine = fine and abs(float(trace.force[-1]) - scenes.STALL_FORCE) < 1e-6 * scenes.STALL_FORCE
    return fine, f"{run.status}, {trace.force[-1]:.6g} N", run.max_residual


def _jams() -> Found:
    run = simulation.simulate(scenes.grasp("seated", force_limit=None))
    when = "" if run.stopped_at is None else f" at {run.stopped_at:.3f} s"
    return run.status == "jammed", run.status + when, run.max_residual


def _slides() -> Found:
    run = simulation.simulate(scenes.sliding_block(speed=0.5, friction=0.25))
    return _compared(run, float(run.pose["block"][-1][0]), 0.5**2 / (2.0 * 0.25 * 9.81), "m")


def _spins() -> Found:
    run = simulation.simulate(scenes.spinning_disk(spin=10.0, friction=0.25))
    # At constant deceleration it turns by half of what it would turn at full speed.
    stop = 3.0 * 0.05 * 10.0 / (4.0 * 0.25 * 9.81)
    return _compared(run, float(run.pose["disk"][-1][2]), 0.5 * 10.0 * stop, "rad")


def _compared(run: simulation.Simulation, found: float, expected: float, unit: str) -> Found:
    off = abs(found / expected - 1.0)
    detail = f"{found:.6g} {unit}, {100.0 * off:.2g} % off"
    return run.converged and off < CLOSED_FORM, detail, run.max_residual


def _agree() -> Found:
    scene = scenes.grasp("slip", support_directions=8)
    stepper = simulation.StewartTrinkle(step=0.05)
    runs = [
        simulation.simulate(scene, stepper=stepper, solver=s())
        for s in (simulation.Newton, simulation.GaussSeidel, simulation.Lemke)
    ]
    ends = np.array([run.pose["object"][-1] for run in runs])
    apart = float(np.abs(ends - ends[0]).max())
    worst = max(run.max_residual for run in runs)
    fine = all(run.converged for run in runs) and apart < AGREEMENT
    return fine, f"at most {apart:.1e} m apart", worst


def _same_bits() -> Found:
    radii = {"tripod_radius": np.linspace(0.03, 0.05, 16)}
    one, two = (simulation.simulate_batch(scenes.grasp("slip"), radii, threads=n) for n in (1, 2))
    same = bool(np.array_equal(one.pose, two.pose))
    return same, "the same bits" if same else "different", float(one.max_residual.max())


_CHECKS: dict[str, Callable[[], Found]] = {
    "grasp seats, drive stalls at 34.3 N": _seats,
    "rigid drive jams, with status jammed": _jams,
    "block stops after v^2 / 2 mu g": _slides,
    "disk stops spinning after 3 R w / 4 mu g": _spins,
    "push of a 1.6 mm part, without inertia": lambda: _steps(
        simulation.simulate(scenes.micro_push(), motion=simulation.QuasiStatic())
    ),
    "heap of nine bodies": lambda: _steps(simulation.simulate(scenes.heap(9, duration=0.5))),
    "newton, gauss-seidel, lemke agree": _agree,
    "one thread and two agree": _same_bits,
}
