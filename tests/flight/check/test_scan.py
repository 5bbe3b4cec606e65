"""``heft devices``: what is on the buses, against the simulated devices, and the vehicle file's lines that read it."""

import errno
import tomllib
from pathlib import Path

import pytest
from fastcrc.crc16 import ibm_sdlc
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.dynamixel.packet import ping_request
from drivers.errors import DriverError
from drivers.ports import I2cReply
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.faults import parse
from hil_sim.mission import open_in_process
from onboard.cli import BAD_INPUT, OK, main
from onboard.devices.registry import DEVICES
from onboard.flight.check import scan
from onboard.ground.before.init import seen
from tests.drivers.can_peers import FakeCan

STILL = [{"phase": 1, "action": "hold", "duration_s": 5.0}]


def looked_at(scenario: str, *faults: str) -> list[scan.ScannedBus]:
    """Its I2C and CAN buses 0.2 s after power-up."""
    made = scenario_of(scenario, {"sequence": STILL, "capture": False} if scenario == "dymaflex" else None)
    mission, urls = open_in_process(made, 1, [parse(text) for text in faults])
    with mission:
        mission.advance(mission.start_ns + 200_000_000)

        def wait(seconds: float) -> None:
            mission.advance(mission.now_ns + round(1e9 * seconds))

        return [scan.scan(urls[bus], lambda: mission.now_ns, wait) for bus in ("i2c_1", "can_0")]


@pytest.fixture(scope="module")
def dymaflex() -> list[scan.ScannedBus]:
    return looked_at("dymaflex")


def test_chips_and_nodes_are_named(dymaflex: list[scan.ScannedBus]) -> None:
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


def test_the_lines_are_tables_of_these_devices(dymaflex: list[scan.ScannedBus]) -> None:
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
    assert [(one.where, one.kind) for one in scan.on_i2c(Chip(0x47))] == [("0x36", ""), ("0x68", "")]
    assert all("no chip that heft reads" in one.what for one in scan.on_i2c(Chip(0x47)))
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
    bus = scan.scan(f"i2c://{tmp_path}/i2c-9", lambda: 0, at_once)
    assert (bus.found, "cannot be used" in bus.problem) == ((), True)
    with pytest.raises(DriverError, match="serial"):
        scan.scan("serial:///dev/ttyUSB0", lambda: 0, at_once)


def test_the_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["devices", "--url", f"i2c://{tmp_path}/i2c-9", "--json", str(tmp_path / "seen.json")]) == OK
    assert "cannot be used" in capsys.readouterr().out
    assert '"vehicle_toml": ""' in (tmp_path / "seen.json").read_text(encoding="utf-8")
    assert main(["devices", "--url", "modbus:[bold]"]) == BAD_INPUT
    assert "modbus:[bold]" in capsys.readouterr().err


def on_line(scenario: str, bus: str, *faults: str) -> scan.ScannedBus:
    """What answers on a serial line 0.6 s after power-up: servos need 0.4 s."""
    mission, urls = open_in_process(scenario, 1, [parse(text) for text in faults])
    with mission:
        mission.advance(mission.start_ns + 600_000_000)

        def wait(seconds: float) -> None:
            mission.advance(mission.now_ns + round(1e9 * seconds))

        return scan.scan(urls[bus], lambda: mission.now_ns, wait)


def test_servos_on_a_line_are_named_and_made_joints_of() -> None:
    line = on_line("student_arm", "tty_servos", "off:joint_3:0:5")
    assert [(one.where, one.what, one.kind) for one in line.found] == [
        (f"ID {n}", "DYNAMIXEL, model 1020, firmware 45", "dynamixel") for n in (1, 2, 4)
    ]
    tables = tomllib.loads(seen.tables({line.url: [(one.kind, one.number) for one in line.found]}))
    assert [table["id"] for table in tables["device"].values()] == [1, 2, 4]
    assert {table["bus"] for table in tables["device"].values()} == set(tables["bus"])


def test_a_modbus_station_is_named_with_its_address() -> None:
    line = on_line("rocksat_serial", "cell_port")
    assert [(one.where, one.what, one.kind) for one in line.found] == [
        ("ID 1", "Modbus load cell transmitter: address = 1", "modbus_load_cell")
    ]
    [table] = tomllib.loads(seen.tables({line.url: [("modbus_load_cell", 7)]}))["device"].values()
    assert table["address"] == 7


def test_a_line_on_which_nothing_of_these_answers() -> None:
    line = on_line("rocksat_serial", "joint_port")  # a QSB, which answers in its own words
    assert (line.found, line.problem) == ((), "")


class Line:
    """A serial port that answers what it is made with to the first request, or says it unasked."""

    def __init__(self, answer: bytes, *, unasked: bool = False) -> None:
        self.answer, self.waiting = (b"", answer) if unasked else (answer, b"")

    @property
    def in_waiting(self) -> int:
        return len(self.waiting)

    def read(self, size: int = 1) -> bytes:
        got, self.waiting = self.waiting[:size], self.waiting[size:]
        return got

    def write(self, data: bytes, /) -> int:
        self.answer, self.waiting = b"", self.waiting + self.answer
        return len(data)

    def close(self) -> None:
        pass


