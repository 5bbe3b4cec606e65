"""The DSC twin against the ASCII protocol of the DSC user manual, appendix B; its examples typed here."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from hil_sim.devices.serial_line.dsc_load_cell import DscLoadCellTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock


class Bench(Line):
    """A converter that has started, with a force of ``force`` N on its cell."""

    def __init__(self, force=0.0, **options):
        self.force = force
        self.analog = Analog(lambda t: self.force(t) if callable(self.force) else self.force)
        super().__init__(DscLoadCellTwin(self.analog, RateClock(), START_NS, **options))
        self.run(300)


def faults(*faults):
    return FaultPlan(faults, START_NS).of("cell")


def test_the_manuals_examples():
    bench = Bench(force=32.1)
    assert bench.ask(b"!001:SOUT?\r") == b"+00032.100\r"
    assert bench.ask(b"!001:BAUD=3\r") == b"\r"
    assert bench.ask(b"!001:SZ=123.456\r") == b"\r"
    assert bench.ask(b"!001:SOUT?\r") == b"-00091.356\r"
    other = Bench(station=14)
    assert other.ask(b"!014:RST\r") == b"\r"


@pytest.mark.parametrize(
    ("before", "after", "answer"),
    [(5, 3, b"-00001.250\r"), (1, 8, b"-1.25000000\r"), (8, 0, b"-00000001.\r"), (3, 2, b"-001.25\r")],
)
def test_a_number_has_dpb_plus_dp_plus_3_characters(before, after, answer):
    assert Bench(force=-1.25, digits=(before, after)).ask(b"!001:SOUT?\r") == answer
    assert len(answer) == before + after + 3


@pytest.mark.parametrize(
    ("force", "digits", "answer"),
    [
        (0.0, (5, 3), b"+00000.000\r"),
        (-0.0004, (5, 3), b"+00000.000\r"),
        (-0.0006, (5, 3), b"-00000.001\r"),
        (49.9996, (5, 3), b"+00050.000\r"),
        (12.5, (2, 0), b"+12.\r"),
        (12.5, (1, 1), b"+9.9\r"),
    ],
)
def test_rounding_and_what_does_not_fit(force, digits, answer):
    assert Bench(force=force, digits=digits).ask(b"!001:SOUT?\r") == answer


def test_case_does_not_matter_and_every_mark_begins_anew():
    bench = Bench(force=1.0)
    assert bench.ask(b"!001:sout?\r") == b"+00001.000\r"
    assert bench.ask(b"rubbish!002:SO!001:SOUT?\r") == b"+00001.000\r"
    assert bench.ask(b"001:SOUT?\r") == b""


@pytest.mark.parametrize("command", [b"!002:SOUT?\r", b"!001SOUT?\r", b"!01:SOUT?\r", b"!001:SOUT?\n", b"!\r", b"!:\r"])
def test_what_is_not_for_it_is_not_answered(command):
    assert Bench().ask(command, 200) == b""


@pytest.mark.parametrize(
    "command",
    [
        b"!001:NONE?\r",
        b"!001:NONE\r",
        b"!001:SOUT=1\r",
        b"!001:SOUT\r",
        b"!001:DP=9\r",
        b"!001:DP=1.5\r",
        b"!001:STN=0\r",
        b"!001:SZ=1-2\r",
        b"!001:SZ=\r",
        b"!001:SZ=12345678901234567\r",
        b"!001:TOOLONG?\r",
    ],
)
def test_what_cannot_be_done_is_answered_by_a_question_mark(command):
    assert Bench().ask(command) == b"?\r"


def test_station_000_is_obeyed_and_not_answered():
    bench = Bench(force=2.0)
    assert bench.ask(b"!000:SNAP\r", 200) == b""
    bench.force = 7.0
    bench.run(20)
    assert bench.ask(b"!001:SYSN?\r") == b"+00002.000\r"
    assert bench.ask(b"!000:SOUT?\r", 200) == b""
    assert bench.ask(b"!001:SOUT?\r") == b"+00007.000\r"


def test_an_answer_comes_within_its_limits_and_not_always_at_once():
    bench = Bench(force=1.0, delay_ns=(2 * MS, 50 * MS))
    command = b"!001:SOUT?\r"
    delays_ms = []
    for _ in range(40):
        bench.send(command)
        sent_ns = bench.now_ns + round(len(command) * 1e10 / 115_200)
        bench.run(60)
        delays_ms.append((bench.ends_ns[0] - sent_ns) / MS - 10 / 115.2)
    assert 2.0 <= min(delays_ms) < 10.0
    assert 40.0 < max(delays_ms) <= 50.001
    with pytest.raises(ValueError, match="within 50 ms"):
        Bench(delay_ns=(0, 51 * MS))


@pytest.mark.parametrize(("code", "rate_hz"), list(enumerate((1, 2, 5, 10, 20, 50, 60, 100, 200, 500))))
def test_a_reading_is_the_last_conversion(code, rate_hz):
    bench = Bench(force=lambda t: t, rate_code=code)
    bench.run(1000)
    for polls in range(12):
        assert bench.device.produced == polls
        bench.run(7.3)
        asked_s = (bench.now_ns - START_NS) * 1e-9 + 11 * 10 / 115_200
        age_s = asked_s - float(bench.ask(b"!001:SOUT?\r"))
        assert -1e-3 < age_s < 1 / rate_hz + 1e-3


def test_peak_and_trough():
    bench = Bench(force=lambda t: 30.0 if 0.40 < t < 0.41 else -20.0 if 0.5 < t < 0.51 else 1.0)
    bench.run(500)
    assert (bench.ask(b"!001:PEAK?\r"), bench.ask(b"!001:TRGH?\r")) == (b"+00030.000\r", b"-00020.000\r")
    assert bench.ask(b"!001:RSPT\r") == b"\r"
    assert bench.ask(b"!001:PEAK?\r") == b"+00001.000\r"


def test_station_and_speed_change_with_the_restart():
    bench = Bench(force=1.0)
    assert bench.ask(b"!001:STN=23\r") == bench.ask(b"!001:BAUD=2\r") == b"\r"
    assert bench.ask(b"!001:SOUT?\r") == b"+00001.000\r"
    assert bench.ask(b"!001:RST\r") == b"\r"
    assert bench.device.line == LineFormat(9600)
    bench.run(300)
    bench.wire.host = LineFormat(9600)
    assert bench.ask(b"!001:SOUT?\r") == b""
    assert bench.ask(b"!023:SOUT?\r") == b"+00001.000\r"


@pytest.mark.parametrize(
    ("code", "baud_rate"),
    [(0, 2400), (1, 4800), (2, 9600), (3, 19_200), (4, 38_400), (5, 57_600), (6, 76_800), (7, 115_200)],
)
def test_speeds(code, baud_rate):
    assert DscLoadCellTwin(Analog(lambda t: 0.0), RateClock(), START_NS, baud_code=code).line == LineFormat(baud_rate)


@pytest.mark.parametrize(
    "setting", [b"BAUD=8", b"RATE=10", b"DPB=0", b"DPB=9", b"FLAG=65536", b"STN=1000", b"SZ=1000000001"]
)
def test_settings_beyond_their_range(setting):
    assert Bench().ask(b"!001:" + setting + b"\r") == b"?\r"


def test_settings_read_back_as_numbers():
    bench = Bench()
    assert bench.ask(b"!001:STN?\r") == b"+00001.000\r"
    assert bench.ask(b"!001:RATE?\r") == b"+00009.000\r"
    assert bench.ask(b"!001:FLAG=0\r") == b"\r"
    assert bench.ask(b"!001:FLAG?\r") == bench.ask(b"!001:STAT?\r") == b"+00000.000\r"


def test_a_brown_out_keeps_the_settings_and_loses_the_peak():
    bench = Bench(force=lambda t: 30.0 if t < 0.5 else 1.0, faults=faults(Fault("reset", "cell", 1.0)))
    bench.ask(b"!001:SZ=0.5\r")
    bench.run(650)
    assert bench.ask(b"!001:SOUT?\r", 100) == b""  # it is starting
    bench.run(300)
    assert bench.ask(b"!001:SOUT?\r") == b"+00000.500\r"
    assert bench.ask(b"!001:PEAK?\r") == b"+00000.500\r"


def test_the_converter_clips_at_capacity_and_a_saturated_one_too():
    broken = faults(Fault("saturated", "cell", 1.0, 2.0, -1.0), Fault("stuck", "cell", 3.0, 4.0))
    bench = Bench(force=lambda t: 80.0 * t, faults=broken)
    bench.run(500)
    assert bench.ask(b"!001:SOUT?\r") == b"+00050.000\r"
    bench.run(500)
    assert bench.ask(b"!001:SOUT?\r") == b"-00050.000\r"


def test_a_setting_out_of_range_is_refused():
    with pytest.raises(ValueError, match=r"STN = 1000 is not within \(1, 999\)"):
        Bench(station=1000)


@given(st.binary(max_size=100))
def test_any_bytes_are_survived(data):
    bench = Bench(force=1.0)
    bench.ask(data, 100)
    assert bench.ask(b"!001:SOUT?\r") == b"+00001.000\r"


@given(
    st.sampled_from(["SOUT", "SZ", "SYSN", "PEAK", "FLAG", "DP", "DPB", "RATE", "XYZ", "SNAP", "RSPT"]),
    st.text("0123456789+-. =?", max_size=16),
)
def test_any_text_for_this_station_is_answered_by_one_line(name, rest):
    bench = Bench(force=1.0)
    answer = bench.ask(f"!001:{name}{rest}\r".encode())
    assert answer.count(b"\r") == 1
    assert answer.endswith(b"\r")
