"""DYNAMIXEL servos that are driven: a motion through the acquisition worker, on simulated servos, in virtual time.

The servos are ``hil_sim``'s; their commands are read off their control tables, what they did off their axes.
"""

import struct
from contextlib import closing

import numpy as np
import pytest

from drivers.records import REGISTER_WRITE
from hil_sim.arm_rig import START_NS
from hil_sim.faults import Fault
from onboard import config
from tests.flight.driven_bench import MS, Kept, closed_after, csv_of, swing
from tests.flight.servo_bench import LINE, SERVOS, ServoBench, written

PLAYED = ["drive_armed", "drive_started", "drive_done"]
MIDWAY_S = 1.6  # in mid-motion


@pytest.fixture
def bench(tmp_path):
    yield from closed_after(tmp_path, ServoBench)


def torques(flown):
    return {drive.drive_state for drive in flown.rig.drives.values()}


def sent(flown, name, address):
    rows = flown.kept.of(f"{name}_sent")
    return rows[rows["address"] == address]


def poked(address, form, *values):
    """Sets registers of a servo before the flight."""
    return lambda servo: struct.pack_into(form, servo.memory, address, *values)


def test_the_arm_follows_the_motion_and_is_let_go_at_the_end(bench):
    flown = bench().run(4.0)
    assert flown.codes == PLAYED
    assert flown.text("drive_done").startswith("motion.csv is over")
    assert flown.axis("shoulder").highest_rad == pytest.approx(0.5, abs=0.01)
    assert flown.axis("elbow").lowest_rad == pytest.approx(-0.2, abs=0.01)
    rows = flown.kept.of("shoulder")
    angle = (rows["value_raw"] - 2048) * rows["scale"]
    time_s, q = swing()
    events = flown.kept.of("event")
    (began_ns,) = events["host_ns"][events["code"] == b"drive_started"]
    wanted = np.interp(1e-9 * (rows["host_ns"] - began_ns) - 1.055, time_s, q[:, 0])  # after a blend of 1 s
    assert np.abs(angle - wanted).max() < 0.015  # 55 ms late: a proportional controller lags by its speed
    status = flown.kept.of("elbow_status")
    assert set(status["device_status"][-100:]) == {5}  # Bus Watchdog: 100 ms
    assert set(status["value_raw"][-100:]) == {1}  # in position
    assert torques(flown) == {1}
    flown.stop()
    assert flown.codes[-2:] == ["drive_stopped", "drive_at_rest"]
    assert torques(flown) == {0}
    assert flown.is_at_rest()


def test_what_is_written_is_a_row_and_nothing_else_is(bench, monkeypatch):
    flown = bench()
    servo, wire = flown.rig.drives["elbow"], []
    write = servo.write
    monkeypatch.setattr(servo, "write", lambda at, data, now: (wire.append((at, bytes(data))), write(at, data, now))[1])
    flown.run(4.0)
    flown.stop()
    rows = flown.kept.of("elbow_sent")
    assert rows.dtype == REGISTER_WRITE
    assert len(rows) > 700
    assert [(int(row["address"]), bytes(row["data"][: row["length"]])) for row in rows] == wire
    assert (np.diff(rows["sequence"].astype(int)) == 1).all()
    assert (np.diff(rows["host_ns"]) >= 0).all()


def test_its_limits_are_the_urdfs_less_the_margin_in_its_own_table(bench):
    flown = bench().run(0.5)
    for name, sense, zero in (("shoulder", 1, 2048), ("elbow", -1, 1777)):
        ends = sorted(zero + round(sense * end * 4096 / (2.0 * np.pi)) for end in (-0.95, 0.95))
        assert [flown.register(name, address) for address in (52, 48)] == ends
        assert flown.register(name, 11, 1) == 3
        assert flown.register(name, 98, 1) == 5
        assert flown.register(name, 112) == 53  # 1.25 rad/s in 0.229 rev/min
        assert flown.register(name, 108) == 0


