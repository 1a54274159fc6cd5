"""Printable boards and tags, true to scale to the nearest 600th of an inch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.io.atomic import refuse_ending, refuse_unwritable, written_whole
from fixel.typing import FloatArray
from fixel.vision.frame import opencv
from fixel.vision.marks import Board, Tag, dictionary_of

if TYPE_CHECKING:
    from PIL.Image import Image

PRINT_ENDINGS: Final = (".pdf", ".png")
PAPERS: Final = {
    "a4": (0.210, 0.297),
    "a3": (0.297, 0.420),
    "a2": (0.420, 0.594),
    "letter": (0.2159, 0.2794),
}  # [m]
PER_METRE: Final = 600 / 0.0254  # [px]
EDGE: Final = 0.008  # [m], margin that printers leave white
FOOT: Final = 0.012  # [m], height below for the ruler and its text
RULER: Final = 0.100  # [m]
BETWEEN: Final = 0.006  # [m] between tags, for cutting
LETTERS: Final = 0.0032  # [m], size of letters


class PrintSheet(NamedTuple):
    """Sheet of paper with black rectangles and text."""

    size: tuple[float, float]  # width and height of the paper [m]
    black: FloatArray  # (n, 4) left, upper, right, lower edge from the upper left corner [m]
    words: tuple[tuple[float, float, str], ...]  # texts with their left and upper edge [m]


def board_sheet(board: Board, title: str, paper: str = "a4") -> PrintSheet:
    """Place a board in the middle of a sheet, portrait or landscape, with a ruler below."""
    page = _page(paper, board.size)
    left, top = 0.5 * (page[0] - board.size[0]), 0.5 * (page[1] - FOOT - board.size[1])
    return _with_foot(page, _at(left, top, board_rectangles(board)), [], title)


def tag_sheets(
    tags: Sequence[tuple[Tag, str]], paper: str = "a4", title: str = "tags"
) -> tuple[PrintSheet, ...]:
    """Place tags row by row, each above its number and a word, on as many sheets as needed."""
    page = _page(paper, (0.0, 0.0))
    sheets: list[PrintSheet] = []
    black: list[FloatArray] = []
    words: list[tuple[float, float, str]] = []
    x, y, row = EDGE, EDGE, 0.0
    for tag, word in sorted(tags, key=lambda pair: -pair[0].size):
        dictionary = dictionary_of(tag.family, tag.id)
        one = _cells_of(dictionary, tag.id, tag.size)
        # Detection of a tag needs a white border, one cell wide.
        cell = tag.size / (dictionary.markerSize + 2)
        wide = max(tag.size + 2.0 * cell, 0.02) + BETWEEN
        tall = tag.size + 2.0 * cell + LETTERS + BETWEEN
        if wide > page[0] - 2 * EDGE or tall > page[1] - 2 * EDGE - FOOT:
            found, expected = f"{1e3 * tag.size:g} mm", f"small enough to fit on {paper}"
            raise InvalidInput("tag.size", found=found, expected=expected, hint="another --paper")
        if x + wide > page[0] - EDGE:
            x, y, row = EDGE, y + row, 0.0
        if y + tall > page[1] - EDGE - FOOT:
            sheets.append(_with_foot(page, _stacked(black), words, title))
            black, words, x, y, row = [], [], EDGE, EDGE, 0.0
        black.append(_at(x + cell, y + cell, one))
        words.append((x + cell, y + tag.size + 2.0 * cell, f"{tag.id} {word}".strip()))
        x, row = x + wide, max(row, tall)
    sheets.append(_with_foot(page, _stacked(black), words, title))
    return tuple(sheets)


def save_sheets(sheets: Sequence[PrintSheet], path: str | Path) -> None:
    """Write sheets as a PDF, or a single one as a PNG with its resolution."""
    refuse_ending(path, PRINT_ENDINGS, "print")
    refuse_unwritable(path)
    as_pdf, dots = Path(path).suffix.lower() == ".pdf", PER_METRE * 0.0254
    if len(sheets) > 1 and not as_pdf:
        found, expected = f"{len(sheets)} sheets", "one sheet, for a PNG"
        raise InvalidInput(str(path), found=found, expected=expected, hint="write a .pdf")
    images = [rastered(sheet) for sheet in sheets]
    with written_whole(Path(path)) as file:
        if as_pdf:
            images[0].save(file, "PDF", resolution=dots, save_all=True, append_images=images[1:])
        else:
            images[0].save(file, "PNG", dpi=(dots, dots))


def rastered(sheet: PrintSheet, per_metre: float = PER_METRE) -> Image:
    """Render a sheet as a black-and-white image."""
    from PIL import Image, ImageDraw, ImageFont

    width, height = (round(side * per_metre) for side in sheet.size)
    pixels = np.full((height, width), 255, dtype=np.uint8)
    for left, top, right, bottom in np.rint(sheet.black * per_metre).astype(int).tolist():
        pixels[top:bottom, left:right] = 0
    image = Image.fromarray(pixels)
    pen = ImageDraw.Draw(image)
    font: Any = ImageFont.load_default(LETTERS * per_metre)
    for x, y, text in sheet.words:
        pen.text((x * per_metre, y * per_metre), text, fill=0, font=font)
    return image.convert("1", dither=Image.Dither.NONE)


def board_rectangles(board: Board) -> FloatArray:
    """Black rectangles (n, 4) of a board, from its upper left corner [m]."""
    i, j = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    dark = (i + j) % 2 == 0
    at = np.stack([i[dark], j[dark]], axis=-1) * board.square
    squares = np.hstack([at, at + board.square])
    if not board.marker:
        return squares
    found = board.of_opencv()
    rectangles = [squares]
    for number, corners in zip(found.getIds().ravel().tolist(), found.getObjPoints(), strict=True):
        x, y = np.asarray(corners)[:, :2].min(axis=0).tolist()
        cells = _cells_of(found.getDictionary(), number, board.marker)
        rectangles.append(_at(x, y, cells))
    return np.concatenate(rectangles)


def _cells_of(dictionary: Any, number: int, size: float) -> FloatArray:
    count = dictionary.markerSize + 2
    cells = opencv().aruco.generateImageMarker(dictionary, number, count)
    row, column = np.nonzero(cells == 0)
    at = np.stack([column, row], axis=-1) * (size / count)
    return np.hstack([at, at + size / count])


def _at(left: float, top: float, rectangles: FloatArray) -> FloatArray:
    return np.asarray(rectangles + np.array([left, top, left, top]))


def _page(paper: str, inside: tuple[float, float]) -> tuple[float, float]:
    if paper.lower() not in PAPERS:
        raise InvalidInput("paper", found=repr(paper), expected=", ".join(PAPERS))

    def fits(page: tuple[float, float]) -> bool:
        return inside[0] <= page[0] - 2 * EDGE and inside[1] <= page[1] - 2 * EDGE - FOOT

    pages = {name: next(filter(fits, (one, one[::-1])), None) for name, one in PAPERS.items()}
    if (page := pages[paper.lower()]) is not None:
        return page
    larger = [name for name, page in pages.items() if page]
    raise InvalidInput(
        "paper",
        found=f"a board of {1e3 * inside[0]:g} x {1e3 * inside[1]:g} mm for {paper}",
        expected="a board that fits on it",
        hint=f"--paper {larger[0]}, or smaller squares" if larger else "smaller squares",
    )


def _with_foot(
    page: tuple[float, float],
    black: FloatArray,
    words: Sequence[tuple[float, float, str]],
    title: str,
) -> PrintSheet:
    left, low = EDGE, page[1] - EDGE
    thin = 0.0003
    ruler = [
        (left, low - thin, left + RULER, low),
        *(
            (left + k * 0.01, low - (0.003 if k % 5 == 0 else 0.0015), left + k * 0.01 + thin, low)
            for k in range(11)
        ),
    ]
    text = f"100 mm: check with a ruler, print at 100 %.  {title}"
    return PrintSheet(
        page,
        np.concatenate([black, np.array(ruler)]),
        (*words, (left, low - 0.0035 - 1.3 * LETTERS, text)),
    )


def _stacked(black: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate(black) if black else np.zeros((0, 4))
