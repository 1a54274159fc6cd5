"""Calibration by worker processes, from where a reader calls it."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.system

SCRIPT = """
import fixel
from fixel.units import mm

pushes = fixel.datasets.example().sample(2)
fits = [
    fixel.calibrate(
        pushes,
        {"mu_pusher": (0, 1), "tripod_radius": (10 * mm, 60 * mm)},
        verdicts=False,
        max_evaluations=20,
        workers=n,
        progress=False,
    )
    for n in (2, 0)
]
values = [[estimate.value.hex() for estimate in fit.estimates.values()] for fit in fits]
assert values[0] == values[1], values
print(*values[0])
"""


@pytest.mark.parametrize("how", ["a script", "typed"])
def test_two_workers_need_no_guard_and_compute_the_same_bits(how, tmp_path):
    """Calibrate by two processes without the guard that the start method `spawn` requires."""
    pytest.importorskip("distributed")
    path = tmp_path / "script.py"
    path.write_text(SCRIPT, encoding="utf-8")
    words, typed = ([str(path)], None) if how == "a script" else (["-"], SCRIPT)
    done = subprocess.run(
        [sys.executable, *words],
        input=typed, capture_output=True, text=True, timeout=300, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split()) == 2
