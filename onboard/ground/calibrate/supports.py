"""A part's centre of mass from a knife edge, two scales, or one under each of three supports; its mass from scales.

On an edge the vertical plane through it holds the centre of mass; on supports the weighted mean of their places is
below it. Each tells one or two coordinates, so a part is turned for the others; what stays untold is the drawing's.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field
from scipy.special import chdtrc

from onboard import config
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import LIKELY_SIZE, MOSTLY, REFUSE, of_each, sigmas
from onboard.flight.estimate.problem.model import build_model, drawn_body
from onboard.ground.calibrate.result import CalibratedNumber, Calibration, KeyChange, stated, two_digits
from onboard.section import NotNegative, Positive, Section, Vector3


class KnifeEdge(Section):
    """``[[edge]]``: the part balances on a knife edge through ``point_m`` along ``edge``; link axes."""

    up: Vector3
    edge: Vector3
    point_m: Vector3


class Scales(Section):
    """``[[scales]]``: what a scale reads under each of two or three supports, the part in one position; link axes."""

    up: Vector3
    supports_m: Annotated[list[Vector3], Field(min_length=2, max_length=3)]
    read_kg: Annotated[list[float] | None, Field(min_length=2, max_length=3)] = None


class PartRig(Section):
    """The rig file of a part."""

    place_sigma_m: Positive = 1e-4
    read_sigma_kg: Positive = 1e-4
    scale_relative: NotNegative = 1e-3
    edge: list[KnifeEdge] = Field(default_factory=list)
    scales: list[Scales] = Field(default_factory=list)


class _Row(NamedTuple):
    """A coordinate of the centre of mass along ``way`` (3,), m."""

    name: str
    way: FloatArray
    at_m: float
    sigma_m: float

    @property
    def text(self) -> str:
        """``edge 1: 1.07 +- 0.2 mm along (1.00, 0.00, 0.00)``."""
        sign = float(np.sign(self.way[int(np.abs(self.way).argmax())]))
        way = ", ".join(f"{sign * part + 0.0:.2f}" for part in self.way)
        return f"{self.name}: {1e3 * sign * self.at_m:.2f} +- {1e3 * self.sigma_m:.2g} mm along ({way})"


def part_rig(path: Path) -> PartRig | None:
    """Read a rig file; None where it has orientations on a load cell.

    Raises:
        ConfigError: it cannot be read or used.
    """
    said = config.read(path, "a rig file")
    tree = config.tree_of(said, str(path))
    if "edge" not in tree and "scales" not in tree:
        return None
    return config.validated(PartRig, tree, config.Origin(str(path), said))


def balance_part(vehicle: config.Vehicle, link: str, held: PartRig) -> Calibration:
    """Mass and centre of mass of a link.

    Args:
        vehicle: whose link it is.
        link: name of it.
        held: the rig, with what was read.

    Raises:
        CalibrationError: it does not tell, or contradicts itself or the drawing.
        ConfigError: no such link.
    """
    model = build_model(vehicle)
    if link not in model.links:
        raise config.ConfigError(f"{vehicle.label}: no link {link!r} with inertia; it has {', '.join(model.links)}")
    drawn = drawn_body(model, link)
    table, known = _stated(vehicle, link)
    rows = [*_edges(held), *_scales(held)]
    centre, covariance = _solved(rows, drawn.centre_of_mass_m, None if known is None else known.centre_m)
    sigma = np.sqrt(np.diag(covariance))
    result = Calibration(notes=[row.text for row in rows])
    _mass(result, held, link, float(drawn.mass_kg), known, table)
    result.add(f"centre of mass of {link}", centre, sigma, "m", drawn.centre_of_mass_m)
    result.changes.append(stated(("link", link), "centre_of_mass_m", centre, sigma))
    if known is None or table is None:
        result.notes.append(
            f"no key of {vehicle.label} takes the sigma of {link}'s centre: state [estimation.prior.link]"
        )
        return result
    result.changes.append(KeyChange(table, "centre_m", two_digits(float(sigma.max()))))
    if untold := ["xyz"[k] for k in range(3) if sigma[k] > MOSTLY * known.centre_m]:
        result.notes.append(
            f"{', '.join(untold)} of the centre was not measured: it is the drawing's, and centre_m stays as wide; "
            "turn the part and measure along it, too"
        )
    return result


class _Known(NamedTuple):
    """What the file states of a link, 1 sigma."""

    mass_relative: float
    centre_m: float


def _stated(vehicle: config.Vehicle, link: str) -> tuple[tuple[str, ...] | None, _Known | None]:
    """Table of the link's sigmas, and these."""
    estimation = vehicle.file.estimation
    if estimation.masses is not None and link in estimation.masses.drawing:
        own = estimation.masses.drawing[link]
        return ("estimation", "masses", "drawing", link), _Known(own.mass_relative, max(own.centre_m, 1e-9))
    if link in estimation.prior.link:
        prior = estimation.prior.link[link]
        return ("estimation", "prior", "link", link), _Known(prior.mass_relative, prior.centre_m)
    return None, None


def _unit(vector: Vector3, name: str) -> FloatArray:
    size = float(np.linalg.norm(vector))
    if not size > 0.0:
        raise CalibrationError(f"{name} has no direction; correct the rig file")
    return np.asarray(np.array(vector) / size, np.float64)


