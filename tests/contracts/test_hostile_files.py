"""Files of strangers: each kind that fixel reads, damaged or made to hurt.

None may start a program, write outside its place, or end in anything but a sentence of fixel. The
interpreter's own audit events show programs and writes, whatever code is at work.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import logging
import os
import random
import shutil
import sqlite3
import sys
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.database.triggers import without_triggers
from tests.datasets.test_bag import TIME, matrices, part_at, two_topics, write_bag
from tests.fixtures import project_of, refused
from tests.formats.test_goal_file import FULL
from tests.formats.test_outline_file import dxf, slot, svg, trimesh

import fixel
from fixel import trust
from fixel.database.bundle import export_bundle, import_bundle
from fixel.database.project import Project
from fixel.errors import FixelError
from fixel.formats.goal_file import load_goal
from fixel.formats.plan_file import load_plan, plan_text
from fixel.io.array_bytes import ResultCache
from fixel.io.saved import save
from fixel.jobs.site import TEMPLATE, load_site
from fixel.kernels.code_cache import cache_folder
from fixel.sampling import thesis_plan
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import pushed_square
from fixel.workflows import jobs
from fixel.workflows.calibration.calibration import collect
from fixel.workflows.calibration.plan import plan_in
from fixel.workflows.calibration.stored import list_calibrations, load_values, stored_calibration
from fixel.workflows.planning.request import load_plan as load_saved_plan, load_trials

SPACE = {"mu_pusher": (0.0, 1.0), "tripod_radius": 0.038}
ENGINE = """
import json, pathlib, sys
pathlib.Path({mark!r}).write_text("started")
for line in sys.stdin:
    print(json.dumps({{"name": "evil", "version": "1", "failed": "it"}}), flush=True)
