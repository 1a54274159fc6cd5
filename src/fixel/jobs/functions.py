"""Functions by name: what a job folder may make a worker call.

A folder may come from elsewhere, so a name in it reaches only functions that are marked with
`callable_by_jobs`, in the modules listed here. The names are stored; they outlive the place of a
module in the package.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeVar

from fixel.errors import InvalidInput

ChunkFunction = Callable[[Path, bytes], bytes]
F = TypeVar("F", bound=Callable[..., Any])

THREADS: Final = "FIXEL_THREADS"  # environment of a worker: cores that are its own

_MODULES: Final = {
    "calibration": "fixel.workflows.calibration.job",
    "domain": "fixel.workflows.domain.job",
    "toy": "fixel.testing.toy_work",
}
# Before kinds had names, folders held the module.
_FORMER: Final = {
    "fixel.workflows.calibration.work": "calibration",
    "fixel.workflows.domain.work": "domain",
}
_ALLOWED: set[tuple[str, str]] = set()  # module and name


def callable_by_jobs(function: F) -> F:
    """Mark a function that files of a job may name: a maker of work, or one that answers chunks."""
    _ALLOWED.add((function.__module__, function.__name__))
    return function


def chunk_function(name: str) -> ChunkFunction:
    """Return the function `(inputs, payload) -> bytes` of a name, say `"calibration:evaluate"`."""
    function: ChunkFunction = named_function(name)
    return function


def current_name(name: str) -> str:
    """Return the name of a function as it is stored now; older folders hold the module's path."""
    kind, colon, attribute = name.partition(":")
    return _FORMER.get(kind, kind) + colon + attribute


def named_function(name: str) -> Any:
    """Return a function that jobs may call, by its stored name `"KIND:FUNCTION"`.

    Raises
    ------
    InvalidInput
        There is no such kind of job or function, or it is not meant for jobs.
    """
    kind, _, attribute = name.partition(":")
    if kind not in _MODULES:
        raise InvalidInput(
            "function of a job",
            found=name,
            expected=f"KIND:FUNCTION, where KIND is one of {', '.join(_MODULES)}",
            hint="a job of an older fixel cannot be continued; start it again",
        )
    module = import_module(_MODULES[kind])
    if (module.__name__, attribute) not in _ALLOWED:
        raise InvalidInput(
            "function of a job",
            found=name,
            expected="a function that is marked with fixel.jobs.functions.callable_by_jobs",
        )
    return getattr(module, attribute)


def threads() -> int | None:
    """How many threads a chunk function should use; None for as many as there are cores."""
    said = os.environ.get(THREADS, "")
    return int(said) if said.isdecimal() and int(said) > 0 else None
