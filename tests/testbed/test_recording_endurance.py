"""Recordings that are killed, and recordings that are long; each with a short twin.

pytest -m soak -s tests/testbed/test_recording_endurance.py
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from benchmarks.recording import plate

from fixel.formats.recording import RecordingHeader, RecordingWriter, open_recording
from fixel.formats.recording_files import ROWS
from fixel.testbed.file_source import LoopbackCamera
from fixel.vision.frame import Frame

pytestmark = pytest.mark.system

FIXEL = "from fixel.cli.main import run; run()"
LATEST = 0.5  # [s] before the kill that may be missing


def start(*arguments: str | Path, core: int | None = None) -> subprocess.Popen[str]:
    """A process that records."""
    pinned = ["taskset", "-c", str(core)] if core is not None else []
    return subprocess.Popen(
        [*pinned, sys.executable, "-c", FIXEL, "record", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def film(folder: Path, n: int, size: tuple[int, int], codec: str = "near") -> Path:
    with RecordingWriter(folder, RecordingHeader(size=size, codec=codec)) as writer:
        for k in range(n):
            writer.write(Frame(k / 30.0, plate(k, size)), k % 8)
    return folder


class Killed(NamedTuple):
    """A recording after its process was killed."""

    missing: float  # [s] between its last frame and the kill
    frames: int


def kill(folder: Path, arguments: Sequence[str | Path], after: float) -> Killed:
    """Record, kill the process some time after its first frame, and read what is there."""
    process = start(*arguments, "--out", folder)
    rows = folder / ROWS
    until = time.monotonic() + 60.0
    try:
        while not (rows.exists() and rows.read_bytes().count(b"\n") > 1):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < until, "it does not record"
            time.sleep(0.01)
        time.sleep(after)
        assert process.poll() is None, process.communicate()
        process.send_signal(signal.SIGKILL)
        moment = time.time()
    finally:
        process.kill()
        process.communicate()
    kept = open_recording(folder)
    assert not kept.complete
    assert sum(1 for _ in kept.frames()) == kept.n_frames == len(kept.readings)
    began = datetime.fromisoformat(kept.header.started).timestamp()
    return Killed(moment - began - float(kept.time[-1]), kept.n_frames)


def kills(tmp_path: Path, n: int, size: tuple[int, int], longest: float) -> list[Killed]:
    rng = np.random.default_rng(6)
    played = film(tmp_path / "film", round(30.0 * (longest + 2.0)), size)
    found = []
    for k in range(n):
        codec = ("as-it-comes", "near", "exact")[k % 3]
        arguments = ["--camera", played, "--tactile", "film", "--codec", codec]
        found.append(kill(tmp_path / f"r{k}", arguments, rng.uniform(longest / 3.0, longest)))
    return found


def test_a_recording_that_is_killed_is_read_up_to_then(tmp_path: Path) -> None:
    assert max(one.missing for one in kills(tmp_path, 3, (320, 240), 0.3)) < LATEST


@pytest.mark.soak
def test_a_hundred_recordings_that_are_killed_are_read_up_to_then(tmp_path: Path) -> None:
    found = kills(tmp_path, 100, (1280, 720), 3.0)
    missing = np.array([one.missing for one in found])
    print(
        f"\n{len(found)} kills: up to {missing.max():.3f} s missing, median "
        f"{np.median(missing):.3f} s, {(missing > LATEST).sum()} over {LATEST} s; "
        f"{min(one.frames for one in found)} to {max(one.frames for one in found)} frames read; "
        f"load {os.getloadavg()[1]:.1f} on {os.cpu_count()} cores"
    )
    assert missing.max() < LATEST


def resident(pid: int) -> float | None:
    """Memory of a process [MB]; none of one that has just ended."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return float(line.split()[1]) / 1e3
    return None


def long_run(tmp_path: Path, n: int, size: tuple[int, int], codec: str, played: int) -> Any:
    """Record from a network camera that shows a film again and again, all on one core."""
    shown = film(tmp_path / "film", played, size)
    sent = [zlib.crc32(data) for _, data in open_recording(shown).jpegs()]
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {0})
    try:
        with LoopbackCamera(shown, loop=True) as camera:
            out = tmp_path / "r"
            limit = f"{n / 30.0}s"
            process = start(
                "--camera", camera.url, "--out", out, "--codec", codec, "--limit", limit, "--json",
                core=0,
            )  # fmt: skip
            memory = []
            until = time.monotonic() + n / 30.0 + 120.0
            while process.poll() is None:
                if time.monotonic() > until:
                    process.kill()
                    pytest.fail(f"it does not end: {process.communicate()}")
                rows = out / ROWS
                if rows.exists() and rows.stat().st_size > 30 * 50:
                    memory.append(resident(process.pid) or memory[-1])
                time.sleep(0.2)
            said, complaints = process.communicate()
    finally:
        os.sched_setaffinity(0, before)
    assert process.returncode == 0, complaints
    answer = json.loads(said)
    kept = open_recording(out)
    if codec == "as-it-comes":  # what was sent, picture by picture, so that none is missing
        for k, (_, data) in enumerate(kept.jpegs()):
            assert zlib.crc32(data) == sent[k % len(sent)]
    assert answer["lost"] == 0
    assert abs(answer["frames"] - n) <= 1  # arrival decides which is the last one before the limit
    return answer | {"memory_MB": memory}


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs Linux")
def test_three_seconds_without_a_lost_frame(tmp_path: Path) -> None:
    found = long_run(tmp_path, 90, (320, 240), "as-it-comes", 30)
    assert found["problems"] == [] or "gap" in found["problems"][0]


@pytest.mark.soak
@pytest.mark.parametrize("codec", ["as-it-comes", "near"])
def test_ten_minutes_without_a_lost_frame(tmp_path: Path, codec: str) -> None:
    found = long_run(tmp_path, 18_000, (1280, 720), codec, 300)
    memory = found.pop("memory_MB")
    early, late = memory[len(memory) // 60], memory[-2]
    print(f"\n{found}\nmemory {early:.1f} MB after ten seconds, {late:.1f} MB at the end")
    assert late < early + 20.0
