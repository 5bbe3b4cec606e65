"""``[estimation]``: phases, gates, priors, rows and what is reported."""

from typing import Annotated, Any, Literal

from pydantic import AliasChoices, Field, model_validator

from onboard.config.methods import METHODS, EstimationMethod
from onboard.section import NotNegative, Positive, Section

LAG_MS, LAG_OF_WIDTH = 200.0, 0.75  # of rows where none is stated: half of the kernel, and what channels come late


class Resumed(Section):
    """How far the mission had come when the power was lost; written by a start that goes on with a flight."""

    log: str
    phase: int
    begun: bool
    taken: bool
    gone: bool


class Phases(Section):
    """Phases of the mission for identification, from a phase channel.

    The payload is held from the phase ``payload_taken`` on, from the start where not given, to ``payload_gone``.
    """

    channel: str
    identify: list[int]
    payload_taken: int | None = None
    payload_gone: int | None = None
    end: int | None = None
    settle_ms: Annotated[float, Field(ge=0, le=60_000)] = 300
    resumed: Resumed | None = None


class Gates(Section):
    """Limits beyond which a row is not used."""

    joint_limits_deg: tuple[float, float] | None = None
    joint_rate_min_rad_s: Positive | None = None
    specific_force_m_s2: Positive | None = None
    specific_force_window_ms: Positive = 500
    residual_sigma: Positive = 6.0
    huber_sigma: Positive | None = None

    @model_validator(mode="after")
    def _limits_are_a_range(self) -> "Gates":
        if self.joint_limits_deg is not None and not self.joint_limits_deg[0] < self.joint_limits_deg[1]:
            low, high = self.joint_limits_deg
            raise ValueError(f"joint_limits_deg goes from {low:g} to {high:g}; write the lower limit first")
        return self


class Zero(Section):
    """Zeroing of the accelerometer: coasting at rest in ``phases``, for at least ``ticks`` row periods.

    ``drift_sigma_m_s2_k``: how much the offset may change per kelvin of the chip, 1 sigma; 0: not followed.
    """

    phases: list[int]
    ticks: Annotated[int, Field(ge=1)] = 100
    drift_sigma_m_s2_k: NotNegative = 0.003


class Link(Section):
    """Sigmas of a link's mass, centre of mass and inertia (the latter relative to half the tensor's trace)."""

    mass_relative: Annotated[float, Field(ge=1e-9, le=100)]
    centre_m: Annotated[float, Field(ge=1e-9, le=100)]
    inertia_relative: Annotated[float, Field(ge=1e-9, le=100)]


class JointKeys(Section):
    """Standard deviations of a joint's place in the drawing (each coordinate), and of its encoder's errors.

    With ``stiffness_N_m_rad`` the joint gives way between its encoder, which is on the drive, and its link.
    """

    position_m: NotNegative = 0.001
    zero_rad: NotNegative = 0.001
    scale: NotNegative = 2e-4
    delay_s: NotNegative = 2e-4
    stiffness_N_m_rad: Annotated[float, Field(ge=1e-3, le=1e7)] | None = None  # noqa: N815
    stiffness_relative: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    damping_N_m_s_rad: Annotated[float, Field(gt=0, le=1e5)] | None = None  # noqa: N815
    damping_relative: Annotated[float, Field(gt=0, le=1)] = 1.0

    @model_validator(mode="after")
    def _of_a_spring(self) -> "JointKeys":
        given = self.model_fields_set & {"stiffness_relative", "damping_N_m_s_rad", "damping_relative"}
        if given and self.stiffness_N_m_rad is None:
            raise ValueError(f"{', '.join(sorted(given))}: of a flexible joint; give stiffness_N_m_rad, or take it out")
        return self


class Prior(Section):
    """Prior: relative sigma by link, absolute sigma of the other columns, SI units.

    To rows each link is in ``link`` or in ``relative``. To the method "exiddm" links not in ``link`` are exact, joints
    not in ``joint`` have the defaults of its keys. A relative sigma of zero makes a link exact: it is not estimated,
    and its part moves to the rows' other side.
    """

    relative: dict[str, NotNegative] = Field(default_factory=dict)
    absolute: dict[str, Positive] = Field(default_factory=dict)
    link: dict[str, Link] = Field(default_factory=dict)
    joint: dict[str, JointKeys] = Field(default_factory=dict)


