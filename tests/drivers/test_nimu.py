"""The nIMU: packets, timer, device, against packets typed from the data sheet."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, FrameError
from drivers.nimu import Nimu, NimuConfig, PacketStream, PacketTimer, decode_packets
from drivers.records import IMU, SCALAR, SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.nimu_model import TICK_NS, NimuModel
from tests.drivers.serial_script import MS, Pty, ScriptedSerial, SerialFlight, bytewise, fault_at_any_call, fed, pieces
from tests.drivers.serial_script import whole as at_once

S = 1_000_000_000

# DOC00290 table 3 by hand: timer 1234h; gyro 1, -1, 256; accel 10922 (1 g), 0, -2; magnetometer 0, 0, 11498 (1 gauss);
# temperature 0, 55, -55
PACKET = bytes.fromhex(
    "ffffffff 26 ff 14 1234 0000 0042 0001 ffff 0100 2aaa 0000 fffe 0000 0000 2cea 0000 0037 ffc9 a3".replace(" ", "")
)
WORDS = [1, -1, 256, 10922, 0, -2, 0, 0, 11498, 0, 55, -55]


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
        assert len(stream._buffer) < 38


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


# The timer


PERIOD = 3072  # ticks, 150 Hz


class Timed:
    """A timer that is fed in reads; device time runs on the host's clock, ``late_ns`` late."""

    def __init__(self, period=PERIOD) -> None:
        self.timer, self.period, self.number = PacketTimer(), period, 0

    def read(self, numbers, late_ns=5 * MS, fresh=True, broken_at=()):
        """The packets of these numbers come in one read, ``late_ns`` after the last of them was made."""
        words = np.array([number * self.period % 65536 for number in numbers], np.uint16)
        broken = np.array([number in broken_at for number in numbers])
        host_ns = S + round(numbers[-1] * self.period * TICK_NS) + late_ns
        return self.timer.place(words, broken, host_ns, fresh)


def test_an_unbroken_stream_needs_no_host_time():
    timed = Timed()
    placed = timed.read(range(10), broken_at=(0,))
    assert placed.ticks.tolist() == [PERIOD * n for n in range(10)]
    assert placed.steps.tolist() == [1] * 10
    assert not placed.restarted.any()
    assert not placed.stuck.any()
    rng = np.random.default_rng(0)
    at = 10
    while at < 3000:
        count = int(rng.integers(1, 8))
        late_ns = int(rng.integers(0, 300 * MS))
        placed = timed.read(range(at, at + count), late_ns, fresh=bool(late_ns < 30 * MS))
        assert placed.ticks.tolist() == [PERIOD * n for n in range(at, at + count)]
        assert set(placed.steps) == {1}
        assert not placed.restarted.any()
        assert not placed.stuck.any()
        at += count
    assert timed.timer.period_ns == pytest.approx(PERIOD * TICK_NS)


@pytest.mark.parametrize("lost", [1, 2, 5, 10, 20, 21, 22])
@pytest.mark.parametrize("late_ns", [0, 30 * MS])
@pytest.mark.parametrize("told", [True, False], ids=["with junk", "clean"])
def test_a_loss_is_counted_by_the_timer(lost, late_ns, told):
    timed = Timed()
    timed.read(range(50))
    first = 50 + lost
    placed = timed.read(range(first, first + 4), late_ns, broken_at=(first,) if told else ())
    assert placed.steps.tolist() == [lost + 1, 1, 1, 1]
    assert int(placed.ticks[0]) == PERIOD * first
    assert not placed.restarted.any()


def test_a_loss_of_a_whole_number_of_turns_is_seen_by_the_host():
    timed = Timed()
    timed.read(range(50))
    placed = timed.read(range(50 + 64, 50 + 68))  # 64 periods are 3 turns to the tick
    assert placed.steps.tolist() == [65, 1, 1, 1]
    assert int(placed.ticks[0]) == PERIOD * 114
    assert placed.restarted.tolist() == [True, False, False, False]  # long enough to hide a restart


def test_a_loss_in_a_late_read_is_made_good_by_the_next():
    timed = Timed()
    timed.read(range(50))
    placed = timed.read(range(50 + 64, 50 + 68), fresh=False)
    assert placed.steps.tolist() == [1, 1, 1, 1]
    placed = timed.read(range(118, 120))
    assert int(placed.ticks[-1]) == PERIOD * 119
    assert placed.steps.tolist() == [65, 1]


