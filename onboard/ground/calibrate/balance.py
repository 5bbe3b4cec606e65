"""The base's mass and centre of mass from a load cell that holds it off a hinge, in several orientations."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from onboard import config
from onboard.devices.roles import LoadCellKeys
from onboard.estimation.arrays import FloatArray
from onboard.estimation.calibration.linear import Balanced, balance
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import LIKELY_SIZE
from onboard.flight.estimate.problem.model import build_model, drawn_body
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.calibrate.place import Gravity
from onboard.ground.calibrate.readings import LogSpan, Readings, require_within, still
from onboard.ground.calibrate.result import CalibratedNumber, Calibration, KeyChange, stated, two_digits
from onboard.section import Positive, Section, Vector3

UNLOADED = 0.02  # of the largest reading: between two orientations the body is lifted off the cell


class Orientation(Section):
    """``[[orientation]]``: how the body lies, in the base link's axes."""

    up: Vector3
    pivot_m: Vector3
    hinge: Vector3
    support_m: Vector3
    push: Vector3


class Rig(Section):
    """The rig file: orientations in the order in which they were held, and how well the places are known."""

    place_sigma_m: Positive = 1e-4
    orientation: list[Orientation] = Field(min_length=4)


def rig(path: Path) -> Rig:
    """Read a rig file.

    Raises:
        ConfigError: it cannot be read or used.
    """
    said = config.read(path, "a rig file")
    return config.validated(Rig, config.tree_of(said, str(path)), config.Origin(str(path), said))


def calibrate_balance(
    read: Readings,
    imu: Readings | None,
    vehicle: config.Vehicle,
    device: str,
    held: Rig,
    place: Gravity,
    at: Sequence[LogSpan] = (),
) -> Calibration:
    """From readings in which the body lay in each orientation of the rig, and was lifted off the cell between them.

    Args:
        read: of the cell, calibrated.
        imu: of the base's IMU, calibrated, where it ran: each orientation has to be the one that the rig file says.
        vehicle: whose base it is.
        device: the cell.
        held: the rig.
        place: gravity.
        at: when it lay still; found where not given.

    Raises:
        CalibrationError: the run does not tell, or contradicts itself or the IMU.
    """
    section = vehicle.file.device[device]
    if not isinstance(section, LoadCellKeys):
        raise CalibrationError(f"{device} is a {section.kind} and no load cell")
    require_within(read, section.capacity_N, "put the hinge nearer to the centre of mass")
    spans, zero = _loaded(read, at, len(held.orientation))
    means = [read.mean(span) for span in spans]
    force = np.array([float(mean[0]) for mean, _ in means]) - zero
    if imu is not None:
        _require_up(imu, vehicle, held, read, spans)
    columns = {
        key: np.array([getattr(one, key) for one in held.orientation], np.float64)
        for key in ("up", "pivot_m", "hinge", "support_m", "push")
    }
    for key in ("up", "hinge", "push"):
        size = np.linalg.norm(columns[key], axis=1, keepdims=True)
        columns[key] = np.divide(columns[key], size, out=np.zeros_like(columns[key]), where=size > 0.0)
    found, sigma_N = _solved(columns, force, means, held, place)
    return _result(vehicle, found, section.relative_sigma, sigma_N, place)


def _solved(
    columns: dict[str, FloatArray],
    force: FloatArray,
    means: Sequence[tuple[FloatArray, FloatArray]],
    held: Rig,
    place: Gravity,
) -> tuple[Balanced, float]:
    """With the places' error as a force: the weight over the lever of the cell, for a body that the hinge carries."""
    moment = np.cross(columns["support_m"] - columns["pivot_m"], columns["push"])
    lever = np.abs(np.einsum("ka,ka->k", columns["hinge"], moment))
    gravity = -place.gravity_m_s2 * columns["up"]
    given = (gravity, columns["pivot_m"], columns["hinge"], columns["support_m"], columns["push"], force)
    read_N = float(np.sqrt(np.mean([spread[0] ** 2 for _, spread in means])))
    rough = balance(*given, max(read_N, UNLOADED * float(np.abs(force).max())))
    misplaced = rough.mass_kg * place.gravity_m_s2 * held.place_sigma_m / np.where(lever > 0.0, lever, np.inf)
    sigma = float(np.hypot(read_N, np.sqrt(np.mean(misplaced**2)) * np.sqrt(2.0)))
    return balance(*given, sigma), sigma


