"""Files in the folder of a job by which its processes communicate.

    connection.json     address of the scheduler; missing while there is none
    tls/                key and certificate that all processes of the job share
    workers/            one file per worker that has joined or refused, and its log
    late/               answers of workers whose scheduler was lost

On a cluster the workers read them on a shared file system and need nothing else.
"""

from __future__ import annotations

import datetime
import json
import os
import shutil
import socket
import sys
import threading
import zlib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from fixel.errors import JobRefused, check_name
from fixel.io.atomic import write_whole
from fixel.io.lock import Owner, read_owner

LOOPBACK: Final = "lo"
REFUSED: Final = 3  # exit code of a worker of another fixel
# Clocks of nodes may differ by hours, so a certificate is valid from one day ago.
_VALID_FROM: Final = datetime.timedelta(days=-1)
_VALID_UNTIL: Final = datetime.timedelta(days=365)
_CRC_BYTES: Final = 4
# Deaths of workers are reported at once: the coordinator counts them itself and tries again.
CONFIG: Final = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.work-stealing": False,
    "distributed.admin.tick.limit": "1h",  # no warnings of long pauses
}


def require_dask() -> None:
    """Raise `JobRefused` if the packages for several workers are not installed."""
    if sys.platform == "win32":
        raise JobRefused(
            "several workers need Linux or macOS", hint="use one process, without workers"
        )
    for package in ("distributed", "dask_jobqueue", "cryptography"):
        if find_spec(package) is None:
            raise JobRefused(
                f"several workers need the package {package.replace('_', '-')}",
                hint='run: pip install "fixel[cluster]"',
            )


def listening(interface: str) -> dict[str, Any]:
    """Return the arguments that bind a Dask process to one network interface."""
    if interface == LOOPBACK:
        return {"host": "127.0.0.1"}
    known = sorted(name for _, name in socket.if_nameindex())
    check_name("interface", interface, known)
    return {"interface": interface}


def end_with_parent() -> None:
    """End this process at once when the other end of its standard input closes."""

    def watch() -> None:
        while sys.stdin.buffer.read(1):
            pass
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


# --- connection ---------------------------------------------------------------------------------


def write_address(folder: Path, address: str) -> None:
    """Publish the address of the scheduler to the workers."""
    write_whole(folder / "connection.json", json.dumps({"address": address}))


def read_address(folder: Path) -> str | None:
    """Load the address of the scheduler; None if there is none."""
    try:
        return str(json.loads((folder / "connection.json").read_text())["address"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def answers(address: str) -> bool:
    """Whether a process listens at an address, within 2 s; Dask would try for longer."""
    host, _, port = address.removeprefix("tls://").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=2.0).close()
    except (OSError, ValueError):
        return False
    return True


def forget_address(folder: Path) -> None:
    """Remove the published address of the scheduler."""
    (folder / "connection.json").unlink(missing_ok=True)


# --- workers ------------------------------------------------------------------------------------


def record_joined(folder: Path, name: str, host: str) -> None:
    """Record that the scheduler has accepted a worker."""
    write_whole(folder / "workers" / f"{name}.json", json.dumps({"host": host, "pid": os.getpid()}))


def joined(folder: Path, name: str) -> Owner | None:
    """Load a worker that has joined, now or earlier; None if it has not."""
    return read_owner(folder / "workers" / f"{name}.json")


def record_refusal(folder: Path, name: str, reason: str) -> None:
    """Record that a worker does not take part, and the reason."""
    write_whole(folder / "workers" / f"{name}.refused", reason)


def refusals(folder: Path) -> list[str]:
    """Return the reasons of workers that did not take part."""
    return [path.read_text() for path in sorted((folder / "workers").glob("*.refused"))]


def clear_workers(folder: Path) -> None:
    """Create the folder of workers; remove refusals of earlier ones."""
    workers = folder / "workers"
    workers.mkdir(exist_ok=True)
    for path in workers.glob("*.refused"):
        path.unlink(missing_ok=True)


# --- late answers -------------------------------------------------------------------------------


def save_late(folder: Path, block: str, framed: bytes) -> None:
    """Store an answer for the next coordinator."""
    body = json.dumps(block).encode() + b"\n" + framed
    name = f"{zlib.crc32(block.encode()):08x}-{os.getpid()}"
    content = zlib.crc32(body).to_bytes(_CRC_BYTES, "little") + body
    write_whole(folder / "late" / name, content, durable=True)


def late_answers(folder: Path) -> Iterator[tuple[str, bytes, Path]]:
    """Yield block, answer and file of each late answer; remove files that cannot be read."""
    for path in sorted((folder / "late").glob("[!.]*")):
        try:
            data = path.read_bytes()
            body = data[_CRC_BYTES:]
            whole = zlib.crc32(body) == int.from_bytes(data[:_CRC_BYTES], "little")
            head, _, framed = body.partition(b"\n")
            block = str(json.loads(head)) if whole else None
        except (OSError, ValueError):
            block = None
        if block is None:
            path.unlink(missing_ok=True)
        else:
            yield block, framed, path


# --- TLS ----------------------------------------------------------------------------------------


def make_tls(folder: Path) -> None:
    """Create a new key and certificate of a job, readable by the owner only.

    Those who know the key can run code in its processes, and the folder may come from elsewhere.
    """
    tls = folder / "tls"
    tls.mkdir(exist_ok=True)  # workers that wait for the new key end without it
    tls.chmod(0o700)
    for name, content in zip(("key.pem", "certificate.pem"), _pair(), strict=True):
        (tls / name).unlink(missing_ok=True)
        descriptor = os.open(tls / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(content)


def remove_tls(folder: Path) -> None:
    """Remove the key and certificate, so that no worker can join any more."""
    shutil.rmtree(folder / "tls", ignore_errors=True)


def security(folder: Path) -> Any:
    """Return Dask's security settings: encrypted, and only for processes with the job's key."""
    from distributed.security import Security

    key, certificate = (str(folder / "tls" / f"{n}.pem") for n in ("key", "certificate"))
    roles = {
        f"tls_{role}_{part}": path
        for role in ("client", "scheduler", "worker")
        for part, path in (("key", key), ("cert", certificate))
    }
    kind: Any = Security
    return kind(require_encryption=True, tls_ca_file=certificate, **roles)


def _pair() -> tuple[bytes, bytes]:
    """Return a private key and its self-signed certificate, as PEM."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "fixel job")])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now + _VALID_FROM)
        .not_valid_after(now + _VALID_UNTIL)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return private, certificate.public_bytes(serialization.Encoding.PEM)
