"""Check that a release could be published: ``python -m tools.release_check``.

It builds the package from the tracked files, installs it in empty environments of every supported
Python at hand, and runs it in a folder without sources. ``--quick`` leaves out what installs.
Nothing is uploaded, and nothing is written outside a temporary folder.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from markdown_it import MarkdownIt
from packaging.metadata import Metadata
from trove_classifiers import classifiers

from tools.licences import check_licences

ROOT: Final = Path(__file__).parents[1]
PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS: Final = re.findall(r":: (3\.\d+)$", "\n".join(PROJECT["classifiers"]), re.M)
EPOCH: Final = "1577836800"  # [s] time of all files in the archives: 2020-01-01
LARGEST: Final = 1_000_000  # [bytes] of a file in an archive
# Endings of measurements, films, compiled code and what caches hold.
FOREIGN: Final = (".parquet", ".h5", ".mat", ".nut", ".mp4", ".mkv", ".pyc", ".so", ".nbi", ".nbc")
WORDS: Final = {True: "right", False: "WRONG", None: "skipped"}


@dataclass(frozen=True)
class Check:
    """Result of one check; `passed` is None for one that was skipped."""

    name: str
    passed: bool | None
    detail: str
    seconds: float


class PythonMissing(Exception):
    """Check that needs a version of Python which this machine lacks."""


def require(right: object, problem: str) -> None:
    if not right:
        raise AssertionError(problem)


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def call(words: list[Any], folder: Path, limit: float = 1500.0) -> str:
    """Run a program without the packages of this environment; return its output."""
    own = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    own |= {"SOURCE_DATE_EPOCH": EPOCH, "MPLBACKEND": "agg", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    done = subprocess.run(
        [*map(str, words)], cwd=folder, env=own, capture_output=True, text=True, timeout=limit
    )
    lines = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
    require(not done.returncode, f"{Path(words[-1]).name}: {lines[-1] if lines else 'failed'}")
    return done.stdout


def tracked() -> list[str]:
    """Files of the repository that git tracks."""
    names = call(["git", "ls-files", "-z"], ROOT).split("\0")
    return [name for name in names if name and (ROOT / name).is_file()]


def build(folder: Path, sources: Path | None = None) -> list[Path]:
    """Build sdist and wheel from `sources`, by default from a copy of the tracked files."""
    if sources is None:
        sources = folder / "sources"
        for name in tracked():
            (sources / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, sources / name)
    call([sys.executable, "-m", "hatchling", "build", "-d", folder / "dist"], sources)
    return sorted((folder / "dist").iterdir(), reverse=True)


def check_same_bytes(folder: Path, first: list[Path]) -> str:
    with tarfile.open(first[0]) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    second, third = build(folder / "again"), build(folder / "from-sdist", unpacked)
    for one, other in ((first[0], second[0]), (first[1], second[1]), (first[1], third[1])):
        require(one.read_bytes() == other.read_bytes(), f"{one.name} differs: {other.parents[1]}")
    return "both built twice, the wheel also from the sdist"


def check_files(sdist: Path, wheel: Path) -> str:
    with tarfile.open(sdist) as archive:
        source = {m.name.partition("/")[2]: m.size for m in archive.getmembers() if m.isfile()}
    with zipfile.ZipFile(wheel) as packed:
        installed = {i.filename: i.file_size for i in packed.infolist()}
    package = {name for name in installed if ".dist-info/" not in name}
    files = {*tracked(), "PKG-INFO"}
    ours = {name.removeprefix("src/") for name in files if name.startswith("src/fixel/")}
    for odd in sorted({*source} ^ files | package ^ ours):
        raise AssertionError(f"{odd}: only in the repository or only in an archive")
    for name, size in (source | installed).items():
        require(not name.endswith(FOREIGN) and size <= LARGEST, f"{name} ({size} bytes)")
    sizes = [f"{path.name}: {path.stat().st_size / 1e6:.1f} MB" for path in (sdist, wheel)]
    return f"{sizes[0]} in {len(source)} files; {sizes[1]} in {len(installed)}"


def check_metadata(wheel: Path) -> str:
    with zipfile.ZipFile(wheel) as packed:
        (name,) = (n for n in packed.namelist() if n.endswith(".dist-info/METADATA"))
        found = Metadata.from_email(packed.read(name), validate=True)
        require(any("/licenses/LICENSE" in n for n in packed.namelist()), "no licence in the wheel")
    unknown = set(found.classifiers or ()) - {*classifiers}
    require(not unknown, f"unknown classifiers: {', '.join(unknown)}")
    require(found.description == text("README.md"), "the description is not README.md")
    require(found.description_content_type == "text/markdown", "the description is not Markdown")
    require(f"\nversion: {found.version}\n" in text("CITATION.cff"), "CITATION.cff: other version")
    require(f"\n## {found.version}" in text("CHANGELOG.md"), "CHANGELOG.md lacks this version")
    return f"{found.name} {found.version}, {found.license_expression}"


def check_readme() -> str:
    tokens = MarkdownIt("commonmark").enable("table").parse(text("README.md"))
    inline = [child for token in tokens for child in token.children or ()]
    targets = [str(t.attrs[key]) for t in inline for key in ("href", "src") if key in t.attrs]
    for target in targets:
        inside = (ROOT / target.partition("#")[0]).exists()
        require(inside or target.startswith("https://"), f"nothing at {target}")
    raw = [child.content for child in inline if child.type == "text" and "](" in child.content]
    require(not raw, f"not rendered: {raw[:1]}")
    return f"{len(targets)} links and pictures"


def interpreter(version: str) -> str:
    """Program of a Python version with venv, from the search path or from pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT", "~/.pyenv")).expanduser() / "versions"
    for found in (shutil.which(f"python{version}"), *pyenv.glob(f"{version}.*/bin/python")):
        code = f"import sys, ensurepip, venv; assert '{version}' == '%d.%d' % sys.version_info[:2]"
        if found and not subprocess.run([found, "-c", code], capture_output=True).returncode:
            return str(found)
    raise PythonMissing(f"no Python {version} with venv here")


