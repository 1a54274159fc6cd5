"""The modules of the package as syntax trees, and the imports between them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


@dataclass(frozen=True)
class Module:
    """One source file of the package.

    Attributes
    ----------
    name : str
        Dotted name, such as ``"fixel.model.scene"``.
    path : Path
        Path of the file, relative to the folder that holds the package.
    file : Path
        Path of the file.
    n_lines : int
        Number of lines, blank lines and docstrings included.
    tree : ast.Module
        Syntax tree of the file.
    """

    name: str
    path: Path
    file: Path
    n_lines: int
    tree: ast.Module

    @property
    def is_package(self) -> bool:
        """Whether the file is the ``__init__.py`` of a folder."""
        return self.path.name == "__init__.py"

    @property
    def room(self) -> str:
        """Name of the entry at the top of the package that holds the file."""
        return self.path.parts[1]

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of the tree, which every figure reads."""
        return list(ast.walk(self.tree))

    @property
    def classes(self) -> Iterator[ast.ClassDef]:
        """Class definitions of the file, nested ones included."""
        return (node for node in self.nodes if isinstance(node, ast.ClassDef))

    @property
    def functions(self) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
        """Function definitions of the file, methods and nested ones included."""
        for node in self.nodes:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield node

    @property
    def docstrings(self) -> Iterator[tuple[int, Definition | ast.Module, str]]:
        """Line, documented node and text of each docstring of the file."""
        for node in self.nodes:
            if isinstance(node, ast.Module | Definition) and (text := ast.get_docstring(node)):
                yield (1 if isinstance(node, ast.Module) else node.lineno, node, text)


def read_modules(package: Path) -> dict[str, Module]:
    """Parse all modules of a package.

    Parameters
    ----------
    package : Path
        Folder of the package, such as ``src/fixel``.

    Returns
    -------
    dict
        Dotted name -> `Module`.
    """
    modules = {}
    for file in sorted(package.rglob("*.py")):
        path = file.relative_to(package.parent)
        parts = path.with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        text = file.read_text(encoding="utf-8")
        modules[name] = Module(name, path, file, text.count("\n"), ast.parse(text))
    return modules


def imports(modules: Mapping[str, Module]) -> dict[str, set[str]]:
    """Find which modules of the package each module imports.

    Imports inside functions and under ``TYPE_CHECKING`` count. ``from fixel.a import b`` is an
    import of ``fixel.a.b`` where that is a module, otherwise of ``fixel.a``.

    Returns
    -------
    dict
        Dotted name -> dotted names of the modules it imports.
    """
    found: dict[str, set[str]] = {}
    for name, module in modules.items():
        targets: set[str] = set()
        for node in module.nodes:
            if isinstance(node, ast.Import):
                targets.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = _absolute(module, node)
                for alias in node.names:
                    whole = f"{base}.{alias.name}"
                    targets.add(whole if whole in modules else base)
        found[name] = {target for target in targets if target in modules} - {name}
    return found


def references(modules: Mapping[str, Module]) -> dict[str, set[str]]:
    """Find which modules each module imports or names in a string, such as ``"fixel.a:b"``.

    Docstrings do not count.

    Returns
    -------
    dict
        Dotted name -> dotted names of the modules it imports or names.
    """
    found = imports(modules)
    for name, module in modules.items():
        docstrings = {id(_docstring_node(node)) for _, node, _ in module.docstrings}
        for node in module.nodes:
            if not isinstance(node, ast.Constant) or id(node) in docstrings:
                continue
            if isinstance(node.value, str):
                found[name] |= _named(node.value, modules) - {name}
    return found


def _docstring_node(node: Definition | ast.Module) -> ast.expr | None:
    """Node of the docstring of a documented node."""
    first = node.body[0]
    return first.value if isinstance(first, ast.Expr) else None


def _named(text: str, modules: Mapping[str, Module]) -> set[str]:
    """Longest dotted names of modules in a text, those of the whole package left out."""
    found = set()
    for name in re.findall(r"\bfixel(?:\.\w+)+", text):
        while name not in modules:
            name = name.rpartition(".")[0]
        found.add(name)
    return found - {"fixel"}


def upward(
    edges: Mapping[str, set[str]], layers: Sequence[str], package: str = "fixel"
) -> list[str]:
    """Find references from a floor to a higher one.

    Parameters
    ----------
    edges : mapping
        Dotted name -> dotted names of the modules it refers to.
    layers : sequence of str
        Floors, the highest first; rooms of one floor are separated by ``|``.

    Returns
    -------
    list of str
        ``module -> module`` of each.
    """
    floors = {
        f"{package}.{room.strip()}": -height
        for height, layer in enumerate(layers)
        for room in layer.split("|")
    }
    room_of = {name: ".".join(name.split(".")[:2]) for name in edges}
    return [
        f"{name} -> {target}"
        for name in sorted(edges)
        for target in sorted(edges[name])
        if room_of[name] in floors and floors[room_of[name]] < floors.get(room_of[target], -99)
    ]


def _absolute(module: Module, node: ast.ImportFrom) -> str:
    """Dotted name of the module that a ``from`` import names."""
    if not node.level:
        return node.module or ""
    parts = module.name.split(".")
    package = parts if module.is_package else parts[:-1]
    package = package[: len(package) - node.level + 1]
    return ".".join([*package, node.module] if node.module else package)


def circles(edges: Mapping[str, set[str]]) -> list[list[str]]:
    """Find groups of modules that import each other, directly or through others.

    Strongly connected components of more than one module (Tarjan, SIAM J. Comput. 1 (1972) 146).
    """
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    groups: list[list[str]] = []

    def visit(name: str) -> None:
        order[name] = lowest[name] = len(order)
        stack.append(name)
        for target in sorted(edges[name]):
            if target not in order:
                visit(target)
                lowest[name] = min(lowest[name], lowest[target])
            elif target in stack:
                lowest[name] = min(lowest[name], order[target])
        if lowest[name] == order[name]:
            start = stack.index(name)
            group = stack[start:]
            del stack[start:]
            if len(group) > 1:
                groups.append(sorted(group))

    for name in sorted(edges):
        if name not in order:
            visit(name)
    return groups


def reached(edges: Mapping[str, set[str]], start: str) -> set[str]:
    """Find all modules that a module imports, directly or through others, itself included."""
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting.extend(edges[name])
    return seen
