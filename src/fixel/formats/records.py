"""Records of files: pydantic classes made from dataclasses, and errors as sentences.

The dataclass is the schema: names, types, defaults and limits of its fields are those of the keys,
and its docstring has their meaning. A record contains only what a text editor could check;
everything else is checked by the constructor of the dataclass.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from functools import reduce
from operator import or_
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Final, TypeVar, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from fixel.docstrings import meanings
from fixel.errors import InvalidInput, did_you_mean, refused_value
from fixel.model.fields import (
    FieldType,
    Value,
    field_types,
    finite,
    fraction,
    non_negative,
    positive,
    table,
    vector,
)

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Point = Annotated[list[Number], Field(min_length=2, max_length=2)]
Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
Corners = Annotated[list[Point], Field(min_length=3)]
KeyPath = tuple[str | int, ...]

T = TypeVar("T")

_NUMBERS: Final[Mapping[Any, Any]] = {
    positive: Positive,
    non_negative: NonNegative,
    fraction: Fraction,
    finite: Number,
}
# Keys that are not written for a default; files show all others.
_OMITTED: Final = frozenset(
    {"velocity", "force", "restitution", "plane", "pushers", "fixels", "contact_friction", "places"}
)
_ENDINGS: Final = {"m": "_mm", "rad": "_deg", "px": "_px"}  # of keys, by unit
_UNIT = re.compile("(_mm|_deg|_px)+$")


class FileRecord(BaseModel):
    """Base of all records: rejects unknown keys, and numbers written as text."""

    model_config = ConfigDict(extra="forbid", strict=True)

    makes: ClassVar[Any] = None  # dataclass or function that the keys are the arguments of
    word: ClassVar[str] = ""  # its name in its own errors
    field_names: ClassVar[Mapping[str, str]] = {}  # keys -> fields of other names
    forms: ClassVar[Mapping[str, Any]] = {}  # of a choice: key -> class


class ChoiceRecord(FileRecord):
    """Base of records with exactly one of several keys."""

    model_config = ConfigDict(
        json_schema_extra=lambda schema: schema.update(
            oneOf=[{"required": [form]} for form in schema["properties"]]
        )
    )


R = TypeVar("R", bound=FileRecord)

# Records by what they make: a dataclass, or a union of those; and the key of each class in a union.
_RECORDS: Final[dict[Any, type[FileRecord]]] = {}
_FORMS: Final[dict[Any, str]] = {}


# --- records from dataclasses ---------------------------------------------------------------------


def record_of(
    kind: Any,
    word: str,
    /,
    *,
    title: str = "",
    units: bool = False,
    names: Mapping[str, str] | None = None,
    required: Sequence[str] = (),
    leave_out: Sequence[str] = (),
    more: Mapping[str, Any] | None = None,
    first: Sequence[str] = (),
    **types: Any,
) -> Any:
    """Make the record of a dataclass, which `made` and `content` convert.

    Parameters
    ----------
    kind : type
        Dataclass whose fields have a `Value`, or a type that files can hold.
    word : str
        Its name in its own errors.
    title : str
        Name of the record, of several for one class.
    units : bool
        Whether keys name their unit, and values are in millimetres and degrees.
    names : mapping of str to str, optional
        Keys, by the name of their field.
    required : sequence of str
        Fields that files must state, though they have a default.
    leave_out : sequence of str
        Fields that files do not have.
    more : mapping of str to (type, FieldInfo), optional
        Keys that are no field of the class.
    first : sequence of str
        Keys that files show before the others.
    **types
        Types of keys that do not follow from their fields.
    """
    said, own_names = meanings(kind.__doc__), dict(names or {})
    keys: dict[str, Any] = dict(more or {})
    for field in (one for one in fields(kind) if one.init and one.name not in leave_out):
        name, own = field.name, field_types(kind)[field.name]
        key = own_names.get(name) or name + (_ending(own.value) if units else "")
        hint = types[name] if name in types else _file_type(own)
        default = _default_of(field)
        if name in required:
            default = ...
        elif default is None or (default is ... and own.optional):
            hint, default = hint | None, None
        elif default is not ...:
            default = _scaled(key, default, _from_si)
        meaning = _description(said.get(name, ""), units=units)
        keys[key] = hint, Field(default, description=meaning)
    keys = {key: keys[key] for key in first} | keys
    record = create_model(title or f"{kind.__name__}Record", __base__=FileRecord, **keys)
    record.makes, record.word = kind, word
    record.field_names = {key: name for name, key in own_names.items()}
    _RECORDS.setdefault(kind, record)
    return record


def use_record(record: type[FileRecord], *kinds: Any) -> None:
    """Use a record that was written by hand for fields of some types."""
    _RECORDS.update(dict.fromkeys(kinds, record))


def choice_of(title: str, kinds: Any = None, /, **forms: Any) -> Any:
    """Make the record of a choice, with exactly one of several keys.

    `forms` has the class of each key: one with a record, or one with a single argument, whose
    value the file has. `kinds` is the union of the classes, where fields of it are of this record.
    """
    keys: dict[str, Any] = {}
    for key, kind in forms.items():
        hint, text = _RECORDS.get(kind), (kind.__doc__ or "").partition("\n")[0]
        if hint is None:
            name, own = next(iter(field_types(kind).items()))
            hint, text = _file_type(own), meanings(kind.__doc__)[name]
        about = _description(text, units=_UNIT.search(key) is not None)
        keys[key] = hint | None, Field(None, description=about)
    record = create_model(title, __base__=ChoiceRecord, **keys)
    record.forms = forms
    if kinds is not None:
        _FORMS.update({kind: form for form, kind in forms.items()})
        _RECORDS[kinds] = record
    return record


def _default_of(field: Any) -> Any:
    """Return the default of a field as files have it: None for an object of another class."""
    if field.default is MISSING:
        return ... if field.default_factory is MISSING else None
    if isinstance(field.default, float) and math.isinf(field.default):
        return None
    return list(field.default) if isinstance(field.default, tuple) else field.default


def _file_type(own: FieldType) -> Any:
    if own.value is None:
        return _plain_type(own.hint)
    if own.value.check in _NUMBERS:
        return _NUMBERS[own.value.check]
    assert own.value.check in (vector, table)
    width = own.value.unit.count(",") + 1
    row = Annotated[list[Number], Field(min_length=width, max_length=width)]
    return row if own.value.check is vector else list[row]


def _plain_type(hint: Any) -> Any:
    inner = [one for one in get_args(hint) if one is not NoneType]
    if get_origin(hint) in (Union, UnionType):
        hint = reduce(or_, inner)
    if hint in _RECORDS:
        return _RECORDS[hint]
    if get_origin(hint) is tuple:
        item = _plain_type(inner[0])
        fixed: Any = {} if inner[1] is ... else {"min_length": len(inner), "max_length": len(inner)}
        return Annotated[list[item], Field(**fixed)]  # type: ignore[valid-type]
    return Number if hint is float else hint


def _ending(value: Value | None) -> str:
    """Return the unit at the end of a key."""
    unit = value.unit if value else ""
    units = re.findall(r"\[(.*?)\]", unit) or [unit]
    return "".join(dict.fromkeys(_ENDINGS.get(unit, "") for unit in units))


def _description(meaning: str, *, units: bool) -> str | None:
    """Return the first sentence of a meaning, with the units of files."""
    first = re.split(r"[.;:](?:\s|$)", meaning)[0]
    if units:
        shown = {"m": "mm", "rad": "deg"}
        first = re.sub(
            r"\[([^]]*)\]$",
            lambda own: f"[{', '.join(shown.get(unit, unit) for unit in own[1].split(', '))}]",
            first,
        )
    return first[:1].lower() + first[1:] or None


# --- between records and objects ------------------------------------------------------------------


def made(record: Any, path: str = "", **given: Any) -> Any:
    """Build the object that a validated record describes; errors have the path of their key.

    Some of its arguments may be `given` instead.
    """
    kind = type(record)
    if kind.forms:
        return _chosen(record, path)
    values = arguments(record, path) | given
    with within(path, f"{kind.word} {values.get('name')!r}", kind.word):
        return kind.makes(**values)


def arguments(record: Any, path: str = "") -> dict[str, Any]:
    """Return the arguments that the keys of a record state, in SI units."""
    kind: Any = type(record)
    known = [one.name for one in fields(kind.makes)] if is_dataclass(kind.makes) else None
    values = {}
    for key, value in record:
        name = kind.field_names.get(key) or _UNIT.sub("", key)
        if value is not None and (known is None or name in known):
            values[name] = _inner(_scaled(key, value, _to_si), f"{path}.{key}".removeprefix("."))
    return values


def _chosen(record: Any, path: str) -> Any:
    form = only_form(record, path)
    kind, value = type(record).forms[form], getattr(record, form)
    if isinstance(value, FileRecord):
        return made(value, f"{path}.{form}")
    with within(path):
        return kind() if value is None else kind(_scaled(form, value, _to_si))


def _inner(value: Any, path: str) -> Any:
    if isinstance(value, FileRecord):
        return made(value, path)
    if isinstance(value, dict):
        return {name: _inner(item, f"{path}.{name}") for name, item in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], FileRecord):
        return tuple(made(item, f"{path}[{k}]") for k, item in enumerate(value))
    return value


def content(value: Any) -> Any:
    """Convert objects to dicts, lists and plain values, as in files; inverse of `made`."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return [content(item) for item in value]
    kind = type(value)
    record = _RECORDS.get(kind)
    if record is None and kind not in _FORMS:
        return value
    own = keys_of(value, record) if record else content(getattr(value, fields(kind)[0].name))
    return {_FORMS[kind]: own} if kind in _FORMS else own


