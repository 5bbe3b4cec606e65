"""Vehicle model: URDF to Pinocchio, with separate parameters for every link.

Pinocchio merges the inertia of links on fixed joints into the moving body before them. A payload on a fixed joint must
keep its own parameters, so the standard parameters are kept *per link*: each link has its frame, its motion, its own 6
x 10 body regressor, and its own ten columns.

Order of the ten parameters: ``M, MX, MY, MZ, XX, XY, YY, XZ, YZ, ZZ`` (Pinocchio's; Limparis 2.112 has another): mass,
first moments, and elements of the inertia tensor about the *link frame's origin*, in the link frame's axes.
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError, UnknownFrameError, UrdfError
from onboard.dynamics.model.tree import tree_of
from onboard.dynamics.model.urdf_check import LEAST_SHARE, inertial_of, require_flyable, vector
from onboard.dynamics.model.urdf_reading import Drawing, plain, shortened
from onboard.estimation.arrays import FloatArray

STANDARD = ("M", "MX", "MY", "MZ", "XX", "XY", "YY", "XZ", "YZ", "ZZ")
FREE_FLYER_NV = 6
STANDARD_GRAVITY_M_S2 = 9.80665
NAMED = (pin.FrameType.BODY, pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)  # of a link and a joint, the link


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """Interpretation of the URDF."""

    base: BaseKind
    base_link: str  # the URDF's root
    payload_link: str | None = None  # link held only part of the time
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY_M_S2)  # of a base in gravity, its axes


class Joint(NamedTuple):
    """A joint that moves, in the model's order."""

    name: str
    axis: tuple[float, float, float]  # in the joint frame
    revolute: bool  # else prismatic
    q_index: int  # in Pinocchio's configuration vector
    q_size: int  # 2 for a continuous joint (cosine, sine)
    v_index: int
    low: float  # position limits, rad or m; infinite where the URDF has none
    high: float


def _standard_parameters(link: ET.Element) -> FloatArray:
    """The ten standard parameters of a URDF link about its own frame, (10,); zeros without ``<inertial>``."""
    own = inertial_of(link)
    if own is None:
        return np.zeros(10)
    R = pin.rpy.rpyToMatrix(own.roll_pitch_yaw_rad)
    inertia = pin.Inertia(own.mass_kg, own.centre_m, R @ own.inertia_kg_m2 @ R.T)
    return np.asarray(inertia.toDynamicParameters(), np.float64)


