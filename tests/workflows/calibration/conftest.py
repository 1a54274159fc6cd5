"""Pictures without content, for tests of their numbers."""

import pytest
from PIL import Image

from fixel.drawing.chart import Chart


@pytest.fixture
def blank(monkeypatch):
    """Save blank pictures, whose numbers are compared: other tests draw them."""

    def save(chart, *paths, banner=""):
        Image.new("RGB", (9, 9)).save(paths[0], dpi=(60, 60))
        paths[1].write_bytes(b"%PDF")

    monkeypatch.setattr(Chart, "save", save)
