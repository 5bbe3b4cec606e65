"""A wrist sensor by RDT over UDP: its records fed three ways, losses, repeats, restarts and states, a real socket."""

import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, FrameError, UrlError
from drivers.net_ft import NetFt, NetFtChannel, NetFtConfig, RecordStream, request
from drivers.net_ft.device import answering
from drivers.net_ft.record import ANY_BIT, RECORD, onrobot_set_up
from drivers.records import SampleStatus
from drivers.transports.network import UdpPort
from tests.conftest import VirtualClock
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.serial_script import (
    MS,
    ScriptedSerial,
    SerialFlight,
    bytewise,
    fault_at_any_call,
    fed,
    fuzzed,
    pieces,
)
from tests.drivers.serial_script import whole as at_once

BAD, RESET = SampleStatus.NOT_VALID, SampleStatus.AFTER_RESET
FX, MZ = NetFtChannel("fx", 0, 1e-6, "N"), NetFtChannel("mz", 5, 1e-6, "N m")
START, STOP = bytes.fromhex("1234000200000000"), bytes.fromhex("1234000000000000")  # as the manual's examples write


def record(number: int, sample: int = 0, status: int = 0, counts=(1, 2, 3, 4, 5, -6)) -> bytes:
    """The 36 bytes of the manual's table."""
    return struct.pack(">III6i", number % 2**32, sample % 2**32, status, *counts)


def datagram(*records: bytes) -> bytes:
    """As a UDP port hands it over."""
    data = b"".join(records)
    return struct.pack(">H", len(data)) + data


class Flight(SerialFlight):
    """The driver, and a sensor that sends 100 records a second from 1 on once it has been asked."""

    def __init__(self, channels=(FX, MZ), rate_hz=100.0, **config) -> None:
        self.asked: list[bytes] = []
        self.number, self.sample, self.sends = 0, 700, False
        port, clock = ScriptedSerial(self.answer), VirtualClock()
        super().__init__(clock, port, NetFt("wrist", channels, port.open, clock, NetFtConfig(rate_hz, **config)))

    def answer(self, data: bytes) -> bytes:
        self.asked.append(data)
        self.sends = data == START
        self.number = 0
        return b""

    def records(self, n, **told):
        """Each comes 10 ms after the one before."""
        for _ in range(n):
            self.number, self.sample = self.number + 1, self.sample + 70
            self.pump(10 * MS, datagram(record(self.number, self.sample, **told)) if self.sends else b"")
        return self

    def lose(self, n):
        self.number, self.sample = self.number + n, self.sample + 70 * n
        self.pump(n * 10 * MS)
        return self


@pytest.fixture
def up():
    flight = Flight()
    flight.start()
    return flight.records(3)


CONTENTS = [record(1), record(2, 7, 1 << 31), record(3) + record(4)]
STREAM = b"".join(datagram(content) for content in CONTENTS)


@pytest.mark.parametrize("feed", [at_once(STREAM), bytewise(), pieces(3), pieces(8, 9)])
def test_fed_any_way_the_same_datagrams_come_out(feed):
    assert fed(RecordStream(), STREAM, feed) == (CONTENTS, [])


@pytest.mark.parametrize("content", [b"", b"GET /", record(1)[:-1], record(1) + b"\0", record(1) * 41])
def test_a_datagram_of_another_length_is_refused_and_the_next_one_taken(content):
    taken, errors = fed(RecordStream(), datagram(content) + STREAM, bytewise())
    assert taken == CONTENTS
    assert len(errors) == 1
    assert str(len(content)) in errors[0]


def test_it_is_asked_once_and_told_to_stop_in_the_end(up):
    up.stop()
    assert up.asked == [START, STOP]
    assert request(2) == START
    assert codes(up.batches) == ["started", "stopped"]
    for channel, value, unit in (("fx", 1e-6, b"N"), ("mz", -6e-6, b"N m")):
        rows = whole(up.batches, channel)
        assert rows["value_raw"] * rows["scale"] == pytest.approx([value] * 3)
        assert set(rows["unit"]) == {unit}
        assert rows["tick"].tolist() == rows["sequence"].tolist() == [0, 1, 2]
        assert not rows["status"].any()
        assert not rows["device_status"].any()


def test_several_records_of_a_datagram_and_several_datagrams_of_a_read_are_rows(up):
    up.pump(40 * MS, datagram(record(4), record(5)) + datagram(record(6)))
    assert whole(up.batches, "fx")["tick"].tolist() == [0, 1, 2, 3, 4, 5]


