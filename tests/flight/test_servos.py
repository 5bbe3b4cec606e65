"""Arms of DYNAMIXEL servos: a vehicle of ``heft init`` flies in virtual time and in real time, and survives faults."""

import numpy as np
import pytest

from drivers.records import SampleStatus
from onboard import config
from onboard.cli import main
from tests.flight.mixed import DEVICES, vehicle
from tests.flight.test_devices import timed
from tests.flight.test_i2c_devices import SPARSE, codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

ARM = ["--base", "fixed", "--joints", "2", "--encoder", "dynamixel"]
WITH_CELL = [*ARM, "--load-cell", "nau7802"]
CHANNELS = ("joint_1", "joint_1_torque", "joint_2", "joint_2_torque")


@pytest.mark.campaign  # by their currents: test_servo_arm
def test_an_arm_of_servos_is_weighed_with_by_their_currents(tmp_path):
    result, log, _ = rehearsed(tmp_path, ARM, swing=8.0, seed=6)
    honest(answers(result))
    assert any(answer["supported"] for answer in answers(result).values())
    for channel in CHANNELS:
        rows = log.read(channel)
        assert len(rows) > 9.0 * 200
        assert set(rows["status"]) == {0}
        assert result["channels"][channel]["missing"] <= 1
    assert codes_of(log, b"joint_2") == [b"identified"]


@pytest.mark.campaign  # by currents: test_servo_arm; by a bridge: test_as5048_flight
def test_an_arm_of_servos_and_a_bridge_is_weighed_with(tmp_path):
    result, _, _ = rehearsed(tmp_path, WITH_CELL, rest=3.0, swing=14.0, seed=6)
    honest(answers(result))
    moment = answers(result)["MY_payload"]
    assert moment["supported"]
    assert abs(moment["value"] - moment["truth"]) < 3.0 * moment["sigma"]


@pytest.mark.campaign  # the driver: test_dynamixel_device, test_serial_laws; in flight: test_servo_arm
def test_it_survives_unplugging_brown_out_garbage_and_loss(tmp_path):
    faults = [
        *("--fault", "unplug:tty_servos:1.5:2.5", "--fault", "off:joint_2:3.2:4.2", "--fault", "garbage:joint_1:5:5.2"),
        *("--fault", "silent:joint_1:5.5:6", "--fault", "byte_loss:tty_servos:6.2:6.6:0.02"),
    ]
    result, log, _ = rehearsed(tmp_path, WITH_CELL, *faults, swing=6.5, change=SPARSE)
    honest({name: row for name, row in answers(result).items() if row["supported"]})
    assert b"bus_recovered" in codes_of(log, b"tty_servos")
    for joint in (b"joint_1", b"joint_2"):
        assert codes_of(log, joint).count(b"silent") >= 1
        assert codes_of(log, joint).count(b"recovered") >= 1
        rows = log.read(joint.decode())
        assert rows["host_ns"][-1] - rows["host_ns"][0] > 7.0e9
        assert len(rows) > 800


@pytest.mark.campaign  # of the driver: test_dynamixel_device
def test_an_overload_is_named_and_its_current_is_not_used(tmp_path):
    result, log, _ = rehearsed(
        tmp_path, ARM, "--fault", "trip:joint_2:2:3", "--fault", "trip:joint_1:3:4:4", swing=4.0, change=SPARSE
    )
    honest({name: row for name, row in answers(result).items() if row["supported"]})
    assert codes_of(log, b"joint_2").count(b"hardware_error") == 1
    assert {b"hardware_error", b"hot"} <= set(codes_of(log, b"joint_1"))
    rows = log.read("joint_2_torque")
    bad = rows["status"] & SampleStatus.NOT_VALID != 0
    assert rows["host_ns"][bad][0] - rows["host_ns"][0] == pytest.approx(2e9, abs=0.5e9)
    assert bad[np.argmax(bad) :].all()
    assert set(log.read("joint_2")["status"]) == {0}


def test_samples_are_put_on_the_time_when_they_were_taken(mixed_flight, tmp_path):
    """Within the stated sigma, of the second servo of two, against the truth."""
    flying = mixed_flight.vehicle(tmp_path)
    for identifier, channel in ((1, "servo_6"), (2, "servo_7")):
        times_ns, sigma_ns = timed(flying, mixed_flight.rows, channel)
        late_ns = mixed_flight.late_ns(f"servo {identifier}", times_ns[-200:])
        stated_ns = 1e6 * flying.file.device[channel].delay_sigma_ms
        clocks = flying.file.device[channel].clocks(channel, flying)
        answer, longest = {1: (360e3, 500e3), 2: (140e3, 720e3)}[identifier]
        assert clocks[channel] == pytest.approx((160e3, answer, longest))  # 16 bytes; 36 and 14
        assert len(times_ns) > 550
        assert sigma_ns < 2.0 * stated_ns
        assert np.abs(late_ns).max() < 2.0 * stated_ns
        assert abs(np.mean(late_ns)) < stated_ns


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("id = 2", "id = 1"), "have ID 1; give them different ids"),
        (("id = 2", "id = 2\nsample_period_ms = 6"), "asked at once; give both the same periods"),
        (("baud=1000000", "baud=57600"), "takes 9.5 ms on 'tty_servos': raise its baud rate"),
        (("gain_N_m_A = 1.78", "torque_sigma_N_m = 0.01"), "measures a current; give gain_N_m_A"),
        (('bus = "tty_servos"\nid = 2', 'bus = "tty_joint"\nid = 2'), "'elbow' is no servo"),
        (('bus = "tty_grip"', 'bus = "tty_servos"'), "'grip' is no servo"),
        (("id = 2", "id = 253"), "252"),
    ],
)
def test_servos_that_cannot_share_a_line_are_refused(tmp_path, change, why):
    assert DEVICES.count(change[0]) == 1
    with pytest.raises(config.ConfigError, match=why):
        vehicle(tmp_path, {}, DEVICES.replace(*change))


def test_a_free_flyer_of_servos_is_made(tmp_path):
    assert main(["init", str(tmp_path / "mine"), "--base", "free", "--joints", "4", "--encoder", "dynamixel"]) == 0
    text = (tmp_path / "mine" / "vehicle.toml").read_text()
    assert text.count('bus = "tty_servos"') == 4
    assert text.count("gain_N_m_A = 1.78") == 4
    assert "id = 4 " in text
    assert 'url = "serial:///dev/tty_servos?baud=1000000"' in text
