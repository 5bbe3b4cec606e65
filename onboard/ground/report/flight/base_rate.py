"""Rate of a free base predicted with the identified payload, compared with the gyro (as figures 4.14 and 4.15).

The prediction uses the joints, the nominal vehicle and the last payload estimate; momentum and gyro offset are fitted
to the first part of the interval, and the rest is prediction.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drivers.records import Rows
from onboard import config
from onboard.dynamics.mechanics.momentum_form import Method, momentum_form
from onboard.estimation.arrays import FloatArray
from onboard.ground.drawing.theme import COLOUR, CYCLE, subplots
from onboard.ground.identify.base_motion.fit import BaseRate, fit
from onboard.ground.report.flight.figures import legend
from onboard.ground.report.flight.flight_data import FlightData
from onboard.recording.reader import LogReader

_LONGEST_S, _SHORTEST_S = 30.0, 6.0
_DEGREES = float(np.degrees(1.0))


def base_rate(flight: FlightData) -> BaseRate | None:
    """Prediction over the last interval with the last payload estimate; None if the log lacks the data."""
    vehicle, model, roles = flight.vehicle, flight.model, flight.roles
    if vehicle is None or model is None or roles is None or vehicle.prediction is config.Prediction.ROWS:
        return None
    payload = model.spec.payload_link
    mass = flight.quantities.get(f"m_{payload}")
    if mass is None or not mass[-1]["supported"]:
        return None
    start_ns = max(
        int(mass[-1]["vehicle_ns"]) - round(_LONGEST_S * 1e9), *(told_ns for told_ns, _ in flight.changes), 0
    )
    log = LogReader(flight.info.path)
    parts: dict[str, list[Rows]] = {"row": [], "estimate": []}
    for channel, some in log.batches(list(parts), start_ns=start_ns):
        parts[channel].append(some)
    if not all(parts.values()):
        return None
    rows = _unbroken(np.concatenate(parts["row"]), start_ns, round(1e9 / vehicle.file.estimation.row_rate_hz))
    period_s = 1.0 / vehicle.file.estimation.row_rate_hz
    if len(rows) < _SHORTEST_S / period_s:
        return None
    chi = model.chi.copy()
    chi[model.payload_columns()] = parts["estimate"][-1]["mean"][-1]
    R, _ = model.pose_in_base(roles.imu.frame)
    form = momentum_form(model, chi, Method.EXIDDM, rows["joint_rad"], rows["joint_rad_s"])
    measured: FloatArray = rows["measured"][:, :3].astype(np.float64) @ R.T
    offset_rad_s = vehicle.file.estimation.imu_prior.gyro_bias_rad_s or np.inf
    return fit(form, measured, flight.seconds(rows["vehicle_ns"]), period_s, offset_rad_s=offset_rad_s)


def _unbroken(rows: Rows, start_ns: int, period_ns: int) -> Rows:
    """The longest run of consecutive rows from ``start_ns`` on with every signal present."""
    rows = rows[rows["vehicle_ns"] >= start_ns]
    fields = (*(rows[field] for field in ("joint_rad", "joint_rad_s", "joint_rad_s2")), rows["measured"][:, :6])
    whole = np.logical_and.reduce([np.isfinite(field).all(axis=1) for field in fields])
    follows = np.diff(rows["vehicle_ns"], prepend=0) == period_ns
    edges = np.flatnonzero(np.concatenate([[True], ~(whole[1:] & whole[:-1] & follows[1:]), [True]]))
    longest = int(np.argmax(np.diff(edges)))
    run = rows[edges[longest] : edges[longest + 1]]
    return run[1:] if len(run) and not np.isfinite(run["measured"][0, :6]).all() else run


def rates(axes: Axes, found: BaseRate, axis: int) -> None:
    """What the gyro measured about one axis of the base."""
    axes.plot(found.time_s, _DEGREES * found.measured[:, axis], color=COLOUR["idle"], linewidth=3.0, label="gyro")
    axes.set_title(f"base rate, {'xyz'[axis]}")
    axes.set_ylabel("deg/s")


def common(every: list[Axes], found: BaseRate) -> None:
    """The end of the fitted part, and the axis of time."""
    for axes in every:
        axes.axvline(found.time_s[found.fitted], color=COLOUR["faint"], linestyle="--", linewidth=0.8)
    every[-1].set_xlabel("time, s")
    every[-1].set_xlim(found.time_s[0], found.time_s[-1])


def draw(found: BaseRate) -> Figure:
    """The report's figure: each axis with its prediction, and the difference."""
    figure, every = subplots(4, sharex=True)
    for axis, axes in enumerate(every[:3]):
        rates(axes, found, axis)
        predicted = _DEGREES * found.predicted[:, axis]
        axes.plot(found.time_s, predicted, color=CYCLE[axis], linewidth=1.0, label="predicted")
        legend(axes)
        left = _DEGREES * (found.measured - found.predicted)[:, axis]
        every[3].plot(found.time_s, left, color=CYCLE[axis], linewidth=0.7, label="xyz"[axis])
    every[3].set_title("gyro less prediction")
    every[3].set_ylabel("deg/s")
    legend(every[3])
    common(every, found)
    return figure
