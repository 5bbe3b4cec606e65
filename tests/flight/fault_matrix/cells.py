"""Every fault of the vocabulary on every device of three vehicles, and what must come of it."""

from typing import Any, NamedTuple

FIRST_S, SECOND_S, EJECTION_S = 3.2, 7.6, 6.0  # where faults begin: in sweep 1, in sweep 2, just before the ejection
CHANNELS = {  # what a fault of a device may touch; everything else must lose nothing
    "rocksat": {
        "imu_base": ("imu_base",),
        "i2c_1": ("imu_base",),
        "joint_1": ("joint_1",),
        "load_cell": ("load_cell",),
        "arm_phase": ("arm_phase",),
        "sync_box": ("can_sync", "pulse", "joint_1", "load_cell"),
        "sync_line": ("pulse",),
        "can_0": ("can_sync", "joint_1", "load_cell", "arm_phase"),
    },
    "rocksat_serial": {
        "imu_base": ("imu_base", "imu_base_mag_x", "imu_base_mag_y", "imu_base_mag_z"),
        "imu_port": ("imu_base", "imu_base_mag_x", "imu_base_mag_y", "imu_base_mag_z"),
        "joint_1": ("joint_1",),
        "joint_port": ("joint_1",),
        "load_cell": ("load_cell",),
        "cell_port": ("load_cell",),
        "arm": ("arm_phase",),
        "arm_port": ("arm_phase",),
    },
    "rocksat_mixed": {
        "imu_base": ("imu_base",),
        "joint_1": ("joint_1", "joint_1_velocity", "joint_1_torque"),
        "load_cell_2": ("load_cell_2",),
        "cell_port": ("load_cell_2",),
    },
}
KINDS = {  # of the devices, for the reader of the table
    "rocksat": "MPU-6050 by its FIFO (I2C), CiA 406 encoder, CiA 404 load cell and a CANopen object (CAN), SYNC, pulse",
    "rocksat_serial": "nIMU, QSB, Modbus load cell and a custom node, each on a serial line",
    "rocksat_mixed": "MPU-6050 in burst mode, CiA 402 drive with node guarding, DSC load cell on a serial line",
}


class Cell(NamedTuple):
    """A fault of a device, and what must come of it.

    Attributes:
        reported: codes of events and causes of gaps, all of which must be reported.
        recovery_s: rows of the device flow again so long after the fault at the latest.
        start_s: when it begins.
        unnamed: samples of one of its channels that may be lost without a gap record.
        shares: it takes samples away at most; one that puts false ones in their place flies alone.
        vehicle: the vehicle it happens to.
    """

    device: str
    kind: str
    value: float = 0.0
    last_s: float = 0.6
    reported: tuple[str, ...] = ()
    recovery_s: float = 0.05
    start_s: float = FIRST_S
    shares: bool = True
    unnamed: int = 0
    vehicle: str = "rocksat"

    @property
    def name(self) -> str:
        return f"{self.kind}({self.value:g})" if self.value else self.kind

    @property
    def channels(self) -> tuple[str, ...]:
        return CHANNELS[self.vehicle][self.device]

    @property
    def flowing(self) -> tuple[str, ...]:
        """Those of its channels that make rows all the time."""
        return tuple(name for name in self.channels if name != "arm_phase" or self.device != "can_0")

    @property
    def fault(self) -> dict[str, Any]:
        end_s = self.start_s + self.last_s
        where = {"kind": self.kind, "device": self.device, "value": self.value}
        return {**where, "start_s": self.start_s, "end_s": end_s}

    def on_its_own(self) -> "Cell":
        """As it stands in the table, wherever in a flight it was put."""
        return self._replace(start_s=FIRST_S) if self.start_s == SECOND_S else self


