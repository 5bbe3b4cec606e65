"""``heft identify``: runs the onboard estimator on recorded flights and reports its final estimates.

For any vehicle these are the last quantities with their intervals, as in the onboard QUANTITY channel. For a free body
(``[free_body]`` in the vehicle file) the load is computed from them, with a summary of loads of known truth.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.records import Rows
from onboard import config
from onboard.config.checks import check
from onboard.dynamics.model.urdf import with_bodies
from onboard.dynamics.model.vehicle import STANDARD
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import named_refusals
from onboard.estimation.smoothing import CUTS_OFF
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.identify.kinds import throws
from onboard.ground.identify.kinds.body_log import identify_body
from onboard.ground.identify.kinds.free_flyer_log import identify_free_flyer, with_chosen_width
from onboard.ground.identify.kinds.identified import Identified, KeptRows, judged, standings
from onboard.ground.identify.kinds.misread_arm import with_mistake
from onboard.ground.identify.kinds.parabolic_log import identify_parabolas
from onboard.ground.identify.kinds.table_log import identify_pivot, identify_table
from onboard.ground.identify.kinds.throws import LoadSummary, Throw, ThrowCalibration
from onboard.ground.identify.replay.as_recorded import as_recorded
from onboard.ground.identify.replay.feed import check_channels, check_times, check_units, fed, feed_rows
from onboard.identification.observability import essential, observed_directions
from onboard.identification.quantities import SUPPORTED_SHRINKAGE, Estimate, QuantityEstimate
from onboard.identification.rows.budget import budget
from onboard.identification.rows.checks.prediction import HeldOutFit, prediction
from onboard.identification.rows.fitted_drawing import FittedLink, fitted_drawing
from onboard.identification.rows.held_out import held_out
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.standard import identified_links, standard_posterior, without_rotors
from onboard.identification.standing import Level
from onboard.identification.verdict import Evidence
from onboard.recording.format.errors import ChannelError
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

BY_LIKELIHOOD: Mapping[config.Prediction, Callable[[config.Vehicle, LogReader], Identified]] = {
    config.Prediction.FREE: identify_free_flyer,
    config.Prediction.PARABOLAS: identify_parabolas,
    config.Prediction.PLANAR: identify_table,
    config.Prediction.BODY: identify_body,
    config.Prediction.PIVOT: identify_pivot,
}
_PRINCIPAL = ("I_1", "I_2", "I_3")  # moments of a thrown load


@dataclass(frozen=True)
class Identification:
    """Results of all logs and their summary."""

    vehicle: config.Vehicle
    logs: tuple[Identified, ...]
    calibration: ThrowCalibration | None
    together: Mapping[str, Throw] = field(default_factory=dict)  # by load: all its throws in one estimate
    predicted: tuple[tuple[Path, HeldOutFit], ...] = ()  # other logs, from the first of these
    recorded: tuple[str, ...] = ()  # what the recording says of itself, other than the vehicle file

    @property
    def usable(self) -> bool:
        """Whether every log gives a usable estimate."""
        return all(log.usable for log in self.logs)

    @property
    def damage(self) -> tuple[str, ...]:
        """Damaged parts, with their log."""
        return tuple(f"{log.log}: {one}" for log in self.logs for one in log.damage)

    @property
    def summaries(self) -> list[LoadSummary]:
        """Summary by load, for loads with known truth."""
        return throws.summaries([log.throw for log in self.logs if log.throw is not None], self.together)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "vehicle": self.vehicle.file.vehicle.name,
            "logs": [log.as_json() for log in self.logs],
            "loads": [summary.as_json() for summary in self.summaries],
            "recorded": list(self.recorded),
            "calibration": self.calibration.as_json() if self.calibration else None,
            **({"predicted": {str(log): one._asdict() for log, one in self.predicted}} if self.predicted else {}),
        }


def by_method(vehicle: config.Vehicle, method: str) -> config.Vehicle:
    """The same vehicle with another estimator.

    Raises:
        ConfigError: its file lacks settings for it.
    """
    settings = vehicle.file.estimation.model_copy(update={"method": method})
    other = vehicle.with_sections(estimation=settings)
    check(other)
    if not settings.predicts and not (settings.base_rows or roles_of(other).cells):
        raise config.ConfigError(f"{vehicle.path}: there are no rows; give base_rows in [estimation], or a load cell")
    return other


def identify(
    vehicle: config.Vehicle, logs: Sequence[Path | LogReader], progress: Callable[[int], None] | None = None
) -> Identification:
    """Identify every log separately, and calibration throws also together by role.

    Args:
        vehicle: the vehicle flown.
        logs: its logs; one that was read through is not read through again.
        progress: called with the number of logs done.

    Raises:
        LogFormatError: a file is not a log.
        ChannelError: a log of another vehicle.
        LoadError: a log of a free body that matches no load or several.
        ConfigError: the vehicle file does not fit its URDF.
    """
    readers = [log if isinstance(log, LogReader) else LogReader(log, kept=1.0 / len(logs)) for log in logs]
    for reader in readers:
        check_units(vehicle, reader)
    vehicle, said = as_recorded(vehicle, readers[0])
    for reader in readers:
        check_channels(vehicle, reader)
        check_times(vehicle, reader)
    by_likelihood = BY_LIKELIHOOD.get(vehicle.prediction)
    vehicle, more, first = with_chosen_width(vehicle, readers[0], by_likelihood)
    loads = [throws.load_of(vehicle, log.path) if vehicle.file.free_body else None for log in readers]
    by_log = {log.path: load for log, load in zip(readers, loads, strict=True) if load is not None}
    if alone := throws.carriers(vehicle, by_log):
        empty: Identifier | None = None
        for reader in (one for one in readers if one.path in alone):
            empty = _again(vehicle, reader, empty, _settled(vehicle, reader))
        assert empty is not None
        vehicle = throws.with_carrier(vehicle, by_log[alone[0]], empty)
        more += (f"what carries the loads is as {', '.join(log.name for log in alone)} shows it",)
    pools, found = dict[str, Identifier](), []
    for reader, load in zip(readers, loads, strict=True):
        about = None if load is None or not vehicle.is_recorded else _settled(vehicle, reader)
        if by_likelihood is None:
            found.append(_one(vehicle, reader, load, about))
        else:
            found.append(first if first is not None and not found else by_likelihood(vehicle, reader))
        if load is not None:
            pools[load.name] = _again(vehicle, reader, pools.get(load.name), about)
        if progress:
            progress(len(found))
    loaded = {load.name: load for load in loads if load is not None}
    calibration = throws.calibrate(vehicle, {loaded[name].role: pool for name, pool in pools.items()})
    together = {name: throws.throw(vehicle, load, pools[name]) for name, load in loaded.items()}
    return Identification(vehicle, tuple(found), calibration, together, recorded=(*said, *more))


def _again(
    vehicle: config.Vehicle, log: LogReader, identifier: Identifier | None, about: FloatArray | None
) -> Identifier:
    """What an identifier, or a fresh one, knows after a log."""
    estimator = Estimator(vehicle, identifier, at_the_end=True)
    estimator.identifier.about = about
    return fed(estimator, log).identifier


def _settled(vehicle: config.Vehicle, log: LogReader) -> FloatArray | None:
    """Parameters by a first pass through a log, at which noise and errors of its rows are computed in the second."""
    first = _again(vehicle, log, None, None)
    return first.block_jackknife(exact=True).mean if first.rows_used else None


def _one(
    vehicle: config.Vehicle, log: LogReader, load: config.Load | None, about: FloatArray | None = None
) -> Identified:
    estimator = Estimator(vehicle, at_the_end=True)
    who = estimator.identifier
    who.about = about
    kept = KeptRows(who.seen.instruments)
    who.seen.listener = kept.keep
    method = vehicle.file.estimation.method
    last = None
    for channel, rows in feed_rows(estimator, log):
        if channel == "quantity":
            last = rows
    online, who = estimator.online, estimator.identifier  # the selected one, where instruments are redundant
    refused, names = named_refusals(who.refused), _asked_names(vehicle, who)
    thrown = throws.throw(vehicle, load, who) if load else None
    if last is None:
        nothing = Evidence(who.rows_used, refused, dict.fromkeys(names, False), None)
        return judged(log, nothing, method=method, throw=thrown)
    held, estimate, findings = held_out(who), online.estimate(), online.findings()
    answers, principal, drawing = _answers(last, who), list[QuantityEstimate](), tuple[FittedLink, ...]()
    if thrown is not None:  # few independent blocks of time give a wide interval, which is valid
        told = {q.name: q.shrinkage <= SUPPORTED_SHRINKAGE for q in estimate.quantities}
        links, principal = tuple(filter(None, [thrown.whole])), _principal(thrown)
        findings = findings.plus(doubts=throws.unlike_the_carrier(vehicle, thrown.load, estimate))
    else:
        told = dict(zip(estimate.names, estimate.supported.tolist(), strict=True))
        told |= {quantity.name: quantity.supported for quantity in estimate.quantities}
        after = standard_posterior(who, vehicle.file.estimation.nuisance)
        links = identified_links(who, after)
        held_link = who.model.vehicle.spec.payload_link
        drawing = fitted_drawing(who.model.vehicle.links, after, [one for one in links if one.link != held_link])
    away = {one.link: one.away for one in links}
    of_bodies = who.block_jackknife(exact=True).mean  # and not of errors of instruments
    if thrown is not None and thrown.principal is not None:
        away[f"the load {thrown.load.name}"] = thrown.principal.away
    evidence = Evidence(
        who.rows_used,
        refused,
        {name: told[name] for name in names} | {one.name: True for one in principal},
        held,
        estimator.inflation**2,
        _no_payload(who, estimate),
        away,
        findings=findings,
        standings=standings([*answers, *principal], useful_of(vehicle)),
    )
    found = judged(
        log,
        evidence,
        answers,
        method,
        throw=thrown,
        observability=observed_directions(who.taken.rls.observability(), who.base.names),
        essential=_essential(who, estimate),
        as_read=dict(zip(who.base.names, of_bodies.tolist(), strict=True)),
        budget={} if thrown is not None else budget(who),
        left_over=kept.left_over(of_bodies) if roles_of(vehicle).cells else {},
        band_Hz=1e3 * CUTS_OFF / vehicle.file.estimation.smoothing_ms,
        links=links,
        drawing=drawing,
        residuals=kept.residuals(who.taken.rls.solve().mean, 1.0 / vehicle.file.estimation.row_rate_hz),
    )
    return with_mistake(vehicle, log, found)


def _principal(thrown: throws.Throw) -> list[QuantityEstimate]:
    """Principal moments of a throw's load."""
    if thrown.principal is None:
        return []
    rows = zip(_PRINCIPAL, *(part.tolist() for part in thrown.principal), strict=True)
    return [QuantityEstimate(name, "kg m^2", value, sigma, low, high, True) for name, value, sigma, low, high in rows]


