"""Every kind of device in vehicle.toml, opened against its twin: what it writes is what the vehicle says it writes."""

import can
import numpy as np
import pytest

from drivers.records import EVENT, GAP, Severity
from onboard.devices.base import BusDevice
from onboard.devices.buses import PulseDevice, PulseOutputDevice
from onboard.devices.registry import DEVICES as DEVICES_BY_KIND
from onboard.flight.clocks import timebase_of
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import SignalSmoother
from onboard.flight.store import rings
from tests.flight.mixed import DEVICES, MixedWorld, angle, force_n, only, vehicle
from tests.flight.mixed_flight import MIXED_s
from tests.hil_sim.devices.twin_bench import MS, START_NS


def fly(directory, world, text, seconds):
    """The vehicle, and rows by channel."""
    flying = vehicle(directory, world.urls, text)
    heard = world.fly(world.open(flying), seconds)
    return flying, {channel: np.concatenate(rows) for channel, rows in heard.items()}


@pytest.fixture
def flight(mixed_flight, tmp_path):
    return mixed_flight.vehicle(tmp_path), mixed_flight.rows


def test_the_mixed_vehicle_has_every_kind_that_has_a_bus():
    kinds = {kind for kind, model in DEVICES_BY_KIND.items() if issubclass(model, BusDevice)}
    kinds -= {"reaction_wheel", "thruster"}  # they need a free base: tests/flight/test_wheels_and_thrusters.py
    assert {line.split('"')[1] for line in DEVICES.splitlines() if line.startswith("kind =")} == kinds


def test_every_channel_is_written_in_its_own_records(flight):
    flying, rows = flight
    assert {channel: rows[channel].dtype for channel in flying.channels} == flying.channels
    assert flying.channels.keys() >= {"upper_torque", "servo_6_velocity", "imu_tip_mag_z", "elbow_mark", "wrist_mode"}
    assert rows.keys() - flying.channels.keys() == {"event", "gap"}
    assert (rows["event"].dtype, rows["gap"].dtype) == (EVENT, GAP)


def test_rows_and_gaps_together_are_all_there_is(flight):
    flying, rows = flight
    for channel in flying.channels:
        gaps = rows["gap"][rows["gap"]["channel"] == channel.encode()]
        missing = [np.arange(g["first_missing"], g["last_missing"] + 1) for g in gaps]
        numbers = np.sort(np.concatenate([rows[channel]["sequence"], *missing]))
        assert (numbers == np.arange(len(numbers))).all(), channel


def test_nothing_fails(flight):
    _, rows = flight
    assert [e["text"] for e in rows["event"] if e["severity"] >= Severity.WARNING] == []
    # a QSB's line is full while it also tells of a pulse, and questions under way at the end are not answered
    assert {(g["channel"], g["cause"]) for g in rows["gap"]} <= {
        (b"elbow", b"lines_lost"),
        (b"cell", b"stopped"),
        (b"grip", b"stopped"),
        *((name, b"stopped") for name in (b"servo_6", b"servo_6_velocity", b"servo_6_torque", b"servo_7")),
    }


def test_rings_keep_ten_seconds_of_every_channel(flight):
    flying, rows = flight
    capacities = rings.capacities(flying)
    assert capacities.keys() == flying.channels.keys()
    for channel, capacity in capacities.items():
        assert capacity >= 10.0 * (len(rows[channel]) / MIXED_s), channel


def test_the_rate_in_the_vehicle_file_is_the_rate_seen(flight):
    flying, rows = flight
    for name, device in flying.file.device.items():
        if device.kind == "canopen_object":
            continue  # on change
        channel = next(iter(device.channels(name)))
        stamps = rows[channel]["host_ns"]
        seen_hz = 1e9 * (len(stamps) - 1) / float(stamps[-1] - stamps[0])
        pulses = isinstance(device, PulseDevice | PulseOutputDevice)
        # intervals of the code are 30 to 61 SYNC periods, and its beginning has the short ones
        assert seen_hz == pytest.approx(flying.rate_hz(name), rel=0.5 if pulses else 0.05), name


def smoothed(flying, rows, seconds):
    """A function to the signals of a vehicle, its clocks and signals having heard so much of the flight."""
    timebase, signals = timebase_of(flying), SignalSmoother(flying)
    first_ns = int(rows["can_sync"]["host_ns"][0])
    for step in range(round(seconds * 20)):
        until_ns = first_ns + (step + 1) * 50 * MS
        now = {
            channel: rows[channel][
                (rows[channel]["host_ns"] < until_ns) & (rows[channel]["host_ns"] >= until_ns - 50 * MS)
            ]
            for channel in flying.channels
        }
        timebase.update(until_ns, now)
        assert signals.append(now) == []
    return lambda channel, at_ns: signals.at(channel, timebase, at_ns, 1)