def _loaded(read: Readings, at: Sequence[LogSpan], count: int) -> tuple[list[LogSpan], float]:
    """When the cell bore the body, and what it reads unloaded."""
    spans = still(read, at)
    level = np.array([float(read.mean(span)[0][0]) for span in spans])
    bare = np.abs(level) < UNLOADED * np.abs(level).max()
    loaded = [span for span, empty in zip(spans, bare, strict=True) if not empty]
    if len(loaded) != count:
        raise CalibrationError(
            f"{len(loaded)} steady loads in the log, {count} orientations in the rig file; lift the body off the cell "
            "between them, or give the times by --at"
        )
    return loaded, float(level[bare].mean()) if bare.any() else 0.0


def _require_up(imu: Readings, vehicle: config.Vehicle, held: Rig, read: Readings, spans: Sequence[LogSpan]) -> None:
    """Refuse an orientation in which the IMU's specific force does not point where the rig file has up."""
    R_BS, _ = build_model(vehicle).pose_in_base(roles_of(vehicle).imu.frame)
    later_s = read.start_s - imu.start_s
    for number, (span, one) in enumerate(zip(spans, held.orientation, strict=True), 1):
        seen = imu.within(LogSpan(span.start_s + later_s, span.end_s + later_s))
        up = R_BS @ imu.values[seen, 3:6].mean(axis=0)
        wanted = np.array(one.up) / np.linalg.norm(one.up)
        angle = float(np.arccos(np.clip(up @ wanted / np.linalg.norm(up), -1.0, 1.0)))
        if angle > LIKELY_SIZE:
            raise CalibrationError(
                f"orientation {number} at {span}: the IMU has up at ({', '.join(f'{v:.2f}' for v in up)}) m/s^2, "
                f"{np.rad2deg(angle):.0f} deg from the rig file's; check the order and the axes"
            )


def _result(
    vehicle: config.Vehicle, found: Balanced, scale_sigma: float, sigma_N: float, place: Gravity
) -> Calibration:
    link = vehicle.file.vehicle.base_link
    drawn = drawn_body(build_model(vehicle), link)
    mass_sigma = float(np.hypot(np.sqrt(found.covariance[0, 0]), scale_sigma * found.mass_kg))
    centre_sigma = np.sqrt(np.diag(found.covariance)[1:])
    result = Calibration(
        [CalibratedNumber(f"mass of {link}", found.mass_kg, mass_sigma, "kg", float(drawn.mass_kg))],
        notes=[f"{sigma_N:.2g} N of reading and places; gravity {place.gravity_m_s2:.5f} m/s^2"],
    )
    result.add(f"centre of mass of {link}", found.centre_of_mass_m, centre_sigma, "m", drawn.centre_of_mass_m)
    table = ("link", link)
    result.changes.append(stated(table, "centre_of_mass_m", found.centre_of_mass_m, centre_sigma))
    prior, known = ("estimation", "prior", "link", link), vehicle.file.estimation.prior.link.get(link)
    if known is not None and known.mass_relative * drawn.mass_kg < mass_sigma:
        result.notes.append("the file knows the mass better than this: it stays; a scale weighs better than a balance")
    else:
        result.changes.append(stated(table, "mass_kg", found.mass_kg, mass_sigma))
        if known is not None:
            result.changes.append(KeyChange(prior, "mass_relative", two_digits(mass_sigma / found.mass_kg)))
    if known is not None:
        result.changes.append(KeyChange(prior, "centre_m", two_digits(float(np.sqrt(np.mean(centre_sigma**2))))))
    return result
