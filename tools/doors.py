"""Count how often the options of a capability are stated at its doors, and how long the doors are.

A door is what leads to the numerics of a capability: workflows, commands, pages and figures.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tools.source import Module

ROOMS: Final = ("workflows", "cli", "web", "drawing", "database", "formats")
SCRIPTS: Final = (".js", ".html")
# Options whose names have other meanings in these files, so that a count says nothing.
AMBIGUOUS: Final = frozenset({"error", "first", "name", "start"})
# An argument of this type has the records of a project, whatever an option of its name means.
RECORDS: Final = "Store"
# An option bears its unit at a border: `threshold` is `threshold_mm` in a file.
UNITS: Final = ("", "_m", "_mm", "_um", "_rad", "_deg", "_s", "_kg", "_n")


@dataclass(frozen=True)
class Capability:
    """Public function with options, and the files that lead to it.

    Attributes
    ----------
    function : str
        Dotted name of the public function; its keyword-only arguments are the options.
    words : str
        Regular expression that the path of each of its doors contains.
    numerics : str
        Name of the folder that computes.
    """

    function: str
    words: str
    numerics: str

    def options(self, modules: Mapping[str, Module]) -> tuple[str, ...]:
        """Return the keyword-only arguments of the function, without ambiguous names."""
        home, _, name = self.function.rpartition(".")
        (function,) = (node for node in modules[home].functions if node.name == name)
        names = (argument.arg for argument in function.args.kwonlyargs)
        return tuple(name for name in names if name not in AMBIGUOUS)

    def is_door(self, path: Path) -> bool:
        """Whether a file leads to the capability: by its room and by a word of its path."""
        return path.parts[1] in ROOMS and re.search(self.words, str(path)) is not None


CAPABILITIES: Final[Mapping[str, Capability]] = {
    "calibration": Capability(
        "fixel.workflows.calibration.run.calibrate", r"(?<!camera/)calibrat", "calibration"
    ),
    "domain": Capability("fixel.workflows.domain.run.map_domain", "domain", "domain"),
    "uncertainty": Capability(
        "fixel.workflows.uncertainty.run.posterior", "uncertainty", "uncertainty"
    ),
    "planning": Capability(
        "fixel.workflows.planning.run.plan",
        r"planning|/plan(_view|\.js|\.html)|cli/plan|goal_file",
        "planning",
    ),
    "filtering": Capability("fixel.workflows.filtering.run.filter", "filtering", "filtering"),
}


def statements(capability: Capability, modules: Mapping[str, Module]) -> list[str]:
    """Find the statements of a capability's options at its doors.

    A statement is a field or an argument of that name, a keyword that passes it on, a string that
    is its key, its entry in a docstring, or its name in a script or template.

    Returns
    -------
    list of str
        File, line and kind of each.
    """
    names = {option + unit for option in capability.options(modules) for unit in UNITS}
    doors = [module for module in modules.values() if capability.is_door(module.path)]
    found = [
        f"{door.path}:{line} {name} ({kind})"
        for door in doors
        for line, name, kind in (*_in_code(door), *_in_docstrings(door))
        if name in names
    ]
    return found + list(_in_scripts(capability, modules, names))


def _in_code(module: Module) -> Iterator[tuple[int, str, str]]:
    for node in module.nodes:
        match node:
            case ast.arg(annotation=ast.Name(id=kind)) if kind == RECORDS:
                continue
            case ast.arg(arg=name) | ast.AnnAssign(target=ast.Name(id=name)):
                yield node.lineno, name, "declared"
            case ast.keyword(arg=str(name)):
                yield node.lineno, name, "passed on"
            case ast.Constant(value=str(name)):
                yield node.lineno, name.removeprefix("--").replace("-", "_"), "key"


def _in_docstrings(module: Module) -> Iterator[tuple[int, str, str]]:
    """Entries in NumPy layout: ``level : float``."""
    for line, _, text in module.docstrings:
        for name in re.findall(rf"(?m)^(\w+) : (?!{RECORDS}$)", text):
            yield line, name, "docstring"


def _in_scripts(
    capability: Capability, modules: Mapping[str, Module], names: set[str]
) -> Iterator[str]:
    package = modules["fixel"].file.parent
    for file in sorted(package.rglob("*")):
        path = file.relative_to(package.parent)
        if file.suffix in SCRIPTS and capability.is_door(path):
            lines = file.read_text(encoding="utf-8").splitlines()
            for number, line in enumerate(lines, start=1):
                for name in re.findall(r"(?<!<)(?<!</)\b\w+", line):  # no elements of HTML
                    if name in names:
                        yield f"{path}:{number} {name} ({file.suffix[1:]})"


def n_lines(capability: Capability, modules: Mapping[str, Module]) -> tuple[int, int]:
    """Return the lines of Python of a capability's doors, and those of its numerics."""
    doors = sum(module.n_lines for module in modules.values() if capability.is_door(module.path))
    rooms = (module.n_lines for module in modules.values() if module.room == capability.numerics)
    return doors, sum(rooms)
