"""First simulations after installation: plain Python answers while another process compiles.

The kernels are Python functions. Without compilation they take a hundred times as long, which is
still less than a second for a usual scene, and compute the same bits where that is tested. Batches
wait for the compiled code. docs/decisions/0041 has the reasons and the figures.
"""

from __future__ import annotations

import os
import pickle
import platform
import select
import subprocess
import sys
import threading
import time
from typing import Any, Final

import numba

from fixel.kernels import code_cache
from fixel.kernels.arrays import Batch, BatchRecord, StepMethod
from fixel.kernels.code_cache import cache_folder, is_stored, print_once, share_compiled
from fixel.kernels.rollout import rollout_batch
from fixel.progress import show_progress

ENTRY: Final = "rollout.rollout_batch"
GLANCE_S: Final = 0.05  # time between two looks at the other processes
IN_BACKGROUND: Final = (
    "Compiling numerical code in the background: once for this version, about a minute. Until then "
    "simulations run as plain Python and take longer, with the same results. `fixel compile` does "
    "it in advance."
)
# Where plain Python is known to compute the same bits: arithmetic of IEEE 754 without contraction,
# and sine, cosine and powers of the same library of C.
SAME_BITS: Final = (
    sys.platform == "linux"
    and platform.machine() == "x86_64"
    and not getattr(numba.config, "USING_SVML", False)
)
code_cache.show = show_progress
_turn = threading.Lock()
_settled = False  # whether the code need not be waited for any more
_compiling: subprocess.Popen[bytes] | None = None
_plain: subprocess.Popen[bytes] | None = None


def is_missing() -> bool:
    """Whether no usable machine code of rollouts is loaded or stored."""
    global _settled
    if not _settled:
        compiled: Any = rollout_batch
        _settled = not hasattr(compiled, "signatures") or bool(
            compiled.signatures or is_stored(ENTRY)
        )
    return not _settled


def wait_for_code() -> None:
    """Wait for another process that compiles; without one, or if it dies, this process compiles."""
    global _settled
    with show_progress(stage="compiling") as report:
        while _is_compiled_elsewhere():
            report(int(1000 * (share_compiled(ENTRY) or 0.0)), 1000)
            time.sleep(GLANCE_S)
    _settled = True


def roll_in_python(batch: Batch, method: StepMethod, record: BatchRecord, every_step: bool) -> bool:
    """Simulate in a process without compilation; False where compiled code is there or needed.

    It starts the compilation, too, if no process compiles. Arguments as for `rollout_batch`.
    """
    with _turn:
        request = (batch, method, record, every_step)
        if not SAME_BITS or not _start(request):
            return False
        answer = None
        try:
            answer = _answer(request)
        finally:
            if answer is None:
                _end_plain()
        if answer is None:
            return False
        for own, new in zip(record, answer, strict=True):
            own[...] = new
        return True


def _start(request: tuple[Any, ...]) -> bool:
    """Start the processes that do not run; False if the code could not be stored or started."""
    global _compiling, _plain
    try:
        if not _is_compiled_elsewhere():
            os.makedirs(cache_folder(), exist_ok=True)
            if _compiling is not None or not os.access(cache_folder(), os.W_OK):
                return False
            _compiling = _child({})
            batch, method, record, every_step = request
            empty = BatchRecord._make(own[:0] for own in record)  # more would have to be read first
            _send(_compiling, (batch, method, empty, every_step))
        if _plain is None:
            print_once(IN_BACKGROUND)
            _plain = _child({"NUMBA_DISABLE_JIT": "1"})
    except OSError:
        return False
    return True


def _is_compiled_elsewhere() -> bool:
    return (_compiling is not None and _compiling.poll() is None) or (
        share_compiled(ENTRY) is not None
    )


def _child(changes: dict[str, str]) -> subprocess.Popen[bytes]:
    """Start a process that finds the modules of this one; Ctrl-C in the terminal spares it."""
    path = os.pathsep.join(map(os.path.abspath, sys.path))
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "fixel.kernels.child"],
        env={**os.environ, "PYTHONPATH": path, **changes},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE if changes else subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _send(process: subprocess.Popen[bytes], request: tuple[Any, ...]) -> None:
    assert process.stdin is not None
    pickle.dump(request, process.stdin)
    process.stdin.flush()


def _answer(request: tuple[Any, ...]) -> BatchRecord | None:
    """Return the record filled by plain Python; None if the code was compiled before, or after an
    error."""
    assert _plain is not None
    assert _plain.stdout is not None
    try:
        _send(_plain, request)
        while not select.select([_plain.stdout], [], [], GLANCE_S)[0]:
            if not _is_compiled_elsewhere():
                return None
        answer: BatchRecord | None = pickle.load(_plain.stdout)
    except (OSError, EOFError, pickle.UnpicklingError):  # the process died
        return None
    return answer


def _end_plain() -> None:
    global _plain
    if _plain is not None:
        _plain.kill()
        _plain.communicate()
        _plain = None


def _forget_processes() -> None:
    """Start again in a forked process, which must not talk to those of another."""
    global _turn, _compiling, _plain
    _turn = threading.Lock()
    _compiling = _plain = None


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_forget_processes)
