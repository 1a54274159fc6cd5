"""Waiting for what other processes say, but not for ever."""

import threading


def line_of(process, patience_s=60.0):
    """The next line that a process writes; one that is silent for so long is killed, and a dead one
    fails the test."""
    hung = threading.Timer(patience_s, process.kill)
    hung.start()
    try:
        line = process.stdout.readline()
    finally:
        hung.cancel()
    assert line, f"{process.args} has ended, or said nothing for {patience_s:g} s"
    return line
