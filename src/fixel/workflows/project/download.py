"""List public datasets with their licences, and download files."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from fixel.datasets import IMPORTERS
from fixel.errors import InvalidInput, StoreRefused


class DownloadedFile(NamedTuple):
    """Downloaded file, with its checksum and size."""

    file: Path
    sha256: str
    n_byte: int


def datasets() -> list[dict[str, str]]:
    """Return name, title, licence and citation of every dataset that can be imported."""
    return [
        {
            "name": importer.name,
            "title": importer.title,
            "licence": importer.licence,
            "citation": importer.citation,
        }
        for importer in IMPORTERS.values()
        if importer.citation
    ]


def fetch(url: str, folder: Path, sha256: str | None = None) -> DownloadedFile:
    """Download a file into a folder: completely, with the required checksum, or not at all.

    Parameters
    ----------
    sha256 : str, optional
        Required checksum; without one, any content is accepted.

    Raises
    ------
    InvalidInput
        Not the address of a file, or not a checksum.
    StoreRefused
        The download failed, or the file has another checksum than the required one.
    """
    try:
        import pooch
    except ImportError:
        raise StoreRefused(
            "downloads need the package pooch", hint="run: pip install 'fixel[download]'"
        ) from None
    name = _name(url)
    if sha256 is not None and not re.fullmatch(r"[0-9a-fA-F]{64}", sha256):
        raise InvalidInput("--sha256", found=sha256, expected="64 hexadecimal digits")
    pooch.get_logger().setLevel("ERROR")  # fixel gives the warnings itself
    wanted = None if sha256 is None else f"sha256:{sha256.lower()}"
    try:
        path = Path(pooch.retrieve(url, wanted, fname=name, path=folder))
    except ValueError as problem:
        raise StoreRefused(
            f"{url} is not the requested file: {_one_line(problem)}",
            hint="check the URL and the checksum; nothing was stored",
        ) from None
    except Exception as problem:  # whatever the network library under pooch raises
        if (answer := getattr(problem, "response", None)) is not None:
            answer.close()  # pooch leaves the connection of a failed request open
        raise StoreRefused(
            f"{url} could not be downloaded: {_one_line(problem)}",
            hint="check the URL and the network",
        ) from None
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return DownloadedFile(path, digest, path.stat().st_size)


def _name(url: str) -> str:
    """File name at the end of an address."""
    parts = urlsplit(url)
    name = Path(parts.path).name
    if parts.scheme not in ("http", "https", "ftp") or not name or name.startswith("."):
        raise InvalidInput("URL", found=url, expected="http(s)://HOST/.../FILE")
    return name


def _one_line(problem: Any) -> str:
    return " ".join(str(problem).split())[:300]
