"""Saved results: one zip file of JSON and NumPy arrays, without pickle."""

from __future__ import annotations

import dataclasses
import inspect
import io
import json
import math
import re
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path, PurePath
from types import MappingProxyType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from fixel.errors import FixelError, InvalidInput
from fixel.io.array_bytes import KINDS, RATIO, SMALL, array_of
from fixel.io.atomic import refuse_device, written_whole
from fixel.model.fields import path_of
from fixel.registry import offers

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
SMALL_HEAD: Final = 4_000_000  # [bytes] of them that may be JSON
MAX_DEPTH: Final = 100  # levels of nesting in JSON
_ARRAY_KINDS: Final = {np.float64: "fiu", np.int64: "iu", np.bool_: "b", np.str_: "U"}
_TEXTS: Final = re.compile(rb'"(?:[^"\\]|\\.)*"')
_BRACKETS: Final = re.compile(rb"[\[\]{}]")
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
            data = stream.getvalue()
            # What packs too well would be rejected by `load` as a bomb.
            is_bomb = len(data) > SMALL // 64 and RATIO * len(zlib.compress(data, 1)) < 4 * len(
                data
            )
            file.writestr(f"{name}.npy", data, zipfile.ZIP_STORED if is_bomb else None)
    return Path(path)


def load(path: str | Path) -> Any:
    """Load a result that its `save` method wrote.

    A file can only contain the classes of results, with values of the kinds that they have. Its
    sizes are checked before it is read, and loading it runs nothing.

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
    path = path_of(path, "path")
    refuse_device(path, "a result saved by fixel")
    try:
        with zipfile.ZipFile(path) as file:
            _check_sizes(file, path)
            head = _json(file.read("result.json"))
            _check_head(head, path)
            result = _Decoder(file).made(head["content"])
        repr(result)  # parts that do not fit together are found here, not by the caller
    except OSError as problem:
        raise _refused(path, problem) from None
    except FixelError as problem:
        if isinstance(problem, InvalidInput) and problem.where == str(path):
            raise
        raise _refused(path, f"a result that this version cannot read: {problem}") from None
    except Exception:  # constructors raise any
        raise _refused(path, "another kind of file, or a damaged one") from None
    return result


def _refused(path: Path, found: object, hint: str | None = None) -> InvalidInput:
    return InvalidInput(str(path), found=found, expected="a result saved by fixel", hint=hint)


def _check_head(head: Any, path: Path) -> None:
    if int(head["format"]) > FORMAT:
        raise _refused(
            path,
            f"a result of fixel {str(head['fixel'])[:40]} in format {int(head['format'])}",
            f"fixel {version('fixel')} reads formats up to {FORMAT}: install a newer one",
        )


def _check_sizes(file: zipfile.ZipFile, path: Path) -> None:
    """Raise where a small file announces much content."""
    packed = path.stat().st_size
    members = file.infolist()
    total = sum(member.file_size for member in members)
    head = file.getinfo("result.json").file_size
    if total > max(SMALL, RATIO * packed) or head > max(SMALL_HEAD, RATIO * packed):
        raise _refused(path, f"{total / 1e6:.0f} MB in a file of {packed / 1e6:.3g} MB")
    if len({member.filename for member in members}) < len(members):
        raise _refused(path, "an array twice")


def _json(data: bytes) -> Any:
    """Return the content of JSON, after a check of its depth."""
    depth = most = 0
    for bracket in _BRACKETS.findall(_TEXTS.sub(b"", data)):
        depth += 1 if bracket in b"[{" else -1
        most = max(most, depth)
    if most > MAX_DEPTH:
        raise ValueError(f"{most} levels")
    return json.loads(data)


def _array(file: zipfile.ZipFile, name: str) -> NDArray[Any]:
    array = array_of(file.read(f"{name}.npy"))
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
    if _known().get(kind.__qualname__) != kind.__module__:
        return None
    if _is_mapping(kind):
        return "mapping", value
    return "object", {name: getattr(value, name) for name in _fields(kind)}


def _is_mapping(kind: type) -> bool:
    """Return whether a class is made of its items."""
    return issubclass(kind, Mapping) and not dataclasses.is_dataclass(kind)


def _fields(kind: Any) -> list[str]:
    """Return the names of the arguments that construct a class."""
    if dataclasses.is_dataclass(kind):
        return [field.name for field in dataclasses.fields(kind) if field.init]
    return list(getattr(kind, "model_fields", None) or kind._fields)


def _path_of(kind: type) -> str:
    package = sys.modules["fixel"]
    public = kind.__name__ in package.__all__ and getattr(package, kind.__name__) is kind
    return f"fixel:{kind.__name__}" if public else f"{kind.__module__}:{kind.__qualname__}"


@cache
def _known() -> Mapping[str, str]:
    """Return the modules of the classes that a file may contain, by the names of these."""
    listed = offers("saved classes").items()
    return {name: module for module, names in listed for name in names.split()}


def _class_of(path: str) -> Any:
    """Return the class of a path in a file; its module may have moved since."""
    name = path.rpartition(":")[2]
    if name not in _known():
        expected = "one that this version of fixel saves"
        raise InvalidInput("class", found=repr(name), expected=expected)
    return getattr(import_module(_known()[name]), name)


@cache
def _hints(kind: type) -> Mapping[str, Any]:
    """Return the types of the arguments of a class; those of pydantic check themselves."""
    if hasattr(kind, "model_fields"):
        return {}
    # Some modules import the classes of their annotations for type checkers only.
    names = {name: _class_of(name) for name in _known()} | {"Callable": Callable}
    own = sys.modules[kind.__module__].__dict__
    missing = {name: named for name, named in names.items() if name not in own}
    return get_type_hints(kind, localns=missing)


@cache
def _sequence_of(kind: type) -> str:
    """Return the field that the constructor takes as a sequence of arguments; empty for none."""
    parameters = inspect.signature(kind).parameters.values()
    return next((own.name for own in parameters if own.kind is own.VAR_POSITIONAL), "")


class _Decoder:
    """Inverse of `_encoded`; each array is loaded once."""

    def __init__(self, file: zipfile.ZipFile) -> None:
        self._array = cache(lambda name: _array(file, name))

    def decoded(self, value: Any) -> Any:
        """Return the value of its content in JSON."""
        if not isinstance(value, dict):
            return value
        kind = value["type"]
        if kind == "array":
            return self._array(value["name"])
        if kind == "float":
            return float(value["text"])
        if kind == "path":
            return Path(value["text"])
        if kind == "bytes":
            return bytes.fromhex(value["text"])
        if kind in ("object", "mapping"):
            return self.made(value)
        return _CONTAINERS[kind](self.decoded(item) for item in value["items"])

    def made(self, value: Mapping[str, Any]) -> Any:
        """Return the object of a listed class whose arguments are of the right types."""
        content = {self.decoded(k): self.decoded(item) for k, item in value["items"]}
        own = _class_of(value["class"])
        if _is_mapping(own):
            return own(content)
        hints = _hints(own)
        for name, item in content.items():
            if name not in _fields(own) or not fits(item, hints.get(name, Any)):
                raise ValueError(f"{own.__name__}.{name}")
        first = content.pop(_sequence_of(own), ())
        return own(*first, **content)


def fits(value: Any, hint: Any) -> bool:
    """Return whether a value has the type of an annotation; arrays by the kind of their numbers."""
    origin, inner = get_origin(hint), get_args(hint)
    if hint is Any:
        return True
    if origin in (Union, UnionType):
        return any(fits(value, one) for one in inner)
    if origin is Literal:
        return value in inner
    if hint in (None, type(None)):
        return value is None
    if hint is np.ndarray or origin is np.ndarray:
        kind = get_args(inner[1])[0] if inner else np.generic
        kinds = _ARRAY_KINDS.get(kind, KINDS)
        return isinstance(value, np.ndarray) and (value.dtype.names or value.dtype.kind in kinds)
    if origin in (tuple, list, set, frozenset, Sequence):
        if not isinstance(value, Sequence | set | frozenset) or isinstance(value, str | bytes):
            return False
        if origin is not tuple or inner[1:] == (...,):
            return all(fits(item, inner[0]) for item in value)
        return len(value) == len(inner) and all(map(fits, value, inner))
    if origin in (dict, Mapping):
        return isinstance(value, Mapping) and all(
            fits(key, inner[0]) and fits(item, inner[1]) for key, item in value.items()
        )
    if not isinstance(hint, type):
        return False
    if issubclass(hint, Enum):
        return value in list(hint)
    return isinstance(value, float | int if hint is float else hint)