def at_once(seconds: float) -> None:
    """What a line says is there already."""


@settings(max_examples=300)
@given(st.binary(max_size=200))
def test_whatever_a_line_says_is_no_crash(noise: bytes) -> None:
    for one in scan.on_line(Line(noise), at_once, "serial"):
        assert one.number <= 0xFF
    assert not list(scan.on_line(Line(noise), at_once, "tcp")) or noise[2:3] == b"V"


def test_a_controller_is_known_by_its_packages() -> None:
    """By the guide: an answer is its size, its letter and what it says; here 1 for accepted, and four numbers."""
    accepted, software = b"\x00\x04V\x01", b"\x00\x13v" + bytes([0, 0, 0, 5, 0, 0, 0, 16, 0, 0, 0, 1, 0, 0, 0, 7])
    six = list(scan.on_line(Line(accepted + software), at_once, "tcp"))
    assert [(one.kind, one.number) for one in six] == [("ur_joint", n) for n in range(1, 7)]
    assert six[1].what == "UR controller, URControl 5.16.1.7: number = 2"
    assert next(iter(scan.on_line(Line(accepted), at_once, "tcp"))).what == "UR controller: number = 1"
    [old] = scan.on_line(Line(b"\x00\x04V\x00"), at_once, "tcp")
    assert (old.kind, "update the controller's software" in old.what) == ("", True)
    assert not list(scan.on_line(Line(b"HTTP/1.1 400 Bad Request\r\n"), at_once, "tcp"))


def test_answers_to_a_ping_are_found_in_any_company() -> None:
    """Examples of ROBOTIS' e-manual, "DYNAMIXEL Protocol 2.0", 3.1: ID 1, XM430-W210, firmware 38, and ID 2."""
    one = bytes.fromhex("FFFFFD00010700550006042665 5D".replace(" ", ""))
    two = bytes.fromhex("FFFFFD000207005500060426 6F6D".replace(" ", ""))
    for line in (one + two, b"\xff\x00junk" + one + b"\xff\xff\xfd\x00" + two + b"\xff"):
        found = list(scan.on_line(Line(line), at_once, "serial"))
        assert [(each.number, each.what) for each in found] == [
            (n, "DYNAMIXEL, model 1030, firmware 38") for n in (1, 2)
        ]
    assert ping_request() == bytes.fromhex("FFFFFD00FE03000131 42".replace(" ", ""))
    broken = one[:-1] + bytes([one[-1] ^ 1])
    assert list(scan.on_line(Line(broken), at_once, "serial")) == []


def test_a_wrist_sensor_is_known_by_a_record() -> None:
    """By its manual: 36 bytes; the port puts their number before them."""
    six = list(scan.on_line(Line(b"\x00\x24" + bytes(36)), at_once, "udp"))
    assert [(one.kind, one.number) for one in six] == [("net_ft", n) for n in range(1, 7)]
    assert not list(scan.on_line(Line(b"\x00\x04HTTP"), at_once, "udp"))


def test_a_wrist_sensor_on_a_line_is_known_by_a_frame() -> None:
    said = b"App Init\r\n\xaa" + bytes(34) + ibm_sdlc(bytes(34)).to_bytes(2, "little")
    six = list(scan.on_line(Line(said, unasked=True), at_once, "serial"))
    assert [(one.kind, one.number) for one in six] == [("bota_ft", n) for n in range(1, 7)]
    assert not list(scan.on_line(Line(said[:-1] + b"\0", unasked=True), at_once, "serial"))


class Named(Line):
    """A sensor of Robotous: it answers the question for its model's name."""

    def write(self, data: bytes, /) -> int:
        return super().write(data) if data == bytes.fromhex("550100000000000000 01AA") else len(data)


def test_a_wrist_sensor_on_a_line_is_known_by_the_name_of_its_model() -> None:
    said = b"\x01RFT40-SA01".ljust(16, b"\0")
    packet = b"\x55" + said + bytes([sum(said) & 0xFF, 0xAA])
    six = list(scan.on_line(Named(packet), at_once, "serial"))
    assert [(one.kind, one.number) for one in six] == [("robotous_rft", n) for n in range(1, 7)]
    assert not list(scan.on_line(Named(packet[:-1] + b"\0"), at_once, "serial"))


def test_odrives_are_known_by_what_they_send_and_nobody_is_asked_beside_them() -> None:
    """Node 48: an SDO read of CANopen node 7 would be its command to change its state."""
    port = FakeCan()
    for command in (0x01, 0x09):
        port.put(0, 48 << 5 | command, bytes(8))  # type: ignore[no-untyped-call]
    [found] = scan.on_can(port, lambda: 0, at_once)
    assert (found.kind, found.number) == ("odrive", 48)
    assert "no torques" in found.what
    assert not port.sent