def _edges(held: PartRig) -> Iterator[_Row]:
    for number, one in enumerate(held.edge, 1):
        name = f"edge {number}"
        across = np.cross(_unit(one.up, f"{name}: up"), _unit(one.edge, f"{name}: edge"))
        sine = float(np.linalg.norm(across))
        if sine < MOSTLY:
            raise CalibrationError(f"{name}: the edge is to be level, and is along up; correct the rig file")
        yield _Row(name, across / sine, float(across / sine @ np.array(one.point_m)), held.place_sigma_m)


def _scales(held: PartRig) -> Iterator[_Row]:
    for number, one in enumerate(held.scales, 1):
        name = f"scales {number}"
        read = np.array(one.read_kg or [], np.float64)
        if len(read) != len(one.supports_m):
            raise CalibrationError(f"{name}: give read_kg, a number for each of {len(one.supports_m)} supports")
        least = sigmas(REFUSE) * held.read_sigma_kg
        if not read.sum() > least or read.min() < -least:
            raise CalibrationError(f"{name} reads {read.tolist()} kg; tare it, and check its unit and its sign")
        up, places = _unit(one.up, f"{name}: up"), np.array(one.supports_m, np.float64)
        level = np.eye(3) - np.outer(up, up)
        apart = (places - places.mean(axis=0)) @ level
        ways = np.linalg.svd(apart)[2][: len(read) - 1]
        spread = apart @ ways.T
        if np.linalg.svd(spread, compute_uv=False).min() < held.place_sigma_m / LIKELY_SIZE:
            raise CalibrationError(f"{name}: its supports lie in a line or above each other; put them apart")
        share = read / read.sum()
        for which, way in enumerate(ways):
            along = places @ way
            at = float(share @ along)
            lever = np.linalg.norm((along - at) / read.sum()) * held.read_sigma_kg
            sigma = float(np.hypot(lever, held.place_sigma_m * np.linalg.norm(share)))
            yield _Row(f"{name}{' ab'[which + 1] if len(ways) > 1 else ''}", way, at, sigma)


def _solved(rows: list[_Row], drawn: FloatArray, drawn_sigma_m: float | None) -> tuple[FloatArray, FloatArray]:
    """Centre and covariance, with the drawing where it is needed.

    Raises:
        CalibrationError: not determined, or a contradiction.
    """
    A = np.array([row.way / row.sigma_m for row in rows])
    b = np.array([row.at_m / row.sigma_m for row in rows])
    _, values, ways = np.linalg.svd(A)
    rank = int((values > 1e-3 * values.max()).sum())
    untold = ways[rank:]
    H, right = A.T @ A, A.T @ b
    if len(untold):
        if drawn_sigma_m is None:
            raise CalibrationError(
                "the centre is not determined in all three directions; turn the part, and measure again"
            )
        P = untold.T @ untold / drawn_sigma_m**2  # the drawing only there: it may come of such a measurement
        H, right = H + P, right + P @ drawn
    covariance = np.linalg.inv(H)
    centre = covariance @ right
    left, freedom = b - A @ centre, len(rows) - rank
    if freedom and chdtrc(freedom, float(left @ left)) < of_each(REFUSE):
        worst = rows[int(np.abs(left).argmax())].name
        raise CalibrationError(f"{worst} contradicts the others by {np.abs(left).max():.0f} sigmas; repeat it")
    if drawn_sigma_m is not None:
        off = A @ drawn - b
        spread = np.eye(len(rows)) + drawn_sigma_m**2 * (A @ A.T)
        squares = float(off @ np.linalg.solve(spread, off))
        if chdtrc(len(rows), squares) < of_each(REFUSE):
            culprit = rows[int(np.abs(off / np.sqrt(np.diag(spread))).argmax())]
            far = abs(float(culprit.way @ drawn) - culprit.at_m)
            raise CalibrationError(
                f"{culprit.name} puts the centre {1e3 * far:.2f} mm from its drawing, which is stated to "
                f"{1e3 * drawn_sigma_m:.2g} mm: check axes, sign and unit of the rig file, or state a wider centre_m"
            )
    return np.asarray(centre, np.float64), np.asarray(covariance, np.float64)


def _mass(
    result: Calibration, held: PartRig, link: str, drawn_kg: float, known: _Known | None, table: tuple[str, ...] | None
) -> None:
    """Mass from all scales, unless the file knows it better.

    Raises:
        CalibrationError: the scales contradict each other.
    """
    if not held.scales:
        return
    sums = np.array([sum(one.read_kg or []) for one in held.scales])
    own = held.read_sigma_kg * np.sqrt([len(one.supports_m) for one in held.scales])
    weight = own**-2.0 / (own**-2.0).sum()
    mass = float(weight @ sums)
    left = float((((sums - mass) / own) ** 2).sum())
    if len(sums) > 1 and chdtrc(len(sums) - 1, left) < of_each(REFUSE):
        worst = int(np.abs((sums - mass) / own).argmax())
        raise CalibrationError(f"scales {worst + 1} weighs {sums[worst]:.4g} kg, all together {mass:.4g} kg; repeat it")
    sigma = float(np.hypot((own**-2.0).sum() ** -0.5, held.scale_relative * mass))
    result.found.append(CalibratedNumber(f"mass of {link}", mass, sigma, "kg", drawn_kg))
    if known is not None and known.mass_relative * drawn_kg < sigma:
        result.notes.append("the file knows the mass better than these scales: it stays")
        return
    result.changes.append(stated(("link", link), "mass_kg", mass, sigma))
    if table is not None:
        result.changes.append(KeyChange(table, "mass_relative", two_digits(sigma / mass)))
