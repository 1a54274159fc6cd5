"""Files that were cut, changed or made to hurt: a clear refusal, or experiments; nothing else."""

import contextlib
import gzip
import os
import random
import shutil

import pytest
from tests.datasets import push_files, recordings
from tests.fixtures import refused

import fixel
from fixel.datasets import IMPORTERS, files
from fixel.errors import FixelError


def _pushes(folder):
    return push_files.mit_push(folder, push_files.push(0), push_files.push(1))


def _table(folder):
    folder.mkdir()
    text = "time_s,x_mm,y_mm,theta_deg,pusher_x_mm,pusher_y_mm,fx_n,touch_bool,note\n" + "".join(
        f"{0.1 * k},{10 * k},0,{k},{10 * k - 40},0,1.5,{k % 2},felt\n" for k in range(12)
    )
    return recordings.table_file(folder / "own.csv", text)


MAKERS = {
    "trials": ("rpi-2dgad", recordings.rpi_2dgad),
    "pushes": ("mit-push", _pushes),
    "records": ("mit-push", recordings.mit_records),
    "runs": ("mit-pusher-slider", recordings.mit_pusher_slider),
    "tripod": ("cmu-tripod", recordings.cmu_tripod),
    "fingers": ("cmu-two-point", recordings.cmu_two_point),
    "own": ("csv", _table),
}

HOSTILE = [
    b"", b"nan", b"-1", b"1e308", b"1e17", b"inf", b"0", b"null", b'"', b",", b"\n", b"\x00", b"{}",
    b"[]", b"\xff\xfe", b"true", b"9" * 400, b"[[[[", b"99999999999999999999", b"1e-320",
]  # fmt: skip

MUTATIONS = 60


@pytest.mark.parametrize("kind", MAKERS)
def test_mutated_files_are_imported_or_refused(kind, tmp_path):
    name, make = MAKERS[kind]
    whole = make(tmp_path / "whole")
    root = whole if whole.is_dir() else whole.parent
    rng = random.Random(kind)
    for _ in range(MUTATIONS):
        copy = tmp_path / "copy"
        shutil.copytree(root, copy)
        _mutate(rng.choice(sorted(path for path in copy.rglob("*") if path.is_file())), rng)
        # Any other exception, and any warning, fails the test.
        with contextlib.suppress(FixelError):
            list(IMPORTERS[name].read(copy / whole.relative_to(root)).experiments())
        shutil.rmtree(copy)


def _mutate(path, rng):
    """Change one thing: cut the file, or put something else in place of a value or a byte."""
    packed = path.read_bytes()
    inside = path.suffix == ".gz" and rng.random() < 0.8
    content = gzip.decompress(packed) if inside else packed
    at = rng.randrange(len(content))
    choice = rng.random()
    if choice < 0.2:
        content = content[:at]
    elif choice < 0.4:
        content = content[:at] + bytes([rng.randrange(256)]) + content[at + 1 :]
    else:
        end = next((k for k in range(at, len(content)) if content[k] in b",\n]}"), len(content))
        content = content[:at] + rng.choice(HOSTILE) + content[end:]
    path.write_bytes(gzip.compress(content) if inside else content)


def _damaged():
    packed = bytearray(gzip.compress(b"t_s,x_m,y_m\n0,0,0\n" * 100))
    packed[12:20] = b"\xff" * 8
    return bytes(packed)


@pytest.mark.parametrize(("limits", "content", "message"), [
    ({"MAX_FILE": 2_000_000}, gzip.compress(b"t_s,x_m,y_m\n" + b"0,0,0\n" * 1_000_000),
     "at most 2 million characters"),
    ({"MAX_CELLS": 1_000_000}, gzip.compress(b"t_s,x_m,y_m\n" + b"\n" * 2_000_000),
     "at most 1 million cells"),
    ({}, gzip.compress(b"x," * 1_000_000), "a line of 1000000 characters"),
    ({}, _damaged(), "a readable CSV file"),
], ids=["too long", "too many cells", "a line without end", "damaged"])  # fmt: skip
def test_archives_that_cannot_be_read_are_refused(tmp_path, monkeypatch, limits, content, message):
    for name, limit in limits.items():
        monkeypatch.setattr(files, name, limit)
    path = tmp_path / "own.csv.gz"
    path.write_bytes(content)
    refused(IMPORTERS["csv"].read, path, match=message)


def test_parquet_that_unpacks_to_many_cells_is_refused_unread(tmp_path, monkeypatch):
    """Three million cells in a few kilobytes."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    zeros = arrow.array([0] * 1_000_000, arrow.int8())
    path = tmp_path / "own.parquet"
    parquet.write_table(arrow.table({name: zeros for name in ("t_s", "x_m", "y_m")}), path)
    assert path.stat().st_size < 20_000
    monkeypatch.setattr(files, "MAX_CELLS", 2_999_999)
    monkeypatch.setattr(parquet.ParquetFile, "read", lambda *_: pytest.fail("it was read"))
    refused(IMPORTERS["csv"].read, path, match="at most 2 million cells")


@pytest.mark.parametrize("fixed", [False, True])
def test_parquet_that_unpacks_to_long_texts_is_refused(tmp_path, monkeypatch, fixed):
    """A thousand times the same text of 10,000 characters, stored once."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    kind = arrow.binary(10_000) if fixed else arrow.string()
    path = tmp_path / "own.parquet"
    columns = {name: [0.1 * k for k in range(1_000)] for name in ("t_s", "x_m", "y_m")}
    texts = arrow.array([b"x" * 10_000] * 1_000, arrow.binary()).cast(kind)
    parquet.write_table(arrow.table({**columns, "note": texts}), path)
    assert path.stat().st_size < 100_000
    monkeypatch.setattr(files, "MAX_FILE", 9_000_000)
    refused(IMPORTERS["csv"].read, path, match="at most 9 million characters")


def test_json_nested_without_end_is_refused(tmp_path):
    path = tmp_path / f"{recordings.RECORD}.json"
    path.write_text('{"object_pose": ' + "[" * 100_000)
    refused(list, IMPORTERS["mit-push"].read(path).experiments())


@pytest.mark.parametrize("name", ["a.jsonl", "a.db3", "a.mcap", "a.csv"])
def test_pipes_are_refused_unread(name, tmp_path):
    os.mkfifo(tmp_path / name)
    for read in (fixel.read_experiments, fixel.load):
        refused(read, tmp_path / name, match=f"{name}: found a pipe or a device")


def test_digits_with_underscores_are_no_numbers(tmp_path):
    rows = "".join(f"{0.1 * k},{k},0,{'1_0' if k == 3 else k}\n" for k in range(12))
    (tmp_path / "a.csv").write_text("time_s,x_mm,y_mm,theta_deg\n" + rows)
    refused(fixel.read_experiments, tmp_path / "a.csv", match="'1_0', but must be a finite number")
