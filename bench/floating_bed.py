"""A simulator of a body that floats on a table, by MuJoCo: thruster commands and tracked poses, with known truth.

It shares nothing with the estimator: bodies are MuJoCo's, valves are switched on a clock of a millisecond.
"""

from dataclasses import dataclass, field
from math import cos, sin
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEP_s = 1e-3
FORCE_N, REACH_M, MARKER_M = 0.6, 0.18, (0.05, 0.02)
CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))
THRUSTERS = {  # place and direction of the force on the body, drawn: two at each corner
    f"t{2 * n + half + 1}": ((x * REACH_M, y * REACH_M), (-x, 0) if half == 0 else (0, -y))
    for n, (x, y) in enumerate(CORNERS)
    for half in (0, 1)
}


class RecordedBed(NamedTuple):
    """What is true, and what was recorded."""

    mass_kg: float
    centre_m: tuple[float, float]
    inertia_kg_m2: float
    delay_s: float
    least_s: float
    time_s: Floats  # of commands
    levels: Floats  # (n, 8)
    pose_s: Floats
    poses: Floats  # (m, 3) of the marker: m, m, rad

    @property
    def truth(self) -> dict[str, float]:
        """By the names that ``heft identify`` gives them, SI."""
        x, y = self.centre_m
        return {"mass": self.mass_kg, "com_x": x, "com_y": y, "I_zz": self.inertia_kg_m2, "delay": self.delay_s}


def commands(rng: np.random.Generator, seconds: float, period_s: float = 0.02) -> Floats:
    """Pulses of 20 to 800 ms of pairs of thrusters, (n, 8), which push one way and back, and turn one way and back."""
    n = round(seconds / period_s)
    levels, at = np.zeros((n, 8)), 10
    names = list(THRUSTERS)
    pairs = [
        ("t1", "t7"),
        ("t3", "t5"),
        ("t2", "t4"),
        ("t6", "t8"),
        ("t1", "t5"),
        ("t3", "t7"),
        ("t2", "t6"),
        ("t4", "t8"),
    ]
    back = {0: 1, 1: 0, 2: 3, 3: 2, 4: 5, 5: 4, 6: 7, 7: 6}
    while at < n - 120:
        which, length = int(rng.integers(8)), int(np.exp(rng.uniform(np.log(1), np.log(40))))
        wait = int(rng.integers(2, 30))
        for one, start in ((which, at), (back[which], at + length + wait)):
            for name in pairs[one]:
                levels[start : start + length, names.index(name)] = 1.0
        at += 2 * (length + wait)
    return levels


@dataclass(frozen=True)
class UnstatedErrors:
    """What nobody stated."""

    force: Floats = field(default_factory=lambda: np.ones(8))  # factor of each thruster
    place: Floats = field(default_factory=lambda: np.zeros((8, 2)))  # added to that of each, m
    stuck: tuple[int, float, float] | None = None  # a thruster that is on, from, to, s
    late_s: float = 0.0  # of the poses' stamps


def fly(
    seed: int,
    seconds: float = 60.0,
    delay_s: float | None = None,
    wrong: UnstatedErrors | None = None,
    period_s: float = 0.02,
) -> RecordedBed:
    """A run; forces off by 3 % all alike and by 2 % each, directions by 0.01 rad, places by 2 mm, valves late by 0 to
    0.5 s and shut below 20 to 70 ms, the table tilted by 0.5 mrad; poses with noise of 0.3 mm and 0.6 mrad.

    Args:
        seed: of all that is drawn.
        seconds: of the run.
        delay_s: of the valves; drawn where not given.
        wrong: besides.
        period_s: of the commands; poses come every 10 ms.
    """  # noqa: D205
    wrong = wrong or UnstatedErrors()
    rng = np.random.default_rng(seed)
    mass, inertia = rng.uniform(8.0, 14.0), rng.uniform(0.12, 0.3)
    centre = rng.uniform(-0.02, 0.02, 2)
    delay = rng.uniform(0.0, 0.5) if delay_s is None else delay_s
    least = rng.uniform(0.02, 0.07)
    loss = max(0.0, rng.normal(0.0, 0.01))
    tilt, drag, spin = rng.normal(0.0, 0.005, 2), abs(rng.normal(0.0, 0.005)), abs(rng.normal(0.0, 0.005))
    supply = 1.0 + np.random.default_rng([seed, 8]).normal(0.0, 0.03)
    factor = supply * (1.0 + rng.normal(0.0, 0.02, 8)) * wrong.force
    place = np.array([at for at, _ in THRUSTERS.values()]) + wrong.place
    toward = np.array([to for _, to in THRUSTERS.values()], float)
    angle = np.arctan2(toward[:, 1], toward[:, 0]) + rng.normal(0.0, 0.01, 8)
    aside = rng.normal(0.0, 0.002, 8)
    place = place + aside[:, None] * np.stack([-np.sin(angle), np.cos(angle)], 1)
    levels = commands(rng, seconds, period_s)
    n = round(seconds / STEP_s)
    acting = np.zeros((n, 8))
    for j in range(8):
        edges = np.flatnonzero(np.diff(np.append(np.append(0.0, levels[:, j]), 0.0)))
        own = delay + rng.normal(0.0, 0.003)
        for on, off in edges.reshape(-1, 2) * period_s:
            if off - on < least:
                continue
            acting[round((on + own + loss) / STEP_s) : round((off + own) / STEP_s), j] = 1.0
    if wrong.stuck is not None:
        j, start, end = wrong.stuck
        acting[round(start / STEP_s) : round(end / STEP_s), j] = 1.0
    poses = _integrate(mass, inertia, centre, tilt, drag, spin, acting, factor * FORCE_N, place, angle, rng)
    marker = np.array(MARKER_M) + rng.normal(0.0, 0.002, 2)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    seen = np.stack([poses[:, 0] + c * marker[0] - s * marker[1], poses[:, 1] + s * marker[0] + c * marker[1]], 1)
    seen = seen * (1.0 + rng.normal(0.0, 0.001))
    yaw = poses[:, 2] + rng.normal(0.0, 0.01)
    shown = np.column_stack([seen, yaw])[::10]
    shown += rng.normal(0.0, 1.0, shown.shape) * [3e-4, 3e-4, 6e-4]
    time_s = np.arange(0.0, n, 10.0) * STEP_s
    time = np.arange(float(len(levels))) * period_s
    return RecordedBed(
        float(mass),
        (float(centre[0]), float(centre[1])),
        inertia,
        delay,
        least,
        time,
        levels,
        time_s + wrong.late_s,
        shown,
    )


