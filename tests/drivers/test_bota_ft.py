"""A Bota Systems sensor: frames fed three ways, every answer of the set-up, losses, restarts, states; any bytes."""

import math
import struct

import numpy as np
import pytest
from fastcrc.crc16 import ibm_sdlc

from drivers.bota_ft import FRAME, BotaFt, BotaFtConfig, decode_frame, wrench_stream
from drivers.bota_ft.device import TEMPERATURE, answering
from drivers.bota_ft.frame import crc
from drivers.errors import FrameError
from drivers.records import SampleStatus
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
FX, MZ = WrenchChannel("fx", 0, "N"), WrenchChannel("mz", 5, "N m")
WARM = WrenchChannel("warm", TEMPERATURE, "degC")
SET_UP = [b"C", b"c,0,1,0,4", b"f,512,0,0,1", b"R"]  # as the maker's example writes them
PERIOD_US = 10_000  # of a sinc length of 512


def frame(time_us: int, status: int = 0, wrench=(1.5, 2, 3, 4, 5, -0.25), warm: float = 24.5) -> bytes:
    """The 37 bytes of a frame."""
    content = struct.pack("<H6fIf", status, *wrench, time_us % 2**32, warm)
    return b"\xaa" + content + struct.pack("<H", ibm_sdlc(content))


class Flight(SerialFlight):
    """The driver, and a sensor that is running, stops at ``C`` and makes 100 frames a second after ``R``."""

    def __init__(self, channels=(FX, MZ), rate_hz=100.0, **config) -> None:
        self.asked: list[bytes] = []
        self.codes: dict[bytes, int] = {}
        self.mute: set[bytes] = set()
        self.time_us, self.runs = 5_000_000, True
        port, clock = ScriptedSerial(self.answer), VirtualClock()
        super().__init__(clock, port, BotaFt("wrist", channels, port.open, clock, BotaFtConfig(rate_hz, **config)))

    def answer(self, data: bytes) -> bytes:
        self.asked.append(data)
        if data[:1] in self.mute:
            return b""
        self.runs = data == b"R"
        return b"r,0,%c,%d\r\n" % (data[0], self.codes.get(data[:1], 0))

    def frames(self, n, **told):
        """Each comes 10 ms after the one before."""
        for _ in range(n):
            self.time_us += PERIOD_US
            self.pump(10 * MS, frame(self.time_us, **told) if self.runs else b"")
        return self

    def lose(self, n):
        self.time_us += n * PERIOD_US
        self.pump(n * 10 * MS)
        return self


@pytest.fixture
def up():
    flight = Flight()
    flight.start()
    flight.frames(22)  # 0.2 s of those of its last run, and the set-up, an answer a pump
    assert flight.asked == SET_UP
    assert not of(flight.batches, "fx").size
    return flight.frames(3)


FRAMES = [frame(n, n, (n, 0, 0xAA, 0, 0, -n)) for n in range(3)]
STREAM = b"".join(FRAMES)


def test_the_checksum_is_the_one_of_its_name():
    assert crc(b"123456789") == ibm_sdlc(b"123456789") == 0x906E  # the check value of CRC-16/X-25 (IBM-SDLC)


@pytest.mark.parametrize("feed", [at_once(STREAM), bytewise(), pieces(3), pieces(8, 9)])
def test_fed_any_way_the_same_frames_come_out(feed):
    assert fed(wrench_stream(), STREAM, feed) == (FRAMES, [])


@pytest.mark.parametrize("junk", [b"App Init\r\n", b"\xaa", b"\xaa\xaa\xaa", FRAMES[0][:20], FRAMES[0][:-1] + b"\0"])
def test_after_junk_the_next_frames_are_taken(junk):
    for feed in (at_once(junk + STREAM), bytewise(), pieces(5)):
        taken, errors = fed(wrench_stream(), junk + STREAM + b"\r", feed)
        assert taken == FRAMES
        assert errors


