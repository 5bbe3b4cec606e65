"""The URDF with the payload as it was identified: by ``heft identify --urdf``, or by the last answers of a flight."""

from pathlib import Path
from typing import Any

import numpy as np

from onboard import config
from onboard.dynamics.model.inertia import RigidBody, symmetric
from onboard.dynamics.model.urdf import with_bodies
from onboard.ground.identify.mission.mission_table import last_answers
from onboard.ground.log.tables import truth
from onboard.identification.standing import Level
from onboard.recording.reader import LogReader

_ELEMENTS = ("xx", "xy", "yy", "xz", "yz", "zz")


class NotAdoptedError(ValueError):
    """An identification that the controller is not given."""


def adopted_urdf(vehicle: config.Vehicle, identified: Path, seed: int) -> str:
    """The URDF that the controller adopts after the capture.

    Args:
        vehicle: whose payload it is.
        identified: a URDF, or the log of a flight.
        seed: of the world that is controlled: a flight of another seed identified another payload.

    Raises:
        NotAdoptedError: a quantity is missing, not supported, or not to be used; or the payload is another one.
    """
    if identified.suffix in (".urdf", ".xml"):
        return identified.read_text(encoding="utf-8")
    link = vehicle.file.vehicle.payload_link
    if link is None:
        raise NotAdoptedError(f"{vehicle.label} names no payload_link; give the URDF that heft identify --urdf writes")
    flown = truth.read(identified)
    if flown is not None and flown.get("seed") != seed:
        raise NotAdoptedError(f"{identified} is of seed {flown.get('seed')}, whose payload is another: --seed {seed}")
    answers = last_answers(LogReader(identified))
    names = [f"m_{link}", *(f"c_{axis}_{link}" for axis in "xyz"), *(f"I_{of}_{link}" for of in _ELEMENTS)]
    values = np.array([_value(identified, name, answers.get(name)) for name in names])
    return with_bodies(vehicle.urdf_text, {link: RigidBody(float(values[0]), values[1:4], symmetric(values[4:]))})


def _value(log: Path, name: str, answer: dict[str, Any] | None) -> float:
    if answer is None or not answer["supported"] or not np.isfinite(answer["value"]):
        raise NotAdoptedError(
            f"{log} does not determine {name}: fly a motion that does, or identify it with heft identify"
        )
    if str(answer["standing"]).startswith(Level.DO_NOT_USE.value):
        raise NotAdoptedError(f"{log}: {name} is not to be used: {answer['standing']}")
    return float(answer["value"])
