"""Registry of the functions that files of a job may name.

A folder may come from elsewhere, so a name in it reaches only functions that are marked with
`callable_by_jobs`, in the modules listed in `fixel.offers`. Stored names do not contain module
paths, so modules can be moved.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, TypeVar

from fixel.errors import InvalidInput
from fixel.registry import offered, offers

ChunkFunction = Callable[[Path, bytes], bytes]
F = TypeVar("F", bound=Callable[..., Any])

THREADS: Final = "FIXEL_THREADS"  # environment variable with the number of cores of a worker

_ALLOWED: set[tuple[str, str]] = set()  # module and name


def callable_by_jobs(function: F) -> F:
    """Mark a function that files of a job may name: a maker of work or a chunk function."""
    _ALLOWED.add((function.__module__, function.__name__))
    return function


def named_function(name: str) -> Any:
    """Return a function that is meant for jobs, by its stored name `"KIND:FUNCTION"`."""
    kind, _, attribute = name.partition(":")
    module = offered("jobs", kind) if kind in offers("jobs") else None
    if module is None or (module.__name__, attribute) not in _ALLOWED:
        expected = f"KIND:FUNCTION of {', '.join(offers('jobs'))} with @callable_by_jobs"
        hint = "a job of an older version of fixel cannot be resumed; start it again"
        raise InvalidInput("function of a job", found=name, expected=expected, hint=hint)
    return getattr(module, attribute)


def threads() -> int | None:
    """Return the number of threads that a chunk function should use; None for all cores."""
    said = os.environ.get(THREADS, "")
    return int(said) if said.isdecimal() and int(said) > 0 else None


# All processes of a job must have exactly the same sources; otherwise their answers may differ in
# the last bits.


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
