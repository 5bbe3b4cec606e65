"""The page for a team that wires, made of what the vehicle file's reader itself knows.

``python -m tests.onboard.device_page docs/devices.md`` writes it; ``test_device_page.py`` holds the two together.
"""

import inspect
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from drivers.canopen_pdo.cia402 import Cia402Config
from drivers.canopen_pdo.cia404 import Cia404Config
from drivers.canopen_pdo.cia406 import Cia406Config
from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.mapped_object import CanopenObjectConfig
from drivers.dsc_load_cell.message import DscLoadCellConfig
from drivers.marks import MARK
from drivers.modbus_load_cell.registers import ModbusLoadCellConfig
from drivers.mpu6050.registers import Mpu6050Config
from drivers.nimu.packet import NimuConfig
from drivers.node_frame.frame import NodeFrameConfig
from drivers.qsb.registers import QsbConfig
from drivers.records import CAN_SYNC, IMU, PULSE, SCALAR
from drivers.sync_pulse.device import SyncPulseConfig
from drivers.sync_pulse.generator import PulseGeneratorConfig
from onboard import config
from onboard.config.devices import CHANNELS

MIXED = Path(__file__).parents[1] / "flight" / "mixed.toml"
RECORDS: list[tuple[np.dtype[np.void], str]] = [
    (IMU, "IMU"),
    (SCALAR, "SCALAR"),
    (CAN_SYNC, "CAN_SYNC"),
    (PULSE, "PULSE"),
    (MARK, "MARK"),
]
DRIVERS: dict[str, tuple[type, ...]] = {
    "mpu6050": (Mpu6050Config,),
    "nimu": (NimuConfig,),
    "qsb": (QsbConfig,),
    "cia406": (Cia406Config, GuardConfig),
    "cia402": (Cia402Config, GuardConfig),
    "cia404": (Cia404Config, GuardConfig),
    "canopen_object": (CanopenObjectConfig, GuardConfig),
    "modbus_load_cell": (ModbusLoadCellConfig,),
    "dsc_load_cell": (DscLoadCellConfig,),
    "node_frame": (NodeFrameConfig,),
    "sync_pulse": (SyncPulseConfig,),
    "pulse_generator": (PulseGeneratorConfig,),
}
MEANING = {  # of keys that belong to no one driver
    "bus": "Name of its `[bus.NAME]`.",
    "frame": "Link, joint or frame of the URDF that it measures in.",
    "accel_noise_m_s2": "Standard deviation of one sample of specific force.",
    "gyro_noise_rad_s": "Standard deviation of one sample of angular rate.",
    "sample_rate_hz": "Nominal sample rate.",
    "gyro_delay_ms": "Delay of the gyro's own filter, removed from its times.",
    "accel_delay_ms": "Delay of the accelerometer's own filter.",
    "joint": "Joint of the URDF whose angle it measures; each moving joint by one device.",
    "zero_count": "What it reads at joint angle zero, counts.",
    "counts_per_revolution": "Counts in a turn of the joint, quadrature and gear included.",
    "qsb.counts_per_revolution": "Counts in a turn of the joint, gear included; negative: it counts the other way.",
    "noise_rad": "Standard deviation of one sample, quantisation included.",
    "gear_ratio": "Turns of the motor in one of the joint, where it is the motor's angle that is measured.",
    "eccentricity_rad": "Cyclic error once in a turn of the motor, rms, of the joint's angle.",
    "transmission_error_rad": "The same twice in a turn, as harmonic drives make it.",
    "node": "Node number.",
    "supervision": '"guarding": a node that makes no heartbeat is asked whether it lives.',
    "axis": "Axis of the force or moment, in `frame`.",
    "measures": '"moment": the force times `lever_m` is the moment about `axis` that the actuator exerts on what lies'
    " beyond `frame`; "
    '"force": the force along `axis`.',
    "lever_m": "Lever of the force, of a moment.",
    "lever_sigma_m": "Standard deviation of the lever.",
    "capacity_N": "A sample as large as this is saturated.",
    "scale_sigma": "Relative standard deviation of its calibration.",
    "noise_N": "Standard deviation of one sample.",
    "delay_ms": "Delay of its own filter, removed from its times.",
    "delay_sigma_ms": "Standard deviation of that delay.",
    "gravity_m_s2": "What its kilogram weighs, where it tells kilograms.",
    "period_ms": "Nominal period.",
    "sync_period_ms": "SYNC period: pulse intervals are whole numbers of it.",
    "sync_bus": "CAN bus that SYNC is sent on, through a second opening of it; none where not given.",
    "tick_hz": "Nominal rate of the node's clock.",
    "rate_hz": "Nominal rate of its data frames.",
    "channel": "Its channels in the order of its descriptor: `[[device.NAME.channel]]`, below.",
    "noise_rad_s": "Standard deviation of one sample of the rate.",
    "noise_m_s2": "Standard deviation of one sample of specific force.",
    "name": "Name in the node's descriptor.",
    "role": "What the estimator takes it for.",
    "absolute": "After a reset of the node it still counts from `zero_count`; where not, its rows are refused then.",
    **{
        f"{kind}.poll_period_ms": "How often the port is read."
        for kind in ("nimu", "qsb", "modbus_load_cell", "dsc_load_cell", "node_frame")
    },
    **{
        f"{kind}.sample_period_ms": "Time between two questions; shorter than the link allows: back to back."
        for kind in ("modbus_load_cell", "dsc_load_cell")
    },
    "cia402.velocity": "Record 606Ch too, as `NAME_velocity`.",
    "cia402.torque": "Record 6077h too, as `NAME_torque`.",
    "cia402.velocity_scale_rad_s": "Unit of velocity of the drive, of the joint; counts a second where not given.",
    "cia402.rated_torque_N_m": "Rated torque of the motor; read from the drive (6076h) where not given.",
    "modbus_load_cell.scale": "`unit` per count; where not given, the transmitter's own division and unit.",
    "canopen_object.counter_subindex": "Of an object of the same index in the same TPDO that counts the changes.",
    "qsb.sync_edge": "Edge of the sync line that latches its count.",
    "node_frame.frame": "Link, joint or frame of the URDF that its gyro and accel channels measure in.",
    "canopen_sync.delay_ms": "Time of a SYNC frame on the wire: nodes sample at its end.",
    "GyroChannel.axis": "Axis of `frame` of the device.",
    "AccelChannel.axis": "Axis of `frame` of the device.",
    "nimu.latency_ms": "From sample to first bit of its packet, as measured; half a sample period where not given.",
    "nimu.latency_sigma_ms": "How well that is known.",
    "recorded_angle.zero_count": "Raw value at angle zero.",
    "recorded_rate.noise_rad_s": "Standard deviation of one sample of the rate.",
}
ROLE = {
    "mpu6050": "IMU",
    "nimu": "IMU",
    "recorded_imu": "IMU",
    "cia406": "joint angle",
    "cia402": "joint angle",
    "qsb": "joint angle",
    "recorded_angle": "joint angle",
    "recorded_rate": "joint rate",
    "recorded_load_cell": "load cell",
    "recorded_value": "none, or the phases",
    "cia404": "load cell",
    "modbus_load_cell": "load cell",
    "dsc_load_cell": "load cell",
    "node_frame": "by channel",
    "canopen_object": "none, or the phases",
    "canopen_sync": "clock of its bus",
    "sync_pulse": "clock of all",
    "pps": "clock of all, where there is no `sync_pulse`",
    "pulse_generator": "none",
}
CLOCK = {
    "mpu6050": "The sample number, fitted to the sync pulses that FSYNC marks in its samples. Wire the sync line to"
    " FSYNC.",
    "nimu": "Its packet timer, fitted to arrival: it has no sync input. Its times are late by what the line is.",
    "qsb": "The adapter's timestamp, fitted to the sync edges that it latches its count on. Wire the sync line to its"
    " digital I/O 0. It holds no zero over a loss of power, and counts modulo 500 until it is set up: give its"
    " `zero_count` after that, joint at zero. After a reset in flight its rows are refused.",
    "cia406": "The number of the SYNC that it answers.",
    "cia402": "The number of the SYNC that it answers.",
    "cia404": "The number of the SYNC that it answers.",
    "modbus_load_cell": "The middle between question and answer, by the host's clock; half their distance is its"
    " uncertainty.",
    "dsc_load_cell": "As a `modbus_load_cell`.",
    "node_frame": "The node's own, fitted to the sync edges that it stamps.",
    "canopen_object": "The number of the SYNC that it answers where `synchronous`, else none: a phase counts from its"
    " arrival.",
    "canopen_sync": "SYNC numbers, fitted to the sync pulses by counter and code.",
    "sync_pulse": "It is the kernel's, CLOCK_MONOTONIC; all others are fitted to it.",
    "pps": "It is the kernel's; edges are told apart by arrival, for they carry no code. SYNC needs the code.",
    "pulse_generator": "None: what it records is when it meant to send. Read the line back by a `sync_pulse`.",
    "recorded_imu": "The recording's own times.",
    "recorded_angle": "The recording's own times.",
    "recorded_rate": "The recording's own times.",
    "recorded_load_cell": "The recording's own times.",
    "recorded_value": "The recording's own times.",
}
SHARED: list[tuple[type[BaseModel], str, str]] = [  # keys of several kinds, their heading, a kind that has them
    (config.LoadCellKeys, "A load cell", "cia404"),
    (config.CanopenNode, "A CANopen node", "cia404"),
]
HEAD = """# Devices

What a vehicle file can carry: each kind with an example, its channels, its clock and its keys. Written by
`python -m tests.onboard.device_page docs/devices.md` from the classes that read the file; the examples are those of
`tests/flight/mixed.toml`, which flies against simulated devices in the tests.

A device stands on a bus, `[bus.NAME]` with a `url`:

| URL | carries |
|---|---|
| `i2c:///dev/i2c-1` | several I2C devices, by address |
| `can+socketcan://can0?bitrate=500000` | several CANopen nodes, and exactly one `canopen_sync` |
| `can+slcan:///dev/ttyACM0?bitrate=500000` | the same, by an ASCII adapter |
| `can+python:///pcan/PCAN_USBBUS1?bitrate=500000` | the same, by any interface that python-can knows |
| `serial:///dev/ttyUSB0?baud=115200` (`parity=E`, `stop_bits=2`) | one serial device; speed and format stand here |
| `gpio:///dev/gpiochip0?line=17`, `pps:///dev/pps0` | one pulse input |
| `gpio-out:///dev/gpiochip0?line=27` | one pulse output |
| `i2c+unix`, `gpio+unix`, `gpio-out+unix` with a socket's path | the same of a simulator |

`heft preflight VEHICLE` opens every bus, runs every device for a few seconds and says which of them is not what the
file says (exit code 0: ready, 4: not). `heft fly` goes on without a bus that cannot be opened, and says so in the log.

Units stand in the keys. **Bold** keys have no default. A file that does not fit is refused with its line and a remedy.
Records (IMU, SCALAR, ...) are those of `drivers/records.py` and `drivers/marks.py`. A vehicle needs an IMU, unless
its base is fixed (the first in the file measures the base, further ones are recorded), and, for each moving joint of
the URDF, one device that measures it. `[estimation.phases] channel` names any SCALAR channel.
"""


