"""Tables and their scene through the interface for programs, and dropped on the page."""

import pytest
from tests.closed_form import push, table_text
from tests.fixtures import refused

import fixel
from fixel.workflows.project import importing as workflow

TABLE = table_text(*push(0.15, 0.02, duration=0.4))


def filled(template):
    half = "0.045"
    square = f"[[-{half}, -{half}], [{half}, -{half}], [{half}, {half}], [-{half}, {half}]]"
    text = template.replace("shape: FILL_IN", f"shape: {{polygon: {square}}}", 1)
    return text.replace("shape: FILL_IN", "shape: {disk: 0.005}").replace(
        "mass: FILL_IN", "mass: 1"
    )


def test_a_table_without_a_scene_is_answered_with_a_template(bench):
    asked = {"name": "mine.csv", "table": TABLE, "dry_run": True}
    read = bench.post("/import", asked)
    assert not read["has_scene"]
    assert not read["stored"]
    assert any("deg to rad" in sentence for sentence in read["understood"])

    asked = {"name": "mine.csv", "table": TABLE, "scene": filled(read["template"])}
    first, second = (bench.post("/import", asked) for _ in range(2))
    assert (first["has_scene"], first["stored"], first["known"]) == (True, True, False)
    assert (second["stored"], second["known"]) == (False, True)
    assert not first["replaced"]
    old = bench.context.store.find("csv/mine")
    other = bench.post("/import", asked | {"table": table_text(*push(0.15, 0.03, duration=0.4))})
    assert (other["stored"], other["replaced"]) == (True, True)
    number = bench.context.store.find("csv/mine")
    assert bench.get(f"/experiments/{old}")["replaced_by"] == number
    assert bench.context.store.experiment(number).scene is not None


def test_what_cannot_be_is_refused_in_a_sentence(bench):
    template = bench.post("/import", {"name": "a.csv", "table": TABLE})["template"]
    for asked in (
        {"name": "../a.csv", "table": TABLE},
        {"name": "a.csv", "table": "no table"},
        {"name": "a.csv", "table": TABLE, "scene": template},
        {"name": "a.csv", "table": TABLE.replace("theta_deg", "theta_rad")},
    ):
        answer = bench.post("/import", asked, 422)
        assert "fixel-import-" not in answer["sentence"]
        assert "scene" not in asked or answer["where"].startswith("scene: ")


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8"])
def test_bytes_of_other_encodings_are_refused_as_by_the_command(bench, tmp_path, encoding):
    header, *rows = TABLE.strip().splitlines()
    table = "\n".join([f"{header},Fläche", *(f"{row},Prüfstück" for row in rows)])
    file = tmp_path / "mine.csv"
    file.write_bytes(table.encode(encoding))
    # As a browser reads a file.
    asked = {"name": file.name, "table": file.read_bytes().decode("utf-8", "replace")}
    if encoding == "utf-8":
        bench.post("/import", asked)
        number = bench.context.store.find("csv/mine")
        assert bench.context.store.experiment(number).conditions["fläche"] == "Prüfstück"
        return
    answer = bench.post("/import", asked, 422)
    assert answer["sentence"] == str(refused(fixel.read_experiments, file))
    assert "not UTF-8" in answer["found"]


def two_pushes():
    """One table of two pushes, which its column `push` separates."""
    header, *rows = TABLE.strip().splitlines()
    other = table_text(*push(0.15, 0.03, duration=0.4)).strip().splitlines()[1:]
    return "\n".join(
        [f"{header},push", *(f"{row},a" for row in rows), *(f"{row},b" for row in other)]
    )


