"""The first simulations, while machine code is missing: plain Python, and what can fail."""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from fixel.kernels import code_cache
from fixel.kernels.rollout import rollout_batch
from fixel.simulation import first_code, simulate
from fixel.testing.scenes import grasp, heap, pushed_square

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
plain = pytest.mark.skipif(not first_code.SAME_BITS, reason="plain Python is not used here")

# Nothing is compiled: the first process runs {compile}, and what needs code is reported.
_SCRIPT = """
import json, subprocess, sys
from fixel.simulation import first_code, simulate
from fixel.testing import scenes
children = []
real = first_code._child
def child(changes):
    program = {plain!r} if changes else {compile!r}
    pipes = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    one = subprocess.Popen([sys.executable, "-c", program], **pipes) if program else real(changes)
    children.append(one)
    return one
first_code._child = child
def compiled(*arguments):
    first_code.wait_for_code()
    print(json.dumps(["compiled here", first_code.is_missing(), len(children)]))
    raise SystemExit
sys.modules["fixel.simulation.simulate"].rollout_in_threads = compiled
try:
    for scene in (scenes.grasp("slip"), scenes.pushed_square(), scenes.heap(3, duration=0.5)):
        run = simulate(scene)
        print(json.dumps([run.status, run.steps, {{k: v.tolist() for k, v in run.pose.items()}}]))
finally:
    for one in children:
        one.kill()
        one.communicate()
"""
_WAITS = "import time; time.sleep(600)"
_DIES = "import os; os._exit(9)"


@pytest.fixture
def cold(tmp_path, monkeypatch):
    monkeypatch.setenv("FIXEL_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def in_a_new_process(cache, compile_=_WAITS, plain=""):
    """Answers of a process whose two children run these programs; the real one by default."""
    environment = {**os.environ, "FIXEL_CACHE_DIR": str(cache)}
    environment.pop("NUMBA_DISABLE_JIT", None)
    script = _SCRIPT.format(compile=compile_, plain=plain)
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True,
        timeout=400, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()], done.stderr


@compiled
@plain
def test_plain_python_answers_with_the_bits_of_compiled_code(tmp_path):
    answers, errors = in_a_new_process(tmp_path)

    scenes = (grasp("slip"), pushed_square(), heap(3, duration=0.5))
    for (status, steps, poses), scene in zip(answers, scenes, strict=True):
        run = simulate(scene)
        assert (status, steps) == (run.status, run.steps)
        assert poses.keys() == run.pose.keys()
        for name, pose in poses.items():
            assert np.array_equal(pose, run.pose[name])
    assert errors.count("Compiling numerical code in the background") == 1
    assert "plain Python and take longer" in errors
    assert "Traceback" not in errors


@compiled
@plain
@pytest.mark.parametrize("programs", [(_DIES, ""), (_WAITS.replace("600", "2"), _DIES)])
def test_a_process_that_dies_loses_no_simulation(tmp_path, programs):
    (answer,), _ = in_a_new_process(tmp_path, *programs)
    assert answer[:2] == ["compiled here", False]


@compiled
def test_a_cache_that_cannot_be_written_starts_no_process(tmp_path):
    file = tmp_path / "cache"
    file.write_text("a file")
    (answer,), _ = in_a_new_process(file)
    assert answer == ["compiled here", False, 0]


@pytest.fixture
def compiling(cold):
    file = Path(code_cache.cache_folder()) / f"{first_code.ENTRY}.compiling"
    file.parent.mkdir(parents=True)
    file.write_text("0.25")
    return file


@compiled
def test_another_process_that_compiles_is_waited_for(compiling, monkeypatch):
    monkeypatch.setattr(first_code, "_settled", False)
    assert code_cache.share_compiled(first_code.ENTRY) == 0.25
    threading.Timer(1.0, compiling.unlink).start()
    began = time.monotonic()
    first_code.wait_for_code()
    assert 0.5 < time.monotonic() - began < 30.0
    assert not first_code.is_missing()


def test_a_process_that_gave_no_sign_for_long_counts_as_dead(compiling):
    os.utime(compiling, (time.time() - 60.0,) * 2)
    assert code_cache.share_compiled(first_code.ENTRY) is None


def test_stored_code_is_that_of_the_entry(cold):
    folder = Path(code_cache.cache_folder())
    assert not code_cache.is_stored(first_code.ENTRY)
    code_cache.write_sealed(str(folder / "rollout.rollout_batch-0"), b"code")
    assert code_cache.is_stored(first_code.ENTRY)
    assert not code_cache.is_stored("batch.rollout")
    assert f"rollout.{rollout_batch.__name__}" == first_code.ENTRY