class LinkTolerance(Section):
    """How far a link may be from its drawing, 1 sigma: mass, centre of mass, inertia about that, place in the arm."""

    mass_relative: NotNegative = 0.03
    centre_m: NotNegative = 0.001
    inertia_relative: NotNegative = 0.01
    length_m: NotNegative = 0.00025


class Masses(Section):
    """Masses to report from the inertia about ``joint``, with the URDF's radii of gyration.

    ``drawing``: by link, how far it may be from its drawing; where not given, 1 mm, 1 % of inertia, 3 % of mass, and
    0.25 mm from the joint to the link.
    """

    joint: str
    arm_link: str
    drawing: dict[str, LinkTolerance] = Field(default_factory=dict)


class ImuPriorKeys(Section):
    """Prior on errors of the base IMU and of its place in the drawing: standard deviations per axis; zero: exact.

    Older files use ``doubt`` and ``turn`` for ``imu_prior`` and ``misalignment``. ``cross_axis`` keys that are not
    given are the smaller of scale and misalignment, which come from the same calibration. ``mounting_rad``: turns gyro
    and accelerometer alike; the misalignments are of each by itself.
    """

    gyro_bias_rad_s: NotNegative = 0.0
    gyro_drift_rad_s2: NotNegative = 0.0
    gyro_scale: NotNegative = 0.0
    gyro_misalignment_rad: NotNegative = Field(
        default=0.003, validation_alias=AliasChoices("gyro_misalignment_rad", "gyro_turn_rad")
    )
    gyro_cross_axis: NotNegative | None = None
    accelerometer_bias_m_s2: NotNegative = 0.0
    accelerometer_drift_m_s3: NotNegative = 0.0
    accelerometer_scale: NotNegative = 0.0
    accelerometer_misalignment_rad: NotNegative = Field(
        default=0.003, validation_alias=AliasChoices("accelerometer_misalignment_rad", "accelerometer_turn_rad")
    )
    accelerometer_cross_axis: NotNegative | None = None
    mounting_rad: NotNegative = 0.0
    delay_s: NotNegative = 0.0
    position_m: NotNegative = 0.003

    @property
    def cross_axis(self) -> tuple[float, float]:
        """Of gyro and accelerometer."""
        gyro, accelerometer = self.gyro_cross_axis, self.accelerometer_cross_axis
        if gyro is None:
            gyro = min(self.gyro_scale, self.gyro_misalignment_rad)
        if accelerometer is None:
            accelerometer = min(self.accelerometer_scale, self.accelerometer_misalignment_rad)
        return gyro, accelerometer


class DisturbanceKeys(Section):
    """What pushes a free base unknown on board: sigmas of first-order Gauss-Markov processes with a drift each.

    In the base's axes; zero: nothing does; silent: by the vehicle's mass (``priors.disturbance_prior``).
    ``time_s``: their correlation time.
    """

    force_N: NotNegative | None = None  # noqa: N815
    torque_N_m: NotNegative | None = None  # noqa: N815
    time_s: Positive = 60.0


class UsefulKeys(Section):
    """How wide half an interval may be where an answer is *good*.

    Over a mass, a moment of inertia, the largest moment of the body (products of inertia), or the body's size
    (coordinates of its centre of mass).
    """

    mass: Positive = 0.2
    moment: Positive = 0.2
    product: Positive = 0.2
    centre: Positive = 0.1


class MotorKeys(Section):
    """A motor coupled to several joints: its rate per joint rate, and its presliding length (Dahl)."""

    ratios: Annotated[dict[str, float], Field(min_length=2)]
    presliding_rad: NotNegative = 0.0


class Carried(Section):
    """Last estimate of an earlier flight, in place of the prior (warm start); written by ``heft fly --continue``.

    ``covariance`` of the parameters in ``names``; ``sensitivity`` of each to the considered parameters (a load cell's
    scale, its delay), which the covariance does not include.
    """

    log: str
    names: list[str]
    mean: list[float]
    covariance: list[list[float]]
    sensitivity: list[list[float]]


class FreeFlyerKeys(Section):
    """The non-linear estimator: payload state at the start, prior of the payload, rate of false alarms."""

    held_at_start: bool = True
    false_alarms_per_hour: Positive = 0.1
    payload_mass_sigma_kg: Positive = 50.0
    payload_first_moment_sigma_kg_m: Positive = 20.0
    payload_inertia_sigma_kg_m2: Positive = 10.0


