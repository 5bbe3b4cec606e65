"""The Modbus load cell driver against a transmitter typed from the manual, and against pymodbus."""

import asyncio
import threading
import time

import numpy as np
import pytest
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.modbus_load_cell import ModbusLoadCell, ModbusLoadCellConfig
from drivers.records import SCALAR, SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.modbus_model import TransmitterModel, framed
from tests.drivers.serial_script import MS, AskedFlight, Pty, ScriptedSerial, run_for

S = 1_000_000_000


class Flight(AskedFlight):
    """A transmitter that answers ``delay_ns`` after the question."""

    def __init__(self, clock, delay_ns=4 * MS, **config) -> None:
        self.cell, settings = TransmitterModel(gross=-1500, net=200), ModbusLoadCellConfig(**config)
        super().__init__(clock, self.cell, lambda port: ModbusLoadCell("cell", port, clock, settings), delay_ns)

    def rows(self, channel="cell"):
        return whole(self.batches, channel)


def test_it_asks_as_fast_as_the_link_allows(flight):
    flight.fly(600)
    rows = flight.rows()
    assert len(rows) == 100  # 4 ms for the answer, 1.75 ms of silence
    assert set(rows["value_raw"]) == {-1500}
    assert set(rows["scale"]) == {0.001}
    assert set(rows["unit"]) == {b"kg"}
    assert set(rows["status"]) == {0}
    assert set(rows["device_status"]) == {0x80}
    assert set(flight.cell.requests) == {framed(bytes.fromhex("01 03 00 06 00 08"))}
    assert flight.device.channels == {"cell": SCALAR}
    assert codes(flight.batches) == ["scale", "started"]
    assert texts(flight.batches, "scale") == ["division and unit code 000Fh, 0.001 kg per count"]
    assert flight.device.period_ns == MS


def test_the_two_stamps_enclose_the_sample(flight):
    flight.fly(100)
    rows = flight.rows()
    asked, answered = rows["tick"].astype(np.int64), rows["host_ns"]
    assert set(answered - asked) == {4 * MS}
    assert np.all(asked[1:] - answered[:-1] >= 1_750_000)


def test_a_sample_period_is_kept_on_average(clock):
    flight = Flight(clock, sample_period_ms=12.5)
    flight.start()
    flight.fly(2000)
    assert len(flight.rows()) == 160


def test_both_weights(clock):
    flight = Flight(clock, values=("net", "gross"))
    flight.start()
    flight.fly(20)
    assert list(flight.device.channels) == ["cell_net", "cell_gross"]
    assert set(flight.rows("cell_net")["value_raw"]) == {200}
    assert set(flight.rows("cell_gross")["value_raw"]) == {-1500}
    flight.cell.deaf = True
    flight.fly(250)
    flight.cell.deaf = False
    flight.fly(100)
    assert len(of(flight.batches, "gap")) == 2
    flight.rows("cell_net")


def test_another_unit_is_told_and_its_rows_are_not_valid(flight):
    flight.fly(20)
    flight.cell.unit = 4
    flight.fly(20)
    assert codes(flight.batches)[-1] == "unit_unknown"
    rows = flight.rows()
    assert rows["status"][-1] == SampleStatus.NOT_VALID
    assert rows["scale"][-1] == 0.0
    flight.cell.unit, flight.cell.division = 0, 12
    flight.fly(1000)
    assert flight.rows()["scale"][-1] == 0.01


@pytest.mark.parametrize("code", [1, 2, 3])
def test_exceptions_are_told_and_named(flight, code):
    flight.fly(50)
    flight.cell.exception = code
    flight.fly(50)
    flight.cell.exception = 0
    flight.fly(50)
    rows = flight.rows()
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"refused"
    assert codes(flight.batches).count(f"exception_{code}") == 1
    assert len(rows) == 25 - (gap["last_missing"] - gap["first_missing"] + 1)


def test_a_map_with_too_few_registers_is_told(clock):
    flight = Flight(clock)
    flight.cell.registers = 10
    flight.start()
    flight.fly(50)
    assert "Laumas map" in texts(flight.batches, "exception_2")[0]


def test_no_answer_is_a_gap_and_then_an_event(flight):
    flight.fly(60)
    flight.cell.deaf = True
    flight.fly(1000)
    assert codes(flight.batches).count("no_answer") == 1
    flight.cell.deaf = False
    flight.fly(300)
    rows = flight.rows()
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"no_answer"
    assert S < gap["duration_ns"] < 1.2 * S
    assert gap["last_missing"] - gap["first_missing"] + 1 == 10
    assert len(rows) > 50


