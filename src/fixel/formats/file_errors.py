"""Errors in files of records, as sentences with the path of the key."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, get_args

from pydantic import ValidationError

from fixel.errors import InvalidInput
from fixel.formats.scene_schema import SceneLevel, written


def explained(problems: ValidationError, root: type[SceneLevel], name: str) -> InvalidInput:
    """First error of a schema without unions, as `InvalidInput`; `name` is that of the file."""
    first = problems.errors(include_url=False)[0]
    path, kind = first["loc"], first["type"]
    if kind == "extra_forbidden":
        return _unknown_key(root, path)
    record = _record_at(root, path)
    if record and kind == "model_type":
        expected = "the keys " + ", ".join(record.model_fields)
    elif kind == "missing":
        expected = "a value: this key is required"
    else:
        expected = first["msg"].removeprefix("Input should be ").replace("valid ", "")
    found = None if kind == "missing" else first["input"]
    description = _description(root, path)
    return InvalidInput(
        written(path) or name,
        found=repr(found) if isinstance(found, str) else found,
        expected=f"{expected} ({description})" if description else expected,
    )


def only_form(record: SceneLevel, path: str) -> str:
    """Return the name of the one form that is given; raise if there are none or several."""
    forms = list(type(record).model_fields)
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


def _unknown_key(root: type[SceneLevel], path: Sequence[str | int]) -> InvalidInput:
    record = _record_at(root, path[:-1])
    known = list(record.model_fields) if record else []
    close = difflib.get_close_matches(str(path[-1]), known, n=1)
    return InvalidInput(
        written(tuple(path)),
        found="an unknown key",
        expected="one of " + ", ".join(known) if known else "no keys here",
        hint=f"did you mean {close[0]!r}?" if close else None,
    )


def _record_at(root: type[SceneLevel], path: Sequence[str | int]) -> type[SceneLevel] | None:
    """Class of the record at a path; None if there is no record."""
    record: type[SceneLevel] | None = root
    for key in path:
        if isinstance(key, str):
            field = record.model_fields.get(key) if record else None
            record = _record_in(field.annotation) if field else record
    return record


def _record_in(annotation: Any) -> type[SceneLevel] | None:
    if isinstance(annotation, type) and issubclass(annotation, SceneLevel):
        return annotation
    inner = (_record_in(argument) for argument in get_args(annotation))
    return next((record for record in inner if record), None)


def _description(root: type[SceneLevel], path: Sequence[str | int]) -> str | None:
    names = [k for k, key in enumerate(path) if isinstance(key, str)]
    record = _record_at(root, path[: names[-1]]) if names else None
    field = record.model_fields.get(str(path[names[-1]])) if record else None
    return field.description if field else None
