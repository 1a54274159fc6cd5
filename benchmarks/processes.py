"""What a user waits for outside the simulation: start-up, the first compilation, memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from benchmarks.figures import Figure, Size, at_most, seconds

REPOSITORY = Path(__file__).resolve().parents[1]

HEAVY = (
    "numpy", "numba", "llvmlite", "scipy", "pydantic", "shapely", "matplotlib", "pyarrow",
    "PIL", "av",
)  # fmt: skip

HELP = f"""
import json, sys
from fixel.cli.main import run
try:
    run(["--help"])
except SystemExit:
    pass
print(json.dumps([name for name in {HEAVY!r} if name in sys.modules]))
"""

SIMULATE = """
from fixel import simulate
from fixel.testing.scenes import grasp
assert simulate(grasp()).converged
"""

COMPILE = """
from fixel.simulation import Simulator
from fixel.testing.scenes import grasp
Simulator(grasp()).ends(duration=1e-6)
"""

# VmHWM belongs to this program alone; ru_maxrss would begin with the memory of its parent.
BATCH = """
import json, resource, sys
from fixel import simulate_batch
from fixel.testing.scenes import grasp
from benchmarks.accuracy import random_sets
n = int(sys.argv[1])
simulate_batch(grasp(), random_sets(n))
kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    with open("/proc/self/status") as lines:
        kilobytes = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
except OSError:
    pass
print(json.dumps(kilobytes))
"""


def run_start(size: Size) -> list[Figure]:
    """`fixel --help`, and the first simulation of a process whose kernels are compiled."""
    command = [_script("fixel"), "--help"]
    package = [sys.executable, "-c", "import fixel"]
    loaded = json.loads(_python(HELP).splitlines()[-1])
    return [
        Figure("import fixel", "s", _timed(package, size.repeats), at_most(0.1)),
        Figure("fixel --help", "s", _timed(command, size.repeats), at_most(0.2)),
        Figure("fixel --help, heavy packages loaded", "-", (float(len(loaded)),), at_most(0.0)),
        Figure(
            "first simulation of a process",
            "s",
            _timed([sys.executable, "-c", SIMULATE], size.repeats),
            at_most(1.5),
        ),
    ]


def run_wheel(size: Size) -> list[Figure]:
    """The package that pip installs."""
    with tempfile.TemporaryDirectory() as folder:
        _run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder])
        (wheel,) = Path(folder).glob("*.whl")
        megabytes = wheel.stat().st_size / 1e6
    return [Figure("wheel", "MB", (megabytes,), at_most(2.0))]


def run_compile(size: Size) -> list[Figure]:
    """The first simulation ever, with nothing compiled, and the time until batches can run."""
    with tempfile.TemporaryDirectory() as folder:
        taken: list[float] = []
        for program in (SIMULATE, COMPILE):  # the second waits for what the first one started
            run = partial(_run, [sys.executable, "-c", program], {"FIXEL_CACHE_DIR": folder})
            taken += seconds(run, repeats=1, warm_up=False)
    return [
        Figure("first simulation ever", "s", (taken[0],), at_most(25.0)),
        Figure("numerical code compiled after it", "s", (taken[1],), at_most(60.0)),
    ]


def run_memory(size: Size) -> list[Figure]:
    """Peak memory of a process that simulates one batch, Python and packages included."""
    _python(BATCH, "1")  # compiles, where that is still to do
    megabytes = json.loads(_python(BATCH, str(size.rollouts)).splitlines()[-1]) * 1024 / 1e6
    return [Figure(f"memory, {size.rollouts} rollouts", "MB", (megabytes,), at_most(500.0))]


def _script(name: str) -> str:
    """A console script of the environment this Python belongs to."""
    return str(Path(sys.executable).with_name(name))


def _timed(command: list[str], repeats: int) -> tuple[float, ...]:
    return seconds(lambda: _run(command), repeats)


def _python(program: str, *arguments: str) -> str:
    return _run([sys.executable, "-c", program, *arguments])


def _run(command: list[str], environment: dict[str, str] | None = None) -> str:
    done = subprocess.run(
        command,
        env=os.environ | (environment or {}),
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}: {done.stderr[-500:]}")
    return done.stdout
