"""Logs of a free body: load of each log, its estimate and truth, and calibration.

The vehicle file has the loads (``[[free_body.load]]``, matched by the log's name) and the carrier
(``[free_body.carrier]``). With throws of the carrier alone and of the proof body among the logs, these numbers are
re-estimated and printed as tables of the vehicle file.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from onboard import config
from onboard.config.bases.free_body import Carrier
from onboard.dynamics.model.inertia import RigidBody, elements, symmetric
from onboard.estimation.arrays import FloatArray
from onboard.identification.corrections import contradicted
from onboard.identification.quantities import SUPPORTED_SHRINKAGE, Estimate
from onboard.identification.rows import free_body
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.standard import LinkEstimate, whole_estimate


class LoadError(ValueError):
    """The load of a log is undefined or ambiguous."""


def plain(value: float) -> float | None:
    """None for NaN."""
    return value if math.isfinite(value) else None


@dataclass(frozen=True)
class Throw:
    """One log's load."""

    load: config.Load
    body: RigidBody | None  # in base axes; None if not determined
    principal: free_body.PrincipalMoments | None
    whole: LinkEstimate | None = None  # carrier and load, the rotors locked

    @property
    def error_percent(self) -> float | None:
        """Norm of the error of the principal moments over the norm of the true ones."""
        if self.principal is None or self.load.truth_kg_m2 is None:
            return None
        truth = np.sort(self.load.truth_kg_m2)
        return float(100.0 * np.linalg.norm(self.principal.moments - truth) / np.linalg.norm(truth))

    @property
    def covered(self) -> int | None:
        """How many of the three true moments lie in their intervals."""
        if self.principal is None or self.load.truth_kg_m2 is None:
            return None
        truth = np.sort(self.load.truth_kg_m2)
        return int(np.count_nonzero((self.principal.low <= truth) & (truth <= self.principal.high)))

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        made: dict[str, Any] = {"load": self.load.name, "role": self.load.role, "supported": self.body is not None}
        if self.body is not None and self.principal is not None:
            made["centre_of_mass_m"] = self.body.centre_of_mass_m.tolist()
            made["inertia_kg_m2"] = elements(self.body.inertia_kg_m2).tolist()
            made["principal_kg_m2"] = {
                field: getattr(self.principal, field).tolist() for field in self.principal._fields
            }
        if self.load.truth_kg_m2 is not None:
            made |= {"truth_kg_m2": sorted(self.load.truth_kg_m2), "truth_source": self.load.truth_source}
            made |= {"error_percent": self.error_percent, "covered": self.covered}
        return made


class LoadSummary(NamedTuple):
    """All throws of one load whose truth is known."""

    load: config.Load
    throws: int
    answered: int
    mean_percent: float
    worst_percent: float
    covered_percent: float  # of the true moments that lie in their intervals
    together: Throw | None = None  # all throws in one estimate, the errors of the instruments common to them

    @property
    def within_bars(self) -> bool | None:
        """Whether mean and worst error are accepted; None where the vehicle file sets no bars."""
        bars = self.load.bars_percent
        if bars is None:
            return None
        return self.answered == self.throws and self.mean_percent <= bars[0] and self.worst_percent <= bars[1]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "load": self.load.name,
            **{field: plain(getattr(self, field)) for field in self._fields[1:-1]},
            "together": None if self.together is None else self.together.as_json(),
            "bars_percent": self.load.bars_percent,
            "within_bars": self.within_bars,
        }


class ThrowCalibration(NamedTuple):
    """Calibration from throws of the carrier and of the proof body."""

    rotor: free_body.RotorCalibration
    carrier: free_body.KnownBody

    def as_toml(self) -> str:
        """The tables of the vehicle file; the rotors' inertia in the URDF is to be multiplied by the factor."""
        carrier = _carrier_keys(*self.carrier)
        carrier["mass_kg"] = float(f"{carrier['mass_kg']:g}")
        for key in ("centre_of_mass_m", "centre_of_mass_sigma_m", "inertia_kg_m2", "inertia_sigma_kg_m2"):
            digits = 2 if "sigma" in key else 4
            carrier[key] = [float(f"{value:.{digits}g}") for value in carrier[key]]
        return tomli_w.dumps({"free_body": {"rotor_sigma": float(f"{self.rotor.sigma:.2g}"), "carrier": carrier}})

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"rotor": self.rotor._asdict(), "carrier": _carrier_keys(*self.carrier)}