def keys_of(value: Any, record: type[FileRecord]) -> dict[str, Any]:
    """Return the keys of a record that the fields of an object state."""
    defaults = {
        field.name: field.default if field.default_factory is MISSING else field.default_factory()
        for field in fields(value)
        if field.name in _OMITTED
    }
    found = {}
    for key in record.model_fields:
        name = record.field_names.get(key) or _UNIT.sub("", key)
        item = getattr(value, name, None)
        if item is None or (isinstance(item, float) and math.isinf(item)):
            continue
        if name not in defaults or np.any(item != defaults[name]):
            found[key] = _scaled(key, content(item), _from_si)
    if "drive" in found:
        found["drive"] = found.pop("drive")  # last, since it may have many waypoints
    return found


def si_field(key: str, value: Any) -> tuple[str, Any]:
    """Return a key without its unit, and its value in metres and radians."""
    return _UNIT.sub("", key), _scaled(key, value, _to_si)


def plain(number: float) -> float:
    """Round a number to 15 digits: `25.4` instead of `25.400000000000002`."""
    return float(f"{number:.15g}")


def _scaled(key: str, value: Any, scale: Callable[[str, float], float]) -> Any:
    """Convert the value of a key between its unit and that of the model; plain for files."""
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if value is None or not key.endswith(("_mm", "_deg")):
        return value
    if key.endswith("_mm_deg"):
        x, y, angle = value
        return [scale("_mm", x), scale("_mm", y), scale("_deg", angle)]
    if isinstance(value, dict):
        return {name: _scaled(key, item, scale) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_scaled(key, item, scale) for item in value]
    return scale("_mm" if key.endswith("_mm") else "_deg", value)


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
    # In YAML, `none:` has no value.
    valueless = (form for form, kind in record.forms.items() if not fields(kind))
    given = given or [form for form in valueless if form in record.model_fields_set]
    if len(given) != 1:
        raise InvalidInput(
            path, found=" and ".join(given) or None, expected="exactly one of " + ", ".join(forms)
        )
    return given[0]


