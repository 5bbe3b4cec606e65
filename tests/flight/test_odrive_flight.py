"""A vehicle of ``heft init --encoder odrive`` flies in virtual time and in real time, and survives what breaks."""

import numpy as np
import pytest

from drivers.records import SampleStatus
from onboard.cli import main
from onboard.timebase.timebase import FreeChannel, Timebase
from tests.drivers.batches import whole
from tests.drivers.test_odrive import MS, Flight, estimates
from tests.flight.test_i2c_devices import codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

ARM = ["--base", "fixed", "--joints", "2", "--encoder", "odrive"]


@pytest.mark.campaign  # by currents: test_servo_arm; its times: below
def test_a_payload_is_weighed_by_its_torques(tmp_path):
    result, log, _ = rehearsed(tmp_path, ARM)
    honest(answers(result))
    assert codes_of(log, b"joint_1") == [b"started"]
    for name in ("joint_1", "joint_2", "joint_2_torque"):
        rows = log.read(name)
        assert len(rows) > 715
        assert not rows["status"].any()
        assert (np.diff(rows["sequence"]) == 1).all()


def test_messages_that_wait_for_those_of_other_axes_have_the_times_of_their_estimates(rng):
    """Half of them wait up to 4 ms, as of four axes on one bus: their arrivals scatter by 1.3 ms."""
    waits = np.rint(4 * MS * rng.uniform(size=600) * (rng.uniform(size=600) < 0.5)).astype(int)
    flight, timebase = Flight(), Timebase({"knee": FreeChannel(1.0, 0.5 * MS, 0.2 * MS)}, None)
    sent = flight.clock() + 10 * MS * np.arange(600)  # each takes 0.5 ms
    for arrived in sent + waits + MS // 2:
        flight.pump(int(arrived) - flight.clock(), estimates(0.0))
        timebase.update(int(arrived), {"knee": whole(flight.batches, "knee")[-1:]})
    rows = whole(flight.batches, "knee")
    assert np.std(rows["host_ns"][200:].astype(int) - sent[200:]) > MS
    late = timebase.time_ns("knee", rows)[200:] - sent[200:]
    assert np.std(late) < 0.02 * MS
    assert abs(late.mean()) < 0.1 * MS


def test_it_survives_unplugging_silence_a_brown_out_and_errors(tmp_path):
    faults = [
        *("--fault", "unplug:odrives:1.5:2.1", "--fault", "silent:joint_1:2.8:3.1"),
        *("--fault", "off:joint_2:3.8:4.3", "--fault", "trip:joint_1:5:5.5:8192"),
    ]
    result, log, _ = rehearsed(tmp_path, ARM, *faults, swing=4.5)
    honest(answers(result))
    assert codes_of(log, b"odrives").count(b"bus_recovered") == 1
    assert b"axis_error" in codes_of(log, b"joint_1")
    assert b"restarted" in codes_of(log, b"odrives")
    rows = log.read("joint_2")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == 1
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 5.5e9


def test_an_axis_and_a_canopen_node_are_not_on_one_bus(tmp_path, capsys):
    assert main(["init", str(tmp_path / "mine"), *ARM, "--load-cell", "cia404"]) == 0
    path = tmp_path / "mine" / "vehicle.toml"
    path.write_text(path.read_text().replace('bus = "odrives"', 'bus = "can_0"'))
    assert main(["preflight", str(path)]) != 0
    assert "CAN and CAN without SYNC; give each a bus" in capsys.readouterr().err
