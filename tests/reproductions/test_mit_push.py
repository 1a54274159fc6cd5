"""The benchmark on straight pushes: made-up ones of known parameters, and real ones."""

import csv
import json

import numpy as np
import pytest
from reproductions.__main__ import app
from reproductions.protocols import PROTOCOLS
from reproductions.pushes import PushGroup, rows_by_key
from reproductions.residuals import Split, few_of, folds, learned_ends, random_split
from reproductions.run import BenchmarkRequest, benchmark_real
from tests.datasets import push_files
from tests.fixtures import refused
from typer.testing import CliRunner

from fixel.datasets.mit_push import read_mit_pushes
from fixel.errors import DatasetMissing
from fixel.io.array_bytes import ResultCache

SHIFT = (0.9e-3, -0.6e-3)
TRUTH = {
    "mu_pusher": 0.15, "registration_x": SHIFT[0], "registration_y": SHIFT[1], "table_bend": 0.6,
}  # fmt: skip


def made_up(folder, n=30):
    """Pushes of two plates on one surface, that end where the simulator says under the truth."""
    rng = np.random.default_rng(7)
    rows = [_start(k, name, rng) for name in ("block", "egg") for k in range(n)]
    write = push_files.mit_push(folder, *rows)
    data = read_mit_pushes(write)
    for key, own in rows_by_key(data, data.usable).items():
        group = PushGroup(data, key, own)
        values = {name: np.full(len(own), value) for name, value in TRUTH.items()}
        found = group.simulate(np.arange(len(own)), values)
        assert found.good.all()
        noise = rng.normal(0.0, 0.1e-3, found.end.shape)
        for row, end in zip(own.tolist(), found.end + noise, strict=True):
            names = ("obj_x1", "obj_y1", "obj_th1")
            rows[row] |= dict(zip(names, end.tolist(), strict=True))
    return push_files.mit_push(folder, *rows)


def _start(k, name, rng):
    """A push into one of the four sides; the tip is recorded where it seems to touch."""
    reach = {"block": (0.03, 0.03), "egg": (0.03, 0.04)}[name][k % 2] + push_files.TIP
    angle, side = rng.uniform(-3.0, 3.0), 0.5 * np.pi * (k % 4)
    along = rng.uniform(-0.015, 0.015) if name == "block" else 0.0
    c, s = np.cos(angle + side), np.sin(angle + side)
    tip = np.array([0.2 + c * reach - s * along, -0.1 + s * reach + c * along])
    way = angle + side + np.pi + rng.uniform(-0.5, 0.5)
    end = tip + 0.05 * np.array([np.cos(way), np.sin(way)])
    return push_files.push(
        k, push_id=f"felt_{name}_{k}", shape=name, obj_th0=angle, tip_x0=tip[0], tip_y0=tip[1],
        tip_x1=end[0], tip_y1=end[1], speed_mm_s=10 + 10 * (k % 3 == 0),
    )  # fmt: skip


def pooled(answer, protocol, model):
    row = next(row for row in answer.rows if row["protocol"] == protocol)
    return float(row[model]["position_mm"]["mean"])


# --- splits ---------------------------------------------------------------------------------------


def test_splits_share_out_every_stratum():
    strata = [10.0] * 20 + [20.0] * 10
    split = random_split(strata, 0.6, 1)
    assert sorted([*split.train, *split.held_out]) == list(range(30))
    assert (split.train < 20).sum() == 12
    assert (split.train >= 20).sum() == 6
    assert random_split(strata, 0.6, 2).train.tolist() != split.train.tolist()
    assert random_split(strata, 0.6, 1).train.tolist() == split.train.tolist()


def test_folds_hold_everybody_out_once():
    found = folds([1] * 7 + [2] * 6, 5, 0)
    assert sorted(np.concatenate([own.held_out for own in found]).tolist()) == list(range(13))
    for own in found:
        assert not set(own.train.tolist()) & set(own.held_out.tolist())
        assert len(own.held_out) in (2, 3)


def test_few_are_some_of_those_for_training():
    split = random_split([1] * 50, 0.6, 0)
    few = few_of(split, 10, 0)
    assert set(few.train.tolist()) < set(split.train.tolist())
    assert len(few.train) == 10
    assert few.held_out is split.held_out


def test_wrong_splits_are_refused():
    refused(folds, [1, 1, 1], 4, 0, match="2 to 3")
    refused(random_split, [1, 1], 1.0, 0, match="between 0 and 1")


# --- finished fits --------------------------------------------------------------------------------


def test_what_is_finished_is_not_done_again(tmp_path):
    kept = ResultCache(tmp_path / "fits")
    calls = []

    def compute():
        calls.append(1)
        return {"answer": len(calls)}

    of = [np.arange(3.0), "a"]
    assert kept.get("one", of, compute) == {"answer": 1}
    assert ResultCache(tmp_path / "fits").get("one", of, compute) == {"answer": 1}
    assert kept.get("one", [np.arange(4.0), "a"], compute) == {"answer": 2}
    (tmp_path / "fits" / "one.json").write_text("{ torn")
    assert kept.get("one", of, compute) == {"answer": 3}


# --- protocols ------------------------------------------------------------------------------------


