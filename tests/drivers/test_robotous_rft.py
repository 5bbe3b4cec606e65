"""A Robotous sensor: packets fed three ways, every question of the set-up, losses, pauses, overloads; any bytes."""

import struct

import pytest

from drivers.errors import FrameError
from drivers.records import SampleStatus
from drivers.robotous_rft import RftConfig, RobotousRft, answering, command, decode_packet, rft_stream
from drivers.serial_line.scalars import WrenchChannel
from tests.conftest import VirtualClock
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.serial_script import (
    MS,
    ScriptedSerial,
    SerialFlight,
    bytewise,
    fed,
    pieces,
)
from tests.drivers.serial_script import whole as at_once

BAD, RESET, FULL = SampleStatus.NOT_VALID, SampleStatus.AFTER_RESET, SampleStatus.SATURATED
FX, TZ = WrenchChannel("fx", 0, "N"), WrenchChannel("tz", 5, "N m")
NAME, RATE, SET_RATE, FILTER, SET_FILTER, START, STOP, BIAS = 1, 16, 15, 9, 8, 11, 12, 17
SET_UP = [STOP, NAME, RATE, FILTER, START, BIAS]


def packet(number: int, contents: bytes = b"") -> bytes:
    """The 19 bytes of a response."""
    field = bytes([number]) + contents.ljust(15, b"\0")
    return b"\x55" + field + bytes([sum(field) % 256, 0xAA])


def sample(counts=(75, 2, 3, 4, 5, -500), overload: int = 0) -> bytes:
    return packet(START, struct.pack(">6hB", *counts, overload))


class Flight(SerialFlight):
    """The driver, and a sensor that makes 100 packets a second after start, an answer a pump."""

    def __init__(self, channels=(FX, TZ), rate_hz=100.0, **config) -> None:
        self.asked: list[bytes] = []
        self.answers = {NAME: b"RFT40-SA01", RATE: b"\4", FILTER: b"", SET_RATE: b"\1", SET_FILTER: b"\1"}
        self.runs = self.mute = False
        port, clock = ScriptedSerial(self.answer), VirtualClock()
        device = RobotousRft("wrist", channels, port.open, clock, RftConfig(rate_hz, **config))
        super().__init__(clock, port, device)

    @property
    def numbers(self) -> list[int]:
        return [data[1] for data in self.asked]

    def answer(self, data: bytes) -> bytes:
        self.asked.append(data)
        self.runs = (self.runs or data[1] == START) and data[1] != STOP
        answered = self.answers.get(data[1])
        return b"" if answered is None or self.runs or self.mute else packet(data[1], answered)

    def packets(self, n, **told):
        """Each comes 10 ms after the one before."""
        for _ in range(n):
            self.pump(10 * MS, sample(**told) if self.runs else b"")
        return self


@pytest.fixture
def up():
    flight = Flight()
    flight.start()
    flight.packets(9)
    assert flight.numbers == [STOP]  # what it still sends is waited for
    flight.packets(23)
    assert flight.numbers == SET_UP
    assert set(of(flight.batches, "fx")["status"]) == {BAD}
    flight.batches.clear()
    return flight.packets(3)


PACKETS = [sample((n, 0x55, -1, 0x5555, 0, -n), n) for n in range(3)]
STREAM = b"".join(PACKETS)
FIELDS = [one[1:-2] for one in PACKETS]


def test_commands_are_those_of_the_manual():
    """By a client that others wrote from it: 55h, eight bytes, their sum, AAh."""
    assert command(START) == bytes.fromhex("55 0B 00 00 00 00 00 00 00 0B AA")
    assert command(SET_RATE, 7) == bytes.fromhex("55 0F 07 00 00 00 00 00 00 16 AA")
    assert command(0xFF, 2)[-2] == 1


