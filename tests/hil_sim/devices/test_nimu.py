"""The nIMU twin against DOC00290 rev. J, table 3, typed here, and against how public code reads real units."""

import numpy as np
import pytest

from hil_sim.devices.serial_line.nimu import NimuTable, NimuTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultPlan
from hil_sim.scenario.sheets import Sheets
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, FlatImu, RateClock, StairImu

BOOT_MS = 250


class Field:
    def gauss(self, times_s):
        return np.tile((0.5, -0.25, 0.0), (len(times_s), 1))


def unit(analog=None, rate_error=0.0, **options):
    return NimuTwin(analog or StairImu(), RateClock(rate_error), START_NS, **options)


def faults(*faults):
    return FaultPlan(faults, START_NS).of("nimu")


def packets(data):
    """The whole packets of a stream; what comes before the first and after the last is left out."""
    first = data.index(b"\xff\xff\xff\xff\x26")
    whole = [data[k : k + 38] for k in range(first, len(data) - 37, 38)]
    assert whole
    assert all(packet.startswith(b"\xff\xff\xff\xff\x26") for packet in whole)
    return whole


def word(packet, at):
    return int.from_bytes(packet[at : at + 2], "big", signed=True)


def timers(data):
    return [int.from_bytes(packet[7:9], "big") for packet in packets(data)]


def test_a_packet_byte_for_byte():
    analog = FlatImu([0x0102, -2, 300, -3924, -32768, 32767, 5])  # -3924: 25 deg C less 0.01
    line = Line(unit(analog, magnetometer=Field(), serial_number=0xBEEF))
    packet = line.run(BOOT_MS + 6)
    # The sample of 250 ms: 250 ms / 2.1701 us = 115202.0 -> 115202 mod 65536 = 49666 = C202h.
    # Field: 0.5 / 8.6975e-5 = 5748.8 -> 1675h; -0.25 / 8.6975e-5 = -2874.4 -> F4C6h.
    # Temperature: (-3924/340 + 36.53 - 25) / 0.018165 = -0.6 -> FFFFh.
    expected = bytes.fromhex("FFFFFFFF 26 00 14 C202 0000 BEEF8000 7FFF 00050102 FFFE 012C1675 F4C6 0000FFFF FFFF FFFF")
    assert packet[:37].hex(" ") == expected.hex(" ")
    assert packet[37] == sum(expected) % 256
    assert len(packet) == 38


@pytest.mark.parametrize(("span", "first"), [("packet", 0), ("after_sync", 4), ("payload", 13)])
def test_the_checksum_covers_what_it_is_told(span, first):
    found = packets(Line(unit(checksum=span)).run(BOOT_MS + 40))
    assert len(found) == 6
    for packet in found:
        assert packet[37] == sum(packet[first:37]) % 256


def test_the_default_checksum_is_that_of_public_code():
    # Two independent readers of real units sum the four FFh too: after_sync would differ by 4 * FFh = FCh.
    packet = packets(Line(unit()).run(BOOT_MS + 6))[0]
    assert packet[37] == (sum(packet[4:37]) + 4 * 0xFF) % 256


def test_words_are_asked_for_with_the_units_of_the_300_dps_2_g_model():
    analog = StairImu()
    Line(unit(analog)).run(BOOT_MS + 10)
    _, per_g, per_dps, code = analog.calls[-1]
    assert 1 / per_g == pytest.approx(9.1553e-5)
    assert 1 / per_dps == pytest.approx(1.3733e-2)
    assert code == 3


def test_the_noise_of_a_vehicle_file_is_that_of_white_samples():
    """By the density, which the filter leaves as it is: 75 Hz lie below half the rate, whatever its delay."""
    said = {"sample_rate_hz": 150.0, "frame": "imu", "accel_noise_m_s2": 0.0196133, "gyro_noise_rad_s": np.pi / 1800.0}
    for delays in ({}, {"accel_delay_ms": 4.5, "gyro_delay_ms": 4.5}):
        imu = NimuTable.from_vehicle("imu", said | delays, Sheets(True, None, {}, {}, {})).sensors["imu"]
        assert imu["accel_g"]["noise_density"] == pytest.approx(2e-3 / 75.0**0.5)
        assert imu["gyro_deg_s"]["noise_density"] == pytest.approx(0.1 / 75.0**0.5)


def test_the_timer_counts_2_1701_us_and_wraps_in_142_ms():
    values = timers(Line(unit(rate_hz=100.0)).run(BOOT_MS + 500))
    assert len(values) == 50
    steps = np.diff(values) % 65536
    assert set(steps.tolist()) <= {4608, 4609}  # 10 ms / 2.1701 us = 4608.1
    assert sum(np.diff(values) < 0) == 4  # 250..740 ms pass 284, 427, 569 and 711 ms


@pytest.mark.parametrize("rate_error", [0.01, -0.008])
def test_timer_and_rate_are_those_of_its_own_clock(rate_error):
    line = Line(unit(rate_error=rate_error, rate_hz=100.0))
    line.run(BOOT_MS / (1 + rate_error))
    values = timers(line.run(1005 / (1 + rate_error)))
    assert len(values) == 101
    assert sum((np.diff(values) % 65536).tolist()) == pytest.approx(1e6 / 2.1701, abs=1)


