"""Print boards and tags, true to scale."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from fixel.drawing.chart import refuse_ending
from fixel.drawing.prints import (
    PRINT_ENDINGS,
    PrintSheet,
    board_sheet,
    save_sheets,
    tag_sheets,
)
from fixel.errors import InvalidInput
from fixel.formats.rig_file import rig_of
from fixel.io.atomic import refuse_unwritable, written_whole
from fixel.vision.boards import board_of
from fixel.vision.marks import Tag
from fixel.workflows.acquisition.camera.calibrate import board_text

MAX_TAGS = 500


class PrintAnswer(NamedTuple):
    """Result of printing boards or tags into a file."""

    file: Path
    sheets: int
    what: str
    tags: int = 0  # number of tags, 0 for a board

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {**self._asdict(), "file": str(self.file)}

    def blocks(self) -> list[list[str]]:
        """Return paragraphs of text for people."""
        if not self.tags:
            return [
                ["Print at 100 %, check the length of the ruler, glue the sheet to a flat plate."]
            ]
        sheets = f"{self.sheets} sheet{'s' if self.sheets > 1 else ''}"
        return [
            [
                f"{self.tags} tags on {sheets}. "
                "Print at 100 %, check the ruler, leave the white border around each tag."
            ]
        ]


def print_board(text: str, output: Path, paper: str) -> PrintAnswer:
    """Save a board as a PDF or PNG."""
    board = board_of(text)
    name = board_text(board)
    _save((board_sheet(board, name, paper),), output)
    return PrintAnswer(output, 1, name)


def print_rig_tags(rig: str, output: Path, paper: str) -> PrintAnswer:
    """Print all tags of a rig, each with the part it belongs to."""
    found = rig_of(rig)
    tags = [
        (mark, name)
        for name, part in found.parts.items()
        for mark in part.marks
        if isinstance(mark, Tag)
    ]
    tags += [(tag, "plate") for tag in found.plate]
    if not tags:
        raise InvalidInput(rig, found="no tags", expected="a rig with tags", hint="thesis-tags")
    return _print_tags(tags, output, paper, found.name)


def print_tags(
    first: int, last: int, size: float, family: str, output: Path, paper: str
) -> PrintAnswer:
    """Print tags with numbers from `first` to `last`, all of one size [m]."""
    if not 0 <= first <= last or last - first >= MAX_TAGS:
        raise InvalidInput(
            "ids", found=f"{first}-{last}", expected=f"a range of at most {MAX_TAGS}: 0-9"
        )
    tags = [(Tag(id=k, size=size, height=0.0, family=family), "") for k in range(first, last + 1)]
    return _print_tags(tags, output, paper, f"{family}, {1e3 * size:g} mm")


def _print_tags(tags: list[tuple[Tag, str]], output: Path, paper: str, title: str) -> PrintAnswer:
    sheets = tag_sheets(tags, paper, title)
    _save(sheets, output)
    return PrintAnswer(output, len(sheets), title, len(tags))


def _save(sheets: tuple[PrintSheet, ...], output: Path) -> None:
    refuse_ending(output, PRINT_ENDINGS, "print")
    refuse_unwritable(output)
    with written_whole(output) as unfinished:
        save_sheets(sheets, unfinished)