@pytest.mark.parametrize("feed", [at_once(STREAM), bytewise(), pieces(3), pieces(8, 9)])
def test_fed_any_way_the_same_packets_come_out(feed):
    assert fed(rft_stream(), STREAM, feed) == (FIELDS, [])


@pytest.mark.parametrize("junk", [b"hello", b"\x55", b"\x55\x55\x55", PACKETS[0][:12], PACKETS[0][:-1] + b"\0"])
def test_after_junk_the_next_packets_are_taken(junk):
    for feed in (at_once(junk + STREAM), bytewise(), pieces(5)):
        stream = rft_stream()
        taken, errors = fed(stream, junk + STREAM + b"\r", feed)
        assert taken == FIELDS
        assert errors
        assert stream.discarded == len(junk) + 1


def test_a_packet_is_refused_with_any_bit_wrong():
    for bit in range(8 * len(PACKETS[1])):
        wrong = bytearray(PACKETS[1])
        wrong[bit // 8] ^= 1 << bit % 8
        with pytest.raises(FrameError):
            decode_packet(bytes(wrong))
    assert decode_packet(PACKETS[1]) == FIELDS[1]


def test_it_is_set_up_without_writing_what_it_has_and_its_packets_are_rows(up):
    up.stop()
    assert codes(up.batches) == ["stopped"]
    assert up.asked == [command(number) for number in (*SET_UP, STOP)]
    for channel, value, unit in (("fx", 1.5, b"N"), ("tz", -0.25, b"N m")):
        rows = of(up.batches, channel)
        assert (rows["value_raw"] * rows["scale"]).tolist() == pytest.approx([value] * 3)
        assert set(rows["unit"]) == {unit}
        assert rows["sequence"].tolist() == rows["tick"].tolist() == [rows["sequence"][0] + n for n in range(3)]
        assert not rows["status"].any()


@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 50.0, 100.0, 200.0, 333.0, 500.0, 1000.0])
def test_a_rate_and_a_filter_that_differ_are_set_once(rate_hz):
    flight = Flight(rate_hz=rate_hz)
    flight.answers |= {RATE: b"\x05", FILTER: b"\1\6"}
    flight.start()
    flight.packets(20)
    code = {10: 1, 20: 2, 50: 3, 100: 4, 200: 0, 333: 6, 500: 7, 1000: 8}[round(rate_hz)]
    assert flight.numbers == [STOP, NAME, RATE, SET_RATE, FILTER, SET_FILTER, START, BIAS]
    assert flight.asked[3] == command(SET_RATE, code)
    assert flight.asked[5] == command(SET_FILTER, 0, 0)
    assert flight.asked[7] == command(BIAS, 0)


def test_rows_are_not_valid_until_its_bias_has_been_off_for_200_ms():
    flight = Flight()
    flight.start()
    flight.packets(60)
    rows = whole(flight.batches, "fx")
    assert rows["status"].tolist() == [BAD] * 20 + [0] * (len(rows) - 20)


@pytest.mark.parametrize(("number", "what"), [(SET_RATE, "output rate"), (SET_FILTER, "no filter")])
@pytest.mark.parametrize(
    ("code", "said"), [(1, "not supported"), (2, "out of range"), (3, "not stored"), (9, "no reas")]
)
def test_what_it_refuses_is_told_and_tried_again(number, what, code, said):
    flight = Flight()
    flight.answers |= {RATE: b"\0", FILTER: b"\1\1", number: bytes([0, code])}
    flight.start()
    flight.packets(25)
    assert flight.numbers[-1] in (number, STOP)
    [text] = texts(flight.batches, "refused")
    assert what in text
    assert said in text
    flight.answers[number] = b"\1"
    flight.packets(80)
    assert codes(flight.batches) == ["refused", "started", "bus_recovered"]
    assert len(whole(flight.batches, "fx")) > 10