def _no_payload(who: Identifier, estimate: Estimate) -> str:
    """Reason why rows that could determine a payload do not; empty if they do."""
    payload = estimate.quantities[len(who.quantities) :]
    return "" if any(one.supported for one in payload) or not payload else payload[0].note


def _essential(who: Identifier, estimate: Estimate) -> tuple[str, ...]:
    """Determined base parameters that differ significantly from zero (Pham and Gautier 1991)."""
    told = np.flatnonzero(estimate.supported)
    if not told.size:
        return ()
    jackknife = who.block_jackknife()
    kept = essential(jackknife.mean[told], jackknife.covariance[np.ix_(told, told)])
    return tuple(estimate.names[k] for k in told[kept])


def _asked_names(vehicle: config.Vehicle, who: Identifier) -> list[str]:
    """Requested names: the quantities; without any, the payload's base parameters, or else all."""
    if who.quantity_names:
        return list(who.quantity_names)
    names = [name for name in who.base.names if name not in vehicle.file.estimation.nuisance]
    payload = who.model.vehicle.spec.payload_link
    own = [name for name in names if payload is not None and name.removesuffix("_R").endswith(f"_{payload}")]
    return own or names


def _answers(rows: Rows, who: Identifier) -> tuple[QuantityEstimate, ...]:
    """The last QUANTITY rows, with the bound of each; of a payload that is a body, not its base parameters."""
    link, held = who.model.vehicle.spec.payload_link, who.payload is not None
    told = held and any(printable(row["name"]) == f"m_{link}" and row["supported"] for row in rows)
    twice = {f"{kind}_{link}" for kind in STANDARD} if told else set[str]()
    found = []
    for row, bound in zip(rows, who.bounds(), strict=True):
        name = printable(row["name"])
        if name not in twice:
            unit = printable(row["unit"]) or ("kg" if name in (f"M_{link}", f"M_{link}_R") else "")
            value, sigma, low, high = (float(row[key]) for key in ("value", "sigma", "low", "high"))
            supported = bool(row["supported"])
            found.append(QuantityEstimate(name, unit, value, sigma, low, high, supported, float(bound)))
    return tuple(found)


