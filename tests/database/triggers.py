"""SQL past the triggers of a database, as a program other than fixel could run it."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

TRIGGERS = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"


@contextmanager
def without_triggers(file: Path) -> Iterator[sqlite3.Connection]:
    """Open a database without its triggers, which are there afterwards as far as their tables."""
    with closing(sqlite3.connect(file, isolation_level=None)) as raw:
        raw.execute("PRAGMA synchronous = OFF")
        triggers = raw.execute(TRIGGERS).fetchall()
        for name, _ in triggers:
            raw.execute(f'DROP TRIGGER "{name}"')
        yield raw
        tables = {name for (name,) in raw.execute("SELECT name FROM sqlite_master")}
        for name, text in triggers:
            if name.rpartition("_")[0] in tables:
                raw.execute(text)
