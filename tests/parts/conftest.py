import pytest

from fixel.parts.model import PartModel
from fixel.testing.pushes import example_parts
from fixel.workflows.parts import part_model


@pytest.fixture(scope="session")
def model() -> PartModel:
    """Model of four simulated parts with few pushes."""
    return part_model(example_parts(4, 16), progress=False, threads=1)
