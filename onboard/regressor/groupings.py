"""Symbolic groupings of base parameters: ``ZZ3R = ZZ3 + Ia3 + (M4 + M5) L3^2``.

A coefficient in a grouping is a homogeneous polynomial in the distances between joints: of degree two for masses in
inertias, of degree one for masses in first moments, and so on. It is identified by computing the same base parameters
for vehicles of other, random proportions and fitting the polynomial to all of them (derived here). Coefficients that
are no polynomial (frames at other angles, ratios of lengths) remain numbers with units.

Links are numbered by the joint that moves them, 0 for the base; bodies fixed to a link keep their names.
"""

import copy
from collections.abc import Iterator
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from onboard.dynamics.model.tree import tree_of
from onboard.dynamics.model.vehicle import FREE_FLYER_NV, STANDARD, VehicleModel
from onboard.estimation.arrays import FloatArray, eigen
from onboard.regressor.base_parameters import BaseParameters, SampledMotion, grouping_of, sampled_rows
from onboard.regressor.rows import RowModel

_SEED = 20260810
_MORE = 8  # proportions beyond those that determine a polynomial: they tell whether it is one
_EXACT = 1e-6
_DIGITS = 4
_SIGN = {False: "+", True: "-"}
_DEGREE = {"M": 0, "MX": 1, "MY": 1, "MZ": 1, **dict.fromkeys(STANDARD[4:], 2), "Ia": 2}  # powers of a length


class Length(NamedTuple):
    """A distance that occurs in coefficients."""

    symbol: str
    value_m: float
    meaning: str


class Groupings(NamedTuple):
    """A vehicle's base parameters in symbols."""

    names: tuple[str, ...]  # (p,) ``ZZ3R``: the ``R`` marks a regrouped one
    sums: tuple[str, ...]  # (p,) ``ZZ3 + Ia3 + (M4 + M5) L3^2``
    lengths: tuple[Length, ...]  # those that occur
    links: dict[str, str]  # what a number or name stands for, in the order of the links

    @property
    def lines(self) -> tuple[str, ...]:
        """``ZZ3R = ZZ3 + ...`` for regrouped parameters, the name alone for others."""
        return tuple(f"{n} = {s}" if n != s else n for n, s in zip(self.names, self.sums, strict=True))


class _Factor(NamedTuple):
    text: str  # without a sign; empty for one
    minus: bool
    degree: int  # in lengths


class _Place(NamedTuple):
    """A translation in the Pinocchio model that may be stretched: of a moving joint, or of a frame on a rigid body."""

    joint: int
    frames: tuple[int, ...]  # none: the joint's placement
    axis: int
    length: Length


def groupings(
    model: RowModel, base: BaseParameters, motion: SampledMotion | None = None, released: bool | None = None
) -> Groupings:
    """Writes base parameters with symbols for the vehicle's distances.

    Args:
        model: the rows.
        base: their base parameters.
        motion: as in :func:`onboard.regressor.base_parameters.base_parameters`.
        released: likewise.
    """
    vehicle = model.vehicle
    tags = _tags(vehicle)
    short = tuple(_short(name, tags) for name in base.standard_names)
    rng = np.random.default_rng(_SEED)
    places = _places(model)
    monomials = [m for degree in (0, 1, 2) for m in combinations_with_replacement(range(len(places)), degree)]
    where = np.argwhere(_regrouped(base))  # (c, 2)
    stretch = rng.uniform(0.6, 1.5, (len(monomials) + _MORE, len(places)))
    stretch[0] = 1.0
    seen = np.array([_coefficients(model, places, one, base, motion, released, where) for one in stretch])  # (s, c)
    value = np.array([place.length.value_m for place in places])
    symbols = [place.length.symbol for place in places]
    written: dict[tuple[int, int], _Factor] = {}
    used: set[str] = set()
    for column, (row, other) in enumerate(where.tolist()):
        degree = _power(base.names[row]) - _power(base.standard_names[other])
        terms = _polynomial(stretch * value, seen[:, column], degree)
        unit = _unit(base.names[row], base.standard_names[other])
        text = f"{seen[0, column]:.{_DIGITS}g}{unit}" if terms is None else _factor(terms, symbols)
        written[row, other] = _Factor(text.removeprefix("-"), text.startswith("-"), degree)
        used |= {symbols[k] for m in terms or () for k in m}
    names, sums = [], []
    for row, own in enumerate(base.independent):
        mine = {short[other]: factor for (line, other), factor in written.items() if line == row}
        names.append(short[own] + ((("_" if "_" in short[own] else "") + "R") if mine else ""))
        sums.append(_sum(short[own], mine))
    lengths = tuple(place.length for place in places if place.length.symbol in used)
    return Groupings(tuple(names), tuple(sums), lengths, {tags[link].lstrip("_"): link for link in vehicle.links})


