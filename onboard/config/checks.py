"""Names in a vehicle file that must point at something in the same file, or beside it."""

from onboard.config.devices import (
    BUS_OF,
    CanopenSyncDevice,
    Cia404Device,
    Cia406Device,
    Mpu6050Device,
    RecordedDevice,
    RecordedImu,
)
from onboard.config.errors import ConfigError, line_of
from onboard.config.vehicle import Vehicle


def check_names(vehicle: Vehicle) -> None:
    """Raise ConfigError for the first name that points nowhere."""
    file, path, text = vehicle.file, vehicle.path, vehicle.text

    def fail(where: list[str], why: str) -> None:
        raise ConfigError(f"{path}:{line_of(text, where)}: {why}")

    for name, device in file.device.items():
        if not isinstance(device, RecordedDevice) and device.bus not in file.bus:
            fail(["device", name, "bus"], f"no bus {device.bus!r}; there are: {', '.join(file.bus)}")
        if isinstance(device, Cia406Device | Cia404Device):
            syncs = [d for d in file.device.values() if isinstance(d, CanopenSyncDevice) and d.bus == device.bus]
            if len(syncs) != 1:
                fail(["device", name], f"bus {device.bus!r} has {len(syncs)} canopen_sync devices; it needs one")
    if not any(isinstance(device, Mpu6050Device | RecordedImu) for device in file.device.values()):
        fail(["device"], "no device is an IMU; the base's motion has to be measured: add one")
    for bus in file.bus:
        kinds = {BUS_OF[type(device)] for device in vehicle.devices_on(bus).values()}
        if len(kinds) > 1:
            fail(["bus", bus], f"bus {bus!r} has devices of {' and '.join(sorted(kinds))}; give each its own bus")
    phases = file.estimation.phases
    if phases and phases.channel not in file.device:
        fail(["estimation", "phases", "channel"], f"no device {phases.channel!r}; there are: {', '.join(file.device)}")
    if file.free_body and file.vehicle.base != "free":
        fail(["free_body"], f'the base is {file.vehicle.base!r}; a free body needs base = "free"')
    for index, load in enumerate(file.free_body.load if file.free_body else ()):
        if load.role == "proof" and load.truth_kg_m2 is None:
            fail(["free_body", "load", str(index), "role"], "a proof body must be known; give truth_kg_m2")
    if not vehicle.urdf_path.is_file():
        fail(["vehicle", "urdf"], f"no file {vehicle.urdf_path}; put the URDF beside the vehicle file")
