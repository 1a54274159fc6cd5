"""Functions by name: what a job folder may make a worker call.

A folder may come from elsewhere, so a name in it reaches only functions of fixel that are marked
with `callable_by_jobs`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeVar

from fixel.errors import InvalidInput

ChunkFunction = Callable[[Path, bytes], bytes]
F = TypeVar("F", bound=Callable[..., Any])

PREFIX: Final = "fixel."
THREADS: Final = "FIXEL_THREADS"  # environment of a worker: cores that are its own
_NAME: Final = re.compile(r"([a-z][a-z0-9_]*(?:\.[a-z][a-z0-9_]*)+):([a-z][a-z0-9_]*)")


_ALLOWED: set[tuple[str, str]] = set()  # module and name


def callable_by_jobs(function: F) -> F:
    """Mark a function that files of a job may name: a maker of work, or one that answers chunks."""
    _ALLOWED.add((function.__module__, function.__name__))
    return function


def chunk_function(name: str) -> ChunkFunction:
    """The function `(inputs, payload) -> bytes` of a name `"fixel.module:function"`."""
    function: ChunkFunction = named_function(name)
    return function


def named_function(name: str) -> Any:
    """Return a function of fixel that jobs may call.

    Raises
    ------
    InvalidInput
        The name is none of fixel's, there is no such function, or it is not meant for jobs.
    """
    match = _NAME.fullmatch(name)
    if match is None or not name.startswith(PREFIX):
        raise InvalidInput(
            "function of a job", found=name, expected='a name such as "fixel.module:function"'
        )
    module, attribute = match.groups()
    try:
        function = getattr(import_module(module), attribute, None)
    except ModuleNotFoundError as problem:
        raise InvalidInput("function of a job", found=f"{name}: {problem}") from None
    if (module, attribute) not in _ALLOWED:
        raise InvalidInput(
            "function of a job",
            found=name,
            expected="a function that is marked with fixel.jobs.functions.callable_by_jobs",
        )
    return function


def threads() -> int | None:
    """How many threads a chunk function should use; None for as many as there are cores."""
    said = os.environ.get(THREADS, "")
    return int(said) if said.isdecimal() and int(said) > 0 else None
