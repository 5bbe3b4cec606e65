"""The pages for a team that wires, made from the classes that read the vehicle file: a table of devices, a page a bus.

``python -m tests.onboard.device_page docs/devices.md`` writes them; ``test_device_page.py`` holds both together.
"""

import inspect
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from drivers.marks import MARK
from drivers.records import CAN_SYNC, IMU, POSE, PULSE, SCALAR
from onboard import config
from onboard.devices.base import BusDevice, DeviceSection, ImuDevice, JointDevice
from onboard.devices.buses import ComponentDevice, StreamedDevice
from onboard.devices.can.canopen import CanopenNodeDevice
from onboard.devices.can.canopen_object import MappedObjectDevice
from onboard.devices.driven import MotorDevice
from onboard.devices.registry import DEVICES
from onboard.devices.roles import LoadCellKeys
from onboard.devices.serial_line.node_channels import CHANNELS
from onboard.devices.ur_rtde import UrOutputs
from onboard.section import LARGEST

FLOWN = Path(__file__).parents[1] / "flight" / "mixed.toml", config.packaged("dymaflex_wheels")
RECORDS: list[tuple[np.dtype[np.void], str]] = [
    (IMU, "IMU"),
    (SCALAR, "SCALAR"),
    (POSE, "POSE"),
    (CAN_SYNC, "CAN_SYNC"),
    (PULSE, "PULSE"),
    (MARK, "MARK"),
]
MEANING = {  # of keys that belong to no one driver
    "accel_scale_sigma": "Relative standard deviation of the accelerometer's scale, carried by intervals of rows.",
    "accel_matrix": "Reading per m/s^2 along each axis, a row for each axis of the sensor.",
    "accel_bias_m_s2": "Reading at no specific force.",
    "gyro_matrix": "Reading per rad/s about each axis, a row for each axis of the sensor.",
    "gyro_bias_rad_s": "Reading at rest.",
    "calibrated": "Date, log and command of its calibration; `heft calibrate` writes it.",
    "gain": "Reading per unit; `heft calibrate` writes it.",
    "offset_N": "Reading without load.",
    "misalignment_sigma_rad": "Standard deviation of the axes of gyro and accelerometer, carried by intervals of rows.",
    "gyro_scale_sigma": "Relative standard deviation of the gyro's scale, carried by intervals of rows.",
    "bus": "Name of its `[bus.NAME]`.",
    "frame": "Link, joint or frame of the URDF that it measures in.",
    "accel_noise_m_s2": "1 sigma of a sample of specific force, as white: density x sqrt(rate / 2).",
    "gyro_noise_rad_s": "1 sigma of a sample of angular rate, as white: density x sqrt(rate / 2).",
    "sample_rate_hz": "Nominal sample rate.",
    "sync_input": "Whether the sync line reaches its FSYNC pin; where it does not, its times are by arrival stamps.",
    "gyro_delay_ms": "Delay of the gyro's filter, removed from its times.",
    "accel_delay_ms": "Delay of the accelerometer's filter.",
    "joint": "Joint of the URDF whose angle it measures; no two devices measure the same.",
    "zero_count": "Reading at joint angle zero, counts.",
    "counts_per_revolution": "Counts in a turn of the joint, quadrature and gear included.",
    "noise_rad": "1 sigma of a sample, quantisation included.",
    "gear_ratio": "Turns of the motor per turn of the joint, where the motor's angle is measured.",
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
    "zero_sigma_rad": "Standard deviation of the angle at its zero.",
    "noise_N": "1 sigma of a sample; that the filter makes neighbours alike is known by `delay_ms`.",
    "delay_ms": "Delay of its filter, removed from its times.",
    "delay_sigma_ms": "Standard deviation of that delay.",
    "gravity_m_s2": "Newton per kilogram of its readings, if its unit is kg.",
    "period_ms": "Nominal period.",
    "sync_period_ms": "SYNC period: pulse intervals are whole numbers of it.",
    "sync_bus": "CAN bus on which SYNC is sent, through a second opening of it; default: none.",
    "tick_hz": "Nominal rate of the node's clock.",
    "rate_hz": "Nominal rate of its data frames.",
    "channel": "Its channels in the order of its descriptor: `[[device.NAME.channel]]`, below.",
    "noise_rad_s": "1 sigma of a sample of the rate.",
    "noise_m_s2": "1 sigma of a sample of specific force.",
    "name": "Name in the node's descriptor.",
    "role": "Its role in the estimator.",
    "absolute": "It keeps `zero_count` over a reset of the node; otherwise its rows are refused after a reset.",
}
SHARED: list[tuple[type[BaseModel], str, str]] = [  # keys of several kinds, their heading, a kind that has them
    (LoadCellKeys, "A load cell", "cia404"),
    (ImuDevice, "An IMU", "recorded_imu"),
    (JointDevice, "A joint's encoder", "qsb"),
    (MotorDevice, "A joint's motor", "cia402"),
    (MappedObjectDevice, "A mapped object", "canopen_object"),
    (CanopenNodeDevice, "A CANopen node", "cia404"),
    (StreamedDevice, "A part of an instrument that streams", "net_ft"),
    (ComponentDevice, "A component of a six-axis sensor", "net_ft"),
    (UrOutputs, "A part of a UR controller", "ur_output"),
]
HEAD = """# Devices

The devices of a vehicle file; each kind links to its example, channels, clock and keys. {written}

{table}

A device is on a bus, `[bus.NAME]` with a `url`:

| URL | carries |
|---|---|
| `i2c:///dev/i2c-1` | several I2C devices, by address |
| `spi:///dev/spidev0.0` (`speed=1000000`, `second=/dev/spidev0.1`) | one device, by its one or two select lines |
| `can+socketcan://can0?bitrate=500000` | several CANopen nodes, and exactly one `canopen_sync` |
| `can+slcan:///dev/ttyACM0?bitrate=500000` | the same, by an ASCII adapter |
| `can+python:///pcan/PCAN_USBBUS1?bitrate=500000` | the same, by any interface that python-can knows |
| `serial:///dev/ttyUSB0?baud=115200` (`parity=E`, `stop_bits=2`) | a device, servos, or a wrist sensor; its speed |
| `tcp://192.168.56.101:30004` | joints, wrench and other outputs of one UR controller |
| `udp://192.168.1.1:49152` | components of one wrist sensor |
| `gpio:///dev/gpiochip0?line=17`, `pps:///dev/pps0` | one pulse input |
| `gpio-out:///dev/gpiochip0?line=27` | one pulse output |
| `gpio-pair:///dev/gpiochip0?data=5&clock=6` | one device of a clock line and a data line |
| `i2c+unix`, `spi+unix`, `gpio+unix`, `gpio-out+unix`, `gpio-pair+unix` and a socket's path | of a simulator |

`heft preflight VEHICLE` opens every bus, runs every device for a few seconds and reports those that differ from
the file (exit code 0: ready, 4: not). `heft fly` continues without a bus that cannot be opened, with an event.

Units are in the keys. **Bold** keys have no default. A file that does not fit is refused with its line and a remedy.
Records (IMU, SCALAR, ...) are those of `drivers/records.py` and `drivers/marks.py`. A vehicle needs an IMU, unless
its base is fixed (the first in the file measures the base, further ones are recorded), and, for each moving joint of
the URDF, one device that measures it. `[estimation.phases] channel` names any SCALAR channel.

The examples are those of `tests/flight/mixed.toml` and, of wheel and thruster, of `dymaflex_wheels`; both fly against
simulated devices in tests.
"""
WRITTEN = "Written by `python -m tests.onboard.device_page docs/devices.md` from the classes that read the file."
TITLES = {
    "i2c": "Devices on I2C",
    "spi": "Devices on SPI",
    "can": "Devices on CAN",
    "gpio": "Devices on two GPIO lines",
    "serial": "Devices on serial lines",
    "tcp": "Devices on a network",
    "pulse": "Pulse inputs and outputs",
    "recorded": "Recorded data as devices",
}
ROOMS = {
    "i2c": "i2c",
    "can": "can",
    "serial_line": "serial",
    "spi": "spi",
    "hx711": "gpio",
    "ur_rtde": "tcp",
    "net_ft": "tcp",
    "recorded": "recorded",
}