def test_a_loss_before_the_period_is_known_is_one_packet_at_least():
    timed = Timed()
    timed.read(range(3))
    assert timed.timer.period_ns is None
    assert timed.read([6, 7], broken_at=(6,)).steps.tolist() == [2, 1]


def test_a_timer_that_began_anew_is_seen():
    timed = Timed()
    timed.read(range(50))
    words = (np.arange(5) * PERIOD + 20_000).astype(np.uint16)
    host_ns = S + round(60 * PERIOD * TICK_NS)
    placed = timed.timer.place(words, np.array([True] + [False] * 4), host_ns, True)
    assert placed.restarted.tolist() == [True, False, False, False, False]


def test_a_timer_that_stands_still_is_seen_and_makes_no_loss():
    timed = Timed()
    timed.read(range(50))
    stuck = np.full(200, 49 * PERIOD % 65536, np.uint16)
    for at in range(0, 200, 4):
        host_ns = S + round((50 + at) * PERIOD * TICK_NS)
        placed = timed.timer.place(stuck[at : at + 4], np.zeros(4, bool), host_ns, True)
        assert placed.stuck.all()
        assert set(placed.steps) == {1}
        assert not placed.restarted.any()


def test_a_first_read_without_junk_is_not_stuck():
    assert not Timed().read(range(3)).stuck.any()


def test_a_period_that_drifts_is_followed():
    timer, tick, rng = PacketTimer(), 0.0, np.random.default_rng(1)
    for read in range(3000):
        period = PERIOD * (1.0 + 0.5 * read / 3000)
        made = tick + period * np.arange(1, 4) + rng.uniform(-2, 2, 3)
        tick += 3 * period
        words = (made.round().astype(np.int64) % 65536).astype(np.uint16)
        placed = timer.place(words, np.zeros(3, bool), S + round(tick * TICK_NS), True)
        assert placed.steps.tolist() == [1, 1, 1]
        assert not placed.restarted.any()
    assert timer.period_ns == pytest.approx(1.5 * PERIOD * TICK_NS, rel=0.01)


@pytest.mark.parametrize("period", [1000, PERIOD, 9000, 20_000])
def test_the_period_is_learnt(period):
    timed = Timed(period)
    timed.read(range(20))
    placed = timed.read([23, 24], broken_at=(23,))
    assert placed.steps.tolist() == [4, 1]


# The device


class Flight(SerialFlight):
    """An nIMU of 150 Hz, read every 20 ms."""

    def __init__(self, clock, model=None, **config) -> None:
        self.model = model or NimuModel()
        self.made = 0.0  # ns of the last packet
        port = ScriptedSerial()
        super().__init__(clock, port, Nimu("imu", port.open, clock, NimuConfig(**config)))

    def start(self):
        made = super().start()
        self.made = float(self.clock())
        return made

    def fly(self, pumps: int, keep=lambda packet: packet):
        for _ in range(pumps):
            self.clock.advance(20 * MS)
            while self.made + self.model.period_ns < self.clock():
                self.made += self.model.period_ns
                self.port.say(keep(self.model.packet()))
            self.pump(0)

    def rows(self):
        return whole(self.batches, "imu")


@pytest.fixture
def flight(clock):
    flight = Flight(clock)
    flight.start()
    return flight


def numbers(rows):
    return rows["gyro_raw"][:, 0].astype(int) | rows["accel_raw"][:, 0].astype(int) << 14


def test_rows_carry_what_the_packet_said(flight):
    flight.fly(100)
    rows = flight.rows()
    assert len(rows) == 300
    np.testing.assert_array_equal(numbers(rows), rows["sequence"])
    np.testing.assert_array_equal(rows["tick"], PERIOD * rows["sequence"])
    assert rows["accel_raw"][0].tolist() == [0, -100, 10922]
    assert rows["gyro_raw"][5].tolist() == [5, -7, 0]
    np.testing.assert_array_equal(rows["temperature_raw"], -1)
    assert rows["accel_scale_m_s2"][0] == np.float32(9.1553e-5 * 9.80665)
    assert rows["gyro_scale_rad_s"][0] == np.float32(np.radians(1.3733e-2))
    assert rows["accel_raw"][0, 2] * rows["accel_scale_m_s2"][0] == pytest.approx(9.80665, rel=1e-4)
    assert set(rows["status"]) == {0}
    assert set(rows["sync"]) == set(rows["filter_code"]) == {0}
    x, y, z = (whole(flight.batches, f"imu_mag_{axis}") for axis in "xyz")
    assert (x["value_raw"][3], y["value_raw"][3], z["value_raw"][3]) == (5, -6, -1)
    assert x["scale"][0] == pytest.approx(8.6975e-9)
    assert x["unit"][0] == b"T"
    np.testing.assert_array_equal(x[["sequence", "tick"]], rows[["sequence", "tick"]])
    assert flight.device.channels == {"imu": IMU, "imu_mag_x": SCALAR, "imu_mag_y": SCALAR, "imu_mag_z": SCALAR}
    flight.stop()
    assert codes(flight.batches) == ["started", "stopped"]
    assert of(flight.batches, "gap").size == 0