def test_a_table_of_several_pushes_is_separated_as_by_the_command(bench, tmp_path):
    store, asked = bench.context.store, {"name": "two.csv", "table": two_pushes()}
    answer = bench.post("/import", asked, 422)
    assert 'use split_by="push" if' in answer["hint"]
    answer = bench.post("/import", asked | {"split_by": "psh"}, 422)
    assert (answer["where"], answer["found"]) == ("split_by", "'psh'")

    read = bench.post("/import", asked | {"split_by": "push", "dry_run": True})
    asked |= {"split_by": "push", "scene": filled(read["template"])}
    first, second = (bench.post("/import", asked) for _ in range(2))
    assert [first[name] for name in ("stored", "known", "replaced")] == [2, 0, 0]
    assert [second[name] for name in ("stored", "known", "replaced")] == [0, 2, 0]
    torn = asked["table"] + "\n" + asked["table"].splitlines()[1][:-1] + "c\n"
    assert bench.post("/import", asked | {"table": torn})["skipped"] == ["two/c: one row"]
    table, scene = tmp_path / "two.csv", tmp_path / "scene.yaml"
    table.write_text(asked["table"])
    scene.write_text(asked["scene"])
    for read in fixel.read_experiments(table, split_by="push", scene=scene):
        stored = store.experiment(store.find(read.key))
        assert stored.trajectory.pose.tobytes() == read.trajectory.pose.tobytes()


@pytest.mark.system
def test_files_dropped_on_the_page_are_imported(browser_page, server):
    page = browser_page
    page.wait_for_selector("tr[data-id]")
    _, template, _ = workflow.import_texts(server.context.store, "a.csv", TABLE, None, dry_run=True)
    page.evaluate(
        """({ table, scene }) => {
            const dataTransfer = new DataTransfer();
            dataTransfer.items.add(new File([table], "dropped.csv"));
            dataTransfer.items.add(new File([scene], "mine.yaml"));
            dispatchEvent(new DragEvent("drop", { dataTransfer, cancelable: true }));
        }""",
        {"table": TABLE, "scene": filled(template)},
    )
    page.wait_for_selector("#import-do:not([disabled])")
    assert "follows its measured path" in page.inner_text("#import-read")
    page.click("#import-do")
    page.wait_for_selector(".toast")
    assert server.context.store.find("csv/dropped")


@pytest.mark.system
def test_a_column_separates_the_pushes_of_a_table_on_the_page(browser_page, server):
    page = browser_page
    page.expected_problems = ["422"]
    page.wait_for_selector("tr[data-id]")
    page.click("#show-import")
    table = {"name": "two.csv", "mimeType": "text/csv", "buffer": two_pushes().encode()}
    page.set_input_files("#import-tables", [table])
    page.wait_for_selector("#import-problem >> text=split_by")
    page.fill("#import-split", "push")
    page.press("#import-split", "Enter")
    page.wait_for_selector("#import-do:not([disabled])")
    page.click("#import-do")
    page.wait_for_selector(".toast >> text=Imported 2 experiments")
    assert page.is_hidden("#import")
    assert server.context.store.find("two/a")


@pytest.mark.system
def test_the_newest_reading_of_a_table_counts(browser_page, server):
    """An answer without the column, which arrives late, does not replace that with it."""
    page, late = browser_page, []
    page.expected_problems = ["422"]
    page.wait_for_selector("tr[data-id]")
    page.route("**/import", lambda route: route.continue_() if late else late.append(route))
    page.click("#show-import")
    table = {"name": "late.csv", "mimeType": "text/csv", "buffer": two_pushes().encode()}
    page.set_input_files("#import-tables", [table])
    page.fill("#import-split", "push")
    page.press("#import-split", "Enter")
    page.wait_for_selector("#import-do:not([disabled])")
    with page.expect_response("**/import") as answer:
        late[0].continue_()
    assert answer.value.status == 422
    page.wait_for_timeout(200)
    assert page.is_hidden("#import-problem")
    with page.expect_download() as download:
        page.click("#import-template")
    assert "shape: FILL_IN" in download.value.path().read_text()


@pytest.mark.system
def test_a_table_that_cannot_be_read_is_skipped_by_name(browser_page, server):
    page = browser_page
    page.expected_problems = ["422"]
    page.wait_for_selector("tr[data-id]")
    page.click("#show-import")
    files = {"good.csv": TABLE, "torn.csv": TABLE[: len(TABLE) // 2] + "x,y"}
    page.set_input_files(
        "#import-tables",
        [
            {"name": name, "mimeType": "text/csv", "buffer": text.encode()}
            for name, text in files.items()
        ],
    )
    page.wait_for_selector("#import-skipped")
    assert "torn.csv" in page.inner_text("#import-skipped")
    page.click("#import-do")
    page.wait_for_selector(".toast")
    assert "skipped torn.csv" in page.inner_text(".toast")
    assert server.context.store.find("csv/good")
