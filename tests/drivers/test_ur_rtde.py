"""A robot controller by RTDE: packages fed three ways, set-up and refused steps, states of the robot, the TCP port."""

import contextlib
import math
import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import FrameError, UrlError
from drivers.transports.network import TcpPort
from drivers.ur_rtde import PackageStream, decode_recipe, decode_text
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.rtde_flight import BAD, MS, PERIOD_S, Flight
from tests.drivers.rtde_model import PACKED, framed, text
from tests.drivers.serial_script import bytewise, fed, pieces
from tests.drivers.serial_script import whole as at_once


@pytest.fixture
def up():
    flight = Flight()
    flight.start()
    return flight.packages(3)


PACKAGES = [
    (ord("V"), b"\1"),
    (ord("v"), struct.pack(">4I", 5, 11, 1, 0)),
    (ord("M"), text("protective stop")[3:]),
    (ord("O"), b"\1DOUBLE,VECTOR6D"),
    (ord("S"), b"\1"),
    (ord("U"), bytes(57)),
    (ord("P"), b"\1"),
]
STREAM = b"".join(framed(chr(kind), payload) for kind, payload in PACKAGES)


@pytest.mark.parametrize("feed", [at_once(STREAM), bytewise(), pieces(3), pieces(8, 9)])
def test_fed_any_way_the_same_packages_come_out(feed):
    taken, errors = fed(PackageStream(), STREAM, feed)
    assert taken == PACKAGES
    assert errors == []


@pytest.mark.parametrize("junk", [b"\0\2U", b"\0\0\0", b"\x10\1U", b"\0\4Z\0", b"GET / HTTP/1.1\r\n"])
def test_a_header_that_cannot_be_discards_what_came_with_it(junk):
    taken, errors = fed(PackageStream(), STREAM + junk, at_once(b" " * 999))
    assert taken == PACKAGES
    assert len(errors) == 1
    assert "30004" in errors[0]


@settings(max_examples=80)
@given(data=st.data())
def test_any_bytes_give_packages_or_a_frame_error(data):
    stream = PackageStream()
    letters = st.sampled_from("VvMOSUIP")
    for piece in data.draw(st.lists(st.binary(max_size=40) | st.builds(framed, letters, st.binary(max_size=60)))):
        stream.receive(piece)
        for _ in range(100):
            try:
                one = stream.take()
            except FrameError:
                continue
            if one is None:
                break
            for decode in (decode_text, lambda payload: decode_recipe(payload, ["timestamp", "actual_q"])):
                with contextlib.suppress(FrameError):
                    decode(one.payload)
        else:
            pytest.fail("100 packages or errors in at most 60 bytes")


def test_set_up_by_the_guide_and_its_rows(up):
    names = "timestamp,robot_mode,safety_status_bits,actual_q,actual_current,ft_raw_wrench"
    assert up.model.asked == [
        ("V", b"\0\2"),
        ("v", b""),
        ("O", struct.pack(">d", 125.0) + names.encode()),
        ("S", b""),
    ]
    up.stop()
    assert codes(up.batches) == ["identified", "started", "stopped"]
    assert texts(up.batches, "identified") == ["URControl 5.11.1.108318"]
    expected = {"q1": (0.5, b"rad"), "q6": (-5.5, b"rad"), "i2": (2.5, b"A"), "fz": (-1.0, b"N")}
    for channel, (value, unit) in expected.items():
        rows = whole(up.batches, channel)
        assert len(rows) == 3
        assert rows["value_raw"] * rows["scale"] == pytest.approx(value, abs=1e-9)
        assert set(rows["unit"]) == {unit}
        assert rows["tick"].tolist() == [100_008_000, 100_016_000, 100_024_000]
        assert set(rows["device_status"]) == {1}
        assert not rows["status"].any()
    assert (of(up.batches, "q6")["scale"] < 0).all()