def page() -> str:
    """The document."""
    shared = "".join(f"\n## {heading}\n{_prose(model)}\n\n{_keys(model, kind)}" for model, heading, kind in SHARED)
    return HEAD + shared + "".join(_section(kind, model) for kind, model in config.DEVICES.items())


def _section(kind: str, model: type[config.DeviceSection]) -> str:
    name, block = example(kind)
    channels = model.model_validate(_device(name)).channels(name) if block else {name: model.records}
    listed = ", ".join(f"`{channel}` {_record(records)}" for channel, records in channels.items())
    parts = [f"\n## {kind}", _prose(model)]
    if block:
        parts.append(f"```toml\n{block}```")
    parts += [f"- **role**: {ROLE[kind]}", f"- **channels**: {listed}", f"- **clock**: {CLOCK[kind]}"]
    text = "\n".join([parts[0], parts[1], "", *parts[2:], ""])
    text += "\n" + _keys(model, kind)
    if kind == "node_frame":
        for role, channel in CHANNELS.items():
            text += f'\n### channel with role = "{role}"\n{_prose(channel)}\n\n' + _keys(channel, kind)
    return text


def example(kind: str) -> tuple[str, str]:
    """Name and text of the device of a kind in the vehicle that the tests fly; empty for what comes of no bus."""
    for part in re.split(r"(?m)^(?=\[(?!\[))", MIXED.read_text(encoding="utf-8")):
        if part.startswith("[device.") and f'kind = "{kind}"\n' in part:
            return part[len("[device.") : part.index("]")], part.strip() + "\n"
    return "NAME", ""


