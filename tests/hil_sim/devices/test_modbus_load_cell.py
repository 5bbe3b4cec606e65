"""The Modbus twin against the Laumas register map and "Modbus over serial line" V1.02, typed here; and its peers.

pymodbus and minimalmodbus, unmodified, talk to it over a pseudo-terminal.
"""

import time

import hypothesis.strategies as st
import minimalmodbus
import pytest
from hypothesis import given
from pymodbus.client import ModbusSerialClient

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import PtySerial
from hil_sim.devices.serial_line.modbus_load_cell import DIVISIONS, ModbusLoadCellTwin, crc16
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.serial_bench import Line, RealTime
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock

STATUS, GROSS, NET, PEAK, DIVISION = 6, 7, 9, 11, 13
GROSS_NEGATIVE, NET_NEGATIVE, PEAK_NEGATIVE, NET_MODE, STABLE, NEAR_ZERO = 0x80, 0x100, 0x200, 0x400, 0x800, 0x1000


class Bench(Line):
    """A transmitter that has started, with a force of ``force`` N on its cell."""

    def __init__(self, force=0.0, **options):
        self.force = force
        self.analog = Analog(lambda t: self.force(t) if callable(self.force) else self.force)
        super().__init__(ModbusLoadCellTwin(self.analog, RateClock(), START_NS, **options))
        self.run(600)

    def frame(self, hexadecimal, ms=20):
        """Send bytes and their CRC; the answer without its CRC, in hex."""
        body = bytes.fromhex(hexadecimal)
        answer = self.ask(body + crc16(body), ms)
        if answer:
            assert crc16(answer[:-2]) == answer[-2:]
        return answer[:-2].hex(" ").upper()

    def read(self, first, count=1):
        answer = bytes.fromhex(self.frame(f"01 03 {first:04X} {count:04X}"))
        assert answer[:3] == bytes([1, 3, 2 * count])
        return [int.from_bytes(answer[k : k + 2], "big") for k in range(3, len(answer), 2)]

    def write(self, first, *values):
        words = "".join(f"{value:04X}" for value in values)
        return self.frame(f"01 10 {first:04X} {len(values):04X} {2 * len(values):02X} {words}")

    def command(self, code):
        return self.write(5, code)

    def long(self, address):
        high, low = self.read(address, 2)
        return high << 16 | low


def faults(*faults):
    return FaultPlan(faults, START_NS).of("cell")


# Frames


def test_the_manual_frame_byte_for_byte():
    bench = Bench(force=74.565, capacity_n=100.0)
    answer = bench.ask(bytes.fromhex("01 03 00 07 00 02 75 CA"))
    assert answer.hex(" ").upper() == "01 03 04 00 01 23 45 73 30"  # 74.565 N is 12345h mN


@pytest.mark.parametrize(
    ("frame", "crc"),
    [("01 03 00 07 00 02", "75 CA"), ("01 04 00 00 00 01", "31 CA"), ("01 83 02", "C0 F1"), ("", "FF FF")],
)
def test_crc_of_published_frames(frame, crc):
    assert crc16(bytes.fromhex(frame)) == bytes.fromhex(crc)


def test_crc_check_value():
    assert crc16(b"123456789") == (0x4B37).to_bytes(2, "little")


def test_the_registers_that_are_there_and_those_that_take_a_value():
    writable = {5, 17, *range(18, 24), 36, 37, *range(38, 44), 72, 73}
    bench = Bench()
    for address in range(80):
        present = address < 18 or address in writable
        assert bench.frame(f"01 03 {address:04X} 0001").startswith("01 03" if present else "01 83 02")
        written = bench.frame(f"01 10 {address:04X} 0001 02 0000")
        assert written.startswith("01 10" if address in writable else "01 90 02")
    assert bench.frame("01 03 0107 0001") == "01 83 02"