def _tags(vehicle: VehicleModel) -> dict[str, str]:
    """What is written after ``ZZ`` for each link: its joint's number, or ``_name`` where it is fixed to another."""
    tags = {}
    for link in vehicle.links:
        frame = vehicle.model.frames[vehicle.frame_id(link)]
        own = frame.parentFrame == 0 or vehicle.model.frames[frame.parentFrame].type == pin.FrameType.JOINT
        tags[link] = str(frame.parentJoint - 1) if own else f"_{link}"
    for number, joint in enumerate(vehicle.joints, 1):
        tags.setdefault(joint.name, str(number))
    return tags


def _short(name: str, tags: dict[str, str]) -> str:
    kind, _, owner = name.partition("_")
    return kind + tags[owner] if owner in tags else name


def _places(model: RowModel) -> list[_Place]:
    """Every distance that the rows may depend on; of the base none: all distances are from it."""
    vehicle, pinocchio = model.vehicle, model.vehicle.model
    found = []
    for joint in range(2, pinocchio.njoints):
        found += list(
            _axes(pinocchio.jointPlacements[joint], joint, (), str(joint - 1), f"to {pinocchio.names[joint]}")
        )
    for name in dict.fromkeys((*vehicle.links, *(row.frame for row in model.rows))):
        frame = vehicle.frame_id(name)
        at = pinocchio.frames[frame]
        if at.type != pin.FrameType.JOINT:
            found += list(_axes(at.placement, at.parentJoint, (frame,), f"_{name}", f"to {name}"))
    return found


def _axes(placement: pin.SE3, joint: int, frames: tuple[int, ...], tag: str, meaning: str) -> Iterator[_Place]:
    along = [axis for axis in range(3) if abs(placement.translation[axis]) > 1e-9]
    for axis in along:
        letter = "xyz"[axis]
        symbol = f"L{tag}" if len(along) == 1 else f"L{tag}{'_' if '_' in tag else ''}{letter}"
        value = float(placement.translation[axis])
        yield _Place(joint, frames, axis, Length(symbol, value, f"{meaning}, along {letter}"))


def _stretched(model: RowModel, places: list[_Place], factors: FloatArray) -> RowModel:
    """The same rows of a vehicle of other proportions."""
    vehicle = copy.copy(model.vehicle)
    vehicle.model = model.vehicle.model.copy()
    for place, factor in zip(places, factors, strict=True):
        placements = (
            [vehicle.model.frames[frame].placement for frame in place.frames]
            if place.frames
            else [vehicle.model.jointPlacements[place.joint]]
        )
        for placement in placements:
            translation = placement.translation.copy()
            translation[place.axis] *= factor
            placement.translation = translation
    vehicle.tree = tree_of(vehicle.model, vehicle.joints, vehicle.links)
    return RowModel(vehicle, model.rows, any(name == "zero_force_x" for name in model.names), model.motors)


def _coefficients(
    model: RowModel,
    places: list[_Place],
    factors: FloatArray,
    base: BaseParameters,
    motion: SampledMotion | None,
    released: bool | None,
    where: NDArray[np.int64],
) -> FloatArray:
    stretched = _stretched(model, places, factors)
    spec = model.vehicle.spec
    allowed = SampledMotion.of(spec.base, spec.gravity_m_s2) if motion is None else motion
    let_go = spec.payload_link is not None if released is None else released
    ticks = 2 * len(model.names) // max(1, len(model.rows)) + 2 * FREE_FLYER_NV
    W = sampled_rows(stretched, np.random.default_rng(_SEED), 2 * ticks, allowed, let_go)
    grouping = grouping_of(W, base.independent)
    return np.asarray(grouping[where[:, 0], where[:, 1]], np.float64)


def _regrouped(base: BaseParameters) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = base.grouping != 0.0
    found[np.arange(len(base.names)), base.independent] = False
    return found


def _power(name: str) -> int:
    return _DEGREE.get(name.split("_", 1)[0], -9)


def _unit(row: str, column: str) -> str:
    """Of a coefficient that no length explains; what is neither mass nor inertia has units of its own."""
    if min(_power(row), _power(column)) < 0:
        return ""
    return {0: "", 1: " m", 2: " m^2", -1: " /m", -2: " /m^2"}[_power(row) - _power(column)]