def test_an_answer_in_pieces_and_several_packages_at_once_are_the_same():
    flight = Flight()
    flight.port.most = 1
    flight.start()
    for _ in range(200):
        flight.pump(MS)
    flight.port.most = 10_000
    data = [flight.model.data(1.0 + 0.008 * k, actual_q=k) for k in range(5)]
    flight.pump(8 * MS, b"".join(data)[:100])
    flight.pump(8 * MS, b"".join(data)[100:])
    rows = whole(flight.batches, "q1")
    assert np.rint(rows["value_raw"] * rows["scale"]).tolist() == [0, 1, 2, 3, 4]


REFUSALS = {
    "protocol version 1 only": ("V", b"\0", "refused", "version 2"),
    "does not start": ("S", b"\0", "refused", "start"),
    "no recipe": ("O", b"\0DOUBLE,INT32,UINT32,VECTOR6D,VECTOR6D,VECTOR6D", "refused", "CB3"),
    "a version of another length": ("v", bytes(15), "out_of_step", "15 bytes"),
    "an acceptance of another length": ("S", b"\1\1", "out_of_step", "2 bytes"),
    "types for other outputs": ("O", b"\1DOUBLE", "out_of_step", "1 types for 6 outputs"),
    "an unknown type": ("O", b"\1DOUBLE,INT32,UINT32,VECTOR6D,VECTOR6D,VECTOR7D", "out_of_step", "VECTOR7D"),
    "nothing": ("O", b"", "out_of_step", "types"),
}


@pytest.mark.parametrize(("letter", "answer", "code", "part"), REFUSALS.values(), ids=REFUSALS)
def test_a_refused_step_is_told_once_and_tried_again_ever_more_rarely(letter, answer, code, part):
    flight = Flight()
    flight.model.says[letter] = answer
    flight.start()
    flight.packages(250)
    assert len(of(flight.batches, "q1")) == 0
    assert codes(flight.batches).count(code) == 1
    assert part in texts(flight.batches, code)[0]
    assert 4 <= flight.port.opened <= 8  # after 20, 40, 80, 160, 320, 640 ms
    del flight.model.says[letter]
    flight.packages(150)
    assert len(of(flight.batches, "q1")) > 20
    assert "bus_recovered" in codes(flight.batches)


def test_an_answer_that_does_not_come_opens_the_connection_anew():
    flight = Flight()
    flight.port.answer = lambda _: b""
    flight.start()
    flight.packages(400)
    assert flight.port.opened > 2
    assert codes(flight.batches).count("silent") == 1


def test_an_output_that_it_has_not_is_left_out_and_the_rest_recorded():
    flight = Flight()
    flight.model.lacks = {"ft_raw_wrench": "NOT_FOUND", "robot_mode": "UINT32"}
    flight.start()
    flight.packages(4)
    flight.port.broken = True
    flight.packages(2)
    flight.port.broken = False
    flight.packages(10)
    flight.stop()
    (told,) = texts(flight.batches, "not_found")  # once, though it was asked twice
    assert "ft_raw_wrench is NOT_FOUND" in told
    assert "robot_mode is UINT32" in told
    assert len(whole(flight.batches, "q1")) > 8
    assert len(whole(flight.batches, "fz")) == 0
    (gap,) = [row for row in of(flight.batches, "gap") if row["channel"] == b"fz"]
    assert gap["cause"] == b"not_found"


@pytest.mark.parametrize(
    ("lacks", "code"),
    [
        ({"actual_q": "IN_USE"}, "in_use"),
        ({"timestamp": "NOT_FOUND"}, "not_found"),
        (dict.fromkeys(("actual_q", "actual_current", "ft_raw_wrench"), "NOT_FOUND"), "not_found"),
    ],
)
def test_without_a_time_or_any_output_nothing_is_recorded(lacks, code):
    flight = Flight()
    flight.model.lacks = lacks
    flight.start()
    flight.packages(100)
    assert codes(flight.batches).count(code) == 1
    assert flight.model.asked[-1][0] == "O"
    flight.model.lacks = {}
    flight.packages(100)
    assert len(of(flight.batches, "q1")) > 10


def test_numbers_that_are_none_are_not_valid(up):
    for value in (math.nan, math.inf, -1e300):
        up.packages(1, actual_q=value)
    for channel, bad in {"q1": BAD, "i2": 0}.items():
        assert of(up.batches, channel)["status"].tolist() == [0, 0, 0, *[bad] * 3]
    assert of(up.batches, "q1")["value_raw"][3:].tolist() == [0, 0, 0]


