"""What a rehearsal of any vehicle compares: its answers with the truth of the world that was made from it.

The world gives mass, centre of mass and inertia of every link as it was built, and of the payload. From these come the
true values of the quantities that the vehicle answers, and for rows also those of its base parameters.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from onboard import config
from onboard.channels import NUMBERS
from onboard.dynamics.model.inertia import RigidBody, composite_functional, elements, symmetric
from onboard.dynamics.model.payload import body_of, standard_of
from onboard.dynamics.model.vehicle import STANDARD, VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.problem.identification import build_identifier, build_online
from onboard.flight.estimate.problem.model import build_model
from onboard.ground.log.tables.truth import Truth
from onboard.identification.pivot.online import PivotRun
from onboard.identification.quantities import BODY, BODY_UNITS
from onboard.identification.rows.free_body import FREE_BODY
from onboard.identification.rows.identifier import Identifier
from onboard.identification.standing import Level
from onboard.recording.reader import LogReader
from onboard.regressor.friction import COLUMNS

Row = dict[str, Any]
_UNDETERMINED = "weak: not determined by the data"


def true_values(vehicle: config.Vehicle, truth: Truth) -> dict[str, float]:
    """What a vehicle's answers should have been, by name, SI."""
    true = {**truth["quantities"]}
    for frame, puck in truth["pucks"].items():
        true |= {f"Fv_{frame}": puck["viscous_N_s_m"], f"Fc_{frame}": puck["coulomb_N"]}
    if vehicle.file.free_body:  # its base parameters say the same
        true |= _of_free_body(build_model(vehicle), truth)
    elif vehicle.prediction is config.Prediction.PIVOT:
        true = _of_pivot(vehicle, truth)
    elif vehicle.prediction is config.Prediction.ROWS:
        true |= _of_rows(build_identifier(vehicle)[0], truth)
    return true


def with_quantities(vehicle: config.Vehicle, truth: Truth) -> Truth:
    """A truth whose ``quantities`` are those of all that the vehicle answers, as far as the world knows them."""
    known = {name: value for name, value in true_values(vehicle, truth).items() if np.isfinite(value)}
    return {**truth, "quantities": known}


def is_estimated_afterwards(vehicle: config.Vehicle) -> bool:
    """Whether a vehicle answers nothing in flight: it moves on a table, or between hands."""
    return vehicle.prediction in (config.Prediction.PLANAR, config.Prediction.PARABOLAS)


def after_the_run(vehicle: config.Vehicle, log: LogReader) -> tuple[dict[str, Row], list[Row]]:
    """Answers of a vehicle that is estimated when its run is over, as ``heft identify`` gives them; and its runs.

    Args:
        vehicle: that flew.
        log: of the run.
    """
    from onboard.ground.identify.identify import BY_LIKELIHOOD  # noqa: PLC0415 - of all that are estimated in flight

    found = BY_LIKELIHOOD[vehicle.prediction](vehicle, log)
    refused = "" if found.verdict.level is not Level.DO_NOT_USE else f"do not use: {'; '.join(found.verdict.reasons)}"
    names = {f"{kind}_{vehicle.file.vehicle.payload_link}": unit for kind, unit in zip(BODY, BODY_UNITS, strict=True)}
    rows: dict[str, Row] = {name: _answer(unit, refused or _UNDETERMINED) for name, unit in names.items()}
    for one in found.answers:
        told = one.supported and not refused
        rows[one.name] = _answer(one.unit, found.standing(one).text, told=told)
        rows[one.name] |= {key: one.as_json()[key] for key in NUMBERS}
    return rows, [run.as_json() for run in found.runs]


def _answer(unit: str, standing: str, *, told: bool = False) -> Row:
    return {"unit": unit, "supported": told, "standing": standing, "leans": "", "drawn": 0.0}


def _of_rows(identifier: Identifier, truth: Truth) -> dict[str, float]:
    """True base parameters and quantities of the rows, by name; NaN where something is not known to the world."""
    model = identifier.model
    by_name = dict.fromkeys(model.names, np.nan)
    for link in model.vehicle.links:
        for kind, value in zip(STANDARD, _standard(link, truth), strict=True):
            by_name[f"{kind}_{link}"] = value
    for joint, drive in truth["drives"].items():
        own = dict(zip(COLUMNS, (drive["rotor_kg_m2"], drive["viscous_n_m_s"], drive["coulomb_n_m"]), strict=True))
        by_name |= {f"{column}_{joint}": value for column, value in own.items() if f"{column}_{joint}" in by_name}
    chi = np.array(list(by_name.values()))
    beta = np.array([_sum(weights, chi) for weights in identifier.base.grouping])
    found = dict(zip(identifier.base.names, beta.tolist(), strict=True))
    found |= {quantity.name: _sum(quantity.weights, beta) for quantity in identifier.quantities}
    return found | _masses(found, truth)


def _masses(names: Iterable[str], truth: Truth) -> dict[str, float]:
    """True masses of links and of sums of them: a mass by an inertia has the drawing's radius of gyration, no truth."""
    known = {f"m_{link}": body["mass_kg"] for link, body in truth["links"].items()} | truth["quantities"]
    terms = {name: name.split("+") for name in names}
    return {
        name: float(sum(known[term] for term in own))
        for name, own in terms.items()
        if all(term.startswith("m_") and term in known for term in own)
    }


def _of_free_body(vehicle: VehicleModel, truth: Truth) -> dict[str, float]:
    """True centre of mass and inertia about it of the whole vehicle, rotors locked."""
    whole = body_of(composite_functional(vehicle) @ np.concatenate([_standard(link, truth) for link in vehicle.links]))
    return dict(zip(FREE_BODY, (*whole[1], *elements(whole[2])), strict=True))


def _of_pivot(vehicle: config.Vehicle, truth: Truth) -> dict[str, float]:
    """True answers of a body on a pivot: without its proof mass, its wheels where they were built."""
    model, whole = build_model(vehicle), np.zeros(10)
    functional = composite_functional(model)
    for k, link in enumerate(model.links):
        if link in truth["links"] and link != vehicle.file.vehicle.payload_link:
            drawn = body_of(functional[:, 10 * k : 10 * k + 10] @ _standard(link, truth))
            off_m = np.asarray(truth["places_m"].get(link, np.zeros(3)), np.float64)
            whole += standard_of(drawn._replace(centre_of_mass_m=drawn.centre_of_mass_m + off_m))
    online = build_online(vehicle)[0]
    assert isinstance(online, PivotRun)
    return dict(zip(online.quantity_names, online.quantities_of(whole[0], whole[1:]).tolist(), strict=True))


def _sum(weights: FloatArray, values: FloatArray) -> float:
    """Of what has a weight: an unknown value without one does not matter."""
    used = np.abs(weights) > 0.0
    return float(weights[used] @ values[used])


def _standard(link: str, truth: Truth) -> FloatArray:
    """Standard parameters of a link as it was built, and of what it holds, (10,)."""
    found = np.zeros(10)
    if link in truth["links"]:
        own = truth["links"][link]
        found += standard_of(
            RigidBody(own["mass_kg"], *(np.asarray(own[k]) for k in ("centre_of_mass_m", "inertia_kg_m2")))
        )
    if link == truth["payload_link"] and truth["quantities"]:
        mass_kg, *others = (truth["quantities"][f"{key}_{link}"] for key in BODY)
        found += standard_of(RigidBody(mass_kg, np.array(others[:3]), symmetric(np.array(others[3:]))))
    return found
