"""Saved results: one zip file of JSON and NumPy arrays, without pickle."""

from __future__ import annotations

import dataclasses
import inspect
import io
import json
import math
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import FixelError, InvalidInput, os_reason
from fixel.io.atomic import written_whole

FORMAT: Final = 1
_PLAIN: Final = (type(None), bool, int, str)
_CONTAINERS: Final[Mapping[str, Callable[[Any], Any]]] = {
    "list": list,
    "tuple": tuple,
    "set": set,
    "frozenset": frozenset,
    "dict": dict,
    "mappingproxy": lambda pairs: MappingProxyType(dict(pairs)),
}
_DAMAGED: Final = (
    zipfile.BadZipFile, zlib.error, KeyError, TypeError, AttributeError, ValueError, EOFError,
    NotImplementedError, RuntimeError, OverflowError,
)  # fmt: skip
Arrays = dict[str, NDArray[Any]]


def save(result: object, path: str | Path) -> Path:
    """Save a result to a file, whole or not at all.

    Parameters
    ----------
    result : object
        Result of a public function, or another frozen object of fixel.
    path : str or path
        File of any name.

    Returns
    -------
    pathlib.Path
        The file.
    """
    arrays: Arrays = {}
    head = {
        "fixel": version("fixel"),
        "format": FORMAT,
        "kind": type(result).__name__,
        "content": _encoded(result, arrays),
    }
    with (
        written_whole(path) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as file,
    ):
        file.writestr("result.json", json.dumps(head, allow_nan=False))
        for name, array in arrays.items():
            stream = io.BytesIO()
            np.save(stream, array, allow_pickle=False)
            file.writestr(f"{name}.npy", stream.getvalue())
    return Path(path)


def load(path: str | Path) -> Any:
    """Load a result that its `save` method wrote.

    Parameters
    ----------
    path : str or path
        File with a saved result.

    Returns
    -------
    Result
        An object equal to the saved one.

    Raises
    ------
    InvalidInput
        The file is missing or damaged, is no saved result, or comes from a newer version.

    Examples
    --------
    >>> import tempfile
    >>> from fixel import Disk
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     load(save(Disk(0.005), f"{folder}/disk.fixel")) == Disk(0.005)
    True
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as file:
            head = json.loads(file.read("result.json"))
            _check_head(head, path)
            return _decoded(head["content"], lambda name: _array(file, name))
    except FixelError as problem:
        if isinstance(problem, InvalidInput) and problem.where == str(path):
            raise
        raise _refused(path, f"a result that this version cannot read: {problem}") from None
    except OSError as problem:
        raise _refused(path, os_reason(problem)) from None
    except _DAMAGED:
        raise _refused(path, "another kind of file, or a damaged one") from None


def _refused(path: Path, found: str, hint: str | None = None) -> InvalidInput:
    return InvalidInput(str(path), found=found, expected="a result saved by fixel", hint=hint)


def _check_head(head: Any, path: Path) -> None:
    if int(head["format"]) > FORMAT:
        raise _refused(
            path,
            f"a result of fixel {head['fixel']} in format {head['format']}",
            f"fixel {version('fixel')} reads formats up to {FORMAT}: install a newer one",
        )


def _array(file: zipfile.ZipFile, name: str) -> NDArray[Any]:
    array: NDArray[Any] = np.load(io.BytesIO(file.read(f"{name}.npy")), allow_pickle=False)
    array.setflags(write=False)
    return array


def _encoded(value: Any, arrays: Arrays) -> Any:
    """Return a value as JSON can hold it; arrays go into `arrays` under a name."""
    if isinstance(value, np.ndarray):
        name = f"array{len(arrays)}"
        arrays[name] = value
        return {"type": "array", "name": name}
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else {"type": "float", "text": repr(value)}
    if isinstance(value, _PLAIN):
        return value
    if isinstance(value, PurePath):
        return {"type": "path", "text": str(value)}
    if isinstance(value, bytes):
        return {"type": "bytes", "text": value.hex()}
    own = _contents(value)
    if own is not None:
        kind, content = own
        items = [[_encoded(key, arrays), _encoded(item, arrays)] for key, item in content.items()]
        return {"type": kind, "class": _path_of(type(value)), "items": items}
    kind = type(value).__name__
    if kind not in _CONTAINERS:
        raise TypeError(f"a {kind} cannot be saved")
    parts = value.items() if isinstance(value, Mapping) else value
    return {"type": kind, "items": [_encoded(part, arrays) for part in parts]}


def _contents(value: Any) -> tuple[str, Mapping[Any, Any]] | None:
    """Return the arguments that construct an object of fixel; None for other objects."""
    kind = type(value)
    if not kind.__module__.startswith("fixel."):
        return None
    if dataclasses.is_dataclass(kind):
        names = [field.name for field in dataclasses.fields(kind) if field.init]
    elif hasattr(kind, "model_fields"):
        names = list(kind.model_fields)
    elif hasattr(kind, "_fields"):
        names = list(kind._fields)
    elif isinstance(value, Mapping):
        return "mapping", value
    else:
        return None
    return "object", {name: getattr(value, name) for name in names}


def _path_of(kind: type) -> str:
    package = sys.modules["fixel"]
    public = kind.__name__ in package.__all__ and getattr(package, kind.__name__) is kind
    return f"fixel:{kind.__name__}" if public else f"{kind.__module__}:{kind.__qualname__}"


def _class_of(path: str) -> type:
    """Return a class of fixel by its path, if objects of it can be saved."""
    module, name = path.split(":")
    if module != "fixel" and not module.startswith("fixel."):
        raise ValueError(path)
    kind = getattr(sys.modules.get(module) or import_module(module), name)
    if not isinstance(kind, type) or not kind.__module__.startswith("fixel."):
        raise ValueError(path)
    return kind


@cache
def _sequence_of(kind: type) -> str:
    """Return the field that the constructor takes as a sequence of arguments; empty for none."""
    parameters = inspect.signature(kind).parameters.values()
    return next((own.name for own in parameters if own.kind is own.VAR_POSITIONAL), "")


def _decoded(value: Any, array: Callable[[str], NDArray[Any]]) -> Any:
    """Inverse of `_encoded`."""
    if not isinstance(value, dict):
        return value
    kind = value["type"]
    if kind == "array":
        return array(value["name"])
    if kind == "float":
        return float(value["text"])
    if kind == "path":
        return Path(value["text"])
    if kind == "bytes":
        return bytes.fromhex(value["text"])
    if kind in ("object", "mapping"):
        content = {_decoded(k, array): _decoded(item, array) for k, item in value["items"]}
        own = _class_of(value["class"])
        if kind == "mapping":
            return own(content)
        first = content.pop(_sequence_of(own), ())
        return own(*first, **content)
    return _CONTAINERS[kind](_decoded(item, array) for item in value["items"])
