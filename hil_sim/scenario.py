"""A mission as data: the TOML of ``scenarios/`` read into frozen objects, every unit in its key, unknown keys refused.

The models below and in ``sensor_tables`` and ``device_tables`` are the schema; the numbers and where they come from
stand in the TOML file, beside each other. A scenario may be ``based_on`` another: its tables lie over those of the
other, but the wiring (``bus``, ``device``, ``clock``) is its own or all the other's, never a mixture.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

import tomllib
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt, ValidationError, model_validator

from hil_sim import wiring
from hil_sim.device_tables import BusTable, DeviceTable
from hil_sim.sensor_tables import Clock, Fraction, NonNegative, Sensor, Table, Vector

_WIRING = {"bus", "device", "clock"}


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message names the file and the key, and says what to do."""


class Header(Table):
    """``[scenario]``. ``based_on``: the packaged scenario over which this one's tables lie."""

    name: str
    description: str
    based_on: str | None = None


class Physics(Table):
    """``[physics]``: time grid of the plant."""

    step_us: PositiveInt
    chunk_steps: PositiveInt


class Geometry(Table):
    """``[geometry]``: modified Denavit-Hartenberg rows (Khalil-Kleinfinger) and the IMU's place on the plate."""

    frame_1_theta_deg: float
    frame_2_a_mm: float
    frame_3_d_mm: float
    frame_4_a_mm: float
    frame_5_a_mm: float
    imu_position_mm: Vector
    imu_roll_pitch_yaw_deg: Vector


class Inertia(Table):
    """Tensor elements about the centre of mass, as printed by a CAD program (products with their sign)."""

    xx: PositiveFloat
    yy: PositiveFloat
    zz: PositiveFloat
    xy: float
    xz: float
    yz: float


class Body(Table):
    """``[body.*]``: ``com_mm`` in the body's own frame; ``as_built_factor`` scales mass and inertia together."""

    mass_g: PositiveFloat
    com_mm: Vector
    inertia_g_mm2: Inertia
    as_built_factor: PositiveFloat = 1.0


class Bodies(Table):
    """``[body]``: arm in frame 3, tip mass in frame 5."""

    arm: Body
    tip_mass: Body


class Joint(Table):
    """``[joint]``: the harmonic drive, all referred to the joint, all proximal to the load cell."""

    reflected_rotor_inertia_kg_m2: PositiveFloat
    coulomb_friction_Nm: NonNegative
    viscous_friction_Nm_s_rad: NonNegative
    ripple_Nm: NonNegative
    ripple_cycles_per_rev: PositiveFloat


class Servo(Table):
    """``[servo]``: position loop of the arm controller with feed-forward and a torque limit."""

    stiffness_Nm_rad: PositiveFloat
    damping_Nm_s_rad: PositiveFloat
    torque_limit_Nm: PositiveFloat
    friction_feedforward: Fraction


class Stops(Table):
    """``[stops]``: a boss on the arm meets a pad before the positive stop, and the two hard stops."""

    contact_radius_mm: PositiveFloat
    hard_deg: PositiveFloat
    hard_stiffness_N_mm: PositiveFloat
    hard_damping_N_s_mm: PositiveFloat
    pad_deg: PositiveFloat
    pad_stiffness_N_mm: PositiveFloat
    pad_damping_N_s_mm: PositiveFloat

    @model_validator(mode="after")
    def _pad_before_stop(self) -> "Stops":
        if self.pad_deg >= self.hard_deg:
            raise ValueError("pad_deg must be smaller than hard_deg: the arm meets the pad first")
        return self


class Ejection(Table):
    """``[ejection]``: the spring between arm and tip mass."""

    speed_m_s: NonNegative
    duration_ms: PositiveFloat
    direction_frame_5: Vector


class Rocket(Table):
    """``[rocket]``: rigid motion of the vehicle that carries the plate."""

    spin_rad_s: float
    nutation_rate_rad_s: NonNegative
    roll_to_pitch_inertia: PositiveFloat
    residual_rate_rad_s: Vector
    centre_of_mass_to_plate_m: Vector


class Mode(Table):
    """A structural mode: lightly damped, driven by noise. Exactly one of the two amplitudes is used by its list."""

    frequency_Hz: PositiveFloat
    damping_ratio: PositiveFloat
    rms: Vector


class Vibration(Table):
    """``[vibration]``: what the structure adds to the rigid motion."""

    broadband_mg: Vector
    broadband_band_Hz: tuple[PositiveFloat, PositiveFloat]
    linear_mode_mg: tuple[Mode, ...]
    angular_mode_mrad_s: tuple[Mode, ...]


class Reentry(Table):
    """``[reentry]``: dynamic pressure grows exponentially around a reference time in the mission."""

    reference_s: float
    reference_deceleration_m_s2: NonNegative
    growth_time_s: PositiveFloat
    rocket_area_over_mass_m2_kg: PositiveFloat
    arm_drag_area_m2: NonNegative
    arm_centre_of_pressure_mm: Vector
    wind_elevation_deg: float
    pitch_moment_rad_s2_per_m_s2: float
    roll_moment_rad_s2_per_m_s2: float
    gust_fraction: NonNegative
    gust_time_s: PositiveFloat


