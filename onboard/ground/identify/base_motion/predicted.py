"""``heft predict``: a log's base motion by one or several derivations, with the parameters that are asked for."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.mechanics.momentum_form import Method, momentum_form
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.ground.identify.base_motion.fit import BaseRate, fit
from onboard.ground.identify.base_motion.flown import UnbrokenRun, flown, payload_in
from onboard.recording.reader import LogReader


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
        on_bed = run.model.spec.base.in_gravity
        found[method] = fit(form, run.rate, run.time_s, run.period_s, level_bed=on_bed)
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
    elif not drawn and run.held and (identified := payload_in(log)) is not None:
        chi[payload] = identified
        whose = "as drawn, payload by the onboard estimate"
    if not run.held:
        chi[payload] = 0.0
    return chi, whose
