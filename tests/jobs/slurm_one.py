"""A real SLURM on this machine, for tests: in one folder, on loopback, gone afterwards.

Nothing under /etc is read or written. `python -m tests.jobs.slurm_one` brings one up, prints
what to put into the environment, and takes it down again on Ctrl-C.
"""

import getpass
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PROGRAMS = ("slurmctld", "slurmd", "munged", "sbatch", "squeue", "scancel", "sinfo")
PATIENCE_S = 30.0
SBIN = ("/usr/sbin", "/sbin")

# Cgroups, task binding and accounting are off: none of them exists in a container. Jobs start at
# once, and ended ones stay visible. Only loopback is listened on.
CONFIGURATION = """\
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
SlurmctldPort={controller_port}
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.%n.pid
SlurmctldLogFile={folder}/log/slurmctld.log
SlurmdLogFile={folder}/log/slurmd.%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MpiDefault=none
SwitchType=switch/none
SchedulerParameters=sched_interval=1,sched_min_interval=0,batch_sched_delay=0,bf_interval=1
MinJobAge=3600
ReturnToService=2
KillWait=2
SlurmctldTimeout=30
SlurmdTimeout=60
SlurmdParameters=config_overrides
PartitionName=main Nodes={nodes} Default=YES MaxTime=INFINITE State=UP
"""
NODE = (
    "NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=1 Boards=1 "
    "SocketsPerBoard=1 CoresPerSocket=1 ThreadsPerCore=1 RealMemory={memory} State=UNKNOWN\n"
)
# slurmd starts a cgroup plugin even where nothing uses one; version 1 without a subsystem is inert.
CGROUPS = "CgroupPlugin=cgroup/v1\nCgroupMountpoint={folder}/nocgroup\n"


def missing() -> list[str]:
    """Programs of SLURM that are not here."""
    return [name for name in PROGRAMS if _which(name) is None]


@contextmanager
def running(nodes: int = 3) -> Iterator[dict[str, str]]:
    """A SLURM with so many nodes of one core; yields what its commands need in the environment."""
    folder = Path(tempfile.mkdtemp(prefix="fixel-slurm-"))
    folder.chmod(0o755)
    environment = {"SLURM_CONF": str(folder / "slurm.conf")}
    try:
        _configure(folder, nodes)
        _start(folder, nodes, os.environ | environment)
        yield environment
    except BaseException:
        for log in sorted((folder / "log").glob("*.log")):
            print(f"== {log}", *log.read_text().splitlines()[-15:], sep="\n", file=sys.stderr)
        raise
    finally:
        _stop(folder)
        shutil.rmtree(folder, ignore_errors=True)


def _configure(folder: Path, nodes: int) -> None:
    for name in ("state", "spool", "log", "munge"):
        (folder / name).mkdir(mode=0o700)
    key = folder / "munge" / "key"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o600)
    controller_port, *ports = _free_ports(nodes + 1)
    host = socket.gethostname().split(".")[0]
    names = [f"n{k}" for k in range(nodes)]
    text = "".join(
        NODE.format(name=name, host=host, port=port, memory=_memory_mb() // nodes)
        for name, port in zip(names, ports, strict=True)
    ) + CONFIGURATION.format(
        host=host,
        user=getpass.getuser(),
        folder=folder,
        controller_port=controller_port,
        nodes=",".join(names),
    )
    (folder / "slurm.conf").write_text(text)
    (folder / "cgroup.conf").write_text(CGROUPS.format(folder=folder))
    for name in names:
        (folder / "spool" / name).mkdir()


def _start(folder: Path, nodes: int, environment: dict[str, str]) -> None:
    munge = folder / "munge"
    _run(
        environment, "munged", "--force", f"--key-file={munge}/key", f"--socket={munge}/socket",
        f"--pid-file={folder}/munged.pid", f"--seed-file={munge}/seed",
        f"--log-file={folder}/log/munged.log", "--num-threads=2",
    )  # fmt: skip
    _await(lambda: (munge / "socket").exists())
    configuration = environment["SLURM_CONF"]
    _run(environment, "slurmctld", "-f", configuration)
    for k in range(nodes):
        _run(environment, "slurmd", "-N", f"n{k}", "-f", configuration)
    _await(lambda: _idle(environment) == nodes)


def _idle(environment: dict[str, str]) -> int:
    command = ["sinfo", "-h", "-N", "-o", "%T"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=30)
    return done.stdout.split().count("idle")


def _run(environment: dict[str, str], program: str, *arguments: str) -> None:
    path = _which(program)
    assert path is not None
    done = subprocess.run(
        [path, *arguments],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=PATIENCE_S,
    )
    if done.returncode != 0:
        raise RuntimeError(f"{program}: {done.stderr.decode(errors='replace')}")


def _stop(folder: Path) -> None:
    """End what was started, each by its own number."""
    files = (*folder.glob("slurmd.*.pid"), folder / "slurmctld.pid", folder / "munged.pid")
    pids = [int(file.read_text()) for file in files if file.exists() and file.read_text().strip()]
    deadline = time.monotonic() + 3.0
    for how in (signal.SIGTERM, signal.SIGKILL):
        for pid in filter(_alive, pids):
            os.kill(pid, how)
        while any(map(_alive, pids)) and time.monotonic() < deadline:
            time.sleep(0.05)
    # Those that watch single jobs would wait for a controller that never comes back.
    for pid in _inside(folder):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _inside(folder: Path) -> Iterator[int]:
    """Numbers of processes whose working directory is in this folder."""
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if folder in (entry / "cwd").readlink().parents:
                yield int(entry.name)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def _await(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not done():
        if time.monotonic() > deadline:
            raise RuntimeError("SLURM did not come up")
        time.sleep(0.05)


def _which(program: str) -> str | None:
    path = os.pathsep.join((os.environ.get("PATH", ""), *SBIN))
    return shutil.which(program, path=path)


def _free_ports(n: int) -> list[int]:
    sockets = [socket.socket() for _ in range(n)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
    finally:
        for each in sockets:
            each.close()


def _memory_mb() -> int:
    return int(0.9 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**20)


def main() -> None:
    """Bring one up until Ctrl-C."""
    begun = time.monotonic()
    with running() as environment:
        print(f"# up after {time.monotonic() - begun:.2f} s; Ctrl-C takes it down")
        print(
            *(f"export {name}={value}" for name, value in environment.items()), sep="\n", flush=True
        )
        signal.pause()


if __name__ == "__main__":
    main()
