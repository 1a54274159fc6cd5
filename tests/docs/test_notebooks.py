"""The example notebooks: made from their tutorials, and they run."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from tools.notebooks import FOLDER, NAMES, PAGES, is_output, shown_outputs, text

pytestmark = pytest.mark.system


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_that_of_its_page(name: str) -> None:
    source = (FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")
    page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert source == text(page), "run: python -m tools.notebooks"
    assert f"](../../examples/notebooks/{name}.ipynb)" in page
    nbformat.validate(nbformat.reads(source, as_version=4))


# The cells of the others run without Jupyter, in `test_pages.py`.
@pytest.mark.parametrize(
    "name", [NAMES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES[1:])]
)
def test_notebook_runs(name: str, tmp_path: Path) -> None:
    page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    for folder in ("data", "scenes"):
        (tmp_path / folder).symlink_to(FOLDER.parent / folder)
    place = tmp_path / "notebooks"  # what a notebook writes is not left among the examples
    place.mkdir()
    NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": place}}
    ).execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    cells = [cell for cell in cells if not cell.source.startswith("%%writefile")]
    assert all(cell.execution_count for cell in cells)
    for cell, (_, shown) in zip(cells, shown_outputs(page), strict=True):
        streams = [o.text for o in cell.outputs if o.output_type == "stream" and o.name == "stdout"]
        assert shown is None or is_output(shown, "".join(streams)), (
            f"{cell.source} printed {streams}"
        )
