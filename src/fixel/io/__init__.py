"""Files that survive crashes: atomic writes, locks, journals, documents, saved results."""

from typing import Any


def __getattr__(name: str) -> Any:
    if name not in ("load", "save"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fixel.io import (
        saved,
    )  # late: this imports NumPy, which a stop of a drive must not wait for

    return getattr(saved, name)
