import subprocess
import sys

import pytest

import fixel


@pytest.mark.parametrize("name", fixel.__all__)
def test_public_name_resolves(name: str) -> None:
    assert getattr(fixel, name) is not None


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'sceen'"):
        fixel.sceen  # noqa: B018


@pytest.mark.parametrize("module", ["fixel", "fixel.errors", "fixel.cli.main"])
def test_import_is_light(module: str) -> None:
    heavy = "{'numpy', 'numba', 'scipy', 'pydantic', 'matplotlib', 'shapely', 'pyarrow', 'rich'}"
    code = f"import sys, {module}; print(*sorted({heavy} & set(sys.modules)))"

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert done.stdout.strip() == ""
