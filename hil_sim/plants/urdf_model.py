"""MuJoCo's model of a URDF: compiled by MuJoCo's reader, its base let go or held, its bodies as they were built."""

import contextlib
import ctypes
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.body import Solid
from hil_sim.plants.urdf_drawing import PREFIX, PlantDrawing
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario

BASE_FREEDOM = {"free": 6, "prescribed": 6, "fixed": 0, "planar": 3, "pivot": 3}
_POSE = {"free": 7, "prescribed": 7, "fixed": 0, "planar": 3, "pivot": 4}  # numbers of the base's pose
_JOINTS = {"free": 1, "prescribed": 1, "fixed": 0, "planar": 3, "pivot": 1}  # of MuJoCo's that let it go
_LEAST_kg_m2 = 1e-12  # of a joint that carries nothing: MuJoCo factors the inertia matrix, and complains of a zero
_SENSED = {
    "gyro": mujoco.mjtSensor.mjSENS_GYRO,
    "accelerometer": mujoco.mjtSensor.mjSENS_ACCELEROMETER,
    "force": mujoco.mjtSensor.mjSENS_FORCE,
    "torque": mujoco.mjtSensor.mjSENS_TORQUE,
    "position": mujoco.mjtSensor.mjSENS_FRAMEPOS,
    "attitude": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
}
Sensed = Literal["gyro", "accelerometer", "force", "torque", "position", "attitude"]

# MuJoCo's Python module lets it time the parts of each step, which takes up to a third of a step of a small model;
# its set_mjcb_time(None) leaves that timer. A release without this variable is slower, and no more.
with contextlib.suppress(AttributeError, OSError, ValueError):
    ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._callbacks.__file__), "mjcb_time").value = None

Fit = Callable[[mujoco.MjSpec, mujoco.MjModel], None]


class Places(NamedTuple):
    """Links at which something is measured."""

    imus: tuple[str, ...]
    cells: tuple[str, ...]
    tracked: tuple[str, ...] = ()


def places(scenario: Scenario, drawing: PlantDrawing) -> Places:
    """Links at which the devices measure motion or loads."""
    imus: dict[str, None] = {}
    cells: dict[str, None] = {}
    tracked: dict[str, None] = {}
    for device in scenario.device.values():
        table = device.model_dump()
        for part in (table, *table.get("channel", ())):
            sensor = scenario.sensor.get(str(part.get("measures")))
            if sensor is not None and sensor.quantity == "inertial":
                imus[drawing.link_at(str(part.get("at")))] = None
            elif sensor is not None and sensor.quantity in ("joint_moment", "force"):
                cells[drawing.link_at(str(part.get("at")))] = None
            elif sensor is not None and sensor.quantity == "pose":
                tracked[drawing.link_at(str(part.get("at")))] = None
    return Places(tuple(imus), tuple(cells), tuple(tracked))


