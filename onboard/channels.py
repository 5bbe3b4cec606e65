"""Dtypes of heft's own channels (clocks, estimates, rows); those of devices are in ``drivers.records``. Same rules."""

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
        ("drawn", "<f8"),  # part of sigma that comes from the tolerances of the drawing
        ("supported", "u1"),  # 0: the data do not hold this quantity (yet), or it is not to be used: not to be shown
        ("level", "u1"),  # 0 good, 1 weak, 2 do not use
        ("why", "S128"),  # it is no better
        ("unit", "S15"),
        ("name", "S32"),
    ],
    align=True,
)


def is_quantity(dtype: np.dtype[np.void]) -> bool:
    """Whether rows are QUANTITY, of this version or of one before it."""
    return {"value", "sigma", "low", "high", "supported", "unit", "name"} <= set(dtype.names or ())


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
        ],
        align=True,
    )