def _carrier_keys(body: RigidBody, sigma: FloatArray) -> dict[str, Any]:
    """Numbers of ``[free_body.carrier]``, sigmas (9,) of centre of mass and inertia."""
    return {
        "mass_kg": body.mass_kg,
        "centre_of_mass_m": body.centre_of_mass_m.tolist(),
        "centre_of_mass_sigma_m": sigma[:3].tolist(),
        "inertia_kg_m2": elements(body.inertia_kg_m2).tolist(),
        "inertia_sigma_kg_m2": sigma[3:].tolist(),
    }


def load_of(vehicle: config.Vehicle, log: Path) -> config.Load:
    """The load that flew in ``log``.

    Raises:
        LoadError: none of the vehicle file's loads, or more than one, is named by this log's name.
    """
    loads = vehicle.file.free_body.load if vehicle.file.free_body else []
    found = [load for load in loads if fnmatchcase(log.name, load.logs)]
    if len(found) == 1:
        return found[0]
    own = f'[[free_body.load]] with a name, logs = "{log.name}" and mass_kg, the whole as weighed without the carrier'
    if not loads:
        raise LoadError(f"{log}: {vehicle.path} does not say what it weighs; write {own} (docs/free_body.md)")
    known = ", ".join(f"{load.name} ({load.logs})" for load in found or loads)
    what, remedy = ("several loads", "") if found else ("no load", f", or write {own}")
    raise LoadError(
        f"{log}: {what} of {vehicle.path} by this name: {known}; rename the log, or correct its 'logs'{remedy}"
    )


def carrier_of(vehicle: config.Vehicle) -> free_body.KnownBody | None:
    """The carrier as the vehicle file has it."""
    carrier = vehicle.file.free_body.carrier if vehicle.file.free_body else None
    if carrier is None:
        return None
    inertia = symmetric(np.array(carrier.inertia_kg_m2))
    body = RigidBody(carrier.mass_kg, np.array(carrier.centre_of_mass_m), inertia)
    return free_body.KnownBody(body, np.array([*carrier.centre_of_mass_sigma_m, *carrier.inertia_sigma_kg_m2]))


def with_carrier(vehicle: config.Vehicle, load: config.Load, identifier: Identifier) -> config.Vehicle:
    """The vehicle with the carrier that its own logs show, in place of ``[free_body.carrier]``.

    Args:
        vehicle: says nothing of its carrier.
        load: the carrier alone.
        identifier: after its logs.
    """
    whole, section = free_body.whole_body(identifier, load.mass_kg), vehicle.file.free_body
    assert section is not None
    carrier = Carrier(**_carrier_keys(whole.body, whole.sigma))
    return vehicle.with_sections(free_body=section.model_copy(update={"carrier": carrier}))


def carriers(vehicle: config.Vehicle, loads: Mapping[Path, config.Load]) -> list[Path]:
    """Logs of the carrier alone that have to say what is subtracted from the others; none where the file says it.

    Raises:
        LoadError: a load on a carrier that neither the file nor a log shows.
    """
    section = vehicle.file.free_body
    if section is None or section.carrier is not None or "load" not in {load.role for load in loads.values()}:
        return []
    own = [log for log, load in loads.items() if load.role == "carrier"]
    if not own and (empty := [load for load in section.load if load.role == "carrier"]):
        log, load = next((log, load) for log, load in loads.items() if load.role == "load")
        raise LoadError(
            f"{log}: {load.name} is what is left without what carries it, which nothing shows: name a log of "
            f"{empty[0].name} ({empty[0].logs}) in the same command, or write [free_body.carrier] (docs/free_body.md)"
        )
    return own


