"""Functions that need the package of an extra name the extra; nothing else needs the package."""

import csv
import re
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

import fixel
from fixel.datasets.files import read_table
from fixel.drawing.animation import film_ending
from fixel.formats.recording_video import VideoSink, packets
from fixel.formats.trajectory_file import save_trajectory, trajectory_columns
from fixel.formats.video_file import VideoWriter, open_video
from fixel.testing import scenes
from fixel.uncertainty.indices import Factor, sobol_indices

SOURCES = Path(fixel.__file__).parent
EXTRAS = {"pyarrow", "av", "cv2", "h5py", "pooch", "PyNomad", "sklearn", "dynesty", "SALib"}
EXTRAS |= {"serial", "cryptography", "dask", "distributed", "psycopg", "mujoco", "Box2D", "pydrake"}
IMPORTED = re.compile(rf"^(?:import (?:.*, *)?|from )({'|'.join(EXTRAS)})\b", re.MULTILINE)


@pytest.fixture(scope="module")
def run():
    return fixel.simulate(scenes.grasp("seated"))


def test_no_module_imports_a_package_of_an_extra_when_it_is_loaded():
    found = [
        (path.name, package)
        for path in SOURCES.rglob("*.py")
        # Programs of their own, and modules that only their engine loads.
        if not {"scripts", "engines"} & {*path.parts}
        for package in IMPORTED.findall(path.read_text(encoding="utf-8"))
    ]
    assert not found


def parquet_cases(run, folder):
    (folder / "pushes.parquet").write_bytes(b"PAR1")
    fit = fixel.datasets.example()[:1]
    return {
        "trajectory": lambda: save_trajectory(run, folder / "run.parquet"),
        "table": lambda: read_table(folder / "pushes.parquet"),
        "tables": lambda: fixel.export(fit, folder / "tables", progress=False),
        "lerobot": lambda: fixel.export(fit, folder / "robot", format="lerobot", progress=False),
    }


def video_cases(run, folder):
    (folder / "film.mkv").write_bytes(b"\x1aE\xdf\xa3")
    return {
        "film": lambda: run.animate(folder / "run.mp4"),
        "video": lambda: open_video(folder / "film.mkv"),
        "new video": lambda: VideoWriter(folder / "new.mkv", (64, 48)),
        "recording": lambda: VideoSink(folder / "new.nut", (64, 48), exact=False),
        "stored recording": lambda: next(packets(folder / "film.mkv")),
    }


def posterior_cases(run, folder):
    push = fixel.datasets.example()[0]
    return {"posterior": lambda: fixel.posterior(push, ["mu_pusher"], progress=False)}


def indices_cases(run, folder):
    factors = [Factor("x", 0.0, 1.0)]
    return {"indices": lambda: sobol_indices(lambda points: points, factors, ["y"])}


@pytest.mark.parametrize(("package", "extra", "cases"), [
    ("pyarrow", "parquet", parquet_cases),
    ("av", "video", video_cases),
    ("dynesty", "infer", posterior_cases),
    ("SALib", "infer", indices_cases),
])  # fmt: skip
def test_what_needs_an_extra_names_it(package, extra, cases, run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    before = None

    for what, call in cases(run, tmp_path).items():
        before = before or sorted(tmp_path.iterdir())
        with pytest.raises(fixel.MissingExtra, match=rf"{package}; run: .*fixel\[{extra}\]"):
            pytest.fail(f"{what}: {call()}")
        assert sorted(tmp_path.iterdir()) == before


def test_without_pyav_films_are_gif(monkeypatch):
    assert film_ending() == ".mp4"
    monkeypatch.setitem(sys.modules, "av", None)

    assert film_ending() == ".gif"


def test_csv_trajectories_are_as_arrow_writes_them(run, tmp_path, monkeypatch):
    columns = trajectory_columns(run)
    pyarrow.csv.write_csv(pa.table(columns), tmp_path / "arrow.csv")
    monkeypatch.setitem(sys.modules, "pyarrow", None)

    save_trajectory(run, tmp_path / "run.csv")

    assert (tmp_path / "run.csv").read_bytes() == (tmp_path / "arrow.csv").read_bytes()
    with (tmp_path / "run.csv").open(newline="") as stream:
        rows = [*csv.DictReader(stream)]
    for name in ("time_s", "object.theta_rad"):
        np.testing.assert_array_equal([float(row[name]) for row in rows], columns[name])
