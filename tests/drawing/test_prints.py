"""Prints of boards and tags: the right squares, of the right size."""

import re

import numpy as np
import pytest
from PIL import Image
from tests.fixtures import refused

from fixel.drawing import prints
from fixel.errors import InvalidInput
from fixel.vision.marks import Tag, board_of
from fixel.vision.tracking.tags import read_tags


@pytest.mark.parametrize("text", ["charuco:7x5:30mm:20mm", "charuco:4x6:24mm:16mm:5x5"])
def test_a_board_is_the_one_of_opencv(text):
    board = board_of(text)
    per_metre = 4000.0
    size = tuple(round(side * per_metre) for side in board.size)
    ours = np.asarray(
        prints.rastered(
            prints.PrintSheet(board.size, prints.board_rectangles(board), ()), per_metre
        ).convert("L")
    )
    theirs = board.of_opencv().generateImage(size)
    assert np.mean(ours != theirs) < 0.02  # rounding of cells to whole pixels


def test_a_printed_board_is_found():
    board = board_of("charuco:7x5:30mm:22mm")
    image = prints.rastered(prints.board_sheet(board, "a board"), 4000.0).convert("L")
    corners = board.find(np.asarray(image))
    assert len(corners.places) == 24
    scale = np.linalg.norm(np.diff(corners.pixels[:2], axis=0)) / 0.03
    assert scale == pytest.approx(4000.0, rel=1e-3)


def test_a_printed_checkerboard_is_found():
    board = board_of("checkerboard:9x6:25mm")
    image = prints.rastered(prints.board_sheet(board, "a board"), 3000.0).convert("L")
    assert len(board.find(np.asarray(image)).places) == 54


def test_printed_tags_are_read():
    tags = [(Tag(id=k, size=0.02 + 0.001 * k, height=0.0), "plate") for k in range(7)]
    (sheet,) = prints.tag_sheets(tags)
    found = read_tags(np.asarray(prints.rastered(sheet, 4000.0).convert("L")), {"apriltag-36h11"})
    for tag, _ in tags:
        (corners,) = found[("apriltag-36h11", tag.id)]
        side = np.linalg.norm(corners[1] - corners[0])
        assert side == pytest.approx(4000.0 * tag.size, abs=2.0)


def test_files_know_their_size(tmp_path):
    sheet = prints.board_sheet(board_of("charuco:7x5:30mm:22mm"), "a board")
    prints.save_sheets([sheet], tmp_path / "a.pdf")
    prints.save_sheets([sheet], tmp_path / "a.png")
    box = re.search(rb"MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", (tmp_path / "a.pdf").read_bytes())
    assert box
    assert float(box[1]) == pytest.approx(297 / 25.4 * 72, abs=0.2)
    with Image.open(tmp_path / "a.png") as image:
        assert image.size[0] == round(0.297 * prints.PER_METRE)
        assert image.info["dpi"][0] == pytest.approx(600.0, abs=0.01)


@pytest.mark.parametrize("board", ["3x6:40mm", "6x8:40mm", "6x7:56mm", "8x6:40mm"])
def test_the_hinted_paper_fits(board):
    squares = board_of(f"checkerboard:{board}")
    try:
        prints.board_sheet(squares, "")
    except InvalidInput as refused:
        hint = re.search(r"--paper (\w+)", refused.hint or "")
        papers = [hint[1]] if hint else []
    else:
        papers = ["a4"]
    fitting = []
    for paper in prints.PAPERS:
        try:
            prints.board_sheet(squares, "", paper)
            fitting.append(paper)
        except InvalidInput:
            continue
    assert papers == fitting[:1]


def test_what_does_not_fit_is_refused(tmp_path):
    refused(prints.board_sheet, board_of("charuco:9x6:40mm:30mm"), "", match="--paper a3")
    refused(prints.board_sheet, board_of("charuco:9x7:90mm:60mm"), "", match="smaller squares")
    refused(prints.board_sheet, board_of("charuco:7x5:30mm:22mm"), "", "a9", match="a4")
    refused(prints.tag_sheets, [(Tag(id=5000, size=0.03, height=0.0), "")], match="586")
    sheets = prints.tag_sheets([(Tag(id=k, size=0.09, height=0.0), "") for k in range(9)])
    assert len(sheets) > 1
    refused(prints.save_sheets, sheets, tmp_path / "a.png", match=r"\.pdf")
