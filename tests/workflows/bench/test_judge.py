"""Reasons to repeat an attempt, at a laboratory whose faults are known."""

import pytest
from tests.workflows.bench.test_loop import bench  # noqa: F401

from fixel.workflows.bench import devices
from fixel.workflows.bench.run import open_bench


def reasons(bench, monkeypatch, **faults):  # noqa: F811
    """Reasons of the first attempt of each row at a laboratory with these faults."""
    project, plan = bench
    monkeypatch.setattr(devices, "HIDDEN", faults.get("hidden", slice(0)))
    monkeypatch.setattr(devices, "OVERLOAD", faults.get("overload", slice(0)))
    with open_bench(project, plan, emulated=True, auto=True, fit=("mu_support",)) as loop:
        loop.run()
        first = [own for own in loop.campaign.attempts.values() if own.number == 1]
        again = [own for own in loop.campaign.attempts.values() if own.number == 2]
    return [own.reasons for own in first], again


@pytest.mark.system
@pytest.mark.parametrize(
    ("fault", "reason"), [("overload", "overload"), ("hidden", "was not seen for")]
)
def test_a_fault_is_noticed_and_the_row_repeated(fault, reason, bench, monkeypatch):  # noqa: F811
    first, again = reasons(bench, monkeypatch, **{fault: slice(1)})
    assert any(reason in found for found in first[0])
    assert first[1] == ()
    assert [own.state for own in again] == ["accepted"]