def test_lost_records_are_counted_by_their_numbers(up):
    up.lose(4).records(2)
    up.stop()
    assert whole(up.batches, "fx")["sequence"].tolist() == [0, 1, 2, 7, 8]
    (gap,) = [row for row in of(up.batches, "gap") if row["channel"] == b"mz"]
    assert (gap["cause"], gap["first_missing"], gap["last_missing"]) == (b"records_lost", 3, 6)


def test_numbers_begin_again_at_0_after_32_bits():
    flight = Flight()
    flight.start()
    flight.number = 2**32 - 3
    flight.records(5)
    assert whole(flight.batches, "fx")["tick"].tolist() == [0, 1, 2, 3, 4]
    assert codes(flight.batches) == ["started"]


def test_repeated_and_late_records_are_left_out_and_told(up):
    up.pump(10 * MS, datagram(record(3)) + datagram(record(5)) + datagram(record(4)) + datagram(record(6)))
    assert whole(up.batches, "fx")["tick"].tolist() == [0, 1, 2, 4, 5]
    assert codes(up.batches)[1:] == ["repeated"]  # once, with the count of others


@pytest.mark.parametrize(("ahead", "taken"), [(22, True), (25, False), (2**30, False)])
def test_more_records_than_can_have_been_sent_are_not_counted_as_lost(up, ahead, taken):
    up.pump(10 * MS, datagram(record(3 + ahead)))  # 1.1 x (0.01 + 0.2) s x 100 Hz = 23.1 may be missing
    up.records(1)
    up.stop()
    assert (up.device.bad_frames == 0) == taken
    assert len(whole(up.batches, "fx")) == 4


def test_a_silent_sensor_is_asked_anew_and_what_was_lost_is_estimated(up):
    up.sends = False
    up.lose(120)
    assert up.asked == [START]
    for _ in range(3):
        up.pump(10 * MS)
    assert up.asked == [START, START]
    up.records(2)
    up.stop()
    rows = whole(up.batches, "fx")
    assert rows["status"].tolist() == [0, 0, 0, RESET, 0]
    assert abs(int(rows["sequence"][3]) - 126) <= 1
    (gap,) = [row for row in of(up.batches, "gap") if row["channel"] == b"fx"]
    assert gap["cause"] == b"silent"
    assert codes(up.batches) == ["started", "silent", "bus_recovered", "stopped"]


def test_a_sensor_that_was_without_power_is_told(up):
    up.sends, up.sample = False, 0
    up.lose(120).pump(30 * MS)
    up.sample = 0
    up.records(2)
    assert codes(up.batches).count("restarted") == 1


def test_an_error_of_the_sensor_is_told_with_its_code_and_its_rows_are_not_valid(up):
    up.records(2, status=0x8000_0004).records(1, status=0x0001_0000).records(1)
    assert of(up.batches, "fx")["status"].tolist() == [0, 0, 0, BAD, BAD, 0, 0]
    assert of(up.batches, "fx")["device_status"].tolist() == [0, 0, 0, 0x80, 0x80, 0, 0]
    assert codes(up.batches)[1:] == ["sensor_error", "sensor_status", "sensor_normal"]
    assert "80000004h" in texts(up.batches, "sensor_error")[0]
    up.pump(2000 * MS, datagram(record(8, 9999)) + datagram(record(9, 9999, 1 << 31)) + datagram(record(10, 9999)))
    assert codes(up.batches)[4:] == ["sensor_error", "sensor_normal"]  # over within one read


def test_a_stop_tells_what_is_missing_at_the_end(up):
    up.pump(900 * MS)
    up.stop()
    whole(up.batches, "fx")
    assert set(of(up.batches, "gap")["last_missing"]) == {3 + 90 - 1}


SAID = st.lists(
    st.builds(datagram, st.builds(record, st.integers(0, 2**32), st.integers(0, 2**32), st.sampled_from([0, 1 << 31])))
    | st.builds(datagram, st.binary(max_size=80)),
    max_size=3,
)


@settings(max_examples=60)
@given(
    moves=st.lists(
        st.tuples(st.sampled_from([0, MS, 10 * MS, 600 * MS, 10_000 * MS]), SAID, st.integers(0, 40)), max_size=25
    )
)
def test_nothing_that_comes_in_can_raise_or_be_lost_in_silence(moves):
    flight = Flight()
    flight.start()
    fuzzed(flight, moves, lambda after_ns, said: flight.pump(after_ns, b"".join(said)))


def test_a_sensor_that_is_asked_who_it_is_names_its_components():
    port = ScriptedSerial(lambda data: datagram(record(1)) if data == request(2, 1) else b"").open()
    assert [one.number for one in answering(port, lambda seconds: None)] == [1, 2, 3, 4, 5, 6]
    for answer in (b"", datagram(b"HTTP/1.1 400")):
        other = ScriptedSerial(lambda _, answer=answer: answer).open()
        assert not list(answering(other, lambda seconds: None))


