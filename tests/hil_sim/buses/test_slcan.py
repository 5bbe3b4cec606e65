"""The adapter's protocol: Lawicel's lines on a pseudo-terminal."""

import contextlib
import os

import pytest

from drivers.ports import CanFrame
from hil_sim.buses.can.slcan import SlcanAdapter


class Terminal:
    """A client of the adapter that writes and reads raw lines."""

    def __init__(self):
        self.adapter = SlcanAdapter()
        self.fd = os.open(self.adapter.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def say(self, text):
        os.write(self.fd, text)
        sent = self.adapter.take()
        return self.hear(), sent

    def hear(self):
        heard = b""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self.fd, 4096):
                heard += data
        return heard

    def close(self):
        os.close(self.fd)
        self.adapter.close()


@pytest.fixture
def terminal():
    terminal = Terminal()
    yield terminal
    terminal.close()


@pytest.mark.parametrize(
    ("said", "heard"),
    [
        (b"V\r", b"V1013\r"),
        (b"v\r", b"v0107\r"),
        (b"N\r", b"NHIL0\r"),
        (b"\r\r", b"\r\r"),
        (b"O\r", b"\a"),  # no bit rate yet
        (b"S6\rO\r", b"\r\r"),
        (b"S6\rO\rO\r", b"\r\r\a"),
        (b"S6\rO\rS5\r", b"\r\r\a"),
        (b"S6\rO\rC\rC\r", b"\r\r\r\a"),
        (b"S9\r", b"\a"),
        (b"Sx\r", b"\a"),
        (b"s001C\rO\r", b"\r\r"),
        (b"F\r", b"\a"),
        (b"S6\rL\rF\r", b"\r\rF00\r"),
        (b"Z1\rZ0\rM00000000\rmFFFFFFFF\r", b"\r\r\r\r"),
        (b"Q\r", b"\a"),
        (b"t1230\r", b"\a"),  # closed
        (b"S6\rO\rt1232\r", b"\r\r\a"),  # data missing
        (b"S6\rO\rt12311\r", b"\r\r\a"),  # half a byte
        (b"S6\rO\rt1239000000000000000000\r", b"\r\r\a"),
        (b"S6\rO\rtxyz0\r", b"\r\r\a"),
        (b"S6\rO\rR000001230\rT000001231AA\r", b"\r\rZ\rZ\r"),
        (b"S6\rL\rt1230\r", b"\r\r\a"),
    ],
)
def test_commands(terminal, said, heard):
    assert terminal.say(said) == (heard, [])


def test_a_remote_frame_asks_for_so_many_bytes(terminal):
    terminal.say(b"S6\rO\r")
    assert terminal.say(b"r7011\r") == (b"z\r", [(0x701, 1)])


def test_a_frame_in_one_piece_and_in_single_bytes(terminal):
    terminal.say(b"S6\rO\r")
    assert terminal.say(b"t601840001000aB02Cd04\r") == (b"z\r", [(0x601, bytes.fromhex("40001000AB02CD04"))])
    got = []
    for byte in b"t0002010A\r":
        got += terminal.say(bytes([byte]))[1]
    assert got == [(0, b"\x01\x0a")]


def test_a_line_that_never_ends_is_forgotten(terminal):
    terminal.say(b"x" * 5000)
    assert terminal.say(b"\rV\r")[0] == b"\rV1013\r"


def test_frames_are_written_as_lines_with_stamps_when_asked(terminal):
    terminal.say(b"S6\rO\r")
    frame = CanFrame(61_234_000_000, 0x0A1, b"\x0f\xf0")
    terminal.adapter.give([frame])
    assert terminal.hear() == b"t0A120FF0\r"
    terminal.say(b"Z1\r")
    terminal.adapter.give([frame])
    assert terminal.hear() == b"t0A120FF004D2\r"  # 61,234 ms modulo 60,000


def test_a_client_that_does_not_read_loses_frames_and_is_told(terminal):
    terminal.say(b"S6\rO\r")
    for _ in range(20_000):
        terminal.adapter.give([CanFrame(0, 0x281, bytes(4))])
    assert terminal.adapter.lost > 1000
    lines = b""
    while data := terminal.hear():
        lines += data
        terminal.adapter.give([])
        terminal.adapter.take()
    assert set(lines.split(b"\r")) == {b"t281400000000", b""}  # whole lines only
    assert lines.count(b"\r") == 20_000 - terminal.adapter.lost
    assert terminal.say(b"F\rF\r")[0] == b"F01\rF00\r"
