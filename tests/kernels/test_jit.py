"""Helpers are linked into entries and have no machine code of their own."""

import numba
import pytest

from fixel.kernels.jit import KNOWN_NUMBA, entry, kernel

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


@kernel
def twice(x: float) -> float:
    return x + x


@entry
def four_times(x: float) -> float:
    return twice(twice(x))


def test_the_pinned_numba_is_known():
    assert numba.version_info.short in KNOWN_NUMBA


def test_an_entry_runs_the_helper():
    assert four_times(1.25) == 5.0


@compiled
def test_a_helper_has_no_machine_code():
    four_times(1.25)
    for overload in twice.overloads.values():
        assert overload.library.get_pointer_to_function(overload.fndesc.mangled_name) == 0
    for overload in four_times.overloads.values():
        assert overload.library.get_pointer_to_function(overload.fndesc.mangled_name) != 0
