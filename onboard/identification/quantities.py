"""Reported quantities: linear combinations of base parameters, and their estimates."""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.errors import SignalError, UnknownFrameError
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.gates import GateReason
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import BaseMotion, RowModel, joint_torque_row

# A rigid body's ten numbers: mass, centre of mass, inertia about it, in one frame's axes.
BODY = ("m", "c_x", "c_y", "c_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
BODY_UNITS = ("kg", *["m"] * 3, *["kg m^2"] * 6)

# A quantity is reported when the data determine it:
SUPPORTED_SHRINKAGE = 0.2  # posterior over prior sigma at most; the prior's weight in the estimate is this squared
SUPPORTED_FREEDOM = 1.5  # at least so many independent blocks of time, less one, carry the information


class Quantity(NamedTuple):
    """A linear combination of base parameters to be reported."""

    name: str
    unit: str
    weights: FloatArray  # (p,)
    note: str = ""


class QuantityEstimate(NamedTuple):
    """A quantity with its interval; NaN where the data do not support it."""

    name: str
    unit: str
    mean: float
    sigma: float
    low: float
    high: float
    shrinkage: float  # posterior sigma over prior sigma
    supported: bool
    note: str


class Estimate(NamedTuple):
    """Estimate after the rows so far."""

    names: tuple[str, ...]  # of the base parameters
    mean: FloatArray  # (p,)
    sigma: FloatArray  # (p,)
    low: FloatArray  # (p,)
    high: FloatArray  # (p,)
    supported: BoolArray  # (p,)
    quantities: tuple[QuantityEstimate, ...]
    rows_used: int
    refused: dict[GateReason, int]  # rows by reason; a row with two reasons counts in both


def inertia_about_joint(vehicle: VehicleModel, joint: str, q: FloatArray | None = None) -> FloatArray:
    """Each link's part of the inertia about a joint, as a functional of the standard parameters, (links, P).

    The torque of unit joint acceleration with all else at rest (Limparis 2.132): ``row[l] @ chi`` is the inertia of
        link l about the joint's axis, kg m^2 (its mass for a prismatic joint).

    Args:
        vehicle: the model.
        joint: by name.
        q: joint positions, (joints,); zero where not given.

    Raises:
        UnknownFrameError: no such joint.
    """
    model = RowModel(vehicle, [joint_torque_row(vehicle, joint, friction=False)])
    ddq = np.zeros((1, len(vehicle.joints)))
    ddq[0, vehicle.joints.index(vehicle.joint(joint))] = 1.0
    still = np.zeros((1, 3))
    at = np.zeros_like(ddq) if q is None else np.asarray(q, np.float64).reshape(1, -1)
    row = model.regressor(at, np.zeros_like(ddq), ddq, BaseMotion(still, still, still))[0, 0]
    parts = np.zeros((len(vehicle.links), row.size))
    for link in range(len(vehicle.links)):
        parts[link, 10 * link : 10 * link + 10] = row[10 * link : 10 * link + 10]
    return parts


def mass_quantities(model: RowModel, base: BaseParameters, joint: str, arm_link: str) -> tuple[Quantity, ...]:
    """Inertias about the joint, and the masses that follow with the nominal geometry (Limparis 4.6).

    A single joint's motion shows inertia, not mass: ``m = ZZ / k^2`` with k the radius of gyration of the link about
    the joint's axis, from the URDF. In order: ``ZZ_R`` held and released; arm, arm + payload, payload (masses); and arm
    + payload from ``ZZ_R`` held alone, which needs no rows without the payload but uses the nominal *ratio* of the two
    masses.

    Args:
        model: the rows.
        base: their base parameters.
        joint: about which the inertias are.
        arm_link: the link that stays.

    Raises:
        UnknownFrameError: no payload link, or a name that the URDF does not have.
        SignalError: the rows can never tell these inertias, or a link weighs nothing in the URDF.
    """
    vehicle = model.vehicle
    payload = vehicle.spec.payload_link
    if payload is None or arm_link not in vehicle.links:
        raise UnknownFrameError(f"masses need a payload link and a link {arm_link!r}; links are {vehicle.links}")
    parts = inertia_about_joint(vehicle, joint)
    functionals = []
    masses = []
    for link in (arm_link, payload):
        index = vehicle.links.index(link)
        inertia = float(parts[index] @ vehicle.chi)
        mass = float(vehicle.chi[10 * index])
        if not (mass > 0.0 and inertia > 0.0):
            raise SignalError(f"link {link!r} has no mass or no inertia about {joint!r} in the URDF; masses need both")
        padded = np.zeros(len(model.names))
        padded[: parts.shape[1]] = parts[index]
        functionals.append(base.weights(padded))
        masses.append((mass, inertia))
    (arm, tip), ((m_arm, zz_arm), (m_tip, zz_tip)) = functionals, masses
    both = (m_arm + m_tip) / (zz_arm + zz_tip)
    drawn = "radii of gyration from the drawing"
    return (
        Quantity(f"ZZ_{joint}_R_held", "kg m^2", arm + tip),
        Quantity(f"ZZ_{joint}_R_released", "kg m^2", arm),
        Quantity(f"m_{arm_link}", "kg", arm * m_arm / zz_arm, drawn),
        Quantity(f"m_{arm_link}+m_{payload}", "kg", arm * m_arm / zz_arm + tip * m_tip / zz_tip, drawn),
        Quantity(f"m_{payload}", "kg", tip * m_tip / zz_tip, drawn),
        Quantity(
            f"m_{arm_link}+m_{payload}_held", "kg", (arm + tip) * both, f"{drawn}, and the ratio of the two masses"
        ),
    )
