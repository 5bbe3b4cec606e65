"""The nIMU as a device: rows, gaps, events and faults of a scripted line and of a pty."""

import itertools
import time

import numpy as np
import pytest

from drivers.nimu import Nimu, NimuConfig
from drivers.records import IMU, SCALAR, SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.nimu_model import PACKET, PERIOD, TICK_NS, NimuModel
from tests.drivers.serial_script import MS, Pty, ScriptedSerial, SerialFlight, run_for


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
    said = itertools.chain([PACKET[9:]], iter(lambda: b"".join(model.packet() for _ in range(3)), b""))
    batches = run_for(device, "imu", 60, lambda _: pty.say(next(said)), timeout_s=0.02)
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
