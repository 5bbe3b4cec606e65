"""Each estimate that a flight logged, held against what was true at its time: one that was later mended counts too.

A quantity's truth can change in flight. What an arm holds is nothing before the capture and after the ejection: its
mass is zero, and its centre and inertia have no truth. For :data:`CHANGING_S` after each nobody can yet have noticed,
and no estimate counts. Quantities of rows are each of one phase of the motion, and true throughout.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from onboard import config
from onboard.channels import outer_ends
from onboard.estimation.arrays import FloatArray
from onboard.ground.identify.mission import own_mission
from onboard.ground.log.tables.truth import Truth
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

CHANGING_S = 1.0  # lag_ms and smoothing_ms of the packaged vehicles, twice
_GOOD = 0  # QUANTITY.level


class Instants(NamedTuple):
    """Of one quantity, over the flight.

    Attributes:
        told: estimates that were supported and have a truth.
        beyond: those of them whose truth lies beyond their 99.9 % interval.
        good_beyond: those of these that were good.
        farthest: largest error over its side of the 99.9 % interval; NaN where none was reported.
    """

    told: int = 0
    beyond: int = 0
    good_beyond: int = 0
    farthest: float = math.nan

    def add(self, off: FloatArray, good: FloatArray) -> "Instants":
        """With more of them: errors by :func:`off_by` of the 99.9 % intervals (n,), and whether each was good (n,)."""
        if not off.size:
            return self
        wrong = off > 1.0
        return Instants(
            self.told + off.size,
            self.beyond + int(wrong.sum()),
            self.good_beyond + int((wrong & (good > 0.0)).sum()),
            float(np.fmax(self.farthest, off.max())),
        )


def of_flight(log: LogReader, vehicle: config.Vehicle, truth: Truth) -> dict[str, Instants]:
    """The instants of each quantity whose truth is known.

    Args:
        log: of the flight.
        vehicle: that flew.
        truth: of the world.
    """
    found = dict[str, Instants]()
    if "quantity" not in log.channels:
        return found
    true = {name: value for name, value in own_mission.true_values(vehicle, truth).items() if math.isfinite(value)}
    held = None if vehicle.prediction is config.Prediction.ROWS else _held(truth)
    for _, rows in log.batches(["quantity"]):
        shown = rows[(rows["supported"] > 0) & np.isfinite(rows["value"])]
        for raw in np.unique(shown["name"]):
            name = printable(raw)
            if name not in true:
                continue
            own = shown[shown["name"] == raw]
            at_s = 1e-9 * (own["vehicle_ns"].astype(np.float64) - float(truth["start_ns"]))
            value = _true_at(at_s, name, true[name], held, str(truth["payload_link"]))
            off = off_by(own["value"], *outer_ends(own), value)
            known = np.isfinite(value) & ~np.isnan(off)
            good = (own["level"] == _GOOD).astype(np.float64)
            found[name] = found.get(name, Instants()).add(off[known], good[known])
    return found


def off_by(value: ArrayLike, low: ArrayLike, high: ArrayLike, truth: ArrayLike) -> FloatArray:
    """Errors (n,) over the sides of their intervals on which the truths lie: above one the truth is beyond."""
    off, sides = np.subtract(truth, value), (np.subtract(value, low), np.subtract(high, value))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.abs(off) / np.where(off < 0.0, *sides), np.float64)


def _held(truth: Truth) -> tuple[float, float]:
    """Mission times between which the payload is held, s."""
    taken = truth.get("gripped_s") or truth.get("capture_s")
    let_go = truth.get("ejection_s")
    return -math.inf if taken is None else float(taken), math.inf if let_go is None else float(let_go)


def _true_at(at_s: FloatArray, name: str, value: float, held: tuple[float, float] | None, link: str) -> FloatArray:
    """The quantity's true value at each time (n,); NaN where it has none, or has just changed."""
    true = np.full(at_s.size, value)
    if held is None or not name.endswith(f"_{link}"):
        return true
    true[(at_s < held[0]) | (at_s > held[1])] = 0.0 if name == f"m_{link}" else math.nan
    for change in held:
        true[(at_s >= change) & (at_s < change + CHANGING_S)] = math.nan
    return true