def check_install(archive: Path, version: str, folder: Path) -> str:
    """Install an archive into an empty environment in `folder`, and check it there."""
    programs = folder / "bin"
    call([interpreter(version), "-m", "venv", folder], folder.parent)
    call([programs / "python", "-m", "pip", "install", "-q", archive], folder)
    where = call([programs / "python", "-c", "import fixel; print(fixel.__file__)"], folder)
    require(Path(where.strip()).is_relative_to(folder), f"fixel was found at {where}")
    size = sum(p.lstat().st_size for p in folder.rglob("*"))
    found = json.loads(call([programs / "fixel", "doctor", "--json"], folder))
    require(found["passed"], f"fixel doctor: {[c for c in found['checks'] if not c['passed']]}")
    require(found["versions"]["fixel"] == PROJECT["version"], "fixel doctor: another version")
    return f"doctor passed; {size / 1e6:.0f} MB"


def check_demo(folder: Path, *options: str) -> str:
    (folder / "demo").mkdir(exist_ok=True)
    words = call([folder / "bin" / "fixel", "demo", *options], folder / "demo").splitlines()
    return f"{len(words)} lines, {sum(p.is_file() for p in (folder / 'demo').rglob('*'))} files"


def check_examples(folder: Path) -> str:
    """Run the gallery and the example of the README."""
    shutil.copytree(ROOT / "examples", folder / "examples")
    blocks = re.findall(r"^```python\n(.*?)^```", text("README.md"), re.M | re.S)
    (folder / "examples" / "gallery" / "README.py").write_text("\n".join(blocks), encoding="utf-8")
    scripts = sorted((folder / "examples" / "gallery").glob("*.py"))
    wrong: list[str] = []
    extras: list[str] = []
    for script in scripts:
        try:
            call([folder / "bin" / "python", script], script.parent)
        except AssertionError as problem:
            needs = re.search(r"fixel\[(\w+)\]", str(problem))
            (extras if needs else wrong).append(f"{script.stem}: {needs[1] if needs else problem}")
    require(not wrong, "; ".join(wrong))
    return f"{len(scripts) - len(extras)} ran; need an extra: {', '.join(extras) or 'none'}"


def run_checks(folder: Path, quick: bool, report: Callable[[Check], None]) -> list[Check]:
    """Run all checks in a temporary folder; `report` is called after each."""
    found: list[Check] = []

    def run(name: str, check: Callable[..., Any], *given: Any) -> Any:
        start = time.monotonic()
        passed: bool | None = True
        try:
            result = check(*given)
        except PythonMissing as reason:
            passed, result = None, str(reason)
        except (AssertionError, subprocess.TimeoutExpired, ExceptionGroup, ValueError) as problem:
            passed, result = False, str(problem)
        detail = result if isinstance(result, str) else "done"
        found.append(Check(name, passed, detail, round(time.monotonic() - start, 1)))
        report(found[-1])
        return result if passed else None

    run("README.md", check_readme)
    run("licences", check_licences, PROJECT)
    archives = run("build", build, folder / "first")
    if not archives:
        return found
    run("same bytes", check_same_bytes, folder, archives)
    run("files", check_files, *archives)
    run("metadata", check_metadata, archives[1])
    done = False  # the whole demo and the examples ran
    for version in () if quick else PYTHONS:
        for archive, kind in zip(archives, ("sdist", "wheel"), strict=True):
            place = folder / f"{kind}-{version}"
            ready = run(f"{kind}, {version}", check_install, archive, version, place)
        if ready:
            run(f"demo --quick, {version}", check_demo, place, "--quick")
        if ready and not done:
            done = True
            run(f"demo, {version}", check_demo, place)
            run(f"examples, {version}", check_examples, place)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.release_check", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out everything that installs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()

    def report(check: Check) -> None:
        if not given.json:
            line = f"{check.name:20} {WORDS[check.passed]:8} {check.seconds:6.0f} s  {check.detail}"
            print(line, flush=True)

    with tempfile.TemporaryDirectory(prefix="fixel-release-") as folder:
        os.environ.setdefault("FIXEL_CACHE_DIR", f"{folder}/kernels")
        found = run_checks(Path(folder).resolve(), given.quick, report)
    counts = {word: sum(c.passed is state for c in found) for state, word in WORDS.items()}
    answer = {"passed": not counts["WRONG"], **counts, "checks": [asdict(check) for check in found]}
    print(json.dumps(answer) if given.json else ", ".join(f"{n} {w}" for w, n in counts.items()))
    return int(counts["WRONG"] > 0)


if __name__ == "__main__":
    sys.exit(main())