def _device(name: str) -> dict[str, Any]:
    table: dict[str, Any] = tomllib.loads(MIXED.read_text(encoding="utf-8"))["device"][name]
    return table


def _record(dtype: np.dtype[np.void]) -> str:
    return next(name for known, name in RECORDS if known == dtype)


def _prose(model: type[BaseModel]) -> str:
    """The class's docstring in Markdown."""
    return (inspect.getdoc(model) or "").replace("``", "`")


def _keys(model: type[BaseModel], kind: str) -> str:
    schema = model.model_json_schema()
    lines = ["| key | | default | |", "|---|---|---|---|"]
    elsewhere = [(group, heading) for group, heading, _ in SHARED if issubclass(model, group) and model is not group]
    for key, field in model.model_fields.items():
        if key == "kind" or any(key in group.model_fields for group, _ in elsewhere):
            continue
        name = f"**`{key}`**" if field.is_required() else f"`{key}`"
        default = "" if field.is_required() or field.default is None else f"`{_toml(field.default)}`"
        lines.append(f"| {name} | {_type(schema['properties'][key])} | {default} | {meaning(model, kind, key)} |")
    links = [f"[{heading}](#{heading.lower().replace(' ', '-')})" for _, heading in elsewhere]
    return "\n".join(lines) + "\n" + (f"\nand those of {' and '.join(links)}.\n" if links else "")


