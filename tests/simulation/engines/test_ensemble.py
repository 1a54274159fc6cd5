"""Tests of ensembles of another engine, with programs that answer well and badly."""

import os
import stat
import sys
import time
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel import InvalidInput, MissingExtra, SolveFailed, simulate
from fixel.kernels import codes
from fixel.simulation.engines import program_of
from fixel.simulation.engines.ensemble import EngineEnsemble
from fixel.simulation.motion import OtherEngine, motion_model
from fixel.simulation.rollouts import INFEASIBLE, RolloutCase, ensemble_of
from fixel.testing.scenes import pushed_square
from fixel.trust import permit

SCENE = pushed_square()
TIMES = np.linspace(0.1, 2.0, 5)
HELLO = '{"name": "toy", "version": "1", "parameters": {"grip": {"unit": "-", "lowest": 0}}}'
# The body follows the pusher, by a share of its way; `misbehave` may do something else first.
PROGRAM = """
import json, os, sys, time
for line in sys.stdin:
    question = json.loads(line)
    if "hello" in question:
        print('{hello}', flush=True)
        continue
    task = question["task"]
    friction = task["pusher"]["friction"]
    x, y, theta = task["body"]["start"]
    (t0, x0, y0, _), (t1, x1, y1, _) = task["pusher"]["path"]
    share = task["values"].get("grip", 1.0)
    pose = [[x + share * (x1 - x0) * t / t1, y, theta] for t in task["times"]]
    if abs(friction - 0.5) < 1e-12:
        {misbehave}
    print(json.dumps({{"pose": pose}}), flush=True)
"""
BAD = {
    "hangs": ("time.sleep(60)", "no answer within 2 s"),
    "crashes": ("raise RuntimeError('no more memory')", "RuntimeError: no more memory"),
    "is killed": ("os.kill(os.getpid(), 11)", "SIGSEGV"),
    "answers NaN": ("pose[2][0] = float('nan')", "not finite"),
    "answers too little": ("del pose[-1]", "shape"),
    "answers texts": ("pose = 'forward'", "without a table of poses"),
    "answers no JSON": ("print('hello', flush=True); continue", "fixel needs a JSON object"),
    "answers half a line": ("print('{{\"pose\": [[', end='', flush=True); os._exit(0)", "status 0"),
    "answers without end": ("print('x' * (80 << 20), end='', flush=True)", "more than 64 MB"),
    "answers a deep nesting": (
        "print('[' * 90000 + ']' * 90000, flush=True); continue",
        "fixel needs a JSON",
    ),
    "answers deep poses": (
        "print('{{\"pose\": ' + '[' * 500 + ']' * 500 + '}}', flush=True); continue",
        "without a table of poses",
    ),
    "fails for a deep reason": (
        "print('{{\"failed\": ' + '[' * 800 + ']' * 800 + '}}', flush=True); continue",
        "[[[[",
    ),
    "leaves a child with its pipe": (
        "import subprocess; subprocess.Popen(['sleep', '120']); os._exit(4)",
        "status 4",
    ),
    "jumps": ("pose[3][0] += 1.0", "a jump"),
    "fails with a reason": ('print(\'{{"failed": "jammed"}}\', flush=True); continue', "jammed"),
}


def program(folder, misbehave="pass", hello=HELLO):
    """Write a program and return the engine of its name."""
    path = folder / "toy.py"
    code = misbehave.replace("{{", "{").replace("}}", "}")
    path.write_text(PROGRAM.format(hello=hello, misbehave=code))
    return OtherEngine(str(path))


def many(engine, limit=None, threads=2):
    permit(engine.name)
    return EngineEnsemble([RolloutCase(SCENE, TIMES)], engine, threads=threads, limit=limit)


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_answer_is_one_failed_rollout_with_its_reason(fault, tmp_path):
    misbehave, expected = BAD[fault]
    ensemble = many(program(tmp_path, misbehave), limit=2.0 if fault == "hangs" else 60.0)
    friction = np.array([0.1, 0.2, 0.5, 0.3, 0.4, 0.6])
    begin = time.monotonic()
    outcome = ensemble.simulate(np.zeros(6, np.int64), {"mu_pusher": friction})
    ensemble.close()
    assert time.monotonic() - begin < 45.0  # an end is noticed before the limit of 60 s
    assert outcome.status[2] == codes.ENGINE_FAILED
    assert expected in outcome.reasons[2]
    assert outcome.reasons[2].startswith("toy: ")
    good = np.arange(6) != 2
    assert outcome.converged.tolist() == good.tolist()
    # The start plus the way of the pusher: 20 mm/s for 2 s.
    np.testing.assert_allclose(outcome.pose[good, -1, 0], 0.04, atol=1e-12)
    assert np.isfinite(outcome.pose).all()


