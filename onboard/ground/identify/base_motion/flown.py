"""Joints and base rate of a log's longest run with one payload or none; the flight's estimator makes the ticks.

``heft predict``: a log's base motion by one or several derivations, with the parameters that are asked for.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.mechanics.momentum_form import Method, momentum_form
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.gates import ReasonArray
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.identify.base_motion.fit import BaseRate, fit
from onboard.ground.identify.kinds.likelihood_log import answer_in, runs_of
from onboard.ground.identify.kinds.tick_recorder import TickRecorder
from onboard.ground.identify.replay.feed import AT_ONCE_s, fed
from onboard.ground.log.tables.source import Interleaved
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.online import Change
from onboard.identification.windows import SHORTEST
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader
from onboard.regressor.signals import Signals


class UnbrokenRun(NamedTuple):
    """A run of ticks without a gap."""

    model: VehicleModel
    period_s: float
    time_s: FloatArray  # (n,) since the log's start
    q: FloatArray  # (n, joints)
    dq: FloatArray
    rate: FloatArray  # (n, 3) of the base, its axes, rad/s
    held: bool  # whether a payload is


class _Recorder(TickRecorder):
    """Keeps ticks; rates of the base in its own axes."""

    def __init__(self, model: VehicleModel, R_BS: FloatArray, *, means: bool) -> None:
        super().__init__(model.spec.payload_link or "payload", len(model.joints))
        self._R_BS, self._means = R_BS, means  # whether what is measured is the IMU, and not the wrench

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        found = super().update(signals, attached, excluded)
        rate = signals.measured[:, :3] @ self._R_BS.T if self._means else signals.motion.rate_rad_s
        rate = np.where(np.asarray(excluded)[:, None] == 0, rate, np.nan)  # only free flight is predicted
        self.ticks[-1] = self.ticks[-1]._replace(measured=np.concatenate([rate, np.zeros_like(rate)], axis=1))
        return found


def flown(vehicle: config.Vehicle, log: LogReader, longest_s: float) -> UnbrokenRun:
    """The last ``longest_s`` of the longest run with one payload; of one with none where no payload was ever held.

    Raises:
        ChannelError: a log of another vehicle, or no run long enough.
        ConfigError: a vehicle whose base does not float, or without an IMU or joints.
    """
    model, roles = build_model(vehicle), roles_of(vehicle)
    if not model.spec.base.floats:
        text = f'base = "{model.spec.base}"; only of a floating base is a motion predicted'
        raise config.ConfigError(f"{vehicle.label}: {text}")
    if not roles.imus or not model.joints:
        raise config.ConfigError(f"{vehicle.label}: an IMU and a joint are needed to predict and compare a motion")
    settings = vehicle.file.estimation
    recorder = _Recorder(model, model.pose_in_base(roles.imu.frame)[0], means=settings.how.tick_means)
    estimator = fed(Estimator(vehicle, recorder), log, AT_ONCE_s)
    ticks, attached = Ticks.joined(recorder.ticks), np.concatenate(recorder.attached)
    known = np.isfinite(ticks.measured[:, :3]).all(axis=1)
    ticks.q[~known] = np.nan  # a run ends where the gyro has a gap
    period_s = 1.0 / settings.row_rate_hz
    if settings.predicts and model.spec.base.falls:
        changes, held = answer_in(log).changes, settings.exiddm.held_at_start or settings.carried is not None
    else:
        changes, held = _edges(ticks.time_s, attached), bool(attached.size and attached[0])
    runs = runs_of(ticks, changes, held, period_s)
    best = max(runs, key=lambda run: (run.payload > 0, run.ticks.stop - run.ticks.start), default=None)
    longest = round(longest_s / period_s)
    if best is None or min(best.ticks.stop - best.ticks.start, longest) < SHORTEST:
        raise ChannelError(
            f"{log.path}: no {SHORTEST * period_s:g} s without a gap in joints and gyro while the payload stays the "
            "same; heft info says what is missing"
        )
    part = ticks.part(slice(max(best.ticks.start, best.ticks.stop - longest), best.ticks.stop))
    payload_held = best.payload > 0 and model.spec.payload_link is not None
    time_s = part.time_s - 1e-9 * (Interleaved(log, estimator.inputs).start_ns or 0)
    return UnbrokenRun(model, period_s, time_s, part.q, part.dq, part.measured[:, :3], payload_held)


def _edges(time_s: FloatArray, attached: BoolArray) -> list[Change]:
    """Changes of the payload by the mission's phases."""
    at = np.flatnonzero(np.diff(attached)) + 1
    return [
        Change("capture" if attached[k] else "ejection", float(time_s[k - 1]), float(time_s[k]), np.nan) for k in at
    ]


