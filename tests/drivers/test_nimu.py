"""The nIMU's packets, against packets typed from the data sheet, and its configuration."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, FrameError
from drivers.nimu import Nimu, NimuConfig, PacketStream, decode_packets
from tests.drivers.nimu_model import PACKET, WORDS, NimuModel
from tests.drivers.serial_script import ScriptedSerial, bytewise, fed, pieces
from tests.drivers.serial_script import whole as at_once


def test_the_packet_of_the_data_sheet():
    assert len(PACKET) == 38
    assert sum(PACKET[:-1]) % 256 == PACKET[-1]
    packets = decode_packets(PACKET)
    assert packets.timer.tolist() == [0x1234]
    assert packets.words.tolist() == [WORDS]
    assert decode_packets(b"").timer.size == 0


@pytest.mark.parametrize("span", ["packet", "after_sync", "payload"])
def test_each_span_of_the_checksum(span):
    model = NimuModel(span)
    data = b"".join(model.packet() for _ in range(50))
    assert decode_packets(data, span).timer.size == 50
    for other in {"packet", "after_sync", "payload"} - {span}:
        with pytest.raises(FrameError, match=f"it is that of checksum_span = '{span}'"):
            decode_packets(data, other)


@pytest.mark.parametrize("at", [*range(5), 6, *range(7, 38)])
def test_a_flipped_bit_is_refused(at):
    spoiled = bytearray(PACKET)
    spoiled[at] ^= 0x10
    with pytest.raises(FrameError):
        decode_packets(PACKET + bytes(spoiled))
    with pytest.raises(FrameError):
        decode_packets(PACKET[: max(at, 1)])


FEEDS = {"whole": at_once, "bytewise": lambda _: bytewise(), "pieces": lambda _: pieces(7)}
JUNK = {
    "nothing": b"",
    "FF": b"\xff",
    "FFFFFF": b"\xff" * 3,
    "half a packet": PACKET[11:],
    "a header too many": PACKET[:20],
    "zeros": bytes(50),
}


@pytest.mark.parametrize("feed", FEEDS.values(), ids=FEEDS)
@pytest.mark.parametrize("junk", JUNK.values(), ids=JUNK)
@pytest.mark.parametrize("after", [b"", PACKET[:37], b"\xff" * 4])
def test_fed_any_way_the_same_comes_out(feed, junk, after):
    model = NimuModel()
    run = [model.packet() for _ in range(100)]
    data = junk + b"".join(run[:60]) + junk + b"".join(run[60:]) + after
    taken, errors = fed(PacketStream(), data, feed(data))
    words = np.concatenate([packets.words for packets in taken])
    np.testing.assert_array_equal(words, [NimuModel().payload(n) for n in range(100)])
    assert bool(errors) == bool(junk)


def test_a_broken_stream_forgets_its_half_packet():
    stream = PacketStream()
    stream.receive(PACKET[:9])
    stream.clear()
    stream.receive(PACKET[9:] + PACKET)
    with pytest.raises(FrameError):
        stream.take()
    assert stream.take().words.tolist() == [WORDS]


@given(st.lists(st.binary(max_size=60) | st.sampled_from([PACKET, PACKET[:5], b"\xff" * 9, PACKET[5:]]), max_size=10))
def test_any_bytes_give_packets_nothing_or_frame_error(chunks):
    stream = PacketStream()
    for chunk in chunks:
        taken, _ = fed(stream, chunk, at_once(chunk))
        assert all(len(packets.timer) == len(packets.words) > 0 for packets in taken)
        assert len(stream.waiting) < 38


@given(st.binary(max_size=120))
def test_a_packet_after_any_junk_is_found(junk):
    taken, _ = fed(PacketStream(), junk + bytes(37) + 2 * PACKET, bytewise())
    assert taken[-1].words[-1].tolist() == WORDS


def test_a_stretch_full_of_headers_is_got_over_quickly():
    stream = PacketStream()
    data = PACKET[:5] * 4000 + PACKET
    before = time.process_time()
    taken, _ = fed(stream, data, at_once(data))
    assert taken[-1].words.tolist() == [WORDS]
    assert time.process_time() - before < 2.0


@pytest.mark.parametrize(
    "bad",
    [{"accel_range_g": 0.0}, {"gyro_scale_deg_s": -1.0}, {"checksum_span": "all"}, {"magnetometer_scale_gauss": 0.0}],
)
def test_a_configuration_that_cannot_be_is_refused(bad):
    with pytest.raises(ConfigurationError):
        NimuConfig(**bad)


@pytest.mark.parametrize("bad", [{"poll_period_ms": -1.0}, {"silence_ms": 0.0}])
def test_times_that_cannot_be_are_refused(clock, bad):
    with pytest.raises(ConfigurationError):
        Nimu("imu", ScriptedSerial().open, clock, NimuConfig(**bad))