@pytest.mark.system
def test_made_up_pushes_are_found_out(tmp_path):
    folder = made_up(tmp_path / "data")
    out = tmp_path / "out"
    reports = []
    request = BenchmarkRequest(seeds=1)

    answer = benchmark_real(
        folder, request, out=out, progress=lambda done, of, _: reports.append((done, of))
    )

    assert [scored.protocol for scored in answer.scored] == list(PROTOCOLS)
    assert reports[-1] == (12, 12)
    before = pooled(answer, "calibrated", "uncalibrated")
    assert pooled(answer, "calibrated", "calibrated") < 0.35 * before
    assert pooled(answer, "learned", "calibrated") < 0.5 * before
    assert pooled(answer, "averaged", "calibrated") < 0.5 * before
    assert pooled(answer, "few", "calibrated") < 0.6 * before
    assert pooled(answer, "calibrated", "calibrated") < pooled(answer, "unregistered", "calibrated")
    assert pooled(answer, "new-shape", "calibrated") < 0.7 * before
    found = answer.fits[0]["values"]
    assert found["registration_x"] == pytest.approx(SHIFT[0], abs=0.25e-3)
    assert found["mu_pusher"] == pytest.approx(0.15, abs=0.05)

    rows = list(csv.DictReader((out / "mit_rows.csv").read_text().splitlines()))
    assert len(rows) == len(answer.rows)
    assert float(rows[0]["calibrated_position_mm_mean"]) > 0.0
    records = list(csv.DictReader((out / "mit_pushes.csv").read_text().splitlines()))
    assert len(records) == sum(len(scored.names) for scored in answer.scored)
    assert (out / "mit.png").read_bytes().startswith(b"\x89PNG")

    again = benchmark_real(folder, request, out=out)
    assert again.rows == answer.rows
    assert again.timing["seconds"] < answer.timing["seconds"]


def test_a_stopped_run_goes_on_where_it_was(tmp_path):
    folder, out = made_up(tmp_path / "data", 12), tmp_path / "out"
    request = BenchmarkRequest(protocols=("calibrated",), seeds=1, quick=True)

    def stop(done, of, what):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        benchmark_real(folder, request, out=out, progress=stop)
    (kept,) = (out / "fits").iterdir()
    written = kept.read_text()
    benchmark_real(folder, request, out=out)

    assert kept.read_text() == written
    assert len(list((out / "fits").iterdir())) == 2


@pytest.mark.system
def test_what_is_held_out_is_never_looked_at(tmp_path):
    """Wrong ends of held-out pushes change no prediction, neither of physics nor of the process."""
    data = read_mit_pushes(made_up(tmp_path / "data"))
    (key, rows), *_ = rows_by_key(data, data.usable).items()
    group = PushGroup(data, key, rows)
    split = random_split(np.zeros(len(rows)).tolist(), 0.6, 0)
    speed = data.speed[rows]
    physics = group.nominal.end

    end, sd = learned_ends(group, split, physics, speed)
    group.end[split.held_out] += 5.0
    end_again, sd_again = learned_ends(group, split, physics, speed)

    assert np.array_equal(end, end_again)
    assert np.array_equal(sd, sd_again)
    changed = Split(split.train[:-2], split.held_out)
    assert not np.array_equal(learned_ends(group, changed, physics, speed)[0], end)


@pytest.mark.system
def test_fits_depend_on_training_pushes_alone(tmp_path):
    folder = made_up(tmp_path / "data", 16)
    data = read_mit_pushes(folder)
    request = BenchmarkRequest(protocols=("calibrated", "few"), seeds=1, quick=True)
    first = benchmark_real(folder, request)
    split = {name for scored in first.scored for name in scored.names}
    rows = list(csv.DictReader(_unzipped(folder)))
    for row in rows:
        if row["push_id"] in split:
            row["obj_x1"] = str(float(row["obj_x1"]) + 1.0)
    push_files.write_table(folder / "pushes.csv.gz", rows)

    second = benchmark_real(folder, request)

    assert [fit["values"] for fit in second.fits] == [fit["values"] for fit in first.fits]
    assert pooled(second, "calibrated", "calibrated") > 900.0
    assert len(data) == len(rows)


def _unzipped(folder):
    import gzip

    with gzip.open(folder / "pushes.csv.gz", "rt", encoding="utf-8") as stream:
        return stream.read().splitlines()


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.system
def test_command_prints_json_and_a_table(tmp_path):
    folder = made_up(tmp_path / "data", 12)
    arguments = ["--data", str(folder), "--quick", "--protocol", "few"]

    plain = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    asked = CliRunner().invoke(app, [*arguments, "--json"])

    assert plain.exit_code == 0, plain.output
    assert "held out" in plain.stdout
    assert "Next: python -m reproductions --data" in plain.stdout
    answer = json.loads(asked.stdout)
    assert answer["part"] == "mit"
    assert answer["rows"][0]["protocol"] == "few"


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"protocols": ("calibrate",)}, "must be one of calibrated, learned"),
    ({"seeds": 0}, "1 or more"),
    ({"folds": 1}, "2 or more"),
])  # fmt: skip
def test_wrong_requests_are_refused(changes, complaint):
    refused(BenchmarkRequest, **changes, match=complaint)


def test_a_folder_without_the_data_is_refused(tmp_path):
    with pytest.raises(DatasetMissing):
        benchmark_real(tmp_path)
    refused(benchmark_real, tmp_path, part="moon", match="must be one of mit")


# --- real pushes ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_real_pushes_are_nearer_than_the_published_simulator(data_root, tmp_path):
    """One plate on plywood, whose warp the published model does not know. Reached: 1.9 mm."""
    source = data_root / "mit_push_endpoints"
    rows = [
        row
        for row in csv.DictReader(_unzipped(source))
        if (row["surface"], row["shape"]) == ("plywood", "rect3")
    ]
    push_files.write_table(tmp_path / "pushes.csv.gz", rows)
    (tmp_path / "shapes.json").write_text((source / "shapes.json").read_text())

    answer = benchmark_real(tmp_path, BenchmarkRequest(protocols=("calibrated",), seeds=1))

    assert pooled(answer, "calibrated", "calibrated") < 2.6
    assert pooled(answer, "calibrated", "published") > 3.0
