"""Warm start from the last estimate of an earlier flight: ``heft fly --continue``, ``heft identify --from``.

A computer that is restarted, or loses its power, loses the rings and the estimator in them; the log is on the medium up
to the last 0.2 s. Its last estimate goes into the vehicle file of the next flight, which that flight's log carries, so
it replays by itself. The information of the earlier rows is reduced until no interval is narrower than in the log;
common errors (a load cell's scale) are kept separate, so that they do not average out from flight to flight. The sigmas
of a free-flyer's payload are tripled, because errors of the other links and of the IMU are common to both flights.

The payload must be the same; otherwise fly without a warm start.
"""

from collections import deque
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tomli_w

from drivers.records import Rows
from onboard import config
from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import HALF
from onboard.flight.estimate.problem.identification import build_online
from onboard.identification.free_flyer.captured_body import NAMES
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.stated_errors.considered import Start
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader

COMMON_ERRORS = 3.0
_ALSO = [name.encode() for name in NAMES]


def go_on(vehicle: config.Vehicle, log: LogReader) -> config.Vehicle:
    """The vehicle file with the last estimate of ``log`` in it.

    Args:
        vehicle: to fly, or to identify.
        log: of a flight of the same vehicle by the same method.

    Raises:
        ChannelError: no estimate in the log, one of other parameters, or nothing that was held at its end.
        ConfigError: the vehicle file does not fit its URDF, or goes on from another log already.
    """
    settings = vehicle.file.estimation
    if settings.carried is not None:
        raise config.ConfigError(f"{vehicle.path} goes on from {settings.carried.log} already; take that table out")
    online, _ = build_online(vehicle)
    names = online.parameter_names
    p = len(names)
    estimate, said = _last_step(log, p + len(online.quantity_names))
    own = tuple(name.decode() for name in said["name"][:p])
    if own != names or estimate["mean"].size != p:
        raise ChannelError(f"{log.path} has estimates of {', '.join(own)}, not of {', '.join(names)}; see its vehicle")
    size = len(online.triangle())
    triangle = np.zeros((size, size))
    triangle[np.triu_indices(size)] = estimate["triangle"]
    if isinstance(online, Identifier):
        return _with(vehicle, log.path, _of_rows(online, estimate, said, triangle), names)
    return _with(vehicle, log.path, _of_payload(log, estimate, triangle), names)


def _of_rows(identifier: Identifier, estimate: np.void, said: Rows, triangle: FloatArray) -> Start:
    p, k = len(identifier.base.names), len(identifier.considered)
    R = triangle[:p, :p]
    root = np.linalg.inv(R)
    weights = np.vstack([np.eye(p), *(quantity.weights for quantity in identifier.quantities)])
    formal = ((weights @ root) ** 2).sum(axis=1)
    considered = np.array([cause.sigma for cause in identifier.considered]) * (not identifier.fits_errors)
    # Of fitted errors an interval has less than was stated, and how much less no log tells: none of it is taken off.
    common = ((weights @ root @ triangle[:p, p : p + k] * considered) ** 2).sum(axis=1)
    said = said[: len(weights)]  # what is no combination of parameters follows from these
    half = 0.5 * (said["high"] - said["low"]) / HALF
    fine = said["supported"] != 0
    wider = np.max((half**2 - common)[fine] / formal[fine], initial=1.0)
    known, right = identifier.rls.prior_equations()
    covariance = np.linalg.inv(known + (R.T @ R - known) / wider)
    mean = covariance @ (right + (R.T @ R @ estimate["mean"] - right) / wider)
    sensitivity = covariance @ R.T @ triangle[:p, p : p + k] / wider
    return Start(mean, 0.5 * (covariance + covariance.T), sensitivity)


def _of_payload(log: LogReader, estimate: np.void, triangle: FloatArray) -> Start:
    R = triangle[:-1, :-1]
    if not R.diagonal().all():
        raise ChannelError(f"{log.path}: nothing was held at the end of that flight; there is nothing to go on from")
    root = COMMON_ERRORS * np.linalg.inv(R)
    return Start(estimate["mean"], root @ root.T, np.zeros((len(R), 0)))


def _last_step(log: LogReader, answers: int) -> tuple[np.void, Rows]:
    """The last ESTIMATE whose QUANTITY rows are all there, and these, without what was not asked for."""
    tails = []
    for channel in ("estimate", "quantity"):
        batches = log.batches([channel]) if channel in log.channels else iter(())
        tails.append([rows for _, rows in deque(batches, maxlen=2)])
    if all(tails):
        estimates, quantities = (np.concatenate(tail) for tail in tails)
        for estimate in estimates[::-1]:
            said = quantities[quantities["host_ns"] == estimate["host_ns"]]
            said = said[~np.isin(said["name"], _ALSO)]
            said = said[-answers:]  # the last step may have been made twice
            if len(said) == answers and len(np.unique(said["name"])) == answers:
                return estimate, said
    raise ChannelError(f"{log.path} holds no whole estimate of this vehicle: there is nothing to go on from")


def _with(vehicle: config.Vehicle, log: Path, start: Start, names: Sequence[str]) -> config.Vehicle:
    carried = {"log": log.name, "names": list(names)}
    carried |= {name: values.tolist() for name, values in start._asdict().items()}
    table = tomli_w.dumps({"estimation": {"carried": carried}})
    return config.parse(f"{vehicle.text.rstrip()}\n\n{table}", vehicle.path, vehicle.urdf_path)
