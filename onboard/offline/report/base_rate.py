"""Rate of a free base predicted with the identified payload, compared with the gyro (as figures 4.14 and 4.15).

The prediction uses the joints, the nominal vehicle and the last payload estimate; momentum and gyro offset are fitted
to the first part of the interval, and the rest is prediction.
"""

from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from drivers.records import Rows
from onboard.dynamics.free_flight import predict_base
from onboard.dynamics.kinematics import link_motions
from onboard.estimation.arrays import FloatArray
from onboard.offline.report.figures import legend
from onboard.offline.report.flight_data import FlightData
from onboard.offline.report.theme import COLOUR, CYCLE, subplots
from onboard.recording.reader import LogReader

_LONGEST_S, _SHORTEST_S = 30.0, 6.0
_FITTED = 1.0 / 3.0
_FIRST, _ROUNDS = 10, 8


class BaseRate(NamedTuple):
    """Rates in IMU axes over one interval without a gap, rad/s."""

    time_s: FloatArray  # (n,) since the log's start
    measured: FloatArray  # (n, 3)
    predicted: FloatArray  # (n, 3)
    fitted: int  # first ticks, used to fit momentum and offset

    @property
    def rms(self) -> FloatArray:
        """Rms of measured minus predicted after the fitted part, (3,) rad/s."""
        return np.asarray(np.sqrt(np.mean((self.measured - self.predicted)[self.fitted :] ** 2, axis=0)))


def base_rate(flight: FlightData) -> BaseRate | None:
    """Prediction over the last interval with the last payload estimate; None if the log lacks the data."""
    vehicle, model, roles = flight.vehicle, flight.model, flight.roles
    if vehicle is None or model is None or roles is None or vehicle.file.estimation.method != "exiddm":
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
    links = link_motions(model, rows["joint_rad"], rows["joint_rad_s"], rows["joint_rad_s2"])
    R, _ = model.pose_in_base(roles.imu.frame)
    measured: FloatArray = rows["measured"][:, :3].astype(np.float64)
    fitted = round(_FITTED * len(rows))
    momentum, offset = np.zeros(3), np.zeros(3)
    for part, free in ((_FIRST, 3), *[(fitted, 6)] * _ROUNDS):  # over the first few the rate is linear in the momentum
        base = predict_base(links, period_s, chi, momentum, ())
        gap = measured - base.rate @ R - offset
        A = np.concatenate([R.T @ base.d_rate, np.broadcast_to(np.eye(3), (len(rows), 3, 3))], axis=2)[:part, :, :free]
        step = np.linalg.lstsq(A.reshape(-1, free), gap[:part].ravel())[0]
        momentum, offset = momentum + step[:3], offset + np.append(step[3:], np.zeros(6 - free))
    predicted = predict_base(links, period_s, chi, momentum, ()).rate @ R + offset
    return BaseRate(flight.seconds(rows["vehicle_ns"]), measured, predicted, fitted)


def _unbroken(rows: Rows, start_ns: int, period_ns: int) -> Rows:
    """The longest run of consecutive rows from ``start_ns`` on with every signal present."""
    rows = rows[rows["vehicle_ns"] >= start_ns]
    fields = ("joint_rad", "joint_rad_s", "joint_rad_s2", "measured")
    whole = np.logical_and.reduce([np.isfinite(rows[field]).all(axis=1) for field in fields])
    follows = np.diff(rows["vehicle_ns"], prepend=0) == period_ns
    edges = np.flatnonzero(np.concatenate([[True], ~(whole[1:] & whole[:-1] & follows[1:]), [True]]))
    longest = int(np.argmax(np.diff(edges)))
    run = rows[edges[longest] : edges[longest + 1]]
    return run[1:] if len(run) and not np.isfinite(run["measured"][0]).all() else run


def draw(found: BaseRate) -> Figure:
    """Plot of each axis: gyro, prediction, and their difference."""
    figure, every = subplots(4, sharex=True)
    degrees = np.degrees(1.0)
    for axis, axes in enumerate(every[:3]):
        axes.plot(found.time_s, degrees * found.measured[:, axis], color=COLOUR["idle"], linewidth=3.0, label="gyro")
        axes.plot(found.time_s, degrees * found.predicted[:, axis], color=CYCLE[axis], linewidth=1.0, label="predicted")
        axes.set_title(f"base rate, {'xyz'[axis]} of the IMU")
        axes.set_ylabel("deg/s")
        legend(axes)
    for axis, colour in zip(range(3), CYCLE, strict=False):
        left = degrees * (found.measured - found.predicted)[:, axis]
        every[3].plot(found.time_s, left, color=colour, linewidth=0.7, label="xyz"[axis])
    every[3].set_title("gyro less prediction")
    every[3].set_ylabel("deg/s")
    every[3].set_xlabel("time, s")
    legend(every[3])
    for axes in every:
        axes.axvline(found.time_s[found.fitted], color=COLOUR["faint"], linestyle="--", linewidth=0.8)
    every[3].set_xlim(found.time_s[0], found.time_s[-1])
    return figure