def test_samples_are_taken_at_the_timer_and_packets_leave_a_millisecond_later():
    analog = StairImu()
    line = Line(unit(analog, rate_error=0.005, rate_hz=150.0))
    line.run(BOOT_MS + 100)
    start_s = BOOT_MS * 1e-3 / 1.005
    assert analog.times_s == pytest.approx([start_s + k / 150 / 1.005 for k in range(len(analog.times_s))], abs=1e-8)
    sent_ns = START_NS + round(analog.times_s[0] * 1e9) + 1_000_000
    characters_ns = [round(k * 1e10 / 115_200) for k in range(1, 39)]
    assert line.ends_ns[:38] == pytest.approx([sent_ns + late for late in characters_ns], abs=3)


@pytest.mark.parametrize("step_ms", [0.1, 7.0, 61.0])
def test_the_way_time_is_cut_changes_no_byte(step_ms):
    reference = Line(unit(rate_error=0.003)).run(427)
    line = Line(unit(rate_error=0.003))
    assert b"".join(line.run(step_ms) for _ in range(round(427 / step_ms))) == reference
    assert len(reference) > 20 * 38


class Foreseen(StairImu):
    """A stair whose future is known up to a mission time."""

    known_s = 0.0


def test_packets_made_ahead_are_those_made_one_by_one():
    said, asked = [], []
    for known_s in (0.0, 0.9):
        analog = Foreseen()
        analog.known_s = known_s
        line = Line(unit(analog, 0.01))
        parts = []
        for ms in range(1, 241):
            parts.append(line.run(5))
            analog.known_s = known_s + 5e-3 * ms if known_s else 0.0
        said.append(b"".join(parts))
        asked.append(len(analog.calls))
    assert said[1] == said[0]
    assert len(packets(said[0])) > 130
    assert asked[1] < 0.1 * asked[0]


def test_what_was_made_ahead_is_not_said_after_a_brown_out():
    found = []
    for known_s in (0.0, 9.0):
        analog = Foreseen()
        analog.known_s = known_s
        nimu = unit(analog)
        line = Line(nimu)
        line.run(BOOT_MS + 100)
        nimu.restart(line.now_ns)
        found.append(line.run(BOOT_MS + 100))
    assert found[1] == found[0]
    assert len(packets(found[0])) > 10


def test_a_long_step_asks_the_physics_once():
    analog = StairImu()
    line = Line(unit(analog))
    line.run(BOOT_MS + 1000)
    assert line.device.produced == 151
    assert len(analog.calls) == 1


def test_another_speed_and_a_rate_that_does_not_fit():
    line = Line(unit(line=LineFormat(57_600)))
    line.run(BOOT_MS + 60)
    assert line.ends_ns[1] - line.ends_ns[0] == pytest.approx(1e10 / 57_600, abs=1)
    with pytest.raises(ValueError, match="150 packets of 38 bytes a second do not fit into 38400 baud"):
        unit(line=LineFormat(38_400))


@pytest.mark.parametrize("baud_rate", [38_400, 57_600, 230_400])
def test_a_host_at_the_wrong_speed_never_sees_a_packet(baud_rate):
    line = Line(unit(), LineFormat(baud_rate))
    garbage = line.run(BOOT_MS + 600)
    assert len(garbage) > 500
    assert b"\xff\xff\xff\xff\x26" not in garbage


def test_it_takes_no_commands():
    line = Line(unit())
    line.send(bytes(range(256)))
    assert len(packets(line.run(BOOT_MS + 100))) == 15


def test_after_a_brown_out_the_timer_begins_again():
    reset_s = 0.5
    line = Line(unit(faults=faults(Fault("reset", "nimu", reset_s))))
    before = timers(line.run(reset_s * 1e3 + 5))
    after = timers(line.run(BOOT_MS + 2))
    assert before[0] == after[0] == 49_666
    assert len(before) == 38
    assert len(after) == 1


def test_no_packet_while_it_is_off_or_disconnected():
    line = Line(unit(faults=faults(Fault("off", "nimu", 0.4, 0.6), Fault("silent", "nimu", 1.0, 1.2))))
    line.run(405)  # the packet under way when the supply goes is not cut off
    assert line.run(440) == b""
    assert len(packets(line.run(164))) == 23  # samples of 850.0 to 996.7 ms
    produced = line.device.produced
    assert line.run(190) == b""
    assert line.device.produced == produced + 29
    assert len(packets(line.run(50))) == 7


def test_a_stuck_and_a_saturated_element():
    line = Line(unit(faults=faults(Fault("stuck", "nimu", 0.4, 0.5), Fault("saturated", "nimu", 0.6, 0.7, -1.0))))
    line.run(408)
    held = {packet[13:25] for packet in packets(line.run(90))}
    assert len(held) == 1
    line.run(110)
    saturated = packets(line.run(85))
    assert len(saturated) == 12
    for packet in saturated:
        assert [word(packet, at) for at in range(13, 25, 2)] == [-32768] * 6


def test_a_clock_that_is_millisecond_late_never_asks_for_the_future():
    class Strict(StairImu):
        now_s = 0.0

        def counts(self, times_s, *arguments):
            assert times_s.max() <= self.now_s
            return super().counts(times_s, *arguments)

    analog = Strict()
    line = Line(unit(analog, rate_error=-0.01))
    for _ in range(700):
        analog.now_s = (line.now_ns + MS - START_NS) * 1e-9
        line.run(1)
    assert line.device.produced > 60