def test_the_magnetometer_may_be_left_out(clock):
    flight = Flight(clock, magnetometer=False)
    flight.start()
    flight.fly(10)
    assert set(flight.device.channels) == {"imu"}
    assert {batch.channel for batch in flight.batches} == {"imu", "event"}


@pytest.mark.parametrize(
    ("words", "status"),
    [
        ([21846, 0, 0, 0, 0, 0], SampleStatus.SATURATED),  # 300.01 deg/s
        ([21845, -21845, 0, 21845, -21845, 0], 0),
        ([0, 0, 0, 0, 21846, 0], SampleStatus.SATURATED),
        ([0, 0, 0, 0, 0, -32768], SampleStatus.SATURATED),
    ],
)
def test_beyond_the_rated_range_is_saturated(flight, words, status):
    flight.clock.advance(20 * MS)
    flight.port.say(flight.model.packet([*words, *[0] * 6]))
    flight.pump(0)
    assert flight.rows()["status"].tolist() == [status]
    assert whole(flight.batches, "imu_mag_x")["status"].tolist() == [0]


def test_lost_packets_are_gaps_of_exactly_those_packets(flight):
    lost = {100, 101, 102, 150, 200, 201}
    count = iter(range(10**6))
    flight.fly(150, lambda packet: b"" if next(count) in lost else packet)
    rows = flight.rows()
    np.testing.assert_array_equal(numbers(rows), rows["sequence"])
    np.testing.assert_array_equal(rows["tick"], PERIOD * rows["sequence"])
    gaps = of(flight.batches, "gap")
    mine = gaps[gaps["channel"] == b"imu"]
    assert mine[["first_missing", "last_missing"]].tolist() == [(100, 102), (150, 150), (200, 201)]
    assert mine["duration_ns"][0] == pytest.approx(3 * PERIOD * TICK_NS, abs=1000)
    assert set(mine["cause"]) == {b"packets_lost"}
    for axis in "xyz":
        whole(flight.batches, f"imu_mag_{axis}")


@pytest.mark.parametrize("cut", [1, 17, 37])
def test_lost_bytes_cost_one_packet(flight, cut):
    count = iter(range(10**6))
    flight.fly(100, lambda packet: packet[cut:] if next(count) in {50, 220} else packet)
    rows = flight.rows()
    assert sorted(set(range(300)) - set(rows["sequence"].tolist())) == [50, 220]
    np.testing.assert_array_equal(numbers(rows), rows["sequence"])
    assert flight.device.bad_frames == 2
    assert codes(flight.batches).count("bad_frame") == 2


def test_noise_between_packets_costs_nothing(flight):
    count = iter(range(10**6))
    flight.fly(100, lambda packet: packet + b"\x07" * (next(count) == 70))
    assert len(flight.rows()) == 300
    assert of(flight.batches, "gap").size == 0
    assert flight.device.bad_frames == 1


def test_a_restarted_imu_says_so(flight):
    flight.fly(100)
    flight.clock.advance(300 * MS)
    flight.model = NimuModel(timer=12_345)
    flight.made = float(flight.clock())
    flight.fly(50)
    rows = flight.rows()
    assert np.flatnonzero(rows["status"]).tolist() == [300]
    assert rows["status"][300] == SampleStatus.AFTER_RESET
    assert np.all(np.diff(rows["tick"].astype(np.int64)) > 0)
    elapsed = 300 * MS / (PERIOD * TICK_NS)
    assert abs(int(rows["sequence"][300]) - 299 - elapsed) < 23  # a turn of the timer, at worst


def test_a_timer_that_stands_still_is_told(flight):
    flight.fly(50)
    good = len(flight.rows())
    flight.model.period_ticks = 0
    for _ in range(20):
        flight.pump(20 * MS, flight.model.packet() * 3)
    flight.model.period_ticks = PERIOD
    flight.fly(0)
    for _ in range(10):
        flight.pump(20 * MS, flight.model.packet() + flight.model.packet() + flight.model.packet())
    rows = flight.rows()
    # the first standing packet still shows the step of the last running one
    assert set(rows["status"][good + 1 : good + 60]) == {SampleStatus.NOT_VALID}
    assert codes(flight.batches) == ["started", "timer_stuck", "timer_runs"]