"""
STARTS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork")
WRITES = ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.truncate", "os.link", "os.symlink")
# The user's list of programs, and the compiled kernels; both are this user's.
ALLOWED = (os.environ["XDG_CONFIG_HOME"], str(cache_folder()), "/dev/null")
HOSTILE = [
    b"", b"nan", b"-1", b"1e308", b"inf", b"0", b"null", b'"', b",", b"\n", b"\x00", b"{}", b"[]",
    b"\xff\xfe", b"true", b"9" * 400, b"[[[[", b"99999999999999999999", b"1e-320", b"../../x",
    b"/bin/sh:-c,id", b'{"type": "path", "text": "/etc/passwd"}', b"fixel.io.lock:FileLock",
]  # fmt: skip


# --- what a file must not do ----------------------------------------------------------------------


class Watch:
    """Record of the programs that were started, and of the files outside a folder written."""

    def __init__(self) -> None:
        self.place: Path | None = None
        self.seen: list[str] = []
        sys.addaudithook(self._note)

    def _note(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.place is None:
            return
        if event in STARTS:
            self.seen.append(f"{event} {arguments[:2]}")
        elif event in WRITES or (event == "open" and self._writes(arguments)):
            path = arguments[0]
            if isinstance(path, str | bytes | os.PathLike):
                # Files of an open folder have names within it.
                opened = arguments[-1] if event in ("os.remove", "os.rmdir", "os.mkdir") else -1
                front = os.readlink(f"/proc/self/fd/{opened}") if opened > 2 else ""
                name = os.path.realpath(os.path.join(front, os.fsdecode(path)))
                # Python writes bytecode of a module that nothing has imported yet.
                own = name.startswith((str(self.place), *ALLOWED)) or "/__pycache__/" in f"{name}/"
                if not own:
                    self.seen.append(f"{event} {name}")

    @staticmethod
    def _writes(arguments: tuple[Any, ...]) -> bool:
        mode, flags = arguments[1], arguments[2]
        write = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
        by_flags = isinstance(flags, int) and bool(flags & write)
        return by_flags or (isinstance(mode, str) and any(sign in mode for sign in "wax+"))


@pytest.fixture(scope="module")
def watch() -> Watch:
    return Watch()


@pytest.fixture
def place(watch: Watch, tmp_path: Path) -> Iterator[Path]:
    """Folder outside which nothing may be written, while no program may be started."""
    watch.seen.clear()
    watch.place = tmp_path.resolve()
    yield tmp_path
    watch.place = None
    assert watch.seen == []


# --- the kinds of files ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with a calibration, the job of it, a bundle, a saved result and a saved plan."""
    folder = tmp_path_factory.mktemp("whole")
    project = project_of(folder / "lab", example_pushes(2, duration=0.3))
    options: dict[str, Any] = {"verdicts": False, "max_evaluations": 8, "progress": False}
    pushes = project.experiments()
    fit = fixel.calibrate(pushes, SPACE, motion="quasistatic", store=project, **options)
    with project.store() as store:
        export_bundle(store, folder / "bundle.zip")
    with contextlib.closing(sqlite3.connect(folder / "lab" / "experiments.db")) as raw:
        raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    (job,) = (folder / "lab" / "jobs").iterdir()
    jobs.pack(job, folder / "job.zip")
    fit.save(folder / "fit.fixel")
    goal = fixel.PoseRegion((0.02, 0.0, 0.0), position=0.009)
    fixel.plan(pushed_square(), goal, rollouts=1_000, progress=False).save(folder / "push.plan")
    pushed_square().save(folder / "scene.yaml")
    (folder / "scene.json").write_text(
        json.dumps({"fixel": 1, "motion": "dynamic", **_scene_content()})
    )
    (folder / "goal.yaml").write_text(FULL)
    (folder / "plan.yaml").write_text(plan_text(thesis_plan()))
    (folder / "site.yaml").write_text(TEMPLATE)
    rows = [f"{0.1 * k},{10 * k},0,{k},{10 * k - 40},0,1.5\n" for k in range(12)]
    head = "time_s,x_mm,y_mm,theta_deg,pusher_x_mm,pusher_y_mm,fx_n\n"
    (folder / "table.csv").write_text(head + "".join(rows))
    ResultCache(folder).get("cache", 1, lambda: {"value": 0.5, "table": [[1.0, 2.0]]})
    write_field_files(folder)
    entry = {"command": ["/opt/sim/run", "fast"], "sha256": {}}
    (folder / "trusted.json").write_text(json.dumps(entry))
    return folder


def write_field_files(folder: Path) -> None:
    """Write drawings, meshes and recordings with libraries of these kinds."""
    bend = "M 10 10 h 40 a 5 5 0 0 1 5 5 v 20 c 0 5 -5 5 -10 5 h -35 z"
    svg(folder / "part.svg", f'<path d="{bend}"/>')
    dxf(folder / "part.dxf", slot)
    box = trimesh.creation.box((0.04, 0.03, 0.01))
    box.export(folder / "part.stl")
    box.export(folder / "text.stl", file_type="stl_ascii")
    write_bag(folder / "bag", two_topics())
    (mcap,) = write_bag(folder / "other", two_topics(), "mcap").glob("*.mcap")
    shutil.copyfile(mcap, folder / "push.mcap")
    log = [
        {"time_s": t, "tag_id": 3, "pose_t": m[:3, 3].tolist(), "pose_R": m[:3, :3].tolist()}
        for t, m in zip(TIME.tolist(), matrices(part_at(TIME)), strict=True)
    ]
    (folder / "tags.jsonl").write_text("\n".join(map(json.dumps, log)))


def _scene_content() -> dict[str, Any]:
    from fixel.formats.scene_file import scene_content

    return scene_content(pushed_square())


def read_bundle(file: Path) -> None:
    project = Project(file.parent / "target")
    with project.store() as store:
        import_bundle(file, store)
    read_project(project.folder)


def read_project(folder: Path) -> None:
    """Open a project, and print what it has stored."""
    project = Project(folder)
    str(list_calibrations(project))
    str(project.experiments())
    with project.store() as store:
        ids = [*store.calibration_summaries()]
        for key in ("1", "2"):
            str(store.experiment(store.find(key)))
    for number in ids:
        str(stored_calibration(project, number))


