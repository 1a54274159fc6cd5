"""The doctor: a healthy machine passes, and a broken part is one FAIL, not a crash."""

from types import SimpleNamespace

import pytest

from fixel.workflows import installation


@pytest.mark.slow
def test_this_machine_is_in_order():
    found = installation.examine()

    assert [c.name for c in found.checks if not c.passed] == []
    assert installation.worst_residual(found.checks) < installation.RESIDUAL
    assert found.versions["numpy"][0].isdigit()
    assert found.cache["bytes"] > 0
    assert found.summary()["passed"] is True


def test_a_check_that_breaks_has_failed(monkeypatch):
    def broken():
        raise ZeroDivisionError("oh no")

    monkeypatch.setattr(installation, "_CHECKS", {"broken": broken})

    assert installation.self_test() == [
        installation.SelfCheck("broken", False, "ZeroDivisionError: oh no", None)
    ]


def test_a_large_residual_is_a_failure(monkeypatch):
    monkeypatch.setattr(installation, "_CHECKS", {"bad": lambda: (True, "converged", 1e-3)})

    assert not installation.self_test()[0].passed


def test_a_cache_that_cannot_be_written_is_a_failure(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(installation, "cache_folder", lambda: str(tmp_path / "file" / "cache"))

    found = installation._cache_check()

    assert not found.passed
    assert "FIXEL_CACHE_DIR" in found.detail


def test_a_package_that_is_missing_is_named():
    assert installation._version("no-such-package-at-all") == "missing"


@pytest.mark.parametrize(
    ("cameras", "ports", "sentence"),
    [
        ([], [], "none; optional"),
        (["video1", "video0"], ["/dev/ttyACM0"], "/dev/video0, /dev/video1, /dev/ttyACM0"),
    ],
)
def test_the_bench_is_reported_and_none_is_fine(tmp_path, monkeypatch, cameras, ports, sentence):
    for name in cameras:
        (tmp_path / name).touch()
    monkeypatch.setattr(installation, "Path", lambda _: tmp_path)
    found_ports = [SimpleNamespace(port=port) for port in ports]
    monkeypatch.setattr("fixel.testbed.serial_port.found_ports", lambda: found_ports)

    found = installation._bench_check()

    assert (found.passed, found.detail) == (True, sentence)