def test_a_frame_is_refused_with_any_bit_wrong():
    for bit in range(8 * len(FRAMES[1])):
        wrong = bytearray(FRAMES[1])
        wrong[bit // 8] ^= 1 << bit % 8
        with pytest.raises(FrameError):
            decode_frame(bytes(wrong))
    assert np.frombuffer(decode_frame(FRAMES[1]), FRAME)["wrench"].tolist() == [[1, 0, 170, 0, 0, -1]]


def test_it_is_set_up_by_the_maker_s_commands_and_its_frames_are_rows(up):
    up.stop()
    assert codes(up.batches) == ["started", "stopped"]
    for channel, value, unit in (("fx", 1.5, b"N"), ("mz", -0.25, b"N m")):
        rows = whole(up.batches, channel)
        assert (rows["value_raw"] * rows["scale"]).tolist() == [value] * 3
        assert set(rows["unit"]) == {unit}
        assert np.diff(rows["tick"].astype(int)).tolist() == [PERIOD_US] * 2
        assert rows["sequence"].tolist() == [0, 1, 2]
        assert not rows["status"].any()


def test_one_that_starts_is_waited_for():
    flight = Flight()
    flight.runs = False
    flight.start()
    flight.lose(100)
    assert not flight.asked  # it may be in its boot loader
    flight.pump(0, b"App In")
    flight.pump(10 * MS, b"it\r\nname: x\r\n")
    flight.runs = True  # as it was saved
    flight.frames(49)
    assert not flight.asked
    flight.frames(3)
    assert flight.asked == SET_UP
    assert len(whole(flight.frames(3).batches, "fx")) == 3


def test_one_that_says_nothing_is_set_up_after_three_seconds():
    flight = Flight()
    flight.runs = False
    flight.start()
    flight.lose(299)
    assert not flight.asked
    flight.lose(1).frames(2)
    assert flight.asked == SET_UP


@pytest.mark.parametrize("command", [0, 1, 2, 3])
def test_each_command_that_is_refused_is_told_and_tried_again(command):
    flight = Flight()
    letter = SET_UP[command][:1]
    flight.codes[letter] = 3
    flight.start()
    flight.frames(25)
    assert flight.asked == SET_UP[: command + 1]
    assert "code 3" in texts(flight.batches, "refused")[0]
    assert repr(SET_UP[command].decode()) in texts(flight.batches, "refused")[0]
    assert not of(flight.batches, "fx").size
    del flight.codes[letter]
    flight.runs = True
    flight.frames(40)
    assert codes(flight.batches) == ["refused", "started", "bus_recovered"]
    assert len(whole(flight.batches, "fx")) > 10


@pytest.mark.parametrize("command", [0, 1, 2, 3])
def test_each_command_that_is_not_answered_is_told_and_tried_again(command):
    flight = Flight()
    letter = SET_UP[command][:1]
    flight.mute.add(letter)
    flight.start()
    flight.frames(25).lose(80)
    assert codes(flight.batches) == []
    flight.lose(30).lose(1)
    assert repr(SET_UP[command].decode()) in texts(flight.batches, "no_answer")[0]
    assert not of(flight.batches, "fx").size
    flight.mute.clear()
    flight.runs = True
    flight.frames(60)
    assert codes(flight.batches) == ["no_answer", "started", "bus_recovered"]


def test_lost_frames_are_counted_by_their_times(up):
    up.lose(4).frames(2)
    up.pump(10 * MS, frame(up.time_us + PERIOD_US)[:-1] + b"\0" + frame(up.time_us + 2 * PERIOD_US))
    up.stop()
    assert whole(up.batches, "fx")["sequence"].tolist() == [0, 1, 2, 7, 8, 10]
    four, one = [row for row in of(up.batches, "gap") if row["channel"] == b"mz"]
    assert (four["cause"], four["first_missing"], four["last_missing"], four["counted"]) == (b"frames_lost", 3, 6, 1)
    assert (one["first_missing"], one["last_missing"]) == (9, 9)
    assert codes(up.batches) == ["started", "bad_frame", "stopped"]


def test_its_time_begins_again_at_0_after_71_minutes():
    flight = Flight()
    flight.time_us = 2**32 - 25 * PERIOD_US
    flight.start()
    rows = whole(flight.frames(30).batches, "fx")
    assert len(rows) > 4
    assert set(np.diff(rows["tick"].astype(int))) == {PERIOD_US}
    assert rows["tick"][-1] > 2**32
    assert codes(flight.batches) == ["started"]


def test_one_that_started_again_in_its_stream_is_set_up_anew(up):
    up.time_us, up.asked[:] = 600_000, []
    up.pump(700 * MS, b"App Init\r\n")
    up.frames(1)
    assert codes(up.batches)[-1] == "restarted"
    up.frames(49)
    assert not up.asked
    up.frames(6)
    up.stop()
    assert up.asked == SET_UP
    rows = whole(up.batches, "fx")
    first = rows["status"].tolist().index(RESET)
    assert first == 3
    assert int(rows["sequence"][first]) - 2 == (rows["host_ns"][first] - rows["host_ns"][2]) / (10 * MS)
    (gap,) = [row for row in of(up.batches, "gap") if row["channel"] == b"fx"]
    assert not gap["counted"]
    assert not rows["status"][first + 1 :].any()


@pytest.mark.parametrize(("ahead_us", "is_told"), [(200_000, False), (230_000, True), (-1, True)])
def test_a_time_that_cannot_be_is_another_start(up, ahead_us, is_told):
    up.pump(10 * MS, frame(up.time_us + 10_000 + ahead_us if ahead_us > 0 else up.time_us + ahead_us))
    assert ("restarted" in codes(up.batches)) == is_told


def test_a_silent_sensor_is_set_up_again_and_what_was_lost_is_by_its_clock(up):
    up.runs, up.asked[:] = False, []
    up.lose(120).lose(1)
    assert codes(up.batches)[-1] == "silent"
    up.runs = True
    up.frames(40)
    up.stop()
    assert up.asked == SET_UP
    assert codes(up.batches) == ["started", "silent", "bus_recovered", "stopped"]
    rows = whole(up.batches, "fx")
    assert not rows["status"].any()
    assert (rows["sequence"] == (rows["tick"] - rows["tick"][0]) // PERIOD_US).all()
    (gap,) = [row for row in of(up.batches, "gap") if row["channel"] == b"fx"]
    assert (gap["cause"], gap["counted"]) == (b"port_lost", 0)


@pytest.mark.parametrize("away_s", [0.1, 3.0])
def test_one_that_was_without_power_while_the_port_was_closed_began_anew(up, away_s):
    up.port.broken = True
    up.pump(10 * MS)
    up.port.broken = False
    up.time_us = round(1e6 * away_s)  # less than has passed, or more than before
    up.pump(4000 * MS)
    up.frames(40)
    rows = whole(up.batches, "fx")
    assert rows["status"].tolist().count(RESET) == 1
    assert rows["status"][3] == RESET
    assert abs(int(rows["sequence"][3]) - 3 - 402 - 22) <= 2


@pytest.mark.parametrize(("short_s", "is_anew"), [(0.6, False), (1.7, True), (990.0, True), (-1.7, True)])
def test_after_an_absence_its_clock_says_whether_it_was_on(up, short_s, is_anew):
    up.port.broken = True
    up.pump(10 * MS)
    up.port.broken = False
    up.time_us += round(1e6 * (1000.0 - short_s))  # a thousand seconds, to 1e-3 and 0.2 s
    up.pump(1_000_000 * MS - 10 * MS)
    up.frames(40)
    assert ((whole(up.batches, "fx")["status"] & RESET) != 0).any() == is_anew


def test_a_time_that_stands_still_is_not_valid(up):
    up.pump(10 * MS, frame(up.time_us))
    assert of(up.batches, "fx")["status"].tolist() == [0, 0, 0, BAD]


@pytest.mark.parametrize(
    ("status", "row", "code"),
    [
        (1, 0, "sensor_status"),
        (2, FULL, "sensor_status"),
        (4, BAD, "sensor_error"),
        (8, BAD, "sensor_error"),
        (0x10, 0, "sensor_status"),
    ],
)
def test_each_bit_of_its_status_is_told_and_marks_the_rows_that_it_spoils(up, status, row, code):
    up.frames(2, status=status).frames(1)
    for channel in ("fx", "mz"):
        assert of(up.batches, channel)["status"].tolist() == [0, 0, 0, row, row, 0]
        assert of(up.batches, channel)["device_status"].tolist() == [0, 0, 0, status, status, 0]
    assert codes(up.batches)[1:] == [code, "sensor_normal"]
    assert f"{status:04x}h" in texts(up.batches, code)[0]


def test_a_state_that_is_over_within_one_read_is_told(up):
    times = [up.time_us + n * PERIOD_US for n in (1, 2, 3)]
    up.pump(30 * MS, frame(times[0]) + frame(times[1], 2) + frame(times[2]))
    assert codes(up.batches)[1:] == ["sensor_status", "sensor_normal"]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9])