def test_a_transmitter_that_stays_away_has_its_port_opened_anew(flight):
    flight.fly(60)
    flight.cell.deaf = True
    flight.fly(5000)
    assert flight.port.opened == 3
    assert codes(flight.batches).count("silent") == 1
    flight.cell.deaf = False
    flight.fly(300)
    assert codes(flight.batches)[-1] == "bus_recovered"
    flight.rows()


def test_a_late_answer_does_not_pass_for_the_next_one(flight):
    flight.fly(60)
    flight.delay_ns = 102 * MS
    flight.cell.gross = 1
    flight.fly(99)
    flight.fly(4)  # no answer yet: the next question asks for a register more
    flight.delay_ns = 4 * MS
    flight.cell.gross = 2
    flight.fly(100)
    rows = flight.rows()
    assert 1 not in rows["value_raw"].tolist()
    assert rows["value_raw"][-1] == 2
    assert set(rows["host_ns"] - rows["tick"].astype(np.int64)) == {4 * MS}
    longer = framed(bytes.fromhex("01 03 00 06 00 09"))
    assert longer in flight.cell.requests
    assert flight.cell.requests[-1] != longer


@pytest.mark.parametrize("junk", [b"\x00", b"\xff\xff\xff", bytes(30)])
def test_junk_between_two_answers_is_told_and_silence_is_waited_for(flight, junk):
    flight.fly(61)
    flight.port.say(junk)
    flight.fly(100)
    rows = flight.rows()
    assert codes(flight.batches).count("bad_frame") == 1
    assert len(rows) > 20


def test_a_spoiled_answer_is_told_and_named(flight):
    flight.fly(60)
    due, answer = flight.coming[0]
    flight.coming[0] = due, answer[:8] + bytes([answer[8] ^ 4]) + answer[9:]
    flight.fly(60)
    flight.rows()
    assert of(flight.batches, "gap")["cause"].tolist() == [b"bad_frame"]
    assert flight.device.bad_frames == 1


def test_each_bad_answer_counts(flight):
    flight.fly(60)
    receive = flight.cell.receive
    flight.cell.receive = lambda request: receive(request)[:-1] + b"\0"
    flight.fly(100)
    flight.cell.receive = receive
    flight.fly(60)
    (gap,) = of(flight.batches, "gap")
    assert flight.device.bad_frames == gap["last_missing"] - gap["first_missing"] + 1 > 3
    assert len(flight.rows()) > 15


def refuses(flight):
    flight.cell.exception = 2


def spoils(flight):
    receive = type(flight.cell).receive
    flight.cell.receive = lambda request: receive(flight.cell, request)[:-1] + b"\0"


def is_deaf(flight):
    flight.cell.deaf = True


@pytest.mark.parametrize(
    ("faults", "counted"),
    [((refuses,), 1), ((spoils,), 0), ((is_deaf,), 0), ((refuses, is_deaf), 0), ((is_deaf, refuses), 0)],
)
def test_losses_are_counted_where_a_valid_answer_came_to_each_request(clock, faults, counted):
    """Else nobody knows whether the transmitter had the request, and made a sample."""
    flight = Flight(clock)
    flight.start()
    flight.fly(60)
    for fault in faults:
        flight.cell.exception, flight.cell.deaf = 0, False
        fault(flight)
        flight.fly(250)
    flight.cell.exception, flight.cell.deaf = 0, False
    flight.cell.__dict__.pop("receive", None)
    flight.fly(200)
    refuses(flight)
    flight.fly(50)
    flight.cell.exception = 0
    flight.fly(100)
    first, second = of(flight.batches, "gap")
    assert first["counted"] == counted
    assert second["counted"] == 1  # an estimate before it does not matter
    flight.rows()


def test_a_port_that_is_gone_is_told_once_and_opened_again(flight):
    flight.fly(60)
    flight.port.broken = True
    flight.fly(1000)
    assert codes(flight.batches).count("bus_error") == 1
    flight.port.broken = False
    flight.fly(1500)
    assert codes(flight.batches)[-1] == "bus_recovered"
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"port_lost"
    assert gap["first_missing"] == gap["last_missing"]  # without a sample period nobody can say how many
    flight.rows()


