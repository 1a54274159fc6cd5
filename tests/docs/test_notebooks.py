"""The example notebooks: made from their tutorials, and they run."""

import nbformat
import pytest
from nbclient import NotebookClient
from tools.notebooks import FOLDER, NAMES, PAGES, text


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_that_of_its_page_and_runs(name: str) -> None:
    source = (FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")
    page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert source == text(page), "run: python -m tools.notebooks"
    notebook = nbformat.reads(source, as_version=4)
    nbformat.validate(notebook)
    NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": FOLDER}}
    ).execute()
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
