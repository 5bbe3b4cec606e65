"""Estimates as records: ESTIMATE, a QUANTITY with level and reason for every parameter and quantity, and events.

A quantity is supported while the data determine it and its level is not *do not use*. The event ``withdrawn``: one that
was supported at any time is now *do not use*; ``answers_again``: it is supported again.
"""

import re
from collections.abc import Collection, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from drivers.records import EVENT, Batch, Rows, Severity, event
from onboard import channels, config
from onboard.estimation.arrays import FloatArray
from onboard.identification.free_flyer.innovation import ReferenceErrors
from onboard.identification.online import Change
from onboard.identification.quantities import Estimate, Findings, Useful, outer_of, sizes
from onboard.identification.standing import LEVELS, Level, Standing, standing
from onboard.recording.format.texts import listed


def innovation_rows(now_ns: int, told: Sequence[ReferenceErrors]) -> Rows:
    """INNOVATION rows (n,) of batches whose errors were noted."""
    rows = np.zeros(sum(len(one.time_s) for one in told), channels.INNOVATION)
    rows["host_ns"] = now_ns
    rows["vehicle_ns"] = np.round(np.concatenate([one.time_s for one in told]) * 1e9)
    for field in ("error", "sigma", "used"):
        rows[field] = np.concatenate([getattr(one, field) for one in told])
    return rows


def useful_of(vehicle: config.Vehicle) -> Useful:
    """How narrow an interval must be to be good, as the vehicle file states it."""
    return Useful(**vehicle.file.estimation.useful.model_dump())


class Answers:
    """Makes the records of one estimator's answers.

    Args:
        estimate_dtype: of the channel ``estimate``.
        nuisance: parameters that are never marked as supported.
        useful: how narrow an interval is that is good.
    """

    def __init__(self, estimate_dtype: np.dtype[np.void], nuisance: Collection[str], useful: Useful) -> None:
        self._dtype, self._nuisance, self._useful = estimate_dtype, list(nuisance), useful
        self._told: set[bytes] = set()  # supported at some time, and not withdrawn since
        self._withdrawn: set[bytes] = set()

    def rows(
        self, now_ns: int, vehicle_ns: int, estimate: Estimate, findings: Findings, triangle: FloatArray
    ) -> tuple[Rows, Rows, list[Batch]]:
        """ESTIMATE (1,), QUANTITY (parameters + quantities,), and events of what was withdrawn or came back."""
        state = np.zeros(1, self._dtype)
        state["host_ns"], state["vehicle_ns"] = now_ns, vehicle_ns
        state["rows_used"], state["rows_gated"] = estimate.rows_used, sum(estimate.refused.values())
        state["mean"] = estimate.mean
        state["triangle"] = triangle[_upper(len(triangle))]
        quantities = (*estimate.quantities, *estimate.also)
        answers = np.zeros(len(estimate.names) + len(quantities), channels.QUANTITY)
        answers["host_ns"], answers["vehicle_ns"] = now_ns, vehicle_ns
        p = len(estimate.names)
        for field in ("low", "high", "sigma", "supported"):
            answers[field][:p] = getattr(estimate, field)
        answers["value"][:p] = estimate.mean
        answers["low_999"][:p], answers["high_999"][:p] = outer_of(
            estimate.mean, estimate.low, estimate.high, estimate.far
        )
        answers["supported"][:p] &= np.array([name not in self._nuisance for name in estimate.names], np.bool_)
        answers["name"][:p] = [name.encode() for name in estimate.names]
        of_all = Standing(Level.GOOD).after(findings._replace(widened=()))
        known = answers["supported"][:p] != 0
        unknown = Standing(Level.WEAK, "not determined by the data so far").after(findings)
        for found, mine in ((of_all, known), (unknown, ~known)):
            answers["level"][:p][mine], answers["why"][:p][mine] = LEVELS.index(found.level), _shortened(found.why)
        if of_all.level is Level.DO_NOT_USE:
            answers["supported"][:p] = 0
        size = sizes(quantities, self._useful)
        judged = [(one, standing(one, findings, size.get(one.name))) for one in quantities]
        answers[_OF_QUANTITY][p:] = [
            (
                *(*one[2:6], *one.outer, one.drawn if one.supported else 0.0),
                *(one.supported and found.level is not Level.DO_NOT_USE, one.unit, one.name),
                *(LEVELS.index(found.level), _shortened(found.why)),
            )
            for one, found in judged
        ]
        return state, answers, self._changes(now_ns, answers[p:])

    def _changes(self, now_ns: int, quantities: Rows) -> list[Batch]:
        supported = {bytes(row["name"]): row for row in quantities if row["supported"]}
        refused = {bytes(row["name"]): row for row in quantities if row["level"] == LEVELS.index(Level.DO_NOT_USE)}
        gone, back = sorted(self._told & refused.keys()), sorted(self._withdrawn & supported.keys())
        self._told = (self._told | supported.keys()) - set(gone)
        self._withdrawn = (self._withdrawn | set(gone)) - set(back)
        said = []
        if gone:
            text = f"{_listed(gone)}: {refused[gone[0]]['why'].decode()}"
            said.append(event(now_ns, Severity.WARNING, "withdrawn", "estimation", _shortened(text, _TEXT).decode()))
        if back:
            said.append(event(now_ns, Severity.INFO, "answers_again", "estimation", _listed(back)))
        return said