def test_with_a_sample_period_an_outage_is_counted(clock):
    flight = Flight(clock, sample_period_ms=10.0)
    flight.start()
    flight.fly(100)
    flight.port.broken = True
    flight.fly(1000)
    flight.port.broken = False
    flight.fly(1500)
    rows = flight.rows()
    away = int(np.argmax(np.diff(rows["sequence"])))
    asked = rows["tick"].astype(np.int64)
    assert rows["sequence"][away + 1] - rows["sequence"][away] == round((asked[away + 1] - asked[away]) / (10 * MS))


def test_a_stop_names_the_open_question(flight):
    flight.fly(62)
    flight.stop()
    flight.rows()
    [gap] = of(flight.batches, "gap")
    assert (gap["cause"], gap["counted"]) == (b"stopped", 0)  # the answer did not come: was there a sample?
    assert not flight.port.is_open
    flight.start()
    flight.fly(60)
    flight.rows()
    assert flight.device.pump(flight.clock()) is not None


def test_a_device_that_is_not_started_does_nothing(clock):
    port = ScriptedSerial()
    device = ModbusLoadCell("cell", port.open, clock)
    assert device.pump(clock()) == []
    assert device.stop(clock()) == []
    assert port.calls == 0


def test_a_write_that_is_taken_in_part_is_a_fault(clock):
    flight = Flight(clock)
    flight.port.write = lambda data: len(data) - 1
    flight.start()
    assert "7 of 8 bytes" in texts(flight.batches, "bus_error")[0]


# Real time


def test_it_works_on_a_pty():
    cell = TransmitterModel(gross=-42)
    pty = Pty(cell.receive)
    batches = run_for(ModbusLoadCell("cell", pty.open, time.monotonic_ns), "cell", 20, lambda _: time.sleep(5e-4))
    pty.close()
    rows = whole(batches, "cell")
    assert len(rows) == 20
    assert set(rows["value_raw"]) == {-42}
    assert np.median(rows["host_ns"] - rows["tick"].astype(np.int64)) < 10 * MS


class PymodbusServer:
    """pymodbus serving a Laumas map on one end of a pty, bridged to a second one that the driver opens."""

    def __init__(self, registers: dict[int, int], count: int = 32) -> None:
        self._server: ModbusSerialServer | None = None
        self.toward_server = Pty(lambda data: self._bridge(self.toward_driver, data))
        self.toward_driver = Pty(lambda data: self._bridge(self.toward_server, data))
        self._values = [registers.get(number, 0) for number in range(40001, 40001 + count)]
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        assert self._ready.wait(10.0)

    @staticmethod
    def _bridge(other: Pty, data: bytes) -> bytes:
        other.say(data)
        return b""

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        device = SimDevice(1, [SimData(0, values=self._values, datatype=DataType.REGISTERS)])
        self._server = ModbusSerialServer(device, port=self.toward_server.path, baudrate=115_200)
        task = asyncio.create_task(self._server.serve_forever())
        await asyncio.sleep(0.2)
        self._ready.set()
        await task

    def close(self) -> None:
        assert self._server is not None
        asyncio.run_coroutine_threadsafe(self._server.shutdown(), self._loop).result(10.0)
        self._thread.join(10.0)
        self.toward_server.close()
        self.toward_driver.close()


def test_pymodbus_serves_our_driver():
    server = PymodbusServer({40007: 0x0180, 40008: 0x0001, 40009: 0xE240, 40011: 77, 40014: 0x000F})
    config = ModbusLoadCellConfig(values=("gross", "net"))
    device = ModbusLoadCell("cell", server.toward_driver.open, time.monotonic_ns, config)
    batches = run_for(device, "cell_gross", 30, lambda _: time.sleep(5e-4), seconds=8.0)
    server.close()
    gross = whole(batches, "cell_gross")
    assert len(gross) == 30
    assert set(gross["value_raw"]) == {-123456}
    assert set(whole(batches, "cell_net")["value_raw"]) == {-77}
    assert set(gross["scale"]) == {0.001}
    assert codes(batches) == ["scale", "started", "stopped"]


def test_pymodbus_refuses_registers_it_has_not():
    server = PymodbusServer({}, count=10)
    device = ModbusLoadCell("cell", server.toward_driver.open, time.monotonic_ns)
    batches = run_for(device, "cell", 1, lambda _: time.sleep(5e-4), seconds=1.0)
    server.close()
    assert "exception_2" in codes(batches)
    assert of(batches, "cell").size == 0
