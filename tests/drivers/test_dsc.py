"""The Mantracourt DSC driver: the manual's messages, any bytes, and every way an answer can fail."""

import time

import numpy as np
import pytest

from drivers.dsc_load_cell import DscLoadCell, DscLoadCellConfig, DscReply, decode_number, read_command
from drivers.errors import FrameError
from drivers.records import SCALAR
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.serial_script import MS, AskedFlight, Pty, run_for

S = 1_000_000_000


def test_the_manuals_read():
    assert read_command(1, "SOUT") == b"!001:SOUT?\r"  # manual, "Read Command"
    assert read_command(14, "CELL") == b"!014:CELL?\r"


@pytest.mark.parametrize(
    ("text", "counts", "decimals"),
    [
        (b"+00032.100", 32100, 3),  # manual: value 32.1, DP = 3, DPB = 5
        (b"-00032.100", -32100, 3),
        (b"+0.0000000", 0, 7),
        (b"-1.", -1, 0),
        (b"+12", 12, 0),
    ],
)
def test_numbers(text, counts, decimals):
    assert decode_number(text) == (counts, decimals)


@pytest.mark.parametrize(
    "bad", [b"", b"?", b"32.1", b"+", b"+.5", b"+1.2.3", b"+1e3", b" +1.0", b"+1.0\n", b"+\xb2", b"!001"]
)
def test_what_is_no_number_is_refused(bad):
    with pytest.raises(FrameError):
        decode_number(bad)


def fed(data: bytes, bytewise: bool):
    answer = DscReply()
    made = None
    for piece in [data[n : n + 1] for n in range(len(data))] if bytewise else [data]:
        assert made is None
        made = answer.receive(piece)
    return made


@pytest.mark.parametrize("bytewise", [False, True])
@pytest.mark.parametrize("text", [b"+00032.100", b"", b"?"])
def test_an_answer_ends_with_cr(text, bytewise):
    assert fed(text + b"\r", bytewise) == text
    assert fed(text, bytewise) is None


@pytest.mark.parametrize("bad", [b"+1.0\r\n", b"+1.0\r+2", b"x" * 33])
def test_too_many_bytes_are_refused(bad):
    with pytest.raises(FrameError):
        DscReply().receive(bad)


class DscModel:
    """A digitiser typed from the manual: DPB digits, a point, DP digits; nothing for another station."""

    def __init__(self, station: int = 1) -> None:
        self.station, self.value, self.before, self.after = station, 32.1, 5, 3
        self.deaf, self.says = False, b""
        self.commands: list[bytes] = []

    def receive(self, data: bytes) -> bytes:
        self.commands.append(data)
        assert data.startswith(b"!")
        assert data.endswith(b"\r")
        if self.deaf or int(data[1:4]) != self.station:
            return b""
        if self.says:
            return self.says
        return b"%+0*.*f\r" % (self.before + self.after + 2, self.after, self.value)


class Flight(AskedFlight):
    """A digitiser that answers 2 ms after the question."""

    def __init__(self, clock, delay_ns=2 * MS, **config) -> None:
        self.dsc, settings = DscModel(), DscLoadCellConfig(**config)
        super().__init__(clock, self.dsc, lambda port: DscLoadCell("cell", port, clock, settings), delay_ns)

    def rows(self):
        return whole(self.batches, "cell")


def test_rows_carry_the_digits(flight):
    flight.fly(50)
    flight.dsc.value = -0.25
    flight.fly(50)
    rows = flight.rows()
    assert len(rows) == 50
    assert (rows["value_raw"][0], rows["value_raw"][-1]) == (32100, -250)
    assert set(rows["scale"]) == {1e-3}
    assert set(rows["unit"]) == {b"N"}
    assert set(rows["host_ns"] - rows["tick"].astype(np.int64)) == {2 * MS}
    assert set(flight.dsc.commands) == {b"!001:SOUT?\r"}
    assert flight.device.channels == {"cell": SCALAR}
    assert codes(flight.batches) == ["started"]


def test_a_command_that_is_not_taken_is_told(flight):
    flight.dsc.says = b"?\r"
    flight.fly(50)
    flight.dsc.says = b""
    flight.fly(50)
    flight.rows()
    assert "SOUT" in texts(flight.batches, "refused")[0]
    assert of(flight.batches, "gap")["cause"].tolist() == [b"refused"]


@pytest.mark.parametrize("says", [b"+0032.100\r", b"+00032.10\r", b"garbage\r", b"\r", b"+00032.100\r\r", b"\xff" * 40])
def test_an_answer_of_another_form_is_a_bad_frame(flight, says):
    flight.fly(10)
    flight.dsc.says = says
    flight.fly(20)
    flight.dsc.says = b""
    flight.fly(50)
    rows = flight.rows()
    assert set(rows["value_raw"]) == {32100}
    assert "bad_frame" in codes(flight.batches)
    assert set(of(flight.batches, "gap")["cause"]) == {b"bad_frame"}


def test_a_form_may_change_with_the_port_opened_anew(flight):
    flight.fly(10)
    flight.port.broken = True
    flight.fly(20)
    flight.port.broken = False
    flight.dsc.after = 4
    flight.fly(100)
    assert flight.rows()["scale"][-1] == 1e-4


def test_a_digitiser_that_is_away_is_told_and_found_again(flight):
    flight.fly(10)
    flight.dsc.deaf = True
    flight.fly(2000)
    flight.dsc.deaf = False
    flight.fly(200)
    rows = flight.rows()
    assert codes(flight.batches) == ["started", "no_answer", "silent", "bus_recovered"]
    assert len(rows) > 50


def test_it_works_on_a_pty_that_waits():
    dsc = DscModel()
    pty = Pty(dsc.receive)
    device = DscLoadCell("cell", lambda: pty.open(timeout=0.05), time.monotonic_ns, DscLoadCellConfig(poll_period_ms=0))
    batches = run_for(device, "cell", 50)
    pty.close()
    rows = whole(batches, "cell")
    assert set(rows["value_raw"]) == {32100}
    # a port that waits returns with the last byte, not when its time is over
    assert np.median(rows["host_ns"] - rows["tick"].astype(np.int64)) < 10 * MS
