"""Texts that users read: messages, help, pages, scripts and report templates, and their faults.

Docstrings are not among them, except those of commands; `tools.house` reads the others itself.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

from tools.source import Module

# Placeholder for a value that is put into a text when it is shown.
VALUE = "X"
# A literal is read by people if it has a word next to another one, or to a value.
WORDS = re.compile(r"[A-Za-z][a-z']+[,;:.!?)]* +\S|\bX [a-z]{2,}")
# SQL, styles, types, headers, Python and YAML that literals hold too.
CODE = re.compile(
    r"SELECT |INSERT |CREATE |UPDATE |DELETE |PRAGMA |ALTER |TRIGGER |RAISE|var\(--|^from fixel"
    r"|^fixel: 1|\w+ \| None|^\w+\[|default-src|Content-Type|<!doctype|^\(prefers|data_files"
)
# Texts that are shown without their context: help of options, descriptions of fields and routes.
ALONE = frozenset({"help", "description", "summary"})
DECLARATIONS = frozenset(
    {"option", "argument", "required"}
)  # of options, with help in second place

# Words without a technical sense in a text that users read, each with its reason.
# "X" is the value that stands in the text. Rules and sections are those of CONTRIBUTING.md.
REJECTED = {
    r"tells?|told|says?|said|asks?|asked|asking": "rule 3: report, state, request",
    r"kept|keeps": "rule 3: stored, saved",
    r"gives? up|feels?|felt|hears?": "rule 3: a program stops, a sensor measures",
    r"nobody|somebody|whoever|anybody|who asks": "rule 4: name the user or use the passive",
    r"so many|as many|so much": "rule 4: the number",
    r"anew|for ever|of use|to be had|can be had|spoil(?:t|ed)": "rule 4: archaic",
    r"beside|in place of|besides": "rule 4: next to, in addition to, instead of",
    r"what it is|what there is|what came of|what came out|what is finished": "rule 4: a noun",
    r"bit by bit|the other way round": "rule 5: bit for bit, inverse",
    r"promis(?:e|es|ed)|calm|unknowns|dice": "rule 8: error bound, insensitive, parameter, rng",
    r"things?": "rule 8: the glossary has a word for each",
    r"judged?|judges|clerk|desk|fan": "rule 6: metaphor",
    r"believe[ds]?": "rule 8: trust",  # `Belief` is the term of planning for what is unknown
    r"goes on|go on|going on|went on|on and on": "rule 4: continue, resume",
    r"went away|part ways|set apart|taken? back": "rule 6: metaphor",
    r"(?<!there )(?<!which )is no (?!longer|more)|that are no|that is no": "archaic: is not a",
    r"heed(?:ed)?|surer|likeliest|lest|whence|thereof|upon|leave (?:them|it) be": "archaic",
}
PATTERN = re.compile(r"\b(?:" + "|".join(REJECTED) + r")\b", re.IGNORECASE)
# A text that opens so needs the text or name above it to be understood; "whether" is for booleans.
FRAGMENT = re.compile(
    r"(of|from|as|with|between|what|where|how|those|none|at|in|on|by|for|to|that|which)\b|\[",
    re.IGNORECASE,
)
MAX_WORDS = 32  # words of a sentence; about 20 are good, and a value counts as one


@dataclass(frozen=True)
class Text:
    """One text that a user can read.

    Attributes
    ----------
    place : str
        File and line.
    text : str
        Text on one line; a value that is put in later is `X`.
    is_alone : bool
        Whether it is shown without context: the help of an option, the description of a field.
    """

    place: str
    text: str
    is_alone: bool = False

    @property
    def faults(self) -> Iterator[str]:
        """Rejected words, a fragment at the beginning, and sentences that are too long."""
        yield from PATTERN.findall(self.text)
        if self.is_alone and (found := FRAGMENT.match(self.text)):
            yield f"{found.group()}..."
        for sentence in re.split(r"[.!?](?:\s|$)|; | # ", self.text):
            if (n_words := len(sentence.split())) > MAX_WORDS:
                yield f"{n_words} words"


def read_texts(modules: Mapping[str, Module]) -> Iterator[Text]:
    """Find the texts that users read, in the order of the files.

    Parameters
    ----------
    modules : mapping
        Dotted name -> `Module`, from `read_modules`. Pages, scripts and templates are searched in
        the folder of the package.
    """
    for module in modules.values():
        yield from _literals(module)
    package = modules["fixel"].file.parent
    for file in sorted(package.rglob("*")):
        read = {".html": _page, ".js": _script, ".txt": _template}.get(file.suffix)
        if read is not None and "vendor" not in file.parts:
            path = file.relative_to(package.parent)
            for line, text, is_alone in read(file.read_text(encoding="utf-8")):
                if found := " ".join(text.split()):
                    yield Text(f"{path}:{line}", found, is_alone)


def read_documents(root: Path) -> Iterator[Text]:
    """Find the paragraphs, list items and table cells of the documentation, without its code.

    Parameters
    ----------
    root : Path
        Folder of the repository: its Markdown files and those under `docs`.
    """
    for file in [*sorted(root.glob("*.md")), *sorted((root / "docs").rglob("*.md"))]:
        if "_build" not in file.parts:
            for line, text in _markdown(file.read_text(encoding="utf-8")):
                yield Text(f"{file.relative_to(root)}:{line}", text)


# Not prose in Markdown: fenced and indented code, marks of containers, comments, formulas.
NOT_PROSE = re.compile(
    r"^(```+|~~~+).*?^\1|^:{3,}[^\n]*|(?<=\n\n)(?:(?: {4,}|\t)[^\n]*\n|\n)+|<!--.*?-->|\$\$.*?\$\$",
    re.DOTALL | re.MULTILINE,
)
INLINE = re.compile(r"`[^`]*`|\$[^$\n]+\$|\]\([^)]*\)|(?<!\*)\*[^*\n]+\*(?!\*)")
BLOCK = re.compile(r"\n\s*(?:\n|(?=[-*|#>:]|\d+\.))|(?<=[^\n]) \|")


def _markdown(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of each paragraph, list item and cell; code, formulas and titles are `X`."""
    source, _, _ = source.partition("\n## Sources\n")
    plain = INLINE.sub(lambda m: VALUE + _blank(m), NOT_PROSE.sub(_blank, source).replace("**", ""))
    at = 0
    for found in [*BLOCK.finditer(plain), None]:
        end = found.start() if found else len(plain)
        if text := plain[at:end].strip(" \n|#>*-:"):
            lead = len(plain[at:end]) - len(plain[at:end].lstrip())
            yield plain.count("\n", 0, at + lead) + 1, " ".join(text.split())
        at = found.end() if found else end


