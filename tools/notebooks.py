"""Notebooks of the tutorials, made from their pages: `python -m tools.notebooks`.

A page is the one source: the site shows it, and its blocks of Python become the cells of a
notebook. A notebook has no outputs, so it differs only where its page does.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
PAGES: Final = ROOT / "docs" / "tutorials"
FOLDER: Final = ROOT / "examples" / "notebooks"
NAMES: Final = (
    "first_push",
    "own_experiments",
    "calibration",
    "trust",
    "grasp",
    "plan",
    "own_simulator",
)

BLOCK: Final = re.compile(r"^```python\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
OUTPUT: Final = re.compile(r"\s*```text\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
NUMBER: Final = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# A file that the reader saves, and the link to the notebook itself.
FILE: Final = re.compile(r"```{code-block} \w+\n:caption: (\S+)\n\n(.*?)```\n", re.DOTALL)
OWN_LINK: Final = re.compile(r"^\[Download this page.*\n\n", re.MULTILINE)
LINK: Final = re.compile(r"(?<=\]\()(?!\w+:|#|/)")
METADATA: Final = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def notebook(page: str) -> dict[str, Any]:
    """Return the notebook of a page, in version 4.5 of the format.

    Links lead to the same pages, and files of examples are found, from the folder of notebooks.
    Outputs that the page shows are left out: running the notebook prints them.
    """
    cells = [{"id": f"cell-{k}", **cell} for k, cell in enumerate(_cells(page))]
    return {"cells": cells, "metadata": METADATA, "nbformat": 4, "nbformat_minor": 5}


def text(page: str) -> str:
    """Return the file of the notebook of a page."""
    return json.dumps(notebook(page), indent=1, ensure_ascii=False) + "\n"


def shown_outputs(page: str) -> list[tuple[str, str | None]]:
    """Return each block of Python of a page with the output that the page shows for it, if any."""
    parts = BLOCK.split(page)
    shown = [OUTPUT.match(part) for part in parts[2::2]]
    return [(code, found and found[1]) for code, found in zip(parts[1::2], shown, strict=True)]


def is_output(shown: str, printed: str) -> bool:
    """Return whether a block printed what its page shows; numbers may differ by 2 %."""
    if [NUMBER.sub("#", s).split() for s in shown.split("\n")] != [
        NUMBER.sub("#", s).split() for s in f"{printed.strip()}\n".split("\n")
    ]:
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(math.isclose(float(a), float(b), rel_tol=0.02, abs_tol=0.02) for a, b in pairs)


def _cells(page: str) -> Iterator[dict[str, Any]]:
    page = FILE.sub(r"```python\n%%writefile \1\n\2```\n", OWN_LINK.sub("", page))
    for k, part in enumerate(BLOCK.split(page)):
        source = (part if k % 2 else OUTPUT.sub("", part, count=1)).strip()
        if not source:
            continue
        if k % 2:
            code = source.replace('"examples/', '"../')
            empty: dict[str, Any] = {"execution_count": None, "metadata": {}, "outputs": []}
            yield {"cell_type": "code", **empty, "source": code.splitlines(keepends=True)}
        else:
            words = LINK.sub("../../docs/tutorials/", source)
            yield {
                "cell_type": "markdown",
                "metadata": {},
                "source": words.splitlines(keepends=True),
            }


def main() -> int:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in NAMES:
        page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
        (FOLDER / f"{name}.ipynb").write_text(text(page), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
