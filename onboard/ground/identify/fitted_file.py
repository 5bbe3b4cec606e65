"""``heft identify --fit-drawing``: a vehicle file and its URDF with the links as a log found them."""

import json
import tempfile
from dataclasses import replace
from pathlib import Path

from onboard import config
from onboard.dynamics.model.vehicle import STANDARD
from onboard.flight.estimate.problem.identification import build_online
from onboard.ground.calibrate.result import KeyChange, two_digits
from onboard.ground.calibrate.vehicle_file import edited
from onboard.ground.identify.identify import urdf
from onboard.ground.identify.kinds.identified import Identified

VEHICLE = "vehicle.toml"


def require_fittable(vehicle: config.Vehicle, directory: Path) -> None:
    """Refuse what cannot be written, before anything is identified.

    Raises:
        ValueError: this kind of vehicle states its links otherwise, or there is a vehicle file already.
    """
    settings = vehicle.file.estimation
    if vehicle.file.free_body is not None or settings.predicts:
        raise ValueError("--fit-drawing: links of an arm are identified by rows alone; here it is a body")
    if settings.masses is not None:
        raise ValueError("--fit-drawing: [estimation.masses] come from the drawing, and do not change it")
    if settings.carried is not None:
        raise ValueError("--fit-drawing: an answer that goes on from another log is of that log too; leave it out")
    if (directory / VEHICLE).exists():
        raise ValueError(f"{directory / VEHICLE} is there already; name another directory, or move it away")


def changes(vehicle: config.Vehicle, found: Identified) -> list[KeyChange]:
    """Keys of the vehicle file that state the links as they were found."""
    prior, made = ("estimation", "prior"), list[KeyChange]()
    for one in found.drawing:
        made += [KeyChange((*prior, "link", one.link), key, two_digits(value)) for key, value in one.stated.items()]
        made.append(KeyChange((*prior, "relative"), one.link, None))
        made += [KeyChange((*prior, "absolute"), f"{kind}_{one.link}", None) for kind in STANDARD]
        made.append(KeyChange(("link",), one.link, None))  # in place of the URDF's
    return [*made, KeyChange(("vehicle",), "urdf", vehicle.urdf_path.name)]


def write(vehicle: config.Vehicle, found: Identified, directory: Path) -> list[Path]:
    """Write both files; returns their paths.

    Args:
        vehicle: that was identified.
        found: by one log.
        directory: made if need be.

    Raises:
        ValueError: the verdict is ``do not use``, or no link but the payload is determined.
        ConfigError: the file cannot be edited.
    """
    if not found.drawing:
        raise ValueError(f"{found.log} determines no link of the arm; there is no drawing to write")
    kept = {one.link for one in found.drawing}
    fitted = urdf(vehicle, replace(found, links=tuple(one for one in found.links if one.link in kept)))
    name = json.dumps(found.log.name)
    said = f"# Links as estimated by heft identify from {name}: by this file that log counts twice."
    text = f"{said}\n\n{edited(vehicle, changes(vehicle, found))}"
    with tempfile.TemporaryDirectory() as where:
        tried = Path(where) / VEHICLE
        for path, content in ((tried, text), (tried.with_name(vehicle.urdf_path.name), fitted)):
            path.write_text(content, encoding="utf-8")
        build_online(config.load(tried))
        directory.mkdir(parents=True, exist_ok=True)
        written = [directory / VEHICLE, directory / vehicle.urdf_path.name]
        for path in written:
            path.write_bytes(tried.with_name(path.name).read_bytes())
    return written
