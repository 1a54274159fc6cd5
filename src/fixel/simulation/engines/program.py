"""Engine in a process of its own, which answers lines of JSON.

The protocol is described in `docs/how-to/engines.md`.
"""

from __future__ import annotations

import contextlib
import json
import os
import reprlib
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, final

from fixel.errors import InvalidInput
from fixel.model.parameters import ParameterInfo
from fixel.simulation.engines.contract import EngineInfo
from fixel.trust import check_command

PROTOCOL = 1
START_LIMIT = 60.0  # [s] until a program answers for the first time: some load large libraries
MAX_ANSWER = 64 << 20  # [bytes] of one line
CHECK_PERIOD = 0.2  # [s] between two checks that a silent program still runs
KEPT_ERRORS = 2000  # [bytes] of standard error that a reason quotes


class ProgramFailed(Exception):
    """Exception raised when a program gives no usable answer; its text is the reason."""


@final
class Program:
    """Process of an engine. It is started at the first question, and again after a failure.

    Its command is started only with the permission of `fixel.trust`.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self.command = tuple(command)
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: Path | None = None
        self._rest = b""
        self._info: EngineInfo | None = None
        self._asking = threading.Lock()  # pages simulate in several threads

    def ask(self, question: Mapping[str, Any], limit: float) -> dict[str, Any]:
        """Send a question and return the answer.

        Raises
        ------
        ProgramFailed
            No answer within `limit` [s], the end of the program, or an answer that is no JSON
            object. The program is ended.
        """
        with self._asking:
            try:
                self._start()
                return self._exchange(question, limit)
            except BaseException:  # with Ctrl-C between them, the next answer would be an old one
                self.close()
                raise

    def info(self) -> EngineInfo:
        """Return name, version and parameters, as the program states them."""
        with self._asking:
            self._start()
        assert self._info is not None
        return self._info

    def close(self) -> None:
        """End the program, with all processes that it started."""
        process, self._process, self._rest = self._process, None, b""
        if process is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    with contextlib.suppress(OSError):
                        stream.close()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def _start(self) -> None:
        if self._process is not None and self._process.poll() is None:
            return
        self.close()
        check_command(self.command)
        # Engines write logs into the working folder.
        self._folder = Path(tempfile.mkdtemp(prefix="fixel-engine-"))
        try:
            with (self._folder / "stderr").open("wb") as errors:
                self._process = subprocess.Popen(
                    self.command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    cwd=self._folder,
                    start_new_session=True,
                    env={**os.environ, "OMP_NUM_THREADS": "1"},
                )
            program = next(word for word in self.command if word != sys.executable)
            self._info = _info(program, self._exchange({"hello": PROTOCOL}, START_LIMIT))
        except OSError as problem:
            self.close()
            found = f"{self.command[0]}, which cannot be started: {problem.strerror}"
            expected = "a program that can be run"
            raise InvalidInput("engine", found=found, expected=expected) from None
        except BaseException:  # or the next question would go to a program that gave no name
            self.close()
            raise

    def _exchange(self, question: Mapping[str, Any], limit: float) -> dict[str, Any]:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(question).encode() + b"\n")
            process.stdin.flush()
        except OSError:
            raise ProgramFailed(self._ended()) from None
        line = self._line(limit)
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):  # deeper nesting than Python reads
            answer = None
        if not isinstance(answer, dict):
            raise ProgramFailed(f"found {line[:60]!r}, but fixel needs a JSON object")
        return answer

    def _line(self, limit: float) -> bytes:
        """Read one line; raise when it is late, too long or never complete."""
        assert self._process is not None
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        until = time.monotonic() + limit
        blocks, size = [self._rest], len(self._rest)
        with selectors.DefaultSelector() as ready:
            ready.register(pipe, selectors.EVENT_READ)
            while b"\n" not in blocks[-1]:
                if size > MAX_ANSWER:
                    raise ProgramFailed(f"an answer of more than {MAX_ANSWER >> 20} MB")
                if not self._waits_for(ready, until):
                    raise ProgramFailed(f"no answer within {limit:.3g} s")
                block = os.read(pipe, 1 << 16)
                if not block:
                    raise ProgramFailed(self._ended())
                blocks.append(block)
                size += len(block)
        line, _, self._rest = b"".join(blocks).partition(b"\n")
        return line

    def _waits_for(self, ready: selectors.BaseSelector, until: float) -> bool:
        """Wait for output; return False when it is late, raise when the program has ended.

        A child of the program may still have the pipe, whose end would not come.
        """
        assert self._process is not None
        while not ready.select(max(0.0, min(CHECK_PERIOD, until - time.monotonic()))):
            if self._process.poll() is not None and not ready.select(0.0):
                raise ProgramFailed(self._ended())
            if time.monotonic() >= until:
                return False
        return True

    def _ended(self) -> str:
        """Describe the end of the process, with the last line that it wrote as an error."""
        assert self._process is not None
        assert self._folder is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        code = self._process.poll()
        how = "closed its output" if code is None else f"ended with status {code}"
        if code is not None and code < 0:
            how = f"ended by signal {signal.Signals(-code).name}"
        with (self._folder / "stderr").open("rb") as errors:
            errors.seek(0, os.SEEK_END)
            errors.seek(max(0, errors.tell() - KEPT_ERRORS))
            said = errors.read().decode(errors="replace").strip().splitlines()
        return f"the program {how}" + (f": {said[-1]}" if said else "")


def _info(command: str, answer: Mapping[str, Any]) -> EngineInfo:
    try:
        parameters = {
            str(name): ParameterInfo(
                str(own.get("unit", "-")),
                str(own.get("meaning", "")),
                float(own.get("lowest", -float("inf"))),
                bool(own.get("above", False)),
            )
            for name, own in dict(answer.get("parameters", {})).items()
        }
    except (AttributeError, TypeError, ValueError, RecursionError):
        found = f"parameters {reprlib.repr(answer.get('parameters'))}"
        expected = 'an object such as {"grip": {"unit": "-", "meaning": "...", "lowest": 0}}'
        raise InvalidInput(f"engine {command}", found=found, expected=expected) from None
    name = text_of(answer.get("name", Path(command).stem))
    return EngineInfo(name, text_of(answer.get("version", "")), parameters)


def text_of(value: object) -> str:
    """Return a text of an answer, of limited depth if it is something else."""
    return value if isinstance(value, str) else reprlib.repr(value)
