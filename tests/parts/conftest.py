import pytest

from fixel.testing.pushes import example_parts
from fixel.workflows.parts import part_model


@pytest.fixture(scope="session")
def model():
    """Model of four simulated parts with few pushes."""
    return part_model(example_parts(4, 16), progress=False, threads=1)
