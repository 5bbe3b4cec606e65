"""Tables of a scenario: sensors, ``[sensor.NAME]``, and clock errors, ``[clock.NAME]``.

A sensor table describes a sensor type as its datasheet does; each device that ``measures`` it draws its own errors.
``quantity`` is the physical quantity measured.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, model_validator

Vector = tuple[float, float, float]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
MeasuredQuantity = Literal[
    "inertial", "joint_angle", "joint_moment", "force", "servo_torque", "phase", "wheel_rate", "thrust", "pose"
]


class Table(BaseModel):
    """Base of all tables: frozen, unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class Axes(Table):
    """Errors of one triad (accelerometer or gyro); ``sigma`` values are drawn once per seed and axis.

    Bandwidth and delay are those of each code of the device's filter, or one of each where there is nothing to choose.
    In flight the bias wanders: ``bias_instability``, rms, with a correlation time, and ``bias_walk_sqrt_s``, a random
    walk, per square root of a second.
    """

    noise_density: NonNegative
    bias_sigma: Vector
    bias_per_kelvin_sigma: Vector
    scale_sigma: NonNegative
    cross_axis_sigma: NonNegative
    bias_instability: NonNegative = 0.0
    bias_instability_time_s: PositiveFloat = 100.0
    bias_walk_sqrt_s: NonNegative = 0.0
    bandwidth_Hz: tuple[PositiveFloat, ...]
    delay_ms: tuple[NonNegative, ...]

    @model_validator(mode="after")
    def _one_or_eight(self) -> "Axes":
        if len(self.bandwidth_Hz) not in (1, 8) or len(self.delay_ms) != len(self.bandwidth_Hz):
            raise ValueError(
                "bandwidth_Hz and delay_ms have an entry for each of the 8 filter codes, or a single entry"
            )
        return self

    def filter(self, code: int) -> tuple[float, float]:
        """Bandwidth in Hz and delay in s by filter code."""
        place = code if len(self.bandwidth_Hz) > 1 else 0
        return self.bandwidth_Hz[place], 1e-3 * self.delay_ms[place]


class ImuTable(Table):
    """Specific force and angular rate at the IMU's place."""

    quantity: Literal["inertial"]
    accel_g: Axes
    gyro_deg_s: Axes
    gyro_per_g_sigma_deg_s: NonNegative
    mounting_sigma_deg: NonNegative
    temperature_start_degC: float
    temperature_rise_K: float
    temperature_time_s: PositiveFloat
    temperature_noise_counts: NonNegative


class EncoderTable(Table):
    """The joint's angle, in counts."""

    quantity: Literal["joint_angle"]
    counts_per_revolution: PositiveInt
    gear_ratio: PositiveFloat
    eccentricity_urad: NonNegative
    transmission_error_urad: NonNegative
    zero_sigma_mrad: NonNegative = 0.0


class _Bridge(Table):
    """A strain gauge bridge and its transmitter."""

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
    delay_sigma_ms: NonNegative = 0.0
    full_scale_readings_s: tuple[float, ...]
    full_scale_window_ms: PositiveFloat


class LoadCellTable(_Bridge):
    """The moment about ``axis`` of a flange (its joint's, where not given), on all beyond, as a force on a lever."""

    quantity: Literal["joint_moment"]
    axis: Vector = (0.0, 0.0, 1.0)
    lever_mm: PositiveFloat
    lever_sigma_mm: NonNegative


class ForceCellTable(_Bridge):
    """The force in a flange along ``axis`` (flange axes), on everything beyond it."""

    quantity: Literal["force"]
    axis: Vector


class MotorTorqueTable(Table):
    """Servo torque from the motor current, friction included."""

    quantity: Literal["servo_torque"]
    scale_sigma: NonNegative
    offset_sigma_Nm: NonNegative
    noise_rms_Nm: NonNegative


class WheelRateTable(Table):
    """The speed of a reaction wheel against the base, in steps of ``step_rad_s``."""

    quantity: Literal["wheel_rate"]
    scale_sigma: NonNegative
    noise_rms_rad_s: NonNegative
    step_rad_s: PositiveFloat


class ThrustTable(Table):
    """The force of a thruster as its driver tells it, in steps of ``step_N``; it has a scale error."""

    quantity: Literal["thrust"]
    scale_sigma: NonNegative
    step_N: PositiveFloat


class PoseTable(Table):
    """Position and attitude of a frame in a laboratory's motion capture, which has a scale error.

    ``place_sigma_mm``, ``mounting_sigma_deg``: of the markers' frame from where it is drawn. Noise is that of one pose.
    """

    quantity: Literal["pose"]
    position_noise_mm: NonNegative
    attitude_noise_deg: NonNegative
    scale_sigma: NonNegative
    place_sigma_mm: NonNegative
    mounting_sigma_deg: NonNegative


class PhaseTable(Table):
    """The code of the sequence's phase."""

    quantity: Literal["phase"]


SensorTable = Annotated[
    ImuTable
    | EncoderTable
    | LoadCellTable
    | ForceCellTable
    | MotorTorqueTable
    | WheelRateTable
    | ThrustTable
    | PoseTable
    | PhaseTable,
    Field(discriminator="quantity"),
]


class ClockTable(Table):
    """``[clock.*]``: relative rate error and its drift, drawn once per seed; the rate is clipped at ``rate_limit``."""

    rate_sigma: NonNegative
    rate_limit: NonNegative
    drift_sigma_per_s: NonNegative
