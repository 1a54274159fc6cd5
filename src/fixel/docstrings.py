"""Docstrings in NumPy layout, as commands, forms and files read them."""

from __future__ import annotations

import inspect
import re


def meanings(docstring: str | None) -> dict[str, str]:
    """Return the meaning of each parameter or attribute in a docstring of NumPy layout."""
    text = inspect.cleandoc(docstring or "")
    section = re.search(r"^(?:Parameters|Attributes)\n-+\n(.*?)(?=^\w+\n-+$|\Z)", text, re.M | re.S)
    body = f"{section[1]}\n" if section else ""
    entries = re.findall(r"^(\S.*?) : .*\n((?:[ ]+.*\n?|\n)*)", body, re.M)
    return {
        name: " ".join(text.replace("`", "").split())
        for names, text in entries
        for name in names.split(", ")
    }
