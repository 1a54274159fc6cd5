"""What the processes of a job tell each other by files in its folder.

    connection.json     where the scheduler listens now; gone when there is nothing to connect to
    tls/                key and certificate that all processes of the job show each other
    workers/            a file a worker, once it has joined or refused; its log beside it
    late/               answers of workers whose scheduler was lost

Also on a cluster these are all the workers need: they read the folder on a shared file system.
"""

from __future__ import annotations

import datetime
import json
import os
import shutil
import socket
import sys
import zlib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, NamedTuple

from fixel.errors import InvalidInput, JobRefused
from fixel.io.atomic import written_whole

LOOPBACK: Final = "lo"
# Clocks of nodes differ by up to hours; a certificate is valid from a day ago on.
_VALID_FROM: Final = datetime.timedelta(days=-1)
_VALID_UNTIL: Final = datetime.timedelta(days=365)
_CRC_BYTES: Final = 4


class WorkerLink(NamedTuple):
    """A worker that has joined."""

    name: str
    host: str
    pid: int


class Late(NamedTuple):
    """An answer that a worker could not give to a scheduler."""

    block: str
    framed: bytes
    path: Path


def refuse_without_dask() -> None:
    """Refuse work in several processes where the packages for it are not installed."""
    if sys.platform == "win32":
        raise JobRefused("several workers need Linux or macOS", hint="leave --workers out")
    for package in ("distributed", "dask_jobqueue", "cryptography"):
        if find_spec(package) is None:
            raise JobRefused(
                f"several workers need the package {package.replace('_', '-')}",
                hint='run: pip install "fixel[cluster]"',
            )


def listening(interface: str) -> dict[str, Any]:
    """Arguments that bind a Dask process to one interface, never to all."""
    if interface == LOOPBACK:
        return {"host": "127.0.0.1"}
    known = sorted(name for _, name in socket.if_nameindex())
    if interface not in known:
        raise InvalidInput("interface", found=interface, expected="one of " + ", ".join(known))
    return {"interface": interface}


# --- connection ---------------------------------------------------------------------------------


def write_address(folder: Path, address: str) -> None:
    """Tell workers where the scheduler is."""
    with written_whole(folder / "connection.json") as path:
        path.write_text(json.dumps({"address": address}))


def read_address(folder: Path) -> str | None:
    """Where the scheduler is, if there is one."""
    try:
        return str(json.loads((folder / "connection.json").read_text())["address"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def answers(address: str) -> bool:
    """Whether anybody listens at an address; Dask would try for long to find out."""
    host, _, port = address.removeprefix("tls://").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=2.0).close()
    except (OSError, ValueError):
        return False
    return True


def forget_address(folder: Path) -> None:
    """Tell workers that nobody expects them."""
    (folder / "connection.json").unlink(missing_ok=True)


# --- workers ------------------------------------------------------------------------------------


def say_joined(folder: Path, name: str, host: str) -> None:
    """A worker's word that the scheduler has accepted it."""
    with written_whole(folder / "workers" / f"{name}.json") as path:
        path.write_text(json.dumps({"host": host, "pid": os.getpid()}))


def joined(folder: Path, name: str) -> WorkerLink | None:
    """A worker that has joined, now or earlier."""
    try:
        said = json.loads((folder / "workers" / f"{name}.json").read_text())
        return WorkerLink(name, str(said["host"]), int(said["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def say_refused(folder: Path, name: str, reason: str) -> None:
    """A worker's word that it does not take part, and why."""
    with written_whole(folder / "workers" / f"{name}.refused") as path:
        path.write_text(reason)


def refusals(folder: Path) -> list[str]:
    """Why workers did not take part."""
    return [path.read_text() for path in sorted((folder / "workers").glob("*.refused"))]


def clear_workers(folder: Path) -> None:
    """Make room for the words of new workers."""
    workers = folder / "workers"
    workers.mkdir(exist_ok=True)
    for path in workers.glob("*.refused"):
        path.unlink(missing_ok=True)


# --- late answers -------------------------------------------------------------------------------


def save_late(folder: Path, block: str, framed: bytes) -> None:
    """Leave an answer for the next coordinator."""
    body = json.dumps(block).encode() + b"\n" + framed
    name = f"{zlib.crc32(block.encode()):08x}-{os.getpid()}"
    with written_whole(folder / "late" / name) as path, path.open("wb") as stream:
        stream.write(zlib.crc32(body).to_bytes(_CRC_BYTES, "little") + body)
        stream.flush()
        os.fsync(stream.fileno())


def late_answers(folder: Path) -> Iterator[Late]:
    """Answers that wait; what cannot be read is removed."""
    for path in sorted((folder / "late").glob("[!.]*")):
        try:
            data = path.read_bytes()
            body = data[_CRC_BYTES:]
            whole = zlib.crc32(body) == int.from_bytes(data[:_CRC_BYTES], "little")
            head, _, framed = body.partition(b"\n")
            late = Late(str(json.loads(head)), framed, path) if whole else None
        except (OSError, ValueError):
            late = None
        if late is None:
            path.unlink(missing_ok=True)
        else:
            yield late


# --- TLS ----------------------------------------------------------------------------------------


def make_tls(folder: Path) -> None:
    """A key and a certificate for this job, unless it has them; readable by its owner alone."""
    tls = folder / "tls"
    if (tls / "certificate.pem").exists() and (tls / "key.pem").exists():
        return
    shutil.rmtree(tls, ignore_errors=True)
    tls.mkdir(mode=0o700)
    key, certificate = _pair()
    for name, content in (("key.pem", key), ("certificate.pem", certificate)):
        descriptor = os.open(tls / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(content)


def remove_tls(folder: Path) -> None:
    """Nobody is to join any more."""
    shutil.rmtree(folder / "tls", ignore_errors=True)


def security(folder: Path) -> Any:
    """What Dask needs to encrypt, and to talk to nobody without this job's key."""
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
    """A key, and a certificate that it has signed itself: all the authority there is."""
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
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    return private, certificate.public_bytes(serialization.Encoding.PEM)