def meaning(model: type[BaseModel], kind: str, key: str) -> str:
    """What a key is: by its place, by its driver, by its name.

    Raises:
        KeyError: Nobody says.
    """
    if model in CHANNELS.values():
        return MEANING.get(f"{model.__name__}.{key}") or MEANING[key]
    of_driver = {k: v for driver in reversed(DRIVERS.get(kind, ())) for k, v in _attributes(driver).items()}
    return MEANING.get(f"{kind}.{key}") or of_driver.get(key) or MEANING[key]


def _attributes(driver: type) -> dict[str, str]:
    """What a driver's configuration says of its attributes, by name."""
    _, _, text = (inspect.getdoc(driver) or "").partition("Attributes:\n")
    text, *_ = re.split(r"\n(?=\S)", text)
    found = re.findall(r"(?m)^    (\w+): (.*(?:\n        .*)*)", text)
    return {name: re.sub(r"\s+", " ", said).replace("``", "`").replace("|", "\\|") for name, said in found}


def _toml(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case tuple():
            return f"[{', '.join(map(_toml, value))}]"
        case float():
            return f"{value:g}"
        case _:
            return str(value)


def _type(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return _type(next(one for one in schema["anyOf"] if one.get("type") != "null"))
    if "enum" in schema or "const" in schema:
        return ", ".join(f"`{_toml(value)}`" for value in schema.get("enum", [schema.get("const")]))
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return f"{len(schema['prefixItems'])} numbers"
        return "tables" if "oneOf" in schema["items"] else f"list of {_type(schema['items'])}"
    name = {"integer": "integer", "number": "number", "string": "text", "boolean": "true, false"}[schema["type"]]
    low, high = schema.get("minimum"), schema.get("maximum")
    if low is not None and high is not None:
        return f"{name}, {low} to {high}"
    bounds = {"exclusiveMinimum": "above", "minimum": "at least"}
    return name + "".join(f" {word} {schema[bound]:g}" for bound, word in bounds.items() if bound in schema)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
