"""Stored machine code: whatever happens to its files, results are right and nothing else runs."""

import ast
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import fixel
from fixel.kernels.code_cache import MAX_BYTES, cache_folder
from fixel.kernels.jit import entry

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
PACKAGE = Path(fixel.__file__).parent


def doubled(x):
    return x + x


def squared(x):
    return x * x


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FIXEL_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def is_loaded(function=doubled):
    """Use the function as a new process would, and return whether its code came from the disk."""
    compiled = entry(function)
    assert compiled(1.25) == function(1.25)
    return not compiled.stats.cache_misses


def stored(cache, name="doubled"):
    (file,) = cache.rglob(f"*.{name}-*")
    return file


class Program:
    """Pickle that writes a file when it is loaded."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return (self.file.write_text, ("run",))


def replaced(file):
    """Replace a file by the sound one of another entry."""
    entry(squared)(1.25)
    shutil.copy(stored(file.parents[1], "squared"), file)


def flipped(file, place):
    content = bytearray(file.read_bytes())
    content[place] ^= 1
    file.write_bytes(content)


def instead(file, make):
    file.unlink()
    make(file)


DAMAGES = {
    "empty": lambda f: f.write_bytes(b""),
    "half": lambda f: f.write_bytes(f.read_bytes()[: f.stat().st_size // 2]),
    "without its last byte": lambda f: f.write_bytes(f.read_bytes()[:-1]),
    "one byte longer": lambda f: f.write_bytes(f.read_bytes() + b"."),
    "zeros": lambda f: f.write_bytes(bytes(f.stat().st_size)),
    "first bit flipped": lambda f: flipped(f, 0),
    "middle bit flipped": lambda f: flipped(f, f.stat().st_size // 2),
    "last bit flipped": lambda f: flipped(f, -1),
    "code of another entry": replaced,
    "a pickle that runs a program": lambda f: f.write_bytes(pickle.dumps(Program(f.parent / "x"))),
    "larger than any code": lambda f: os.truncate(f, MAX_BYTES + 1),
    "writable for others": lambda f: f.chmod(0o666),
    "missing": lambda f: f.unlink(),
    "a folder": lambda f: instead(f, lambda f: (f / "below").mkdir(parents=True)),
    "a link to itself": lambda f: instead(f, lambda f: f.symlink_to(f)),
    "a pipe without a writer": lambda f: instead(f, os.mkfifo),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_a_damaged_file_is_compiled_again_and_replaced(cache, damage, capsys):
    assert not is_loaded()
    assert is_loaded()
    file = stored(cache)
    damage(file)
    assert not is_loaded()
    assert is_loaded()
    assert file.is_file()
    assert not (file.parent / "x").exists()
    assert "cannot be stored" not in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid(), reason="only root can do this")
def test_code_of_another_user_is_not_run(cache):
    is_loaded()
    os.chown(stored(cache), 12345, 12345)
    assert not is_loaded()


SCRIPT = """
import math, resource, sys
from fixel.kernels import jit
jit.PATIENCE_S = math.inf
def tripled(x):
    return x + x + x
def run():
    f = jit.entry(tripled)
    assert f(2.0) == 6.0 and f(2) == 6 and f(2j) == 6j
    print(sum(f.stats.cache_misses.values()))
