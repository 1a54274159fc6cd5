"""Fixtures of the tests of jobs."""

import os

import pytest
from tests.jobs import slurm_one


@pytest.fixture(scope="session")
def real_slurm():
    """Environment of a real SLURM on this machine, with three nodes of one core."""
    absent = slurm_one.missing()
    if absent:
        pytest.skip(f"no SLURM here ({absent[0]} is missing): apt-get install slurm-wlm munge")
    with slurm_one.running(nodes=3) as environment:
        yield environment


@pytest.fixture
def slurm(real_slurm, monkeypatch):
    """A real SLURM, in the environment of this test."""
    for name, value in real_slurm.items():
        monkeypatch.setenv(name, value)
    return os.environ["SLURM_CONF"]