def test_results_do_not_depend_on_the_number_of_processes(tmp_path):
    values = {"toy.grip": np.linspace(1.0, 1.4, 9)}
    which = np.zeros(9, np.int64)
    one, several = (many(program(tmp_path), threads=n).simulate(which, values).pose for n in (1, 3))
    assert one.tobytes() == several.tobytes()


REFUSED = '    print(\'{"refused": "a pusher with corners"}\', flush=True); continue'


@pytest.mark.parametrize(("line", "error", "message"), [
    ("    sys.exit(3)", SolveFailed, "lost 10 times in a row: the program ended with status 3"),
    (REFUSED, InvalidInput, "engine toy: found a pusher with corners"),
])  # fmt: skip
def test_an_engine_that_never_answers_and_one_that_refuses_end_the_work(
    line, error, message, tmp_path
):
    engine = program(tmp_path)
    path = Path(engine.name)
    path.write_text(path.read_text().replace('    task = question["task"]', line))
    with pytest.raises(error, match=message):
        many(engine).simulate(np.zeros(40, np.int64), {})


def test_parameters_of_another_engine_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"mujoco\.timeconst.*toy\.grip"):
        many(program(tmp_path)).simulate(
            np.zeros(1, np.int64), {"mujoco.timeconst": np.array([0.01])}
        )


def test_values_out_of_range_are_not_simulated(tmp_path):
    outcome = many(program(tmp_path)).simulate(
        np.zeros(2, np.int64), {"toy.grip": np.array([-0.1, 1.2])}
    )
    assert outcome.reasons == ["toy.grip below its smallest value", ""]
    assert outcome.status.tolist() == [INFEASIBLE, codes.CONVERGED]


DEEP = "[" * 700 + "]" * 700


def no_program(folder):
    path = folder / "engine"
    path.write_text("no program")
    return OtherEngine(str(path))


@pytest.mark.parametrize(("make", "message"), [
    (lambda folder: OtherEngine(f"{program(folder).name}==2"),
     "found version 1, but fixel needs version 2"),
    (lambda folder: OtherEngine(str(folder / "none.py")), "no file"),
    (no_program, "cannot be started"),
    *((lambda folder, hello=hello: program(folder, hello=hello), "engine") for hello in (
        "[1]", "{oops", '{"parameters": 3}', "[" * 90_000, f'{{"parameters": {DEEP}}}')),
])  # fmt: skip
def test_programs_that_are_no_engine_are_refused(make, message, tmp_path):
    refused(many, make(tmp_path), match=message)


@pytest.mark.parametrize("hello", ["[1]", '{"parameters": 3}'])
def test_a_refused_program_is_started_again(hello, tmp_path):
    for _ in range(2):
        refused(simulate, SCENE, motion=program(tmp_path, hello=hello).name, match="toy.py: found")
    assert simulate(SCENE, motion=program(tmp_path).name).converged


def test_a_version_that_was_not_tested_is_refused(monkeypatch):
    monkeypatch.setattr("fixel.simulation.engines.version", lambda package: "7.30.0")
    with pytest.raises(InvalidInput, match=r"7\.30\.0.*7\.3, which was tested.*pymunk==7\.30\.0:"):
        program_of("pymunk:step=0.01")
    assert program_of("pymunk==7.30.0").command[-1] == "pymunk==7.30.0"


def test_a_missing_package_is_refused(monkeypatch):
    def missing(package):
        raise PackageNotFoundError(package)

    monkeypatch.setattr("fixel.simulation.engines.version", missing)
    with pytest.raises(MissingExtra, match=r"pymunk.*pip install 'fixel\[engines\]'"):
        program_of("pymunk")


@pytest.mark.skipif(sys.platform == "win32", reason="a script that the shell starts")
def test_any_executable_is_an_engine(tmp_path):
    script = program(tmp_path).name
    shell = tmp_path / "engine"
    shell.write_text(f"#!/bin/sh\nexec {sys.executable} {script}\n")
    shell.chmod(shell.stat().st_mode | stat.S_IXUSR)
    found = simulate(SCENE, motion=str(shell), output_interval=0.5)
    assert found.converged
    assert found.method["engine"] == f"{shell} 1"