def _literals(module: Module) -> Iterator[Text]:
    """Literals of a source file that are sentences or phrases."""
    nodes = module.nodes
    skipped: set[int] = set()
    alone: set[int] = set()
    for node in nodes:
        if isinstance(node, ast.Expr):
            skipped.add(id(node.value))  # a docstring
        elif isinstance(node, ast.JoinedStr):
            skipped.update(map(id, node.values))
        elif isinstance(node, ast.FormattedValue) and node.format_spec is not None:
            skipped.add(id(node.format_spec))
        elif isinstance(node, ast.keyword) and node.arg in ALONE:
            alone.add(id(node.value))
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in DECLARATIONS:
            alone.update(map(id, node.args[:2]))
    for node in nodes:
        if not isinstance(node, ast.Constant | ast.JoinedStr) or id(node) in skipped:
            continue
        text = _text(node)
        if text is not None and (id(node) in alone or _is_read(text)):
            yield Text(f"{module.path}:{node.lineno}", " ".join(text.split()), id(node) in alone)
    if module.room == "cli":  # the docstring of a command is its help
        for line, node, text in module.docstrings:
            if isinstance(node, ast.FunctionDef) and "as_json" in ast.unparse(node.args):
                yield Text(f"{module.path}:{line}", " ".join(text.split()), is_alone=True)