def test_a_range_of_several_turns_is_driven_in_extended_position_mode(bench):
    servos = {**SERVOS, "elbow": {"identifier": 2, "turns": -1.0, "zero_count": 4000}}
    flown = bench(zero=4000, rig={"servos": servos}).run(3.2)
    assert [flown.register(name, 11, 1) for name in ("shoulder", "elbow")] == [3, 4]
    assert flown.codes == PLAYED
    assert flown.kept.of("elbow")["value_raw"].max() > 4096


def test_an_arm_that_stands_elsewhere_is_not_moved(bench):
    flown = bench(rig={"angles": (0.0, 0.4)}).run(0.3)
    assert "elbow stands" in flown.text("drive_refused")
    assert torques(flown) == {0}


@pytest.mark.parametrize("said", [{"arm": False}, {"arm": False, "drive": "phase = 3"}])
def test_nothing_is_written_unless_armed(bench, said):
    flown = bench(**said).run(1.0)
    assert flown.codes == []
    assert torques(flown) == {0}
    assert len(flown.kept.of("shoulder_status")) > 150
    if "drive" not in said:
        assert not len(flown.kept.of("shoulder_sent"))


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (Fault("trip", "elbow", MIDWAY_S), "elbow reports a hardware error"),
        pytest.param(Fault("silent", "elbow", MIDWAY_S, 2.0), "elbow has not answered for", marks=pytest.mark.campaign),
        pytest.param(Fault("silent", "shoulder", MIDWAY_S, 2.0), "no answer for", marks=pytest.mark.campaign),  # below
        pytest.param(Fault("off", "elbow", MIDWAY_S, 2.0), "elbow has not answered for", marks=pytest.mark.campaign),
        (Fault("reset", "elbow", MIDWAY_S), "elbow has not answered for"),
        pytest.param(Fault("unplug", LINE, MIDWAY_S, 2.0), "no answer for", marks=pytest.mark.campaign),
        (Fault("byte_loss", LINE, MIDWAY_S, 2.0, 1.0), "no answer for"),
        (Fault("garbage", "elbow", MIDWAY_S, 2.0), "elbow has not answered for"),
    ],
    ids=lambda value: f"{value.kind}-{value.device}" if isinstance(value, Fault) else None,
)
def test_whatever_is_wrong_stops_all_servos_for_good(bench, fault, said):
    flown = bench(faults=[fault]).run(MIDWAY_S - 0.02)
    assert min(abs(axis.rate_rad_s) for axis in flown.rig.axes.values()) > 0.1, "it happens in mid-motion"
    flown.run(0.9)
    assert said in flown.text("drive_stopped")
    assert flown.is_at_rest()
    before = flown.codes
    flown.run(0.6)  # the motion would be over
    assert torques(flown) == {0}
    assert "drive_done" not in flown.codes
    assert flown.codes.count("drive_stopped") == before.count("drive_stopped") == 1


def test_a_line_that_is_away_for_long_leaves_servos_that_hold(bench):
    """Their watchdogs stop them; when the line is back nobody lets them fall, and nobody moves them."""
    flown = bench(faults=[Fault("unplug", LINE, MIDWAY_S, 6.0)]).run(MIDWAY_S + 0.4)
    assert flown.is_at_rest()
    assert [flown.register(name, 98, 1) for name in ("shoulder", "elbow")] == [255, 255]
    flown.run(6.5)
    assert flown.codes[-2:] == ["drive_stopped", "drive_unheard"]
    assert torques(flown) == {1}
    assert flown.is_at_rest()
    rows = flown.kept.of("elbow")
    assert 1e-9 * (rows["host_ns"][-1] - START_NS) > 7.7, "it is read again"
    flown.stop()
    again = Kept()
    flown.kept = again
    (flown.directory / "drive_armed").unlink()
    flown.start()
    flown.run(1.0)
    assert flown.codes == ["drive_refused"], "a new flight finds an arm that is not at the start"
    assert torques(flown) == {1}


