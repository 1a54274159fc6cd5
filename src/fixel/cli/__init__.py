"""Command line: parse arguments, call a workflow, print the result."""

import os
import signal
import sys
from typing import Any


def run() -> None:
    """Run the `fixel` command; Ctrl-C while its modules load ends it with one sentence.

    It ends silently if its output is not read to the end, as by `head`.
    """
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:  # a shell ignores it for its background
        signal.signal(signal.SIGINT, _stop)
    from fixel.cli import main

    signal.signal(signal.SIGINT, usual)
    try:
        main.run()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python flushes the output at its end
        sys.exit(141)


def _stop(*_: Any) -> None:
    # An exception could be lost, or become another one, in the module that is loading.
    os.write(2, b"fixel: stopped.\n")
    os._exit(130)
