"""Reported quantities: linear combinations of base parameters, and their estimates."""

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.linalg import block_diag

from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_of, standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.gates import GateReason
from onboard.estimation.policy import wider
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import BaseMotion, RowModel, joint_torque_row

# A rigid body's ten numbers: mass, centre of mass, inertia about it, in one frame's axes.
BODY = ("m", "c_x", "c_y", "c_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
BODY_UNITS = ("kg", *["m"] * 3, *["kg m^2"] * 6)

Numbers = TypeVar("Numbers", float, FloatArray)

_IN_JSON = ("name", "unit", "value", "sigma", "low", "high", "supported", "bound", "leans")
MOST_ALSO = 6  # quantities of an Estimate that are not asked for
# A quantity is reported when the data determine it:
SUPPORTED_SHRINKAGE = 0.2
"""Posterior over prior sigma at most: the prior's weight in the estimate is this squared, a 25th. Part of an interval
by one cause, from which on it is named: as much of its variance."""
SUPPORTED_FREEDOM = 1.5  # at least so many independent blocks of time, less one, carry the information


class DrawingTolerance(NamedTuple):
    """How far a link may be from its drawing, one sigma each."""

    mass: float = 0.03  # relative
    centre_m: float = 1e-3  # of each coordinate of its centre of mass
    inertia: float = 0.01  # of the inertia about it, relative, at the mass that it has
    length_m: float = 0.00025  # of each coordinate of its frame's place beyond the joint


class Leaning(NamedTuple):
    """What of a quantity comes from the drawing."""

    cause: str
    weights: FloatArray  # (p,): times the base parameters, the standard deviation that the drawing's tolerance makes


class Quantity(NamedTuple):
    """A linear combination of base parameters to be reported."""

    name: str
    unit: str
    weights: FloatArray  # (p,)
    note: str = ""
    leanings: tuple[Leaning, ...] = ()
    known: tuple[float, float] | None = None  # from the drawing, with its sigma: a witness, no prior


def outer_of(mean: Numbers, low: Numbers, high: Numbers) -> tuple[Numbers, Numbers]:
    """Ends of the 99.9 % interval of a normal by those of 95 %, a number or (n,) each."""
    return mean - wider() * (mean - low), mean + wider() * (high - mean)


class QuantityEstimate(NamedTuple):
    """A quantity with its interval; numbers are NaN where the data do not support it."""

    name: str
    unit: str
    value: float
    sigma: float
    low: float
    high: float
    supported: bool
    bound: float = math.nan  # Cramer-Rao: the least sigma that the motion flown allows, at the stated noise
    leans: str = ""  # on which stated sigmas, where these make up a good part of its own
    own_outer: tuple[float, float] | None = None  # ends of the 99.9 % interval, where it is not that of a normal
    shrinkage: float = math.nan  # posterior sigma over prior sigma
    note: str = ""
    drawn: float = 0.0  # part of sigma that comes from the drawing's tolerances

    @property
    def half(self) -> float:
        """The longer side of its interval."""
        return max(self.high - self.value, self.value - self.low)

    @property
    def outer(self) -> tuple[float, float]:
        """Ends of its 99.9 % interval."""
        return outer_of(self.value, self.low, self.high) if self.own_outer is None else self.own_outer

    def as_json(self) -> dict[str, Any]:
        """Plain values of an answer of ``heft identify``, None for NaN."""
        low, high = self.outer
        told = {key: getattr(self, key) for key in _IN_JSON} | {"low_999": low, "high_999": high}
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in told.items()}


class Findings(NamedTuple):
    """What is to be said of all answers that their intervals do not show."""

    against: tuple[str, ...] = ()  # they are not to be used
    doubts: tuple[str, ...] = ()  # they are weak
    widened: tuple[str, ...] = ()  # of what is stated less is taken for granted, and their intervals are as wide

    def plus(self, against: Iterable[str] = (), doubts: Iterable[str] = ()) -> "Findings":
        """These and more."""
        return self._replace(against=(*self.against, *against), doubts=(*self.doubts, *doubts))


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
    also: tuple[QuantityEstimate, ...] = ()  # of how a captured body came; from its capture on, at most MOST_ALSO


def inertia_about_joint(vehicle: VehicleModel, joint: str) -> FloatArray:
    """Each link's part of the inertia about a joint, as a functional of the standard parameters, (links, P).

    The torque of unit joint acceleration with all else at rest, joints at zero (Limparis 2.132): ``row[l] @ chi``
        is the inertia of link l about the joint's axis, kg m^2 (its mass for a prismatic joint).

    Args:
        vehicle: the model.
        joint: by name.

    Raises:
        UnknownFrameError: no such joint.
    """
    model = RowModel(vehicle, [joint_torque_row(vehicle, joint, friction=False)])
    ddq = np.zeros((1, len(vehicle.joints)))
    ddq[0, vehicle.joints.index(vehicle.joint(joint))] = 1.0
    still = np.zeros((1, 3))
    row = model.regressor(np.zeros_like(ddq), np.zeros_like(ddq), ddq, BaseMotion(still, still, still))[0, 0]
    return block_diag(*row.reshape(-1, 10))


