"""Types of values that several resources share."""

from __future__ import annotations

import base64
from typing import Annotated, Any

import numpy as np
from fastapi import Path
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

MAX_ID = 2**31 - 1  # largest integer of a database
MOST_KEYS = 100  # keys of a request's body; those that are known are about ten

# Ids, as they stand in addresses and in bodies.
Number = Annotated[int, Path(ge=1, le=MAX_ID)]
Id = Annotated[int, Field(ge=1, le=MAX_ID)]


def plain_text(text: str) -> str:
    """Reject what neither a database nor a browser can store."""
    if any(c < " " and c not in "\n\t" for c in text):
        raise ValueError("control characters in a text")
    return text


Text = Annotated[str, AfterValidator(plain_text)]


class RequestBody(BaseModel):
    """The body of a request: unknown keys are refused, very many of them at once."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _few_keys(cls, body: Any) -> Any:
        """Reject a body with many unknown keys before each of them becomes an error."""
        if isinstance(body, dict) and len(body) > MOST_KEYS:
            raise ValueError(f"{len(body)} keys; at most {MOST_KEYS} are read")
        return body


class Array(BaseModel):
    """Numbers: little-endian, row after row, in base64."""

    dtype: str = Field(description='"<f8" or "<f4" or "<i4", as NumPy names them')
    shape: list[int]
    base64: str

    @classmethod
    def of(cls, values: ArrayLike, dtype: str = "<f8") -> Array:
        """Encode an array."""
        array = np.ascontiguousarray(values, dtype=dtype)
        data = base64.b64encode(array.tobytes()).decode("ascii")
        return cls(dtype=dtype, shape=list(array.shape), base64=data)
