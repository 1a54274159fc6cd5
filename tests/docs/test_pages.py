"""The pages a newcomer reads first: their Python runs, their links lead somewhere."""

import csv
import os
import re
from pathlib import Path

import pytest
import yaml
from tools.notebooks import NAMES, is_output, shown_outputs

import fixel
from fixel.formats import scene_file_from_dict
from fixel.model import KNOWN_PARAMETERS

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
GENERATED = ("gallery", "reference/api", "reference/commands", "reference/generated", "project")


def _is_generated(path: Path) -> bool:
    """Whether `make docs` writes a page; the build itself checks the links of those."""
    place = Path(os.path.normpath(path)).relative_to(ROOT)
    return place.is_relative_to("docs") and (
        place.relative_to("docs").as_posix().startswith(GENERATED)
    )


ALL_PAGES = [
    page
    for page in (*ROOT.glob("*.md"), *sorted((ROOT / "docs").rglob("*.md")))
    if not _is_generated(page)
]
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
# A file that the reader saves.
FILE = re.compile(r"```{code-block} \w+\n:caption: (\S+)\n\n(.*?)```", re.DOTALL)
# The first tutorial runs as a notebook; recordings are read in tests/formats.
ELSEWHERE = ("docs/how-to/record.md", f"docs/tutorials/{NAMES[0]}.md")
RUNNING = [
    page
    for page in ALL_PAGES
    if BLOCK.search(page.read_text(encoding="utf-8"))
    and page.relative_to(ROOT).as_posix() not in ELSEWHERE
]


@pytest.mark.parametrize("page", RUNNING, ids=lambda page: page.stem)
def test_python_blocks_run_in_order(
    page: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    for name, text in FILE.findall(page.read_text(encoding="utf-8")):
        (tmp_path / name).write_text(text, encoding="utf-8")
    namespace: dict[str, object] = {"__name__": "page"}
    for block, shown in shown_outputs(page.read_text(encoding="utf-8")):
        exec(compile(block, str(page), "exec"), namespace)
        printed = capsys.readouterr().out
        assert shown is None or is_output(shown, printed), f"{block} printed {printed}"


@pytest.mark.parametrize(
    "page", sorted((ROOT / "docs/tutorials").glob("*.md")), ids=lambda p: p.stem
)
def test_tutorials_import_public_names_only(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    own = re.findall(r"^\s*(?:import|from) (fixel\S*)(?: import (.*))?$", text, re.MULTILINE)
    for module, names in own:
        assert module in ("fixel", "fixel.units"), f"{page.name} imports from {module}"
        assert module == "fixel.units" or {*re.findall(r"\w+", names)} <= {*dir(fixel)}
    assert {*re.findall(r"\bfixel\.([a-zA-Z]\w+)\(", text)} <= {*dir(fixel)}


def test_the_gallery_imports_nothing_that_belongs_to_commands_or_pages() -> None:
    for script in sorted((ROOT / "examples/gallery").glob("*.py")):
        own = re.findall(r"^(?:import|from) fixel\.(\w+)", script.read_text("utf-8"), re.MULTILINE)
        assert not {*own} & {"workflows", "cli", "web", "capability"}, script.name


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda page: page.stem)
def test_local_links_lead_somewhere(page: Path) -> None:
    for target, anchor in re.findall(
        r"\]\((?!\w+:)([^)#\s]*)#?([^)\s]*)\)", page.read_text(encoding="utf-8")
    ):
        found = page.parent / target if target else page
        assert found.exists() or _is_generated(found), f"{page.name} links to {target}"
        if anchor and found.exists():
            assert anchor in _anchors(found), f"{page.name} links to {target}#{anchor}"


def _anchors(page: Path) -> set[str]:
    """Names of the headings of a page, as links write them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    words = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {name.strip().replace(" ", "-") for name in words}


def test_calibration_page_names_every_parameter() -> None:
    page = (ROOT / "docs" / "how-to" / "calibration.md").read_text(encoding="utf-8")
    named = set()
    for first_cell in re.findall(r"^\| (`.*?) \|", page, re.MULTILINE):
        names = re.findall(r"`(\w+)`", first_cell)
        # `start_x`, `_y` stands for start_x and start_y.
        stem = names[0].rpartition("_")[0]
        named |= {stem + name if name.startswith("_") else name for name in names}
    # Of the three free points the page names the first and the last.
    known = {name for name in KNOWN_PARAMETERS if not name.startswith("support_")}
    assert known <= named, f"undocumented: {sorted(known - named)}"


def test_the_bias_of_plans_is_the_same_in_the_readme_on_its_page_and_in_the_rows() -> None:
    with (ROOT / "benchmarks" / "results" / "planning.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    bias = 100.0 * sum(float(row["mean"]) - float(row["held"]) for row in rows) / len(rows)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    page = ROOT / "docs" / "reproductions" / "plans-in-another-model.md"
    assert f"more often\nthan stated: by {-bias:.1f} percentage points" in readme
    assert f"too small by {-bias:.1f} points" in page.read_text(encoding="utf-8")


def test_scene_file_page_has_an_example_that_loads() -> None:
    page = (ROOT / "docs" / "reference" / "scene-file.md").read_text(encoding="utf-8")
    example = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)[0]
    assert scene_file_from_dict(yaml.safe_load(example)).scene.names == (
        "object",
        "actuator",
        "fixel-1",
    )
