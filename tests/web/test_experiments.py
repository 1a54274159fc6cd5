"""The table of experiments and its marks, asked for as a program does."""

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from fastapi import applications
from tests.datasets import recordings
from tests.fixtures import bare_experiment
from tests.web.conftest import unpacked

from fixel.datasets import plan_import
from fixel.formats.video_file import VideoWriter, open_video
from fixel.vision.frame import Frame
from fixel.web.pages import listing
from fixel.web.views import video as videos

ADDRESS = "/experiments"
RAW = f"/api/v1{ADDRESS}"


def ids(bench, filter):
    return bench.get(f"{ADDRESS}/ids?filter={filter}")["ids"]


# --- the table --------------------------------------------------------------------------------


def test_a_page_of_the_table(bench):
    found = bench.get(f"{ADDRESS}?limit=3")
    assert (len(found["experiments"]), found["total"], found["faulty"]) == (3, 30, 1)
    row = found["experiments"][2]
    assert row["flags"] == [
        {"name": "misregistered", "detail": "starts 4.2 mm inside the pusher", "fault": True}
    ]
    assert row["before_mm"] > 0.0
    assert row["after_mm"] is None
    assert row["shape"] == "square"
    assert len(row["start"]) == 3
    assert len(bench.get(f"{ADDRESS}?offset=28")["experiments"]) == 2
    assert bench.get(f"{ADDRESS}?offset=1000")["experiments"] == []


def test_a_page_whose_experiments_have_been_deleted_is_the_last_one(bench, monkeypatch):
    monkeypatch.setattr(listing, "ROWS", 20)
    last, after = (bench.client.get(f"{ADDRESS}?offset={k}").text for k in (20, 60))
    assert after.count("<tr data-id") == last.count("<tr data-id") == 10
    assert "21 to 30" in " ".join(after.split())


@pytest.mark.parametrize(("sort", "of"), [
    ("moved", lambda row: row["moved_m"]),
    ("turned", lambda row: row["turned_rad"]),
    ("name", lambda row: row["name"]),
    ("layout", lambda row: row["layout"]),
    ("offset_y_m", lambda row: row["conditions"]["offset_y_m"]),
    ("contacts", lambda row: row["contacts"]),
    ("duration", lambda row: row["duration_s"]),
    ("flags", lambda row: len(row["flags"])),
])  # fmt: skip
def test_it_sorts_by_any_column(bench, sort, of):
    for descending in (False, True):
        rows = bench.get(f"{ADDRESS}?sort={sort}&descending={descending}")["experiments"]
        values = [of(row) for row in rows]
        assert values == sorted(values, reverse=descending)


def test_what_is_not_known_stands_last_either_way(bench):
    for descending in (False, True):
        rows = bench.get(f"{ADDRESS}?sort=before&descending={descending}")["experiments"]
        known = [row["before_mm"] for row in rows if row["before_mm"] is not None]
        assert len(known) == 3
        assert [row["before_mm"] for row in rows[:3]] == sorted(known, reverse=descending)


@pytest.mark.parametrize(("query", "where"), [
    ("filter=is:odd", "filter: is:"),
    ("filter=moved>far", "filter: moved"),
    ('filter="open', "filter"),
    ("sort=no%22name", "column"),
    ("limit=0", "query.limit"),
    ("limit=501", "query.limit"),
    ("limit=1_0", "query.limit"),
    ("offset=-1", "query.offset"),
    ("offset=99999999999999999999", "query.offset"),
    ("limt=3", "query"),
])  # fmt: skip
def test_what_cannot_be_is_refused_with_the_place(bench, query, where):
    said = bench.get(f"{ADDRESS}?{query}", 422)
    assert said["where"] == where
    assert said["expected"]


def test_unknown_parameters_are_refused_wherever_there_are_others_or_none(bench):
    said = bench.get(f"{ADDRESS}?offset=0&limt=3", 422)
    assert (said["where"], said["found"]) == ("query", "'limt'")
    assert "did you mean 'limit'" in said["hint"]
    said = bench.get(f"{ADDRESS}/1?raw=1", 422)
    assert (said["found"], said["expected"]) == ("raw", "no parameters")


