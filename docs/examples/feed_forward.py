"""Feed-forward torques of a free-flyer's arm, by the payload that a running flight hands over.

    heft fly vehicle.toml --hand-over /dev/shm/payload.urdf
    python docs/examples/feed_forward.py /dev/shm/payload.urdf motion.csv

The motion has ``time_s`` and a column for each joint, rad or m, as ``heft plan`` writes it. With every answer of the
flight (stream ``quantity``) this looks whether the payload is still handed over, and says once for each change what
torque the motion takes, or that there is no payload to count on. ``--once`` looks once, without the stream: exit code
1 where there is none.
"""

import argparse
import csv
import sys
import time
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

import heft

OLDEST_NS = 3_000_000_000  # the flight writes the file every second


def handed_over(path: Path) -> str | None:
    """The URDF that a flight stands by now; None where it has withdrawn it, or does not write any more."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    said = ET.fromstring(text).find("identified")
    age_ns = -1 if said is None else time.monotonic_ns() - int(said.attrib["host_ns"])
    return text if 0 <= age_ns <= OLDEST_NS else None


def torques(urdf: str, joints: list[str], time_s: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Of the joints along a motion, (n, joints), N m or N: the base floats, and nothing had momentum before.

    Args:
        urdf: of the vehicle with its payload.
        joints: names of the columns.
        time_s: even steps, (n,).
        q: rad or m, (n, joints).
    """
    model = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    model.gravity.setZero()
    data = model.createData()
    columns = [model.joints[model.getJointId(name)].idx_v for name in joints]
    dq = np.gradient(q, time_s, axis=0)
    ddq = np.gradient(dq, time_s, axis=0)
    base, out = slice(0, 6), np.zeros_like(q)
    for k in range(len(q)):
        place, rate, acceleration = np.zeros((3, model.nv))
        place[columns], rate[columns], acceleration[columns] = q[k], dq[k], ddq[k]
        at = pin.integrate(model, pin.neutral(model), place)
        mass = pin.crba(model, data, at)
        mass = np.triu(mass) + np.triu(mass, 1).T
        rate[base] = -np.linalg.solve(mass[base, base], mass[base] @ rate)
        bias = pin.nonLinearEffects(model, data, at, rate)
        acceleration[base] = -np.linalg.solve(mass[base, base], mass[base] @ acceleration + bias[base])
        out[k] = (mass @ acceleration + bias)[columns]
    return out


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("payload", type=Path, help="FILE of heft fly --hand-over")
    parser.add_argument("motion", type=Path, help="CSV")
    parser.add_argument("--once", action="store_true", help="look once")
    asked = parser.parse_args()
    with asked.motion.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    table = np.array(rows, np.float64)
    joints, time_s, q = names[1:], table[:, names.index("time_s")], table[:, 1:]

    def say(urdf: str | None) -> None:
        if urdf is None:
            print("no payload to count on: no feed-forward", flush=True)
            return
        mass = next(one for one in ET.fromstring(urdf).iter("quantity") if one.attrib["unit"] == "kg").attrib
        largest = np.abs(torques(urdf, joints, time_s, q)).max(axis=0)
        told = ", ".join(f"{name} {torque:.3g}" for name, torque in zip(joints, largest, strict=True))
        print(f"{float(mass['value']):.4g} kg ({float(mass['low']):.4g} to {float(mass['high']):.4g}); "
              f"largest torques: {told}", flush=True)  # fmt: skip

    if asked.once:
        urdf = handed_over(asked.payload)
        say(urdf)
        return 0 if urdf is not None else 1
    had: bool | None = None
    for _ in heft.subscribe("quantity"):
        urdf = handed_over(asked.payload)
        if (urdf is not None) != had:
            say(urdf)
            had = urdf is not None
    return 0


if __name__ == "__main__":
    sys.exit(main())
