"""Records of files: pydantic classes with the keys and kinds of value, and errors as sentences.

A record contains only what a text editor could check; everything else is checked in the model.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, TypeVar, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fixel.errors import InvalidInput, did_you_mean

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Point = Annotated[list[Number], Field(min_length=2, max_length=2)]
Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
KeyPath = tuple[str | int, ...]

T = TypeVar("T")

_UNIT = re.compile("(_mm|_deg|_px)+$")
_PHRASES = {
    "missing": "a value: this key is required",
    "float_type": "a number",
    "int_type": "a whole number",
    "finite_number": "a finite number",
    "string_type": "text",
    "list_type": "a list",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than_equal": "a number of at most {le:g}",
    "too_short": "at least {min_length} entries",
    "too_long": "at most {max_length} entries",
    "literal_error": "{expected}",
}


class FileRecord(BaseModel):
    """Base of all records: rejects unknown keys, and numbers written as text."""

    model_config = ConfigDict(extra="forbid", strict=True)


R = TypeVar("R", bound=FileRecord)


class NoneRecord(FileRecord):
    """Record without keys."""


def validated(root: type[R], raw: Any, name: str) -> R:
    """Validate every key and kind of value in the raw content of a file.

    Parameters
    ----------
    root : type
        Record of the whole file.
    raw : Any
        Content as dicts, lists and plain values.
    name : str
        Name of the whole in errors: `"scene"`.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.
    """
    try:
        return root.model_validate(raw)
    except ValidationError as problems:
        raise _explained(problems, root, raw, name) from None


def built(kind: type[T], record: FileRecord, path: str, *prefixes: str, **fields: Any) -> T:
    """Build an object of the model from the fields of a record; some may be given instead.

    Its errors are reported at the path of the record, see `within`.
    """
    with within(path, *prefixes):
        return kind(**{**si_fields(record), **fields})


def si_fields(record: FileRecord) -> dict[str, Any]:
    """Return the fields of a record in metres and radians, without the units in their names."""
    return dict(si_field(key, value) for key, value in record)


def si_field(key: str, value: Any) -> tuple[str, Any]:
    """Return a key without its unit, and its value in metres and radians."""
    return _UNIT.sub("", key), _scaled(key, value, _to_si)


def unit_content(value: object, record: type[FileRecord]) -> dict[str, Any]:
    """Return the fields of an object under the keys of its record; inverse of `si_fields`."""
    return {
        key: _scaled(key, getattr(value, _UNIT.sub("", key)), _from_si)
        for key in record.model_fields
    }


def plain(number: float) -> float:
    """Round a number to 15 digits: `25.4` instead of `25.400000000000002`."""
    return float(f"{number:.15g}")


def _scaled(key: str, value: Any, scale: Callable[[str, float], float]) -> Any:
    """Convert the value of a key between its unit and that of the model; plain for files."""
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if value is None:
        return None
    if key.endswith("_mm_deg"):
        x, y, angle = value
        return [scale("_mm", x), scale("_mm", y), scale("_deg", angle)]
    if isinstance(value, dict):
        return {name: _scaled(key, item, scale) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_scaled(key, item, scale) for item in value]
    unit = next((unit for unit in ("_mm", "_deg") if key.endswith(unit)), None)
    return scale(unit, value) if unit else value


def _to_si(unit: str, value: float) -> float:
    return value / 1e3 if unit == "_mm" else math.radians(value)


def _from_si(unit: str, value: float) -> float:
    return plain(1e3 * value if unit == "_mm" else math.degrees(value))


def only_form(record: FileRecord, path: str, forms: Sequence[str] = ()) -> str:
    """Return the name of the one form that is given; raise if there are none or several.

    `forms` are by default all keys of the record.
    """
    forms = forms or list(type(record).model_fields)
    given = [form for form in forms if getattr(record, form) is not None]
    if len(given) != 1:
        raise InvalidInput(
            path,
            found=" and ".join(given) or None,
            expected="exactly one of " + ", ".join(forms),
        )
    return given[0]


@contextmanager
def within(path: str, *prefixes: str) -> Iterator[None]:
    """Report errors of built objects at a key of the file, with prefixes of the place removed."""
    try:
        yield
    except InvalidInput as problem:
        where = problem.where
        for prefix in prefixes:
            where = where.removeprefix(prefix)
        raise InvalidInput(
            where, found=problem.found, expected=problem.expected, hint=problem.hint
        ).within(path) from None


def written(path: KeyPath) -> str:
    """Format a path as `bodies[0].shape.polygon[2]`."""
    return "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in path).removeprefix(".")


def annotation_at(root: type[FileRecord], path: KeyPath) -> Any:
    """Return the annotation of the value at a path; None if there is no such key."""
    annotation: Any = root
    for key in path:
        if get_origin(annotation) is dict:
            annotation = get_args(annotation)[1]
        elif isinstance(key, str):
            record = _record_in(annotation)
            field = record.model_fields.get(key) if record else None
            annotation = field.annotation if field else None
    return annotation


def record_at(root: type[FileRecord], path: KeyPath) -> type[FileRecord] | None:
    """Return the class of the record at a path, also of each in a list; None if there is none."""
    return _record_in(annotation_at(root, path))


def description_at(root: type[FileRecord], path: KeyPath) -> str | None:
    """Return the description of the last key of a path, without indices behind it."""
    named = [k for k, key in enumerate(path) if isinstance(key, str)]
    record = record_at(root, path[: named[-1]]) if named else None
    field = record.model_fields.get(str(path[named[-1]])) if record else None
    return field.description if field else None


def unknown_key(root: type[FileRecord], path: KeyPath) -> InvalidInput:
    """Error for a path whose last key the record there does not have."""
    record = record_at(root, path[:-1])
    known = list(record.model_fields) if record else []
    return InvalidInput(
        written(path),
        found="an unknown key",
        expected="one of " + ", ".join(known) if known else "no keys here",
        hint=did_you_mean(path[-1], known),
    )


def _record_in(annotation: Any) -> type[FileRecord] | None:
    if isinstance(annotation, type) and issubclass(annotation, FileRecord):
        return annotation
    inner = (_record_in(argument) for argument in get_args(annotation))
    return next((record for record in inner if record), None)


def _explained(
    problems: ValidationError, root: type[FileRecord], raw: Any, name: str
) -> InvalidInput:
    first = problems.errors(include_url=False)[0]
    kind, path = first["type"], _path(first["loc"], raw, first["type"])
    if kind == "extra_forbidden":
        return unknown_key(root, path)
    found = None if kind == "missing" else first["input"]
    return InvalidInput(
        written(path) or name,
        found=repr(found) if isinstance(found, str) else found,
        expected=_expected(kind, first.get("ctx", {}), first["msg"], root, path),
    )


def _path(location: tuple[int | str, ...], raw: Any, kind: str) -> KeyPath:
    """Path of a pydantic location, without its names for the members of unions."""
    path: list[str | int] = []
    for depth, key in enumerate(location):
        is_last = depth == len(location) - 1
        if isinstance(raw, list) and isinstance(key, int) and key < len(raw):  # noqa: SIM114
            raw = raw[key]
        elif isinstance(raw, dict) and key in raw:
            raw = raw[key]
        elif not (is_last and kind == "missing"):
            continue
        path.append(key)
    return tuple(path)


def _expected(
    kind: str, context: dict[str, Any], message: str, root: type[FileRecord], path: KeyPath
) -> str:
    record = record_at(root, path)
    if record and kind == "model_type":
        return "the keys " + ", ".join(record.model_fields)
    plain = message.removeprefix("Input should be ").replace("valid ", "")
    phrase = _PHRASES[kind].format(**context) if kind in _PHRASES else plain
    description = description_at(root, path)
    return f"{phrase} ({description})" if description else phrase