@contextmanager
def within(path: str, *words: str) -> Iterator[None]:
    """Report errors of built objects at a key of the file, without their own first word."""
    try:
        yield
    except InvalidInput as problem:
        where = problem.where
        for word in filter(None, words):
            if where.startswith(word) and where[len(word) : len(word) + 1] in ("", ".", "["):
                where = where[len(word) :].removeprefix(".")
        moved = problem.at(where or path)
        raise (moved.within(path) if where and path else moved) from None


# --- validation -----------------------------------------------------------------------------------


def validated(root: type[R], raw: Any, name: str) -> R:
    """Validate every key and kind of value in the raw content of a file.

    `name` is that of the whole in errors: `"scene"`. The first error has the path of its key.
    """
    try:
        return root.model_validate(raw)
    except ValidationError as problems:
        raise _explained(problems, root, raw, name) from None


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
    found, expected = "an unknown key", "one of " + ", ".join(known) if known else "no keys here"
    return InvalidInput(
        written(path), found=found, expected=expected, hint=did_you_mean(path[-1], known)
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
    refused = refused_value(problems)
    expected = str(refused.expected)
    if kind == "model_type" and (record := record_at(root, path)):
        expected = "a mapping with the keys " + ", ".join(record.model_fields)
    elif description := description_at(root, path):
        expected += f" ({description})"
    return InvalidInput(written(path) or name, found=refused.found, expected=expected)


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
