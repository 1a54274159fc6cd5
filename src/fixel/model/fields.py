"""Checks of field values, and equality of objects that contain arrays."""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache
from numbers import Real
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, number_of, quoted
from fixel.typing import FloatArray

MAX_SHOWN: Final = 60  # numbers of an array that are printed
MAX_WHOLE: Final = 2**63 - 1  # of databases and compiled code
MAX_SEED: Final = 2**32 - 1  # of NumPy's old generator, which SciPy and others use


class Comparable:
    """Equality, hash and text by fields, for dataclasses with `eq=False` and arrays or mappings.

    With `repr=False`, the text is a call with the fields that differ from their defaults.
    """

    __slots__ = ()

    def __repr__(self) -> str:
        given = []
        for own in dataclasses.fields(self):  # type: ignore[arg-type]
            value, factory = getattr(self, own.name), own.default_factory
            usual: Any = own.default if factory is dataclasses.MISSING else factory()
            if own.repr and not np.array_equal(value, usual):
                given.append(f"{own.name}={_shown(value)}")
        return f"{type(self).__name__}({', '.join(given)})"

    def _compared(self) -> tuple[Any, ...]:
        named = dataclasses.fields(self)  # type: ignore[arg-type]
        return tuple(_hashable(getattr(self, field.name)) for field in named if field.compare)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self._compared() == other._compared()

    def __hash__(self) -> int:
        return hash((type(self).__name__, self._compared()))


def settle(instance: object, **values: object) -> None:
    """Write checked values into a frozen instance, from its `__post_init__` only."""
    for name, value in values.items():
        object.__setattr__(instance, name, value)


class Value(NamedTuple):
    """Annotation of a field: the check of its value, with the unit or the labels of columns.

    Constructors check it with `check_fields`. Files have the same limits, and keys with the unit.
    """

    check: Callable[..., Any]  # `positive`, `vector`, ... of this module
    unit: str = ""


class FieldType(NamedTuple):
    """Type of a field as its annotation states it."""

    hint: Any
    value: Value | None
    optional: bool  # whether None is allowed


@cache
def field_types(kind: Any) -> Mapping[str, FieldType]:
    """Return the types of the fields of a dataclass, by name."""
    hints = get_type_hints(kind, include_extras=True)
    found = {}
    for field in dataclasses.fields(kind):
        hint = hints[field.name]
        own = next(
            (one for one in getattr(hint, "__metadata__", ()) if isinstance(one, Value)), None
        )
        hint = get_args(hint)[0] if own else hint
        optional = field.default is None or NoneType in get_args(hint)
        found[field.name] = FieldType(hint, own, optional)
    return found


def check_fields(instance: Any, where: str = "", leave_out: Collection[str] = ()) -> None:
    """Check the annotated fields of an instance, from its `__post_init__`, and store them.

    `where` is the prefix of the fields in errors; the class itself checks those in `leave_out`.
    """
    prefix = f"{where}." if where else ""
    kind: Any = type(instance)
    for name, (_, own, optional) in field_types(kind).items():
        value = getattr(instance, name)
        if own is not None and name not in leave_out and not (optional and value is None):
            units = (own.unit,) if own.unit else ()
            object.__setattr__(instance, name, own.check(value, prefix + name, *units))