def test_a_flight_computer_that_is_killed_leaves_servos_that_stop_and_hold(bench):
    flown = bench().run(MIDWAY_S)
    flown.run(0.3, pumped=False)
    assert flown.is_at_rest()
    assert torques(flown) == {1}
    assert [flown.register(name, 98, 1) for name in ("shoulder", "elbow")] == [255, 255]


def test_after_a_stop_it_can_hold(bench):
    flown = bench(drive='after_stop = "hold"').run(MIDWAY_S)
    flown.stop()
    assert flown.codes[-1] == "drive_at_rest"
    assert torques(flown) == {1}
    assert flown.is_at_rest()


def test_a_quick_stop_is_a_ramp(bench):
    flown = bench(drive="quick_stop_rad_s2 = 3.0").run(MIDWAY_S)
    at, rate = flown.axis("shoulder").angle_rad(1e-9 * (flown.rig.now_ns - START_NS)), flown.axis("shoulder").rate_rad_s
    flown.stop()
    (row,) = [row for row in sent(flown, "shoulder", 108) if row["length"] == 12][:1]
    acceleration, velocity, goal = struct.unpack("<3i", row["data"].tobytes())
    assert (acceleration, velocity) == (8, 53)  # 3 rad/s2 in 214.577 rev/min2
    way = (goal - 2048) * 2.0 * np.pi / 4096 - at
    assert way == pytest.approx(rate * abs(rate) / 6.0, rel=0.15, abs=0.01)


def test_way_points_of_a_profile(bench):
    time_s, q = swing(rows=9)
    flown = bench(drive='mode = "profile"\nacceleration_rad_s2 = 5', csv=csv_of(time_s, q)).run(4.5)
    assert flown.codes == PLAYED
    assert flown.register("shoulder", 108) == 13
    assert flown.axis("shoulder").highest_rad == pytest.approx(0.5, abs=0.02)
    assert flown.axis("shoulder").angle_rad(1e-9 * (flown.rig.now_ns - START_NS)) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (poked(68, "B", 1), "Status Return Level (68) is 1"),
        (poked(63, "B", 0x14), "Shutdown (63) leaves out overload"),
        (poked(44, "<I", 20), "Velocity Limit (44) is too low: 42 is needed"),
        (poked(70, "B", 0x20), "hardware error 20h"),
    ],
)
def test_a_servo_that_cannot_be_driven_safely_is_not(bench, change, why):
    flown = bench(change={"elbow": change}).run(0.2)
    assert why in flown.text("configuration")
    assert torques(flown) == {0}


@pytest.mark.parametrize(("zero", "refused"), [(1777, False), (4000, True)])
def test_a_homing_offset_is_refused_without_limits_of_the_servos_own(bench, zero, refused):
    flown = bench(change={"elbow": poked(20, "<i", 100)}, zero=zero).run(0.2)
    told = [text.decode() for text in flown.kept.of("event")["text"]]
    assert any("Homing Offset (20) is not 0" in text for text in told) == refused


def test_a_torque_that_is_on_is_not_switched_off_for_the_set_up(bench):
    flown = bench(change={"elbow": poked(64, "B", 1)}).run(0.2)
    assert "and its torque is on: switch that off with its tool" in flown.text("configuration")
    assert flown.rig.drives["elbow"].drive_state == 1


@pytest.mark.parametrize("register", [48, 52, 64, 98, 112, 116])
def test_a_servo_that_keeps_another_value_than_written_is_not_driven(bench, register):
    def forgets(servo):
        changed, before = servo.changed, bytes(servo.memory[register : register + 4])

        def back(address, now_ns):
            changed(address, now_ns)
            if address == register:
                servo.memory[register : register + 4] = before

        servo.changed = back

    flown = bench(change={"elbow": forgets}).run(0.4)
    assert f"elbow: address {register} keeps" in flown.text("configuration")
    assert "drive_started" not in flown.codes
    assert flown.axis("shoulder").fastest_rad_s < 0.05
    assert torques(flown) == {0}


