"""Helpers are linked into entries and have no machine code of their own."""

import contextlib
import gc
import os
import time

import numba
import pytest
from numba.core.compiler import Flags

from fixel.kernels import code_cache, jit
from fixel.kernels.code_cache import cache_folder
from fixel.kernels.jit import KNOWN_NUMBA, KernelCompiler, _Flags, entry, kernel

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


@kernel
def twice(x):
    return x + x


@entry
def four_times(x):
    return twice(twice(x))


@numba.njit(pipeline_class=KernelCompiler)
def kernel_sum(x, y):
    return x + y


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


@compiled
def test_a_compilation_collects_garbage_rarely_and_restores_the_thresholds(monkeypatch):
    during = []
    core = KernelCompiler._compile_core

    def observed(self):
        during.append(gc.get_threshold())
        return core(self)

    monkeypatch.setattr(KernelCompiler, "_compile_core", observed)
    before = gc.get_threshold()
    assert kernel_sum(1.0, 2.0) == 3.0
    assert during
    assert all(threshold != before for threshold in during)
    assert gc.get_threshold() == before


def test_flags_are_compared_as_numba_compares_them():
    plain, changed, same = Flags(), Flags(), Flags()
    changed.nrt = True
    same.nrt = False  # the default, set
    for flags in (plain, changed, same):
        assert hash(_Flags(flags)) == hash(flags)
        for other in (plain, changed, same):
            assert (_Flags(flags) == _Flags(other)) == (flags == other)
            assert (_Flags(flags) == other) == (flags == other)


@kernel
def squared(x):
    return x * x


def fourth_power(x):
    return squared(squared(x))


@compiled
def test_a_compilation_shows_how_far_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv("FIXEL_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(jit, "PATIENCE_S", 0.0)
    monkeypatch.setattr(jit, "BEAT_S", 0.01)
    stages, reports, files, stored = [], [], [], []
    marks = f"{cache_folder(__file__)}/test_jit.fourth_power.compiling"

    def report(done, total):
        reports.append((done, total))
        with open(marks) as file:
            files.append(file.read())

    @contextlib.contextmanager
    def show(stage):
        stages.append(stage)
        yield report

    core = KernelCompiler._compile_core

    def slow(self):
        time.sleep(0.2)
        return core(self)

    def store(path, content, write=code_cache.write_sealed):
        stored.append(os.path.exists(marks))  # processes that wait would compile again
        write(path, content)

    monkeypatch.setattr(code_cache, "write_sealed", store)
    monkeypatch.setattr(code_cache, "show", show)
    monkeypatch.setattr(KernelCompiler, "_compile_core", slow)
    assert entry(fourth_power)(2.0) == 16.0
    assert stages == ["compiling test_jit.fourth_power, 1 functions"]
    assert 0 <= reports[0][0] < reports[-1][0] <= 1000
    assert stored == [True]
    assert all(0.0 <= float(text) <= 1.0 for text in files)
    assert not list(tmp_path.rglob("*.compiling"))
