"""Reported quantities: linear combinations of base parameters, their estimates, what these are good for and lean on.

Whether an estimate is known well enough to be used is half its interval against a size. A mass or a moment of inertia
is held against itself, a product of inertia against the largest moment of its body, a coordinate of a centre of mass
against the size of the body: ``(|c|^2 + tr I / 2 m)^(1/2)``, the root mean square distance of its mass from the origin
of its frame. A body of which mass or inertia is not determined has no size, and its products and centre are not judged.
What is useful is stated by the user (``[estimation.useful]``).

An answer leans on those sigmas of the vehicle file that its own sigma would change with. A shift of a prior's mean by
one sigma s moves an estimate by its covariance P with that parameter over s; this is also what the prior adds to its
variance: ``dP / d(ln s) = 2 (P / s)^2``. Parameters of one key are summed as squares.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
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


def outer_of(mean: Numbers, low: Numbers, high: Numbers, far: Numbers | None = None) -> tuple[Numbers, Numbers]:
    """Ends of the 99.9 % interval by those of 95 %, a number or (n,) each; ``far``: times as wide, of no normal."""
    times = wider() if far is None else far
    return mean - times * (mean - low), mean + times * (high - mean)


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

    def as_far(self, far: float) -> "QuantityEstimate":
        """With a 99.9 % interval so many times as wide as the other."""
        return self._replace(own_outer=outer_of(self.value, self.low, self.high, far))

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
    far: FloatArray | None = None  # (p,) half of a 99.9 % interval over that of the other, where not that of a normal


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


_CENTRE, _MOMENTS, _PRODUCTS = ("c_x", "c_y", "c_z"), ("I_xx", "I_yy", "I_zz"), ("I_xy", "I_xz", "I_yz")


class Useful(NamedTuple):
    """Half an interval over what it is held against, at most; by default what a controller of the pair needs."""

    mass: float = 0.2
    moment: float = 0.2
    product: float = 0.2
    centre: float = 0.1


class Size(NamedTuple):
    """What half an interval is held against."""

    value: float
    share: float  # of it, at most
    what: str  # "it", "the body's size", "its largest moment"


def is_positive(name: str, unit: str) -> bool:
    """Whether a quantity is a mass or a moment of inertia, and no product of inertia."""
    return unit == "kg" or (unit == "kg m^2" and not name.startswith(_PRODUCTS))


def sizes(quantities: Iterable[QuantityEstimate], useful: Useful) -> dict[str, Size]:
    """By name, of the quantities that have one."""
    told = {one.name: one for one in quantities if one.supported}
    found = {
        name: Size(one.value, useful.mass if one.unit == "kg" else useful.moment, "it")
        for name, one in told.items()
        if is_positive(name, one.unit)
    }
    for name in [name for name in told if name.startswith(f"{BODY[0]}_")]:
        body = name.removeprefix(BODY[0])
        of = {kind: told.get(kind + body) for kind in BODY}
        moments = [one.value for kind in _MOMENTS if (one := of[kind]) is not None]
        if not moments:
            continue
        for kind in _PRODUCTS:
            found[kind + body] = Size(max(moments), useful.product, "its largest moment")
        centre = [one.value for kind in _CENTRE if (one := of[kind]) is not None]
        if len(moments) == 3 and sum(moments) > 0.0 < told[name].value:
            size = float(np.sqrt(np.dot(centre, centre) + sum(moments) / 2.0 / told[name].value))
            for kind in _CENTRE:
                found[kind + body] = Size(size, useful.centre, "the body's size")
    return found


def too_wide(one: QuantityEstimate, size: Size | None) -> str:
    """Why an answer is not known well enough; empty if it is, or has no size."""
    if size is None or one.half <= size.share * size.value:
        return ""
    return f"its interval is as wide as {one.half / size.value:.0%} of {size.what}"


MEASURED = "noise of what was measured, and scatter beyond it"


class Contribution(NamedTuple):
    """A part of an answer's sigma."""

    cause: str  # a key of vehicle.toml, or what the data leave
    sigma: float  # in the unit of the answer
    share: float  # of the variance


class Causes:
    """The keys that answers may lean on.

    Args:
        keys: of each parameter; empty for what has none.
        sigma: stated, of each parameter, (p,).
        further: keys of which no parameter is; the last ones.

    Attributes:
        names: of the c keys.
        at: of each parameter's key among these; -1 for none.
    """

    def __init__(self, keys: Sequence[str], sigma: FloatArray, further: Sequence[str] = ()) -> None:
        stated = [key if np.isfinite(s) and s > 0.0 else "" for key, s in zip(keys, sigma.tolist(), strict=True)]
        self.names = (*dict.fromkeys(key for key in stated if key), *further)
        self.at = np.array([self.names.index(key) if key else -1 for key in stated], np.intp)
        self._of = np.zeros((len(keys), len(self.names)))
        some = np.flatnonzero(self.at >= 0)
        self._of[some, self.at[some]] = 1.0 / sigma[some] ** 2

    def effects(self, along: FloatArray) -> FloatArray:
        """What one sigma of each key does to some answers, (k, c); zero of those of which no parameter is.

        Args:
            along: covariance of the answers with each parameter, (k, p).
        """
        return np.asarray(np.sqrt(along**2 @ self._of), np.float64)

    def said(self, effects: FloatArray, sigma: FloatArray, size: FloatArray, most: int = 3) -> tuple[str, ...]:
        """Of each answer the keys that make up a good part of its sigma, with their effects in per cent; else empty.

        Args:
            effects: of each key, (k, c).
            sigma: of the answers, (k,).
            size: that effects are shown over, (k,); over zero they are not shown.
            most: keys that are said.
        """
        found = []
        for each, one, whole in zip(effects, sigma.tolist(), size.tolist(), strict=True):
            large = [c for c in np.argsort(-each)[:most].tolist() if each[c] > SUPPORTED_SHRINKAGE * one]
            told = ", ".join(self.names[c] + (f" ({100.0 * each[c] / whole:.2g} %)" if whole else "") for c in large)
            found.append(f"leans on {told}" if told else "")
        return tuple(found)

    def budget(self, effects: FloatArray, sigma: FloatArray) -> tuple[tuple[Contribution, ...], ...]:
        """Of each answer what its sigma is made of, the largest first; arguments as of :meth:`said`."""
        rest = np.sqrt(np.maximum(sigma**2 - (effects**2).sum(axis=1), 0.0))
        every = zip(effects.tolist(), rest.tolist(), strict=True)
        return tuple(by_size(dict(zip((*self.names, MEASURED), (*each, left), strict=True))) for each, left in every)


def by_size(parts: Mapping[str, float]) -> tuple[Contribution, ...]:
    """Parts of a sigma by their cause, the largest first; empty where they are not known."""
    whole: FloatArray = np.array(list(parts.values())) ** 2
    if not np.isfinite(whole).all() or not whole.sum() > 0.0:
        return ()
    made = [Contribution(cause, sigma, sigma**2 / float(whole.sum())) for cause, sigma in parts.items() if sigma > 0.0]
    return tuple(sorted(made, key=lambda one: -one.sigma))