class Predicted(NamedTuple):
    """A log's base motion, measured and predicted."""

    log: Path
    vehicle: str
    parameters: str  # whose, in words
    held: bool
    found: dict[Method, BaseRate]
    refused: dict[Method, str]  # why a derivation does not apply

    def as_json(self) -> dict[str, Any]:
        """Plain values; rates in deg/s, base axes."""
        one = next(iter(self.found.values()))
        degrees = np.degrees(1.0)
        methods: dict[str, Any] = {str(method): {"refused": why} for method, why in self.refused.items()}
        for method, rate in self.found.items():
            angle, off = rate.turned()
            methods[str(method)] = {
                "rms_deg_s": (degrees * rate.rms).tolist(),
                "worst_deg_s": float(degrees * np.abs(rate.error).max()),
                "turned_deg": float(degrees * angle[-1]),
                "angle_error_end_deg": float(degrees * off[-1]),
                "angle_error_worst_deg": float(degrees * off.max()),
                "momentum_N_m_s": rate.momentum.tolist(),
                "gyro_offset_deg_s": (degrees * rate.offset).tolist(),
                "predicted_deg_s": (degrees * rate.predicted).tolist(),
            }
        return {
            "log": str(self.log),
            "vehicle": self.vehicle,
            "parameters": self.parameters,
            "payload_held": self.held,
            "fitted_s": [float(one.time_s[0]), float(one.time_s[one.fitted])],
            "predicted_s": [float(one.time_s[one.fitted]), float(one.time_s[-1])],
            "swing_deg_s": (degrees * one.swing).tolist(),
            "methods": methods,
            "time_s": one.time_s.tolist(),
            "measured_deg_s": (degrees * one.measured).tolist(),
        }


def predict(
    vehicle: config.Vehicle,
    log: LogReader,
    methods: Sequence[Method],
    longest_s: float = 30.0,
    urdf: Path | None = None,
    *,
    drawn: bool = False,
) -> Predicted:
    """Predict the base's motion over the last ``longest_s`` of a log's longest run with one payload.

    Args:
        vehicle: that flew.
        log: its log.
        methods: derivations.
        longest_s: of the interval; its first third fits momentum and gyro offset.
        urdf: with the bodies to predict with; else the last onboard estimate of the payload, if the log has one.
        drawn: with the vehicle's own URDF, whatever was identified.

    Raises:
        ChannelError: a log of another vehicle, or no interval long enough.
        ConfigError: a base that does not float.
        ModelError: a URDF of another vehicle; or no derivation applies.
    """
    run = flown(vehicle, log, longest_s)
    chi, whose = _parameters(run, log, urdf, drawn=drawn)
    found: dict[Method, BaseRate] = {}
    refused: dict[Method, str] = {}
    for method in methods:
        try:
            form = momentum_form(run.model, chi, method, run.q, run.dq)
        except SignalError as error:
            refused[method] = str(error)
            continue
        stated = vehicle.file.estimation.imu_prior.gyro_bias_rad_s or np.inf
        on_bed = run.model.spec.base.in_gravity
        found[method] = fit(form, run.rate, run.time_s, run.period_s, level_bed=on_bed, offset_rad_s=stated)
    if not found:
        raise SignalError("; ".join(refused.values()))
    return Predicted(log.path, vehicle.file.vehicle.name, whose, run.held, found, refused)


def _parameters(run: UnbrokenRun, log: LogReader, urdf: Path | None, *, drawn: bool) -> tuple[FloatArray, str]:
    """Standard parameters of all links, and whose they are in words."""
    model, payload = run.model, run.model.payload_columns()
    chi, whose = model.chi.copy(), "as drawn"
    if urdf is not None:
        other = VehicleModel(urdf.read_text(encoding="utf-8"), model.spec)
        if other.links != model.links:
            raise SignalError(f"{urdf} has links {', '.join(other.links)}; the vehicle has {', '.join(model.links)}")
        chi, whose = other.chi.copy(), f"of {urdf.name}"
    elif not drawn and run.held and (identified := answer_in(log).payload) is not None:
        chi[payload] = identified
        whose = "as drawn, payload by the onboard estimate"
    if not run.held:
        chi[payload] = 0.0
    return chi, whose
