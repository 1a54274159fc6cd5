"""Types of values that answers and requests share."""

from __future__ import annotations

import base64
import json
import math
from functools import partial
from typing import Annotated, Any

import numpy as np
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

from fixel.typing import FloatArray, IntArray

MAX_ID = 2**31 - 1  # largest integer of a database
MAX_KEYS = 100  # keys of a request's body; those that are known are about ten

# Ids, as they stand in addresses and in bodies.
Id = Annotated[int, Field(ge=1, le=MAX_ID)]


def plain_text(text: str) -> str:
    """Reject what neither a database nor a browser can store."""
    if any(c < " " and c not in "\n\t" for c in text):
        raise ValueError("control characters in a text")
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
        raise ValueError(f"{len(body)} keys; at most {MAX_KEYS} are allowed")
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