def _polynomial(lengths: FloatArray, seen: FloatArray, degree: int) -> dict[tuple[int, ...], float] | None:
    """The homogeneous polynomial in the lengths (s, k) that has the values ``seen`` (s,): factors by monomial."""
    if not 0 <= degree <= 2:
        return None
    monomials = list(combinations_with_replacement(range(lengths.shape[1]), degree))
    which = np.array(monomials, np.intp).reshape(len(monomials), degree)
    values = lengths[:, which].prod(axis=2)  # (s, m)
    scale = np.abs(values).max(axis=0)
    found = np.linalg.lstsq(values / scale, seen)[0]
    if np.abs(values / scale @ found - seen).max() > _EXACT * np.abs(seen).max():
        return None
    kept = np.abs(found) > _EXACT * np.abs(seen).max()
    return {monomials[k]: _round(found[k] / scale[k]) for k in np.flatnonzero(kept)}


def _round(c: float) -> float:
    return round(c) if abs(c - round(c)) < 1e-6 else float(c)


def _factor(terms: dict[tuple[int, ...], float], symbols: list[str]) -> str:
    """The polynomial as a factor that may stand before a parameter; a perfect square is written as one."""
    if set(terms) == {()}:
        return _number(terms[()])
    sign = -1.0 if all(c < 0.0 for c in terms.values()) else 1.0
    terms = {m: sign * c for m, c in terms.items()}
    minus = "-" if sign < 0.0 else ""
    if len(terms) == 1:
        ((m, c),) = terms.items()
        return minus + _number(c, before=True) + _monomial(m, symbols)
    root = _square_root(terms)
    if root is not None:
        return f"{minus}({_joined(root, symbols)})^2"
    common = abs(next(iter(terms.values())))
    if common != 1.0 and all(abs(abs(c) - common) < 1e-9 for c in terms.values()):
        return f"{minus}{_number(common, before=True)}({_joined({m: c / common for m, c in terms.items()}, symbols)})"
    return f"{minus}({_joined(terms, symbols)})"


def _square_root(terms: dict[tuple[int, ...], float]) -> dict[tuple[int, ...], float] | None:
    if not all(len(m) == 2 for m in terms):
        return None
    which = sorted({k for m in terms for k in m})
    A = np.zeros((len(which), len(which)))
    for (i, j), c in terms.items():
        A[which.index(i), which.index(j)] += 0.5 * c
        A[which.index(j), which.index(i)] += 0.5 * c
    values, vectors = eigen(A)
    if len(which) < 2 or np.abs(values[:-1]).max() > 1e-9 * values[-1]:
        return None
    root = vectors[:, -1] * np.sqrt(values[-1])
    root *= np.sign(root[np.abs(root) > 1e-9][0])
    return {(k,): _round(c) for k, c in zip(which, root, strict=True)}


def _joined(terms: dict[tuple[int, ...], float], symbols: list[str]) -> str:
    text = ""
    for m, c in terms.items():
        sign = (" - " if c < 0.0 else " + ") if text else ("-" if c < 0.0 else "")
        text += sign + _number(abs(c), before=True) + _monomial(m, symbols)
    return text


def _monomial(m: tuple[int, ...], symbols: list[str]) -> str:
    return " ".join(f"{symbols[k]}^2" if m.count(k) == 2 else symbols[k] for k in dict.fromkeys(m))


def _number(c: float, before: bool = False) -> str:
    """A factor: nothing for one, a sign for minus one."""
    if abs(c) == 1.0:
        return "-" if c < 0.0 else ""
    return f"{c:.{_DIGITS}g}" + (" " if before else "")


def _sum(own: str, others: dict[str, _Factor]) -> str:
    """``own`` and the others, those with the same factor in brackets before it: ``(M4 + M5) L3^2``."""
    groups: dict[str, dict[str, _Factor]] = {}
    for name, factor in sorted(others.items(), key=lambda one: one[1].degree):
        groups.setdefault(factor.text, {})[name] = factor
    text = own
    for factor_text, members in groups.items():
        if not factor_text:
            text += "".join(f" {_SIGN[factor.minus]} {name}" for name, factor in members.items())
            continue
        (first, outer), *rest = members.items()
        inner = first + "".join(f" {_SIGN[factor.minus != outer.minus]} {name}" for name, factor in rest)
        inner = f"({inner})" if rest else inner
        both = f"{inner} {factor_text}" if factor_text[0] in "L(" else f"{factor_text} {inner}"
        text += f" {_SIGN[outer.minus]} {both}"
    return text
