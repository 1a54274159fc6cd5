"""The gate and the conventions of the interface for programs."""

import http.client
import json
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest
from tests.jobs.helpers import await_true
from tests.processes import line_of

from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import StoreRefused
from fixel.web.palette import DARK, LIGHT, READABLE, ROLES, contrast_of, palette_css, readable
from fixel.web.problems import OUR_MISTAKE
from fixel.web.project import project_server
from fixel.web.security import MAX_BODY


def test_a_program_gets_in_with_the_token(bench):
    token = {"authorization": f"Bearer {bench.gate.token}"}
    answer = bench.stranger().get("/api/v1/project", headers=token)
    assert answer.status_code == 200
    assert answer.json()["name"] == "my_lab"
    assert answer.json()["datasets"] == {"testbed": 30}
    assert "set-cookie" not in answer.headers


@pytest.mark.parametrize(
    "header", ["Bearer guess", "Bearer ", "Basic {token}", "{token}", "Bearer {token} {token}"]
)
def test_and_with_nothing_else(bench, header):
    # Not even with the cookie: a program that sends a wrong token should hear of it.
    for client in (bench.client, bench.stranger()):
        sent = {"authorization": header.format(token=bench.gate.token)}
        answer = client.get("/api/v1/project", headers=sent)
        assert answer.status_code == 401
        assert answer.headers["www-authenticate"] == "Bearer"
        assert answer.json()["hint"]


def test_refusals_at_the_gate_are_documents(bench):
    answer = bench.stranger().get("/api/v1/project")
    assert answer.status_code == 403
    assert "link" in answer.json()["sentence"]


def test_what_is_not_there_is_a_document_below_api_and_a_page_elsewhere(bench):
    assert bench.get("/nothing", 404)["status"] == 404
    page = bench.client.get("/nothing")
    assert page.status_code == 404
    assert "Back to the first page" in page.text
    page = bench.client.get("/experiments/999").text
    assert page.count("fixel list shows all experiments") == 1


def test_a_page_of_damaged_records_is_not_called_missing(bench, monkeypatch):
    def fail(*_):
        raise StoreRefused("experiment 1 is damaged", "list the errors: fixel db check")

    monkeypatch.setattr(Store, "experiment", fail)
    page = bench.client.get("/experiments/1")
    assert page.status_code == 409
    assert "experiment 1 is damaged" in page.text
    assert "Page not found" not in page.text


def test_a_project_that_is_moved_or_deleted_is_not_shown_from_open_files(project, tmp_path):
    from tests.web.bench import Bench

    place = tmp_path / "lab"
    shutil.copytree(project, place)
    bench = Bench(place)
    flag = {"ids": [1], "name": "late", "detail": "the pusher stuck", "fault": True}
    place.rename(tmp_path / "moved")
    for again in (False, True):
        if again:  # another project in its place
            shutil.copytree(project, place)
        for path in ("/experiments", "/experiments/1", "/jobs", "/results", "/run/calibrate"):
            page = bench.client.get(path)
            assert page.status_code == 409, path
            assert f"{place} was moved or deleted" in page.text
        assert "moved or deleted" in bench.get("/experiments/1", 409)["sentence"]
        assert "moved or deleted" in bench.post("/experiments/flag", flag, 409)["sentence"]
    shutil.rmtree(place)
    (tmp_path / "moved").rename(place)
    assert bench.client.get("/experiments/1").status_code == 200
    bench.post("/experiments/flag", flag)
    bench.close()
    with Project(place).store() as store:
        assert "late" in {own.name for own in store.experiment(1).flags}


def test_an_unexpected_error_is_logged_for_who_started_it(bench, monkeypatch, caplog):
    def mistaken(*_, **__):
        raise KeyError("of ours")

    monkeypatch.setattr(Store, "experiments", mistaken)
    monkeypatch.setattr(Store, "experiment", mistaken)
    document = bench.client.get("/api/v1/experiments")
    page = bench.client.get("/experiments/1")
    assert (document.status_code, page.status_code) == (500, 500)
    assert document.json()["sentence"] == OUR_MISTAKE
    assert page.text == f"{OUR_MISTAKE}\n"
    for answer in (document, page):
        assert "of ours" not in answer.text
        assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert caplog.text.count("KeyError: 'of ours'") == 2
    assert "GET /experiments/1" in caplog.text


