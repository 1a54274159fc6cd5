"""Files of the parameters to search: space files, and Dakota input files as in the thesis.

Of Dakota, the method `coliny_pattern_search` and one block of continuous design variables are
read. Missing keywords take Dakota's defaults. Blocks on how Dakota was run are skipped.

Source: Dakota reference manual, input file formatting and `coliny_pattern_search`; SCOLIB for
defaults; appendix C.7 of the thesis (RPI).
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from fixel.calibration.direct_search import PatternSearch
from fixel.errors import InvalidInput, did_you_mean, unknown_name
from fixel.formats.records import arguments, record_of, validated, within
from fixel.io.atomic import read_bounded, usable
from fixel.io.document import document
from fixel.model.parameters import KNOWN_PARAMETERS, in_si, is_parameter
from fixel.model.space import ParameterSpace, Unknown

MAX_BYTES: Final = 1_000_000

# Descriptors of the thesis -> fixel's name, and the factor from their unit to fixel's.
DESCRIPTORS: Final = {
    "fC": ("mu_fixel", 1.0),
    "pCFC": ("mu_pusher", 1.0),
    "sPRD": ("tripod_radius", 1e-3),  # mm
    "sFC": ("mu_support", 1.0),
}

BLOCKS: Final = (
    "strategy",
    "environment",
    "method",
    "model",
    "variables",
    "interface",
    "responses",
)
_SKIPPED: Final = ("strategy", "environment", "interface", "responses")

# Kind of value after each keyword, under the keyword's newer or shorter name.
_FLAG, _NUMBER, _COUNT, _NUMBERS, _STRINGS = "", "a number", "a whole number", "numbers", "strings"
_METHOD: Final[dict[str, object]] = {
    "coliny_pattern_search": _FLAG,
    "id_method": _STRINGS,
    "output": ("silent", "quiet", "normal", "verbose", "debug"),
    "initial_delta": _NUMBER,
    "variable_tolerance": _NUMBER,
    "contraction_factor": _NUMBER,
    "solution_target": _NUMBER,
    "max_iterations": _COUNT,
    "max_function_evaluations": _COUNT,
    "expand_after_success": _COUNT,
    "expansion": _FLAG,
    "no_expansion": _FLAG,
    "exploratory_moves": ("basic_pattern",),
    "pattern_basis": ("coordinate",),
    "synchronization": ("blocking", "nonblocking"),
}
_VARIABLES: Final[dict[str, object]] = {
    "id_variables": _STRINGS,
    "continuous_design": _COUNT,
    "initial_point": _NUMBERS,
    "lower_bounds": _NUMBERS,
    "upper_bounds": _NUMBERS,
    "descriptors": _STRINGS,
}
_MODEL: Final[dict[str, object]] = {
    "single": _FLAG,
    "id_model": _STRINGS,
    "variables_pointer": _STRINGS,
    "interface_pointer": _STRINGS,
    "responses_pointer": _STRINGS,
}
_KNOWN: Final = {"method": _METHOD, "variables": _VARIABLES, "model": _MODEL}
_OTHER_NAMES: Final = {
    "threshold_delta": "variable_tolerance",
    "solution_accuracy": "solution_target",
    "cdv_initial_point": "initial_point",
    "cdv_lower_bounds": "lower_bounds",
    "cdv_upper_bounds": "upper_bounds",
    "cdv_descriptors": "descriptors",
    "cdv_descriptor": "descriptors",
    "descriptor": "descriptors",
}

# Dakota's defaults of keywords that a file omits.
_DEFAULTS: Final = {
    "initial_delta": 1.0,
    "variable_tolerance": 1e-5,
    "contraction_factor": 0.5,
    "max_iterations": 100,
    "max_function_evaluations": 1000,
    "expand_after_success": 5,
}

_TOKEN: Final = re.compile(
    r"""
      (?P<blank>[\s,=\\]+|\#[^\n]*)
    | (?P<text>'[^'\n]*'|"[^"\n]*"|[‘’][^‘’'\n]*[‘’']|[“”][^“”"\n]*[“”"])
    | (?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w.]))
    | (?P<endless>[+-]?(?:inf|infinity|nan)\b)
    | (?P<word>[A-Za-z_]\w*)
    | (?P<other>.)
    """,
    re.VERBOSE | re.IGNORECASE,
)


class DakotaFile(NamedTuple):
    """Search and parameter space that a Dakota input file defines."""

    optimiser: PatternSearch
    space: ParameterSpace
    notes: tuple[str, ...]  # skipped blocks, and values taken from Dakota's defaults


class _Token(NamedTuple):
    kind: str  # name of a group of _TOKEN; empty at the end of the text
    text: str
    where: str  # its file and line


def load_dakota(path: str | Path) -> DakotaFile:
    """Load a Dakota input file; errors have the line of what fixel's search does not support."""
    data = read_bounded(Path(path), "a Dakota input file", MAX_BYTES)
    with usable(path, "a text file", UnicodeDecodeError):
        return dakota_from_text(data.decode("utf-8-sig"), str(path))