def name_of(value: object, where: str) -> str:
    """Return a name, checked to be non-empty text on one line."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise InvalidInput(where, found=quoted(value), expected="a name of printable characters")
    return value


def pose_of(text: str, where: str) -> FloatArray:
    """Return a pose (3,) [m, m, rad] from text such as `120.5,3,-10` [mm, mm, deg]."""
    try:
        x, y, angle = (number_of(part, where) for part in text.split(","))
    except ValueError:
        expected = "x,y,angle in mm, mm and degrees: 120.5,3,-10"
        raise InvalidInput(where, found=repr(text), expected=expected) from None
    return np.array([x / 1e3, y / 1e3, math.radians(angle)])


def instance(value: object, kind: type | UnionType, where: str, expected: str) -> None:
    """Raise for a value of another type."""
    if not isinstance(value, kind):
        found = None if value is None else f"the type {type(value).__name__}"
        raise InvalidInput(where, found=found, expected=expected)


def finite(value: object, where: str, unit: str = "") -> float:
    """Return a value as a float, checked to be finite."""
    return _number(value, where, f"a finite number{_in(unit)}", lambda x: True)


def positive(value: object, where: str, unit: str = "") -> float:
    """Return a value as a float, checked to be finite and above zero."""
    return _number(value, where, f"a number greater than 0{_in(unit)}", lambda x: x > 0.0)


def non_negative(value: object, where: str, unit: str = "") -> float:
    """Return a value as a float, checked to be finite and at least zero."""
    return _number(value, where, f"a number of at least 0{_in(unit)}", lambda x: x >= 0.0)


def fraction(value: object, where: str) -> float:
    """Return a value as a float, checked to be from 0 to 1."""
    return _number(value, where, "a number from 0 to 1", lambda x: 0.0 <= x <= 1.0)


def inner_share(value: object, where: str) -> float:
    """Return a value as a float, checked to be between 0 and 1, and neither of them."""
    return _number(value, where, "a number between 0 and 1", lambda x: 0.0 < x < 1.0)


def optional_positive(value: object, where: str, unit: str = "") -> float | None:
    """Return a value as a float, checked to be finite and above zero, or None."""
    return None if value is None else positive(value, where, unit)


def texts(value: object, where: str) -> tuple[str, ...]:
    """Return several texts, also of one alone; raise for other values."""
    many = isinstance(value, Iterable) and not isinstance(value, str)
    found: tuple[Any, ...] = tuple(value) if many else (value,)  # type: ignore[arg-type]
    for one in found:
        instance(one, str, where, "a text, or several")
    return found


def path_of(value: object, where: str) -> Path:
    """Return a path; raise for a value that cannot be one."""
    instance(value, str | PathLike, where, "a path")
    if "\0" in str(value):
        raise InvalidInput(where, found=quoted(value), expected="a path without null characters")
    return Path(value)  # type: ignore[arg-type]


def whole(value: object, where: str, least: int = 1, most: int = MAX_WHOLE) -> int:
    """Return a whole number from `least` to `most`, or raise `InvalidInput`."""
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = least - 1
    if not least <= number <= most or isinstance(value, bool):
        is_open = number < least and most == MAX_WHOLE
        limits = f"of at least {least}" if is_open else f"from {least} to {most}"
        raise InvalidInput(where, found=quoted(value), expected=f"a whole number {limits}")
    return number


def vector(value: ArrayLike, where: str, labels: str) -> FloatArray:
    """Return a checked row of finite numbers, one per comma-separated label: `"x [m], y [m]"`."""
    length = labels.count(",") + 1
    row = floats(value, where, f"{length} numbers: {labels}")
    if row.shape != (length,):
        raise InvalidInput(where, found=_shape(row), expected=f"{length} numbers: {labels}")
    _check_finite(row, where, labels)
    return frozen(row)


def table(value: ArrayLike, where: str, labels: str) -> FloatArray:
    """Return checked rows of finite numbers, one column per comma-separated label."""
    width = labels.count(",") + 1
    rows = floats(value, where, f"rows of {width} numbers: {labels}")
    if rows.ndim != 2 or rows.shape[1] != width or len(rows) == 0:
        raise InvalidInput(where, found=_shape(rows), expected=f"rows of {width} numbers: {labels}")
    for index, row in enumerate(rows) if not np.isfinite(rows).all() else ():
        _check_finite(row, f"{where}[{index}]", labels)
    return frozen(rows)


def numbers(value: ArrayLike, where: str) -> FloatArray:
    """Return an array of finite numbers, of any shape."""
    array = floats(value, where, "finite numbers")
    _check_finite(array, where, "one or an array")
    return array


def frozen(array: ArrayLike) -> FloatArray:
    """Return a read-only C-ordered copy; minus zero becomes zero."""
    copy: FloatArray = np.add(np.asarray(array, np.float64), 0.0, order="C")
    copy.flags.writeable = False
    return copy


def _number(value: object, where: str, expected: str, fits: Callable[[float], bool]) -> float:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if not _is_real(value):
        raise InvalidInput(where, found=quoted(value), expected=expected)
    try:
        number = float(value)  # type: ignore[arg-type]
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or not fits(number):
        raise InvalidInput(where, found=number, expected=expected)
    return number


def floats(value: ArrayLike, where: str, expected: str) -> FloatArray:
    """Return an array of numbers; raise for other content, also behind a mask."""
    try:
        raw = np.asarray(value)
        if np.ma.is_masked(value) or not (raw.dtype.kind in "iuf" or all(map(_is_real, raw.flat))):
            raise TypeError
        return raw.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        found = "masked values" if np.ma.is_masked(value) else quoted(value)
        raise InvalidInput(where, found=found, expected=expected) from None


def readings(value: ArrayLike, where: str) -> FloatArray:
    """Return a read-only array of numbers or truth values; NaN where one is missing or masked."""
    try:
        if np.asarray(value).dtype.kind in "cmMSU":
            raise TypeError
        lost = np.ma.getmaskarray(value)  # type: ignore[arg-type]
        array = np.where(lost, np.nan, np.asarray(value, np.float64))
    except (TypeError, ValueError):
        expected = "numbers, or NaN for none"
        raise InvalidInput(where, found=quoted(value), expected=expected) from None
    return frozen(array)


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool | np.bool_ | np.timedelta64)


def _check_finite(row: FloatArray, where: str, labels: str) -> None:
    if not np.isfinite(row).all():
        raise InvalidInput(where, found=row.tolist(), expected=f"finite numbers: {labels}")


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _shape(array: FloatArray) -> str:
    if array.ndim == 0:
        return "one number"
    if array.size == 0:
        return "an empty list"
    return "one row of " + str(len(array)) if array.ndim == 1 else f"an array of {array.shape}"


def _shown(value: Any) -> str:
    """Return an array as a list, a long one by its shape, and other values as they are."""
    if not isinstance(value, np.ndarray):
        return repr(value)
    return repr(value.tolist()) if value.size <= MAX_SHOWN else f"<array of {value.shape}>"


def _hashable(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, Mapping):
        return tuple((key, _hashable(value[key])) for key in sorted(value))
    return tuple(map(_hashable, value)) if isinstance(value, list) else value