def test_an_error_at_each_transaction_ends_in_no_motion_or_in_none_missing(tmp_path):
    """The answer to the n-th Read or Write of the elbow is an error."""
    seen = set()
    for call in range(1, 25):

        def refusing(servo, call=call):
            answer, count = servo.answer, [0]

            def counted(error, data, now_ns):
                count[0] += 1
                answer(2 if count[0] == call else error, b"" if count[0] == call else data, now_ns)

            servo.answer = counted

        with closing(ServoBench(tmp_path, change={"elbow": refusing})) as flown:
            flown.run(0.35)
            (tmp_path / "drive_armed").unlink(missing_ok=True)
            if "drive_started" in flown.codes:
                assert torques(flown) == {1}, call
                assert "configuration" not in flown.kept.of("event")["code"].astype(str).tolist()
            else:
                assert torques(flown) == {0}, call
                assert flown.axis("shoulder").fastest_rad_s < 0.05, call
            seen.add(tuple(flown.codes))
    assert seen == {(), ("drive_armed", "drive_started"), ("drive_armed", "drive_stopped", "drive_at_rest")}


def test_a_goal_that_is_not_taken_stops_the_arm(bench):
    flown = bench().run(MIDWAY_S)
    flown.rig.drives["elbow"].refuses = lambda address, value: 4 if address == 116 else 0
    flown.run(0.5)
    assert "elbow takes no goals" in flown.text("drive_stopped")


@pytest.mark.parametrize(("lost", "stopped"), [(2, False), (3, True)])
def test_goals_that_are_lost_in_a_row_stop_the_arm(bench, lost, stopped):
    """As many as a joint may be behind its targets may be lost: nobody acknowledges them."""
    flown = bench().run(MIDWAY_S)
    left = iter([4] * lost)
    flown.rig.drives["elbow"].refuses = lambda address, value: next(left, 0) if address == 116 else 0
    flown.run(0.1)
    assert next(left, None) is None
    assert ("drive_stopped" in flown.codes) == stopped


def test_a_servo_that_falls_silent_in_its_set_up_is_set_up_when_it_is_back(bench):
    flown = bench(faults=[Fault("silent", "elbow", 0.08, 0.5)]).run(0.2)
    assert 0 < len(flown.kept.of("elbow_sent")) < len(flown.kept.of("shoulder_sent"))
    flown.run(4.4)
    assert flown.codes == PLAYED


def test_a_servo_is_let_go_when_it_stands(bench):
    flown = bench(drive="quick_stop_rad_s2 = 3.0").run(MIDWAY_S)
    servo, rates = flown.rig.drives["shoulder"], []
    changed = servo.changed
    servo.changed = lambda at, now: (rates.append(servo.axis.rate_rad_s) if at == 64 else None, changed(at, now))
    assert abs(servo.axis.rate_rad_s) > 0.2
    flown.stop()
    (rate,) = rates
    assert abs(rate) < 0.229 * 2.0 * np.pi / 60.0  # its unit of speed


def test_a_torque_that_another_master_takes_away_stops_the_arm(bench):
    flown = bench().run(MIDWAY_S)
    flown.rig.drives["elbow"].memory[64] = 0
    flown.run(2.0)
    assert "elbow has lost its torque" in flown.text("drive_stopped")


def test_a_timeout_beyond_what_a_stop_may_wait_is_refused(bench):
    flown = bench(servo="timeout_ms = 13").run(0.1)
    assert "give half of [drive] sync_limit_ms = 25, or less" in flown.text("bus_failed")


def test_servos_that_are_driven_need_a_period_and_room_on_the_line(tmp_path):
    path = written(tmp_path, servo="sample_period_ms = 1")
    with pytest.raises(config.ConfigError, match="a round of 2 servos takes"):
        config.load(path)


def test_a_step_of_the_worker_between_two_rounds_sends_nothing_twice(bench):
    flown = bench().run(2.0)
    goals = sent(flown, "shoulder", 116)
    assert 350 < len(goals) < len(flown.kept.of("shoulder"))
    assert np.diff(goals["host_ns"][10:]).min() > MS