@lru_cache
def _upper(size: int) -> tuple[NDArray[np.intp], ...]:
    """Places of the upper triangle of a square matrix."""
    return np.triu_indices(size)


_NUMBERS = ["value", "sigma", "low", "high", "low_999", "high_999", "drawn"]
_OF_QUANTITY = [*_NUMBERS, "supported", "unit", "name", "level", "why"]
WHY, _TEXT = channels.QUANTITY["why"].itemsize, EVENT["text"].itemsize


def _listed(names: Sequence[bytes]) -> str:
    return listed([name.decode() for name in names])


def _shortened(why: str, most: int = WHY) -> bytes:
    """A reason as long as the field; of a longer one the first words, and that there are more."""
    said = why.encode()
    return said if len(said) <= most else said[: most - 3].rpartition(b" ")[0] + b" ..."


_HYPOTHESES = {
    "left_out": "{} contradicts the other instruments: estimates without it",
    "absent": "{} has no readings that can be used: estimates without it",
    "taken_back": "{} no longer contradicts the other instruments: estimates with it",
    "release_contradicted": "a reported release of the payload is rejected: {}",
    "capture_contradicted": "a reported capture of the payload is rejected: {}",
}


_CHANGES = {
    "change": "change of payload or instruments, kind not yet known,",
    "contact": "contact that left the payload as it was,",
    "instrument": "change of an instrument, not of the payload,",
    "altered": "part of the payload lost or added, or an instrument changed,",
}


PAYLOAD_CHANGES = ("change", "capture", "ejection", "contact", "instrument", "altered")
INSTRUMENTS = ("left_out", "taken_back")
_REJECTED = ("release_contradicted", "capture_contradicted")
_AGO = re.compile(r"(-?\d+\.\d\d) s ago")


def change_event(now_ns: int, change: Change) -> Batch:
    """A change of the payload or of the selected hypothesis, as an event."""
    if change.kind in _HYPOTHESES:
        return event(now_ns, Severity.WARNING, change.kind, "estimation", _HYPOTHESES[change.kind].format(change.what))
    ago_s, since_s = (1e-9 * now_ns - at_s for at_s in (change.time_s, change.since_s))
    text = f"{_CHANGES.get(change.kind, change.kind)} {ago_s:.2f} s ago"
    if np.isfinite(change.score):
        text += f", not before {since_s:.2f} s ago; innovations {change.score:.1f} times their expected size"
    severity = Severity.WARNING if change.kind in ("instrument", "altered") else Severity.INFO
    return event(now_ns, severity, change.kind, "estimation", text)


def change_of(row: np.void) -> Change | None:
    """The change that an EVENT of :func:`change_event` tells, to the 10 ms of its text; None for any other event.

    Of an instrument that is left out or taken back it has the name.
    """
    kind, text = row["code"].decode("ascii", "replace"), row["text"].decode("utf-8", "replace")
    ago_s = [0.0] if kind in (*INSTRUMENTS, *_REJECTED) else [float(number) for number in _AGO.findall(text)]
    if row["source"] != b"estimation" or kind not in (*PAYLOAD_CHANGES, *INSTRUMENTS, *_REJECTED) or not ago_s:
        return None
    at_s, since_s = (1e-9 * float(row["host_ns"]) - ago for ago in (ago_s[0], ago_s[-1]))
    return Change(kind, at_s, since_s, np.nan, text.partition(" ")[0] if kind in INSTRUMENTS else "")
