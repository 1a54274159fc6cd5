"""Experiments read from tables, datasets, recordings and exports; and what is refused."""

import numpy as np
import pytest
from tests.closed_form import SIDE, push
from tests.datasets.recordings import table_file
from tests.fixtures import refused

import fixel
from fixel.errors import DatasetMissing, InvalidInput
from fixel.formats import SceneFile
from fixel.workflows.experiments import read_experiments

HEAD = ("time_s", "x_m", "y_m", "theta_rad", "tip_x_m", "tip_y_m")


def template():
    part = fixel.Body(
        "part",
        fixel.Polygon.rectangle(SIDE, SIDE),
        mass=0.5,
        support=fixel.Tripod(radius=0.03, friction=0.25),
    )
    return fixel.Scene(part, fixel.Pusher("tip", fixel.Disk(0.005), friction=0.3))


def columns(*offsets, **more):
    """Columns of pushes in closed form, one after the other."""
    rows, names = [], []
    for k, offset in enumerate(offsets):
        time, pose, tip = push(0.15, offset)
        rows.append(np.column_stack((time, pose, tip)))
        names += [f"p{k}"] * len(time)
    table = dict(zip(HEAD, np.concatenate(rows).T.tolist(), strict=True))
    return {"push": names, **table, **more}


def text_of(table):
    names = list(table)
    lines = [
        ",".join(names),
        *(",".join(map(str, row)) for row in zip(*table.values(), strict=True)),
    ]
    return "\n".join(lines) + "\n"


def read(table, **more):
    return read_experiments(table, split_by="push", scene=template(), progress=False, **more)


def test_three_lines_make_scenes_of_a_table():
    found = read(columns(0.01, -0.02))

    assert found.keys == ("table/p0", "table/p1")
    for experiment, offset in zip(found, (0.01, -0.02), strict=True):
        time, pose, tip = push(0.15, offset)
        scene = experiment.scene
        assert scene.bodies[0].pose == pytest.approx(pose[0])
        assert scene.pushers[0].drive.waypoints[:, 1:3] == pytest.approx(tip)
        assert scene.duration == pytest.approx(time[-1])
        assert experiment.trajectory.pose == pytest.approx(pose)
        assert experiment.simulate().converged
    assert found.skipped == ()
    assert "2 experiments, one for each value of 'push'." in found.notes


def test_all_tables_give_the_same(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet

    table = columns(0.01, -0.02, surface=["abs"] * len(columns(0.01, -0.02)["push"]))
    pandas = pytest.importorskip("pandas")
    csv = table_file(tmp_path / "table.csv", text_of(table))
    pa.parquet.write_table(pa.table(table), tmp_path / "table.parquet")
    expected = read(table)
    assert expected[0].conditions == {"surface": "abs"}
    for source in (
        str(csv),
        tmp_path / "table.parquet",
        pa.table(table),
        pandas.DataFrame(table),
        {name: np.array(column) for name, column in table.items()},
    ):
        found = read(source)
        assert found.keys == expected.keys
        for one, other in zip(found, expected, strict=True):
            assert one.trajectory == other.trajectory
            assert one.scene == other.scene
            assert one.conditions == other.conditions


def _with_clock(table, clock, title):
    return {title if name == "time_s" else name: clock if name == "time_s" else column
            for name, column in table.items()}  # fmt: skip


@pytest.mark.parametrize("title", ["time_s", "time_ms", "stamp"])
def test_times_of_a_clock_are_seconds_whatever_their_title(tmp_path, title):
    pandas = pytest.importorskip("pandas")
    table = columns(0.01, -0.02)
    seconds = np.round(np.array(table["time_s"]), 6)
    table["time_s"] = seconds.tolist()
    since = (1e9 * seconds).astype("timedelta64[ns]")
    stamps = np.datetime64("2026-03-29T00:59:59", "ns") + since  # summer time began a second later
    berlin = pandas.to_datetime(stamps, utc=True).tz_convert("Europe/Berlin")
    expected = read(table)
    for clock in (
        stamps,
        since,
        [stamp.to_pydatetime() for stamp in pandas.to_datetime(stamps)],
        [stamp.isoformat() for stamp in berlin],
        pandas.Series(stamps),
        pandas.Series(berlin),
        pandas.Series(since),
    ):
        found = read(_with_clock(table, clock, title), columns={"time": title})
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one.trajectory.time, other.trajectory.time, atol=2e-6)
    written = table_file(tmp_path / "clock.csv", text_of(_with_clock(table, stamps, title)))
    found = read(written, columns={"time": title})
    assert found[1].scene.duration == pytest.approx(expected[1].scene.duration, abs=2e-6)