def test_everything_is_described(bench):
    described = bench.get("/openapi.json")
    assert described["servers"] == [{"url": "/api/v1"}]
    for path, entries in described["paths"].items():
        for method, entry in entries.items():
            assert entry["summary"], (method, path)
            assert entry["tags"], (method, path)
            assert "4XX" in entry["responses"], (method, path)


def descriptions(document):
    """All texts of one line in a document."""
    rows = document.values() if isinstance(document, dict) else document
    own = [document.get("description")] if isinstance(document, dict) else []
    yield from (text for text in own if isinstance(text, str) and "\n" not in text)
    for row in rows:
        if isinstance(row, dict | list):
            yield from descriptions(row)


def test_no_description_repeats_its_words(bench):
    texts = list(descriptions(bench.get("/openapi.json")))
    assert len(texts) > 400
    assert [text for text in texts if re.search(r"\b(\w+(?: \w+)*)\W+\1\b", text)] == []


def test_the_guide_names_every_operation(bench):
    guide = bench.client.get("/api").text
    for path in bench.get("/openapi.json")["paths"]:
        assert f"/api/v1{path}" in guide
    assert bench.gate.token not in guide


@pytest.mark.parametrize("text", ["", "{", "[]", '{"ids": [1],}', "\x00"])
def test_bodies_that_are_no_json_object_are_refused_in_one_sentence(bench, text):
    answer = bench.send("/experiments/delete", text)
    assert answer.status_code == 422
    wanted = ", but fixel needs a JSON object, sent with Content-Type: application/json"
    assert answer.json()["sentence"].startswith("body: found ")
    assert answer.json()["sentence"].endswith(wanted)


def test_long_bodies_are_refused(bench):
    assert bench.send("/project", b"x" * (MAX_BODY + 1)).status_code == 413


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("ground", [LIGHT, DARK])
def test_colours_can_be_read(role, ground):
    assert contrast_of(readable(ROLES[role], ground, READABLE), ground) >= 4.5


def test_the_palette_is_that_of_the_figures():
    assert "--body: #0072b2;" in palette_css()
    assert contrast_of("#000000", "#ffffff") == pytest.approx(21.0)


# --- the command ------------------------------------------------------------------------------


@pytest.mark.system
def test_the_command_prints_a_link_that_opens_and_ends_at_once(project):
    code = "from fixel.cli.main import run; run()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "serve", str(project), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            said = json.loads(line_of(process))
            assert said["project"] == "my_lab"
            page, _, token = said["link"].partition("?token=")
            asked = urllib.request.Request(
                f"{page}api/v1/project", headers={"Authorization": f"Bearer {token}"}
            )
            with urllib.request.urlopen(asked, timeout=60) as answer:
                assert json.load(answer)["name"] == "my_lab"
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 0
    assert token not in out + err


@pytest.mark.system
@pytest.mark.skipif(sys.platform != "linux", reason="a terminal of Linux, and its list of programs")
def test_no_other_user_reads_the_token_in_the_arguments_of_the_browser(project, tmp_path):
    """A browser of ours reports its arguments, and where the file it was given leads."""
    import pty

    seen, browser = tmp_path / "seen", tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\nprintf "%s" "$*" > {seen}.part; mv {seen}.part {seen}\n')
    browser.chmod(0o700)
    code = "from fixel.cli.main import run; run()"
    main, terminal = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code, "serve", str(project)],
        stdout=terminal,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "BROWSER": f"{browser} %s", "DISPLAY": ":0"},
    )
    try:
        await_true(lambda: seen.exists() or process.poll() is not None)
        address = seen.read_text()
        token = os.read(main, 100_000).decode().partition("?token=")[2].split()[0]
        assert token not in address
        door = Path(url2pathname(urlsplit(address).path))
        assert stat.S_IMODE(door.stat().st_mode) == 0o600
        assert f"?token={token}" in door.read_text()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
        assert not door.exists()
    finally:
        process.kill()
        process.wait()
        os.close(main)
        os.close(terminal)


def test_for_others_it_answers_to_its_own_names_and_no_other(bench):
    server = project_server(bench.context, host="0.0.0.0")
    with server:
        assert socket.gethostname() in server.link
        assert server.gate.token in server.link  # no option leaves it out
        for name, status in ((socket.gethostname(), 200), ("evil.example", 400)):
            line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
            line.request(
                "GET",
                "/api/v1/project",
                headers={"host": name, "authorization": f"Bearer {server.gate.token}"},
            )
            assert line.getresponse().status == status
            line.close()
