"""Program of the two processes of a first simulation: one compiles, one simulates without code.

It reads pickled arguments of `rollout_batch` from its input. With ``NUMBA_DISABLE_JIT=1`` it runs
them as plain Python and writes the filled record, or None after an error; it ends when its input
does. Otherwise it compiles the function for the types of the first ones, stores the code, and ends.
"""

import os
import pickle
import sys
import threading
from queue import SimpleQueue
from typing import Any

import numba
import numpy as np

from fixel.kernels.rollout import rollout_batch

_config: Any = numba.config


def _roll(requests: SimpleQueue[Any]) -> None:
    np.seterr(all="ignore")  # compiled code does not warn either
    while True:
        batch, method, record, every_step = requests.get()
        try:
            rollout_batch(batch, method, record, every_step, 0, len(record.status))
        except Exception:  # plain Python raises where compiled code continues, as with inf
            record = None
        pickle.dump(record, sys.stdout.buffer)
        sys.stdout.buffer.flush()


def _main() -> None:
    if not _config.DISABLE_JIT:
        batch, method, record, every_step = pickle.load(sys.stdin.buffer)
        rollout_batch(batch, method, record, every_step, 0, 0)
        return
    requests: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_roll, args=(requests,), daemon=True).start()
    try:
        while True:
            requests.put(pickle.load(sys.stdin.buffer))
    except EOFError:
        os._exit(0)  # in the middle of a rollout, too


if __name__ == "__main__":
    _main()