def test_missing_values_of_any_kind_are_blank_cells():
    pandas = pytest.importorskip("pandas")
    table = columns(0.01)
    place = {"x_m": 2, "y_m": 2, "theta_rad": 2}
    numbers = np.array(table["x_m"])
    expected = len(numbers) - 1
    for lost in (
        np.where(np.arange(len(numbers)) == 2, np.nan, numbers),
        np.ma.masked_array(numbers, mask=np.arange(len(numbers)) == 2),
        pandas.array(numbers, dtype="Float64").copy(),
    ):
        if not isinstance(lost, np.ndarray):
            lost[place["x_m"]] = pandas.NA
        (found,) = read(table | {"x_m": lost})
        assert len(found.trajectory.time) == expected


def test_tables_that_are_none_are_refused_in_words():
    pandas = pytest.importorskip("pandas")
    table = columns(0.01)
    twice = pandas.concat([pandas.DataFrame(table)] * 2, axis=1)
    refused(read, twice, match="found 'push' twice, but fixel needs different names")
    refused(read, {name: [] for name in table}, match="found no rows")
    rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
    refused(read, rows, match="found a row of values, but fixel needs columns")
    shuffled = {name: [*column[1:3], column[0], *column[3:]] for name, column in table.items()}
    refused(read, shuffled, match="sort the rows by time")
    table["push"] = [None, None, *table["push"][2:]]
    assert read(table).skipped == ("table/: rows without a value of 'push'",)


def test_columns_and_units_are_chosen_where_the_header_does_not_say():
    table = columns(0.01)
    table["robot x"] = [1e3 * x for x in table.pop("tip_x_m")]
    table["robot y"] = [1e3 * y for y in table.pop("tip_y_m")]
    table["yaw (raw)"] = np.degrees(table.pop("theta_rad")).tolist()
    chosen = {"pusher_x": "robot x", "pusher_y": "robot y", "theta": "yaw (raw)"}

    found = read(table, columns=chosen, units={"length": "mm", "angle": "deg"})

    _, pose, tip = push(0.15, 0.01)
    assert found[0].trajectory.pose == pytest.approx(pose)
    assert found[0].pusher.pose[:, :2] == pytest.approx(tip)


def test_units_that_contradict_the_header_are_refused():
    table = columns(0.01)
    contradiction = r"column x_m \(push p0\): found the unit m .* but mm was given"
    refused(read, table, units={"length": "mm"}, match=contradiction)
    agreed = read(table, units={"length": "m", "time": "s", "angle": "rad"})
    assert agreed[0].trajectory.pose == pytest.approx(read(table)[0].trajectory.pose)


def test_pushes_that_are_not_split_name_the_column_that_splits_them():
    table = columns(0.01, -0.02)
    table |= {"surface": ["abs"] * len(table["push"]), "row": [*range(len(table["push"]))]}
    with pytest.raises(InvalidInput, match=r'increasing times; use split_by="push" if'):
        read_experiments(table, scene=template(), progress=False)
    del table["push"]
    with pytest.raises(InvalidInput, match=r'use split_by="COLUMN"'):
        read_experiments(table, scene=template(), progress=False)
    table["time_s"][1] = table["time_s"][0]  # the clock stands still, which no column explains
    refused(read_experiments, table, scene=template(), progress=False, match="increasing times")


def test_a_function_gives_each_experiment_its_scene():
    table = columns(0.01, -0.02)
    sizes = {"p0": 0.5, "p1": 0.7}

    def scene(conditions):
        part = fixel.Body(
            "part", fixel.Polygon.rectangle(SIDE, SIDE), mass=sizes[conditions["name"]],
            support=fixel.Tripod(radius=0.03, friction=0.25),
        )  # fmt: skip
        return fixel.Scene(part, fixel.Pusher("tip", fixel.Disk(0.005), friction=0.3))

    found = read_experiments(table, split_by="push", scene=scene, progress=False)
    assert [one.scene.bodies[0].mass for one in found] == [0.5, 0.7]


def test_a_loaded_scene_file_is_a_scene():
    loaded = SceneFile(scene=template())
    table = columns(0.01, -0.02)
    as_file = read_experiments(table, split_by="push", scene=loaded, progress=False)
    as_scene = read_experiments(table, split_by="push", scene=loaded.scene, progress=False)
    assert [one.scene for one in as_file] == [one.scene for one in as_scene]


def test_single_rows_are_skipped_and_named():
    table = columns(0.01)
    table = {name: [*column, column[0]] for name, column in table.items()}
    table["push"][-1] = "lost"
    found = read(table)
    assert found.skipped == ("table/lost: one row",)
    assert "skipped 1: table/lost: one row" in repr(found)