def read_job(file: Path) -> None:
    """Unpack a job, print it, and load what it computed."""
    folder = file.parent / "unpacked"
    try:
        str(jobs.unpack(file, folder).summary())
        list(jobs.log_lines(folder))
        str(plan_in(folder).request)
        str(collect(plan_in(folder), folder)[0])
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def read_trusted(file: Path) -> None:
    """Read a list of trusted programs with this entry in it."""
    trust.list_folder().mkdir(parents=True, exist_ok=True)
    entry = trust.list_folder() / "0123.json"
    shutil.copyfile(file, entry)
    try:
        for own in trust.trusted_entries():
            str(own.lines)
    finally:
        entry.unlink()


def read_cache(file: Path) -> None:
    assert isinstance(ResultCache(file.parent).get("cache", 1, lambda: {"value": 1.0}), dict)


def read_drawing(file: Path) -> None:
    repr(fixel.Polygon.from_file(file, unit="m" if file.suffix == ".stl" else None))


def read_recording(file: Path) -> None:
    columns = {} if file.suffix == ".jsonl" else {"part": "/part", "pusher": "/tip"}
    str(fixel.read_experiments(file, columns=columns, progress=False))


@dataclass(frozen=True)
class Kind:
    """Name of a valid file in the laboratory, and the function that reads it."""

    file: str
    read: Callable[[Path], object]
    folder: bool = False


KINDS = {
    "scene": Kind("scene.yaml", lambda path: repr(fixel.load_scene(path))),
    "scene as JSON": Kind("scene.json", lambda path: repr(fixel.load_scene(path))),
    "goal": Kind("goal.yaml", lambda path: repr(load_goal(path))),
    "plan": Kind("plan.yaml", lambda path: repr(load_plan(path))),
    "site": Kind("site.yaml", lambda path: repr(load_site(path))),
    "table": Kind("table.csv", lambda path: str(fixel.read_experiments(path, progress=False))),
    "drawing in SVG": Kind("part.svg", read_drawing),
    "drawing in DXF": Kind("part.dxf", read_drawing),
    "mesh": Kind("part.stl", read_drawing),
    "mesh as text": Kind("text.stl", read_drawing),
    "MCAP": Kind("push.mcap", read_recording),
    "bag": Kind("bag", read_recording, folder=True),
    "tags": Kind("tags.jsonl", read_recording),
    "bundle": Kind("bundle.zip", read_bundle),
    "project": Kind("lab", read_project, folder=True),
    "job": Kind("job.zip", read_job),
    "saved result": Kind("fit.fixel", lambda path: repr(fixel.load(path))),
    "saved plan": Kind("push.plan", lambda path: load_trials(path, load_saved_plan(path))),
    "trusted program": Kind("trusted.json", read_trusted),
    "result cache": Kind("cache.json", read_cache),
}
kinds = pytest.mark.parametrize("name", KINDS)
# Drawings and recordings that unpack to gigabytes are tested with their readers.
NESTED = (".yaml", ".json", ".csv", ".zip", ".fixel", ".plan")


def copied(lab: Path, kind: Kind, place: Path) -> Path:
    """Copy a valid file, with an empty project next to it for what is imported."""
    if kind.read is read_bundle and not (place / "target").exists():
        Project.create(place / "target")
    target = place / kind.file
    if kind.folder:
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(lab / kind.file, target)
    else:
        shutil.copyfile(lab / kind.file, target)
    return target


@kinds
def test_the_valid_file_is_read(name: str, lab: Path, place: Path) -> None:
    KINDS[name].read(copied(lab, KINDS[name], place))


# --- random changes -------------------------------------------------------------------------------