def bus(model: type[BaseModel]) -> str:
    """Of the :data:`TITLES`, by the module that the class stands in; empty for what several have."""
    room = model.__module__.split(".")[2]
    return "" if room in ("base", "bridge", "buses", "driven", "roles") else ROOMS.get(room, "pulse")


def pages() -> dict[str, str]:
    """The documents by name."""
    rows, found = ["| kind | bus | for the estimator | device |", "|---|---|---|---|"], dict[str, str]()
    for of, title in TITLES.items():
        kinds = {kind: model for kind, model in DEVICES.items() if bus(model) == of}
        if of != "recorded":
            rows += [
                f"| [{kind}](devices_{of}.md#{kind}) | {of} | {model.about_role} | {_summary(model)} |"
                for kind, model in kinds.items()
            ]
        head = f"# {title}\n\nBuses, units and a table of all kinds: [devices](devices.md). {WRITTEN}\n"
        sections = "".join(_section(kind, model) for kind, model in kinds.items())
        found[f"devices_{of}.md"] = head + _shared(of) + sections
    rows.append("| [recorded_*](devices_recorded.md) | none | as of the device | Data that `heft import` has read |")
    return {"devices.md": HEAD.format(table="\n".join(rows), written=WRITTEN) + _shared(""), **found}


def _summary(model: type[BaseModel]) -> str:
    """First clause of the class's docstring."""
    return re.sub(r"\s+", " ", re.split(r"[.;:](?:\s|$)", _prose(model))[0])


