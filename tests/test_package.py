"""Contents of the wheel, and metadata of the repository."""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import fixel

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PACKAGED = (".py", ".yaml", ".json", ".csv", ".bib", ".txt", ".html", ".css", ".js", ".svg")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("dist")
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True, timeout=120)
    (path,) = folder.glob("*.whl")
    assert path.name == f"fixel-{PROJECT['version']}-py3-none-any.whl"
    assert path.stat().st_size < 2.2e6
    return zipfile.ZipFile(path)


def test_wheel_has_all_of_the_package_and_nothing_else(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    assert {name.split("/")[0] for name in names} == {
        "fixel",
        f"fixel-{PROJECT['version']}.dist-info",
    }
    source = ROOT / "src"
    files = {
        path.relative_to(source).as_posix()
        for path in source.rglob("*")
        if path.is_file() and path.suffix in PACKAGED
    }
    assert files <= names
    assert not [name for name in names if re.search(r"(^|/)(tests?|reproductions)/|test_", name)]


def test_wheel_requires_no_extra(wheel: zipfile.ZipFile) -> None:
    (name,) = [name for name in wheel.namelist() if name.endswith("METADATA")]
    required = re.findall(
        r"^Requires-Dist: ([\w-]+)(?!.*extra ==)", wheel.read(name).decode(), re.M
    )
    assert len(required) == len(PROJECT["dependencies"])


def test_one_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == fixel.__version__ == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    # Required by the Citation File Format 1.2.0.
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert all("name" in author for author in citation["authors"])


def test_extras_that_messages_name_exist() -> None:
    sources = [*(ROOT / "src").rglob("*.py"), ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    named = {
        (path.name, extra)
        for path in sources
        for found in re.findall(r"fixel\[([\w,-]+)\]", path.read_text(encoding="utf-8"))
        for extra in found.split(",")
    }
    assert named
    known = set(PROJECT["optional-dependencies"])
    assert not [place for place in named if place[1] not in known]
