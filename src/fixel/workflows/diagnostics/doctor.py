"""Check an installation of fixel."""

from __future__ import annotations

import functools
import os
import platform
import tempfile
import time
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, final

from fixel.errors import InvalidInput, os_reason
from fixel.kernels.jit import cache_folder
from fixel.simulation import Lemke
from fixel.testing import scenes
from fixel.typing import Notify
from fixel.workflows.compilation import cache_size, engine_is_cold, get_ready
from fixel.workflows.diagnostics.self_test import SelfCheck, self_test, worst_residual

PACKAGES = ("numpy", "numba", "scipy", "shapely", "matplotlib", "pyarrow", "av", "pillow")


@final
@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Result of checking the installation.

    Attributes
    ----------
    versions : dict from name to str
    machine : dict
        Platform, cores that this process may use, threads of a batch.
    cache : dict
        Folder of compiled kernels, its size [bytes], and whether they were compiled before.
    checks : list of SelfCheck
    seconds : float
        Duration of all checks [s].
    """

    versions: dict[str, str]
    machine: dict[str, Any]
    cache: dict[str, Any]
    checks: list[SelfCheck]
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    def summary(self) -> dict[str, Any]:
        """Return the answer of `fixel doctor --json`."""
        worst = worst_residual(self.checks)
        return {"passed": self.passed, "max_residual": worst, **asdict(self)}


def examine(notify: Notify | None = None) -> Diagnosis:
    """Collect versions, cores and the cache of compiled kernels, and run the self-test.

    Parameters
    ----------
    notify : callable, optional
        Called with a sentence before long operations.
    """
    start = time.perf_counter()
    warm = not engine_is_cold()
    get_ready(scenes.sliding_block(), notify)
    get_ready(scenes.grasp(support_directions=8), notify, Lemke())
    checks = [_cache_check(), _film_check(), _bench_check(), *self_test()]
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
    name = "compiled kernels can be kept"
    folder = Path(cache_folder())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as problem:
        reason = os_reason(problem)
        hint = "set FIXEL_CACHE_DIR to a folder one may write to"
        return SelfCheck(name, False, f"{folder}: {reason}; {hint}")
    return SelfCheck(name, True, "the cache folder can be written to")


def _film_check() -> SelfCheck:
    name = "films can be written"
    try:
        import av
        from av.codec import Codec
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
    name = "cameras and serial ports"
    found = _cameras() + _serial_ports()
    return SelfCheck(name, True, ", ".join(found) if found else "none, fine")


def _cameras() -> list[str]:
    return [f"/dev/{path.name}" for path in sorted(Path("/dev").glob("video*"))]


def _serial_ports() -> list[str]:
    from fixel.testbed.serial_port import found_ports

    try:
        return [port.port for port in found_ports()]
    except InvalidInput:
        return []  # pyserial is an extra
