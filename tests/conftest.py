"""Shared by all tests: a quiet Matplotlib, Hypothesis profiles, and real data if there is any."""

import atexit
import contextlib
import functools
import gc
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

os.environ.setdefault("MPLBACKEND", "Agg")
# Several processes run tests. Threads of linear algebra would wait for each other, up to ten times
# as long as one alone computes.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Tests neither use nor change the list of trusted programs of the person who runs them.
os.environ["XDG_CONFIG_HOME"] = tempfile.mkdtemp(prefix="fixel-settings-")
atexit.register(shutil.rmtree, os.environ["XDG_CONFIG_HOME"], ignore_errors=True)

# Shells start what runs in the background with Ctrl-C ignored; then no test of it could pass.
signal.signal(signal.SIGINT, signal.default_int_handler)

REPOSITORY = Path(__file__).resolve().parents[1]

# Compilation makes the first example slow, so no deadline; the same examples every time, so that
# a red test is red for everybody. `make soak` looks for new ones.
_SLOW_EXAMPLES = [HealthCheck.too_slow]
settings.register_profile(
    "default",
    max_examples=50,
    deadline=None,
    derandomize=True,
    suppress_health_check=_SLOW_EXAMPLES,
)
settings.register_profile("ci", parent=settings.get_profile("default"), print_blob=True)
settings.register_profile(
    "soak",
    deadline=None,
    derandomize=False,
    max_examples=5000,
    print_blob=True,
    suppress_health_check=_SLOW_EXAMPLES,
)
settings.load_profile(
    os.environ.get("HYPOTHESIS_PROFILE") or ("ci" if os.environ.get("CI") else "default")
)


# Files of emulated devices and idle connections, whose tests mostly wait: one process runs them
# while the others compute.
_WAITING = ("tests/contracts/test_actuators.py", "tests/testbed/test_motion_grbl.py",
            "tests/testbed/test_frame_source.py", "tests/web/test_serve.py")  # fmt: skip

# Files that compile or wait for browsers and processes, and take longest. Short ones come last.
_FIRST = (
    ("kernels/", "modes/", *_WAITING),
    ("_browser", "benchmarks", "database", "docs", "jobs", "contracts", "workflows", "cli",
     "planning", "web/test_"),
    ("environments", "filtering", "simulation", "drawing", "parts", "vision", "uncertainty"),
)  # fmt: skip

# Files that one process runs: they compile the same code, once, or wait.
_TOGETHER = {
    "tests/kernels": ("tests/kernels/",),
    "tests/modes": ("tests/modes/", "tests/simulation/test_load_map.py"),
    "waiting": _WAITING,
}
_APART = (
    "tests/docs/test_pages.py",
    "tests/docs/test_docstrings.py",
    "tests/benchmarks/test_benchmarks.py",
    "tests/web/test_accessible_browser.py",
)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Import the files in another order in each process that runs all tests.

    Pytest rewrites the assertions of a file that is new, for 50 ms, and stores the result. In the
    same order, all processes would do so for every file at the same time.
    """
    own = getattr(session.config, "workerinput", None)
    if own is None or session.config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    files = sorted(REPOSITORY.glob("tests/**/test_*.py"))
    files = [file for file in files if not _without_chosen(file, session.config.option.markexpr)]
    for file in files[int(own["workerid"].removeprefix("gw")) :: own["workercount"]]:
        name = ".".join(file.relative_to(REPOSITORY).with_suffix("").parts)
        with contextlib.suppress(Exception, pytest.skip.Exception):  # collecting it reports why
            import_module(name)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file that the marks leave out as a whole, where no file is named."""
    if config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return None
    return _without_chosen(collection_path, config.option.markexpr) or None