def test_the_wrong_span_is_told_with_the_right_one(clock):
    flight = Flight(clock, NimuModel("payload"))
    flight.start()
    flight.fly(200)
    assert of(flight.batches, "imu").size == 0
    (text,) = texts(flight.batches, "silent")
    assert "checksum_span = 'payload'" in text


def test_silence_and_its_end_are_told(flight):
    flight.fly(50)
    good = len(flight.rows())
    flight.fly(100, lambda packet: b"")
    assert codes(flight.batches).count("silent") == 1
    flight.fly(50)
    rows = flight.rows()
    assert codes(flight.batches)[-1] == "bus_recovered"
    np.testing.assert_array_equal(numbers(rows), rows["sequence"])
    np.testing.assert_array_equal(rows["tick"], PERIOD * rows["sequence"])
    assert rows["status"][good] == SampleStatus.AFTER_RESET


def test_what_a_stop_finds_missing_is_named_once(flight):
    flight.fly(50)
    flight.fly(20, lambda packet: b"")
    flight.stop()
    assert of(flight.batches, "gap")["cause"].tolist() == [b"silent"] * 4
    flight.fly(20, lambda packet: b"")
    flight.device.start(flight.clock())
    flight.fly(50)
    rows = flight.rows()
    np.testing.assert_allclose(numbers(rows), rows["sequence"], rtol=0, atol=1)
    gaps = of(flight.batches, "gap")
    assert len(gaps) >= 4
    assert np.all(gaps["last_missing"] >= gaps["first_missing"])


def test_a_port_that_is_gone_is_told_once_and_opened_again(flight):
    flight.fly(50)
    flight.port.broken = True
    flight.fly(100)
    assert 1 <= codes(flight.batches).count("bus_error") <= 2
    flight.port.broken = False
    flight.fly(100)
    rows = flight.rows()
    assert codes(flight.batches)[-1] == "bus_recovered"
    np.testing.assert_array_equal(numbers(rows), rows["sequence"])


def test_a_fault_at_any_call_is_survived(clock):
    for flight in fault_at_any_call(lambda: Flight(clock), lambda f: f.fly(30), lambda f: f.fly(10), 30):
        assert len(flight.rows()) > 90


@pytest.mark.parametrize("most", [1, 11, 38])
def test_it_does_not_matter_how_the_bytes_come(clock, most):
    flight = Flight(clock)
    flight.port.most = most
    flight.start()
    flight.port.say(b"".join(flight.model.packet() for _ in range(30)))
    for _ in range(30 * 38):
        flight.pump(0)
    rows = flight.rows()
    np.testing.assert_array_equal(rows["tick"], PERIOD * np.arange(30))
    np.testing.assert_array_equal(numbers(rows), np.arange(30))


def test_it_works_on_a_pty():
    model = NimuModel()
    pty = Pty(lambda _: b"")
    device = Nimu("imu", pty.open, time.monotonic_ns, NimuConfig(poll_period_ms=0))
    batches = device.start(time.monotonic_ns())
    deadline = time.monotonic() + 5.0
    pty.say(PACKET[9:])
    while of(batches, "imu").size < 60 and time.monotonic() < deadline:
        pty.say(model.packet() + model.packet() + model.packet())
        batches += device.pump(time.monotonic_ns(), 0.02)
    batches += device.stop(time.monotonic_ns())
    pty.close()
    rows = whole(batches, "imu")
    np.testing.assert_array_equal(numbers(rows), np.arange(len(rows)))
    assert codes(batches) == ["started", "stopped"]


def test_a_unit_that_hangs_and_still_sends_is_named_and_its_samples_are_not_valid(flight):
    """Its timer runs on; samples 100 to 149 are one and the same."""
    words = flight.model.payload
    flight.model.payload = lambda number: words(number if number not in range(100, 150) else 100)
    flight.fly(120)
    rows = flight.rows()
    bad = rows["sequence"][(rows["status"] & SampleStatus.NOT_VALID) != 0]
    assert set(range(108, 150)) <= set(bad.tolist()) <= set(range(100, 150))
    assert texts(flight.batches, "stuck")[0].startswith("samples from 100 on are bit-identical")
    assert codes(flight.batches).count("stuck_over") == 1
    assert not len(of(flight.batches, "gap"))