def dakota_from_text(text: str, where: str = "dakota") -> DakotaFile:
    """Parse the text of a Dakota input file; `where` names it in errors."""
    blocks, notes = _blocks(text, where)
    optimiser = _optimiser(_needed(blocks, "method", where), notes)
    space = _space(_needed(blocks, "variables", where))
    return DakotaFile(optimiser, space, tuple(notes))


# --- from text to keywords ------------------------------------------------------------------------


@dataclass
class _Block:
    """Keywords of one block, with their values and places."""

    name: str
    where: str
    values: dict[str, Any] = field(default_factory=dict)
    places: dict[str, str] = field(default_factory=dict)

    def at(self, keyword: str) -> str:
        return self.places.get(keyword, self.where)

    def need(self, keyword: str) -> Any:
        if keyword not in self.values:
            raise InvalidInput(
                self.at(keyword), found=f"{self.name} without {keyword}", expected="both"
            )
        return self.values[keyword]


def _blocks(text: str, where: str) -> tuple[dict[str, _Block], list[str]]:
    tokens = deque(_tokens(text, where))
    blocks: dict[str, _Block] = {}
    notes: list[str] = []
    while (token := tokens.popleft()).kind:
        name = token.text.lower()
        if token.kind != "word" or name not in BLOCKS:
            raise _refused(token, "a block: " + ", ".join(BLOCKS), BLOCKS)
        if name in blocks:
            raise _refused(token, f"one {name} block")
        blocks[name] = _Block(name, token.where)
        if name in _SKIPPED:
            while not _at_block(tokens):
                tokens.popleft()
            notes.append(f"the block {name} was skipped: fixel evaluates the error itself")
        else:
            _read_block(tokens, blocks[name])
    return blocks, notes


def _at_block(tokens: deque[_Token]) -> bool:
    """Whether the next token begins a block, or is the end."""
    token = tokens[0]
    return not token.kind or (token.kind == "word" and token.text.lower() in BLOCKS)


def _read_block(tokens: deque[_Token], block: _Block) -> None:
    known = _KNOWN[block.name]
    while not _at_block(tokens):
        token = tokens.popleft()
        keyword = token.text.lower()
        keyword = _OTHER_NAMES.get(keyword, keyword)
        if token.kind != "word" or keyword not in known:
            names = [*known, *(old for old, new in _OTHER_NAMES.items() if new in known)]
            raise _refused(token, "one of " + ", ".join(names), names)
        if keyword in block.values:
            raise _refused(token, "each keyword once")
        block.places[keyword] = token.where
        block.values[keyword] = _value(tokens, token, known[keyword])


def _value(tokens: deque[_Token], keyword: _Token, kind: object) -> Any:
    if isinstance(kind, tuple):
        token = tokens.popleft()
        if token.text.lower() not in kind:
            raise _refused(token, f"{keyword.text} to be {' or '.join(kind)}", kind)
        return token.text.lower()
    if kind == _FLAG:
        return True
    if kind == _STRINGS:
        texts = []
        while tokens[0].kind == "text":
            texts.append(tokens.popleft().text[1:-1])
        if not texts:
            raise _refused(tokens[0], f"{kind} in quotes after {keyword.text}")
        return texts
    numbers = _numbers(tokens)
    single = kind in (_NUMBER, _COUNT)
    if not numbers or (single and len(numbers) > 1):
        raise _refused(tokens[0], f"{kind} after {keyword.text}")
    if kind == _COUNT and not numbers[0].is_integer():
        raise _refused(keyword, f"{kind} after {keyword.text}")
    return int(numbers[0]) if kind == _COUNT else numbers[0] if single else numbers


def _numbers(tokens: deque[_Token]) -> list[float]:
    """Take the next numbers; `3*0.5` stands for 0.5 three times."""
    found: list[float] = []
    while tokens[0].kind == "number":
        token = tokens.popleft()
        value, count = float(token.text), 1
        if tokens[0].text == "*":
            tokens.popleft()
            if not (value.is_integer() and 0 < value <= 1000 and tokens[0].kind == "number"):
                raise _refused(token, "a count before * and a number after it")
            value, count = float(tokens.popleft().text), int(value)
        found.extend([value] * count)
    if tokens[0].kind == "endless":
        raise _refused(tokens[0], "a finite number, since fixel searches within bounds")
    return found


