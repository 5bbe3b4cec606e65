"""Tables of vehicle.toml that read what was found on the buses of a computer."""

import json
import re
from collections.abc import Mapping, Sequence

from onboard.devices.base import ImuDevice, JointDevice, LoadCellDevice
from onboard.ground.before.init import devices

_ROLES = ImuDevice, JointDevice, LoadCellDevice


def tables(found: Mapping[str, Sequence[tuple[str, int]]]) -> str:
    """Tables of the buses and of the devices on them; of kinds that ``heft init`` makes no table of, none.

    Args:
        found: by the URL of a bus, kinds, each with its I2C address, node number, or period of SYNC in us.
    """
    text, count = "", dict.fromkeys(_ROLES, 0)
    for number, (url, things) in enumerate(found.items()):
        bus, made = _name_of(url, number), ""
        for kind, place in things:
            if kind == "canopen_sync":
                made += _on(bus, 0, devices.SYNC).replace("period_ms = 5\n", f"period_ms = {1e-3 * place:.3g}\n")
            for role in count:
                if kind in devices.kinds(role):
                    count[role] += 1
                    made += _on(bus, place, _table(kind, place, role, count[role]))
                    break
        text += f"\n[bus.{bus}]\nurl = {json.dumps(url)}\n{made}" if made else ""
    return text.lstrip()


def bus_of(kind: str) -> str:
    """Name of the bus that ``heft init`` puts a device of a kind on that it makes tables of."""
    role = next(role for role in _ROLES if kind in devices.kinds(role))
    return _table(kind, 1, role, 1).bus


def _table(kind: str, place: int, role: type, count: int) -> devices.NewDevice:
    if role is JointDevice:
        return devices.joint(kind, place, f"joint_{count}", f"joint_{count}")
    made = devices.imu(kind, "imu_base") if role is ImuDevice else devices.load_cell(kind, place, "wrist")
    if count == 1:
        return made
    return made._replace(text=re.sub(r"(?m)^\[device\.\w+\]", f"[device.{kind}_{count}]", made.text, count=1))


def _on(bus: str, address: int, made: devices.NewDevice) -> str:
    text = made.text.replace(f'bus = "{made.bus}"', f'bus = "{bus}"')
    text = re.sub(r"(?m)^address = 0x[0-9a-f]+", f"address = 0x{address:02x}", text)
    return re.sub(r"(?m)^address = \d+$", f"address = {address}", text)


def _name_of(url: str, number: int) -> str:
    """The last part of its path where that can be a name, as i2c_1 or can0; otherwise its number."""
    last = re.sub(r"\W", "_", url.partition("?")[0].rpartition("/")[2], flags=re.ASCII).strip("_")
    return last if re.fullmatch(r"[A-Za-z]\w{0,23}", last, re.ASCII) else f"bus_{number}"