def throw(vehicle: config.Vehicle, load: config.Load, identifier: Identifier) -> Throw:
    """What one log, or all logs of a load, say of it.

    Args:
        vehicle: its carrier is subtracted, unless the carrier is the load.
        load: what flew.
        identifier: after the logs.
    """
    section = vehicle.file.free_body
    assert section is not None
    # Few independent blocks of time give a wide but valid interval; the prior alone is not an estimate.
    estimated = identifier.estimate().quantities if identifier.rows_used else ()
    told = {q.name for q in estimated if q.shrinkage <= SUPPORTED_SHRINKAGE}
    if not set(free_body.FREE_BODY) <= told:
        return Throw(load, None, None)
    carrier = None if load.role == "carrier" else carrier_of(vehicle)
    mass = load.mass_kg + (carrier.body.mass_kg if carrier else 0.0)
    whole = free_body.whole_body(identifier, mass)
    found = free_body.without_carrier(whole, carrier, section.rotor_sigma)
    return Throw(load, *found, whole_estimate(vehicle.file.vehicle.base_link, whole, section.rotor_sigma))


def unlike_the_carrier(vehicle: config.Vehicle, load: config.Load, estimate: Estimate) -> tuple[str, ...]:
    """Reason to doubt a throw of the carrier alone: its body is not that of the vehicle file; empty where it is.

    No other witness has the signs of an accelerometer: with all turned, the centre of mass is on the other side.
    """
    carrier, section = carrier_of(vehicle), vehicle.file.free_body
    if carrier is None or section is None or load.role != "carrier":
        return ()
    known = [*carrier.body.centre_of_mass_m, *elements(carrier.body.inertia_kg_m2)]
    stated = dict(zip(free_body.FREE_BODY, zip(known, carrier.sigma, strict=True), strict=True))
    scale = dict.fromkeys(free_body.INERTIA, section.rotor_sigma)
    away = {}
    for one in estimate.quantities:
        if one.shrinkage <= SUPPORTED_SHRINKAGE:
            value, sigma = stated[one.name]
            spread = math.hypot(one.sigma, sigma, scale.get(one.name, 0.0) * value)
            away[f"{one.name} of the carrier"] = float(one.value - value) / spread
    return contradicted(away)


def summaries(throws: Sequence[Throw], together: Mapping[str, Throw]) -> list[LoadSummary]:
    """One for each load whose truth is known, in the order of the throws; ``together``: by load, of all its throws."""
    made = []
    for load in dict.fromkeys(throw.load.name for throw in throws if throw.load.truth_kg_m2 is not None):
        mine = [throw for throw in throws if throw.load.name == load]
        errors = [throw.error_percent for throw in mine if throw.error_percent is not None]
        inside = [throw.covered for throw in mine if throw.covered is not None]
        worst, mean = (max(errors), float(np.mean(errors))) if errors else (np.nan, np.nan)
        covered = 100.0 * sum(inside) / (3 * len(inside)) if inside else np.nan
        made.append(LoadSummary(mine[0].load, len(mine), len(errors), mean, worst, covered, together.get(load)))
    return made


def calibrate(vehicle: config.Vehicle, calibration: Mapping[str, Identifier]) -> ThrowCalibration | None:
    """The rotors and the carrier, from throws of known bodies only.

    Args:
        vehicle: gives the masses and the proof body.
        calibration: by role ("carrier", "proof"), an identifier that has seen all the throws of that role.

    Returns:
        None unless both roles have usable throws.
    """
    loads = vehicle.file.free_body.load if vehicle.file.free_body else []
    by_role = {load.role: load for load in loads}
    if not {"carrier", "proof"} <= {role for role, seen in calibration.items() if seen.rows_used}:
        return None
    device_kg, proof = by_role["carrier"].mass_kg, by_role["proof"]
    assert proof.truth_kg_m2 is not None
    device = free_body.whole_body(calibration["carrier"], device_kg, exact=True)
    both = free_body.whole_body(calibration["proof"], device_kg + proof.mass_kg, exact=True)
    known = RigidBody(proof.mass_kg, np.zeros(3), np.diag(proof.truth_kg_m2))
    rotor = free_body.calibrate_rotor(device.body, both.body, known)
    body = device.body._replace(inertia_kg_m2=rotor.factor * device.body.inertia_kg_m2)
    return ThrowCalibration(rotor, free_body.KnownBody(body, device.sigma * np.repeat([1.0, rotor.factor], [3, 6])))