def test_requests_at_the_same_time_generate_one_description(bench, monkeypatch):
    """Warnings are ignored during its generation, for all threads: two at once undo each other."""
    generates, calls = applications.get_openapi, []

    def slowly(**options):
        calls.append(len(calls))
        time.sleep(0.2)  # any other request begins in it
        return generates(**options)

    monkeypatch.setattr(applications, "get_openapi", slowly)
    monkeypatch.setattr(bench.api, "openapi_schema", None)
    with ThreadPoolExecutor(4) as threads:
        for answer in threads.map(bench.get, [f"{ADDRESS}?limit=1"] * 4):
            assert answer["experiments"]
    assert calls == [0]


def test_coverage_counts_everything_once(bench):
    found = bench.get("/coverage")
    assert found["x"]["name"] == "offset_x_m"
    assert sum(map(sum, found["number"])) == 30
    assert sum(map(sum, found["table"])) == 30
    assert found["shapes"] == ["pentagon", "square"]
    narrow = bench.get("/coverage?filter=shape=square&x=start_x_m&y=start_y_m")
    assert sum(map(sum, narrow["number"])) == len(ids(bench, "shape=square"))
    # Places are between their edges, so that a filter made of these finds them.
    x, y = found["x"], found["y"]
    for i, row in enumerate(found["number"]):
        for j, count in enumerate(row):
            bounds = (
                f"offset_x_m>={x['edges'][i]} offset_x_m<{x['edges'][i + 1]} "
                f"offset_y_m>={y['edges'][j]} offset_y_m<{y['edges'][j + 1]}"
            )
            if count:
                assert len(ids(bench, bounds)) == count


# --- one of them ------------------------------------------------------------------------------


def test_all_of_one(bench):
    one = bench.get(f"{ADDRESS}/3")
    assert one["key"].startswith("testbed/")
    assert one["flags"][0]["name"] == "misregistered"
    assert not one["deleted"]
    track = bench.get(f"{ADDRESS}/3/trajectory")
    stored = bench.context.store.experiment(3)
    np.testing.assert_array_equal(unpacked(track["time"]), stored.trajectory.time)
    np.testing.assert_array_equal(unpacked(track["pose"]), stored.trajectory.pose)
    felt = bench.get(f"{ADDRESS}/3/tactile")
    assert felt["measured"]["columns"] == ["fixel_1_bool", "fixel_2_bool", "fixel_3_bool"]
    assert len(felt["fixels"]) == 3


def test_its_simulations(bench):
    found = bench.get(f"{ADDRESS}/1/simulations")
    assert found["total"] == 1
    assert found["simulations"][0]["error_mm"] == pytest.approx(
        bench.get(ADDRESS)["experiments"][0]["before_mm"]
    )
    assert bench.get(f"{ADDRESS}/9/simulations") == {"total": 0, "simulations": []}


@pytest.mark.parametrize(
    "path", ["", "/trajectory", "/simulations", "/tactile", "/video", "/thumbnail.svg", "/outlines"]
)
def test_none_is_none(bench, path):
    assert bench.get(f"{ADDRESS}/999{path}", 404)["where"] == "experiment 999"
    assert bench.get(f"{ADDRESS}/0{path}", 422)["where"] == "path.number"
    assert bench.get(f"{ADDRESS}/99999999999{path}", 422)["where"] == "path.number"


@pytest.mark.parametrize("number", ["999", "0", "-1", "x", "9" * 30, "1e3", "٣٤٥"])
def test_a_page_of_none_says_so(bench, number):
    answer = bench.client.get(f"/experiments/{number}")
    assert answer.status_code == 404
    assert "there is no experiment" in answer.text


def test_thumbnails_are_kept_where_the_content_is_named(bench):
    content = bench.get(ADDRESS)["experiments"][0]["content"]
    named = bench.client.get(f"{RAW}/1/thumbnail.svg?content={content}")
    assert named.headers["content-type"] == "image/svg+xml"
    assert "immutable" in named.headers["cache-control"]
    assert named.text.count("<path") == 7  # three fixels, pusher, start, end, trail
    assert "no-store" in bench.client.get(f"{RAW}/1/thumbnail.svg").headers["cache-control"]


