"""vehicle.toml to frozen objects. Units stand in the keys; a key nobody knows is refused with its line and a remedy."""

import difflib
import re
import tomllib
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Sigma3 = tuple[NotNegative, NotNegative, NotNegative]
Sigma6 = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]


class ConfigError(ValueError):
    """The vehicle file cannot be used; the message names file, line and remedy."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class VehicleSection(_Section):
    """What flies. ``base``: what is known of the base's motion and of the wrench on it."""

    name: str
    urdf: str
    base: Literal["free", "prescribed", "fixed"]
    base_link: str
    payload_link: str | None = None


class Bus(_Section):
    """A bus by URL; ``drivers.transports`` says which there are."""

    url: str


class _Device(_Section):
    bus: str


class Mpu6050Device(_Device):
    """MPU-6050 family IMU over I2C, drained from its FIFO."""

    kind: Literal["mpu6050"]
    address: Annotated[int, Field(ge=0x68, le=0x69)] = 0x68
    frame: str
    sample_rate_hz: Annotated[int, Field(ge=4, le=1000)] = 1000
    accel_range_g: Literal[2, 4, 8, 16] = 4
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = 250
    filter_code: Annotated[int, Field(ge=0, le=6)] = 2
    poll_period_ms: Positive = 10
    accel_noise_m_s2: Positive
    gyro_noise_rad_s: Positive


class CanopenSyncDevice(_Device):
    """The SYNC messages on a CAN bus; ``delay_ms`` is the time a SYNC frame takes on the wire."""

    kind: Literal["canopen_sync"]
    period_ms: Positive
    delay_ms: NotNegative = 0.0


class Cia406Device(_Device):
    """Encoder node (CiA 406), sampled on SYNC."""

    kind: Literal["cia406"]
    node: Annotated[int, Field(ge=1, le=127)]
    joint: str
    counts_per_revolution: Annotated[int, Field(gt=0)]
    zero_count: int = 0
    noise_rad: Positive


class Cia404Device(_Device):
    """Load cell node (CiA 404), sampled on SYNC.

    ``measures = "moment"``: the cell's force times ``lever_m`` is the moment about ``axis`` of ``frame`` that the
    actuator exerts on everything beyond that frame. ``measures = "force"``: its force along ``axis``.
    """

    kind: Literal["cia404"]
    node: Annotated[int, Field(ge=1, le=127)]
    frame: str
    axis: Vector3
    measures: Literal["moment", "force"]
    lever_m: Positive = 1.0
    lever_sigma_m: NotNegative = 0.0
    capacity_N: Positive  # noqa: N815  (the newton's own letter)
    scale_sigma: NotNegative = 0.0
    noise_N: Positive  # noqa: N815
    delay_ms: NotNegative = 0.0
    delay_sigma_ms: NotNegative = 0.0


class CanopenObjectDevice(_Device):
    """Any object a CANopen node maps into a TPDO that it sends on change."""

    kind: Literal["canopen_object"]
    node: Annotated[int, Field(ge=1, le=127)]
    tpdo: Annotated[int, Field(ge=1, le=4)]
    byte_offset: Annotated[int, Field(ge=0, le=7)] = 0
    format: Literal["u8", "i8", "u16", "i16", "u32", "i32"]
    unit: str = "1"
    scale: float = 1.0
    index: Annotated[int, Field(ge=0, le=0xFFFF)]
    subindex: Annotated[int, Field(ge=0, le=0xFF)]


class RecordedImu(_Section):
    """An IMU of a recording from elsewhere (``heft import``): its host stamps are its sample times."""

    kind: Literal["recorded_imu"]
    frame: str
    period_ms: Positive
    accel_noise_m_s2: Positive
    gyro_noise_rad_s: Positive


class RecordedRate(_Section):
    """A joint rate of a recording from elsewhere; the joint turns a body of revolution, its angle is of no account."""

    kind: Literal["recorded_rate"]
    joint: str
    period_ms: Positive
    noise_rad_s: Positive


class SyncPulseDevice(_Device):
    """The sync pulse line; intervals between pulses are whole numbers of ``sync_period_ms``."""

    kind: Literal["sync_pulse"]
    sync_period_ms: Positive


BusDevice = Mpu6050Device | CanopenSyncDevice | Cia406Device | Cia404Device | CanopenObjectDevice | SyncPulseDevice
RecordedDevice = RecordedImu | RecordedRate
_BUS_OF: dict[type[BaseModel], str] = {
    Mpu6050Device: "I2C",
    CanopenSyncDevice: "CAN",
    Cia406Device: "CAN",
    Cia404Device: "CAN",
    CanopenObjectDevice: "CAN",
    SyncPulseDevice: "a pulse line",
}
_DEVICES: tuple[type[BaseModel], ...] = (*get_args(BusDevice), *get_args(RecordedDevice))
Device = Annotated[BusDevice | RecordedDevice, Field(discriminator="kind")]