def test_exceptions():
    bench = Bench()
    assert bench.frame("01 04 0007 0002") == "01 84 01"
    assert bench.frame("01 06 0005 0007") == "01 86 01"
    assert bench.frame("01 2B 0E01 00") == "01 AB 01"
    assert bench.frame("01 03 0018 0001") == "01 83 02"
    assert bench.frame("01 03 0016 0004") == "01 83 02"
    assert bench.frame("01 03 FFFF 0002") == "01 83 02"
    assert bench.frame("01 03 0000 0000") == "01 83 03"
    assert bench.frame("01 03 0000 0021") == "01 83 03"
    assert bench.frame("01 03 0000") == "01 83 03"
    assert bench.frame("01 03 0000 0001 00") == "01 83 03"
    assert bench.frame("01 10 0006 0001 02 0000") == "01 90 02"
    assert bench.frame("01 10 0012 0002 02 0000") == "01 90 03"
    assert bench.frame("01 10 0012 0001 04 0000 0000") == "01 90 03"
    assert bench.frame("01 10 0005 0001 02 03E7") == "01 90 03"


def test_most_registers_that_fit_in_one_frame():
    assert len(Bench().read(0, 24)) == 24


def test_other_stations_and_broadcasts_are_not_answered():
    bench = Bench(force=1.0)
    assert bench.frame("02 03 0007 0002") == ""
    assert bench.frame("00 03 0007 0002") == ""
    assert bench.frame("00 10 0005 0001 02 0007") == ""
    assert bench.long(NET) == 0  # the broadcast tare was obeyed


