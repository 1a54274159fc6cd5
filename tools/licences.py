"""Licences of the packages that fixel needs, from their metadata."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from importlib.metadata import Distribution, distributions
from typing import Any, Final

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

FREE: Final = frozenset((
    "MIT", "MIT-0", "MIT-CMU", "ISC", "0BSD", "BSD-2-Clause", "BSD-3-Clause", "Apache-2.0", "HPND",
    "LLVM-exception", "PSF-2.0", "Zlib", "CC0-1.0", "MPL-2.0", "Unlicense",
))  # fmt: skip
# Words of older metadata, and the licence that they mean; the first that is found counts.
WORDS: Final = {
    "LGPL|Lesser General Public": "LGPL-3.0-or-later",
    "GPL|General Public": "GPL-3.0-or-later",
    "MIT": "MIT",
    "ISC": "ISC",
    "Apache": "Apache-2.0",
    "Mozilla|MPL": "MPL-2.0",
    "Python Software Foundation|PSF": "PSF-2.0",
    "BSD": "BSD-3-Clause",
    "zlib": "Zlib",
}
# Licences in the repositories of packages whose metadata name none. That of apsw may be chosen.
STATED: Final = {"pynomadbbo": "LGPL-3.0-or-later", "dynesty": "MIT", "apsw": "MIT"}
OURS: Final = ("dev", "docs", "bench", "build")  # extras for work on fixel itself


def check_licences(project: Mapping[str, Any]) -> str:
    """Raise AssertionError for a licence that is unknown, or not free and not only in extras."""
    known: dict[str, Distribution] = {canonicalize_name(d.name): d for d in distributions()}
    extras = project["optional-dependencies"]
    plain: set[str] = set()
    collect(project["dependencies"], known, plain)
    every = {*plain}
    collect([line for e in extras if e not in OURS for line in extras[e]], known, every)
    named = {name: licence(name, known[name]) for name in sorted(every & {*known})}
    other = {name: found for name, found in named.items() if not is_free(found)}
    bad = [f"{n}: {x or 'none stated'}" for n, x in other.items() if n in plain or "GPL" not in x]
    if bad:
        raise AssertionError("; ".join(bad))
    absent = sorted(every - {*known})
    return f"{len(plain)} packages, {len(named)} with extras" + "".join(
        f"; {what}: {', '.join(names)}"
        for what, names in (
            ("only in extras", [f"{name} ({found})" for name, found in other.items()]),
            ("not installed here, so not checked", absent),
        )
        if names
    )


def collect(lines: Iterable[str], known: Mapping[str, Distribution], found: set[str]) -> None:
    """Add the names of packages that requirements need, directly or not, on this system."""
    for need in map(Requirement, lines):
        name = canonicalize_name(need.name)
        if name not in found and (need.marker is None or need.marker.evaluate({"extra": ""})):
            found.add(name)
            options = [f"extra == '{extra}'" for extra in need.extras]
            needs = known[name].requires or [] if name in known else []
            collect((n.split(" ;")[0] if any(o in n.replace('"', "'") for o in options) else n
                     for n in needs), known, found)  # fmt: skip


def licence(name: str, about: Distribution) -> str:
    """SPDX expression of a package's licence; empty if its metadata name none that is known."""
    fields = about.metadata.json
    stated = STATED.get(name) or fields.get("license_expression")
    if stated:
        return str(stated)
    kinds = [kind for kind in fields.get("classifier", ()) if kind.startswith("License ::")]
    for words in (" ".join(kinds), str(fields.get("license"))):
        for pattern, meant in WORDS.items():
            if re.search(rf"\b({pattern})\b", words):
                return meant
    return ""


def is_free(expression: str) -> bool:
    """Whether one of the alternatives of an SPDX expression has only licences of the list."""
    alternatives = [{*re.findall(r"[\w.+-]+", part)} for part in expression.split(" OR ")]
    return any(own and own - {"AND", "WITH"} <= FREE for own in alternatives)
