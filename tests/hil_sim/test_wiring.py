"""Device tables of a scenario are read by their emulators and held against its buses, sensors and clocks."""

import re

import pytest

from hil_sim.scenario.load import ScenarioError, load, names
from hil_sim.twins import emulators

SERIAL_LINE = {"kind": "serial"}
NIMU = {"kind": "nimu", "bus": "line", "measures": "imu"}
BOX = {"kind": "sync_box", "line": "sync_line"}
CRYSTAL = {"rate_sigma": 0.0, "rate_limit": 0.0, "drift_sigma_per_s": 0.0}


def node(**keys: object) -> dict[str, object]:
    return {"kind": "loadcell404", "bus": "can_0", "measures": "load_cell", **keys}


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        ({"device": {"imu_base": {"bus": "i2c_2"}}}, "device.imu_base.bus: no bus 'i2c_2'; there are: can_0, i2c_1"),
        ({"device": {"imu_base": {"bus": "can_0"}}}, "can_0 is of kind 'can' and this goes on a bus of kind 'i2c'"),
        ({"device": {"sync_box": {"line": "can_0"}}}, "device.sync_box.line: can_0 is of kind 'can'"),
        ({"device": {"joint_1": {"measures": "radar"}}}, "device.joint_1 measures 'radar'; the sensors here are: enc"),
        ({"device": {"joint_1": {"measures": "imu"}}}, "a encoder406 does not measure inertial; name another sensor"),
        ({"device": {"joint_1": {"node": 2}}}, "bus can_0: 2 devices are node 2; move either, or give it another"),
        ({"device": {"two": BOX}, "clock": {"two": CRYSTAL}}, "several sync boxes"),
        ({"device": {"camera": node(node=4, flags=True)}}, "device.camera.flags: Extra inputs are not permitted"),
        (
            {"device": {"camera": {"kind": "camera"}}},
            "device.camera: no device is a 'camera'; there are: arm",
        ),
        ({"device": {"imu_2": NIMU}, "bus": {"line": SERIAL_LINE}}, "no [clock.imu_2] says how right"),
        ({"clock": {"joint_1": CRYSTAL}}, "clock.joint_1 belongs to no device; the clocks here are: imu_base, imu_"),
        (
            {"bus": {"line": SERIAL_LINE}, "device": {"a": NIMU, "b": NIMU}, "clock": {"a": CRYSTAL, "b": CRYSTAL}},
            "bus line: 2 devices are the line",
        ),
        (
            {
                "bus": {"line": SERIAL_LINE},
                "device": {"joint_2": {"kind": "qsb", "bus": "line", "measures": "encoder"}},
                "clock": {"joint_2": CRYSTAL},
            },
            "bus.line.baud_rate: a qsb comes up with 230400, not 115200",
        ),
        (
            {
                "bus": {"line": SERIAL_LINE},
                "device": {
                    "node": {
                        "kind": "node_frame",
                        "bus": "line",
                        "channel": [{"name": "gyro", "measures": "imu", "unit": "rad/s", "type": "i16"}],
                    }
                },
                "clock": {"node": CRYSTAL},
            },
            "device.node: a node_frame does not measure inertial",
        ),
    ],
)
def test_wiring_that_cannot_be_is_refused_with_the_remedy(overrides, named) -> None:
    with pytest.raises(ScenarioError, match=re.escape(named)):
        emulators(load("rocksat", overrides))


@pytest.mark.parametrize("name", names())
def test_every_packaged_scenario_is_wired(name) -> None:
    scenario = load(name)
    devices = emulators(scenario)
    assert len(devices) >= 4
    assert {device: table.kind for device, table in devices.items()} == {
        device: table.kind for device, table in scenario.device.items()
    }
