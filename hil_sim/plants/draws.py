"""What of a vehicle a seed draws: bodies and places as they were built, the payload, the motion at the start."""

from collections.abc import Collection

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.body import Solid, built
from hil_sim.plants.urdf_model import rotation
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import LetGo, PayloadTable, Scenario, Tolerance

_EXACT = Tolerance(mass_relative=0.0, centre_mm=0.0, inertia_relative=0.0)
_DRAWS = 1000  # of a part until it is one that can exist


def as_built(
    scenario: Scenario, drawn: dict[str, Solid], rotors: Collection[str], rng: np.random.Generator
) -> dict[str, Solid]:
    """Every link within its tolerance of the drawing; drawn again until it is a body that can exist.

    Rotors of wheels are balanced bodies of revolution: all of their inertia has one factor.
    """
    known = {name for name, table in scenario.as_built.items() if table.place_mm} | {"default"}
    known |= {scenario.vehicle.payload_link or ""}  # as which the payload is made
    unknown = sorted(scenario.as_built.keys() - drawn.keys() - known)
    if unknown:
        raise ScenarioError(f"as_built names {', '.join(unknown)}; links with a mass are {', '.join(drawn)}")
    usual = scenario.as_built.get("default", Tolerance())
    found: dict[str, Solid] = {}
    for link, body in drawn.items():
        sigma = scenario.as_built.get(link, usual)
        if link in rotors:
            mass, inertia = 1.0 + np.array([sigma.mass_relative, sigma.inertia_relative]) * rng.standard_normal(2)
            found[link] = Solid(mass * body.mass_kg, body.centre_of_mass_m, inertia * body.inertia_kg_m2)
            continue
        found[link] = _made(link, body, sigma, rng)
    return found


def _made(link: str, drawn: Solid, sigma: Tolerance, rng: np.random.Generator) -> Solid:
    centre = drawn.centre_of_mass_m + 1e-3 * np.asarray(sigma.centre_off_mm)
    denser = sigma.mass_factor
    if sigma.density_relative:
        denser *= 1.0 + sigma.density_relative * rng.standard_normal()
    inertia = denser * sigma.inertia_factor * drawn.inertia_kg_m2
    drawn = Solid(denser * drawn.mass_kg, centre, inertia)
    for _ in range(_DRAWS):
        one = built(drawn, sigma.mass_relative, 1e-3 * sigma.centre_mm, sigma.inertia_relative, rng)
        if one.is_possible:
            return one
    raise ScenarioError(f"as_built.{link}: hardly any body lies within it; make it smaller")


def off_the_drawing(scenario: Scenario, links: Collection[str], rng: np.random.Generator) -> dict[str, FloatArray]:
    """Places of frames off their drawing, (3,) each."""
    sigma_m = {link: 1e-3 * table.place_mm for link, table in scenario.as_built.items() if table.place_mm}
    fixed = sorted(sigma_m.keys() - (set(links) - {scenario.vehicle.base_link}))
    if fixed:
        raise ScenarioError(f"as_built: {', '.join(fixed)}: place_mm is of a link that hangs on another; take it out")
    return {link: sigma_m[link] * rng.standard_normal(3) for link in links if link in sigma_m}


def payload(table: PayloadTable, drawn: Solid | None, sigma: Tolerance | None, rng: np.random.Generator) -> Solid:
    """A solid box in the frame of its link; whatever is not given is drawn.

    Where its link has an inertia in the URDF and the table gives no shape, it has that shape at another density, and is
    made within ``sigma`` where that is given.

    Raises:
        ScenarioError: ``sigma`` of a box.
    """
    low, high = np.log(table.mass_kg)
    mass = float(np.exp(rng.uniform(low, high)))
    shape = rng.uniform(0.7, 1.4, 3)
    size = (mass / table.density_kg_m3) ** (1.0 / 3.0) * shape / np.cbrt(shape.prod())
    aside, turn = rng.uniform(-0.3, 0.3, 3), rng.uniform(-np.pi, np.pi, 3)
    if drawn is not None and drawn.mass_kg > 0.0 and table.size_mm is None and table.centre_of_mass_mm is None:
        like = Solid(mass, drawn.centre_of_mass_m, drawn.inertia_kg_m2 * mass / drawn.mass_kg)
        return like if sigma is None else _made("the payload's link", like, sigma, rng)
    if sigma is not None and sigma.model_copy(update={"place_mm": 0.0}) != _EXACT:
        raise ScenarioError("as_built of the payload's link: [payload] says what a box is; give it place_mm alone")
    if table.size_mm is not None:
        size = 1e-3 * np.asarray(table.size_mm)
    centre = aside * size + [0.0, 0.0, 0.5 * size[2]]
    if table.centre_of_mass_mm is not None:
        centre = 1e-3 * np.asarray(table.centre_of_mass_mm)
    if table.roll_pitch_yaw_deg is not None:
        turn = np.deg2rad(table.roll_pitch_yaw_deg)
    return Solid.box(mass, size.tolist(), centre.tolist()).turned(rotation(turn))


def let_go(table: LetGo, base: str, rng: np.random.Generator) -> FloatArray:
    """Velocity of the base at the start, MuJoCo's numbers."""
    rate = table.rate_rad_s * rng.uniform(-1.0, 1.0, 3) + np.asarray(table.spin_rad_s)
    velocity = table.velocity_m_s * rng.uniform(-1.0, 1.0, 3)
    return {
        "free": np.concatenate([velocity, rate]),
        "planar": np.array([*velocity[:2], rate[2]]),
        "pivot": np.asarray(rate, np.float64),
    }.get(base, np.zeros(0))