def _rocksat() -> list[Cell]:
    imu, joint, load_cell, arm = "imu_base", "joint_1", "load_cell", "arm_phase"
    cells = [
        Cell(imu, "off", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell(imu, "reset", 0.0, 0.6, ("brown_out", "gap brown_out"), 0.3),
        Cell(imu, "intermittent", 0.1, 0.6, ("bus_error",)),
        Cell(imu, "stuck", 0.0, 0.6, ("stuck",), shares=False),
        Cell(imu, "saturated", 0.0, 0.6, ("rows refused: saturated",), shares=False),
        Cell(imu, "wrong", 0.5, shares=False),
        Cell(imu, "delayed", 0.1, shares=False),
        Cell(imu, "garbage", 0.0, 0.6, ("bus_error", "gap bus_error"), 1.1),
        Cell(imu, "slow", 0.2, 0.6, ("clock imu_base rejects pulses",)),
        Cell(imu, "clock_jump", -0.06, 0.6, ("clock imu_base rejects pulses",)),
        Cell(imu, "clock_jump", -0.3, 0.6, ("no_samples", "gap no_samples"), unnamed=1),
        Cell(imu, "timeout", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell(imu, "pulse_drop"),
        Cell(imu, "pulse_spurious", 0.07),
        Cell("i2c_1", "nack", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell("i2c_1", "stuck_bus", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell("i2c_1", "intermittent", 0.1, 0.6, ("bus_error",)),
    ]
    for node in (joint, load_cell):
        cells += [
            Cell(node, "off", 0.0, 0.6, ("silent", "node_rebooted", "gap node_reset"), 0.2),
            Cell(node, "reset", 0.0, 0.6, ("node_rebooted", "gap node_reset"), 0.2),
            Cell(node, "silent", 0.0, 0.6, ("silent", "emcy_8140", "gap no_pdo")),
            Cell(node, "silent", 0.0, 2.0, ("silent", "heartbeat_lost", "gap node_reset"), 0.6),
            Cell(node, "intermittent", 0.1, 0.6, ("emcy_8140", "gap no_pdo")),
            Cell(node, "stuck", 0.0, 0.6, ("estimation stuck", "rows refused: stuck"), shares=False),
            Cell(node, "wrong", 0.3, shares=False),
            Cell(node, "delayed", 0.1, 0.6, _LATE[node], shares=False),
            Cell(node, "garbage", 0.0, 0.6, ("bad_heartbeat", "rows refused: saturated")),
            Cell(node, "slow", 0.02, 0.6, ("pdo_extra", "gap no_pdo")),
        ]
    cells.append(Cell(load_cell, "saturated", 1.0, 0.6, ("rows refused: saturated",)))
    cells.append(Cell(joint, "slipped", 10.0, 0.6, ("estimation angle_jumped",), shares=False))
    late = EJECTION_S
    cells += [
        Cell(arm, "off", 0.0, 1.2, ("heartbeat_lost",), 0.2, late, shares=False),
        Cell(arm, "reset", 0.0, 1.2, ("node_rebooted",), 0.2, late),
        Cell(arm, "silent", 0.0, 1.2, ("emcy_8140", "pdo_lost", "gap no_pdo"), 0.6, late, shares=False),
        Cell(arm, "stuck", 0.0, 1.2, ("rows refused: residual",), 4.0, late, shares=False),
        Cell(arm, "wrong", 1.0, 1.2, (), 4.0, late),
        Cell(arm, "delayed", 0.2, 1.2, (), 4.0, late),
        Cell(arm, "garbage", 0.0, 1.2, ("bad_heartbeat",), 4.0, late, shares=False),
        Cell(arm, "slow", 0.2, 1.2, (), 4.0, late),
        Cell(arm, "wrong", 1.0, shares=False),
        Cell("sync_box", "off", 0.0, 0.6, ("sync_restarted",), 0.2),
        Cell("sync_box", "reset", 0.0, 0.6, ("sync_restarted", "gap no_pdo"), 0.2),
        Cell("sync_box", "silent", 0.0, 0.6, ("gap no_sync",), 0.3),
        Cell("sync_box", "intermittent", 0.1, 0.6, ("gap no_sync",), 0.3),
        Cell("sync_box", "wrong", 7.0, 0.6, ("sync_restarted", "gap no_sync"), 0.3),
        Cell("sync_box", "garbage", 0.0, 0.6, ("bad_sync", "sync_restarted"), 0.3),
        Cell("sync_box", "slow", 0.05, recovery_s=0.3, shares=False),
        Cell("sync_box", "clock_jump", 0.1, 0.6, ("sync_restarted", "gap no_pdo"), 0.3),
        Cell("sync_box", "clock_jump", -0.1, 0.6, ("sync_paused",), 0.3),
        Cell("sync_line", "pulse_drop", recovery_s=0.35),
        Cell("sync_line", "pulse_spurious", 0.07, recovery_s=0.35),
        Cell("sync_line", "intermittent", 0.3, recovery_s=0.35),
        Cell("sync_line", "delayed", 0.02, recovery_s=0.35),
        Cell("sync_line", "garbage", 50.0, recovery_s=0.35),
        Cell("can_0", "frame_drop", 0.0, 0.6, ("gap no_sync",)),
        Cell("can_0", "bus_off", 0.0, 0.6, ("can_error_040", "can_error_100", "gap no_sync")),
        Cell("can_0", "error_frames", 0.01, 0.6, ("can_error_088",)),
        Cell("can_0", "flood", 0x001, 0.6, ("gap no_sync",)),
        Cell("can_0", "flood", 0x101, 0.6, ("silent", "gap no_pdo")),
        Cell("can_0", "flood", 0x7F0),
        Cell("can_0", "delayed", 0.05, 0.6, ("sync_paused",)),
        Cell("can_0", "intermittent", 0.1, 0.6, ("gap no_sync",)),
        Cell("can_0", "unplug", 0.0, 0.6, ("bus_error", "gap no_sync"), 0.7, shares=False),
    ]
    return cells


_LATE = {"joint_1": ("estimation angle_jumped",), "load_cell": ("rows refused: residual",)}
_TOLD = {  # of the devices on serial lines, by kind of fault
    "imu_base": {
        "off": ("silent", "gap packets_lost"),
        "reset": ("gap packets_lost",),
        "silent": ("silent", "gap packets_lost"),
        "intermittent": ("gap packets_lost",),
        "garbage": ("bad_frame", "gap packets_lost"),
        "stuck": ("stuck",),
        "saturated": ("rows refused: saturated",),
        "byte_loss": ("bad_frame", "gap packets_lost"),
        "byte_garble": ("bad_frame", "gap packets_lost"),
        "unplug": ("bus_error", "gap packets_lost"),
    },
    "joint_1": {
        "off": ("silent", "gap silent"),
        "reset": ("device_reset", "gap device_reset"),
        "silent": ("silent", "gap silent"),
        "intermittent": ("gap lines_lost",),
        "garbage": ("bad_frame", "gap silent"),
        "stuck": ("estimation stuck", "rows refused: stuck"),
        "delayed": ("rows refused: residual",),
        "slow": ("clock joint_1 rejects pulses",),
        "pulse_spurious": ("clock joint_1 rejects pulses",),
        "byte_loss": ("bad_frame", "gap lines_lost"),
        "byte_garble": ("bad_frame", "gap lines_lost"),
        "unplug": ("bus_error", "gap port_lost"),
    },
    "load_cell": {
        "off": ("no_answer", "gap no_answer"),
        "reset": ("no_answer", "gap no_answer"),
        "silent": ("no_answer", "gap no_answer"),
        "intermittent": ("gap no_answer",),
        "garbage": ("gap bad_frame", "bad_frame"),
        "stuck": ("estimation stuck", "rows refused: stuck"),
        "delayed": ("rows refused: residual",),
        "saturated": ("rows refused: saturated",),
        "byte_loss": ("gap no_answer",),
        "byte_garble": ("bad_frame", "gap bad_frame"),
        "unplug": ("bus_error", "gap port_lost"),
    },
    "arm_phase": {
        "off": ("node_reset",),
        "reset": ("node_reset",),
        "silent": ("gap frames_lost",),
        "intermittent": ("gap frames_lost",),
        "garbage": ("bad_frame", "gap frames_lost"),
        "slow": ("clock arm_phase rejects pulses",),
        "pulse_spurious": ("clock arm_phase rejects pulses",),
        "byte_loss": ("bad_frame", "gap frames_lost"),
        "byte_garble": ("bad_frame", "gap frames_lost"),
        "unplug": ("bus_error", "gap frames_lost"),
    },
}


def _serial() -> list[Cell]:
    imu, joint, load_cell, arm = "imu_base", "joint_1", "load_cell", "arm"
    cells = []
    for device in (imu, joint, load_cell, arm):
        cells += [
            Cell(device, "off", recovery_s=0.6),
            Cell(device, "reset", recovery_s=0.6),
            Cell(device, "silent", recovery_s=0.3),
            Cell(device, "intermittent", 0.1),
            Cell(device, "stuck", shares=False),
            Cell(device, "wrong", 0.3, shares=False),
            Cell(device, "delayed", 0.1, shares=False),
            Cell(device, "garbage", recovery_s=0.3),
            Cell(device, "slow", 0.02 if device == load_cell else 0.2, shares=False),
        ]
        if device != joint:
            cells.append(Cell(device, "saturated", 1.0, shares=False))
        else:
            cells.append(Cell(device, "slipped", 10.0, shares=False))
        if device != load_cell:
            cells += [Cell(device, "clock_jump", value) for value in (0.1, -0.1)]
        if device in (joint, arm):
            cells += [Cell(device, "pulse_drop"), Cell(device, "pulse_spurious", 0.07)]
    for port in ("imu_port", "joint_port", "cell_port", "arm_port"):
        cells += [
            Cell(port, "byte_loss", 0.02, recovery_s=0.1),
            # a QSB line has no checksum: a digit that turned into another passes, and a timestamp may seem to jump
            Cell(port, "byte_garble", 0.02, unnamed=5 if port == "joint_port" else 0),
            Cell(port, "unplug", recovery_s=0.3),
            Cell(port, "intermittent", 0.1),
        ]
    cells = [cell._replace(vehicle="rocksat_serial") for cell in cells]
    return [cell._replace(reported=_TOLD[cell.channels[0]].get(cell.kind, ())) for cell in cells]


def _mixed() -> list[Cell]:
    imu, joint, load_cell = "imu_base", "joint_1", "load_cell_2"
    unanswered = ("no_answer", "gap no_answer")
    cells = [
        Cell(imu, "off", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell(imu, "stuck", 0.0, 0.6, ("stuck",), shares=False),
        Cell(imu, "garbage", 0.0, 0.6, ("gap configuration_lost",), 1.1),
        Cell(imu, "clock_jump", -0.06, 0.6, ("gap missed",)),
        Cell(joint, "off", 0.0, 0.6, ("guarding_lost", "silent", "gap node_reset"), 0.4),
        Cell(joint, "reset", 0.0, 0.6, ("node_rebooted", "gap node_reset"), 0.4),
        Cell(joint, "silent", 0.0, 0.6, ("guarding_lost", "emcy_8140", "gap node_reset"), 0.4),
        Cell(joint, "intermittent", 0.1, 0.6, ("emcy_8140", "gap no_pdo"), 0.4),
        Cell(joint, "stuck", 0.0, 0.6, ("estimation stuck", "rows refused: stuck"), shares=False),
        Cell(joint, "wrong", 0.3, shares=False),
        Cell(joint, "delayed", 0.1, 0.6, _LATE[joint], shares=False),
        Cell(joint, "slipped", 10.0, 0.6, ("estimation angle_jumped",), shares=False),
        Cell(joint, "garbage", 0.0, 0.6, ("bad_heartbeat", "guarding_lost", "rows refused: saturated"), 0.4),
        Cell(joint, "slow", 0.02, 0.6, ("pdo_extra", "gap no_pdo")),
        Cell(joint, "saturated", 1.0, shares=False),
        Cell(load_cell, "off", 0.0, 0.6, unanswered, 0.4),
        Cell(load_cell, "reset", 0.0, 0.6, ("gap no_answer",), 0.4),
        Cell(load_cell, "silent", 0.0, 0.6, unanswered),
        Cell(load_cell, "intermittent", 0.1, 0.6, ("gap no_answer",)),
        Cell(load_cell, "stuck", 0.0, 0.6, ("estimation stuck", "rows refused: stuck"), shares=False),
        Cell(load_cell, "wrong", 0.3, shares=False),
        Cell(load_cell, "delayed", 0.1, shares=False),
        Cell(load_cell, "garbage", 0.0, 0.6, unanswered),
        Cell(load_cell, "slow", 0.02),
        Cell(load_cell, "saturated", 1.0, 0.6, ("rows refused: saturated",), shares=False),
        Cell("cell_port", "unplug", 0.0, 0.6, ("bus_error", "gap port_lost"), 0.3),
    ]
    return [cell._replace(vehicle="rocksat_mixed") for cell in cells]


CELLS = [*_rocksat(), *_serial(), *_mixed()]