def mutated(content: bytes, rng: random.Random) -> bytes:
    """Cut the content, change a byte, or put something else in place of a value."""
    if not content:
        return rng.choice(HOSTILE)
    at, choice = rng.randrange(len(content)), rng.random()
    if choice < 0.15:
        return content[:at]
    if choice < 0.4:
        return content[:at] + bytes([rng.randrange(256)]) + content[at + 1 :]
    end = next((k for k in range(at, min(len(content), at + 500)) if content[k] in b",\n]}"), at)
    return content[:at] + rng.choice(HOSTILE) + content[end:]


def mutate(path: Path, rng: random.Random) -> None:
    """Change one file: in a folder any, in a zip mostly one member with its new checksum."""
    if path.is_dir():
        files = [own for own in path.rglob("*") if own.is_file()]
        return mutate(rng.choice(sorted(files)), rng)
    if not zipfile.is_zipfile(path) or rng.random() < 0.3:
        path.write_bytes(mutated(path.read_bytes(), rng))
        return None
    with zipfile.ZipFile(path) as file:
        members = {info.filename: file.read(info) for info in file.infolist()}
    changed = rng.choice(sorted(members))
    if rng.random() < 0.05:
        members["../../../escaped"] = members.pop(changed)
    else:
        members[changed] = mutated(members[changed], rng)
    _resealed(members)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for own, content in members.items():
            file.writestr(own, content)
    return None


def _resealed(members: dict[str, bytes]) -> None:
    """Correct the checksum of a job's inputs, as a stranger would."""
    with contextlib.suppress(ValueError, KeyError, TypeError):
        job = json.loads(members["job.json"])
        digest = hashlib.sha256()
        for own in sorted(own for own in members if own.startswith("inputs/")):
            content = hashlib.sha256(members[own]).hexdigest()
            digest.update(f"{own.removeprefix('inputs/')}\0{content}\0".encode())
        job["inputs_sha256"] = digest.hexdigest()
        members["job.json"] = json.dumps(job).encode()


def attack(name: str, lab: Path, place: Path, n: int) -> dict[str, int]:
    """Read a file with random changes n times; return how often it was read and refused."""
    kind, rng, tally = KINDS[name], random.Random(name), {"read": 0, "refused": 0}
    for k in range(n):
        path = copied(lab, kind, place)
        mutate(path, rng)
        try:
            kind.read(path)
            tally["read"] += 1
        except FixelError:
            tally["refused"] += 1
        except BaseException:
            print(f"change {k} of {name!r}")
            raise
    return tally


