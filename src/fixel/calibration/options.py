"""Checks of options that several optimisers share."""

from __future__ import annotations

import operator

from fixel.errors import InvalidInput
from fixel.model.fields import fraction, positive, settle

__all__ = ["between", "fraction", "positive", "settle", "whole"]


def whole(value: object, where: str, least: int = 1) -> int:
    """Return a whole number of at least `least`, or raise `InvalidInput`."""
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = least - 1
    if number < least or isinstance(value, bool):
        raise InvalidInput(where, found=value, expected=f"a whole number of at least {least}")
    return number


def between(value: object, where: str) -> float:
    """Return a number between 0 and 1, exclusive, or raise `InvalidInput`."""
    number = positive(value, where)
    if number >= 1.0:
        raise InvalidInput(where, found=number, expected="a number between 0 and 1")
    return number