def test_what_is_no_number_is_not_valid_and_the_others_are(up, value):
    up.frames(1, wrench=(value, 0, 0, 0, 0, 1))
    assert of(up.batches, "fx")["status"].tolist()[-1] == BAD
    assert of(up.batches, "mz")["status"].tolist()[-1] == 0


def test_its_temperature_is_recorded_where_wanted_and_is_good_beyond_the_range_of_forces():
    flight = Flight((FX, WARM))
    flight.start()
    flight.frames(25).frames(1, status=6)
    rows = whole(flight.batches, "warm")
    assert set(rows["value_raw"] * rows["scale"]) == {24.5}
    assert set(rows["unit"]) == {b"degC"}
    assert not rows["status"].any()
    assert rows["sequence"].tolist() == whole(flight.batches, "fx")["sequence"].tolist()


def test_a_stop_tells_what_is_missing_at_the_end(up):
    up.pump(900 * MS)
    up.stop()
    whole(up.batches, "fx")
    assert set(of(up.batches, "gap")["last_missing"]) == {3 + 90 - 1}


@pytest.mark.parametrize(("rate_hz", "sinc"), [(25.0, 2048), (100.0, 512), (800.0, 64)])
def test_the_rate_is_the_sinc_length(rate_hz, sinc):
    assert BotaFtConfig(rate_hz).commands[2] == b"f,%d,0,0,1" % sinc


def test_a_sensor_that_is_heard_names_its_components():
    for said in (frame(1), b"App Init\r\n\xaa" + frame(7)):
        port = ScriptedSerial().open()
        port.say(said)
        assert [one.number for one in answering(port, lambda seconds: None)] == [1, 2, 3, 4, 5, 6]
        assert not port.written  # what is not asked cannot be stopped
    for said in (b"", b"HTTP/1.1 400" * 10, frame(1)[:-1] + b"\0"):
        port = ScriptedSerial().open()
        port.say(said)
        assert not list(answering(port, lambda seconds: None))