"""


def process(tmp_path, script, cache):
    # Code belongs to a file, so the same file with all scripts.
    file = tmp_path / "script.py"
    file.write_text(SCRIPT + "exec(sys.argv[1])", encoding="utf-8")
    command = [sys.executable, str(file), script]
    return subprocess.Popen(
        command, env=os.environ | {"FIXEL_CACHE_DIR": str(cache)}, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.mark.system
def test_code_that_cannot_be_stored_or_read_back_is_one_sentence(tmp_path):
    full = "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY)); run()"
    unread = "from fixel.kernels import code_cache; code_cache.MAX_BYTES = 10; run()"
    (tmp_path / "file").touch()
    for script, cache in (
        (full, tmp_path / "cache"),
        ("run()", tmp_path / "file"),
        (unread, tmp_path / "unread"),
    ):
        out, error = process(tmp_path, script, cache).communicate()

        assert out == "3\n"
        assert error.count("\n") == 1
        assert "cannot be stored" in error
        assert "FIXEL_CACHE_DIR" in error
    assert [f for f in (tmp_path / "cache").rglob("*") if f.is_file()] == []  # nor half a file
    compiling = process(tmp_path, "jit.PATIENCE_S = -1.0; run()", tmp_path / "file")
    announced, problem = compiling.communicate()[1].splitlines()
    assert announced.startswith("Compiling")
    assert "once" not in announced
    assert "cannot be stored" in problem


@pytest.mark.system
def test_processes_at_once_compile_each_code_once(tmp_path):
    cache = tmp_path / "cache"
    all_at_once = [process(tmp_path, "run()", cache) for _ in range(3)]
    answers = [one.communicate() for one in all_at_once]
    assert sum(int(out) for out, _ in answers) == 3  # for three combinations of types
    assert [error for _, error in answers] == [""] * 3
    assert process(tmp_path, "run()", cache).communicate() == ("0\n", "")


@pytest.mark.system
def test_a_process_that_is_killed_while_it_compiles_blocks_no_other(tmp_path):
    cache = tmp_path / "cache"
    dies = (
        "jit.KernelCompiler._compile_core = lambda own: os.kill(os.getpid(), 9); import os; run()"
    )
    process(tmp_path, dies, cache).communicate()
    assert [file.suffix for file in cache.rglob("*.*")] == [".compiling"]
    assert process(tmp_path, "run()", cache).communicate() == ("3\n", "")
    assert not [*cache.rglob("*.compiling")]


@pytest.mark.system
def test_long_compilation_is_one_line_on_standard_error_and_loading_is_none(tmp_path):
    at_once = "jit.PATIENCE_S = -1.0; run()"

    out, error = process(tmp_path, at_once, tmp_path / "cache").communicate()
    assert out == "3\n"
    assert error.count("\n") == 1
    assert error.startswith("Compiling")

    # Another installation's code, at another path and of other sources, is no reason for silence.
    (tmp_path / "other").mkdir()
    other = process(tmp_path / "other", f"x = 1; {at_once}", tmp_path / "cache")
    (tmp_path / "other" / "neighbour.py").touch()
    assert process(tmp_path, at_once, tmp_path / "cache").communicate() == ("0\n", "")
    other.communicate()


def test_the_folder_names_the_sources_of_the_kernels_and_of_the_neighbours(tmp_path):
    folders = []
    for name, text in (("a", "X = 1"), ("b", "X = 1"), ("c", "X = 2")):
        package = tmp_path / name / "package"
        package.mkdir(parents=True)
        (package / "entry.py").write_text("", encoding="utf-8")
        (package / "constants.py").write_text(text, encoding="utf-8")
        folders.append(cache_folder(str(package / "entry.py")))

    same, at_another_path, edited = folders
    assert same == at_another_path
    assert same != edited


def test_compiled_code_uses_only_its_own_folder_and_the_kernels():
    """Otherwise an edited function would leave old machine code in use."""
    decorators = {"entry", "kernel", "large_kernel", "allocating_kernel", "spliced_kernel"}
    outside, n = [], 0
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "fixel.kernels.jit import" not in text:
            continue
        own = ".".join(["fixel", *path.relative_to(PACKAGE).parent.parts, ""])
        origin = {}
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom):
                origin |= {alias.asname or alias.name: node.module for alias in node.names}
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.FunctionDef):
                continue
            if not decorators & {d.id for d in node.decorator_list if isinstance(d, ast.Name)}:
                continue
            n += 1
            used = {x.id for line in node.body for x in ast.walk(line) if isinstance(x, ast.Name)}
            for module in {origin.get(name, "") for name in used}:
                if module.startswith("fixel.") and not f"{module}.".startswith(
                    ("fixel.kernels.", own)
                ):
                    outside.append(f"{path.name} {node.name}: {module}")
    assert n > 100
    assert outside == []
