"""Values: types that answers and requests share, and filters that write them on pages."""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Any, Final

import numpy as np
from markupsafe import Markup
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    model_validator,
)

from fixel.errors import counted, number_of
from fixel.progress import time_text
from fixel.table import Table
from fixel.typing import FloatArray, IntArray
from fixel.units import displayed, split_unit

MAX_ID = 2**31 - 1  # largest integer of a database
MAX_KEYS = 100  # keys of a request's body; those that are known are about ten


def _plain_number(value: Any) -> Any:
    """Reject a text that pydantic takes for a number, such as `1_0`."""
    return number_of(value, "number") if isinstance(value, str) else value


# Numbers and ids, as they stand in addresses and in bodies.
Number = Annotated[float, BeforeValidator(_plain_number)]
Whole = Annotated[int, BeforeValidator(_plain_number)]
Id = Annotated[Whole, Field(ge=1, le=MAX_ID)]


def plain_text(text: str) -> str:
    """Reject what neither a database nor a browser can store."""
    if any(c < " " and c not in "\n\t" for c in text):
        raise ValueError("text without control characters")
    return text


def storable(value: Any) -> Any:
    """Reject what no file can store, before an error message is made of it."""
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except (UnicodeEncodeError, RecursionError):
        raise ValueError("text that a file can store, with few levels") from None
    return value


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


Text = Annotated[str, AfterValidator(plain_text)]
# JSON has no number that is infinite or none.
Finite = Annotated[float | None, BeforeValidator(_finite)]


class Answer(BaseModel):
    """Part of an answer; it can be made of any object with the same attributes."""

    model_config = ConfigDict(
        frozen=True, from_attributes=True, json_schema_serialization_defaults_required=True
    )


def _few_keys(body: Any) -> Any:
    """Reject a body with many unknown keys before each of them becomes an error."""
    if isinstance(body, dict) and len(body) > MAX_KEYS:
        raise ValueError(f"at most {MAX_KEYS} keys, not {len(body)} keys")
    return body


OpenBody = Annotated[dict[str, Any], BeforeValidator(_few_keys)]  # its reader knows the keys


class RequestBody(BaseModel):
    """The body of a request: unknown keys are refused, very many of them at once."""

    model_config = ConfigDict(extra="forbid")

    _limit_keys = model_validator(mode="before")(_few_keys)


class PackedArray(BaseModel):
    """Numbers: little-endian, row after row, in base64."""

    dtype: str = Field(description='"<f8" or "<f4" or "<i4", as NumPy names them')
    shape: list[int]
    base64: str


def _packed(values: np.ndarray[Any, Any], dtype: str = "<f8") -> PackedArray:
    array = np.ascontiguousarray(values, dtype=dtype)
    data = base64.b64encode(array.tobytes()).decode("ascii")
    return PackedArray(dtype=dtype, shape=list(array.shape), base64=data)


# Arrays, which are packed when an answer is written.
_as_it_is = PlainValidator(lambda value: value)
Array = Annotated[FloatArray, _as_it_is, PlainSerializer(_packed)]
ShortArray = Annotated[FloatArray, _as_it_is, PlainSerializer(partial(_packed, dtype="<f4"))]
IndexArray = Annotated[
    IntArray, _as_it_is, PlainSerializer(partial(_packed, dtype="<i4"), return_type=PackedArray)
]
# A few numbers, which stand in an answer as they are.
Numbers = Annotated[
    FloatArray, _as_it_is, PlainSerializer(lambda values: values.tolist(), return_type=list[float])
]


NONE: Final = "\u2013"  # for what is not known

# Sign and colour of a verdict: never the colour alone.
_VERDICTS: Final = {
    "identified": ("\u2713", "good"),
    "trades off": ("\u21c4", "off"),
    "not identified": ("?", "off"),
    "not excited": ("\u2205", "off"),
    "at bound": ("\u21e5", "fault"),
    "effective": ("\u2248", "off"),
    "precise, but the model misfits": ("\u2260", "fault"),
    "at least": ("\u2265", "off"),
    "at most": ("\u2264", "off"),
    "frozen": ("\u2016", ""),
}


def fixed(value: float | None, digits: int = 1, factor: float = 1.0) -> str:
    """Format a number with a true minus sign, and none before a zero."""
    if value is None or not math.isfinite(value):
        return NONE
    text = f"{abs(factor * value):.{digits}f}"
    return f"\u2212{text}" if value < 0.0 and float(text) else text


def short(value: float | None) -> str:
    """Format a number with at most four digits."""
    if value is None or not math.isfinite(value):
        return NONE
    return f"{value:.4g}".replace("-", "\u2212", 1)


def minus(text: str) -> str:
    """Return a text with true minus signs before its numbers."""
    return re.sub(r"(^|\s)-(?=[\d.])", "\\1\u2212", text)


def count(number: int) -> str:
    """Format a number with its thousands apart."""
    return f"{number:,}".replace(",", "\u202f")


def several(number: int, what: str) -> str:
    """Return a number of things: `1 experiment`, `2 experiments`."""
    return counted(count(number), what)


def condition(name: str, value: str | float) -> tuple[str, str, str]:
    """Return name, value and unit of a condition, in the unit that its name ends with."""
    if isinstance(value, str):
        return name.replace("_", " "), value, ""
    stem, si = split_unit(name)
    unit, factor = displayed(si)
    return stem.removesuffix("_ratio").replace("_", " "), short(factor * value), unit


def lasting(seconds: float | None) -> str:
    """Format a duration, if it is known."""
    return NONE if seconds is None or not math.isfinite(seconds) else time_text(seconds)


def size(number: int | None) -> str:
    """Format a size in decimal units."""
    if number is None:
        return "stored on a server"
    value = float(number)
    for unit in ("byte", "kB", "MB", "GB"):
        if value < 1000.0:
            return f"{value:.3g} {unit}" if unit != "byte" else f"{number} byte"
        value /= 1000.0
    return f"{value:.3g} TB"


def instant(iso: str) -> str:
    """Format a time in UTC to the minute."""
    return f"{iso[:10]} {iso[11:16]}" if len(iso) >= 16 else iso


def touched(contacts: str) -> str:
    """Describe a measured contact mode: `fixel 1 and 3`, `no fixel`."""
    found = [str(k) for k, digit in enumerate(contacts, 1) if digit == "1"]
    return "fixel " + " and ".join(found) if found else "no fixel"


def rms(error: float | None, unit: str) -> float | None:
    """Return an error that is a mean square as its root [mm]; any other as it is."""
    return math.sqrt(error) if error is not None and unit == "mm^2" else error


def verdict(name: str) -> tuple[str, str]:
    """Return the sign and the class of a verdict."""
    return _VERDICTS.get("trades off" if name.startswith("trades") else name, ("", ""))


def corners(outline: FloatArray) -> str:
    """Return the corners of an outline for an SVG [mm]; its y points down."""
    return " ".join(f"{1e3 * x:.3f},{-1e3 * y:.3f}" for x, y in outline)


def html(table: Table) -> Markup:
    """Return a table as markup; it escapes its texts itself."""
    return Markup(table.html())


FILTERS: Final[Mapping[str, Callable[..., Any]]] = {
    filter.__name__: filter
    for filter in (
        fixed, short, minus, count, several, lasting, size, instant, touched, rms, verdict, corners,
        html,
    )
}  # fmt: skip