def _text(node: ast.AST) -> str | None:
    """Text of a literal, with `X` for its values; None for other nodes."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part) or VALUE for part in node.values)
    return None


def _is_read(text: str) -> bool:
    """Whether a literal consists of words; names, keys, patterns and SQL do not."""
    return bool(WORDS.search(text)) and not CODE.search(text) and "\\" not in text


class _Reader(HTMLParser):
    """Collector of the texts and the speaking attributes of a page."""

    SPEAKING = ("title", "placeholder", "aria-label", "alt")
    INLINE = frozenset(
        {"a", "abbr", "b", "br", "code", "em", "i", "kbd", "small", "span", "strong"}
    )

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[int, str, bool]] = []
        self.text = ""
        self.line = 1
        self.closed = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in self.SPEAKING and value:
                self.found.append((self.getpos()[0], value, False))
        if tag not in self.INLINE:
            self.end()
        if tag in ("pre", "script", "style"):
            self.closed = tag

    def handle_endtag(self, tag: str) -> None:
        if tag == self.closed:
            self.closed = ""
        if tag not in self.INLINE:
            self.end()

    def handle_data(self, data: str) -> None:
        if not self.closed:
            if not self.text.strip():
                self.line = self.getpos()[0]
            self.text += data

    def end(self) -> None:
        self.found.append((self.line, self.text, False))
        self.text = ""


def _page(source: str) -> Iterator[tuple[int, str, bool]]:
    """Texts of a page and of its attributes."""
    lines = re.sub(r"\{#.*?#\}", _blank, source, flags=re.DOTALL)
    lines = re.sub(r"\{\{.*?\}\}", lambda m: VALUE + _blank(m), lines, flags=re.DOTALL)
    reader = _Reader()
    reader.feed(re.sub(r"\{%.*?%\}", _blank, lines, flags=re.DOTALL))
    reader.end()
    yield from reader.found


def _template(source: str) -> Iterator[tuple[int, str, bool]]:
    """Sentences of a report template, which begin with a dash, and texts within its blocks."""
    plain = re.sub(r"\{#.*?#\}", _blank, source, flags=re.DOTALL)
    plain = re.sub(r"\{\{.*?\}\}", lambda m: VALUE + _blank(m), plain, flags=re.DOTALL)
    plain = re.sub(r"\{%.*?%\}", _blank, plain, flags=re.DOTALL)
    line = 1
    for part in re.split(r"(?m)^(?=- )", plain):
        yield line, part.removeprefix("- "), False
        line += part.count("\n")
    for found in re.finditer(r"\{[{%].*?[%}]\}", source, flags=re.DOTALL):
        for literal in re.finditer(r'"([^"]+)"', found.group()):
            yield source.count("\n", 0, found.start() + literal.start()) + 1, literal[1], False


def _blank(found: re.Match[str]) -> str:
    return "\n" * found.group().count("\n")


# Comments, literals and brackets of a script; a template literal goes on after each value.
TOKEN = re.compile(
    r"//[^\n]*|/\*.*?\*/|\"(?:[^\"\\\n]|\\.)*\"|'(?:[^'\\\n]|\\.)*'|[`{}]", re.DOTALL
)
PIECE = re.compile(r"((?:[^`\\$]|\\.|\$(?!\{))*)(`|\$\{)", re.DOTALL)


def _script(source: str) -> Iterator[tuple[int, str, bool]]:
    """Literals of a script that consist of words."""
    for start, text in _script_literals(source):
        if _is_read(text):
            yield source.count("\n", 0, start) + 1, text, False


def _script_literals(source: str) -> Iterator[tuple[int, str]]:
    """Offset and text of each literal of a script; those inside values come first."""
    stack: list[tuple[int, list[str]]] = []  # template literals whose value is being read
    braces: list[int] = []  # open brackets inside each of these values
    at = 0
    while found := TOKEN.search(source, at):
        token, at = found.group(), found.end()
        if token[0] in "\"'":
            yield found.start(), token[1:-1]
        elif token == "{" and braces:
            braces[-1] += 1
        elif token == "}" and braces and braces[-1]:
            braces[-1] -= 1
        elif token == "`" or (token == "}" and braces):
            if token == "`":
                start, parts = found.start(), list[str]()
            else:
                braces.pop()
                start, parts = stack.pop()
            piece = PIECE.match(source, at)
            if piece is None:
                return
            parts.append(piece[1])
            at = piece.end()
            if piece[2] == "`":
                yield start, VALUE.join(parts)
            else:
                stack.append((start, parts))
                braces.append(0)
