"""Errors while a project's file is read: only damage is called damage."""

import resource

import pytest

from fixel.errors import StoreRefused
from fixel.io.damaged_files import readable


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
