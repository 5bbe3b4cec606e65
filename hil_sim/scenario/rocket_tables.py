"""Tables of a scenario with one arm on a rocket, as RockSat-X flew it: ``[scenario] plant = "rocket_arm"``."""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from hil_sim.scenario.part_tables import Vibration
from hil_sim.scenario.sensor_tables import Fraction, NonNegative, Table, Vector
from hil_sim.scenario.tables import Scenario


class RocketPhysics(Table):
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


class BodyTable(Table):
    """``[body.*]``: ``com_mm`` in the body's own frame; ``as_built_factor`` scales mass and inertia together."""

    mass_g: PositiveFloat
    com_mm: Vector
    inertia_g_mm2: Inertia
    as_built_factor: PositiveFloat = 1.0


class ArmBodies(Table):
    """``[body]``: arm in frame 3, tip mass in frame 5."""

    arm: BodyTable
    tip_mass: BodyTable


class BuiltPart(Table):
    """How far a part is from its drawing, 1 sigma; drawn per seed, none beyond two sigma.

    ``inertia_relative`` is of the tensor about the centre of mass, at the mass that the part has.
    """

    mass_relative: Annotated[float, Field(ge=0.0, le=0.3)] = 0.0
    centre_mm: NonNegative = 0.0
    inertia_relative: Annotated[float, Field(ge=0.0, le=0.3)] = 0.0


class AsBuilt(Table):
    """``[as_built]``: each part, and the distance of the tip mass's frame from the joint."""

    arm: BuiltPart = BuiltPart()
    tip_mass: BuiltPart = BuiltPart()
    length_mm: NonNegative = 0.0


class JointTable(Table):
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


RocketAction = Annotated[Hold | Push | Sweep | Eject, Field(discriminator="action")]


class RocketScenario(Scenario):
    """A whole mission of the rocket's arm."""

    physics: RocketPhysics
    geometry: Geometry
    body: ArmBodies
    as_built: AsBuilt = AsBuilt()
    joint: JointTable
    servo: Servo
    stops: Stops
    ejection: Ejection
    rocket: Rocket
    vibration: Vibration
    reentry: Reentry
    sequence: Annotated[tuple[RocketAction, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _sequence_is_sound(self) -> "RocketScenario":
        if sum(step.action == "eject" for step in self.sequence) > 1:
            raise ValueError("there is one tip mass: at most one step of the sequence may have action 'eject'")
        for step in self.sequence:
            if step.action == "sweep" and step.amplitude_deg >= self.stops.pad_deg:
                raise ValueError(f"a sweep of +-{step.amplitude_deg} deg meets the pad at {self.stops.pad_deg} deg")
        return self