def _integrate(
    mass: float,
    inertia: float,
    centre: Floats,
    tilt: Floats,
    drag: float,
    spin: float,
    acting: Floats,
    force: Floats,
    place: Floats,
    angle: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Pose of the body's frame at every step, (n, 3)."""
    spec = f"""<mujoco><option timestep="{STEP_s}" gravity="0 0 0" integrator="RK4"/><worldbody><body>
    <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
    <joint name="yaw" type="hinge" axis="0 0 1"/>
    <inertial pos="{centre[0]} {centre[1]} 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
    </body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(spec)
    data = mujoco.MjData(model)
    data.qpos[2] = rng.uniform(-3.0, 3.0)
    data.qvel[:] = rng.normal(0.0, 0.01, 3)
    found = np.empty((len(acting), 3))
    ux, uy, each = np.cos(angle), np.sin(angle), acting * force
    lever = (place[:, 0] - centre[0]) * uy - (place[:, 1] - centre[1]) * ux
    pushes = np.stack([(each * ux).sum(axis=1), (each * uy).sum(axis=1), (each * lever).sum(axis=1)], axis=1).tolist()
    (x, y), (tilt_x, tilt_y) = centre.tolist(), tilt.tolist()
    for i, (along, across, moment) in enumerate(pushes):
        if i % 5000 == 0:
            (uneven_x, uneven_y), turning = rng.normal(0.0, 3e-4, 2).tolist(), rng.normal(0.0, 5e-4)
        found[i] = data.qpos
        (vx, vy, w), yaw = data.qvel.tolist(), float(data.qpos[2])
        c, s = cos(yaw), sin(yaw)
        vx, vy = vx - w * (s * x + c * y), vy + w * (c * x - s * y)  # of the centre of mass
        data.xfrc_applied[1, 0] = c * along - s * across + mass * (tilt_x + uneven_x - drag * vx)
        data.xfrc_applied[1, 1] = s * along + c * across + mass * (tilt_y + uneven_y - drag * vy)
        data.xfrc_applied[1, 5] = moment + inertia * (turning - spin * w)
        mujoco.mj_step(model, data)
    return found


def urdf(mass_kg: float) -> str:
    """A drawing: mass as weighed, centre and moment of inertia as anybody would guess them."""
    frames = {"marker": (MARKER_M, 0.0)}
    frames |= {name: (at, np.arctan2(to[1], to[0])) for name, (at, to) in THRUSTERS.items()}
    links = "".join(
        f'<link name="{name}"/><joint name="{name}_mount" type="fixed"><parent link="body"/><child link="{name}"/>'
        f'<origin xyz="{x} {y} 0.1" rpy="0 0 {yaw}"/></joint>\n'
        for name, ((x, y), yaw) in frames.items()
    )
    return (
        f'<robot name="floater"><link name="body"><inertial><mass value="{mass_kg}"/><origin xyz="0 0 0.05"/>'
        f'<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>\n{links}</robot>\n'
    )


def write(bed: RecordedBed, directory: Path) -> None:
    """``run.csv``: commands at the poses' times, as a laboratory's logger has them; ``body.urdf``, mass to 0.5 %."""
    at = np.searchsorted(bed.time_s, bed.pose_s, side="right") - 1
    keep = (at >= 0) & (bed.pose_s <= bed.time_s[-1])
    yaw = np.remainder(bed.poses[keep, 2] + np.pi, 2.0 * np.pi) - np.pi
    rows = np.column_stack([100.0 + bed.pose_s[keep], bed.poses[keep, :2], yaw, bed.levels[at[keep]]])
    header = ",".join(["t", "x", "y", "yaw", *THRUSTERS])
    np.savetxt(directory / "run.csv", rows, delimiter=",", header=header, comments="", fmt="%.6f")
    weighed = bed.mass_kg * (1.0 + 0.005 * np.random.default_rng(round(1e6 * bed.mass_kg)).normal())
    (directory / "body.urdf").write_text(urdf(weighed))
