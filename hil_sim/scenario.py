"""A mission as data: the TOML of ``scenarios/`` read into frozen objects, every unit in its key, unknown keys refused.

The models below are the schema; the numbers and where they come from stand in the TOML file, beside each other.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

import tomllib
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, ValidationError, model_validator

Vector = tuple[float, float, float]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
NonNegative = Annotated[float, Field(ge=0.0)]


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message names the file and the key, and says what to do."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Header(_Table):
    """``[scenario]``."""

    name: str
    description: str


class Physics(_Table):
    """``[physics]``: time grid of the plant."""

    step_us: PositiveInt
    chunk_steps: PositiveInt


class Geometry(_Table):
    """``[geometry]``: modified Denavit-Hartenberg rows (Khalil-Kleinfinger) and the IMU's place on the plate."""

    frame_1_theta_deg: float
    frame_2_a_mm: float
    frame_3_d_mm: float
    frame_4_a_mm: float
    frame_5_a_mm: float
    imu_position_mm: Vector
    imu_roll_pitch_yaw_deg: Vector


class Inertia(_Table):
    """Tensor elements about the centre of mass, as printed by a CAD program (products with their sign)."""

    xx: PositiveFloat
    yy: PositiveFloat
    zz: PositiveFloat
    xy: float
    xz: float
    yz: float


class Body(_Table):
    """``[body.*]``: ``com_mm`` in the body's own frame; ``as_built_factor`` scales mass and inertia together."""

    mass_g: PositiveFloat
    com_mm: Vector
    inertia_g_mm2: Inertia
    as_built_factor: PositiveFloat = 1.0


class Bodies(_Table):
    """``[body]``: arm in frame 3, tip mass in frame 5."""

    arm: Body
    tip_mass: Body


class Joint(_Table):
    """``[joint]``: the harmonic drive, all referred to the joint, all proximal to the load cell."""

    reflected_rotor_inertia_kg_m2: PositiveFloat
    coulomb_friction_Nm: NonNegative
    viscous_friction_Nm_s_rad: NonNegative
    ripple_Nm: NonNegative
    ripple_cycles_per_rev: PositiveFloat


class Servo(_Table):
    """``[servo]``: position loop of the arm controller with feed-forward and a torque limit."""

    stiffness_Nm_rad: PositiveFloat
    damping_Nm_s_rad: PositiveFloat
    torque_limit_Nm: PositiveFloat
    friction_feedforward: Fraction


class Stops(_Table):
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


class Ejection(_Table):
    """``[ejection]``: the spring between arm and tip mass."""

    speed_m_s: NonNegative
    duration_ms: PositiveFloat
    direction_frame_5: Vector


class Rocket(_Table):
    """``[rocket]``: rigid motion of the vehicle that carries the plate."""

    spin_rad_s: float
    nutation_rate_rad_s: NonNegative
    roll_to_pitch_inertia: PositiveFloat
    residual_rate_rad_s: Vector
    centre_of_mass_to_plate_m: Vector


class Mode(_Table):
    """A structural mode: lightly damped, driven by noise. Exactly one of the two amplitudes is used by its list."""

    frequency_Hz: PositiveFloat
    damping_ratio: PositiveFloat
    rms: Vector


class Vibration(_Table):
    """``[vibration]``: what the structure adds to the rigid motion."""

    broadband_mg: Vector
    broadband_band_Hz: tuple[PositiveFloat, PositiveFloat]
    linear_mode_mg: tuple[Mode, ...]
    angular_mode_mrad_s: tuple[Mode, ...]


class Reentry(_Table):
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


class Hold(_Table):
    """``[[sequence]]`` action ``hold``: stay at the zero of the joint."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["hold"]
    duration_s: PositiveFloat


class Push(_Table):
    """``[[sequence]]`` action ``push``: run into a stop, press for a while, come back."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["push"]
    command_deg: float
    approach_s: PositiveFloat
    hold_s: PositiveFloat
    retreat_s: PositiveFloat


class Sweep(_Table):
    """``[[sequence]]`` action ``sweep``: minimum-jerk strokes between -amplitude and +amplitude."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["sweep"]
    amplitude_deg: PositiveFloat
    stroke_s: PositiveFloat
    strokes: PositiveInt
    pause_s: NonNegative
    transfer_s: PositiveFloat


class Eject(_Table):
    """``[[sequence]]`` action ``eject``: the tip mass leaves at the start; the arm holds its zero."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["eject"]
    duration_s: PositiveFloat


Action = Annotated[Hold | Push | Sweep | Eject, Field(discriminator="action")]


class Axes(_Table):
    """Errors of one triad (accelerometer or gyro); ``sigma`` values are drawn once per seed and axis."""

    noise_density: NonNegative
    bias_sigma: Vector
    bias_per_kelvin_sigma: Vector
    scale_sigma: NonNegative
    cross_axis_sigma: NonNegative
    bandwidth_Hz: Annotated[tuple[PositiveFloat, ...], Field(min_length=8, max_length=8)]
    delay_ms: Annotated[tuple[NonNegative, ...], Field(min_length=8, max_length=8)]


class Imu(_Table):
    """``[imu]``."""

    accel_g: Axes
    gyro_deg_s: Axes
    gyro_per_g_sigma_deg_s: NonNegative
    mounting_sigma_deg: NonNegative
    temperature_start_degC: float
    temperature_rise_K: float
    temperature_time_s: PositiveFloat
    temperature_noise_counts: NonNegative


class Encoder(_Table):
    """``[encoder]``."""

    counts_per_revolution: PositiveInt
    zero_count: Annotated[int, Field(ge=0, lt=2**32)]
    gear_ratio: PositiveFloat
    eccentricity_urad: NonNegative
    transmission_error_urad: NonNegative


class LoadCell(_Table):
    """``[load_cell]``."""

    lever_mm: PositiveFloat
    lever_sigma_mm: NonNegative
    capacity_N: PositiveFloat
    scale_sigma: NonNegative
    nonlinearity_of_rated_output: NonNegative
    creep_fraction: NonNegative
    creep_time_s: PositiveFloat
    zero_sigma_N: NonNegative
    zero_drift_sigma_N_s: NonNegative
    zero_walk_N_sqrt_s: NonNegative
    noise_rms_N: NonNegative
    delay_ms: PositiveFloat
    full_scale_readings_s: tuple[float, ...]
    full_scale_window_ms: PositiveFloat


class Clock(_Table):
    """``[clock.*]``: relative rate error and its drift, drawn once per seed; the rate is clipped at ``rate_limit``."""

    rate_sigma: NonNegative
    rate_limit: NonNegative
    drift_sigma_per_s: NonNegative


class Clocks(_Table):
    """``[clock]``."""

    imu_base: Clock
    imu_base_rc: Clock
    sync_box: Clock


class Scenario(_Table):
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
    imu: Imu
    encoder: Encoder
    load_cell: LoadCell
    clock: Clocks
    fault: tuple[dict[str, Any], ...] = ()

    @model_validator(mode="after")
    def _sequence_is_sound(self) -> "Scenario":
        if sum(step.action == "eject" for step in self.sequence) > 1:
            raise ValueError("there is one tip mass: at most one step of the sequence may have action 'eject'")
        for step in self.sequence:
            if step.action == "sweep" and step.amplitude_deg >= self.stops.pad_deg:
                raise ValueError(f"a sweep of +-{step.amplitude_deg} deg meets the pad at {self.stops.pad_deg} deg")
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
    return parse(_merged(table, overrides or {}), label)


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