@pytest.mark.parametrize("number", [NAME, RATE, SET_RATE, FILTER, SET_FILTER, START])
def test_each_question_that_is_not_answered_is_told_and_asked_again(number):
    flight = Flight()
    flight.answers |= {RATE: b"\0", FILTER: b"\1\1"}
    kept = flight.answers.pop(number, None)
    make, flight.answer_all = flight.answer, True

    def answer(data):
        made = make(data)
        if data[1] == START and number == START and flight.answer_all:
            flight.runs = False
        return made

    flight.port.answer = answer
    flight.start()
    flight.packets(50)
    assert not of(flight.batches, "fx").size
    assert codes(flight.batches) == []
    flight.packets(20)
    assert f"command {number} is not answered" in texts(flight.batches, "no_answer")[0]
    flight.answer_all = False
    if kept is not None:
        flight.answers[number] = kept
    flight.packets(200)
    assert codes(flight.batches) == ["no_answer", "started", "bus_recovered"]


def test_another_model_is_refused_with_the_key_to_write():
    flight = Flight()
    flight.answers[NAME] = b"RFT80-6A01\0"
    flight.start()
    flight.packets(20)
    assert "write counts_per_N_m = 1000" in texts(flight.batches, "refused")[0]
    assert START not in flight.numbers
    other = Flight(counts_per_N_m=1000.0)
    for name in (b"RFT80-6A01\0", b"RFT99-new"):
        other.answers[NAME] = name
        other.start()
        other.packets(45)
        assert set(of(other.batches, "tz")["scale"]) == {1e-3}
        other.stop()


def test_a_sensor_that_still_sends_is_stopped_first():
    flight = Flight()
    flight.start()
    flight.runs = True  # the stop is lost on the line; another on the way is not
    flight.packets(9)
    flight.runs = False
    flight.packets(25)
    assert flight.numbers == SET_UP
    assert len(whole(flight.batches, "fx")) > 5


def test_bytes_that_are_no_packet_are_packets_lost(up):
    first = of(up.batches, "fx")["sequence"][0]
    up.pump(10 * MS, sample()[:-3])  # bytes lost
    up.pump(10 * MS, sample())
    up.pump(30 * MS, sample()[:-1] + b"\0" + sample()[:5] + b"\0" + sample()[6:] + sample())
    up.stop()
    assert (of(up.batches, "fx")["sequence"] - first).tolist() == [0, 1, 2, 4, 7]
    gaps = [row for row in of(up.batches, "gap") if row["channel"] == b"tz"]
    assert [(row["cause"], row["first_missing"] - first, row["last_missing"] - first) for row in gaps] == [
        (b"frames_lost", 3, 3),
        (b"frames_lost", 5, 6),
    ]
    assert sorted(codes(up.batches)) == ["bad_frame", "bad_frame", "stopped"]
    assert not of(up.batches, "fx")["status"].any()


@pytest.mark.parametrize(("pause_ms", "lost"), [(50, 0), (60, 0), (80, 7), (300, 29)])
def test_after_a_pause_what_is_missing_is_by_the_time_passed(up, pause_ms, lost):
    up.pump(pause_ms * MS, sample())
    up.packets(1)
    up.stop()
    rows = of(up.batches, "fx")[2:]
    assert (rows["sequence"] - rows["sequence"][0]).tolist() == [0, 1 + lost, 2 + lost]
    assert rows["status"].tolist() == [0, RESET if lost else 0, 0]
    assert sum(row["last_missing"] + 1 - row["first_missing"] for row in of(up.batches, "gap")) == 2 * lost
    assert not any(row["counted"] for row in of(up.batches, "gap"))


@pytest.mark.parametrize(("spare_ms", "lost"), [(140, 0), (200, 2)])
def test_of_a_slow_sensor_a_pause_is_more_than_a_period_and_a_half(spare_ms, lost):
    flight = Flight(rate_hz=10.0)
    flight.answers[RATE] = b"\1"
    flight.start()
    flight.packets(13)
    flight.pump((100 + spare_ms) * MS, sample())
    flight.stop()
    assert whole(flight.batches, "fx")["sequence"].tolist() == [0, 1 + lost]


