"""Guard process that stops a drive when the program that drives it cannot.

It runs as a script, without site packages and without fixel, so that it starts in milliseconds
and does no other work. It shares the open port with its owner and writes a feed hold and a soft
reset to it

- when a byte that is a signal's number comes from its owner;
- when the owner's pipe closes: the owner has died;
- on SIGINT (Ctrl-C reaches every process of the terminal), SIGTERM and SIGHUP;
- when a key is pressed, if it has a terminal, and when that is closed.

`q` from its owner ends it without stopping the drive.

    python -I -S stop_guard.py PORT_FD KEYS_FD(or -1)

It needs Linux or macOS, and is not started on Windows.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import time

STOP = b"!\x18"  # GRBL: feed hold, soft reset; both take effect ahead of anything that is queued
RELEASE = b"q"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def stop(port: int) -> None:
    """Discard unsent data and write the stop command."""
    with contextlib.suppress(termios.error):
        termios.tcflush(port, termios.TCOFLUSH)
    for _ in range(100):
        try:
            os.write(port, STOP)
            break
        except BlockingIOError:
            time.sleep(0.001)
        except OSError:
            return  # the drive is disconnected
    print(f"stopped {time.monotonic():.6f}", flush=True)


def watch(port: int, keys: int) -> None:
    """Watch for reasons to stop the drive, until released or until the owner has died."""
    heard, woken = os.pipe()
    os.set_blocking(woken, False)
    os.set_blocking(0, False)
    signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
    for number in SIGNALS:
        signal.signal(number, lambda *_: None)
    print("ready", flush=True)
    sources = [0, heard] + [keys] * (keys >= 0)
    while True:
        ready = select.select(sources, [], [])[0]
        said = os.read(0, 64) if 0 in ready else None
        # Other signals, such as Ctrl-Z or a resized window, are ignored.
        stops = said is not None and (not said or any(n in said for n in SIGNALS))
        if heard in ready:
            os.read(heard, 64)
            stops = True
        if keys in ready:
            stops = True
            if not pressed(keys):
                sources.remove(keys)  # the terminal was closed
        if stops:
            stop(port)
        if said is not None and (not said or RELEASE in said):
            return


def pressed(keys: int) -> bytes:
    """Read the keys typed; empty if the terminal was closed."""
    try:
        return os.read(keys, 64)
    except OSError:
        return b""


def main() -> None:
    port, keys = int(sys.argv[1]), int(sys.argv[2])
    before = None
    if keys >= 0:
        before = termios.tcgetattr(keys)
        quiet = termios.tcgetattr(keys)
        quiet[3] &= ~(termios.ICANON | termios.ECHO)  # keys at once, without echo
        termios.tcsetattr(keys, termios.TCSANOW, quiet)
    try:
        watch(port, keys)
    except BrokenPipeError:
        pass  # the owner, the reader of this pipe, has died
    finally:
        if before is not None:
            # The owner may have been killed, and no longer be the terminal's program.
            signal.signal(signal.SIGTTOU, signal.SIG_IGN)
            termios.tcsetattr(keys, termios.TCSANOW, before)
    # Without flushing, since the pipe may be closed.
    os._exit(0)


if __name__ == "__main__":
    main()
