"""Stop a running command with Enter, Ctrl-C or a termination signal."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class StopWish:
    """Request to stop, with its reason."""

    def __init__(self) -> None:
        self.reason = ""

    def __call__(self) -> str:
        """Return the reason to stop; empty while there is none."""
        return self.reason


@contextmanager
def stop_on_request() -> Iterator[StopWish]:
    """Collect requests to stop: Enter, Ctrl-C, SIGTERM; a second Ctrl-C interrupts at once."""
    wish = StopWish()

    def asked(number: int, frame: FrameType | None) -> None:
        wish.reason = "stopped with Ctrl-C" if number == signal.SIGINT else "asked to stop"
        signal.signal(number, signal.default_int_handler)

    kept: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        kept = {n: signal.signal(n, asked) for n in (signal.SIGINT, signal.SIGTERM)}
    if sys.stdin is not None and sys.stdin.isatty():
        threading.Thread(target=_wait_for_enter, args=(wish,), daemon=True).start()
    try:
        yield wish
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def _wait_for_enter(wish: StopWish) -> None:
    if sys.stdin.readline():
        wish.reason = wish.reason or "stopped with Enter"
