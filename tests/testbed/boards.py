"""Things at the other end of a serial port that are not the tactile board."""

import os
import pty
import threading
import tty
from collections.abc import Callable
from contextlib import contextmanager


@contextmanager
def stranger(answer: Callable[[bytes], bytes]):
    """A port where every read is answered by a function; yields its name."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            try:
                heard = os.read(master, 256)
            except OSError:
                return
            if ended.is_set():
                return
            said = answer(heard)
            if said:
                os.write(master, said)

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        os.write(slave, b"\0")  # wakes the server
        server.join(2.0)
        os.close(slave)
        os.close(master)
