"""Fits that are done, kept in a folder: the same command goes on where it was stopped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.io.atomic import written_whole
from fixel.typing import FloatArray

# Raise it when the same settings no longer mean the same fit.
VERSION: Final = 1


@final
class ResultCache:
    """Answers by name, each kept with a mark of what it was computed from.

    Parameters
    ----------
    folder : Path or None
        Made where it is missing; nothing is kept without one.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def get(self, name: str, of: object, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The answer kept under a name, if it is of the same; computed and kept otherwise.

        Parameters
        ----------
        name : str
            Of the file.
        of : object
            Whatever the answer depends on, as plain values and arrays.
        compute : callable
            Gives plain values.
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
    except (OSError, ValueError):
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
    """Rounded for a file: a nanometre and a nanoradian are nothing."""
    return list(np.round(table, 9).tolist())
