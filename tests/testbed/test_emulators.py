"""Emulated hardware fails loudly, and ends, if it or its program hangs."""

import os
import threading

import pytest

from fixel.testbed.emulators import bench as emulated_mega
from fixel.testbed.emulators.bench import EmulatedMega
from fixel.testbed.emulators.grbl import EmulatedGrbl


def test_a_controller_whose_program_reads_nothing_can_be_ended():
    controller = EmulatedGrbl()
    port = os.open(controller.port, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
    for _ in range(100):
        os.write(port, 100 * b"?")
    ending = threading.Thread(target=controller.close, daemon=True)
    ending.start()
    ending.join(60.0)
    os.close(port)

    assert not ending.is_alive()


def board_that(does: str, folder) -> EmulatedMega:
    program = folder / "emulated_mega"
    program.write_text(f"#!/bin/sh\n{does}\n")
    program.chmod(0o755)
    return EmulatedMega(folder)


def test_a_board_that_does_not_start_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(emulated_mega, "ANSWERS_WITHIN", 0.2)
    with pytest.raises(RuntimeError, match="did not start"):
        board_that("exec sleep 60", tmp_path)


def test_a_board_that_hangs_is_reported(tmp_path, monkeypatch):
    with board_that("echo ready; exec sleep 60", tmp_path) as board:
        monkeypatch.setattr(emulated_mega, "ANSWERS_WITHIN", 0.2)
        with pytest.raises(RuntimeError, match=r"no answer within 0\.2 s"):
            board.touch(1)


def test_a_board_that_died_is_reported(tmp_path):
    with (
        board_that("echo ready; read line", tmp_path) as board,
        pytest.raises(RuntimeError, match="received 'time'"),
    ):
        print(board.time)
