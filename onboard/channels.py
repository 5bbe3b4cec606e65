"""Dtypes of heft's channels (clocks, estimates, rows); those of devices are in ``drivers.records``. Same rules."""

from enum import IntEnum

import numpy as np

_HEAD = [("sequence", "<u8"), ("host_ns", "<i8")]

CLOCK = np.dtype(
    [
        *_HEAD,
        ("reference_tick", "<f8"),
        ("reference_ns", "<f8"),  # vehicle time of reference_tick
        ("period_ns", "<f8"),
        ("sigma_ns", "<f8"),
        ("sigma_period_ns", "<f8"),
        ("residual_ns", "<f8"),  # of the last mark
        ("residual_rms_ns", "<f8"),
        ("marks", "<u4"),
        ("rejected", "<u4"),
        ("state", "u1"),  # ClockState
        ("channel", "S31"),
    ],
    align=True,
)

QUANTITY = np.dtype(
    [
        *_HEAD,
        ("vehicle_ns", "<i8"),  # of the last row that went in
        ("value", "<f8"),
        ("sigma", "<f8"),
        ("low", "<f8"),  # 95 % interval
        ("high", "<f8"),
        ("low_999", "<f8"),  # 99.9 % interval
        ("high_999", "<f8"),
        ("drawn", "<f8"),  # part of sigma that comes from the tolerances of the drawing
        ("supported", "u1"),  # 0: the data do not hold this quantity (yet), or it is not to be used: not to be shown
        ("level", "u1"),  # 0 good, 1 weak, 2 do not use
        ("why", "S128"),  # it is no better
        ("unit", "S15"),
        ("name", "S32"),
    ],
    align=True,
)


class Act(IntEnum):
    """Of a REQUEST row."""

    SEGMENT = 0  # the arm is to play it
    MET = 1  # nothing more: enough is known
    GIVEN_UP = 2


REQUEST = np.dtype(
    [
        *_HEAD,
        ("vehicle_ns", "<i8"),  # of the last row that it was made of
        ("ratio", "<f8"),  # of the widest asked half interval to what is wanted
        ("expected", "<f8"),  # the same after the segment
        ("number", "<u4"),
        ("act", "u1"),  # Act
        ("segment", "S32"),
    ],
    align=True,
)


INNOVATION = np.dtype(  # what the base IMU measured less what the filter had predicted, a tick, its axes
    [
        *_HEAD,
        ("vehicle_ns", "<i8"),
        ("error", "<f4", (6,)),  # rad/s, m/s^2
        ("sigma", "<f4", (6,)),  # of the error: noise, and what the filter did not know
        ("used", "u1"),  # 0: an outlier, left out
    ],
    align=True,
)


class Order(IntEnum):
    """What an operator may ask of a flight; PUS message subtypes of service 128."""

    MARK = 1  # a numbered line in the log
    STOP = 2  # the end of the flight, as by SIGTERM
    SPAN = 3  # packets of a span of the log


class Refusal(IntEnum):
    """Why an order is not carried out."""

    NONE = 0
    NOT_ARMED = 1
    OUT_OF_RANGE = 2
    DUPLICATE = 3
    UNKNOWN = 4
    MALFORMED = 5
    OTHER_SESSION = 6
    BUSY = 7
    NOT_DONE = 8


ORDER = np.dtype(  # of an operator, as it came, refused ones too
    [
        *_HEAD,
        ("begin_ns", "<i8"),  # of a SPAN, CLOCK_MONOTONIC
        ("end_ns", "<i8"),
        ("number", "<u4"),  # of a MARK
        ("order", "u1"),  # Order; 0: none that is known
        ("refused", "u1"),  # Refusal, by who took it
        ("who", "S62"),
    ],
    align=True,
)

ORDER_REPLY = np.dtype(  # of the supervisor, when an order was carried out
    [
        *_HEAD,
        ("order_sequence", "<u8"),
        ("refused", "u1"),  # Refusal
        ("channel", "S31"),  # of the order
    ],
    align=True,
)

TRIAL = np.dtype(  # of a controller, when it is over
    [
        *_HEAD,
        ("number", "<u4"),  # of its stage, from 1
        ("missed", "<u4"),  # SYNCs
        ("joints_rms_rad", "<f8"),  # of reference less measured, all joints; NaN: it did not begin
        ("tip_rms_m", "<f8"),  # the same of the tip, by the model's geometry
        ("saturated", "<f8"),  # share of the torques that were limited
        ("stage", "S16"),  # empty, before, after, learning
        ("stopped", "S192"),  # why it was; empty if it was not
    ],
    align=True,
)

