from pathlib import Path

import pytest

from fixel.testbed.emulators import bench as emulated_mega


@pytest.fixture(scope="session")
def mega_folder() -> Path:
    """Folder of the built firmware and its emulator."""
    reason = emulated_mega.why_not()
    if reason:
        pytest.skip(reason)
    return emulated_mega.built(emulated_mega.FIRMWARE / "build")


@pytest.fixture
def mega(mega_folder):
    with emulated_mega.EmulatedMega(mega_folder) as board:
        yield board