class Hold(Table):
    """``[[sequence]]`` action ``hold``: stay at the zero of the joint."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["hold"]
    duration_s: PositiveFloat


class Push(Table):
    """``[[sequence]]`` action ``push``: run into a stop, press for a while, come back."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["push"]
    command_deg: float
    approach_s: PositiveFloat
    hold_s: PositiveFloat
    retreat_s: PositiveFloat


class Sweep(Table):
    """``[[sequence]]`` action ``sweep``: minimum-jerk strokes between -amplitude and +amplitude."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["sweep"]
    amplitude_deg: PositiveFloat
    stroke_s: PositiveFloat
    strokes: PositiveInt
    pause_s: NonNegative
    transfer_s: PositiveFloat


class Eject(Table):
    """``[[sequence]]`` action ``eject``: the tip mass leaves at the start; the arm holds its zero."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["eject"]
    duration_s: PositiveFloat


Action = Annotated[Hold | Push | Sweep | Eject, Field(discriminator="action")]


class Scenario(Table):
    """A whole mission. ``fault`` tables are passed on to ``hil_sim.faults`` as they are."""

    scenario: Header
    physics: Physics
    geometry: Geometry
    body: Bodies
    joint: Joint
    servo: Servo
    stops: Stops
    ejection: Ejection
    rocket: Rocket
    vibration: Vibration
    reentry: Reentry
    sequence: Annotated[tuple[Action, ...], Field(min_length=1)]
    sensor: dict[str, Sensor]
    clock: dict[str, Clock]
    bus: dict[str, BusTable]
    device: Annotated[dict[str, DeviceTable], Field(min_length=1)]
    fault: tuple[dict[str, Any], ...] = ()

    @model_validator(mode="after")
    def _sequence_is_sound(self) -> "Scenario":
        if sum(step.action == "eject" for step in self.sequence) > 1:
            raise ValueError("there is one tip mass: at most one step of the sequence may have action 'eject'")
        for step in self.sequence:
            if step.action == "sweep" and step.amplitude_deg >= self.stops.pad_deg:
                raise ValueError(f"a sweep of +-{step.amplitude_deg} deg meets the pad at {self.stops.pad_deg} deg")
        return self

    @model_validator(mode="after")
    def _wiring_is_sound(self) -> "Scenario":
        wrong = list(wiring.problems(self.bus, self.device, self.sensor, self.clock))
        if wrong:
            raise ValueError("; ".join(wrong))
        return self


def names() -> tuple[str, ...]:
    """Names of the packaged scenarios, sorted."""
    folder = resources.files("hil_sim") / "scenarios"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def load(name_or_path: str | Path, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Read a packaged scenario by name, or any TOML file by path (it ends in ``.toml``).

    Args:
        name_or_path: ``"rocksat"``, or a path.
        overrides: nested tables laid over the file's, e.g. ``{"body": {"tip_mass": {"as_built_factor": 0.9}}}``.

    Raises:
        ScenarioError: no such scenario, not TOML, or a key that is unknown, missing, or out of range.
    """
    label, table = _read(name_or_path)
    return parse(_merged(table, overrides or {}), label)


def _read(name_or_path: str | Path, above: tuple[str, ...] = ()) -> tuple[str, dict[str, Any]]:
    """What to call a file, and its tables over those of the one that it is based on."""
    if str(name_or_path).endswith(".toml"):
        label = str(name_or_path)
        source: Traversable = Path(name_or_path)
    else:
        label = f"packaged scenario {name_or_path}"
        source = resources.files("hil_sim") / "scenarios" / f"{name_or_path}.toml"
    try:
        table = tomllib.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ScenarioError(f"{label} does not exist; packaged scenarios are {', '.join(names())}") from error
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{label} is not TOML: {error}; correct the file") from error
    base = table.get("scenario", {}).get("based_on")
    if base is None:
        return label, table
    if label in above:
        raise ScenarioError(f"{label} is based on itself; take a based_on out")
    _, below = _read(str(base), (*above, label))
    return label, _merged({key: value for key, value in below.items() if key not in _WIRING & table.keys()}, table)


def parse(table: Mapping[str, Any], label: str = "scenario") -> Scenario:
    """Check a table against the schema.

    Raises:
        ScenarioError: naming each wrong key by its dotted path.
    """
    try:
        return Scenario.model_validate(table)
    except ValidationError as error:
        problems = "; ".join(f"{'.'.join(map(str, e['loc'])) or 'file'}: {e['msg']}" for e in error.errors())
        raise ScenarioError(f"{label} cannot be used: {problems}. Correct these keys") from error


def _merged(table: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(table)
    for key, value in overrides.items():
        below = merged.get(key)
        merged[key] = _merged(below, value) if isinstance(below, dict) and isinstance(value, Mapping) else value
    return merged