class Estimation(Section):
    """The estimator's ticks, its smoothing kernel, its rows, its gates.

    ``method``: "rows" is least squares on rows of the vehicle's dynamics; "exiddm" predicts the base IMU of a free
        vehicle, estimates the payload, detects capture and ejection; it uses ``imu_prior``, ``exiddm`` and
        ``prior.link``.
    ``smoothing``: the kernel of every signal, ``smoothing_ms`` wide: a spline, or the steady-state Kalman smoother;
    see :mod:`onboard.estimation.kinematics`. ``lag_ms``: 0.75 times that, where 200 are too few.
    ``block_ms``: distance at which errors of rows are taken as independent; default: five times ``smoothing_ms``.
    ``row_noise``: "white" counts all noise of a row as white; "by_frequency" filters the rows of a base that is not
    free, so that what differentiated encoders add at high frequencies does not hide slow motion.
    ``base_rows`` are rows of a wrench known to be zero, within the two sigmas after it.
    ``zero_force_sigma_m_s2``: constant error of the specific force after zeroing; estimated if given.
    ``level_sigma_rad``: how far, by axis, gravity may be turned from where it is stated, of a fixed base whose joints'
    torques are measured; estimated, 1 degree where silent.
    ``motor``: those of joint torques that turn with more than one joint, by name; each has parameters ``Ia_``, ``Fv_``
    and ``Fc_`` of its own.
    ``carried``: warm start from an earlier flight with the same payload.
    ``nuisance``: base parameters that absorb unmodelled effects: estimated, but never reported as supported.
    """

    method: Literal["rows", "exiddm"] = "rows"
    step_ms: Annotated[float, Field(ge=1, le=1000)] = 50
    row_rate_hz: Annotated[float, Field(ge=0.1, le=10_000)] = 100
    lag_ms: Annotated[float, Field(ge=1, le=5000)] = LAG_MS
    smoothing_ms: Annotated[float, Field(ge=1, le=5000)] = 100
    smoothing: Literal["spline", "smoother"] = "spline"
    block_ms: Positive | None = None
    row_noise: Literal["white", "by_frequency"] = "white"
    base_rows: list[Literal["force", "moment"]] = Field(default_factory=list)
    base_force_sigma_N: Positive = 0.1  # noqa: N815
    base_moment_sigma_N_m: Positive = 5e-4  # noqa: N815
    zero_force_sigma_m_s2: Positive | None = None
    level_sigma_rad: NotNegative | None = None
    phases: Phases | None = None
    zero: Zero | None = None
    gates: Gates = Field(default_factory=Gates.model_construct)
    prior: Prior = Field(default_factory=Prior.model_construct)
    masses: Masses | None = None
    motor: dict[str, MotorKeys] = Field(default_factory=dict)
    nuisance: list[str] = Field(default_factory=list)
    carried: Carried | None = None
    exiddm: FreeFlyerKeys = Field(default_factory=FreeFlyerKeys.model_construct)
    disturbance: DisturbanceKeys = Field(default_factory=DisturbanceKeys.model_construct)
    useful: UsefulKeys = Field(default_factory=UsefulKeys.model_construct)
    imu_prior: ImuPriorKeys = Field(
        default_factory=ImuPriorKeys.model_construct, validation_alias=AliasChoices("imu_prior", "doubt")
    )

    @property
    def how(self) -> EstimationMethod:
        """Its method: what that needs, and who builds it."""
        return METHODS[self.method]

    @property
    def predicts(self) -> bool:
        """Whether its method predicts what the base's instruments show, and has no rows."""
        return self.how.predicts

    @model_validator(mode="before")
    @classmethod
    def _waits_for_the_kernel(cls, given: Any) -> Any:
        width_ms = given.get("smoothing_ms") if isinstance(given, dict) else None
        if isinstance(width_ms, int | float) and LAG_OF_WIDTH * width_ms > LAG_MS:
            return {"lag_ms": LAG_OF_WIDTH * width_ms} | given
        return given

    @model_validator(mode="after")
    def _kernel_is_full(self) -> "Estimation":
        if self.lag_ms < (half_ms := 0.5 * self.smoothing_ms):
            raise ValueError(
                f"lag_ms = {self.lag_ms:g}: a kernel of smoothing_ms = {self.smoothing_ms:g} ends {half_ms:g} ms after "
                f"its row, so no row would be made; write {LAG_OF_WIDTH * self.smoothing_ms:g}, or take lag_ms out"
            )
        return self