@kinds
def test_changed_files_are_read_or_refused(
    name: str,
    lab: Path,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Changed files are read or refused, and nothing that a parser logs reaches the terminal."""
    with monkeypatch.context() as terminal:
        terminal.setattr(logging.getLogger(), "handlers", [])
        tally = attack(name, lab, place, 40)
    assert capsys.readouterr().err == ""
    assert tally["refused"] > 0 or name in ("trusted program", "result cache")


@pytest.mark.soak
@kinds
def test_ten_thousand_changed_files(name: str, lab: Path, place: Path) -> None:
    n = int(os.environ.get("FIXEL_CHANGES", "10000"))
    print(name, attack(name, lab, place, n))


# --- a program that a file names ------------------------------------------------------------------


@pytest.fixture
def engine(tmp_path: Path) -> str:
    """Engine name of a program that leaves a mark when it starts."""
    program = tmp_path / "evil.py"
    program.write_text(ENGINE.format(mark=str(tmp_path / "mark")))
    return str(program)


def refused_as_program(call: Callable[[], object], engine: str) -> None:
    """Check that a call is refused with the path of the program and the command that allows it."""
    with pytest.raises(FixelError, match="fixel trust") as refusal:
        call()
    assert engine in str(refusal.value)
    assert "\n" not in str(refusal.value)


def with_engine(database: Path, engine: str) -> None:
    """Change the engine of the stored calibrations, as a stranger would."""
    with_content(database, "method", lambda own: json.dumps(own | {"motion": engine, "job": ""}))
    with_content(database, "request", lambda own: json.dumps(own | {"motion": engine}))


def with_content(database: Path, column: str, change: Callable[[dict[str, Any]], str]) -> None:
    """Change a JSON column of the stored calibrations behind the triggers."""
    with without_triggers(database) as raw:
        for number, own in raw.execute(f"SELECT id, {column} FROM calibration").fetchall():
            changed = change(json.loads(own))
            raw.execute(f"UPDATE calibration SET {column} = ? WHERE id = ?", (changed, number))
        raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def compare_stored(folder: Path) -> object:
    """Compare an experiment with the stored calibration, as `fixel compare --calibration` does."""
    project = Project(folder)
    with project.store() as store:
        return fixel.compare(store.experiment(1), load_values(store, 1), progress=False)


def test_a_project_prints_and_refuses_only_to_simulate(lab: Path, place: Path, engine: str) -> None:
    folder = copied(lab, KINDS["project"], place)
    shutil.rmtree(folder / "jobs")
    with_engine(folder / "experiments.db", engine)
    read_project(folder)
    assert "evil.py" in str(stored_calibration(Project(folder), 1))
    refused_as_program(lambda: compare_stored(folder), engine)


def test_a_bundle_is_imported_and_refuses_only_to_simulate(
    lab: Path, place: Path, engine: str
) -> None:
    with zipfile.ZipFile(lab / "bundle.zip") as file:
        file.extractall(place / "open")
    with_engine(place / "open" / "experiments.db", engine)
    with zipfile.ZipFile(place / "bundle.zip", "w") as file:
        file.write(place / "open" / "experiments.db", "experiments.db")
    Project.create(place / "target")
    read_bundle(place / "bundle.zip")
    refused_as_program(lambda: compare_stored(place / "target"), engine)


@pytest.mark.parametrize("name", ["/dev/zero", "../../thesis.txt", "ab/../../thesis.txt"])
def test_a_series_is_no_other_file(name: str, lab: Path, place: Path) -> None:
    """A media file is named by its checksum, also in a project that was copied as a folder."""
    folder = copied(lab, KINDS["project"], place)
    (place / "thesis.txt").write_text("ten pages")
    with without_triggers(folder / "experiments.db") as raw:
        raw.execute("UPDATE series SET data = NULL, media_sha256 = ?", (name,))
    with Project(folder).store() as store, pytest.raises(FixelError, match="no checksum"):
        store.experiment(1)


@pytest.mark.parametrize("scheme", ["sqlite", "SQLite", "sqlite+pysqlite"])
def test_settings_create_no_file_outside_the_project(scheme: str, lab: Path, place: Path) -> None:
    folder = copied(lab, KINDS["project"], place)
    outside = place / "outside.db"
    (folder / "fixel.yaml").write_text(f"name: lab\ndatabase: {scheme}:///{outside}\n")
    refused(read_project, folder, match="database: found")
    assert not outside.exists()


def test_a_packed_job_is_not_resumed(lab: Path, place: Path, engine: str) -> None:
    with zipfile.ZipFile(lab / "job.zip") as file:
        members = {info.filename: file.read(info) for info in file.infolist()}
    request = json.loads(members["inputs/request.json"])
    members["inputs/request.json"] = json.dumps(request | {"motion": engine}).encode()
    members = {k: v for k, v in members.items() if k not in ("journal", "result", "state.json")}
    _resealed(members)
    with zipfile.ZipFile(place / "job.zip", "w") as file:
        for name, content in members.items():
            file.writestr(name, content)
    assert jobs.unpack(place / "job.zip", place / "job").can_resume
    refused_as_program(lambda: jobs.run_here(place / "job"), engine)
    assert "fixel trust" in jobs.status_of(place / "job").reason


def test_a_saved_result_is_loaded_and_refuses_only_to_simulate(
    lab: Path, place: Path, engine: str
) -> None:
    path = place / "fit.fixel"
    with zipfile.ZipFile(lab / "fit.fixel") as file:
        members = {info.filename: file.read(info) for info in file.infolist()}
    text = members["result.json"].decode()
    assert '"quasistatic"' in text
    members["result.json"] = text.replace('"quasistatic"', json.dumps(engine)).encode()
    with zipfile.ZipFile(path, "w") as file:
        for name, content in members.items():
            file.writestr(name, content)
    fit = fixel.load(path)
    assert "mu_pusher" in str(fit)
    push = example_pushes(1, duration=0.3)[0]
    refused_as_program(lambda: fixel.compare(push, fit, progress=False), engine)
    refused_as_program(lambda: fit.simulate(push), engine)


def test_an_object_of_another_class_is_not_built(place: Path) -> None:
    victim = place / "thesis.txt"
    victim.write_text("ten pages\n")
    items = [["path", {"type": "path", "text": str(victim)}], ["what", "x"]]
    for name in ("fixel.io.lock:FileLock", "fixel.io.array_bytes:ResultCache", "fixel:Project"):
        head = {"fixel": "1", "format": 1, "kind": "Disk"}
        head["content"] = {"type": "object", "class": name, "items": items}  # type: ignore[assignment]
        with zipfile.ZipFile(place / "disk.fixel", "w") as file:
            file.writestr("result.json", json.dumps(head))
        refused(fixel.load, place / "disk.fixel", match="a result saved by fixel")
    assert victim.read_text() == "ten pages\n"


@pytest.mark.parametrize("name", ["scene", "scene as JSON", "goal", "plan", "site"])
def test_a_text_file_cannot_name_a_program(name: str, lab: Path, place: Path, engine: str) -> None:
    path = copied(lab, KINDS[name], place)
    text = path.read_text()
    if path.suffix == ".json":
        text = text.replace('"dynamic"', json.dumps(engine))
    else:
        lines = [line for line in text.splitlines() if not line.startswith("motion:")]
        text = "\n".join([*lines, f"motion: {engine}", ""])
    path.write_text(text)
    refused(KINDS[name].read, path, match="motion")


def test_an_entry_of_the_list_counts_by_its_content(lab: Path, place: Path, engine: str) -> None:
    """A file with another name, or for another content, permits nothing."""
    own = trust.trust_program(engine)
    Path(engine).write_text("print('another')")
    refused_as_program(lambda: trust.check_command((engine,)), engine)
    shutil.copyfile(own.file, own.file.with_name("other.json"))
    refused_as_program(lambda: trust.check_command((engine,)), engine)
    own.file.with_name("other.json").unlink()
    own.file.unlink()


# --- bombs and deep nesting -----------------------------------------------------------------------

DEEP = 100_000


def deep(path: Path) -> None:
    """Replace the text of a file, or of the members of a zip, by deeply nested lists."""
    if path.suffix in (".yaml", ".json", ".csv"):
        path.write_text("a: " * (path.suffix == ".yaml") + "[" * DEEP + "]" * DEEP)
        return
    with zipfile.ZipFile(path) as file:
        members = {info.filename: file.read(info) for info in file.infolist()}
    nested = b'{"fixel": "1", "format": 1, "content": ' + b"[" * DEEP + b"]" * DEEP + b"}"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name, nested if name.endswith(".json") else content)


def bomb(path: Path) -> None:
    """Make the file unpack to 100 MB, or expand to gigabytes."""
    if path.suffix == ".yaml":
        levels = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
        path.write_text("\n".join(["a0: &a0 [x, x]", *levels]))
    elif path.suffix in (".json", ".csv"):
        path.write_text("[" + "1," * 6_000_000 + "1]")
    else:
        with zipfile.ZipFile(path) as file:
            members = {info.filename: file.read(info) for info in file.infolist()}
        largest = max(members, key=lambda name: len(members[name]))
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            for name, content in members.items():
                with file.open(name, "w", force_zip64=True) as stream:
                    stream.write(content)
                    for _ in range(100 if name == largest else 0):
                        stream.write(bytes(1_000_000))


def peak(call: Callable[[], object]) -> float:
    """Return the memory that a call allocates at most [bytes]."""
    tracemalloc.start()
    with contextlib.suppress(FixelError):
        call()
    found = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return found


def odd_methods() -> dict[str, Callable[[dict[str, Any]], str]]:
    """Return changes of a stored calibration: deep, another kind of value, another folder."""
    return {
        "deep": lambda method: "[" * DEEP + "]" * DEEP,
        "deep inside": lambda m: json.dumps(m | {"unknowns": "[" * DEEP + "]" * DEEP}),
        "another kind": lambda m: json.dumps(m | {"unknowns": '[{"name": 3}]', "job": ""}),
        "no JSON": lambda m: json.dumps(m | {"unknowns": "{", "job": ""}),
        "another folder": lambda m: json.dumps(m | {"job": "../../elsewhere"}),
        "its own folder": lambda m: json.dumps(m | {"job": ".."}),
        "another mode": lambda m: json.dumps(m | {"mode": "sideways", "how": "no", "job": ""}),
    }


@pytest.mark.parametrize("change", odd_methods())
@pytest.mark.parametrize("name", ["project", "bundle"])
def test_odd_methods_of_calibrations(name: str, change: str, lab: Path, place: Path) -> None:
    path = copied(lab, KINDS[name], place)
    change_method = odd_methods()[change]
    if name == "project":
        with_content(path / "experiments.db", "method", change_method)
    else:
        with zipfile.ZipFile(path) as file:
            file.extractall(place / "open")
        with_content(place / "open" / "experiments.db", "method", change_method)
        with zipfile.ZipFile(path, "w") as file:
            file.write(place / "open" / "experiments.db", "experiments.db")
    with contextlib.suppress(FixelError):
        KINDS[name].read(path)


@pytest.mark.parametrize(
    ("attack", "name"),
    [
        (attack, name)
        for attack in (deep, bomb)
        for name, kind in KINDS.items()
        if Path(kind.file).suffix in NESTED and (attack, name) != (deep, "bundle")
    ],
)
def test_bombs_and_deep_nesting_are_refused(
    attack: Callable[[Path], None], name: str, lab: Path, place: Path
) -> None:
    path = copied(lab, KINDS[name], place)
    attack(path)
    if name in ("trusted program", "result cache"):  # what cannot be read there is no entry
        KINDS[name].read(path)
        return
    with pytest.raises(FixelError) as refusal:
        KINDS[name].read(path)
    assert "\n" not in str(refusal.value)


def test_a_bomb_takes_no_memory(lab: Path, place: Path) -> None:
    for name in ("saved result", "job", "bundle"):
        path = copied(lab, KINDS[name], place)
        bomb(path)
        assert peak(lambda: KINDS[name].read(path)) < 50e6  # noqa: B023


def test_a_forged_header_takes_no_memory(place: Path) -> None:
    """An array of eight bytes whose header announces a petabyte."""
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**14,)}
    np.lib.format.write_array_header_1_0(stream, header)
    content = {"type": "object", "class": "fixel:Polygon"}
    head = {"fixel": "1", "format": 1, "content": content}
    content["items"] = [["vertices", {"type": "array", "name": "array0"}]]  # type: ignore[assignment]
    with zipfile.ZipFile(place / "polygon.fixel", "w") as file:
        file.writestr("result.json", json.dumps(head))
        file.writestr("array0.npy", stream.getvalue() + bytes(8))
    refused(fixel.load, place / "polygon.fixel", match="a damaged one")


def test_a_scene_with_an_odd_value_stays_unread(place: Path) -> None:
    """Arguments of a listed class have the types of their annotations."""
    fixel_file = save(pushed_square().bodies[0], place / "body.fixel")
    with zipfile.ZipFile(fixel_file) as file:
        members = {info.filename: file.read(info) for info in file.infolist()}
    head = json.loads(members["result.json"])
    for item in head["content"]["items"]:
        if item[0] == "name":
            item[1] = {"type": "list", "items": [1, 2]}
    members["result.json"] = json.dumps(head).encode()
    with zipfile.ZipFile(fixel_file, "w") as file:
        for name, content in members.items():
            file.writestr(name, content)
    refused(fixel.load, fixel_file, match="a damaged one")