def _shared(of: str) -> str:
    """Keys of several kinds of a bus; of several buses where ``of`` is empty."""
    own = [one for one in SHARED if bus(one[0]) == of]
    return "".join(f"\n## {heading}\n{_prose(model)}\n\n{_keys(model, kind)}" for model, heading, kind in own)


def _section(kind: str, model: type[DeviceSection]) -> str:
    name, block = example(kind)
    channels = model.model_validate(_device(name)).channels(name) if block else model.model_construct().channels(name)
    listed = ", ".join(f"`{channel}` {_record(records)}" for channel, records in channels.items())
    parts = [f"\n## {kind}", _prose(model)]
    if block:
        parts.append(f"```toml\n{block}```")
    parts += ["", f"- **role**: {model.about_role}", f"- **channels**: {listed}", f"- **clock**: {model.about_clock}"]
    text = "\n".join([parts[0], parts[1], "", *parts[2:], ""])
    text += "\n" + _keys(model, kind)
    if kind == "node_frame":
        for role, channel in CHANNELS.items():
            text += f'\n### channel with role = "{role}"\n{_prose(channel)}\n\n' + _keys(channel, kind)
    return text


def example(kind: str) -> tuple[str, str]:
    """Name and text of the device of a kind in a vehicle that the tests fly; empty for what comes of no bus."""
    text = "".join(file.read_text(encoding="utf-8") for file in FLOWN)
    for part in re.split(r"(?m)^(?=\[(?!\[))", text):
        if part.startswith("[device.") and f'kind = "{kind}"\n' in part:
            return part[len("[device.") : part.index("]")], part.strip() + "\n"
    return "NAME", ""


def flown_devices() -> dict[str, dict[str, Any]]:
    """The devices of the vehicles that the tests fly."""
    found: dict[str, dict[str, Any]] = {}
    for file in reversed(FLOWN):
        found |= tomllib.loads(file.read_text(encoding="utf-8"))["device"]
    return found


def _device(name: str) -> dict[str, Any]:
    return flown_devices()[name]


def _record(dtype: np.dtype[np.void]) -> str:
    return next(name for known, name in RECORDS if known == dtype)


def _prose(model: type[BaseModel]) -> str:
    """The class's docstring in Markdown."""
    return (inspect.getdoc(model) or "").replace("``", "`")


