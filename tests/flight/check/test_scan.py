"""``heft devices``: what is on the buses, against the simulated devices, and the vehicle file's lines that read it."""

import errno
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import DriverError
from drivers.ports import I2cReply
from hil_sim.faults import parse
from hil_sim.mission import open_in_process
from onboard.cli import BAD_INPUT, OK, main
from onboard.devices.registry import DEVICES
from onboard.flight.check import scan
from onboard.ground.before.init import seen


def looked_at(scenario: str, *faults: str) -> list[scan.Bus]:
    """Its I2C and CAN buses 0.2 s after power-up."""
    mission, urls = open_in_process(scenario, 1, [parse(text) for text in faults])
    with mission:
        mission.advance(mission.start_ns + 200_000_000)

        def wait(seconds: float) -> None:
            mission.advance(mission.now_ns + round(1e9 * seconds))

        return [scan.scan(urls[bus], lambda: mission.now_ns, wait) for bus in ("i2c_1", "can_0")]


@pytest.fixture(scope="module")
def dymaflex() -> list[scan.Bus]:
    return looked_at("dymaflex")


def test_chips_and_nodes_are_named(dymaflex: list[scan.Bus]) -> None:
    i2c, can = dymaflex
    assert [(one.where, one.what, one.kind) for one in i2c.found] == [
        ("0x68", "MPU-6050", "mpu6050"),
        ("0x69", "MPU-6050", "mpu6050"),
    ]
    sync, *nodes = can.found
    assert (sync.kind, sync.what, sync.number) == ("canopen_sync", "SYNC, every 2 ms", 2000)
    assert [one.where for one in nodes] == [f"node {n}" for n in range(1, 8)]
    assert [one.kind for one in nodes] == [*["cia406"] * 5, "cia404", ""]
    assert nodes[5].what == "CiA 404, vendor 0x5a5a, product 0x194, no heartbeat"
    assert "no device profile" in nodes[6].what


def test_the_lines_are_tables_of_these_devices(dymaflex: list[scan.Bus]) -> None:
    text = seen.tables({bus.url: [(one.kind, one.number) for one in bus.found if one.kind] for bus in dymaflex})
    tables = tomllib.loads(text)
    assert [bus["url"] for bus in tables["bus"].values()] == [bus.url for bus in dymaflex]
    devices = tables["device"]
    assert list(devices) == ["imu_base", "mpu6050_2", "can_sync", *(f"joint_{n}" for n in range(1, 6)), "load_cell"]
    for table in devices.values():
        assert table["bus"] in tables["bus"]
        DEVICES[table["kind"]].model_validate(table)
    assert [devices[name]["address"] for name in ("imu_base", "mpu6050_2")] == [0x68, 0x69]
    assert devices["can_sync"]["period_ms"] == 2
    assert [devices[f"joint_{n}"]["node"] for n in range(1, 6)] == [1, 2, 3, 4, 5]
    assert devices["load_cell"]["node"] == 6


def test_what_is_off_or_unplugged_is_not_listed_or_said() -> None:
    i2c, can = looked_at("rocksat_mixed", "off:imu_base:0:5", "off:load_cell:0:5")
    assert i2c.found == ()
    assert [one.where for one in can.found] == ["080h", "node 1", "node 3"]


class Chip:
    """A chip at 0x68 and 0x36 that heft has no driver for: every register reads ``value``, or fails with ``code``."""

    def __init__(self, value: int, code: int = 0) -> None:
        self.value, self.code = value, code

    def write(self, address: int, data: bytes) -> None:
        raise AssertionError(f"{address:#x} was written {data.hex()}")

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        if address not in (0x36, 0x68):
            raise OSError(errno.ENXIO, "no answer")
        if self.code:
            raise OSError(self.code, "failed")
        return I2cReply(bytes([self.value]) * count, 0)

    def close(self) -> None:
        pass


def test_a_chip_that_heft_does_not_know_is_said_and_not_written_to() -> None:
    assert [(one.where, one.kind) for one in scan.on_i2c(Chip(0xEA))] == [("0x36", ""), ("0x68", "")]
    assert all("no chip that heft reads" in one.what for one in scan.on_i2c(Chip(0xEA)))
    held = list(scan.on_i2c(Chip(0, errno.ETIMEDOUT)))
    assert ["SDA may be held low" in one.what for one in held] == [True, True]
    with pytest.raises(OSError, match="failed"):
        list(scan.on_i2c(Chip(0, errno.ENODEV)))


def test_buses_of_a_computer(tmp_path: Path) -> None:
    dev, net = tmp_path / "dev", tmp_path / "net"
    for name in ("i2c-10", "i2c-1", "null"):
        (dev / name).parent.mkdir(exist_ok=True)
        (dev / name).touch()
    for name, kind in (("can0", "280"), ("eth0", "1"), ("lo", "772")):
        (net / name).mkdir(parents=True)
        (net / name / "type").write_text(f"{kind}\n", encoding="ascii")
    assert scan.urls(dev, net) == [
        *(f"i2c://{dev}/{name}" for name in ("i2c-1", "i2c-10")),
        "can+socketcan://can0?bitrate=500000",
    ]
    assert scan.urls(tmp_path / "none", tmp_path / "none") == []


def test_a_bus_that_cannot_be_opened_is_said(tmp_path: Path) -> None:
    nothing: Callable[[float], None] = lambda _: None  # noqa: E731
    bus = scan.scan(f"i2c://{tmp_path}/i2c-9", lambda: 0, nothing)
    assert (bus.found, "cannot be used" in bus.problem) == ((), True)
    with pytest.raises(DriverError, match="serial"):
        scan.scan("serial:///dev/ttyUSB0", lambda: 0, nothing)


def test_the_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["devices", "--url", f"i2c://{tmp_path}/i2c-9", "--json", str(tmp_path / "seen.json")]) == OK
    assert "cannot be used" in capsys.readouterr().out
    assert '"vehicle_toml": ""' in (tmp_path / "seen.json").read_text(encoding="utf-8")
    assert main(["devices", "--url", "modbus:[bold]"]) == BAD_INPUT
    assert "modbus:[bold]" in capsys.readouterr().err
