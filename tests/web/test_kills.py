"""The server killed with -9 at random while it writes: every answered write is there, whole.

Three kills here, a hundred with: make soak PYTEST_ARGS=tests/web/test_kills.py
"""

import contextlib
import http.client
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections import Counter

import pytest
from tests.jobs.helpers import await_true
from tests.processes import line_of

from fixel.database.project import Project

pytestmark = pytest.mark.system

ALL = list(range(1, 31))
MARKED, DELETED = ALL[10:], ALL[:10]  # so that the acts of one writer do not meet another's


class Mortal:
    """A server in a process of its own, again and again."""

    def __init__(self, folder):
        self._mother = subprocess.Popen(
            [sys.executable, "-m", "tests.web.mortal", str(folder)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip

    def born(self):
        self._mother.stdin.write("\n")
        self._mother.stdin.flush()
        said = json.loads(line_of(self._mother))
        self.pid, self.port, self.token = said["pid"], said["port"], said["token"]

    def kill(self):
        os.kill(self.pid, signal.SIGKILL)
        assert line_of(self._mother) == "dead\n"

    def close(self):
        self._mother.stdin.close()
        self._mother.wait(60)
        self._mother.stdout.close()


class Writer(threading.Thread):
    """Acts on a server until it dies; knows what was promised and what was only asked for."""

    def __init__(self, server, act, number):
        super().__init__(daemon=True)
        self.server, self.act, self.number = server, act, number
        self.promised, self.asked = [], None

    def run(self):
        connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=60)
        headers = {
            "Authorization": f"Bearer {self.server.token}",
            "Content-Type": "application/json",
        }
        with (
            contextlib.suppress(OSError, http.client.HTTPException),
            contextlib.closing(connection),
        ):
            for k in range(100_000):
                path, body, word = self.act(self.number * 100_000 + k)
                self.asked = word
                connection.request("POST", f"/api/v1{path}", json.dumps(body), headers)
                answer = connection.getresponse()
                answer.read()
                assert answer.status == 200, (path, answer.status)
                self.promised.append(word)


def noting(k):
    return "/experiments/note", {"ids": MARKED, "text": f"note {k}"}, f"note {k}"


def flagging(k):
    return "/experiments/flag", {"ids": MARKED, "name": f"odd-{k}"}, f"odd-{k}"


def deleting(k):
    return f"/experiments/{'undelete' if k % 2 else 'delete'}", {"ids": DELETED}, k % 2


def keeping(k):
    value = 0.2 + 1e-8 * k
    body = {"parameters": {"mu_support": value}}
    return f"/experiments/{MARKED[0]}/simulations", body, value


def storm(folder, kills, seed, first=1):
    """Kill the server repeatedly, and check all records after each kill; `first` is its number."""
    chance = random.Random(seed)
    server, values = Mortal(folder), Counter()
    try:
        for number in range(first, first + kills):
            server.born()
            acts = (noting, flagging, deleting, keeping)
            writers = [Writer(server, act, number) for act in acts]
            for writer in writers:
                writer.start()
            await_true(lambda own=writers[:3]: all(writer.promised for writer in own))
            time.sleep(chance.uniform(0.0, 0.4))
            server.kill()
            for writer in writers:
                writer.join(60)
                values[writer.act.__name__] += len(writer.promised)
            _whole(folder, *writers)
    finally:
        server.close()
    return values


def _whole(folder, notes, flags, deletions, simulations):
    assert Project(folder).check().troubles == ()
    file = f"file:{folder / 'experiments.db'}?mode=ro"
    with contextlib.closing(sqlite3.connect(file, uri=True)) as records:
        for column, table, writer in (("text", "note", notes), ("name", "flag", flags)):
            counts = records.execute(f"SELECT {column}, count(*) FROM {table} GROUP BY {column}")
            _all_or_none(Counter(dict(counts)), writer)
        wanted = f"id IN ({','.join(map(str, DELETED))}) AND deleted_at_utc IS NOT NULL"
        gone = records.execute(f"SELECT count(*) FROM experiment WHERE {wanted}").fetchone()[0]
        assert gone in (0, len(DELETED))
        if deletions.promised and deletions.asked == deletions.promised[-1]:
            assert gone == (0 if deletions.asked else len(DELETED))
        used = (
            "SELECT p.mu_support FROM simulation s"
            " JOIN system_parameters p ON p.id = s.system_parameters_id"
        )
        stored = Counter(row[0] for row in records.execute(used))
        assert [stored[value] for value in simulations.promised] == [1] * len(simulations.promised)
        assert stored[simulations.asked] in (0, 1)


def _all_or_none(counts, writer):
    for word in writer.promised:
        assert counts[word] == len(MARKED), word
    assert counts[writer.asked] in (0, len(MARKED)), writer.asked


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_three_kills(project):
    values = storm(project, kills=3, seed=0)
    assert min(values[act.__name__] for act in (noting, flagging, deleting)) >= 3


@pytest.mark.soak
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_hundred_kills(project):
    print(storm(project, kills=100, seed=int(time.time()), first=4))
