"""Corrections of the instruments, kind by kind, against the sigmas that are stated for them.

Under the stated sigmas s the fitted corrections c, of covariance P, are ``c ~ N(0, diag(s^2) - P)`` (the difference of
an efficient estimate and its prior; Hausman, Econometrica 46, 1978). Each kind is tested by itself, and the mean of its
axes too, as a reference voltage changes them alike: where the flight hardly tells a correction, c stays within s
whatever the error is, and a sum over all corrections hides it. A scale of DYMAFLEX's accelerometer that is common to
its axes moves the mass by half of it, and c by a fortieth: 5 % are corrected by less than one sigma, and found by four
to six. The flight is then fitted again with that kind hardly bound, as widens the interval of the mass by a quarter.
Errors of links and joints are tested together in the directions that the flight tells of, which are some seventy of
more than a hundred.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.dynamics.model.inertia import elements
from onboard.dynamics.model.payload import body_jacobian
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.estimation.maximum_likelihood import inverse_of
from onboard.estimation.policy import DOUBT, chance_text
from onboard.identification.exiddm.prediction.further import FurtherCell, instrument_of
from onboard.identification.exiddm.prediction.joint_noise import NOISE_KEY
from onboard.identification.leaning import Causes
from onboard.identification.whole_flight.blocks import FlightFit, total_of
from onboard.identification.whole_flight.chance import Chance, squares_of
from onboard.identification.whole_flight.fit import WholeFlight

KINDS = (
    "gyro_scale",
    "gyro_misalignment_rad",
    "gyro_cross_axis",
    "accelerometer_scale",
    "accelerometer_misalignment_rad",
    "accelerometer_cross_axis",
    "mounting_rad",
    "place",
    "delay_s",
)
KINDS_OF_CELL = ("scale", "delay_s")
_FREE = 10.0  # times its stated sigma
_TOLD = 0.005  # share of a correction's variance that the flight takes away, in a direction that is tested


@dataclass(frozen=True)
class CorrectionKind(Chance):
    """A kind of correction of an instrument."""

    device: int  # its number in the predictor, 0: the first IMU
    of: str  # its name
    name: str  # of :data:`KINDS` or :data:`KINDS_OF_CELL`
    common: bool  # the mean of its axes
    parameters: IndexArray

    @property
    def unlikely(self) -> bool:
        """Whether it is to be fitted freely."""
        return self.chance < DOUBT

    @property
    def text(self) -> str:
        """``accelerometer_scale of the IMU, common to its axes, is not as stated (chance 3e-05)``."""
        which = f"{self.name} of {self.of}{', common to its axes,' if self.common else ''}"
        return f"{which} is not as stated ({chance_text(self.chance)})"


def kinds_of(flight: WholeFlight, found: FlightFit) -> list[CorrectionKind]:
    """Every kind of the instruments that take part that has a stated sigma, the least likely first.

    Args:
        flight: that was fitted, with the sigmas as they are stated.
        found: its fit.
    """
    own: dict[tuple[int, str], list[int]] = {}
    for place, parameter in enumerate(found.names):
        device, correction = instrument_of(parameter, flight.further)
        axis = correction[-2:] in ("_x", "_y", "_z")
        own.setdefault((device, correction[:-2] if axis else correction), []).append(place)
    made = []
    for device, of in enumerate(("the IMU", *(one.name for one in flight.further))):
        if device not in flight.devices:
            continue
        is_cell = device and isinstance(flight.further[device - 1], FurtherCell)
        for name in KINDS_OF_CELL if is_cell else KINDS:
            at = np.array(own.get((device, name), []), np.intp)
            scaled, told = _scaled(flight, found, at)
            sums = [np.eye(at.size), np.full((at.size, 1), at.size**-0.5)] if at.size > 1 else [np.eye(at.size)]
            for common, along in enumerate(sums if at.size else []):
                squares, freedom = squares_of(along.T @ scaled, along.T @ told @ along, _TOLD)
                made.append(CorrectionKind(squares, freedom, device, of, name, bool(common), at))
    return sorted(made, key=lambda one: one.chance)


def bodies_of(flight: WholeFlight, found: FlightFit) -> Chance:
    """Errors of links, joints and thrusters together, in the directions that the flight tells of.

    Args:
        flight: that was fitted, with the sigmas as they are stated.
        found: its fit.
    """
    scaled, told = _scaled(flight, found, flight.of_bodies)
    return Chance(*squares_of(scaled, told, _TOLD))


def _scaled(flight: WholeFlight, found: FlightFit, at: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Corrections in their stated sigmas, (k,), and the covariance that these should have, (k, k)."""
    sigma, P = flight.sigma[at], found.fit.covariance[np.ix_(at, at)]
    doubt = found.correction.sigma[at] / sigma
    return found.fit.x[at] / sigma, np.eye(at.size) - P / np.outer(sigma, sigma) + np.outer(doubt, doubt)


def freely(flight: WholeFlight, found: FlightFit, kinds: Sequence[CorrectionKind]) -> FlightFit:
    """The fit once more, with the unlikely kinds hardly bound by what is stated; the same fit where there are none.

    Args:
        flight: that was fitted; its sigmas of these kinds are changed.
        found: its fit.
        kinds: that it found.

    Raises:
        ConvergenceError, SingularError: as :meth:`WholeFlight.fit`.
    """
    unlikely = [one.parameters for one in kinds if one.unlikely]
    if not unlikely:
        return found
    flight.widen(np.concatenate(unlikely), _FREE)
    return flight.fit_again(found)


def bound_of(flight: WholeFlight, found: FlightFit) -> FloatArray:
    """Cramér-Rao: the least sigmas of the payload's ten numbers at the noise and the sigmas that are stated, (10,).

    By the information of all rows that were used, at the estimate. Where a kind was fitted freely, the sigmas of the
    fit are wider than that.

    Args:
        flight: that was fitted.
        found: its fit.

    Raises:
        SingularError: rows and stated sigmas leave a parameter undetermined.
    """
    rows = total_of(found.blocks, len(found.names)).information
    covariance = inverse_of(rows + np.diag(np.nan_to_num(1.0 / flight.stated**2)))
    D = body_jacobian(found.chi)
    return np.asarray(np.sqrt(np.diag(D @ covariance[:10, :10] @ D.T)), np.float64)


def leans_on(flight: WholeFlight, found: FlightFit) -> tuple[str, ...]:
    """The stated sigmas that each of the payload's ten numbers depends on, with the effect of one sigma.

    See :mod:`onboard.identification.leaning`.

    Args:
        flight: that was fitted.
        found: its fit.
    """
    D = np.zeros((10, found.fit.x.size))
    D[:, :10] = body_jacobian(found.chi)
    keys = [*[""] * 10, *(flight.key_of(name) for name in found.names[10:])]
    sigma = np.sqrt(np.diag(found.payload.covariance))
    body = found.payload.body
    size = np.abs([body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)])
    causes = Causes(keys, flight.sigma, [NOISE_KEY])
    effects = causes.effects(D @ found.fit.covariance)
    effects[:, -1] = np.abs(D @ found.correction.sigma)
    return causes.said(effects, sigma, size)
