"""What every key outside ``[device]`` means, and when to change it: for the JSON Schema and ``docs/vehicle.md``.

The keys of devices are described by their modules, in ``docs/devices.md``.
"""

from typing import NamedTuple

from onboard.config import estimation
from onboard.config.bases.free_body import Carrier, FreeBody, Load
from onboard.config.bases.parabola import Parabola
from onboard.config.bases.pivot import Balance, Pivot
from onboard.config.bases.table import Body, Planar, Puck
from onboard.config.drive import Drive
from onboard.config.keys.bases import BALANCE, BODY, CARRIER, FREE_BODY, JOINT, LOAD, PARABOLA, PIVOT, PLANAR, PUCK
from onboard.config.keys.drive_meanings import DRIVE, MISSION
from onboard.config.keys.flight_meanings import REALTIME, TELEMETRY
from onboard.config.mission import MissionKeys
from onboard.config.telemetry import Telemetry
from onboard.config.vehicle import BusSection, LinkSection, Realtime, RecordingSection, VehicleSection
from onboard.section import Section


class KeyMeaning(NamedTuple):
    """Of a key: what it is, and when to change it (empty where it always is as the vehicle is)."""

    what: str
    change: str = ""


_M = KeyMeaning
MEANINGS: dict[type[Section], dict[str, KeyMeaning]] = {
    VehicleSection: {
        "name": _M("Name of the vehicle; logs are called by it."),
        "urdf": _M(
            "URDF file, relative to this file: links with mass, centre and inertia, joints with axes and limits."
        ),
        "base": _M(
            "What is known of the base: it floats freely, its motion is prescribed by something larger and measured, "
            "it is fixed in gravity, it floats on an air-bearing table, or it turns about the base link's origin on a "
            "spherical air bearing."
        ),
        "base_link": _M("Link of the URDF that the base IMU moves with."),
        "payload_link": _M("Link that stands for what is grappled; its inertia in the URDF is a first guess or zero."),
        "essential": _M(
            "Devices without which a flight has failed: heft fly ends with 1 if any of them was never heard.",
            "name what the answer cannot do without",
        ),
        "gravity_m_s2": _M(
            "Gravity in base axes; counts on a table, and where the base is fixed: an IMU there tells its direction, "
            "and has to read as much.",
            "the bench is tilted, or stands at another latitude",
        ),
    },
    BusSection: {"url": _M("Where the bus is opened; the table of URLs is in docs/devices.md.")},
    LinkSection: {
        "mass_kg": _M("Its mass.", "it was weighed: heft calibrate balance writes it"),
        "centre_of_mass_m": _M("Its centre of mass, link axes.", "it was balanced: heft calibrate balance writes it"),
        "inertia_kg_m2": _M(
            "XX, XY, YY, XZ, YZ, ZZ about its centre of mass, link axes.",
            "it was swung: heft calibrate bifilar writes it",
        ),
        "calibrated": _M("Date, log and command of its calibration."),
    },
    RecordingSection: {
        "directory": _M("Where logs go, relative to where heft runs.", "the medium for logs is mounted elsewhere"),
        "sync_period_ms": _M(
            "Nothing recorded is ever longer than this off the medium.", "the medium wears, or is slow"
        ),
        "segment_s": _M("A log goes on in a new file after this time.", "files are to be downlinked separately"),
        "segment_mib": _M("The same, after this size.", "as above"),
        "min_free_mib": _M(
            "The oldest segments of earlier flights are deleted while less is free; 0 keeps them all.",
            "a flight computer flies again and again without anybody who makes room",
        ),
        "reserve_mib": _M("Kept back for events and gaps when the disk is full."),
        "resume_s": _M("A start goes on with a flight that lost its power no longer ago; 0: never."),
    },
    estimation.Estimation: {
        "method": _M(
            '"rows": least squares on rows of the dynamics; "exiddm": predicts the base IMU of a free vehicle, finds '
            "payload, capture and ejection.",
            'a free base: "exiddm"',
        ),
        "step_ms": _M("The estimator runs this often; answers come at 10 Hz at most.", "the computer is slow"),
        "row_rate_hz": _M("Rows of the regression a second.", "the motion is faster than a tenth of it"),
        "lag_ms": _M(
            "Rows are made this long after the fact, when every channel has arrived; 0.75 times `smoothing_ms` where "
            "that is more and none is given. Less than half of it is refused.",
            "a device reports late: rows are then refused as gaps",
        ),
        "smoothing_ms": _M(
            "Width of the kernel that both sides of every row go through.",
            "wider for quiet, slow motion or gear ripple; narrower for fast motion",
        ),
        "smoothing": _M(
            "Kernel: a spline, or the steady-state Kalman smoother.",
            "a recording is identified: its rows may wait longer",
        ),
        "block_ms": _M(
            "Rows further apart than this are taken to err independently; five times smoothing_ms if not given.",
            "errors are slower than that (thermal, sloshing)",
        ),
        "row_noise": _M('"by_frequency" filters rows by their noise: no free base.', "no gear is in the residuals"),
        "base_rows": _M("Components of the base's wrench that are known to be zero and make rows.", "the base is free"),
        "base_force_sigma_N": _M("How well that force is known to be zero, 1 sigma.", "thrusters, drag or cables act"),
        "base_moment_sigma_N_m": _M("The same of the moment.", "as above"),
        "zero_force_sigma_m_s2": _M(
            "What zeroing leaves of a constant error of the specific force; estimated where given, and of a free body.",
            "the accelerometer is zeroed in flight",
        ),
        "level_sigma_rad": _M(
            "How far the base may lean, 1 sigma by axis; estimated, for a fixed arm by its torques; 0.0175 if silent.",
            "the base was levelled better, or stands on a slope",
        ),
        "phases": _M("Table: which phases of the mission are for identification."),
        "zero": _M("Table: where the accelerometer is zeroed."),
        "gates": _M("Table: which rows are refused."),
        "prior": _M("Table: what is known beforehand."),
        "masses": _M("Table: masses to report from inertia about a joint."),
        "motor": _M(
            "Tables by name: motors coupled to several joints; parameters Ia_NAME, Fv_NAME, Fc_NAME.",
            "a wrist is coupled, and its joints' torques are measured",
        ),
        "nuisance": _M(
            "Base parameters that take up what is not theirs: estimated, never reported as supported.",
            "a disturbance has the shape of a parameter (drag as a first moment)",
        ),
        "carried": _M("Table: what an earlier flight had learned; heft fly --continue writes it."),
        "exiddm": _M('Table of method "exiddm".'),
        "disturbance": _M('Table: what pushes a free base unknown on board, for method "exiddm".'),
        "useful": _M("Table: how narrow an interval must be to be good; a wider interval is weak."),
        "imu_prior": _M(
            "Table: sigmas of the base IMU's errors, for method exiddm; of rows, a moving base's two biases."
        ),
    },
    estimation.Phases: {
        "channel": _M("SCALAR channel whose value is the phase."),
        "identify": _M("Codes of the phases that are for identification."),
        "payload_taken": _M("The payload is held from this phase on; from the start where not given."),
        "payload_gone": _M("From this phase on it is no longer held."),
        "end": _M("The flight is over: heft fly stops."),
        "resumed": _M("Table: how far the mission had come when the power was lost; heft fly writes it."),
        "settle_ms": _M("Rows this close to a change of phase are not used.", "the arm rings for longer"),
    },
    estimation.Resumed: {
        "log": _M("Log of the part before."),
        "phase": _M("Phase that the mission was in."),
        "begun": _M("Whether there had been a phase for identification."),
        "taken": _M("Whether the payload had been taken."),
        "gone": _M("Whether it had been released."),
    },
    estimation.Gates: {
        "joint_limits_deg": _M(
            "Rows of any joint outside are refused as contact.", "stops or soft pads lie within reach"
        ),
        "joint_rate_min_rad_s": _M("Rows of slower joints are refused.", "stiction is felt at the turning points"),
        "specific_force_m_s2": _M("Beyond this mean specific force rows are refused as drag.", "air or thrust may act"),
        "specific_force_window_ms": _M("Window of that mean."),
        "residual_sigma": _M(
            "Rows further than this from the prediction are refused.", "outliers slip through, or too few do"
        ),
        "huber_sigma": _M("Rows further than this weigh less, by Huber.", "outliers are many and mild"),
    },
    estimation.Zero: {
        "phases": _M("Codes of the phases of coasting at rest."),
        "ticks": _M("So many row periods of it at least.", "coasting is shorter, or the accelerometer noisier"),
        "drift_sigma_m_s2_k": _M(
            "How much the offset changes per kelvin of the chip, 1 sigma; it is followed from rest to rest.",
            "another accelerometer; 0: it is not followed",
        ),
    },
    estimation.Link: {
        "mass_relative": _M("How well the link was weighed: relative, 1 sigma."),
        "centre_m": _M("How well it was balanced, 1 sigma."),
        "inertia_relative": _M("How well it was swung: relative to half the tensor's trace, 1 sigma."),
    },
    estimation.Prior: {
        "relative": _M("Relative sigma of all parameters of links not weighed; 0: exact.", "a link was measured"),
        "absolute": _M(
            "Absolute sigma of the other columns, SI, by name; by prediction: of friction and offset of joint torques.",
            "a bias is known to be small",
        ),
        "link": _M("How each link was measured, in place of `relative`; ExIDDM takes links not in it for exact."),
        "joint": _M(
            'How well places and encoders of joints are known, for method "exiddm"; the defaults for joints not in it.'
        ),
    },
    estimation.JointKeys: {key: _M(*said) for key, said in JOINT.items()},
    estimation.MotorKeys: {
        "ratios": _M("Motor rate per joint rate, by joint; 1 where both are equal at the joint."),
        "presliding_rad": _M(
            "Presliding length of its Coulomb friction after a reversal (Dahl); 0: none.",
            "friction lags behind reversals",
        ),
    },
    estimation.Masses: {
        "joint": _M("Joint about which the inertia is."),
        "arm_link": _M("Link of the arm; its radius of gyration is taken from the URDF, as the payload's is."),
        "drawing": _M("By link, how far it may be from its drawing.", "Weighed or balanced parts: state what is left."),
    },
    estimation.LinkTolerance: {
        "mass_relative": _M(
            "Standard deviation of the mass, relative; the arm's checks the scales of cells and encoders."
        ),
        "centre_m": _M("Standard deviation of each coordinate of the centre of mass."),
        "inertia_relative": _M("Standard deviation of the inertia about the centre of mass, relative, at its mass."),
        "length_m": _M("Standard deviation of each coordinate of its frame's place beyond the joint."),
    },
    estimation.Carried: {
        "log": _M("Log that it is from."),
        "names": _M("Parameters."),
        "mean": _M("Their values, SI."),
        "covariance": _M("Their covariance."),
        "sensitivity": _M("Of each to what is considered and no part of the covariance."),
    },
    estimation.FreeFlyerKeys: {
        "held_at_start": _M("Whether a payload is held when the flight begins.", "it is caught in flight: false"),
        "false_alarms_per_hour": _M("Of captures and ejections that are none.", "later alarms matter less, or more"),
        "payload_mass_sigma_kg": _M(
            "How large a payload could be, 1 sigma about none.", "the vehicle is larger than a ton"
        ),
        "payload_first_moment_sigma_kg_m": _M("The same of its first moment.", "as above"),
        "payload_inertia_sigma_kg_m2": _M("The same of its inertia.", "as above"),
    },
    estimation.DisturbanceKeys: {
        "force_N": _M(
            "Each component of a force at the base's origin, 1 sigma at first; silent: 0.4 mN a kilogram of vehicle.",
            "what drags, leaks and pulls is known",
        ),
        "torque_N_m": _M(
            "Of a torque, the same; silent: that force at the heaviest link's radius of gyration.", "as above"
        ),
        "time_s": _M("Correlation time of both.", "it changes faster"),
    },
    estimation.UsefulKeys: {
        "mass": _M("Half of a 95 % interval of a mass, over the mass.", "a controller asks for more, or needs less"),
        "moment": _M("Of a moment of inertia, over it.", "as above"),
        "product": _M("Of a product of inertia, over the body's largest moment.", "as above"),
        "centre": _M(
            "Of a coordinate of a centre of mass, over the body's size: rms distance of its mass from its frame.",
            "as above",
        ),
    },
    estimation.ImuPriorKeys: {
        "gyro_bias_rad_s": _M(
            "Bias of the gyro at the start, 1 sigma by axis. Silent of a free body: 8.7e-3.",
            "from a data sheet or a calibration",
        ),
        "gyro_drift_rad_s2": _M("Its drift.", "the IMU warms up in flight"),
        "gyro_scale": _M("Relative error of its scale.", "from the data sheet, or a calibration"),
        "gyro_misalignment_rad": _M("Of its axes in the frame.", "the mounting was measured"),
        "gyro_cross_axis": _M(
            "Share of an axis that another shows, each of six; silent: the least of the two above.",
            "the data sheet states it",
        ),
        "accelerometer_bias_m_s2": _M(
            "Bias of the accelerometer at the start. Silent of a free body: 0.1.",
            "from the data sheet, or a calibration",
        ),
        "accelerometer_drift_m_s3": _M("Its drift.", "the IMU warms up in flight"),
        "accelerometer_scale": _M("Relative error of its scale.", "from the data sheet, or a calibration"),
        "accelerometer_misalignment_rad": _M("Of its axes in the frame.", "the mounting was measured"),
        "accelerometer_cross_axis": _M("As of the gyro.", "the data sheet states it"),
        "mounting_rad": _M(
            "Of its housing, which turns gyro and accelerometer alike; the misalignments are then of each in it.",
            "the mounting was measured",
        ),
        "delay_s": _M("Of its samples, beyond what is known and taken off.", "its filter was not measured"),
        "position_m": _M("Of each coordinate of its place in the drawing.", "the mounting was measured"),
    },
    **{
        section: {key: _M(*said) for key, said in of.items()}
        for section, of in (
            *((FreeBody, FREE_BODY), (Carrier, CARRIER), (Load, LOAD), (Parabola, PARABOLA), (Drive, DRIVE)),
            *((Realtime, REALTIME), (Telemetry, TELEMETRY)),
            *((Planar, PLANAR), (Puck, PUCK), (Pivot, PIVOT), (Balance, BALANCE), (Body, BODY), (MissionKeys, MISSION)),
        )
    },
}
