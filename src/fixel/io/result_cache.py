"""Cache of fits in a folder, so that the same command continues where it was stopped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.io.atomic import written_whole
from fixel.typing import FloatArray

# Increase it when the same settings no longer give the same fit.
VERSION: Final = 1


@final
class ResultCache:
    """Results by name, each stored with a checksum of its inputs.

    Parameters
    ----------
    folder : Path or None
        Folder of the cache, created if missing; None to store nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def get(self, name: str, of: object, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return the result stored under a name for the same inputs, or compute and store it.

        Parameters
        ----------
        name : str
            Name of the file.
        of : object
            All inputs of the result, as plain values and arrays.
        compute : callable
            Function that returns plain values.
        """
        mark = _mark(of)
        if self.folder is None:
            return compute()
        path = self.folder / f"{name}.json"
        kept = _read(path)
        if kept is not None and kept.get("of") == mark:
            return dict(kept["answer"])
        answer = compute()
        with written_whole(path) as beside:
            beside.write_text(json.dumps({"of": mark, "answer": answer}), encoding="utf-8")
        return answer


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    good = isinstance(content, dict) and isinstance(content.get("answer"), dict)
    return content if good else None


def _mark(of: object) -> str:
    return hashlib.sha256(json.dumps([VERSION, of], default=_plain).encode()).hexdigest()


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return [
            list(value.shape),
            hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest(),
        ]
    if isinstance(value, np.generic):
        return value.item()
    return repr(value)


def listed(table: FloatArray) -> list[Any]:
    """Return a table rounded to 9 digits (nanometres, nanoradians), for a file."""
    return list(np.round(table, 9).tolist())
