"""A wrist sensor, a tool and a robot that holds still in many poses: NumPy and nothing of ours.

Rotations by Rodrigues' formula and by quaternion products written out; the sensor has scales, cross-talk, zeros that
walk and noise of its own.
"""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from onboard.cli import main

HEADER = ("qw", "qx", "qy", "qz", "fx", "fy", "fz", "mx", "my", "mz")
NAMED = (*HEADER[:4], *(f"{name} [N]" for name in HEADER[4:7]), *(f"{name} [Nm]" for name in HEADER[7:]))
GRAVITY = 9.80665
# Said, so that no other meaning is fitted as well
AS_RECORDED = ("--sense=sensor-in-base", "--axes=sensor", "--sign=weight", "--gravity=0,0,-1")


def turn(v):
    """Rotation by a vector, rad (Rodrigues)."""
    angle = np.linalg.norm(v)
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = np.asarray(v) / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def anyhow(rng):
    """A rotation, all as likely."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(R):
    """w, x, y, z; by the largest of the four (Shepperd)."""
    four = np.array([np.trace(R), R[0, 0], R[1, 1], R[2, 2]])
    k = int(four.argmax())
    q = np.zeros(4)
    if k == 0:
        q[0] = 0.5 * np.sqrt(1.0 + four[0])
        q[1:] = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4.0 * q[0])
        return q
    a, b, c = k - 1, k % 3, (k + 1) % 3
    q[1 + a] = 0.5 * np.sqrt(1.0 + R[a, a] - R[b, b] - R[c, c])
    q[0], q[1 + b], q[1 + c] = np.array([R[c, b] - R[b, c], R[b, a] + R[a, b], R[c, a] + R[a, c]]) / (4.0 * q[1 + a])
    return q


class Truth(NamedTuple):
    mass_kg: float
    centre_m: np.ndarray
    mounting: np.ndarray
    zero: np.ndarray
    noise: np.ndarray


class Recording(NamedTuple):
    """What was done, and what is true."""

    R: np.ndarray  # (n, 3, 3) flange in the base
    wrench: np.ndarray  # (n, 6)
    true: Truth

    @property
    def rows(self):
        """(n, 10) by ``HEADER``."""
        return np.hstack([np.array([quaternion(R) for R in self.R]), self.wrench])


def record(seed, count=30, gain=0.01, cross=0.005, walk=0.3, spread_deg=None, tilt_deg=1.0, about_z=True):
    """A tool and a sensor of this seed; all poses, or those within some angle of the first."""
    rng = np.random.default_rng(seed)
    mass = float(np.exp(rng.uniform(np.log(0.3), np.log(8.0))))
    centre = rng.normal(size=3) * 0.02 + [0.0, 0.0, rng.uniform(0.02, 0.2)]
    mounting = turn([0.0, 0.0, rng.uniform(-np.pi, np.pi) if about_z else 0.0]) @ turn(rng.normal(size=3) * 0.0175)
    tilt = turn([*(rng.normal(size=2) * np.deg2rad(tilt_deg)), 0.0])
    scales = 1.0 + gain * rng.normal(size=6)
    X = cross * rng.normal(size=(6, 6))
    X[:3, 3:] /= 0.05
    X[3:, :3] *= 0.05
    np.fill_diagonal(X, 0.0)
    force = rng.uniform(0.01, 0.1)
    noise = np.repeat([force, force * rng.uniform(0.02, 0.1)], 3)
    zero = np.concatenate([rng.normal(size=3) * 10.0, rng.normal(size=3) * 0.5])
    if spread_deg is None:
        R = np.array([anyhow(rng) for _ in range(count)])
    else:
        R = np.array([turn(np.deg2rad(spread_deg) * rng.uniform(-1.0, 1.0, 3)) for _ in range(count)])
    wrench = np.empty((count, 6))
    for k in range(count):
        weight = mass * mounting @ R[k].T @ tilt @ [0.0, 0.0, -GRAVITY]
        load = np.concatenate([weight, np.cross(centre, weight)])
        wrench[k] = scales * load + X @ load + zero + noise * rng.normal(size=6)
        if k < count - 1:
            zero = zero + walk * noise * rng.normal(size=6)
    return Recording(R, wrench, Truth(mass, centre, mounting, zero, noise))


def write(path: Path, rows, header=HEADER, between=","):
    """A table of text."""
    lines = [between.join(header)] if header else []
    lines += [between.join(cell if isinstance(cell, str) else repr(float(cell)) for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def weighed(directory, rows, *options, header=HEADER, between=","):
    """Exit code and answer of the command."""
    path = write(directory / "poses.csv", rows, header, between)
    answer = directory / "answer.json"
    answer.unlink(missing_ok=True)
    code = main(["weigh", str(path), "--json", str(answer), *options])
    return code, json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else {}


def holds(answer, truth):
    """Whether mass and centre lie in their intervals."""
    found = {quantity["name"]: quantity for quantity in answer["quantities"]}
    true = dict(zip(("m", "c_x", "c_y", "c_z"), (truth.mass_kg, *truth.centre_m), strict=True))
    return {name: found[name]["low"] <= value <= found[name]["high"] for name, value in true.items()}
