"""Loading of YAML and JSON from files that may be malicious or wrong.

Values are built from the events of the parser, to forbid tags, aliases and duplicate keys. Files
have at most `MAX_DEPTH` levels and `MAX_BYTES` in all. Plain scalars follow the core schema of
YAML 1.2: `1e-3` is a number, `no` and `1:30` are text.
"""

from __future__ import annotations

import json
import math
import re
import shlex
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from fixel.errors import InvalidInput
from fixel.io.atomic import read_bounded

# [bytes] Scene files have some kilobytes; a measured path of an hour at 100 Hz has about 10 MB.
MAX_BYTES = 10_000_000
# Scene files have about 7 levels. With much larger values a file could exhaust the stack later.
MAX_DEPTH = 40
TABLES = (".csv", ".csv.gz", ".tsv", ".parquet")  # endings of files that are never documents

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INTEGER = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WORDS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}


def read_document(path: Path, kind: str = "file") -> Any:
    """Load a YAML or JSON file as dicts, lists, text, numbers, booleans and None.

    Errors name its `kind`, such as `"scene file"`. A file that is missing, a table, too large, not
    UTF-8, or not one valid document within the limits raises `InvalidInput`.
    """
    if path.is_file() and path.name.lower().endswith(TABLES):
        name = shlex.quote(str(path))
        hint = f"import its poses: fixel import {name}; or perform its rows: fixel bench {name}"
        expected = f"a {kind}, in YAML or JSON"
        raise InvalidInput(str(path), found="a table", expected=expected, hint=hint)
    text = _text(path, kind)
    parse = parse_json if path.suffix.lower() == ".json" else parse_yaml
    return parse(text, str(path))


@contextmanager
def document(path: str | Path, kind: str = "file") -> Iterator[Any]:
    """Yield the content of a file, as `read_document`; errors in the block name the file."""
    content = read_document(Path(path), kind)
    try:
        yield content
    except InvalidInput as problem:
        raise problem.at(f"{path}: {problem.where}") from None


def parse_yaml(text: str, where: str) -> Any:
    """Return the content of one YAML document; `where` names it in errors."""
    if (whole := text.rstrip()).endswith("\n---"):  # `ros2 topic echo` ends every message so
        text = whole.removesuffix("---")
    try:
        return _composed(yaml.parse(text, Loader=_LOADER), where)
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        line = f"{where}, line {mark.line + 1}" if mark else where
        found = f"an error ({getattr(problem, 'problem', None) or 'an unusual character'})"
        raise InvalidInput(line, found=found, expected="well-formed YAML") from None


def parse_json(text: str, where: str) -> Any:
    """Return the content of a JSON text; `where` names it in errors."""
    try:
        value = json.loads(text, object_pairs_hook=lambda pairs: _unique(pairs, where))
    except json.JSONDecodeError as problem:
        line = f"{where}, line {problem.lineno}"
        found = f"an error at column {problem.colno}"
        raise InvalidInput(line, found=found, expected="well-formed JSON") from None
    except RecursionError:
        raise _too_deep(where) from None
    except InvalidInput:
        raise
    except ValueError:
        found, expected = "a number of too many digits", "numbers that can be read"
        raise InvalidInput(where, found=found, expected=expected) from None
    _refuse_depth(value, where)
    return value


def yaml_text(content: Any) -> str:
    """Return YAML text with the same meaning in versions 1.1 and 1.2."""
    options: Any = {"sort_keys": False, "default_flow_style": None, "width": 100}
    return str(yaml.dump(content, Dumper=_Dumper, **options))


def plain_numbers(value: Any) -> Any:
    """Convert a value for strict JSON: arrays to lists, numbers that are not finite to None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: plain_numbers(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_numbers(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def plain_scalar(text: str) -> Any:
    """Return the value of an unquoted scalar."""
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text) if len(text) < 300 else float(text)
    if _BASED.fullmatch(text) and len(text) < 300:
        return int(text, 0)
    return float(text) if _FLOAT.fullmatch(text) else text


def _text(path: Path, kind: str) -> str:
    data = read_bounded(path, f"a {kind}, in YAML or JSON", MAX_BYTES, "resample measured paths")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        found = f"a byte that is not UTF-8 at position {problem.start}"
        raise InvalidInput(str(path), found=found, expected="text in UTF-8") from None


class _Open:
    """List or mapping whose end has not been parsed yet."""

    def __init__(self, value: Any) -> None:
        self.value = value
        self.key: str | None = None

    def take(self, item: Any, event: Any, where: str) -> None:
        if isinstance(self.value, list):
            self.value.append(item)
        elif self.key is not None:
            self.value[self.key] = item
            self.key = None
        elif not isinstance(event, yaml.ScalarEvent):
            raise _refused(event, where, "a list or mapping as a key", "text")
        elif event.value in self.value:
            raise _refused(event, where, f"the key {event.value!r} twice", "each key once")
        else:
            self.key = event.value


def _composed(events: Iterator[Any], where: str) -> Any:
    root = _Open([])
    stack = [root]
    for event in events:
        if isinstance(event, yaml.AliasEvent):
            hint = "write the value instead"
            raise _refused(event, where, f"the alias *{event.anchor}", "no aliases", hint)
        if getattr(event, "tag", None) not in (None, "!") and not isinstance(
            event, yaml.DocumentStartEvent
        ):
            raise _refused(event, where, f"the tag {event.tag}", "no tags")
        if isinstance(event, yaml.ScalarEvent):
            plain = event.implicit[0] and not event.style
            stack[-1].take(plain_scalar(event.value) if plain else event.value, event, where)
        elif isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
            if len(stack) > MAX_DEPTH:
                raise _too_deep(where)
            inner = _Open({} if isinstance(event, yaml.MappingStartEvent) else [])
            stack[-1].take(inner.value, event, where)
            stack.append(inner)
        elif isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent):
            stack.pop()
        elif isinstance(event, yaml.DocumentStartEvent) and root.value:
            raise _refused(event, where, "a second document", "one document")
    return root.value[0] if root.value else None


def _refused(
    event: Any, where: str, found: str, expected: str, hint: str | None = None
) -> InvalidInput:
    line = event.start_mark.line + 1
    return InvalidInput(f"{where}, line {line}", found=found, expected=expected, hint=hint)


def _too_deep(where: str) -> InvalidInput:
    found = f"more than {MAX_DEPTH} levels of nesting"
    return InvalidInput(
        where, found=found, expected="at most about seven levels, as in scene files"
    )


def _refuse_depth(value: Any, where: str) -> None:
    level = [value] if isinstance(value, dict | list) else []
    for _ in range(MAX_DEPTH):
        level = [
            inner
            for outer in level
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, dict | list)
        ]
    if level:
        raise _too_deep(where)


def _unique(pairs: list[tuple[str, Any]], where: str) -> dict[str, Any]:
    seen = dict(pairs)
    if len(seen) < len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise InvalidInput(where, found=f"the key {twice!r} twice", expected="each key once")
    return seen


class _Dumper(yaml.SafeDumper):
    """Dumper without aliases, which quotes text that would be parsed as another type."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_text(dumper: _Dumper, text: str) -> yaml.Node:
    style = None if isinstance(plain_scalar(text), str) else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent_text)
