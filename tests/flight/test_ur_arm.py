"""A UR arm by RTDE: a vehicle of ``heft init`` flies in virtual time and over a real TCP connection, and survives."""

import numpy as np
import pytest

from drivers.records import SampleStatus
from onboard import config
from onboard.cli import main
from tests.flight.mixed import DEVICES, vehicle
from tests.flight.test_devices import timed
from tests.flight.test_i2c_devices import codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

ARM = ["--base", "fixed", "--joints", "2", "--encoder", "ur_joint", "--no-pulse"]
CHANNELS = tuple(f"joint_{n}{part}" for n in (1, 2) for part in ("", "_torque"))


@pytest.mark.campaign  # by currents of servos: test_servo_arm; answers of a UR arm: below
@pytest.mark.parametrize("rate", [125, 500])
def test_an_arm_is_weighed_with_by_its_currents(tmp_path, rate):
    change = ("rate_hz = 125 ", f"rate_hz = {rate} ")
    result, log, _ = rehearsed(tmp_path, ARM, rest=3.0, swing=6.0, seed=6, change=change)
    honest(answers(result))
    assert any(answer["supported"] for answer in answers(result).values())
    for channel in CHANNELS:
        rows = log.read(channel)
        assert len(rows) == pytest.approx(9.0 * rate, abs=0.2 * rate)
        assert set(rows["status"]) == {0}
        assert result["channels"][channel]["missing"] == 0
    assert codes_of(log, b"robot") == [b"identified", b"started", b"stopped"]


def test_it_survives_a_pulled_cable_a_restart_and_garbage(tmp_path):
    faults = [
        *("--fault", "unplug:robot:1.5:2.5", "--fault", "reset:joint_2:3.5", "--fault", "garbage:joint_1:6:6.2"),
        *("--fault", "trip:joint_2:6.7:7", "--fault", "emergency_stop:joint_1:7.5:7.9"),
    ]
    result, log, _ = rehearsed(tmp_path, ARM, *faults, swing=7.0)
    honest({name: row for name, row in answers(result).items() if row["supported"]})
    events = codes_of(log, b"robot")
    for code in ("bus_error", "restarted", "out_of_step", "safety", "safety_normal", "arm_off", "arm_on"):
        assert code.encode() in events, code
    assert events.count(b"bus_recovered") == 3
    gaps = log.read("gap")
    for channel in CHANNELS:
        rows, lost = log.read(channel), gaps[gaps["channel"] == channel.encode()]
        assert rows["host_ns"][-1] - rows["host_ns"][0] > 8.0e9
        assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == 1
        assert (rows["status"] & SampleStatus.NOT_VALID != 0).sum() == pytest.approx(50, abs=2)  # without power
        assert len(rows) + (lost["last_missing"] - lost["first_missing"] + 1).sum() == rows["sequence"][-1] + 1
        assert rows["sequence"][-1] == pytest.approx(8.5 * 125, abs=8)
        assert lost["counted"].tolist() == [1, 0, 1]  # over the restart it is estimated


def test_samples_are_put_on_the_time_when_they_were_taken(mixed_flight, tmp_path):
    """By arrivals alone, within twice the stated sigma, against the truth."""
    flying = mixed_flight.vehicle(tmp_path)
    times_ns, sigma_ns = timed(flying, mixed_flight.rows, "robot_8")
    delay_ns, stated_ns = flying.file.device["robot_8"].delay_ns
    assert stated_ns == pytest.approx(1e6 * np.hypot(8.0, 2.0) / 12**0.5)
    assert stated_ns < sigma_ns < 1.5 * stated_ns
    numbers = mixed_flight.rows["robot_8"]["sequence"][-200:]
    late_ns = times_ns[-200:] - mixed_flight.taken_ns["robot_8"][numbers]
    assert len(times_ns) > 480
    assert np.abs(late_ns).max() < 2.0 * stated_ns
    early_ns = delay_ns - 700e3  # that of the file, half a period, is more than the twin's
    assert late_ns + early_ns == pytest.approx(0.0, abs=2e6 / 12**0.5)  # of the poll; a sample more or less: 8 ms


def test_rows_of_all_devices_of_a_controller_have_one_time(mixed_flight):
    heard = mixed_flight.rows
    for channel in ("robot_8_velocity", "robot_8_torque", "flange", "tcp_1", "tcp_6"):
        assert (heard[channel]["tick"] == heard["robot_8"]["tick"]).all()
    assert heard["flange"]["unit"][0] == b"N"


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (('bus = "robot"\noutput', 'bus = "robot"\nrate_hz = 500\noutput'), "give both the same rate_hz"),
        (('bus = "robot"\noutput', 'bus = "robot"\nlatency_ms = 1\noutput'), "give both the same rate_hz"),
        (('output = "actual_TCP_force"', 'output = "ft_raw_wrench"'), "'tcp' and 'flange' are ft_raw_wrench 3"),
        (("component = 3", "component = 4"), "4 to 6 moments"),
        (("number = 2", "number = 7"), "6"),
        (("gain_N_m_A = 10.0", "torque_sigma_N_m = 0.01"), "measures a current; give gain_N_m_A"),
        (('output = "actual_TCP_force"', 'output = "a,b"'), "pattern"),
        (('bus = "robot"\noutput', 'bus = "robot"\nrate_hz = 501\noutput'), "1 to 500"),
        (("tcp://192.168.56.101:30004", "serial:///dev/ttyUSB9?baud=9600"), "its devices are on TCP"),
    ],
)
def test_what_does_not_fit_a_controller_is_refused(tmp_path, change, why):
    assert DEVICES.count(change[0]) == 1
    with pytest.raises(config.ConfigError, match=why):
        vehicle(tmp_path, {}, DEVICES.replace(*change))


def test_a_preflight_names_a_controller_that_is_not_there(tmp_path, capsys):
    assert main(["init", str(tmp_path / "mine"), *ARM, "--bus", "robot=tcp://127.0.0.1:9"]) == 0
    assert main(["preflight", str(tmp_path / "mine" / "vehicle.toml"), "--seconds", "1"]) == 4
    said = capsys.readouterr()
    assert "Connection refused" in said.out + said.err


@pytest.mark.realtime
@pytest.mark.timeout(180)
def test_an_arm_flies_in_real_time_over_a_real_connection(tmp_path):
    _, log, _ = rehearsed(tmp_path, ARM, "--realtime", "--fault", "unplug:robot:2:3", rest=3.0, swing=4.0)
    assert b"bus_recovered" in codes_of(log, b"robot")
    for channel in CHANNELS:
        rows = log.read(channel)
        assert len(rows) > 4.0 * 125
        assert 120 < rows["sequence"][-1] - len(rows) < 220  # it is tried again after half a second