class UrdfModel:
    """A vehicle's model, base joints first.

    Args:
        drawing: its URDF.
        base: kind of the base.
        gravity_m_s2: world axes.
        places: where it is measured.
        fit: adds to the model what the URDF has not; it is given the model without.

    Attributes:
        model: MuJoCo's.
        root: link that all others hang on.
        freedom: degrees of freedom of the base.
        pose: numbers of its pose.
        joints: names of the joints in the order of MuJoCo's columns after the base's.

    Raises:
        ScenarioError: MuJoCo cannot simulate it.
    """

    def __init__(
        self, drawing: PlantDrawing, base: str, gravity_m_s2: Sequence[float], places: Places, fit: Fit | None = None
    ) -> None:
        try:
            spec = mujoco.MjSpec.from_string(drawing.plain)
            spec.compiler.fusestatic = False
            _let_go(spec.body(PREFIX + drawing.root), base)
            _instrument(spec, places)
            self.model = spec.compile()
            if fit is not None:
                fit(spec, self.model)
                self.model = spec.compile()
        except ValueError as error:
            why = str(error).replace(PREFIX, "")
            raise ScenarioError(
                f"MuJoCo cannot simulate the URDF: {why}; give every link that moves a mass, "
                "and an inertia about its centre of mass that a body can have"
            ) from error
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.model.opt.gravity = gravity_m_s2
        self.model.dof_damping[:] = self.model.dof_frictionloss[:] = 0.0
        self.model.dof_armature[:] = _LEAST_kg_m2
        self.root, self.freedom = drawing.root, BASE_FREEDOM[base]
        self.pose = _POSE[base]
        self.joints = tuple(self.model.joint(index).name for index in range(_JOINTS[base], self.model.njnt))
        self._drawn = {link: self._read(link) for link in drawing.links}

    def _read(self, link: str) -> Solid:
        body = self.model.body(PREFIX + link)
        R = matrix_of(body.iquat)
        return Solid(float(body.mass[0]), np.array(body.ipos), R @ np.diag(body.inertia) @ R.T)

    @property
    def drawn(self) -> dict[str, Solid]:
        """Every link that has a mass, as drawn, in its own frame."""
        return {link: body for link, body in self._drawn.items() if body.mass_kg > 0.0}

    def build(self, bodies: Mapping[str, Solid]) -> None:
        """Give links other inertias."""
        for link, own in bodies.items():
            body = self.model.body(PREFIX + link)
            moments, axes = np.linalg.eigh(own.inertia_kg_m2)
            axes[:, 2] *= np.sign(np.linalg.det(axes))
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, axes.ravel())
            body.mass, body.ipos, body.inertia, body.iquat = own.mass_kg, own.centre_of_mass_m, moments, quaternion
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def move(self, off_m: Mapping[str, FloatArray]) -> None:
        """Move links' frames off where they are drawn, in the axes of the link before."""
        for link, by in off_m.items():
            self.model.body(PREFIX + link).pos += by
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def empty(self, link: str) -> Solid:
        """Take a link's inertia away, which is that of the payload it holds; returns it as drawn."""
        own = self._drawn[link]
        self._drawn[link] = Solid(0.0, np.zeros(3), np.zeros((3, 3)))
        self.build({link: self._drawn[link]})
        return own

    def hold(self, link: str, payload: Solid | None) -> None:
        """Weld a payload to a link, or take it off: the link has its own inertia besides."""
        own = self._drawn[link]
        self.build({link: own if payload is None else _together(own, payload)})

    def body(self, link: str) -> int:
        """MuJoCo's number of a link."""
        return int(self.model.body(PREFIX + link).id)

    def beyond(self, link: str) -> list[int]:
        """MuJoCo's numbers of a link and of all that hangs on it."""
        cut, found = self.body(link), []
        for index in range(1, self.model.nbody):
            at = index
            while at not in (cut, 0):
                at = int(self.model.body_parentid[at])
            if at == cut:
                found.append(index)
        return found

    def sensor(self, kind: Sensed, link: str) -> slice:
        """Where a sensor's numbers stand: three, of an attitude four."""
        sensor = self.model.sensor(f"{kind} {link}")
        first = int(sensor.adr[0])
        return slice(first, first + int(sensor.dim[0]))


def _let_go(root: mujoco.MjsBody, base: str) -> None:
    if BASE_FREEDOM[base] == 6:
        root.add_freejoint()
    elif base == "pivot":
        root.add_joint(name="pivot", type=mujoco.mjtJoint.mjJNT_BALL)
    elif base == "planar":
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        root.add_joint(name="table x", type=slide, axis=[1, 0, 0])
        root.add_joint(name="table y", type=slide, axis=[0, 1, 0])
        root.add_joint(name="table yaw", type=hinge, axis=[0, 0, 1])


def _instrument(spec: mujoco.MjSpec, places: Places) -> None:
    def add(kinds: Iterable[Sensed], links: Iterable[str]) -> None:
        for link in links:
            for kind in kinds:
                spec.add_sensor(
                    name=f"{kind} {link}", type=_SENSED[kind], objtype=mujoco.mjtObj.mjOBJ_SITE, objname=f"at {link}"
                )

    for link in dict.fromkeys((*places.imus, *places.cells, *places.tracked)):
        spec.body(PREFIX + link).add_site(name=f"at {link}")
    add(("gyro", "accelerometer"), places.imus)
    add(("force", "torque"), places.cells)
    add(("position", "attitude"), places.tracked)


def _together(one: Solid, other: Solid) -> Solid:
    """Two bodies in one frame, welded."""
    mass = one.mass_kg + other.mass_kg
    centre = (one.mass_kg * one.centre_of_mass_m + other.mass_kg * other.centre_of_mass_m) / mass
    inertia = np.zeros((3, 3))
    for part in (one, other):
        d = part.centre_of_mass_m - centre
        inertia += part.inertia_kg_m2 + part.mass_kg * (d @ d * np.eye(3) - np.outer(d, d))
    return Solid(mass, centre, inertia)


def matrix_of(quaternion: FloatArray) -> FloatArray:
    """Rotation of a quaternion (w, x, y, z), (3, 3)."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, np.asarray(quaternion, np.float64))
    return out.reshape(3, 3)


def rotation(roll_pitch_yaw: FloatArray) -> FloatArray:
    """(3, 3): Rz(yaw) Ry(pitch) Rx(roll), rad."""
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, np.asarray(roll_pitch_yaw, np.float64), "XYZ")
    return matrix_of(quaternion)