@pytest.mark.parametrize("bit", range(64))
def test_any_inverted_bit_silences_it(bit):
    bench = Bench()
    frame = bytearray(bytes.fromhex("01 03 00 07 00 02 75 CA"))
    frame[bit // 8] ^= 1 << bit % 8
    assert bench.ask(bytes(frame), 20) == b""
    assert bench.device.bad_frames == 1


def test_a_pause_inside_a_frame_voids_it_and_a_short_one_does_not():
    request = bytes.fromhex("01 03 00 07 00 02 75 CA")
    for pause_ms, answered in ((0.7, True), (0.8, False), (1.7, False)):
        bench = Bench()
        bench.send(request[:4])
        bench.run(4 * 10 / 115.2 + pause_ms)
        assert bool(bench.ask(request[4:], 20)) is answered


def test_a_pause_of_3_5_characters_begins_a_new_frame():
    bench = Bench()
    bench.ask(b"\x01\x03\x00", 2.1)
    assert bench.frame("01 03 0007 0001") == "01 03 02 00 00"
    assert bench.device.bad_frames == 1


@pytest.mark.parametrize(("baud_rate", "silence_ms"), [(9600, 3.646), (19_200, 1.823), (38_400, 1.75), (115_200, 1.75)])
def test_the_answer_begins_after_the_silence_and_the_turnaround(baud_rate, silence_ms):
    bench = Bench(line=LineFormat(baud_rate))
    bench.send(bytes.fromhex("01 03 00 07 00 02 75 CA"))
    sent_ns = bench.now_ns
    bench.run(60)
    assert bench.ends_ns[0] - sent_ns == pytest.approx(
        8 * 1e10 / baud_rate + silence_ms * MS + 0.5 * MS + 1e10 / baud_rate, abs=MS / 1000
    )
    assert len(bench.ends_ns) == 9


def test_even_parity():
    bench = Bench(force=2.0, line=LineFormat(19_200, "E"))
    assert bench.long(GROSS) == 2000
    bench.wire.host = LineFormat(19_200)
    assert bench.ask(bytes.fromhex("01 03 00 07 00 02 75 CA")) == b""


# Registers


def test_weights_are_magnitudes_with_their_signs_in_the_status():
    bench = Bench(force=-12.3456)
    assert bench.read(STATUS, 8) == [
        GROSS_NEGATIVE | NET_NEGATIVE | PEAK_NEGATIVE | STABLE,
        *(0, 12346),
        *(0, 12346),
        *(0, 12346),
        0x040F,
    ]
    bench.force = 12.3456
    bench.run(50)
    assert bench.read(STATUS, 3) == [STABLE, 0, 12346]


def test_signed_words_when_told():
    bench = Bench(force=-1.0, signs_in_status=False)
    assert bench.read(STATUS, 3) == [STABLE, 0xFFFF, 0xFC18]


@pytest.mark.parametrize(
    ("code", "division", "force", "shown"),
    [
        (12, 0.01, 12.344, 1234),
        (13, 0.005, 12.344, 12345),
        (14, 0.002, 12.345, 12344),
        (6, 1.0, 12.6, 13),
        (3, 10.0, 26.0, 30),
    ],
)
def test_divisions(code, division, force, shown):
    assert DIVISIONS[code] == division
    bench = Bench(force=force, division=code)
    assert bench.long(GROSS) == shown
    assert bench.read(DIVISION) == [0x0400 | code]


def test_the_table_of_divisions():
    coarse = [100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0]
    fine = [0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001]
    assert list(DIVISIONS) == coarse + fine


def test_zero_and_overload_bits():
    assert Bench().read(STATUS) == [STABLE | NEAR_ZERO]
    assert Bench(force=50.009).read(STATUS) == [STABLE]
    assert Bench(force=50.02).read(STATUS) == [STABLE | 0x4]
    assert Bench(force=55.1).read(STATUS) == [STABLE | 0xC]


def test_the_display_ends_at_999999():
    bench = Bench(force=1050.0, capacity_n=1000.0)
    assert bench.long(GROSS) == 999_999
    assert bench.read(STATUS) == [STABLE | 0x34]


def test_a_moving_weight_is_not_stable():
    bench = Bench(force=lambda t: t)
    assert not bench.read(STATUS)[0] & STABLE


def test_a_reading_is_the_last_conversion_at_300_hz():
    bench = Bench(force=lambda t: 10 * t)
    for polls in range(20):
        assert bench.device.produced == polls
        bench.run(1.3)
        asked_s = (bench.now_ns - START_NS) * 1e-9
        age_s = asked_s + (8 * 1e10 / 115_200 + 1.75 * MS) * 1e-9 - bench.long(GROSS) / 10_000
        assert -1e-4 < age_s < 1 / 300 + 1e-4


def test_peak_sees_what_no_poll_sees():
    bench = Bench(force=lambda t: 30.0 if 0.70 < t < 0.71 else 1.0)
    bench.run(500)
    assert (bench.long(GROSS), bench.long(PEAK)) == (1000, 30_000)


# Commands


def test_tare_net_and_gross():
    bench = Bench(force=5.0)
    assert bench.command(7) == "01 10 00 05 00 01"
    bench.force = 3.0
    bench.run(50)
    assert bench.read(STATUS, 5) == [NET_NEGATIVE | NET_MODE | STABLE, 0, 3000, 0, 2000]
    bench.command(9)
    assert bench.read(STATUS, 5) == [STABLE, 0, 3000, 0, 3000]


def test_tare_at_zero_is_refused():
    assert Bench().command(7) == "01 90 03"


def test_zero_within_its_range_only():
    bench = Bench(force=0.25)
    bench.command(8)
    assert bench.long(GROSS) == 0
    bench.force = 5.0
    bench.run(50)
    assert bench.command(8) == "01 90 03"
    assert bench.long(GROSS) == 4750


def test_preset_tare():
    bench = Bench(force=5.0)
    bench.write(72, 0, 1200)
    bench.command(130)
    assert bench.long(NET) == 3800
    bench.write(72, 1, 0)
    bench.command(130)
    assert bench.read(NET, 2) == [0, 65_536 - 5000]
    assert bench.read(STATUS)[0] & NET_MODE


def test_tare_and_zero_go_with_the_supply_and_the_permanent_zero_stays():
    bench = Bench(force=0.2, faults=faults(Fault("reset", "cell", 1.0), Fault("off", "cell", 2.0, 2.1)))
    bench.command(8)
    assert bench.long(GROSS) == 0
    bench.run(1100)
    assert bench.long(GROSS) == 200
    bench.command(100)
    bench.run(1500)
    assert bench.long(GROSS) == 0


def test_setpoints_survive_only_when_saved():
    bench = Bench(faults=faults(Fault("reset", "cell", 1.0), Fault("reset", "cell", 3.0)))
    bench.write(18, 0, 1000, 0, 2000)
    assert bench.read(18, 4) == [0, 1000, 0, 2000]
    bench.run(1500)
    assert bench.read(18, 4) == [0, 0, 0, 0]
    bench.write(18, 0, 1000)
    bench.write(38, 0, 10)
    bench.command(99)
    bench.run(2500)
    assert (bench.read(18, 2), bench.read(38, 2)) == ([0, 1000], [0, 10])


def test_a_refused_write_writes_nothing():
    bench = Bench()
    assert bench.write(22, 1, 2, 3) == "01 90 02"
    assert bench.read(22, 2) == [0, 0]


# Faults


def test_no_answer_before_it_has_started():
    cell = ModbusLoadCellTwin(Analog(lambda t: 0.0), RateClock(), START_NS)
    line = Line(cell)
    line.run(400)
    assert line.ask(bytes.fromhex("01 03 00 07 00 02 75 CA"), 80) == b""


def test_stuck_and_saturated():
    bench = Bench(
        force=lambda t: 10 * t,
        faults=faults(Fault("stuck", "cell", 1.0, 1.5), Fault("saturated", "cell", 2.0, 2.5, -1)),
    )
    bench.run(500)
    first = bench.long(GROSS)
    bench.run(200)
    assert bench.long(GROSS) == first == pytest.approx(10_000, abs=40)
    bench.run(900)
    assert bench.long(GROSS) == 60_000
    assert bench.read(STATUS)[0] & GROSS_NEGATIVE


def test_a_station_out_of_range_is_refused():
    with pytest.raises(ValueError, match="Modbus address 248"):
        Bench(station=248)


@given(st.lists(st.tuples(st.binary(max_size=40), st.floats(0, 5)), max_size=6))
def test_any_bytes_are_survived(pieces):
    bench = Bench(force=1.0)
    for data, pause_ms in pieces:
        bench.ask(data, pause_ms)
    bench.run(30)
    assert bench.long(PEAK) == 1000


@given(st.integers(0, 127), st.binary(max_size=80))
def test_any_frame_with_a_right_crc_is_answered_by_the_function_or_an_exception(function, body):
    bench = Bench()
    answer = bytes.fromhex(bench.frame((bytes([1, function]) + body).hex(), 40))
    assert answer[0] == 1
    assert answer[1] in (function, function | 0x80)
    if answer[1] & 0x80:
        assert answer[2] in (1, 2, 3)


# Peers


@pytest.fixture
def terminal():
    """A transmitter with -32.1 N on its cell, behind a pseudo-terminal, in real time."""
    start_ns = time.monotonic_ns()
    link = PtySerial()
    bus = SerialBus(link)
    bus.add(ModbusLoadCellTwin(Analog(lambda t: -32.1), RateClock(start_ns=start_ns), start_ns, boot_ns=0))
    with RealTime(bus):
        yield link.path
    link.close()


@pytest.mark.realtime
def test_minimalmodbus(terminal):
    instrument = minimalmodbus.Instrument(terminal, 1, close_port_after_each_call=False)
    instrument.serial.baudrate = 115_200
    instrument.serial.timeout = 2.0
    try:
        assert instrument.read_registers(7, 2) == [0, 32_100]
        assert instrument.read_long(7) == 32_100
        assert instrument.read_register(6) == GROSS_NEGATIVE | NET_NEGATIVE | PEAK_NEGATIVE | STABLE
        instrument.write_register(5, 7)  # by function 16
        assert instrument.read_long(9) == 0
        instrument.write_long(18, 123_456)
        assert instrument.read_long(18) == 123_456
        with pytest.raises(minimalmodbus.IllegalRequestError, match="illegal data address"):
            instrument.read_register(60)
        with pytest.raises(minimalmodbus.IllegalRequestError, match="illegal function"):
            instrument.read_register(7, functioncode=4)
        instrument.address = 2
        instrument.serial.timeout = 0.1
        with pytest.raises(minimalmodbus.NoResponseError):
            instrument.read_register(7)
    finally:
        instrument.serial.close()


@pytest.mark.realtime
def test_pymodbus(terminal):
    with ModbusSerialClient(terminal, baudrate=115_200, timeout=2.0, retries=0) as client:
        read = client.read_holding_registers(6, count=8, device_id=1)
        assert read.registers == [GROSS_NEGATIVE | NET_NEGATIVE | PEAK_NEGATIVE | STABLE, *([0, 32_100] * 3), 0x040F]
        assert client.convert_from_registers([0, 32_100], client.DATATYPE.INT32) == 32_100
        assert not client.write_registers(5, [7], device_id=1).isError()
        assert client.read_holding_registers(9, count=2, device_id=1).registers == [0, 0]
        assert client.read_holding_registers(0, count=33, device_id=1).exception_code == 3
        assert client.read_holding_registers(60, count=1, device_id=1).exception_code == 2
        assert client.read_input_registers(7, count=1, device_id=1).exception_code == 1
        assert client.write_register(5, 9, device_id=1).exception_code == 1
        assert client.write_registers(5, [12], device_id=1).exception_code == 3