def _refused(token: _Token, expected: str, names: Sequence[str] = ()) -> InvalidInput:
    found, hint = (
        token.text if token.kind else "the end of the file",
        did_you_mean(token.text, names),
    )
    return InvalidInput(token.where, found=found, expected=expected, hint=hint)


def _tokens(text: str, where: str) -> Iterator[_Token]:
    line = 1
    for match in _TOKEN.finditer(text):
        kind = str(match.lastgroup)
        if kind != "blank":
            yield _Token(kind, match.group(), f"{where}, line {line}")
        line += match.group().count("\n")
    yield _Token("", "", f"{where}, line {line}")


# --- from keywords to objects ---------------------------------------------------------------------


def _needed(blocks: dict[str, _Block], name: str, where: str) -> _Block:
    if name not in blocks:
        raise InvalidInput(where, found=f"no {name} block", expected="a Dakota input file with one")
    return blocks[name]


def _optimiser(block: _Block, notes: list[str]) -> PatternSearch:
    block.need("coliny_pattern_search")
    given = block.values
    if "expansion" in given and "no_expansion" in given:
        raise InvalidInput(
            block.at("no_expansion"), found="expansion and no_expansion", expected="one of them"
        )
    left_out = [f"{k} {v:g}" for k, v in _DEFAULTS.items() if k not in given]
    if left_out:
        notes.append("missing, so defaults of Dakota are used: " + ", ".join(left_out))
    values = {**_DEFAULTS, **given}
    with within(block.at("coliny_pattern_search")):
        return PatternSearch(
            initial_delta=values["initial_delta"],
            threshold_delta=values["variable_tolerance"],
            contraction_factor=values["contraction_factor"],
            expand_after=None if "no_expansion" in given else values["expand_after_success"],
            resolution=0.0,
            solution_accuracy=given.get("solution_target"),
            max_iterations=values["max_iterations"],
            max_function_evaluations=values["max_function_evaluations"],
        )


def _space(block: _Block) -> ParameterSpace:
    count = block.need("continuous_design")
    columns = []
    for keyword in ("initial_point", "lower_bounds", "upper_bounds", "descriptors"):
        column = block.need(keyword)
        if len(column) != count:
            expected = f"{count}, the number given by continuous_design"
            raise InvalidInput(
                block.at(keyword), found=f"{len(column)} after {keyword}", expected=expected
            )
        columns.append(column)
    unknowns = []
    for start, low, high, descriptor in zip(*columns, strict=True):
        name, unit = _name(descriptor, block.at("descriptors"))
        with within(block.at("continuous_design")):
            unknowns.append(
                Unknown(name=name, low=low * unit, high=high * unit, nominal=start * unit)
            )
    return ParameterSpace(unknowns=tuple(unknowns))


def _name(descriptor: str, where: str) -> tuple[str, float]:
    """Fixel's name of a descriptor, and the factor from the file's unit to fixel's."""
    if descriptor in DESCRIPTORS:
        return DESCRIPTORS[descriptor]
    if is_parameter(descriptor):
        return descriptor, 1.0
    raise unknown_name(where, descriptor, [*DESCRIPTORS, *KNOWN_PARAMETERS])


def read_space(path: Path) -> ParameterSpace:
    """Load a space file: YAML or JSON, a mapping from names to low, high and start.

    A name may have a list of these, each for other conditions. Names may end in `_mm`, `_deg` or
    `_mrad`; otherwise values are SI.
    """
    with document(path, "space file") as content:
        entries = content.get("parameters", content) if isinstance(content, Mapping) else None
        if not isinstance(entries, Mapping) or not entries:
            expected = "NAME: {low, high, start}"
            raise InvalidInput("parameters", found="no parameters", expected=expected)
        several = {str(k): own if isinstance(own, list) else [own] for k, own in entries.items()}
        return ParameterSpace(unknowns=tuple(_entry(k, own) for k in several for own in several[k]))


_Entry: Final = record_of(
    Unknown,
    "parameter",
    names={"nominal": "start"},
    leave_out=("name",),
    where=dict[str, str | float],
)


def _entry(written: str, entry: Any) -> Unknown:
    name, factor = in_si(written)
    with within(written, name, "parameters"):
        own = arguments(validated(_Entry, entry, ""))
        own = {k: factor * value if isinstance(value, float) else value for k, value in own.items()}
        return Unknown(name=name, **own)