@pytest.mark.parametrize(("ending", "codec"), [(".mp4", "h264"), (".avi", "mjpeg")])
def test_a_video_by_ranges(bench, tmp_path, ending, codec):
    film = tmp_path / f"film{ending}"
    with VideoWriter(film, (32, 24), codec) as writer:
        for k in range(5):
            writer.write(Frame(k / 30.0, np.full((24, 32, 3), 40 * k, dtype=np.uint8)))
    video = bench.context.store.add_video(film)
    bare = bare_experiment(f"without a scene {ending}", video=video)
    number = bench.context.store.add_experiment(bare).id
    try:
        whole = bench.client.get(f"{RAW}/{number}/video")
        assert whole.status_code == 200
        played = tmp_path / "played.mp4"
        played.write_bytes(whole.content)
        times = [frame.time for frame in open_video(played).frames()]
        assert times == pytest.approx([k / 30.0 for k in range(5)], abs=1e-4)
        assert open_video(played).codec == "h264"
        assert whole.headers["content-type"] == "video/mp4"
        with videos._one_at_a_time:  # while another long one is written
            assert bench.client.get(f"{RAW}/{number}/video").content == whole.content
        part = bench.client.get(f"{RAW}/{number}/video", headers={"range": "bytes=4-7"})
        assert (part.status_code, part.content) == (206, b"ftyp")
        beyond = bench.client.get(f"{RAW}/{number}/video", headers={"range": "bytes=9999-"})
        assert beyond.status_code == 416
        assert bench.get(f"{ADDRESS}/{number}/outlines") == {"outlines": None}
        assert "<svg" in bench.client.get(f"{RAW}/{number}/thumbnail.svg").text
        assert "This experiment has no scene" in bench.client.get(f"/experiments/{number}").text
    finally:
        bench.context.store.delete([number])


# --- marks ------------------------------------------------------------------------------------


def test_notes_and_back(bench):
    made = bench.post(f"{ADDRESS}/note", {"ids": [7, 8], "text": " slipped early \n"})["changed"]
    assert [note["text"] for note in bench.get(f"{ADDRESS}/7")["notes"]] == ["slipped early"]
    assert ids(bench, "is:noted slipped") == [7, 8]
    assert bench.post("/notes/delete", {"ids": made}) == {"changed": made}
    assert bench.get(f"{ADDRESS}/7")["notes"] == []
    bench.post("/notes/undelete", {"ids": made[:1]})
    assert ids(bench, "is:noted") == [7]
    bench.post("/notes/delete", {"ids": made})


@pytest.mark.parametrize(("path", "body", "status"), [
    ("flag", {"ids": [1], "name": "Not So"}, 422),
    ("flag", {"ids": [], "name": "late"}, 422),
    ("flag", {"ids": [1, 999], "name": "late"}, 404),
    ("flag", {"ids": [2**31], "name": "late"}, 422),
    ("flag", {"ids": [1], "name": "late", "detail": "a\x00b"}, 422),
    ("flag", {"ids": [1], "name": "late", "odd": 1}, 422),
    ("note", {"ids": [1], "text": "   "}, 422),
    ("note", {"ids": [1], "text": "x" * 10_001}, 422),
    ("note", {"ids": [1], "text": "\ud800"}, 422),
    ("delete", {"ids": "all"}, 422),
    ("delete", None, 422),
])  # fmt: skip
def test_marks_that_cannot_be_change_nothing(bench, path, body, status):
    before = bench.get(ADDRESS)
    bench.post(f"{ADDRESS}/{path}", body, status)
    assert bench.get(ADDRESS) == before


def test_a_simulation_by_the_publisher_is_on_the_page(bench, tmp_path):
    folder = recordings.rpi_2dgad(tmp_path)
    bench.context.project.add(plan_import(folder))
    stored = bench.context.store.find("rpi-2dgad/7")

    page = bench.client.get(f"/experiments/{stored}").text
    assert "Simulation by the publisher of the data" in page
    (simulation,) = bench.get(f"{ADDRESS}/{stored}/simulations")["simulations"]
    assert simulation["method"] == {"simulated_by": "laboratory"}
    offered = bench.get(f"{ADDRESS}/{stored}/comparison")["sets"]
    assert [one["label"] for one in offered if one["kind"] == "simulation"] == [
        f"simulation {simulation['id']} by the publisher of the data"
    ]
