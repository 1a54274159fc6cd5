"""Shared by all tests: a quiet Matplotlib, Hypothesis profiles, and real data if there is any."""

import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

os.environ.setdefault("MPLBACKEND", "Agg")

# Shells start what runs in the background with Ctrl-C ignored; then no test of it could pass.
signal.signal(signal.SIGINT, signal.default_int_handler)

REPOSITORY = Path(__file__).resolve().parents[1]

# Compilation makes the first example slow, so no deadline; the same examples every time, so that
# a red test is red for everybody. `make soak` looks for new ones.
_SLOW_EXAMPLES = [HealthCheck.too_slow]
settings.register_profile(
    "default", deadline=None, derandomize=True, suppress_health_check=_SLOW_EXAMPLES
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


# Files that wait for browsers and processes, and take longest.
_FIRST = ("_browser", "benchmarks", "database", "docs", "jobs", "workflows", "cli")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put long files first: one that starts last leaves all other processes idle."""
    items.sort(key=lambda item: not any(word in item.nodeid.split("::")[0] for word in _FIRST))


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of the real push data: `FIXEL_DATA`, else `shared/data` beside the repository."""
    named = os.environ.get("FIXEL_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(
            f"no real data at {folder}; set FIXEL_DATA to the folder that holds the datasets"
        )
    return folder
