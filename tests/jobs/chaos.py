"""Kill -9 at random times: workers, the scheduler, the coordinator; then see what is left."""

import random
import time

from tests.jobs.helpers import PATIENCE_S, kill, names_in, processes, start

from fixel.jobs import folder as files

KINDS = ("worker", "scheduler", "coordinator")


def storm_at_random(folder, n):
    """A storm of so many kills of random kinds; all of them are found a victim."""
    generator = random.Random(n)
    assert storm(folder, [generator.choice(KINDS) for _ in range(n)], seed=n) == n


def storm(folder, kinds, seed, between_s=(0.0, 1.0)):
    """Run a job to its end while its processes are killed in this order; how many were.

    Most are killed while answers come in, the others at any time, while they start for example.
    """
    generator = random.Random(seed)
    coordinator = start(folder)
    known, kills = set(), 0
    try:
        for kind in kinds:
            if generator.random() < 0.7:
                _await_progress(folder, len(known), coordinator)
            time.sleep(generator.uniform(*between_s))
            victims = _victims(folder, kind, coordinator)
            if coordinator.poll() is None:
                kills += kill(generator.choice(victims)) if victims else 0
            known = _nothing_lost(folder, known)
            if kind == "coordinator":
                coordinator.wait(PATIENCE_S)
            if coordinator.poll() is not None:
                if coordinator.returncode == 0:
                    return kills
                coordinator = start(folder)
        while coordinator.poll() is None:
            # As long as answers come; how long the rest takes is the work's own affair.
            known = _nothing_lost(folder, known)
            _await_progress(folder, len(known), coordinator)
        assert coordinator.returncode == 0, (folder / "log.txt").read_text()
    finally:
        if coordinator.poll() is None:
            coordinator.kill()
            coordinator.wait()
    _nothing_lost(folder, known)
    return kills


def _victims(folder, kind, coordinator):
    """Processes to choose from; those that are only just being started may be waited for."""
    deadline = time.monotonic() + 60.0
    while coordinator.poll() is None and time.monotonic() < deadline:
        found = processes(folder, kind)
        if found:
            return found
        time.sleep(0.02)
    return []


def _await_progress(folder, n_known, coordinator):
    """Wait for an answer more, or for the coordinator's end."""
    deadline = time.monotonic() + PATIENCE_S
    while coordinator.poll() is None and len(names_in(folder)) <= n_known:
        assert time.monotonic() < deadline, (folder / "log.txt").read_text()
        time.sleep(0.05)


def _nothing_lost(folder, known):
    """Names of the answers kept; large ones go once the result is written, not before."""
    names = set(names_in(folder))
    assert known <= names or (folder / files.RESULT).exists(), "a finished evaluation was lost"
    return known | names