def test_what_is_lost_by_bytes_is_not_lost_by_time_again(up):
    up.pump(110 * MS, (sample()[:-1] + b"\0") * 10 + sample())
    up.stop()
    rows = of(up.batches, "fx")
    assert rows["sequence"][-1] - rows["sequence"][-2] == 11
    assert not rows["status"].any()


def test_what_a_host_read_late_is_not_lost(up):
    up.pump(400 * MS, sample() * 40)
    up.packets(2)
    up.stop()
    assert not of(up.batches, "gap").size
    assert len(of(up.batches, "fx")) == 45


def test_a_silent_sensor_is_set_up_again(up):
    up.runs, up.asked[:] = False, []
    up.pump(1010 * MS)
    assert codes(up.batches) == ["silent"]
    up.packets(60)
    up.stop()
    assert up.numbers == [*SET_UP, STOP]
    assert codes(up.batches) == ["silent", "bus_recovered", "stopped"]
    rows = of(up.batches, "fx")
    assert rows["status"].tolist()[:5] == [0, 0, 0, BAD | RESET, BAD]
    away = (rows["host_ns"][3] - rows["host_ns"][2]) / (10 * MS)
    assert rows["sequence"][3] - rows["sequence"][2] == round(away)
    assert set(of(up.batches, "gap")["cause"]) == {b"port_lost"}


@pytest.mark.parametrize(
    ("overload", "axes"), [(0x20, "Fx"), (0x10, "Fy"), (8, "Fz"), (4, "Tx"), (2, "Ty"), (1, "Tz"), (0x28, "Fz, Fx")]
)
def test_an_overload_names_its_axes_and_saturates_the_packet(up, overload, axes):
    up.packets(2, overload=overload).packets(1)
    for channel in ("fx", "tz"):
        assert of(up.batches, channel)["status"].tolist() == [0, 0, 0, FULL, FULL, 0]
        assert of(up.batches, channel)["device_status"].tolist() == [0, 0, 0, overload, overload, 0]
    assert codes(up.batches) == ["sensor_status", "sensor_normal"]
    assert f": {axes};" in texts(up.batches, "sensor_status")[0]


def test_an_overload_that_is_over_within_a_read_is_told_and_reserved_bits_are_not(up):
    up.pump(30 * MS, sample() + sample(overload=1) + sample(overload=0xC0))
    assert codes(up.batches) == ["sensor_status", "sensor_normal"]


@pytest.mark.parametrize(("counts", "status"), [(32767, FULL), (32766, 0), (-32768, FULL), (-32767, 0)])
def test_the_ends_of_a_number_are_saturated_of_that_component_alone(up, counts, status):
    up.packets(1, counts=(counts, 0, 0, 0, 0, 0))
    assert of(up.batches, "fx")["status"].tolist()[-1] == status
    assert of(up.batches, "tz")["status"].tolist()[-1] == 0


def test_a_stop_tells_what_is_missing_at_the_end(up):
    last = of(up.batches, "fx")["sequence"][-1]
    up.pump(900 * MS)
    up.stop()
    assert set(of(up.batches, "gap")["last_missing"]) == {last + 90}


def test_a_sensor_that_answers_or_sends_names_its_components():
    for said in (packet(NAME, b"RFT40-SA01"), b"\x55\x55" + sample()):
        port = ScriptedSerial(lambda data, said=said: said).open()
        assert [one.number for one in answering(port, lambda seconds: None)] == [1, 2, 3, 4, 5, 6]
        assert bytes(port.written) == command(NAME)  # a question that sets nothing
    for said in (b"", b"HTTP/1.1 400" * 10, sample()[:-1] + b"\0", packet(RATE, b"\4")):
        port = ScriptedSerial(lambda data, said=said: said).open()
        assert not list(answering(port, lambda seconds: None))