def _without_chosen(file: Path, chosen: str) -> bool:
    """Whether the marks leave out a file: one of whole systems, where these are left out."""
    if not (file.name.startswith("test_") and chosen.startswith("not system and")):
        return False
    text = file.read_text(encoding="utf-8")
    return bool(re.search(r"^pytestmark = (?:\[)?pytest\.mark\.system\b", text, re.MULTILINE))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put long files first: one that starts last leaves all other processes idle."""

    def rank(item: pytest.Item) -> int:
        file = item.nodeid.split("::")[0]
        ranks = (k for k, words in enumerate(_FIRST) if any(word in file for word in words))
        return next(ranks, len(_FIRST))

    items.sort(key=rank)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Run files that compile the same in one process, and long files whose tests share nothing in
    several."""
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            if file in _APART:
                return nodeid
            found = (name for name, files in _TOGETHER.items() if file.startswith(files))
            return next(found, file)

    return Scheduling(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_collection_finish() -> None:
    """Exempt what collecting created from garbage collection, and collect more rarely afterwards.

    The former is a tenth of the time of all tests, the latter another thirtieth.
    """
    from fixel.kernels import jit

    jit.PATIENCE_S = math.inf  # output must not depend on what is compiled already
    gc.freeze()
    gc.set_threshold(20_000)


# Tests that look at figures, by words in their names and those of their files.
_LAID_OUT = ("/drawing/", "/reproductions/", "figure", "picture", "chart", "drawn", "animated",
             "film", "demo")  # fmt: skip
# And the one that makes the figures of every capability.
_RENDERED = (*_LAID_OUT, "test_a_stored_result_prints_the_same_text_in_a_new_process")


@pytest.fixture(scope="session", autouse=True)
def full_style() -> dict[str, object]:
    """Save pictures with few pixels and without embedded fonts; lay figures out and render them
    only where tests look at them. Elsewhere, files of figures are empty pages.

    Returns the style that users get.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    from fixel.drawing import palette

    full = dict(palette.STYLE)
    palette.STYLE.update({"savefig.dpi": 60, "pdf.fonttype": 3})

    def only_in(words: Sequence[str], call: Callable[..., None]) -> Callable[..., None]:
        def called(*arguments: object) -> None:
            test = os.environ.get("PYTEST_CURRENT_TEST", "")
            if any(word in test for word in words):
                call(*arguments)

        return called

    ConstrainedLayoutEngine.execute = only_in(_LAID_OUT, ConstrainedLayoutEngine.execute)
    Figure.draw_without_rendering = only_in(_LAID_OUT, Figure.draw_without_rendering)
    Figure.draw = only_in(_RENDERED, Figure.draw)
    return full


@pytest.fixture(scope="session", autouse=True)
def nothing_awaits_the_disk() -> None:
    """Leave it to the system when it writes files to the disk: only a power cut would lose them.

    The system keeps what a killed process has written. Databases of 50 tests wait for a disk
    3,000 times.
    """
    from sqlalchemy import event
    from sqlalchemy.dialects.sqlite.base import SQLiteDialect
    from sqlalchemy.util import LRUCache

    from fixel.database import engine

    os.fsync = lambda descriptor: None
    open_file, statements = engine._sqlite, LRUCache(10_000)
    # Statements are compiled once for all files, not for each: equal dialects compile alike.
    SQLiteDialect.__eq__ = lambda own, other: type(own) is type(other)
    SQLiteDialect.__hash__ = lambda own: hash(type(own))

    def opened(url: object) -> object:
        made = open_file(url)
        event.listen(made, "connect", lambda raw, _: raw.execute("PRAGMA synchronous = OFF"))
        made._compiled_cache = statements
        return made

    engine._sqlite = opened


@pytest.fixture(scope="session", autouse=True)
def one_migration() -> None:
    """Run the migrations of an empty SQLite file once in a process: other new projects repeat their
    statements. Tests of databases run the migrations each time.
    """
    from fixel.database import engine, schema

    upgrade, lock = schema.upgrade, threading.Lock()

    @functools.cache
    def statements() -> list[str]:
        made = engine.open_engine("sqlite://")
        with engine.writing(made) as connection:
            upgrade(connection)
            raw = connection.connection.dbapi_connection
            found = raw.execute("SELECT sql FROM sqlite_master WHERE sql NOT NULL ORDER BY rowid")
            done = [sql for (sql,) in found]
            done.append(f"INSERT INTO alembic_version VALUES ('{schema.newest()}')")
        made.dispose()
        return done

    def upgraded(connection: Any, version: str = "head") -> None:
        usual = version == "head" and connection.dialect.name == "sqlite"
        tested = "tests/database/" in os.environ.get("PYTEST_CURRENT_TEST", "")
        raw = connection.connection.dbapi_connection
        if tested or not usual or raw.execute("SELECT 1 FROM sqlite_master").fetchone():
            upgrade(connection, version)
            return
        with lock:  # two threads may create the first two projects
            repeated = statements()
        for statement in repeated:
            raw.execute(statement)

    schema.upgrade = upgraded


@pytest.fixture(scope="session", autouse=True)
def one_command_tree() -> None:
    """Build the commands of the program once: each call would build them again."""
    import typer.main
    import typer.testing

    from fixel.cli import main

    build = functools.cache(typer.main.get_command)
    typer.main.get_command = typer.testing._get_command = build
    make = main.program_of
    # A test may replace a command; its program keeps it, so no other one gets its id.
    made = functools.cache(lambda commands: make(name for name, _ in commands))
    main.program_of = lambda names: made(tuple((one, id(main.COMMANDS[one])) for one in names))


@pytest.fixture(scope="module")
def few_live() -> Iterator[None]:
    """Find posteriors with few live points, where no test asks how good they are."""
    from fixel.uncertainty import posterior

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(posterior, "MIN_LIVE", 30)
        yield


@pytest.fixture(scope="module")
def small_laboratory() -> Iterator[None]:
    """Render the pictures of an emulated laboratory with half the usual number of pixels."""
    from fixel.workflows.bench import devices

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(devices, "SMALLER", 0.5)
        yield


# Compile the engine, then the parts of the plain loop.
_COMPILE = """
from fixel.simulation import Simulator, simulate
from fixel.testing.scenes import grasp
Simulator(grasp()).ends(duration=1e-6)
print("compiled", flush=True)
simulate(grasp(), duration=1e-6, plain=True)
"""


class Compilation:
    """Compilation of the engine by one process, while the others collect.

    Processes that find it missing would all compile it, each in a minute.
    """

    def pytest_sessionstart(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", _COMPILE], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self.compiled = b""

    def pytest_xdist_node_collection_finished(self) -> None:
        """Wait for the engine: the tests begin afterwards."""
        self.compiled = self.compiled or self.process.stdout.readline()

    def pytest_sessionfinish(self) -> None:
        self.process.kill()
        self.process.communicate()


def pytest_configure(config: pytest.Config) -> None:
    """Have one process compile if several run tests."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Compilation())


@pytest.fixture(autouse=True, scope="session")
def compiled_here() -> None:
    """Run no test as plain Python while code is compiled, except those of it."""
    from fixel.simulation import first_code

    first_code._settled = True


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of the real push data: `FIXEL_DATA`, else `shared/data` next to the repository."""
    named = os.environ.get("FIXEL_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(
            f"no real data at {folder}; set FIXEL_DATA to the folder that holds the datasets"
        )
    return folder