def predict(vehicle: config.Vehicle, found: Identified, other: Path) -> HeldOutFit:
    """How well the base parameters of one log explain the rows of another.

    Args:
        vehicle: of both; by rows.
        found: identification of the first log.
        other: log to predict; its rows are not used for the parameters.

    Raises:
        LogFormatError: a file that is no log.
        ChannelError: a log of another vehicle, or one without a row that could be used.
        ConfigError: the vehicle's method has no rows.
    """
    estimator = Estimator(vehicle, at_the_end=True)
    for _ in feed_rows(estimator, LogReader(other)):
        pass
    who = estimator.identifier
    values = found.as_read
    if not who.rows_used or not values:
        which = other if values else found.log
        raise ChannelError(f"{which} has no row that could be used; heft identify says why")
    return prediction(who.seen, who.model, who.base, np.array([values[name] for name in who.base.names]))


def urdf(vehicle: config.Vehicle, found: Identified) -> str:
    """The vehicle's URDF with the bodies identified from a log.

    Raises:
        ValueError: the verdict is ``do not use``, or no link is determined.
    """
    if found.verdict.level is Level.DO_NOT_USE:
        raise ValueError(f"{found.log}: {found.verdict.text}; no URDF is made of it")
    bodies = {one.link: one.body for one in found.links if one.body is not None}
    if not bodies:
        raise ValueError(f"{found.log} determines no link of the URDF; there is nothing to write")
    if found.throw is not None:
        model = build_model(vehicle)
        bodies = {link: without_rotors(model, body) for link, body in bodies.items()}
    return with_bodies(vehicle.urdf_text, bodies)
