"""The files of a release agree with each other, and the check of a release finds what is wrong."""

import io
import re
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from tools import release_check
from tools.licences import is_free

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CONDA = {"matplotlib": "matplotlib-base"}  # names that differ


def pins(name: str) -> set[str]:
    text = (ROOT / "requirements" / name).read_text(encoding="utf-8")
    return set(re.findall(r"^([\w.-]+==[^\s;]+)", text, re.M))


def test_the_recipe_needs_what_the_package_needs() -> None:
    recipe = yaml.safe_load((ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
    needs = [Requirement(line) for line in PROJECT["dependencies"]]
    expected = {f"{CONDA.get(r.name, r.name)} {r.specifier}" for r in needs}
    expected.add(f"python {PROJECT['requires-python']}")

    # Both write the parts of a range in any order.
    assert {part_sorted(line) for line in recipe["requirements"]["run"]} == {
        part_sorted(line) for line in expected
    }
    assert recipe["context"]["version"] == PROJECT["version"]
    assert recipe["about"]["license"] == PROJECT["license"]
    (entry,) = recipe["build"]["python"]["entry_points"]
    assert entry == "fixel = " + PROJECT["scripts"]["fixel"]


def part_sorted(line: str) -> tuple[str, ...]:
    name, _, limits = line.partition(" ")
    return (name, *sorted(limits.split(",")))


def test_core_packages_are_pinned_as_in_the_complete_lock() -> None:
    core = pins("core.txt")

    assert core <= pins("lock.txt")
    names = {pin.partition("==")[0] for pin in core}
    assert {Requirement(line).name.lower() for line in PROJECT["dependencies"]} <= names


def test_the_container_runs_without_rights_and_installs_pinned_packages() -> None:
    lines = (ROOT / "Containerfile").read_text(encoding="utf-8").splitlines()
    words = [line.split(maxsplit=1) for line in lines if line[:1].isupper()]
    last = max(k for k, (word, _) in enumerate(words) if word == "FROM")

    assert ["USER", "fixel"] in words[last:]
    assert "--require-hashes -r /src/requirements/core.txt" in "\n".join(lines)


@pytest.mark.parametrize(("expression", "free"), [
    ("MIT", True),
    ("BSD-2-Clause AND Apache-2.0 WITH LLVM-exception", True),
    ("GPL-3.0-only OR MIT", True),
    ("LGPL-3.0-only", False),
    ("MIT AND GPL-2.0-only", False),
    ("", False),
])  # fmt: skip
def test_a_free_licence(expression: str, free: bool) -> None:
    assert is_free(expression) is free


def archives(folder: Path, files: dict[str, bytes]) -> list[Path]:
    """An sdist and a wheel with given files of the repository."""
    with tarfile.open(folder / "fixel-1.tar.gz", "w:gz") as sdist:
        for name, content in {**files, "PKG-INFO": b""}.items():
            member = tarfile.TarInfo(f"fixel-1/{name}")
            member.size = len(content)
            sdist.addfile(member, io.BytesIO(content))
    with zipfile.ZipFile(folder / "fixel-1.whl", "w") as wheel:
        for name, content in files.items():
            if name.startswith("src/fixel/"):
                wheel.writestr(name.removeprefix("src/"), content)
        wheel.writestr("fixel-1.dist-info/METADATA", "")
    return [folder / "fixel-1.tar.gz", folder / "fixel-1.whl"]


FILES = {"README.md": b"fixel", "src/fixel/a.py": b"a = 1\n"}


def test_archives_have_what_git_tracks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(release_check, "tracked", lambda: [*FILES])

    assert "in 3 files" in release_check.check_files(*archives(tmp_path, FILES))


@pytest.mark.parametrize(
    ("tracked", "files", "found"),
    [
        (FILES, {"README.md": b"fixel"}, "only in"),
        (FILES, {**FILES, "dist/old.whl": b""}, "only in"),
        (FILES, {**FILES, "src/fixel/__pycache__/a.pyc": b""}, "only in"),
        ({**FILES, "data/run.parquet": b"x"}, {**FILES, "data/run.parquet": b"x"}, "parquet"),
        ({**FILES, "a.svg": b""}, {**FILES, "a.svg": bytes(1_000_001)}, "a.svg"),
    ],
    ids=["a file is missing", "a build is packed", "bytecode is packed", "data", "a large file"],
)
def test_other_archives_are_wrong(tracked, files, found, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(release_check, "tracked", lambda: [*tracked])

    with pytest.raises(AssertionError, match=found):
        release_check.check_files(*archives(tmp_path, files))


def test_the_readme_leads_to_files_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    assert int(release_check.check_readme().split()[0]) > 10
    monkeypatch.setattr(release_check, "text", lambda _: "![a picture](docs/no_such_picture.png)")

    with pytest.raises(AssertionError, match="no_such_picture"):
        release_check.check_readme()


def test_one_failure_neither_stops_nor_hides_the_others(tmp_path, monkeypatch) -> None:
    def fail(*_: object) -> str:
        raise AssertionError("two builds differ")

    for name in ("check_readme", "check_files", "check_metadata", "check_licences"):
        monkeypatch.setattr(release_check, name, lambda *_: "fine")
    monkeypatch.setattr(release_check, "build", lambda *_: [tmp_path, tmp_path])
    monkeypatch.setattr(release_check, "check_same_bytes", fail)
    monkeypatch.setattr(release_check, "PYTHONS", ["3.1"])
    reported: list[release_check.Check] = []

    found = release_check.run_checks(tmp_path, False, reported.append)

    assert reported == found
    wrong = [(check.name, check.detail) for check in found if check.passed is False]
    assert wrong == [("same bytes", "two builds differ")]
    skipped = [check.name for check in found if check.passed is None]
    assert skipped == ["sdist, 3.1", "wheel, 3.1"]