class VehicleModel:
    """A free-flyer base with joints, and the standard parameters of each of its links.

    Attributes:
        spec: how the URDF was read.
        model: the Pinocchio model, gravity zero, free-flyer root.
        joints: the joints, in the order of the columns of q, dq, ddq.
        links: links with mass, in the order of their columns; the payload link among them even without.
        chi: standard parameters from the URDF, (10 x links,).
        tree: joints and links as arrays.
    """

    def __init__(self, urdf: str, spec: VehicleSpec) -> None:
        drawing = require_flyable(urdf, spec.base, spec.payload_link)
        elements = drawing.links
        try:
            self.model = pin.buildModelFromXML(plain(drawing), pin.JointModelFreeFlyer())
        except (ValueError, RuntimeError) as error:
            raise UrdfError(f"Pinocchio cannot read the URDF: {error}") from error
        if spec.base_link != drawing.root:
            raise UrdfError(f"base_link {spec.base_link!r} is not the root of the URDF; the root is {drawing.root}")
        if spec.payload_link is not None and spec.payload_link not in elements:
            raise UnknownFrameError(
                f"payload_link {spec.payload_link!r} is not in the URDF; it has {shortened(elements)}"
            )
        self.spec = spec
        self.model.gravity.setZero()
        parameters = {
            frame.name: _standard_parameters(elements[frame.name])
            for frame in self.model.frames
            if frame.type == pin.FrameType.BODY
        }
        least_kg = LEAST_SHARE * sum(chi[0] for chi in parameters.values())
        self.links = tuple(name for name, chi in parameters.items() if chi[0] > least_kg or name == spec.payload_link)
        self.chi = np.concatenate([parameters[name] for name in self.links] or [np.zeros(0)])
        self.chi.setflags(write=False)
        if spec.base.follows:
            self.base_body()
        self.joints = tuple(self._joint(drawing, index) for index in range(2, self.model.njoints))
        self.tree = tree_of(self.model, self.joints, self.links)
        self._poses: dict[str, tuple[FloatArray, FloatArray]] = {}  # of frames fixed in the base
        self._neutral = self.model.createData()
        pin.framesForwardKinematics(self.model, self._neutral, pin.neutral(self.model))

    def _joint(self, drawing: Drawing, index: int) -> Joint:
        name, joint = self.model.names[index], self.model.joints[index]
        found = drawing.joints[name]
        axis = vector(found.element.find("axis"), "xyz", "1 0 0")
        axis /= np.linalg.norm(axis)
        bounded = joint.nq == 1
        return Joint(
            name,
            (float(axis[0]), float(axis[1]), float(axis[2])),
            found.kind != "prismatic",
            joint.idx_q,
            joint.nq,
            joint.idx_v,
            float(self.model.lowerPositionLimit[joint.idx_q]) if bounded else -np.inf,
            float(self.model.upperPositionLimit[joint.idx_q]) if bounded else np.inf,
        )

    def frame_id(self, name: str) -> int:
        """Pinocchio's index of a link or joint; of the link where both have that name.

        Raises:
            UnknownFrameError: no such name.
        """
        for kind in NAMED:
            if self.model.existFrame(name, kind):
                return int(self.model.getFrameId(name, kind))
        known = ", ".join(dict.fromkeys(frame.name for frame in self.model.frames[1:]))
        raise UnknownFrameError(f"the URDF has no link, joint or frame {name!r}; it has {known}")

    def joint(self, name: str) -> Joint:
        """A joint by name.

        Raises:
            UnknownFrameError: no such joint.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        names = ", ".join(joint.name for joint in self.joints)
        raise UnknownFrameError(f"the URDF has no moving joint {name!r}; it has {names}")

    def pose_in_base(self, frame: str) -> tuple[FloatArray, FloatArray]:
        """Pose of a frame that is fixed in the base: ``(R_BF (3, 3), p_BF (3,))`` in base axes, m.

        Raises:
            UnknownFrameError: no such frame, or one that moves with a joint.
        """
        if frame not in self._poses:
            found = self.model.frames[self.frame_id(frame)]
            if found.parentJoint != 1:
                raise UnknownFrameError(f"frame {frame!r} moves with a joint; name a frame fixed in the base")
            pose = np.array(found.placement.rotation), np.array(found.placement.translation)
            for part in pose:
                part.setflags(write=False)
            self._poses[frame] = pose
        return self._poses[frame]

    def base_body(self) -> str:
        """The base link, or the first link with a mass that is fixed to it.

        Raises:
            UrdfError: there is none.
        """
        for link in self.links:
            if self.model.frames[self.frame_id(link)].parentJoint == 1 and link != self.spec.payload_link:
                return str(link)
        raise UrdfError(
            f"the base, link {self.spec.base_link!r}, weighs nothing beside the payload; give it <inertial>"
        )

    def distal_links(self, frame: str) -> tuple[int, ...]:
        """Indices into :attr:`links` of the links beyond a cut at a frame."""
        cut = self.frame_id(frame)
        beyond = []
        for index, link in enumerate(self.links):
            at = self.frame_id(link)
            while at not in (cut, 0):
                at = self.model.frames[at].parentFrame
            if at == cut:
                beyond.append(index)
        return tuple(beyond)

    def centre_of_mass_is_fixed(self) -> bool:
        """Whether the vehicle's centre of mass is fixed in the base: every joint turns a balanced body."""
        for joint in self.joints:
            moment, reach = np.zeros(3), 0.0
            o_M_joint = self._neutral.oMf[self.frame_id(joint.name)]
            for link in self.distal_links(joint.name):
                joint_M_link = o_M_joint.actInv(self._neutral.oMf[self.frame_id(self.links[link])])
                mass, first = self.chi[10 * link], self.chi[10 * link + 1 : 10 * link + 4]
                moment += joint_M_link.rotation @ first + mass * joint_M_link.translation
                reach += mass * np.linalg.norm(joint_M_link.translation) + np.linalg.norm(first)
            off_axis = moment - np.dot(moment, joint.axis) * np.array(joint.axis)
            if not joint.revolute or np.linalg.norm(off_axis) > 1e-9 * reach:
                return False
        return True

    def payload_columns(self) -> slice:
        """The payload link's ten columns; an empty slice without a payload link."""
        if self.spec.payload_link is None:
            return slice(0, 0)
        start = 10 * self.links.index(self.spec.payload_link)
        return slice(start, start + 10)

    def parameter_sigma(self, relative: dict[str, float]) -> FloatArray:
        """Prior standard deviations of the standard parameters, (10 x links,).

        A link's relative sigma is applied to its mass, to mass x k for the first moments, and to half the trace of its
        inertia for every element of it, k being the link's radius of gyration about its frame. Elements that are zero
        by symmetry in the drawing thus have a sigma too.

        Args:
            relative: relative standard deviation by link name; every link must be there.

        Raises:
            UnknownFrameError: a link that is missing, or a name that is not a link.
            SignalError: a sigma that is negative or not finite.
        """
        if set(relative) != set(self.links):
            raise UnknownFrameError(self._who_lacks(relative))
        wrong = [link for link, value in relative.items() if not 0.0 <= value < np.inf]
        if wrong:
            raise SignalError(f"the relative sigma of {', '.join(wrong)} is negative or not finite; give zero or more")
        sigma = np.empty_like(self.chi)
        for index, link in enumerate(self.links):
            chi = self.chi[10 * index : 10 * index + 10]
            mass, half_trace = chi[0], 0.5 * (chi[4] + chi[6] + chi[9])
            length = np.sqrt(half_trace / mass) if mass > 0.0 else 0.0
            scale = np.array([mass, *[mass * length] * 3, *[half_trace] * 6])
            sigma[10 * index : 10 * index + 10] = relative[link] * scale
        return sigma

    def _who_lacks(self, relative: dict[str, float]) -> str:
        """Which links have no sigma, and which names are of no link."""
        said = ["give a relative sigma for each of the links with inertia and for nothing else"]
        if lacking := [link for link in self.links if link not in relative]:
            said.append(f"none is given of {', '.join(lacking)}: give each, 1.0 where nothing is known")
        if unknown := [link for link in relative if link not in self.links]:
            said.append(f"{', '.join(unknown)} is none of {', '.join(self.links)}: take it out, or correct the name")
        return "; ".join(said)
