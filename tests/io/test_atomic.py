"""Files that are complete or absent.
Errors while a project's file is read: only damage is called damage.
"""

import os
import resource
import stat
import zipfile
from pathlib import Path

import pytest

from fixel.errors import InvalidInput, StoreRefused
from fixel.io.atomic import parsed, readable, write_whole, written_whole


def test_the_unfinished_file_has_a_name_that_others_cannot_guess(tmp_path: Path) -> None:
    """Two threads write one file, and another user could put a link under a known name."""
    path = tmp_path / "own.csv"
    with written_whole(path) as first:
        first.write_text("first")
        write_whole(path, "second")
        with written_whole(path) as third:
            assert third != first
            assert {first.suffix, third.suffix} == {".csv"}
            third.write_text("third")
    assert path.read_text() == "first"
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="of systems with named pipes")
def test_a_pipe_or_a_device_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    """A result that root wrote to /dev/null removed the device of the whole machine."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InvalidInput, match="found a device or a pipe"):
        write_whole(tmp_path / "pipe", "text")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


@pytest.mark.parametrize("problem", [KeyError("set"), EOFError(), RecursionError()])
def test_invalid_content_is_damage_of_this_file(tmp_path, problem):
    path = tmp_path / "own.json"
    with pytest.raises(StoreRefused, match="it is damaged") as refusal, readable(path, "delete it"):
        raise problem
    assert (str(path) in str(refusal.value), refusal.value.hint) == (True, "delete it")


def read_own(path):
    with readable(path, "delete it"):
        return path.read_text()


def test_a_failure_of_the_machine_does_not_advise_to_delete_the_file(tmp_path):
    path = tmp_path / "own.json"
    path.write_text("{}")
    usual = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, usual[1]))  # no more files may be opened
    try:
        with pytest.raises(StoreRefused, match="too many open files") as refusal:
            read_own(path)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, usual)
    assert refusal.value.hint is None


@pytest.mark.parametrize(("content", "found"), [
    (b"", "an empty file"),
    (b"\n<!DOCTYPE html><html>Sign in</html>", "a web page"),
    (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "a pointer of Git LFS"),
    (bytes(3000), "damaged, incomplete or foreign content"),
])  # fmt: skip
def test_a_file_that_no_parser_can_read_is_described(tmp_path, content, found):
    path = tmp_path / "push.zip"
    path.write_bytes(content)
    with pytest.raises(InvalidInput) as refusal, parsed(path):
        zipfile.ZipFile(path)

    error = refusal.value
    assert (error.where, error.found, error.expected) == ("push.zip", found, "a readable ZIP file")
    assert f"size of {len(content):,} bytes" in error.hint
