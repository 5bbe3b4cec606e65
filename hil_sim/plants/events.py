"""Captures and ejections of a mission: when they happen, and what moves how."""

import math
from typing import NamedTuple

import numpy as np

from hil_sim.plants.body import Solid
from hil_sim.plants.parts.contact import Contact
from hil_sim.plants.parts.exchange import Jolt, Released
from hil_sim.plants.servo_flight import ServoFlight
from hil_sim.plants.vehicle_flight import VehicleFlight
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario


class Event(NamedTuple):
    """What happens between two rows.

    Attributes:
        name: ``capture``; ``grip``, which closes after a contact; ``lost_part``; ``ejection``.
        row: of the integration, that is first after it.
        moves: what comes or goes, or is left when a part has come off; nothing of a grip.
        contact: frequency, Hz, and damping ratio of a capture that holds the payload by a spring first.
        lasts_s: of the push of an ejection; 0: at once.
    """

    name: str
    row: int
    moves: Released | None
    contact: tuple[float, float] | None = None
    lasts_s: float = 0.0

    def happen(self, flight: VehicleFlight | ServoFlight) -> Jolt | None:
        """Do it; what jumps."""
        if isinstance(flight, ServoFlight):
            return flight.happen(self.name == "capture", self.moves, self.lasts_s)
        if self.moves is None:
            return flight.close()
        if self.name == "lost_part":
            flight.alter(self.moves.payload)
            return None
        if self.name == "ejection":
            held = self.moves.payload if flight.caught is None else flight.caught
            return flight.exchange(None, self.moves._replace(payload=held))
        if self.contact is None:
            return flight.exchange(self.moves, None)
        flight.touch(self.moves, *self.contact)
        return None


def events(
    scenario: Scenario, payload: Solid | None, step_s: float, steps: int, rng: np.random.Generator
) -> list[Event]:
    """Of a mission, in their order.

    Args:
        scenario: its ``[capture]``, ``[lost_part]`` and ``[ejection]``.
        payload: what is caught and let go.
        step_s: of the integration.
        steps: of the mission.
        rng: draws the time of the capture, the payload's motion against the gripper, and the spring.

    Raises:
        ScenarioError: a mission that ends before the grip has closed; a part that is more than the payload.
    """
    capture, ejection, found, first = scenario.capture, scenario.ejection, list[Event](), 0
    if capture is not None and payload is not None:
        window = rng.uniform(capture.earliest_s, max(capture.latest_s, capture.earliest_s))
        at_s = window if capture.phase is None else scenario.start_of(capture.phase)
        first = min(max(round(at_s / step_s), 2), steps - 2)
        velocity = capture.velocity_sigma_m_s * rng.standard_normal(3)
        comes = Released(payload, velocity, capture.rate_sigma_rad_s * rng.standard_normal(3))
        if capture.contact_Hz is None:
            found.append(Event("capture", first, comes))
        else:
            contact = rng.uniform(*capture.contact_Hz), capture.contact_damping_ratio
            found.append(Event("capture", first, comes, contact))
            first += math.ceil(Contact.lasts_s(*contact) / step_s)
            if first > steps - 2:
                raise ScenarioError("the mission ends before the grip closes: give capture a higher contact_Hz")
            found.append(Event("grip", first, None))
    lost = scenario.lost_part
    if lost is not None and payload is not None:
        left = payload.without(lost.mass_kg, lost.centre_m)
        if not left.is_possible:
            raise ScenarioError(
                "lost_part: no body is left of the payload; give a smaller mass_kg, or another centre_m"
            )
        first = min(max(round(lost.at_s / step_s), first + 2), steps - 4)
        found.append(Event("lost_part", first, Released(left, np.zeros(3), np.zeros(3))))
    comes_to_it = ejection is None or ejection.phase in (None, *(step.phase for step in scenario.sequence))
    if ejection is not None and payload is not None and comes_to_it:
        told = scenario.start_of(ejection.phase) if ejection.phase is not None else ejection.at_s
        row = min(max(round((told or 0.0) / step_s), first + 2), steps - 2)
        goes = Released(payload, np.asarray(ejection.velocity_m_s), np.zeros(3))
        found.append(Event("ejection", row, goes, lasts_s=1e-3 * (ejection.duration_ms or 0.0)))
    return found
