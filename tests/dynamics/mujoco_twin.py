"""Random vehicles written twice: as URDF for us, as MJCF for MuJoCo. Truth comes from the latter's inverse dynamics."""

from dataclasses import dataclass, field

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation


@dataclass
class Link:
    name: str
    parent: int  # index, -1 for the base
    kind: str  # "free" (base), "revolute", "continuous", "prismatic", "fixed"
    xyz: np.ndarray
    rpy: np.ndarray
    axis: np.ndarray
    mass: float
    com: np.ndarray
    inertia: np.ndarray  # (3, 3) about the centre of mass, in link axes
    site: np.ndarray = field(default_factory=lambda: np.zeros(3))


def random_link(rng, name, parent, kind):
    half = np.sort(rng.uniform(0.02, 0.3, 3))
    mass = rng.uniform(0.1, 10.0)
    # a solid box: satisfies the triangle inequality with room
    diagonal = (
        mass / 3.0 * np.array([half[1] ** 2 + half[2] ** 2, half[0] ** 2 + half[2] ** 2, half[0] ** 2 + half[1] ** 2])
    )
    R = Rotation.random(rng=rng).as_matrix()
    axis = rng.normal(size=3)
    return Link(
        name,
        parent,
        kind,
        rng.uniform(-0.5, 0.5, 3),
        rng.uniform(-1.2, 1.2, 3),
        axis / np.linalg.norm(axis),
        mass,
        rng.uniform(-0.2, 0.2, 3),
        R @ np.diag(diagonal) @ R.T,
    )


def random_vehicle(rng, kinds, parents=None):
    links = [random_link(rng, "base", -1, "free")]
    for index, kind in enumerate(kinds):
        parent = index if parents is None else parents[index]
        links.append(random_link(rng, f"link_{index + 1}", parent, kind))
    return links


def numbers(values):
    return " ".join(repr(float(v)) for v in np.ravel(values))


def to_urdf(links):
    parts = ['<robot name="random">']
    for link in links:
        i = link.inertia
        parts.append(
            f'<link name="{link.name}"><inertial><origin xyz="{numbers(link.com)}"/><mass value="{link.mass!r}"/>'
            f'<inertia ixx="{float(i[0, 0])!r}" ixy="{float(i[0, 1])!r}" ixz="{float(i[0, 2])!r}" '
            f'iyy="{float(i[1, 1])!r}" iyz="{float(i[1, 2])!r}" izz="{float(i[2, 2])!r}"/></inertial></link>'
        )
    for link in links[1:]:
        limit = (
            '<limit lower="-3" upper="3" effort="1" velocity="1"/>' if link.kind in ("revolute", "prismatic") else ""
        )
        parts.append(
            f'<joint name="joint_{link.name}" type="{link.kind}"><parent link="{links[link.parent].name}"/>'
            f'<child link="{link.name}"/><origin xyz="{numbers(link.xyz)}" rpy="{numbers(link.rpy)}"/>'
            f'<axis xyz="{numbers(link.axis)}"/>{limit}</joint>'
        )
    return "".join(parts) + "</robot>"


def to_mujoco(links, free="<freejoint/>"):
    def body(index):
        link = links[index]
        x, y, z, w = Rotation.from_euler("xyz", link.rpy).as_quat()
        i = link.inertia
        full = numbers([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
        place = "" if link.kind == "free" else f'pos="{numbers(link.xyz)}" quat="{numbers([w, x, y, z])}"'
        joint = {
            "free": free,
            "fixed": "",
            "prismatic": f'<joint type="slide" axis="{numbers(link.axis)}"/>',
        }.get(link.kind, f'<joint type="hinge" axis="{numbers(link.axis)}"/>')
        inner = "".join(body(k) for k, other in enumerate(links) if other.parent == index)
        return (
            f'<body name="{link.name}" {place}>{joint}<inertial pos="{numbers(link.com)}" mass="{link.mass!r}" '
            f'fullinertia="{full}"/><site name="site_{link.name}"/>{inner}</body>'
        )

    sensors = "".join(
        f'<force name="force_{link.name}" site="site_{link.name}"/>'
        f'<torque name="torque_{link.name}" site="site_{link.name}"/>'
        for link in links[1:]
    )
    xml = (
        '<mujoco><compiler angle="radian"/><option gravity="0 0 0"><flag contact="disable"/></option>'
        f"<worldbody>{body(0)}</worldbody><sensor>{sensors}</sensor></mujoco>"
    )
    return mujoco.MjModel.from_xml_string(xml)


def inverse_dynamics(model, q, dq, ddq, velocity, rate, acceleration, rate_acceleration, data=None):
    """MuJoCo's answer at one tick: (force on the base, moment on it, joint forces, sensor data), base axes.

    The base sits at the origin in the world's axes; ``acceleration`` is that of its origin (gravity is zero).
    ``data``: of the model, for many ticks: making it takes a hundred times as long as the answer.
    """
    data = data or mujoco.MjData(model)
    data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    data.qpos[7:], data.qvel[6:], data.qacc[6:] = q, dq, ddq
    data.qvel[:3], data.qvel[3:6] = velocity, rate
    data.qacc[:3], data.qacc[3:6] = acceleration, rate_acceleration
    mujoco.mj_inverse(model, data)
    return (
        data.qfrc_inverse[:3].copy(),
        data.qfrc_inverse[3:6].copy(),
        data.qfrc_inverse[6:].copy(),
        data.sensordata.copy(),
    )


def swung(links, rng, t, gravity_m_s2):
    """Angles, rates, accelerations, torques, (n, 3) each, of eight random sines a joint on a base that stands."""
    w, a, p = rng.uniform(0.5, 4.0, (8, 3)), rng.uniform(0.1, 0.3, (8, 3)), rng.uniform(0, 6.3, (8, 3))
    phase = w * t[:, None, None] + p  # (n, 8, 3)
    motion = [(f * a * w**k).sum(axis=1) for k, f in enumerate((np.sin(phase), np.cos(phase), -np.sin(phase)))]
    model, still = to_mujoco(links), np.zeros(3)
    model.opt.gravity[:] = (0, 0, -gravity_m_s2)
    ticks, data = zip(*motion, strict=True), mujoco.MjData(model)
    return *motion, np.array([inverse_dynamics(model, *tick, still, still, still, still, data)[2] for tick in ticks])
