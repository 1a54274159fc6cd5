"""Solved artefacts that tests share: made once for each state of the sources, and copied.

They are in `build/artefacts`, or in the folder that `FIXEL_ARTEFACTS` names. Those of other sources
are deleted after a day.
"""

import fcntl
import functools
import hashlib
import os
import shutil
import time
from pathlib import Path

DAY_S = 86400.0  # processes of a running test may use them
REPOSITORY = Path(__file__).resolve().parents[1]
# Artefacts depend on the package, on what it uses, and on the modules that make them.
SOURCES = (
    *sorted((REPOSITORY / "src").rglob("*.py")),
    REPOSITORY / "requirements" / "lock.txt",
    REPOSITORY / "tests" / "laboratories.py",
    REPOSITORY / "tests" / "workflows" / "growing.py",
)


@functools.cache
def store():
    """Folder of the artefacts of these sources."""
    digest = hashlib.sha256()
    for path in SOURCES:
        digest.update(str(path.relative_to(REPOSITORY)).encode() + b"\0" + path.read_bytes())
    root = Path(os.environ.get("FIXEL_ARTEFACTS", REPOSITORY / "build" / "artefacts"))
    folder = root / digest.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    for other in root.iterdir():
        if other != folder and time.time() - other.stat().st_mtime > DAY_S:
            shutil.rmtree(other, ignore_errors=True)
    return folder


def artefact(name, make):
    """Return the folder of an artefact, which nothing may change.

    Parameters
    ----------
    name : str
    make : callable
        Fills a folder `my_lab`, which does not exist yet. Other processes wait for it.
    """
    folder = store() / name
    with (store() / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.is_dir():
            unfinished = store() / f"{name}.unfinished"
            shutil.rmtree(unfinished, ignore_errors=True)
            unfinished.mkdir()
            make(unfinished / "my_lab")  # a project has the name of its first folder
            unfinished.rename(folder)
    return folder / "my_lab"


def copied(name, make, folder):
    """Copy an artefact into a new folder, which a test may change; return the folder."""
    return Path(shutil.copytree(artefact(name, make), folder))