class Phases(_Section):
    """Which phases of the mission are for identification, as told by a channel."""

    channel: str
    identify: list[int]
    payload_gone: int | None = None
    end: int | None = None
    settle_ms: NotNegative = 300


class Gates(_Section):
    """When a row may not be used."""

    joint_limits_deg: tuple[float, float] | None = None
    joint_rate_min_rad_s: Positive | None = None
    specific_force_m_s2: Positive | None = None
    specific_force_window_ms: Positive = 500
    residual_sigma: Positive = 6.0


class Zero(_Section):
    """Where the accelerometer is zeroed: coasting at rest in ``phases``, ``ticks`` row periods of it at least."""

    phases: list[int]
    ticks: Annotated[int, Field(ge=1)] = 100


class Prior(_Section):
    """What is known beforehand: relative sigma by link, absolute sigma of the other columns, SI units."""

    relative: dict[str, Positive] = {}
    absolute: dict[str, Positive] = {}


class Masses(_Section):
    """Masses to report from inertia about ``joint``, under the URDF's radii of gyration."""

    joint: str
    arm_link: str


class Estimation(_Section):
    """The estimator's ticks, its smoothing kernel, its rows, its gates.

    ``block_ms``: rows further apart than this are taken to err independently; five times ``smoothing_ms`` if not given.
    ``base_rows`` are rows of a wrench that is known to be zero, good to the two sigmas after it.
    ``zero_force_sigma_m_s2`` is what zeroing leaves of a constant error of the specific force; estimated where given.
    ``nuisance`` names base parameters that take up what is not theirs: estimated, and never reported as supported.
    """

    step_ms: Positive = 50
    row_rate_hz: Positive = 100
    lag_ms: Positive = 200
    smoothing_ms: Positive = 100
    block_ms: Positive | None = None
    base_rows: list[Literal["force", "moment"]] = []
    base_force_sigma_N: Positive = 0.1  # noqa: N815
    base_moment_sigma_N_m: Positive = 5e-4  # noqa: N815
    zero_force_sigma_m_s2: Positive | None = None
    phases: Phases | None = None
    zero: Zero | None = None
    gates: Gates = Gates()
    prior: Prior = Prior()
    masses: Masses | None = None
    nuisance: list[str] = []


class Carrier(_Section):
    """The device itself, without a load, in base axes, with the sigmas of its calibration.

    Inertia is about its own centre of mass, in the order XX, XY, YY, XZ, YZ, ZZ.
    """

    mass_kg: Positive
    centre_of_mass_m: Vector3
    centre_of_mass_sigma_m: Sigma3
    inertia_kg_m2: Vector6
    inertia_sigma_kg_m2: Sigma6


class Load(_Section):
    """What a free body carries in some of its logs, weighed.

    ``role``: "carrier" is the device alone (``mass_kg`` is the carrier's), "proof" a body known beforehand, its
    ``truth_kg_m2`` about the base axes x, y, z through its own centre of mass; these two calibrate. ``truth_kg_m2``
    of a "load" are principal moments in any order. ``bars_percent``: the mean and the worst error that are accepted.
    """

    name: str
    logs: str
    role: Literal["load", "carrier", "proof"] = "load"
    mass_kg: Positive
    truth_kg_m2: tuple[Positive, Positive, Positive] | None = None
    truth_source: str | None = None
    bars_percent: tuple[Positive, Positive] | None = None


class FreeBody(_Section):
    """A free vehicle with balanced rotors, to be known as one rigid body: its own part in it, and what it may carry.

    ``rotor_sigma``: relative, of the rotors' inertia in the URDF; all inertias scale with it.
    """

    rotor_sigma: NotNegative = 0.0
    carrier: Carrier | None = None
    load: list[Load] = []


class Recording(_Section):
    """Where flights go."""

    directory: str = "flights"
    sync_period_ms: Positive = 200


class VehicleFile(_Section):
    """A whole vehicle.toml."""

    vehicle: VehicleSection
    bus: dict[str, Bus] = {}
    device: dict[str, Device]
    estimation: Estimation = Estimation()
    free_body: FreeBody | None = None
    recording: Recording = Recording()


