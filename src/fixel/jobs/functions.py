"""Functions by name: what a job folder may make a worker call.

A folder may come from elsewhere, so a name in it reaches only public functions of fixel itself.
"""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from fixel.errors import InvalidInput

ChunkFunction = Callable[[Path, bytes], bytes]

PREFIX: Final = "fixel."
THREADS: Final = "FIXEL_THREADS"  # environment of a worker: cores that are its own
_NAME: Final = re.compile(r"([a-z][a-z0-9_]*(?:\.[a-z][a-z0-9_]*)+):([a-z][a-z0-9_]*)")


def chunk_function(name: str) -> ChunkFunction:
    """The function `(inputs, payload) -> bytes` of a name `"fixel.module:function"`."""
    function: ChunkFunction = named_function(name)
    return function


def named_function(name: str) -> Any:
    """A public function of fixel.

    Raises
    ------
    InvalidInput
        The name is none of fixel's, or there is no such function.
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
    if not inspect.isfunction(function) or function.__module__ != module:
        raise InvalidInput(
            "function of a job", found=name, expected="a function defined in that module"
        )
    return function


def threads() -> int | None:
    """How many threads a chunk function should use; None for as many as there are cores."""
    said = os.environ.get(THREADS, "")
    return int(said) if said.isdecimal() and int(said) > 0 else None