@pytest.mark.parametrize(("change", "options", "complaint"), [
    ({"time_s": None}, {}, "found the columns .*fixel needs a column for time"),
    ({"x_m": 1e3, "y_m": 1e3, "tip_x_m": 1e3, "tip_y_m": 1e3}, {}, "x_mm is in millimetres"),
    ({"theta_rad": 57.3}, {}, "units={'angle': 'deg'}"),
    ({}, {"units": {"angles": "deg"}}, "did you mean 'angle'"),
    ({}, {"units": {"angle": "grad"}}, "must be one of rad, mrad, deg"),
    ({}, {"columns": {"theta": "thta_rad"}}, "did you mean 'theta_rad'"),
    ({}, {"columns": {"pusher_xx": "tip_x_m"}}, "did you mean 'pusher_x'"),
    ({}, {"split_by": "pushes"}, "did you mean 'push'"),
    ({"tip_x_m": None, "tip_y_m": None}, {}, "'tip' without a drive, and a table without its"),
    ({}, {"object_name": "prt"}, "fixel needs the object 'prt'"),
    ({}, {"scene": 3}, "scene: found the type int"),
    ({}, {"limit": 0}, "limit is 0"),
    ({}, {"format": "cvs"}, "format is 'cvs'"),
])  # fmt: skip
def test_what_cannot_be_right_is_refused(change, options, complaint):
    table = columns(0.01)
    for name, factor in change.items():
        column = table.pop(name)
        if factor is not None:
            table[name] = [factor * value for value in column]
    given = {"split_by": "push", "scene": template(), "progress": False} | options
    refused(read_experiments, table, match=complaint, **given)


def test_sources_that_are_none(tmp_path):
    with pytest.raises(DatasetMissing, match="no such file"):
        read_experiments(tmp_path / "nothing.csv")
    refused(read_experiments, 3, match="found the type int, but fixel needs a file")
    refused(read_experiments, {"time_s": [0.0], "x_m": [0.0, 1.0]}, match="of equal length")


def test_several_files_and_a_limit(tmp_path):
    table = columns(0.01)
    del table["push"]
    files = [table_file(tmp_path / f"run{k}.csv", text_of(table)) for k in range(3)]
    found = read_experiments(files, scene=template(), limit=2, progress=False)
    assert found.keys == ("csv/run0", "csv/run1")
    reported = []
    read_experiments(files, progress=reported.append)
    assert [progress.done for progress in reported] == [1, 2, 3]


def test_reading_of_a_split_table_is_reported(tmp_path):
    reported = []
    table = table_file(tmp_path / "all.csv", text_of(columns(0.01)))
    n = len(read_experiments(table, split_by="push", progress=reported.append))
    read = [one for one in reported if one.stage == "reading the table"]
    assert [(one.done, one.total) for one in read] == [(k, n) for k in range(n)]


def test_a_bundle_gives_its_experiments_back(tmp_path):
    pushes = fixel.datasets.example()[:3]
    done = fixel.export(pushes, tmp_path / "pushes.zip", progress=False)
    found = read_experiments(done.target)
    assert found.keys == pushes.keys
    assert [one.trajectory for one in found] == [one.trajectory for one in pushes]
    assert [one.scene for one in found] == [one.scene for one in pushes]


def test_a_public_dataset_is_recognised(data_root):
    folder = data_root / "rpi_2dgad"
    found = read_experiments(folder, limit=3, progress=False)
    assert len(found) == 3
    assert found[0].dataset == "rpi-2dgad"
    with pytest.raises(InvalidInput, match="scene: found a source read as rpi-2dgad"):
        read_experiments(folder, scene=template())


@pytest.mark.parametrize("option", ["columns", "units"])
def test_roles_and_units_of_another_type_are_refused_by_name(option):
    pandas = pytest.importorskip("pandas")
    for wrong in (pandas.Series({"time": "time_s"}), [("time", "time_s")], "time_s"):
        refused(read, columns(0.01), **{option: wrong}, match=f"{option}.* texts by name")


def test_equal_names_of_files_in_two_folders_are_stated(tmp_path):
    text = "time_s,x_mm,y_mm,theta_deg\n0,0,0,0\n1,5,0,1\n2,9,0,2\n"
    places = [tmp_path / folder / "t.csv" for folder in ("a", "b")]
    for place in places:
        place.parent.mkdir()
        place.write_text(text)
    stated = "Equal names: 2 experiments are csv/t; rename their files before a calibration."
    assert stated in str(read_experiments(places, progress=False))
    assert "Equal" not in str(read_experiments(places[:1], progress=False))