def test_a_protective_stop_and_its_end(up):
    up.packages(2, safety_status_bits=0b100_0000_0100)
    assert texts(up.batches, "safety") == ["protective stop, stopped due to safety: clear it on the teach pendant"]
    assert of(up.batches, "q1")["device_status"].tolist() == [1, 1, 1, 4, 4]
    assert not of(up.batches, "q1")["status"].any()  # it measures, where it stands
    up.packages(1, safety_status_bits=0b11)
    up.packages(1)
    assert codes(up.batches)[2:] == ["safety", "safety_normal"]
    short = [up.model.data(up.time_s + k * PERIOD_S, safety_status_bits=bits) for k, bits in ((1, 1), (2, 4), (3, 1))]
    up.pump(2000 * MS, b"".join(short))  # within one read
    assert codes(up.batches)[4:] == ["safety", "safety_normal"]


@pytest.mark.parametrize("mode", [-1, 3, 4, 8])
def test_without_power_angles_are_held_and_not_measured(up, mode):
    up.packages(2, robot_mode=mode)
    up.packages(1, robot_mode=5)
    assert of(up.batches, "q1")["status"].tolist() == [0, 0, 0, BAD, BAD, 0]
    assert codes(up.batches)[2:] == ["arm_off", "arm_on"]
    assert f"robot mode {mode} (" in texts(up.batches, "arm_off")[0]


@pytest.mark.parametrize(("level", "severity"), [(0, 2), (1, 2), (2, 1), (3, 0)])
def test_messages_of_the_controller_are_events(up, level, severity):
    up.pump(MS, text("joint limit", "RTMachine", level))
    (event,) = [row for row in of(up.batches, "event") if row["code"] == b"controller"]
    assert (event["text"], event["severity"]) == (b"RTMachine: joint limit", severity)


@pytest.mark.parametrize("payload", [b"", b"\5abc", b"\1a\2b\1", b"\1a\1b", b"\1a\1b\1\1"])
def test_a_message_with_other_lengths_is_refused(payload):
    with pytest.raises(FrameError, match="lengths"):
        decode_text(payload)


@pytest.mark.parametrize("url", ["tcp://host", "tcp://host:0", "tcp://host:65536", "tcp://:30004", "tcp://h:x"])
def test_a_url_without_host_and_port_is_refused(url):
    with pytest.raises(UrlError, match="30004"):
        TcpPort.open(url)


@pytest.fixture
def listener():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        yield server


def eventually(read, wanted: bytes) -> bytes:
    """What a port has read by the time that it is ``wanted``."""
    data, deadline = b"", time.monotonic() + 5.0
    while data != wanted and time.monotonic() < deadline:
        data += read()
    return data


def test_a_connection_carries_bytes_both_ways_and_ends_after_the_last_of_them(listener):
    url = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
    port = TcpPort.open(url)
    assert (port.in_waiting, port.read(10)) == (0, b"")
    other, _ = listener.accept()
    assert port.write(b"V") == 1
    assert other.recv(10) == b"V"
    other.sendall(b"abcde")
    other.close()
    assert eventually(lambda: port.read(2) if port.in_waiting else b"", b"abcde") == b"abcde"
    with pytest.raises(OSError, match="closed"):
        eventually(lambda: bytes(port.in_waiting), b"never")
    port.close()
    listener.close()
    with pytest.raises(ConnectionRefusedError):
        TcpPort.open(url)


def test_packages_of_universal_robots_own_serialiser(up):
    up.pump(8 * MS, framed("U", PACKED))
    for channel, value in {"q1": 0.1, "q6": 3.0, "i2": -1.25, "fz": -34.5}.items():
        row = of(up.batches, channel)[-1]
        assert row["value_raw"] * row["scale"] == pytest.approx(value, abs=1e-9)
        assert (row["sequence"], row["tick"], row["status"], row["device_status"]) == (3, 100_032_000, 0, 1)
