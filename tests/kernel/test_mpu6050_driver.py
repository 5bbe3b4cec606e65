"""Our driver on /dev/i2c-N: every sample that the chip makes comes out, or is named."""

import errno
import re
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers.errors import SelfTestError
from drivers.mpu6050 import Mpu6050, Mpu6050Config
from drivers.ports import I2cPort
from drivers.records import Batch, Rows
from drivers.transports import open_i2c
from tests.kernel.conftest import Served

POLL_S = 0.010


@pytest.fixture
def port(chip: Served) -> Iterator[I2cPort]:
    port = open_i2c(chip.urls["i2c_1"], time.monotonic_ns)
    yield port
    port.close()


def fly(device: Mpu6050, duration_s: float) -> list[Batch]:
    """Start, pump every 10 ms, stop."""
    batches = device.start(time.monotonic_ns())
    due = time.monotonic()
    end = due + duration_s
    while due < end:
        batches += device.pump(time.monotonic_ns())
        due = max(due + POLL_S, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
    return batches + device.stop(time.monotonic_ns())


def rows_of(batches: list[Batch], channel: str) -> Rows:
    return np.concatenate([batch.rows for batch in batches if batch.channel == channel])


def events(batches: list[Batch]) -> list[bytes]:
    return [code for batch in batches if batch.channel == "event" for code in batch.rows["code"].tolist()]


def sample_ms(rows: Rows) -> Rows:
    """Which millisecond of the chip a row was made in: what the twin writes into accel x and y."""
    words = rows["accel_raw"].astype(np.int64)
    return np.asarray(words[:, 0] + (words[:, 1] << 15))


def gaps_of(batches: list[Batch]) -> list[np.void]:
    return [batch.rows[0] for batch in batches if batch.channel == "gap"]


def missing(batches: list[Batch]) -> int:
    return sum(int(gap["last_missing"]) - int(gap["first_missing"]) + 1 for gap in gaps_of(batches))


def check_accounts(batches: list[Batch]) -> Rows:
    """Every number is a row's or a gap's, and between two gaps each row is the chip's next sample; the rows."""
    rows = rows_of(batches, "imu")
    assert len(rows) + missing(batches) == rows["sequence"][-1] + 1
    next_ones = np.flatnonzero(np.diff(rows["sequence"]) == 1)
    assert len(next_ones) >= len(rows) - 1 - len(gaps_of(batches))
    assert (np.diff(sample_ms(rows))[next_ones] == 1).all()
    return rows


def test_every_sample_of_two_seconds_is_there_once_or_named(port: I2cPort) -> None:
    batches = fly(Mpu6050("imu", port), 2.2)
    rows = check_accounts(batches)
    told = events(batches)
    assert told[0] == b"started"
    assert b"stopped" in told
    overflows = set(told) - {b"started", b"stopped"}  # a busy machine may keep us from the FIFO for 73 ms
    assert overflows <= {b"fifo_overflow"}
    assert {gap["cause"] for gap in gaps_of(batches)} == overflows
    assert len(rows) + missing(batches) > 1800
    assert len(rows) > 900
    assert (rows["temperature_raw"] == -4420).all()
    assert (rows["gyro_raw"] == [131, -262, 393]).all()
    np.testing.assert_allclose(rows["accel_raw"][:, 2] * rows["accel_scale_m_s2"], 9.80665, rtol=1e-4)


def test_a_probe_of_an_empty_address_names_the_errno(port: I2cPort) -> None:
    with pytest.raises(OSError, match=r".") as caught:
        port.write_read(0x69, b"\x75", 1)
    assert caught.value.errno == errno.EREMOTEIO
    assert port.write_read(0x68, b"\x75", 1).data == b"\x68"


def test_a_bus_that_fails_for_a_while_costs_what_the_fifo_could_not_hold(serve: Callable[..., Served]) -> None:
    served = serve(faults=[{"kind": "nack", "device": "i2c_1", "start_s": 1.5, "end_s": 1.8, "value": errno.ENXIO}])
    port = open_i2c(served.urls["i2c_1"], time.monotonic_ns)
    batches = fly(Mpu6050("imu", port), 3.0 - served.age_s)
    port.close()
    rows = check_accounts(batches)
    told = events(batches)
    assert told[0] == b"started"
    assert b"stopped" in told
    assert told.index(b"bus_error") < told.index(b"bus_recovered")
    (text,) = [
        batch.rows["text"][0] for batch in batches if batch.channel == "event" and b"bus_error" in batch.rows["code"]
    ]
    assert b"ENXIO" in text
    assert missing(batches) > 200  # 0.3 s, less the 73 samples that the FIFO holds
    chip_ms = sample_ms(rows[[0, -1]])
    numbers = rows["sequence"][[0, -1]].astype(np.int64)
    late_host_ms = 20  # what is lost is counted by host stamps, and those may be two polls late
    assert abs(np.diff(chip_ms) - np.diff(numbers)) <= late_host_ms


def test_a_brown_out_is_noticed_and_flown_on(serve: Callable[..., Served]) -> None:
    served = serve(faults=[{"kind": "reset", "device": "imu_base", "start_s": 1.5}])
    port = open_i2c(served.urls["i2c_1"], time.monotonic_ns)
    batches = fly(Mpu6050("imu", port), 3.0 - served.age_s)
    port.close()
    rows = check_accounts(batches)
    # a reset in the middle of a drain is first seen as bytes that are none
    told = [code for code in events(batches) if code not in {b"fifo_overflow", b"misaligned"}]
    assert told == [b"started", b"brown_out", b"started", b"stopped"]
    (gap,) = [gap for gap in gaps_of(batches) if gap["cause"] == b"brown_out"]
    assert len(rows[rows["sequence"] > gap["last_missing"]]) > 300


def test_the_driver_outlives_its_node(serve: Callable[..., Served]) -> None:
    served = serve()
    port = open_i2c(served.urls["i2c_1"], time.monotonic_ns)
    device = Mpu6050("imu", port)
    now_ns = time.monotonic_ns()
    batches = device.start(now_ns)
    served.kill()
    for seconds in range(1, 4):
        batches += device.pump(now_ns + seconds * 1_000_000_000)
    batches += device.stop(now_ns + 4_000_000_000)
    port.close()
    assert events(batches) == [b"bus_error", b"no_answer", b"stopped"]
    texts = [batch.rows["text"][0] for batch in batches if batch.channel == "event"]
    assert all(b"ENOENT): the adapter is gone: plug it in" in text for text in texts[:2])


def test_an_adapter_that_was_unplugged_is_taken_up_again(serve: Callable[..., Served]) -> None:
    """Its node goes and comes back as another one of the same name; the driver keeps the port it was given."""
    served = serve()
    port = open_i2c(served.urls["i2c_1"], time.monotonic_ns)
    device = Mpu6050("imu", port)
    batches = device.start(time.monotonic_ns())

    def pump_for(duration_s: float) -> None:
        end = time.monotonic() + duration_s
        while time.monotonic() < end:
            batches.extend(device.pump(time.monotonic_ns()))
            time.sleep(POLL_S)

    pump_for(1.0)
    served.kill()
    pump_for(0.5)
    serve()
    pump_for(3.0)
    batches += device.stop(time.monotonic_ns())
    port.close()
    told = [code for code in events(batches) if code != b"fifo_overflow"]
    assert told[0] == b"started"
    assert told[-3:] == [b"bus_recovered", b"started", b"stopped"]
    assert b"bus_error" in told
    assert len(rows_of(batches, "imu")) > 1_000


def test_burst_mode_takes_every_sample_of_a_slow_chip_once(port: I2cPort) -> None:
    device = Mpu6050("imu", port, Mpu6050Config(sample_rate_hz=20, mode="burst"))
    batches = device.start(time.monotonic_ns())
    end = time.monotonic() + 4.0
    while time.monotonic() < end:
        batches += device.pump(time.monotonic_ns())
        time.sleep(device.period_ns * 1e-9)
    batches += device.stop(time.monotonic_ns())
    rows = rows_of(batches, "imu")
    assert [code for code in events(batches) if code != b"stopped"] == [b"started"]
    assert len(rows) + missing(batches) > 60
    steps = np.diff(sample_ms(rows))
    assert np.all(steps > 0), "no sample twice"
    assert set((steps / 50.0).round().astype(int)) <= {1, 2, 3, 4}


def test_the_twin_answers_a_self_test_as_its_factory_would(port: I2cPort) -> None:
    """But for accel x, into which this twin writes the time: it is not at rest, and how far off depends on the time."""
    try:
        passed = Mpu6050("imu", port).self_test(time.sleep)
        deviations = (*passed.gyro_deviation, *passed.accel_deviation)
        said = ""
    except SelfTestError as error:
        deviations, said = error.deviations, str(error)
    assert [abs(value) < 0.02 for value in deviations] == [True, True, True, False, True, True]
    assert not said or re.search(r"accel x .* off the factory trim", said)