HEALTH = np.dtype(  # a second of a real flight; NaN and -1: unknown
    [
        *_HEAD,
        ("status_word", "<u4"),  # onboard.flight.health.status.Status, of the last second
        ("status_latched", "<u4"),  # all bits since the start
        ("rows", "<u8"),  # of all devices, since the start
        ("rows_hz", "<f4"),
        ("slowest_percent", "<f4"),  # of its nominal rate, the slowest stream in the last second
        ("gaps", "<u4"),  # gap records since the start
        ("missing", "<u8"),  # rows in them
        ("not_recorded", "<u8"),  # rows that the recorder lost
        ("recorder_backlog_percent", "<f4"),  # of its ring: rows not yet in the log, the fullest ring
        ("estimator_lag_s", "<f4"),  # since the last sample that it took in, however long a sample takes to arrive
        ("row_age_s", "<f4"),  # of the newest row of the regression, the lag of the vehicle file included
        ("estimator_skipped_s", "<f4"),  # of the devices' rows left out, since the start
        ("acquisition_missed", "<u4"),  # ticks that came while the step before still ran, since the worker's start
        ("estimation_missed", "<u4"),
        ("recording_missed", "<u4"),
        ("restarts", "<u4"),  # of workers, since the start
        ("clocks_acquiring", "u1"),
        ("clocks_locked", "u1"),
        ("clocks_flywheel", "u1"),
        ("clocks_invalid", "u1"),
        ("supervisor_cpu_percent", "<f4"),  # of one core
        ("acquisition_cpu_percent", "<f4"),
        ("estimation_cpu_percent", "<f4"),
        ("recording_cpu_percent", "<f4"),
        ("others_cpu_percent", "<f4"),  # fork servers, spare workers, the live server, the page
        ("supervisor_pss_mb", "<f4"),  # one process a second is looked at
        ("acquisition_pss_mb", "<f4"),
        ("estimation_pss_mb", "<f4"),
        ("recording_pss_mb", "<f4"),
        ("others_pss_mb", "<f4"),
        ("computer_idle_percent", "<f4"),  # of all cores
        ("memory_free_mb", "<f4"),
        ("disk_free_mb", "<f4"),
        ("temperature_deg_c", "<f4"),  # the hottest zone
        ("throttled", "<i4"),  # bits of the Raspberry Pi's get_throttled
    ],
    align=True,
)

HEALTH_STREAM = np.dtype(  # a device's channel in the second before a HEALTH record
    [
        *_HEAD,
        ("rate_hz", "<f4"),
        ("nominal_hz", "<f4"),  # 0: it has none
        ("rows", "<u8"),  # since the start
        ("gaps", "<u4"),
        ("missing", "<u8"),
        ("unrecorded", "<i4"),  # rows in the ring that were not in the log; -1: unknown
        ("capacity", "<u4"),  # rows of the ring
        ("clock_state", "u1"),  # onboard.timebase.clock.ClockState; 255: no clock of its own
        ("channel", "S31"),
    ],
    align=True,
)

STANDING = np.dtype(  # how a flight stands, as its downlink tells it; in no log
    [
        *_HEAD,
        ("missing", "<u8"),  # packets that did not come
        ("damaged_bytes", "<u8"),  # that belong to no whole packet
        ("mode", "S15"),  # of the flight
        ("phase", "S31"),
    ],
    align=True,
)


def is_quantity(dtype: np.dtype[np.void]) -> bool:
    """Whether rows are QUANTITY, of this version or of one before it."""
    return {"value", "sigma", "low", "high", "supported", "unit", "name"} <= set(dtype.names or ())


NUMBERS = ("value", "low", "high", "low_999", "high_999", "sigma")
"""Fields of QUANTITY in its unit: value, ends of the 95 % and the 99.9 % interval, standard deviation."""


def numbers_of(row: np.void) -> dict[str, float]:
    """The :data:`NUMBERS` of a row, of a log of any version."""
    outer = dict(zip(("low_999", "high_999"), outer_ends(row), strict=True))
    return {name: float(outer[name] if name in outer else row[name]) for name in NUMBERS}


def outer_ends(rows: np.ndarray | np.void) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the 99.9 % intervals of QUANTITY rows; of a log of an earlier version those of a normal."""
    if "low_999" in (rows.dtype.names or ()):
        return rows["low_999"], rows["high_999"]
    value, wider = rows["value"], 3.2905 / 1.9600
    return value - wider * (value - rows["low"]), value + wider * (rows["high"] - value)


def tick_dtype(channels: int) -> np.dtype[np.void]:
    """TICK: what one step of the estimator consumed of each of ``channels`` channels, so that replay is exact."""
    return np.dtype(
        [
            *_HEAD,
            ("first_sequence", "<u8", (channels,)),
            ("last_sequence", "<u8", (channels,)),
            ("skipped_ns", "<i8"),  # of the devices' rows left out before this step: the estimator could not keep up
            ("consumed", "<u4", (channels,)),  # rows; 0: none, and the two sequence numbers are void
            ("final", "u1"),  # 1: the last step; no later samples are awaited
            ("fresh", "u1"),  # 1: a new estimator without data replaced one that died, from this step on
        ],
        align=True,
    )


def estimate_dtype(parameters: int, size: int) -> np.dtype[np.void]:
    """ESTIMATE: the state of the recursive estimator over ``parameters`` parameters, its triangle ``size`` wide."""
    return np.dtype(
        [
            *_HEAD,
            ("vehicle_ns", "<i8"),
            ("rows_used", "<u8"),
            ("rows_gated", "<u8"),
            ("mean", "<f8", (parameters,)),
            ("triangle", "<f8", (size * (size + 1) // 2,)),  # square-root information [R z], upper triangle by rows
        ],
        align=True,
    )


def row_dtype(rows: int, joints: int) -> np.dtype[np.void]:
    """ROW: the ``rows`` lines of the regression at one tick, the joints' motion, and why a line was left out."""
    return np.dtype(
        [
            *_HEAD,
            ("vehicle_ns", "<i8"),
            ("joint_rad", "<f8", (joints,)),
            ("joint_rad_s", "<f8", (joints,)),
            ("joint_rad_s2", "<f8", (joints,)),
            ("measured", "<f8", (rows,)),
            ("sigma", "<f8", (rows,)),
            ("gate", "<u4", (rows,)),  # onboard.estimation.gates.GateReason
            ("innovation", "<f4", (rows,)),  # measured less expected, sigmas; NaN: not compared
        ],
        align=True,
    )
