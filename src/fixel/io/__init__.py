"""Files that survive crashes: atomic writes, locks, journals, documents, saved results."""

from typing import Any


def __getattr__(name: str) -> Any:
    if name not in ("load", "save"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # Late: it imports NumPy, which the stop of a drive, a reader of locks, must not wait for.
    from fixel.io import saved

    return getattr(saved, name)