def mass_quantities(
    model: RowModel,
    base: BaseParameters,
    joint: str,
    arm_link: str,
    tolerances: Mapping[str, DrawingTolerance] = MappingProxyType({}),
) -> tuple[Quantity, ...]:
    """Inertias about the joint, and the masses that follow with the nominal geometry (Limparis 4.6).

    A single joint's motion shows inertia, not mass: ``m = ZZ / k^2`` with k the radius of gyration of the link about
    the joint's axis, from the URDF. In order: ``ZZ_R`` held and released; arm, arm + payload, payload (masses). None of
    the masses follows from ``ZZ_R`` held alone: that needs the ratio of the two masses, and the payload is unknown.

    Args:
        model: the rows.
        base: their base parameters.
        joint: about which the inertias are.
        arm_link: the link that stays.
        tolerances: of the drawing, by link; :class:`DrawingTolerance`'s own where not given.

    Raises:
        UnknownFrameError: no payload link, or a name that the URDF does not have.
        SignalError: the rows can never tell these inertias, or a link weighs nothing in the URDF.
    """
    vehicle = model.vehicle
    payload = vehicle.spec.payload_link
    if payload is None or arm_link not in vehicle.links:
        raise UnknownFrameError(f"masses need a payload link and a link {arm_link!r}; links are {vehicle.links}")
    parts = inertia_about_joint(vehicle, joint)
    of_links = list[tuple[FloatArray, FloatArray, tuple[Leaning, ...]]]()  # inertia, mass, and what this leans on
    for link in (arm_link, payload):
        index = vehicle.links.index(link)
        inertia = float(parts[index] @ vehicle.chi)
        mass = float(vehicle.chi[10 * index])
        if not (mass > 0.0 and inertia > 0.0):
            raise SignalError(f"link {link!r} has no mass or no inertia about {joint!r} in the URDF; masses need both")
        padded = np.zeros(len(model.names))
        padded[: parts.shape[1]] = parts[index]
        weights = base.weights(padded)
        tolerance, chi = tolerances.get(link, DrawingTolerance()), vehicle.chi[10 * index : 10 * index + 10]
        sigmas, by_mass = _gyration_sigma(parts[index], chi, 10 * index, tolerance), weights * mass / inertia
        leaning = tuple(Leaning(f"the {what} of {link}", by_mass * sigma) for what, sigma in sigmas.items())
        of_links.append((weights, by_mass, leaning))
    (arm, m_arm, of_arm), (tip, m_tip, of_tip) = of_links
    drawn, mass = "radii of gyration from the drawing", float(vehicle.chi[10 * vehicle.links.index(arm_link)])
    known = mass, mass * tolerances.get(arm_link, DrawingTolerance()).mass
    return (
        Quantity(f"ZZ_{joint}_R_held", "kg m^2", arm + tip),
        Quantity(f"ZZ_{joint}_R_released", "kg m^2", arm),
        Quantity(f"m_{arm_link}", "kg", m_arm, drawn, of_arm, known),
        Quantity(f"m_{arm_link}+m_{payload}", "kg", m_arm + m_tip, drawn, (*of_arm, *of_tip)),
        Quantity(f"m_{payload}", "kg", m_tip, drawn, of_tip),
    )


def _gyration_sigma(part: FloatArray, chi: FloatArray, first: int, tolerance: DrawingTolerance) -> dict[str, float]:
    """Relative sigma of a link's inertia about a joint at a given mass, by cause.

    Args:
        part: the inertia as a functional of all standard parameters, (P,).
        chi: the link's, (10,).
        first: the place of its mass among all.
        tolerance: of its drawing.
    """
    own = part[first : first + 10]
    body = body_of(chi)
    point = RigidBody(body.mass_kg, body.centre_of_mass_m, np.zeros((3, 3)))
    whole = float(own @ chi)
    step = 1e-6  # m; the inertia is quadratic in the centre, so central differences are exact
    moved = [
        [own @ standard_of(body._replace(centre_of_mass_m=body.centre_of_mass_m + way * unit)) for way in (step, -step)]
        for unit in np.eye(3)
    ]
    slope = np.array([(plus - minus) / (2.0 * step) for plus, minus in moved])
    about_centre = whole - float(own @ standard_of(point))
    moment = float(np.linalg.norm(slope)) / whole
    return {
        "centre of mass": moment * tolerance.centre_m,
        "place": moment * tolerance.length_m if own[1:4].any() else 0.0,  # none on the joint's axis
        "radius of gyration": abs(about_centre) * tolerance.inertia / whole,
    }