class Vehicle(BaseModel):
    """A vehicle file that has been read: its text, its directory, its objects."""

    model_config = ConfigDict(frozen=True)

    path: Path
    text: str
    file: VehicleFile

    @cached_property
    def urdf_path(self) -> Path:
        """The URDF beside the vehicle file."""
        return self.path.parent / self.file.vehicle.urdf

    def devices_on(self, bus: str) -> dict[str, BusDevice]:
        """Devices by channel name on one bus, in the order of the file."""
        return {
            name: device
            for name, device in self.file.device.items()
            if not isinstance(device, RecordedDevice) and device.bus == bus
        }

    def with_urls(self, urls: dict[str, str]) -> "Vehicle":
        """The same vehicle with other bus URLs."""
        buses = {name: Bus(url=urls.get(name, bus.url)) for name, bus in self.file.bus.items()}
        return self.model_copy(update={"file": self.file.model_copy(update={"bus": buses})})


def packaged(name: str) -> Path:
    """Path of a vehicle that comes with heft."""
    return Path(__file__).parent / "vehicles" / name / "vehicle.toml"


def load(path: Path) -> Vehicle:
    """Read and check a vehicle file.

    Raises:
        ConfigError: no such file, no TOML, an unknown key, a wrong value, or a name that points nowhere.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give the path of a vehicle.toml") from error
    return parse(text, path)


def parse(text: str, path: Path) -> Vehicle:
    """As :func:`load`, for a text that is at hand already (from a log, say)."""
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error
    try:
        file = VehicleFile.model_validate(tree)
    except ValidationError as error:
        raise ConfigError("\n".join(_explain(path, text, tree, dict(one)) for one in error.errors())) from error
    vehicle = Vehicle(path=path, text=text, file=file)
    _check_names(vehicle)
    return vehicle


def _explain(path: Path, text: str, tree: dict[str, Any], error: dict[str, Any]) -> str:
    where = [str(part) for part in error["loc"]]
    # a discriminated union puts the kind into the location
    if where[:1] == ["device"] and len(where) > 2:
        del where[2]
    line = _line_of(text, where)
    name = ".".join(where)
    if error["type"] == "extra_forbidden":
        known = _known_keys(where[:-1], tree)
        near = difflib.get_close_matches(where[-1], known, 1, 0.5)
        remedy = f"did you mean {near[0]!r}? Units stand in the key" if near else f"known here: {', '.join(known)}"
        return f"{path}:{line}: unknown key {name!r}; {remedy}"
    if error["type"] == "missing":
        return f"{path}:{line}: {name!r} is missing; add it"
    return f"{path}:{line}: {name!r}: {error['msg']} (found {error['input']!r})"


def _known_keys(where: list[str], tree: dict[str, Any]) -> list[str]:
    if not where:
        return list(VehicleFile.model_fields)
    if where[0] == "device" and len(where) == 2:
        kind = tree["device"][where[1]].get("kind")
        return next((list(m.model_fields) for m in _DEVICES if kind in get_args(m.model_fields["kind"].annotation)), [])
    models: dict[str, type[BaseModel]] = {
        "vehicle": VehicleSection,
        "bus": Bus,
        "estimation": Estimation,
        "phases": Phases,
        "gates": Gates,
        "zero": Zero,
        "prior": Prior,
        "masses": Masses,
        "free_body": FreeBody,
        "carrier": Carrier,
        "load": Load,
        "recording": Recording,
    }
    tables = [part for part in where if not part.isdigit()]  # an array of tables counts them
    section = models.get(tables[-1]) or models.get(tables[0])
    return list(section.model_fields) if section else []


def _line_of(text: str, where: list[str]) -> int:
    """Line of the key at ``where``, else of the nearest table around it."""
    table: list[str] = []
    seen: dict[str, int] = {}
    best, depth = 1, 0
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[(\[?)\s*([^\]]+?)\s*\]", line):
            table = [part.strip().strip("\"'") for part in header[2].split(".")]
            if header[1]:
                seen[header[2]] = seen.get(header[2], -1) + 1
                table.append(str(seen[header[2]]))
            here = table
        elif key := re.match(r"\s*([A-Za-z0-9_\-\"'.]+)\s*=", line):
            here = [*table, *(part.strip("\"'") for part in key[1].split("."))]
        else:
            continue
        if here == where[: len(here)] and len(here) > depth:
            best, depth = number, len(here)
    return best


def _check_names(vehicle: Vehicle) -> None:
    """Names that must point at something in the same file, or beside it."""
    file, path, text = vehicle.file, vehicle.path, vehicle.text

    def fail(where: list[str], why: str) -> None:
        raise ConfigError(f"{path}:{_line_of(text, where)}: {why}")

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
        kinds = {_BUS_OF[type(device)] for device in vehicle.devices_on(bus).values()}
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
