"""Stamp of the running fixel: its version and a digest of its sources.

All processes of a job must have exactly the same sources; otherwise their answers may differ in
the last bits.
"""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path


@cache
def stamp() -> str:
    """Return version and digest of the sources: `"0.1.0+3f8a0c2b91d4e670"`."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return f"{version('fixel')}+{digest.hexdigest()[:16]}"
