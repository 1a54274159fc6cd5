"""Works that a report may cite, from `references.bib`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from typing import Final

_ENTRY: Final = re.compile(r"^@\w+\{(\w+),\n.*?^\}\n", re.MULTILINE | re.DOTALL)
_FIELD: Final = re.compile(r"^  (\w+) = \{(.*)\},$", re.MULTILINE)
OWN: Final = "fixel"  # key of the program itself

# BibTeX notation, and how people read it.
READ: Final = {'{\\"u}': "ü", "{\\`e}": "è", "{": "", "}": ""}


@cache
def known_works() -> dict[str, str]:
    """Load the BibTeX entry of every known work, by key; the program has its version."""
    text = (files("fixel.workflows.report") / "references.bib").read_text(encoding="utf-8")
    text = text.replace("Version VERSION", f"Version {version('fixel')}")
    return {found[1]: found[0] for found in _ENTRY.finditer(text)}


def works(keys: Sequence[str]) -> dict[str, str]:
    """Select the entries of the program and of what is cited, each once; skip unknown keys."""
    known = known_works()
    return {key: known[key] for key in dict.fromkeys((OWN, *keys)) if key in known}


def bibtex(cited: dict[str, str]) -> str:
    """Return the content of a `.bib` file."""
    return "\n".join(cited.values())


def line(entry: str) -> str:
    """Format an entry as a line of a list of references."""
    fields = dict(_FIELD.findall(entry))
    authors = fields.pop("author").replace(" and others", " et al.").replace(" and ", ", ")
    title, year = fields.pop("title")[1:-1], fields.pop("year")
    for written, read in READ.items():
        authors = authors.replace(written, read)
    rest = [value.replace("--", "-") for name, value in fields.items() if name != "number"]
    parts = [f"{authors} ({year})", title, ", ".join(rest)]
    return ". ".join(part for part in parts if part) + "."
