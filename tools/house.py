"""Measure the structure and the language of the source: ``python -m tools.house``.

``limits.toml`` next to this file holds the largest value that each figure may have.
``--tighten`` lowers the limits to what is measured; ``--list FIGURE`` names the places that count.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tools.doors import CAPABILITIES, n_lines, statements
from tools.source import Module, circles, imports, reached, read_modules, references, upward
from tools.texts import read_texts

PACKAGE = Path(__file__).parents[1] / "src" / "fixel"
LIMITS = Path(__file__).with_name("limits.toml")
PROJECT = Path(__file__).parents[1] / "pyproject.toml"

# Module of the function that the command `fixel calibrate` is made of.
CALIBRATE = CAPABILITIES["calibration"].function.rpartition(".")[0]

Modules = Mapping[str, Module]

# First words of a docstring that needs the name above it to be understood.
FRAGMENT = re.compile(r"(of|from|as|with|between|what|whether|where|how|those)\b", re.IGNORECASE)
# Words of rules 3 to 5 of the language rule (CONTRIBUTING.md) that have no technical sense.
BANNED = re.compile(
    r"\b(tells?|told|says?|said|nobody|somebody|whoever|who asks|so many|anew|beside|for ever"
    r"|spoil(?:t|ed)|of use|in place of|what it is|bit by bit|the other way round)\b",
    re.IGNORECASE,
)
IRREGULAR_PARTICIPLES = re.compile(
    "Built|Chosen|Cut|Drawn|Fed|Felt|Found|Given|Gone|Grown|Held|Kept|Known|Laid|Left|Lost|Made|Met"
    "|Put|Read|Said|Seen|Sent|Set|Shown|Spent|Spread|Taken|Thrown|Told|Torn|Unseen|Wound|Written"
)
NOUNS_IN_ED = frozenset({"Bed", "Feed", "Need", "Seed", "Shed", "Speed"})


@dataclass(frozen=True)
class Figure:
    """One measured property of the source, smaller is better.

    Attributes
    ----------
    meaning : str
        What is counted, with its unit.
    value : int or float
        Measured value.
    places : tuple of str
        Places that were counted, ready to print; empty where there is nothing to name.
    """

    meaning: str
    value: float
    places: tuple[str, ...] = ()


def measure(modules: Modules) -> dict[str, Figure]:
    """Measure all figures.

    Parameters
    ----------
    modules : mapping
        Dotted name -> `Module`, from `read_modules`.

    Returns
    -------
    dict
        Name of the figure -> `Figure`, in the order in which they are printed.
    """
    edges = imports(modules)
    rooms: Counter[str] = Counter()
    for module in modules.values():
        rooms[module.room] += module.n_lines
    n_lines = rooms.total()
    room, n_largest = rooms.most_common(1)[0]
    workflows = [module for module in modules.values() if module.room == "workflows"]
    campaign = [modules[name] for name in sorted(reached(edges, CALIBRATE))]
    docstrings = [
        (f"{module.path}:{line}", node, text)
        for module in modules.values()
        for line, node, text in module.docstrings
    ]
    fragments = [f"{at} {_first(text)}" for at, node, text in docstrings if _leans(node, text)]
    return {
        "lines": Figure("lines of Python in src/", n_lines),
        "files": Figure("Python files in src/", len(modules)),
        "classes": _listed("classes", _classes(modules)),
        "workflows_lines": Figure("lines of workflows/", sum(m.n_lines for m in workflows)),
        "workflows_files": Figure("files of workflows/", len(workflows)),
        "largest_room": Figure(
            f"largest room ({room}), % of the lines", _share(n_largest, n_lines)
        ),
        "repeated_class_names": _listed("class names defined twice or more", _repeated(modules)),
        "participle_classes": _listed("classes named by a bare participle", _participles(modules)),
        "pages_lines": Figure("lines of scripts, styles and templates of pages", _page_lines()),
        "web_mirrors": _listed("web classes named ...In or ...Out", _mirrors(modules)),
        "progress_aliases": _listed("aliases of a progress callback", _progress_aliases(modules)),
        "circles": _listed("circles of imports", map(" <-> ".join, circles(edges))),
        "upward_references": _listed(
            "references to a higher floor, by imports or strings",
            upward(references(modules), read_floors()),
        ),
        **dict(_doors(modules)),
        "rollout_loop": _longest("lines of the loop of a rollout", _rollout_loop(modules)),
        "longest_function": _longest(
            "lines of the longest function, kernels and migrations left out", _functions(modules)
        ),
        "fragments": Figure(
            "docstrings that open as a fragment, %",
            _share(len(fragments), len(docstrings)),
            tuple(fragments),
        ),
        "banned_words": _listed(
            "banned words in docstrings",
            (f"{at} {word}" for at, _, text in docstrings for word in BANNED.findall(text)),
        ),
        "user_texts": _listed(
            "faults of messages, help and pages (tools/texts.py)",
            (f"{t.place} {fault}: {t.text}" for t in read_texts(modules) for fault in t.faults),
        ),
        "calibrate_modules": _listed("modules reached by `fixel calibrate`", _names(campaign)),
        "calibrate_lines": Figure("lines of these modules", sum(m.n_lines for m in campaign)),
    }


def _page_lines() -> int:
    kinds = {".js", ".css", ".html"}
    files = (file for file in (PACKAGE / "web").rglob("*") if file.suffix in kinds)
    return sum(len(file.read_text().splitlines()) for file in files)


def _doors(modules: Modules) -> Iterator[tuple[str, Figure]]:
    """Two figures of each capability, of which the package under test may have none."""
    for name, capability in CAPABILITIES.items():
        if capability.function.rpartition(".")[0] in modules:
            places = tuple(statements(capability, modules))
            n_options = len(capability.options(modules))
            around, numerics = n_lines(capability, modules)
            yield (
                f"{name}_statements",
                Figure("statements of an option", round(len(places) / n_options, 1), places),
            )
            yield (
                f"{name}_around",
                Figure("lines around a line of numerics", round(around / numerics, 2)),
            )


def read_floors() -> list[str]:
    """Load the floors that the import contract names, the highest first."""
    settings = tomllib.loads(PROJECT.read_text(encoding="utf-8"))
    floors: list[str] = settings["tool"]["importlinter"]["contracts"][0]["layers"]
    return floors


def _listed(meaning: str, places: Iterator[str] | list[str]) -> Figure:
    """Figure that is the number of places."""
    found = tuple(places)
    return Figure(meaning, len(found), found)


def _longest(meaning: str, functions: list[tuple[int, str]]) -> Figure:
    """Figure that is the length of the longest function."""
    ordered = sorted(functions, reverse=True)[:40]
    return Figure(meaning, ordered[0][0], tuple(f"{n:4d} {place}" for n, place in ordered))


def _share(part: int, whole: int) -> float:
    """Percentage, to one decimal."""
    return round(100 * part / whole, 1)


def _names(modules: list[Module]) -> Iterator[str]:
    return (module.name for module in modules)


def _classes(modules: Modules) -> Iterator[str]:
    return (f"{m.path}:{node.lineno} {node.name}" for m in modules.values() for node in m.classes)


def _repeated(modules: Modules) -> Iterator[str]:
    """Class names with more than one definition; a leading underscore makes no difference."""
    places = defaultdict(list)
    for module in modules.values():
        for node in module.classes:
            places[node.name.lstrip("_")].append(str(module.path))
    return (f"{name}: {', '.join(at)}" for name, at in sorted(places.items()) if len(at) > 1)


def _participles(modules: Modules) -> Iterator[str]:
    for module in modules.values():
        for node in module.classes:
            name = node.name.lstrip("_")
            regular = re.fullmatch(r"[A-Z][a-z]+ed", name) and name not in NOUNS_IN_ED
            if regular or IRREGULAR_PARTICIPLES.fullmatch(name):
                yield f"{module.path}:{node.lineno} {node.name}"


def _mirrors(modules: Modules) -> Iterator[str]:
    for module in modules.values():
        for node in module.classes:
            if module.room == "web" and re.fullmatch(r"\w+(In|Out)", node.name):
                yield f"{module.path}:{node.lineno} {node.name}"


def _progress_aliases(modules: Modules) -> Iterator[str]:
    """Names for ``Callable[[int, int, ...], None]`` and ``Callable[[str], None]``."""
    shape = re.compile(r"Callable\[\[(int, int|str)\b.*\], None\]( \| None)?")
    for module in modules.values():
        for node in module.tree.body:
            if isinstance(node, ast.Assign) and shape.fullmatch(ast.unparse(node.value)):
                yield f"{module.path}:{node.lineno} {ast.unparse(node)}"


def _rollout_loop(modules: Modules) -> list[tuple[int, str]]:
    """Functions of the compiled rollout that hold its loop over time."""
    module = modules["fixel.kernels.rollout"]
    return [
        (_length(node), f"{module.path}:{node.lineno} {node.name}")
        for node in module.functions
        if any(isinstance(inner, ast.While) for inner in ast.walk(node))
    ]


def _functions(modules: Modules) -> list[tuple[int, str]]:
    return [
        (_length(node), f"{module.path}:{node.lineno} {node.name}")
        for module in modules.values()
        if module.room != "kernels" and "migrations" not in module.path.parts
        for node in module.functions
    ]


def _length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function from its ``def``, without its docstring."""
    body = function.body
    n_docstring = 0
    if ast.get_docstring(function, clean=False) is not None:
        n_docstring = (body[0].end_lineno or 0) - body[0].lineno + 1
    return (function.end_lineno or 0) - function.lineno + 1 - n_docstring


