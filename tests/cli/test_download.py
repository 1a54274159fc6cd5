"""`fixel data`, with a server on this machine in place of the world's."""

import functools
import gc
import hashlib
import http.server
import socket
import threading

import pytest
from tests.cli.shell import fixel, json_of

CONTENT = b"time_s,x_mm,y_mm,theta_deg\n0.0,1,2,3\n0.1,1,2,3\n"


@pytest.fixture
def site(tmp_path):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "run.csv").write_bytes(CONTENT)

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    handler = functools.partial(Quiet, directory=str(tmp_path / "site"))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_every_dataset_has_a_licence_and_a_citation(capsys):
    known = json_of(capsys, "data")["datasets"]
    assert {entry["name"] for entry in known} == {
        "rpi-2dgad", "mit-push", "mit-pusher-slider", "cmu-tripod", "cmu-two-point",
    }  # fmt: skip
    assert all(entry["licence"] and entry["citation"] for entry in known)
    assert "licence:" in fixel(capsys, "data")[1]


def test_a_file_is_fetched_and_checked(site, tmp_path, capsys):
    digest = hashlib.sha256(CONTENT).hexdigest()
    folder = tmp_path / "data"
    answer = json_of(capsys, "data", f"{site}/run.csv", "-o", folder, "--sha256", digest)
    assert answer["sha256"] == digest
    assert (folder / "run.csv").read_bytes() == CONTENT


def test_another_file_than_asked_for_is_not_kept(site, tmp_path, capsys):
    folder = tmp_path / "data"
    code, _, err = fixel(capsys, "data", f"{site}/run.csv", "-o", folder, "--sha256", "0" * 64)
    assert code == 1
    assert "is not the requested file" in err
    assert not [p for p in folder.iterdir() if p.is_file()]


def test_without_a_checksum_it_is_reported(site, tmp_path, capsys):
    code, out, err = fixel(capsys, "data", f"{site}/run.csv", "-o", tmp_path / "data")
    assert code == 0
    assert hashlib.sha256(CONTENT).hexdigest() in out
    assert "No checksum" in err


@pytest.mark.parametrize(("url", "code", "says"), [
    ("{site}/nothing.csv", 1, "could not be downloaded"),
    ("run.csv", 2, "http"),
    ("{site}/", 2, "FILE"),
])  # fmt: skip
def test_addresses_that_lead_nowhere(site, tmp_path, capsys, url, code, says):
    found, _, err = fixel(capsys, "data", url.format(site=site), "-o", tmp_path / "data")
    assert found == code
    assert says in err


def test_a_refused_download_leaves_no_connection_open(site, tmp_path, capsys):
    server = ("127.0.0.1", int(site.rpartition(":")[2]))
    gc.disable()  # or the collector hides what was left open
    try:
        fixel(capsys, "data", f"{site}/nothing.csv", "-o", tmp_path / "data")
        # Not `isinstance`, which asks proxies of other tests, whose objects may be gone.
        sockets = [each for each in gc.get_objects() if issubclass(type(each), socket.socket)]
        assert not [each for each in sockets if each.fileno() >= 0 and _peer(each) == server]
    finally:
        gc.enable()


def _peer(connection):
    try:
        return connection.getpeername()
    except OSError:  # not connected, or already gone
        return None
