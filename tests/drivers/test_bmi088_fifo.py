"""FIFOs of a BMI088: frames, and the driver against two dies typed from the data sheet, on I2C and on SPI."""

import errno
from typing import ClassVar

import numpy as np
import pytest

from drivers.errors import ConfigurationError, FrameError
from drivers.inertial.bmi088 import Bmi088Config, Bmi088SpiPort
from drivers.inertial.bmi088_fifo import Bmi088Fifo, decode_frames
from tests.drivers.batches import codes, of
from tests.drivers.chip_flight import ChipFlight
from tests.drivers.i2c_model import MS
from tests.drivers.test_bmi088 import GYRO, NAME, RESET, SATURATED, Bmi088Model
from tests.drivers.test_bmi088_spi import Bmi088SpiModel, Line

CONFIG = Bmi088Config(mode="fifo")
FRAME, TIME = "84 0100 ff7f 0080", "44 010203"
ACCEL_NS, GYRO_NS, TICK_NS = 625_000, 1_000_000, 39_062.5
UNIT_NS, ZERO = 100_000, 30_000  # of the words below


class Fifos:
    """Adds to a model of both dies its FIFOs; ``slow``: lengths of their periods."""

    reset_values: ClassVar = {**Bmi088Model.reset_values, 0x45: 0x80, 0x48: 0x02, 0x49: 0x10}

    def reset(self) -> None:
        super().reset()
        self.fifos, self.made = {0: [], GYRO: []}, {0: None, GYRO: None}
        self.skipped, self.overrun, self.stream, self.taken = 0, 0, b"", 0

    def period_ns(self, die: int) -> float:
        return (GYRO_NS if die else ACCEL_NS) * getattr(self, "slow", {0: 1.0, GYRO: 1.0})[die]

    def run(self) -> None:
        super().run()
        now_ns, r = self.clock(), self.registers
        is_on = r.get(0x7D) == 4 and self.on_ns is not None and now_ns >= self.on_ns and not self.stands_still
        for die, takes, most in ((0, is_on and r[0x49] == 0x50, 146), (GYRO, r.get(GYRO | 0x3E) == 0x80, 100)):
            number = int(now_ns // self.period_ns(die)) if takes else None
            if number is not None and self.made[die] is not None:
                words = self.rate if die else self.force
                for n in range(max(self.made[die] + 1, number - 200), number + 1):
                    sample = np.array(words(round(n * self.period_ns(die))), "<i2").tobytes()
                    self.fifos[die].append(sample)
                over = len(self.fifos[die]) - most
                if over > 0:
                    del self.fifos[die][:over]
                    self.skipped, self.overrun = (self.skipped, 0x80) if die else (over, self.overrun)
            self.made[die] = number

    def wrote(self, register: int, value: int) -> None:
        super().wrote(register, value)
        if (self.die | register) == GYRO | 0x3E:
            self.fifos[GYRO], self.overrun = [], 0
        if (self.die | register, value) in ((0x49, 0x50), (GYRO | 0x3E, 0x80)):
            self.made[self.die] = int(self.clock() // self.period_ns(self.die))

    def byte(self, register: int) -> int:
        where = self.die | register
        if where in (0x24, 0x25):
            return (7 * len(self.fifos[0]) + 2 * bool(self.skipped) >> 8 * (where - 0x24)) & 0xFF
        return len(self.fifos[GYRO]) | self.overrun if where == GYRO | 0x0E else super().byte(register)

    def popped(self, count: int) -> bytes:
        """What a reading of the addressed die's FIFO gives; frames that are read whole are gone."""
        fifo = self.fifos[self.die]
        if self.die:
            data, gone = b"".join(fifo), min(count // 6, len(fifo))
        else:
            first = bytes([0x40, min(self.skipped, 255)]) if self.skipped else b""
            ticks = int(self.clock() / TICK_NS / self.period_ns(0) * ACCEL_NS) + self.ahead & 0xFFFFFF
            data = first + b"".join(b"\x84" + one for one in fifo) + b"\x44" + ticks.to_bytes(3, "little")
            gone = min(max(count - len(first), 0) // 7, len(fifo))
            self.skipped = 0
        del fifo[:gone]
        return data[:count].ljust(count, b"\x80")


class OnI2c(Fifos, Bmi088Model):
    def write_read(self, address, data, count):
        if data[0] not in (0x26, 0x3F) or (data[0] == 0x26) != (address == 0x18):
            return super().write_read(address, data, count)
        reply = super().write_read(address, data, 0)
        return reply._replace(data=self.popped(count))


class OnSpi(Fifos, Bmi088SpiModel):
    def frame(self, die, frame):
        self.die = GYRO * die
        if frame[0] & 0x7F != (0x3F if die else 0x26) or die in self.absent:
            begin, register = 1 if die else 2, frame[0] & 0x7F
            span = range(register, register + len(frame) - begin)
            assert frame[0] < 0x80 or (0x3F if die else 0x26) not in span  # it would pop
            return super().frame(die, frame)
        begin = 1 if die else 2
        return bytes(begin) + self.popped(len(frame) - begin)


class Flight(ChipFlight):
    def __init__(self, clock, config=CONFIG, chip=None):
        model = chip or OnI2c(clock)
        self.zero = clock() // UNIT_NS + ZERO
        model.force = model.rate = lambda now_ns: (now_ns // UNIT_NS - self.zero, 7, -7)
        port = Bmi088SpiPort(Line(model, 0), Line(model, 1)) if isinstance(model, OnSpi) else model
        super().__init__(clock, model, Bmi088Fifo(NAME, port, config))

    def in_order(self):
        """Rows and gaps give each number once; ticks go on by the period."""
        rows, gaps = self.rows(), of(self.batches, "gap")
        lost = sum(int(one["last_missing"] - one["first_missing"]) + 1 for one in gaps)
        numbers = rows["sequence"].astype(int)
        assert numbers[-1] + 1 == len(rows) + lost
        assert (np.diff(numbers) > 0).all()
        assert (np.diff(rows["host_ns"]) >= 0).all()
        return rows, gaps


CHIPS = pytest.mark.parametrize("chip", [OnI2c, OnSpi])
AT_ANY_PLACE = pytest.mark.parametrize(
    "chip",
    [pytest.param(OnI2c, marks=pytest.mark.campaign), OnSpi],  # of chips on I2C: test_chip_laws
)


def test_frames_as_they_are_coded():
    data = bytes.fromhex(f"40 05 48 00 {FRAME} 50 00 87 0200 0000 0000 {TIME} 80 80 84")
    words, ticks, skipped = decode_frames(data)
    assert words.tolist() == [[1, 32767, -32768], [2, 0, 0]]
    assert (ticks, skipped) == (0x030201, True)
    assert decode_frames(b"\x80\0").ticks is None
    with pytest.raises(FrameError, match="no header"):
        decode_frames(b"\0\0")


def test_a_frame_that_is_cut_is_left_out_whole():
    whole = bytes.fromhex(FRAME + TIME)
    for size in range(len(whole)):
        words, ticks, skipped = decode_frames(whole[:size])
        assert (len(words), ticks, skipped) == (size >= 7, None, False)


@pytest.mark.parametrize("wrong", [{"poll_period_ms": 40.0}, {"poll_period_ms": 0.0}, {"max_transfer_bytes": 13}])
def test_what_would_run_over_is_refused(wrong):
    with pytest.raises(ConfigurationError, match="less than half a FIFO"):
        Bmi088Config(mode="fifo", **wrong)


@pytest.mark.parametrize("early_ms", [0.9, 1.4, 2.1, 2.8])
def test_the_first_samples_wait_for_two_of_the_gyroscope(clock, early_ms):
    chip = OnI2c(clock, transfer_ns=20_000)
    flight = Flight(clock, chip=chip)
    while "started" not in codes(flight.batches):
        flight.fly(0.001)
    clock.advance(round(early_ms * MS))
    flight.batches += flight.device.pump(clock())
    flight.fly(0.5)
    flight.batches += flight.device.stop(clock())
    rows, gaps = flight.in_order()
    assert len(gaps) == 0
    first_ns = (int(rows["accel_raw"][0, 0]) + flight.zero) * UNIT_NS
    begun_ns = next(one["host_ns"] for one in of(flight.batches, "event") if one["code"] == b"started")
    assert first_ns - int(begun_ns) < 0.8 * MS


@CHIPS
@pytest.mark.parametrize("longest", [14, pytest.param(40, marks=pytest.mark.campaign), 252])  # between the others
def test_rows_are_the_accelerometer_s_samples_and_rates_lie_between(clock, chip, longest):
    flight = Flight(clock, Bmi088Config(mode="fifo", max_transfer_bytes=longest), chip(clock, transfer_ns=20_000))
    flight.fly(2.0)
    assert codes(flight.batches) == ["started"]
    rows, gaps = flight.in_order()
    assert len(gaps) == 0
    assert len(rows) > 1.75 * 1600
    assert set(np.diff(rows["tick"].astype(int))) == {16}
    late = rows["gyro_raw"][:, 0] - rows["accel_raw"][:, 0].astype(int)
    settled = late[1600:]
    assert abs(np.median(settled)) <= 5  # 0.5 ms, of 0.1: the count bounds the gyroscope's time to half a sample
    assert np.ptp(settled) <= 12
    late_ns = rows["host_ns"].astype(int) - (rows["accel_raw"][:, 0].astype(int) + flight.zero) * UNIT_NS
    assert np.abs(late_ns).max() < 0.2 * MS
    assert set(rows["temperature_raw"]) == {127}


def test_periods_and_clocks_of_both_dies_are_their_own(clock):
    chip = OnI2c(clock, transfer_ns=20_000)
    chip.slow = {0: 1.01, GYRO: 0.985}
    chip.rate_of_ticks = 1.0 / 1.01
    flight = Flight(clock, chip=chip)
    flight.fly(3.0)
    rows, gaps = flight.in_order()
    assert len(gaps) == 0
    late = rows["gyro_raw"][3000:, 0] - rows["accel_raw"][3000:, 0].astype(int)
    assert abs(np.median(late)) <= 6
    assert np.ptp(late) <= 14


@pytest.mark.parametrize("ahead", [-1, 1])
def test_after_a_loss_no_sample_is_dated_by_a_sensor_time_at_the_edge_of_one(clock, ahead):
    """The sensor time goes on a tick before, or after, a sample comes into the FIFO."""
    for phase in range(16):
        clock.advance(round(phase * TICK_NS))
        chip = OnI2c(clock, transfer_ns=20_000)
        chip.ahead = ahead
        flight = Flight(clock, chip=chip)
        flight.fly(0.3)
        broken = len(chip.transfers) + 1
        chip.fail = lambda number, broken=broken: errno.EIO if number == broken else 0
        flight.fly(0.2)
        rows, _ = flight.in_order()
        true_ns = np.diff(rows["accel_raw"][:, 0].astype(float)) * UNIT_NS
        assert np.diff(rows["sequence"].astype(int)) == pytest.approx(true_ns / ACCEL_NS, abs=0.2), phase


@pytest.mark.parametrize("register", [0x24, 0x26, 0x0E, 0x3F])
def test_a_host_that_was_away_for_20_ms_between_any_two_transfers_loses_nothing(clock, register):
    chip = OnI2c(clock, transfer_ns=20_000)
    flight = Flight(clock, chip=chip)
    flight.fly(1.0)

    def late(number):
        if number % 11 == 0 and chip.transfers[-1][2] == register:
            clock.advance(20 * MS)
            chip.run()
        return 0

    chip.fail = late
    flight.fly(1.5)
    rows, gaps = flight.in_order()
    assert len(gaps) == 0
    assert np.ptp(rows["gyro_raw"][1600:, 0] - rows["accel_raw"][1600:, 0].astype(int)) <= 15


@pytest.mark.parametrize("die", [0, GYRO])
def test_a_host_that_was_away_too_long_counts_what_ran_over(clock, die):
    flight = Flight(clock, chip=OnI2c(clock, transfer_ns=20_000))
    flight.fly(1.0)
    clock.advance(60 * MS)
    flight.batches += flight.device.pump(clock())
    assert len(of(flight.batches, "gap")) == 0  # 96 and 60 samples: they wait
    clock.advance((95 if die == 0 else 140) * MS)
    flight.fly(1.0)
    rows, gaps = flight.in_order()
    assert len(gaps) >= 1
    assert set(gaps["cause"]) == {b"fifo_overflow"}
    assert codes(flight.batches) == ["started"]
    late = rows["gyro_raw"][-800:, 0] - rows["accel_raw"][-800:, 0].astype(int)
    assert abs(np.median(late)) <= 12
    true_ns = np.diff(rows["accel_raw"][:, 0].astype(float)) * UNIT_NS
    assert np.diff(rows["sequence"].astype(int)) == pytest.approx(true_ns / ACCEL_NS, abs=0.2)


@AT_ANY_PLACE
@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.campaign)])  # places between those of the other
def test_one_failed_transfer_at_any_place_is_survived(clock, chip, every):
    for place in range(0, 60, every):
        model, code = chip(clock, transfer_ns=20_000), (errno.EREMOTEIO, errno.EIO)[place % 2]
        model.fail = lambda number, place=place, code=code: code if number == place else 0
        flight = Flight(clock, chip=model)
        flight.fly(0.5)
        said = codes(flight.batches)
        assert said in (["started"], ["started", "bus_error", "bus_recovered"]), place
        rows, gaps = flight.in_order()
        assert {one["cause"] for one in gaps} <= {b"bus_error"}
        true_ns = np.diff(rows["accel_raw"][:, 0].astype(float)) * UNIT_NS
        assert np.diff(rows["sequence"].astype(int)) == pytest.approx(true_ns / ACCEL_NS, abs=0.2), place


@AT_ANY_PLACE
@pytest.mark.parametrize(
    ("first", "code"),
    [
        (0, errno.EREMOTEIO),
        pytest.param(3, errno.ETIMEDOUT, marks=pytest.mark.campaign),  # places between those of the other
    ],
)
def test_a_bus_that_dies_at_any_transfer_is_told_once_and_survived(clock, chip, first, code):
    for place in range(first, 60, 6):
        model = chip(clock)
        dead = {"until": 1 << 30}
        model.fail = lambda number, place=place, dead=dead: code if place <= number < dead["until"] else 0
        flight = Flight(clock, chip=model)
        flight.fly(1.5)
        said = [one for one in codes(flight.batches) if one != "started"]
        assert said in (["no_answer"], ["bus_error"]), place
        dead["until"] = 0
        flight.fly(2.0)
        assert codes(flight.batches)[-1] in ("started", "bus_recovered")
        assert len(flight.in_order()[0]) > 800


@CHIPS
def test_a_brown_out_is_seen_and_ticks_go_on(clock, chip):
    flight = Flight(clock, chip=chip(clock))
    flight.fly(1.0)
    flight.chip.reset()
    flight.fly(1.5)
    said = codes(flight.batches)
    assert said[0] == said[-1] == "started"
    assert set(said[1:-1]) <= {"no_samples", "brown_out", "bus_error", "configuration_lost"}
    rows, gaps = flight.in_order()
    assert rows["status"].tolist().count(RESET) == 1
    assert len(gaps) == 1
    assert (np.diff(rows["tick"].astype(int)) > 0).all()


@pytest.mark.parametrize("die", [0, GYRO])
def test_a_die_that_stops_is_set_up_again(clock, die):
    flight = Flight(clock)
    flight.fly(1.0)
    if die:
        flight.chip.registers[GYRO | 0x3E] = 0
    else:
        flight.chip.stands_still = True
    flight.fly(0.15)
    assert codes(flight.batches)[:2] in (["started", "no_samples"], ["started", "brown_out"])
    flight.chip.stands_still = False
    flight.fly(1.0)
    assert codes(flight.batches)[-1] == "started"
    assert len(flight.in_order()[1]) == 1


def test_what_is_no_frame_is_an_error_of_the_bus(clock):
    flight = Flight(clock)
    flight.fly(0.5)
    popped, flight.chip.popped = flight.chip.popped, lambda count: b"\x11" * count
    flight.fly(0.1)
    flight.chip.popped = popped
    flight.fly(1.0)
    assert codes(flight.batches) == ["started", "bus_error", "bus_recovered"]
    flight.in_order()


def test_a_word_at_an_end_of_its_range_is_saturated(clock):
    flight = Flight(clock)
    flight.fly(0.5)
    assert not flight.rows()["status"].any()
    flight.chip.rate = lambda now_ns: (1, 2, -32768)
    flight.fly(0.1)
    assert SATURATED in set(flight.rows()["status"][-40:])


def test_its_sensor_time_begins_again_at_0_after_24_bits(clock):
    chip = OnI2c(clock)
    chip.ahead = (1 << 24) - int(clock() / TICK_NS) % (1 << 24) - 20_000
    flight = Flight(clock, chip=chip)
    flight.fly(2.0)
    assert codes(flight.batches) == ["started"]
    rows, gaps = flight.in_order()
    assert len(gaps) == 0
    assert rows["tick"][-1] > 1 << 24
