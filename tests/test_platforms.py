"""fixel without what only Linux has: every module imports, and what cannot work says so."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.system

# Runs in a process of its own. Other packages are imported first: they choose by the real platform,
# as Numba does when it compiles, so nothing is simulated here.
SCRIPT = """
import ctypes, importlib, os, pkgutil, signal, sys, tempfile
from pathlib import Path

LINUX = "sched_getaffinity sched_setaffinity posix_fallocate posix_fadvise".split()
POSIX = (
    "fork forkpty getuid geteuid getgid getegid statvfs pwrite pread killpg getpgid setsid mkfifo"
    " uname getloadavg ttyname openpty fchmod chown nice waitid WNOHANG O_NOCTTY O_NONBLOCK"
    " ST_RDONLY set_blocking"
).split()
SIGNALS = (
    "SIGKILL SIGHUP SIGSTOP SIGCONT SIGALRM SIGUSR1 setitimer pthread_kill pthread_sigmask"
).split()
MODULES = "fcntl termios pty tty pwd grp resource syslog posix".split()
SCRIPTS = ("fixel.testbed.stop_guard",)  # a program, which is started on POSIX only


class Locking:
    LK_NBLCK = 2
    owners = {}

    @classmethod
    def locking(cls, descriptor, how, size):
        if cls.owners.setdefault(os.fstat(descriptor).st_ino, descriptor) != descriptor:
            raise PermissionError(13, "Permission denied")


class Kernel:
    def OpenProcess(access, inherit, pid):
        return pid

    def GetExitCodeProcess(handle, code):
        code._obj.value = 259 if handle == os.getpid() else 1

    def CloseHandle(handle):
        pass


def import_all():
    import fixel
    from fixel.engine_names import ENGINES, installed_engines

    # An adapter needs its engine, of which Drake is not installed everywhere.
    absent = {
        module
        for name, own in ENGINES.items()
        if name not in installed_engines()
        for module in (
            f"fixel.simulation.engines.{own.module}",
            f"fixel.simulation.engines.scripts.run_{name}",
        )
    }
    for module in pkgutil.walk_packages(fixel.__path__, "fixel."):
        if module.name not in {*SCRIPTS, *absent} and "migrations" not in module.name:
            importlib.import_module(module.name)


def without(holder, words):
    for word in words:
        if hasattr(holder, word):
            delattr(holder, word)


def refusal(what):
    from fixel.errors import FixelError

    try:
        what()
    except FixelError as refused:
        print(refused)


def use(platform):
    sys.platform = platform
    for name in [m for m in sys.modules if m == "fixel" or m.startswith("fixel.")]:
        del sys.modules[name]
    import_all()
    from fixel.database.project import Project
    from fixel.io.journal import Journal, read_journal, writer_of
    from fixel.io.lock import is_running
    from fixel.jobs.link import require_dask
    from fixel.testbed.emergency import stop_drive
    from fixel.testbed.emulators.grbl import EmulatedGrbl
    from fixel.workflows.installation import machine

    print(platform)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "journal"
        with Journal(path) as journal:
            journal.append([("a", b"1")])
            assert writer_of(path).pid == os.getpid()
            refusal(lambda: Journal(path))
        assert list(read_journal(path)) == [("a", b"1")]
        project = Project.create(Path(folder) / "lab")
        with project.store() as store:
            assert store.experiments().total == 0
    assert is_running(os.getpid()) and not is_running(0)
    assert machine()["cores"] > 0
    if platform == "win32":
        refusal(require_dask)
        refusal(EmulatedGrbl)
        refusal(lambda: stop_drive("COM5"))


import_all()
without(os, LINUX)
use("darwin")
without(os, POSIX)
without(signal, SIGNALS)
sys.modules.update(dict.fromkeys(MODULES), msvcrt=Locking)
os.kill = lambda *_: sys.exit("os.kill ends a process of Windows, or sends it Ctrl-C")
ctypes.windll = type("windll", (), {"kernel32": Kernel})
use("win32")
"""


def test_every_module_imports_on_macos_and_windows() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    macos, lock, windows, also, workers, drive, stop = done.stdout.splitlines()
    assert (macos, windows) == ("darwin", "win32")
    assert "is in use by process" in lock
    assert "is in use by process" in also
    assert workers.startswith("several workers need Linux or macOS")
    assert "fixel needs Linux or macOS" in drive
    assert "power of the drive" in stop