def test_processes_end_with_their_ensemble(tmp_path):
    ensemble = many(program(tmp_path))
    ensemble.simulate(np.zeros(2, np.int64), {})
    pids = [own._process.pid for own in ensemble._programs if own._process is not None]
    assert pids
    del ensemble
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_simulate_returns_what_an_engine_knows(tmp_path):
    engine = program(tmp_path)
    found = simulate(SCENE, {"toy.grip": 1.5}, motion=engine.name, output_interval=0.25)
    assert found.converged
    assert found.final["part"].x == pytest.approx(0.06)
    assert found.final["finger"].x - found.pose["finger"][0, 0] == pytest.approx(0.04)
    assert len(found.contacts) == 0
    assert found.twist["part"][3, 0] == pytest.approx(0.03)
    assert "toy.py 1" in " ".join(repr(found).split())  # a long path wraps the line


def test_a_failed_simulation_is_a_value_with_advice(tmp_path):
    engine = program(tmp_path, BAD["crashes"][0])
    found = simulate(SCENE, {"mu_pusher": 0.5}, motion=engine.name)
    assert found.status == "engine_failed"
    assert "no more memory" in found.advice
    assert len(found.time) == 1


def test_a_calibration_finds_the_parameter_of_a_program(tmp_path):
    """The toy's own motion, with noise, as measurements: the parameter is found again."""
    engine = program(tmp_path)
    truth = simulate(SCENE, {"toy.grip": 1.2}, motion=engine.name, output_interval=0.1)
    noisy = truth.pose["part"] + np.random.default_rng(1).normal(0.0, 2e-5, (21, 3))
    case = RolloutCase(SCENE, np.linspace(0.1, 2.0, 20))
    ensemble = ensemble_of([case], engine)
    grips = np.linspace(1.0, 1.4, 41)
    pose = ensemble.simulate(np.zeros(41, np.int64), {"toy.grip": grips}).pose
    error = ((pose - noisy[1:]) ** 2).sum(axis=(1, 2))
    assert grips[np.argmin(error)] == pytest.approx(1.2)


# An engine of fixel that crashes where friction at the pusher is high, by a pusher's own value.
FRAGILE = """
import json, os, sys
from fixel.simulation.engines import engine_of
from fixel.simulation.engines.serve import answer
engine = engine_of("pymunk:step=0.02")
for line in sys.stdin:
    question = json.loads(line)
    if "task" in question and question["task"]["pusher"]["friction"] > {limit}:
        os.abort()
    print(json.dumps(answer(engine, question)), flush=True)
"""


@pytest.mark.system
def test_a_calibration_goes_on_after_crashes(tmp_path):
    """The search finds the same values as with an engine that does not crash far from them."""
    pytest.importorskip("pymunk")
    pushes = fixel.datasets.example()[:2]
    found = []
    for limit in (9.0, 0.45):
        path = tmp_path / f"engine_{limit:g}.py"
        path.write_text(FRAGILE.format(limit=limit))
        fit = fixel.calibrate(
            pushes, {"mu_pusher": (0.05, 0.6)}, motion=str(path), verdicts=False,
            optimiser="pattern-search", max_evaluations=40, progress=False,
        )  # fmt: skip
        found.append(fit["mu_pusher"])
    assert found[1] == pytest.approx(found[0], abs=0.02)
    assert found[1] < 0.45


def test_the_motion_of_a_name_is_the_engine():
    assert motion_model("pymunk:iterations=30") == OtherEngine("pymunk:iterations=30")
    refused(fixel.simulate_batch, SCENE, {"mu_pusher": [0.1]}, motion="pymunk", match="motion")


@pytest.mark.parametrize("name", ["pymnk", "pymnk:step=0.01", "pymnk==7.3"])
def test_an_unknown_motion_names_the_engines_and_the_nearest(name):
    text = str(refused(motion_model, name))
    assert "dynamic, quasistatic, first-order, box2d, drake, mujoco, pymunk" in text
    assert "the path of a program; did you mean 'pymunk'?" in text
    refused(motion_model, "quasi-static", match="did you mean 'quasistatic'")