def test_every_joint_and_cell_is_read_right_at_the_right_time(flight):
    """What the twins measured, at vehicle times, through each device's own clock, unit, zero and scale."""
    flying, rows = flight
    signal = smoothed(flying, rows, 3.9)
    at_ns = START_NS + np.arange(4300, 4600, 50) * MS
    roles = roles_of(flying)
    assert len(roles.joints) == 11
    for joint in roles.joints:
        number = int(joint.joint.partition("_")[2])
        true = np.array([angle(number)(1e-9 * (t - START_NS)) for t in at_ns.tolist()])
        found = signal(joint.channel, at_ns)
        assert (found.refused == 0).all(), joint.channel
        measured = found.derivatives[0][:, 0]
        if joint.channel == "elbow":  # it counts modulo 500 until it is set up: where zero is, nobody knows
            true, measured = true[1:] - true[0], measured[1:] - measured[0]
        a_tenth_of_a_millisecond_rad = 0.1e-3 * 0.6
        a_count_rad = 2.0 * np.pi / 4096 if joint.channel in ("tip", "servo_6", "servo_7", "knee", "hip") else 0.0
        if joint.channel == "robot_8":  # by arrivals alone: two of its sigmas
            a_count_rad = 2e-9 * flying.file.device["robot_8"].delay_ns[1] * 0.6
        assert measured == pytest.approx(true, abs=a_tenth_of_a_millisecond_rad + a_count_rad), joint.channel
    assert len(roles.cells) == 11
    for cell in roles.cells:
        found = signal(cell.channel, at_ns)
        assert (found.refused == 0).all(), cell.channel
        true = [force_n(1e-9 * (t - START_NS)) for t in at_ns.tolist()]
        assert found.derivatives[0][:, 0] == pytest.approx(true, abs=0.001), cell.channel
    for channel, si in (("wrist_gyro_x", np.radians(1.0)), ("wrist_accel_x", 0.5 * 9.80665)):
        assert signal(channel, at_ns).derivatives[0][:, 0] == pytest.approx(si, rel=1e-4)


def timed(flying, rows, channel):
    """Mission times of a channel's rows, and 1 sigma of the last, ns."""
    timebase, rows = timebase_of(flying), rows[channel]
    for now in np.array_split(rows, len(rows) // 5):
        timebase.update(int(now["host_ns"][-1]), {channel: now})
    times_ns = timebase.time_ns(channel, rows)
    return times_ns - START_NS, timebase.sigma_ns(channel, int(times_ns[-1]))


def test_a_trackers_delay_holds_half_of_a_poll(flight):
    flying, _ = flight
    [delay] = flying.file.device["tracker"].delays("tracker", flying)
    assert delay.delay_s == pytest.approx(8e-3 + 0.5 * 5e-3 + 52 * 10 / 230_400)  # a message without a covariance
    assert delay.sigma_s == pytest.approx(1e-3 * np.hypot(1.0, 5.0 / 12**0.5))


def test_a_pose_is_put_on_the_time_when_it_was_taken(flight):
    flying, rows = flight
    timebase = timebase_of(flying)
    poses = rows["tracker"]
    for now in np.array_split(poses, len(poses) // 5):
        timebase.update(int(now["host_ns"][-1]), {"tracker": now})
    taken_s = (timebase.time_ns("tracker", poses[-20:]) - START_NS) * 1e-9
    late_s = taken_s - poses["position_m"][-20:, 0] / 0.1  # it drifts by 0.1 m/s
    one_poll_s = 5e-3
    assert np.abs(late_s).max() < one_poll_s


def test_pulses_driven_come_in(flight):
    _, rows = flight
    sent, received = rows["loop"], rows["second"]
    assert len(sent) > 10
    assert (sent["edge_ns"] == received["edge_ns"]).all()


def test_a_bus_that_cannot_be_opened_costs_its_own_devices_only(tmp_path):
    lost = "imu_base", "imu_elbow", "bridge", "tip", "knee", "imu_tip"
    others = "can_sync", "shoulder", "hip", "elbow"
    text = only(*lost, *others)
    with MixedWorld(tmp_path, text) as world:
        world.urls["i2c_1"] = "i2c:///dev/no-such-bus"
        world.urls["tty_imu"] = "serial:///dev/no-such-tty?baud=115200"
        flying, rows = fly(tmp_path, world, text, 1.0)
    said = {(e["source"], e["code"]) for e in rows["event"] if e["severity"] == Severity.ERROR}
    assert said == {(b"i2c_1", b"bus_failed"), (b"imu_tip", b"bus_error")}
    silent = {channel for channel in flying.channels if channel not in rows}
    magnetic = {f"imu_tip_mag_{axis}" for axis in "xyz"}
    assert silent == {*lost, *magnetic}
    assert set(others) < set(rows)


def test_the_generator_makes_the_syncs_of_a_bus_that_has_no_other(tmp_path):
    text = only("imu_tip", "can_sync", "shoulder", "load_cell", "loop", "second")
    text = text.replace('bus = "loop_out"\n', 'bus = "loop_out"\nsync_bus = "can_0"\n')
    with MixedWorld(tmp_path, text, sync_box=False) as world:
        _, rows = fly(tmp_path, world, text, 2.0)
    sent = rows["loop_sync"]["tick"]
    assert len(sent) == pytest.approx(2.0 * 200, abs=5)
    assert (rows["can_sync"]["sync_counter"] > 0).all()
    assert len(rows["shoulder"]) > 300
    assert set(rows["shoulder"]["tick"]) <= set(sent)


def test_a_node_without_heartbeat_is_guarded_as_the_vehicle_says(tmp_path):
    guarded = 'node = 1\nsupervision = "guarding"\nguard_time_ms = 50\nlife_time_factor = 4\n'
    text = only("imu_tip", "can_sync", "shoulder", "upper", "load_cell").replace("node = 1\n", guarded)
    with MixedWorld(tmp_path, text) as world:
        world.encoder.dictionary.remove(0x1017, 0)
        channel = world.urls["can_0"].removeprefix("can+virtual://").partition("?")[0]
        with can.Bus(channel, interface="virtual", preserve_timestamps=True) as listener:
            _, rows = fly(tmp_path, world, text, 1.0)
            heard = iter(lambda: listener.recv(0.0), None)
            asked_s = [message.timestamp for message in heard if message.is_remote_frame]
    # the virtual bus carries no remote frames to the twin, so that the fourth question finds the node lost
    assert {e["source"] for e in rows["event"] if e["code"] == b"guarding_lost"} == {b"shoulder"}
    assert np.diff(asked_s[:4]) == pytest.approx(0.05, abs=0.002)