def _first(text: str) -> str:
    """First line of a docstring."""
    return text.partition("\n")[0]


def _leans(node: ast.AST, text: str) -> bool:
    """Whether a docstring opens as a fragment; "Whether" is right for what returns a boolean."""
    if not (found := FRAGMENT.match(text)):
        return False
    returns = getattr(node, "returns", None)
    is_boolean = returns is not None and ast.unparse(returns) in ("bool", "BoolArray")
    return not (is_boolean and found.group().lower() == "whether")


def read_limits() -> dict[str, float]:
    """Load the largest value that each figure may have."""
    return tomllib.loads(LIMITS.read_text(encoding="utf-8"))


def tighten(limits: Mapping[str, float], figures: Mapping[str, Figure]) -> None:
    """Lower each limit in the file to the measured value, if that is smaller."""
    text = LIMITS.read_text(encoding="utf-8")
    for name, figure in figures.items():
        if figure.value < limits[name]:
            text = re.sub(rf"(?m)^{name} = [\d.]+", f"{name} = {figure.value}", text)
    LIMITS.write_text(text, encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Print the figures; return 1 if one exceeds its limit."""
    parser = argparse.ArgumentParser(prog="make house", description=(__doc__ or "").split(":")[0])
    parser.add_argument("--list", metavar="FIGURE", help="print the places that a figure counts")
    parser.add_argument("--tighten", action="store_true", help="lower limits to measured values")
    options = parser.parse_args(arguments)
    figures = measure(read_modules(PACKAGE))
    if options.list:
        if options.list not in figures:
            parser.error(f"no figure {options.list!r}; figures: {', '.join(figures)}")
        print("\n".join(figures[options.list].places))
        return 0
    limits = read_limits()
    print(f"{'figure':22} {'value':>9} {'limit':>9}  meaning")
    for name, figure in figures.items():
        mark = "  EXCEEDED" if figure.value > limits[name] else ""
        print(f"{name:22} {figure.value:>9,} {limits[name]:>9,}  {figure.meaning}{mark}")
    if options.tighten:
        tighten(limits, figures)
    return int(any(figure.value > limits[name] for name, figure in figures.items()))


if __name__ == "__main__":
    sys.exit(main())
