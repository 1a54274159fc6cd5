"""The firmware as a program of the thesis meets it: bytes on a port, nothing of fixel between."""

import subprocess

import pytest
import serial

from fixel.testbed import tactile_protocol as frames

pytestmark = pytest.mark.system

IDENTITY_REPLY_BYTES = 4 + 25 + 2


@pytest.fixture
def port(mega):
    with serial.Serial(mega.port, frames.BAUD, timeout=2.0) as opened:
        yield opened


def asked(port: serial.Serial, question: bytes, size: int) -> bytes:
    port.write(question)
    return port.read(size)


def test_the_board_says_nothing_unasked(port):
    port.timeout = 0.05

    assert port.read(1) == b""


def test_an_old_program_gets_the_old_byte_for_any_single_byte(mega, port):
    for bits, question in enumerate((b"?", b"\x00", b"a", b"\xff", b"R", b"\xfa", b"\xf5", b"?")):
        mega.touch(bits)
        assert asked(port, question, 1) == bytes([bits])


NO_REQUESTS = {
    "beginnings alone": b"\xf5\xf5\xf5",
    "no such kind": b"\xf5Q",
    "wrong checksum": b"\xf5R\x01ab",
    "thresholds with a wrong checksum": b"\xf5T\x01" + bytes(8),
    "as many as its buffer holds": bytes(range(60)),
}


def test_whatever_is_no_request_gets_a_byte_for_a_byte(mega, port):
    mega.touch(3)

    for name, sent in NO_REQUESTS.items():
        assert asked(port, sent, len(sent)) == b"\x03" * len(sent), name


def behind(ohm):
    """Volts at the pin: 5 V through the contact to it, and 2 kOhm from there to ground."""
    return 5.0 * 2000.0 / (2000.0 + ohm)


def test_a_fixel_is_touched_above_900_of_1023(mega, port):
    """The limit lets a contact bridge the coils of the thesis."""
    mega.touch(0)
    off, on = (4.39, behind(285), behind(1e9)), (4.42, behind(0), behind(260))
    for touched, every in ((0, off), (2, on)):
        for volts in every:
            mega.volts(1, volts)
            assert asked(port, b"?", 1) == bytes([touched]), volts


def test_a_request_behind_a_stray_beginning_is_understood(mega, port):
    mega.touch(6)

    answer = asked(port, b"\xf5" + frames.request(frames.READ, 7), 1 + frames.READ_REPLY_BYTES)

    assert answer[0] == 6
    (frame,) = frames.FrameFinder().add(answer[1:])
    bits, _, values = frames.reading_of(frame)
    assert (frame.number, bits, frame.content[0]) == (7, 6, 2)
    assert values[0] < 100 < 900 < values[1]


def test_the_emulator_takes_no_file_away(mega_folder, tmp_path):
    (tmp_path / "notes").write_text("mine")
    command = [mega_folder / "emulated_mega", mega_folder / "tactile.elf", tmp_path / "notes"]
    done = subprocess.run(command, input="", capture_output=True, text=True, timeout=60.0)

    assert (done.returncode, "exists" in done.stderr) == (1, True)
    assert (tmp_path / "notes").read_text() == "mine"


def test_what_stands_behind_a_late_found_request_is_answered_too(mega, port):
    mega.touch(6)
    question = b"\xf5T" + frames.request(frames.READ, 7) + b"abcd"  # of thresholds, at first sight

    answer = asked(port, question, 2 + frames.READ_REPLY_BYTES + 4)

    assert answer[:2] + answer[-4:] == b"\x06" * 6
    assert len(frames.FrameFinder().add(answer[2:-4])) == 1


def test_contacts_change_at_the_scripted_time(mega, port):
    mega.touch(0)
    mega.touch(1, after=0.05)

    first = asked(port, b"?", 1)
    port.timeout = 0.06
    port.read(1)

    assert first == b"\x00"
    port.timeout = 2.0
    assert asked(port, b"?", 1) == b"\x01"


def test_thresholds_above_what_the_converter_gives_are_refused(mega, port):
    def thresholds(*values):
        request = frames.request(frames.SET_THRESHOLDS, 3, *values)
        (frame,) = frames.FrameFinder().add(asked(port, request, IDENTITY_REPLY_BYTES))
        return frames.identity_of(frame).thresholds

    assert thresholds(500, 600, 700) == (500, 600, 700)
    assert thresholds(500, 1024, 400) == (500, 600, 700)
    assert thresholds(65535, 600, 700) == (500, 600, 700)
    assert thresholds(1023, 0, 900) == (1023, 0, 900)