def _keys(model: type[BaseModel], kind: str) -> str:
    """The table of a kind's keys, less those that are the same in a table of several kinds."""
    groups = [(group, heading, of) for group, heading, of in SHARED if issubclass(model, group) and model is not group]
    shared = {line for group, _, of in groups for line in _all_keys(group, of)}
    lines = [line for line in _all_keys(model, kind) if line not in shared]
    links = [f"[{heading}]({_anchor(group, model, heading)})" for group, heading, _ in groups]
    table = ["| key | | default | |", "|---|---|---|---|", *lines, ""] if lines else []
    return "\n".join(
        [*table, *([f"{'and those' if lines else 'Keys: those'} of {' and '.join(links)}.", ""] if links else [])]
    )


def _anchor(group: type[BaseModel], model: type[BaseModel], heading: str) -> str:
    """Of a shared table, seen from the page of ``model``."""
    page = "devices.md" if bus(group) != bus(model) else ""
    return f"{page}#{heading.lower().replace(' ', '-').replace(chr(39), '')}"


def _all_keys(model: type[BaseModel], kind: str) -> list[str]:
    """Of each key of a kind a line of its table."""
    schema, lines = model.model_json_schema(), []
    for key, field in model.model_fields.items():
        if key == "kind":
            continue
        name = f"**`{key}`**" if field.is_required() else f"`{key}`"
        default = "" if field.is_required() or field.default is None else f"`{toml_of(field.default)}`"
        lines.append(f"| {name} | {type_of(schema['properties'][key])} | {default} | {meaning(model, key)} |")
    return lines


def meaning(model: type[BaseModel], key: str) -> str:
    """What a key is: as its own class says, or the driver, or the name that many have.

    Raises:
        KeyError: Nobody says.
    """
    drivers = model.driver_configs if issubclass(model, BusDevice) else ()
    classes = [one for driver in reversed(drivers) for one in reversed(driver.__mro__[:-1])]
    of_driver = {k: v for one in classes for k, v in _attributes(one).items()}
    return model.model_fields[key].description or of_driver.get(key) or MEANING[key]


def _attributes(driver: type) -> dict[str, str]:
    """What a driver's configuration says of its attributes, by name."""
    _, _, text = (inspect.getdoc(driver) or "").partition("Attributes:\n")
    text, *_ = re.split(r"\n(?=\S)", text)
    found = re.findall(r"(?m)^    (\w+): (.*(?:\n        .*)*)", text)
    return {name: re.sub(r"\s+", " ", said).replace("``", "`").replace("|", "\\|") for name, said in found}


def toml_of(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case tuple():
            return f"[{', '.join(map(toml_of, value))}]"
        case float():
            return f"{value:g}"
        case _:
            return str(value)


def type_of(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return type_of(next(one for one in schema["anyOf"] if one.get("type") != "null"))
    if "enum" in schema or "const" in schema:
        return ", ".join(f"`{toml_of(value)}`" for value in schema.get("enum", [schema.get("const")]))
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return f"{len(schema['prefixItems'])} numbers"
        return "tables" if "oneOf" in schema["items"] else f"list of {type_of(schema['items'])}"
    name = {"integer": "integer", "number": "number", "string": "text", "boolean": "true, false"}[schema["type"]]
    if abs(schema.get("maximum", 0)) == LARGEST:  # any number that a vehicle can have: only its sign is stated
        sign = {-LARGEST: "", 0: " at least 0", 1 / LARGEST: " above 0"}
        return name + sign[schema["minimum"]]
    low, high = schema.get("minimum"), schema.get("maximum")
    if low is not None and high is not None:
        return f"{name}, {low} to {high}"
    bounds = {"exclusiveMinimum": "above", "minimum": "at least"}
    return name + "".join(f" {word} {schema[bound]:g}" for bound, word in bounds.items() if bound in schema)


if __name__ == "__main__":
    for name, text in pages().items():
        Path(sys.argv[1]).with_name(name).write_text(text, encoding="utf-8")
