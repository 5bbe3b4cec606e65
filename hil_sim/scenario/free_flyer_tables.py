"""Tables of a scenario with a free-flyer that captures a payload: ``[scenario] plant = "free_flyer"``.

The nominal vehicle is that of ``hil_sim.plants.free_flyer``; ``[as_built]`` gives the as-built tolerances.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from hil_sim.scenario.sensor_tables import NonNegative, Table, Vector
from hil_sim.scenario.tables import Scenario

JOINTS = 5
Angles = tuple[float, float, float, float, float]


class FreeFlyerPhysics(Table):
    """``[physics]``: steps of the sensors' grid, and how many of them the integration takes at a time."""

    step_us: PositiveInt
    integration_steps: PositiveInt
    chunk_steps: PositiveInt


class Built(Table):
    """Standard deviations of a part as it was built about its drawing; of the inertia, relative to half its trace."""

    mass_relative: NonNegative
    centre_mm: NonNegative
    inertia_relative: NonNegative


class AsBuilt(Table):
    """``[as_built]``: base, each link of the arm; standard deviation of places of joints and IMUs, by coordinate.

    ``compliance_rad_N_m``: of every joint between its encoder, on the motor's side, and its link.
    """

    base: Built
    link: Built
    joint_place_mm: NonNegative = 0.0
    imu_place_mm: NonNegative = 0.0
    compliance_rad_N_m: NonNegative = 0.0


class SloshTable(Table):
    """``[slosh]``: a part of the base's mass that swings, hardly damped, along all axes."""

    mass_kg: PositiveFloat
    frequency_Hz: PositiveFloat


class WheelTable(Table):
    """``[wheel.NAME]``: a balanced rotor in the base, on the axis ``NAME`` turns about; inertia about it and across."""

    axis: Vector
    position_mm: Vector
    mass_kg: PositiveFloat
    axial_kg_m2: PositiveFloat
    across_kg_m2: PositiveFloat
    start_rad_s: float
    inertia_relative: NonNegative = 0.0


class AttitudeTable(Table):
    """``[attitude]``: the wheels hold the base's attitude by a spring and a damper, ``torque_N_m`` at most."""

    spring_N_m_rad: NonNegative
    damper_N_m_s: NonNegative
    torque_N_m: PositiveFloat


class PulseTable(Table):
    """``[[pulse]]``: a thruster's force on the base, base axes, for a time; ``thruster``: the device that tells it."""

    thruster: str = ""
    at_s: NonNegative
    duration_s: PositiveFloat
    force_N: Vector
    position_mm: Vector


class Release(Table):
    """``[release]``: initial motion; each component of the rate lies within +- ``rate_rad_s``."""

    rate_rad_s: NonNegative


class Payload(Table):
    """``[payload]``: a solid box, its centre of mass and orientation in the grasp frame."""

    mass_kg: PositiveFloat
    size_mm: Vector
    centre_of_mass_mm: Vector
    roll_pitch_yaw_deg: Vector


class CaptureTable(Table):
    """``[capture]``: time window of the capture and sigmas of the payload's motion relative to the gripper."""

    earliest_s: PositiveFloat
    latest_s: PositiveFloat
    velocity_sigma_m_s: NonNegative
    rate_sigma_rad_s: NonNegative


class Site(Table):
    """``[site.NAME]``: an IMU's place and axes in the base."""

    position_mm: Vector
    roll_pitch_yaw_deg: Vector


class HoldPosture(Table):
    """``[[sequence]]`` action ``hold``: the arm keeps its posture."""

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["hold"]
    duration_s: PositiveFloat


class Swing(Table):
    """``[[sequence]]`` action ``swing``: every joint swings about the posture, by tones drawn per seed.

    Amplitudes come to ``swing_deg`` rms at most some; the motion grows from rest and dies down within ``ramp_s``.
    """

    phase: Annotated[int, Field(ge=0, le=255)]
    action: Literal["swing"]
    duration_s: PositiveFloat
    ramp_s: PositiveFloat
    swing_deg: PositiveFloat
    tones: PositiveInt
    band_Hz: tuple[PositiveFloat, PositiveFloat]

    @model_validator(mode="after")
    def _ramps_fit(self) -> "Swing":
        if 2.0 * self.ramp_s > self.duration_s:
            raise ValueError("duration_s must hold two ramps of ramp_s")
        return self


FreeFlyerAction = Annotated[HoldPosture | Swing, Field(discriminator="action")]


class Arm(Table):
    """``[arm]``: the posture about which it moves, and by how much that differs from flight to flight."""

    posture_deg: Angles
    posture_spread_deg: NonNegative


class FreeFlyerScenario(Scenario):
    """A whole mission of the free-flyer. Without ``capture`` the payload is held from the start."""

    physics: FreeFlyerPhysics
    as_built: AsBuilt
    release: Release
    arm: Arm
    payload: Payload
    capture: CaptureTable | None = None
    slosh: SloshTable | None = None
    wheel: dict[str, WheelTable] = Field(default_factory=dict)
    attitude: AttitudeTable | None = None
    pulse: tuple[PulseTable, ...] = ()
    site: dict[str, Site]
    sequence: Annotated[tuple[FreeFlyerAction, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _capture_is_sound(self) -> "FreeFlyerScenario":
        if self.capture is not None:
            end_s = sum(step.duration_s for step in self.sequence)
            if not self.capture.earliest_s <= self.capture.latest_s < end_s:
                raise ValueError(
                    f"capture must lie between earliest_s and latest_s, and both before the end, {end_s} s"
                )
        return self