@pytest.mark.parametrize("url", ["udp://host", "udp://host:0", "udp://host:65536", "udp://:49152", "udp://h:x"])
def test_a_url_without_host_and_port_is_refused(url):
    with pytest.raises(UrlError, match="49152"):
        UdpPort.open(url)


def test_datagrams_keep_their_ends_and_only_the_peer_s_are_received():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer, socket.socket(type=socket.SOCK_DGRAM) as other:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(5.0)
        port = UdpPort.open(f"udp://127.0.0.1:{peer.getsockname()[1]}")
        assert (port.in_waiting, port.read(10)) == (0, b"")
        assert port.write(START) == 8
        data, address = peer.recvfrom(100)
        assert data == START
        other.sendto(b"no", address)
        for sent in (b"", b"ab", record(1)):
            peer.sendto(sent, address)
        wanted, read, deadline = b"\0\0" + b"\0\2ab" + datagram(record(1)), b"", time.monotonic() + 5.0
        while read != wanted and time.monotonic() < deadline:
            read += port.read(port.in_waiting)
        assert read == wanted
    with pytest.raises(ConnectionRefusedError):  # of the peer's computer: that port is closed
        _asked_until(port, deadline)
    port.close()


def _asked_until(port, deadline):
    while time.monotonic() < deadline:
        port.write(START)
        assert not port.in_waiting


def test_a_frame_error_is_no_end_of_the_stream():
    stream = RecordStream()
    stream.receive(datagram(b"x") + STREAM)
    with pytest.raises(FrameError):
        stream.take()
    assert stream.take() == CONTENTS[0]


# OnRobot's Compute Box. What its example ``highspeed_udp.c`` sends, and where it reads: offsets 0 number, 4 sample
# counter, 8 status, from 12 on Fx to Tz, each 4 bytes, big-endian; 10,000 counts a newton, 100,000 a newton metre.
EXAMPLE = [bytes.fromhex(f"1234{rest}") for rest in ("00820000000a", "008100000004", "004200000000", "000200000000")]


def hex_flight(rate_hz=100.0, low_pass=4) -> Flight:
    return Flight(rate_hz=rate_hz, set_up=onrobot_set_up(rate_hz, low_pass), errors=ANY_BIT)


def test_onrobot_s_box_is_set_up_as_its_example_does_with_5_ms_between_two_requests():
    flight = hex_flight()
    flight.start()
    sent = [len(flight.asked)]
    for _ in range(16):
        flight.pump(MS)
        sent.append(len(flight.asked))
    assert flight.asked == EXAMPLE
    assert [sent.index(n) for n in (1, 2, 3, 4)] == [0, 5, 10, 15]
    flight.records(3)
    flight.stop()
    assert flight.asked == [*EXAMPLE, STOP]
    assert len(whole(flight.batches, "fx")) == 3


def test_a_record_of_onrobot_s_box_is_read_where_its_example_reads_it():
    said = bytes.fromhex("00000007 00000abc 00000000 000186a0 ffffec78 00000000 00002710 fffffffb 000f4240")
    rows = np.frombuffer(said, RECORD)
    assert (int(rows["rdt_sequence"][0]), int(rows["ft_sequence"][0]), int(rows["status"][0])) == (7, 0xABC, 0)
    assert (rows["counts"][0, :3] / 1e4).tolist() == [10.0, -0.5, 0.0]
    assert (rows["counts"][0, 3:] / 1e5).tolist() == [0.1, -5e-5, 10.0]


def test_any_bit_of_the_status_of_onrobot_s_box_is_an_error():
    flight = hex_flight()
    flight.start()
    for _ in range(4):
        flight.pump(5 * MS)
    flight.records(2).records(1, status=1).records(1)
    assert of(flight.batches, "fx")["status"].tolist() == [0, 0, BAD, 0]
    assert codes(flight.batches) == ["started", "sensor_error", "sensor_normal"]


def test_onrobot_s_box_is_set_up_anew_after_a_fault_at_any_call():
    for flight in fault_at_any_call(
        hex_flight, lambda flight: flight.records(9), lambda flight: flight.records(20), fewest_calls=20
    ):
        assert flight.asked[-5:] == [*EXAMPLE, STOP]
        assert len(whole(flight.batches, "fx")) > 8


@pytest.mark.parametrize(("rate_hz", "low_pass"), [(1500.0, 0), (300.0, 0), (2500.0, 0), (100.0, 7), (100.0, -1)])
def test_rates_and_filters_that_onrobot_s_box_has_not_are_refused(rate_hz, low_pass):
    with pytest.raises(ConfigurationError, match="1000 / n"):
        onrobot_set_up(rate_hz, low_pass)
