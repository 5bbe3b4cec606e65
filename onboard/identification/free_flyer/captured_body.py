"""How a captured body came, reported on board: its rate in space and its velocity against the gripper just before.

Ticks about a change that may be a capture are kept until it is classified. Once the payload is known, its momentum is
what vehicle and payload have together after the capture, less what the vehicle alone would have
(:mod:`onboard.identification.free_flyer.before_capture`). As the payload becomes better known it is estimated again,
each time half as many more ticks have been used, with the zeros of the IMU at the capture as they were known best.
"""

from typing import Final, NamedTuple

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import HALF
from onboard.identification.free_flyer.before_capture import (
    ANNOUNCED_s,
    BeforeCapture,
    NoBodyError,
    Payload,
    Zeros,
    before_capture,
    margins_s,
)
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.free_flyer.recursion.recursive import MotionFilter
from onboard.identification.online import Change
from onboard.identification.quantities import SUPPORTED_SHRINKAGE, QuantityEstimate

NAMES: Final = tuple(f"{kind}_before_capture_{axis}" for kind in ("velocity", "rate") for axis in "xyz")
UNITS: Final = (*["m/s"] * 3, *["rad/s"] * 3)

_EXPECTED: Final = np.repeat([0.1, 1.0], 3)  # m/s, rad/s: how bodies may come; see SUPPORTED_SHRINKAGE
_KEPT_s: Final = 2.5  # ticks before a change is noticed
_AGAIN: Final = 1.5  # growth of the number of ticks at which the estimate is made again


class _Touch(NamedTuple):
    """Between which times a payload may have been touched first, and the ticks about them."""

    from_s: float
    until_s: float
    ticks: Ticks | None = None  # none until all have come


class CapturedBody:
    """Tells of a body that a :class:`MotionFilter` finds captured how it moved before.

    Args:
        ekf: the estimator.
    """

    def __init__(self, ekf: MotionFilter) -> None:
        self._ekf = ekf
        self._recent: Ticks | None = None
        self._seen = 0  # changes
        self._suspected: _Touch | None = None  # not classified
        self._captured: _Touch | None = None
        self._told: BeforeCapture | None = None
        self._zeros: list[Zeros] = []  # as they were known best
        self._failure, self._once = "", False
        self._used, self._next = 0, 0.0  # ticks at which it was reported last, and is due again

    def take(self, ticks: Ticks) -> None:
        """Keep ticks, and follow the changes that the estimator has found meanwhile."""
        recent = ticks if self._recent is None else self._recent.and_then(ticks)
        if not len(recent.time_s):
            return
        changes = self._ekf.changes
        for change in changes[self._seen :]:
            self._follow(change)
        self._seen = len(changes)
        self._suspected, self._captured = (
            _completed(one, recent, margins_s(self._ekf.predictor.period_s))
            for one in (self._suspected, self._captured)
        )
        settled = self._ekf.held and all(one is None or one.ticks for one in (self._suspected, self._captured))
        since_s = recent.time_s[-1] - (0.0 if settled else _KEPT_s)
        self._recent = recent.part(slice(int(np.searchsorted(recent.time_s, since_s)), None))

    def _follow(self, change: Change) -> None:
        if change.kind == "change":
            since_s = change.since_s if self._suspected is None else min(self._suspected.from_s, change.since_s)
            self._suspected = _Touch(since_s, change.time_s)
        elif change.kind == "capture":
            at_s, announced = change.time_s, not change.since_s < change.time_s
            if self._suspected is None or announced:
                early_s, late_s = (at_s - ANNOUNCED_s, at_s + ANNOUNCED_s) if announced else (change.since_s, at_s)
                self._suspected = _Touch(early_s, late_s)
            self._captured, self._suspected = self._suspected, None
            self._told, self._failure, self._once = None, "", True
            self._used, self._next, self._zeros = 0, 0.0, []
        elif change.kind in ("ejection", "capture_contradicted"):
            self._captured = self._suspected = self._told = None
        else:
            self._suspected = None

    def quantities(self, *, known: bool) -> tuple[QuantityEstimate, ...]:
        """Velocity of its centre of mass against the gripper, rate in space, gripper's axes; none before a capture.

        Args:
            known: the payload is.
        """
        if not self._once:
            return ()
        if self._captured is None:
            return _unknown("nothing is held")
        if self._told is None or not known:
            return _unknown(self._failure if known and self._failure else "the payload is not known")
        values = np.concatenate([self._told.velocity_m_s, self._told.rate_rad_s]).tolist()
        sigmas, shares = self._told.sigma.tolist(), (self._told.sigma / _EXPECTED).tolist()
        found = []
        for name, unit, value, sigma, share in zip(NAMES, UNITS, values, sigmas, shares, strict=True):
            if share <= SUPPORTED_SHRINKAGE:
                told = name, unit, value, sigma, value - HALF * sigma, value + HALF * sigma
                found.append(QuantityEstimate(*told, supported=True, shrinkage=share))
            else:
                why = f"known to {sigma:.2g} {unit} only: momentum and time of the contact determine no more"
                found.append(_untold(name, unit, why))
        return tuple(found)

    @property
    def due(self) -> bool:
        """It is due, if the payload is known."""
        used, ready = self._ekf.ticks_used, self._captured is not None and self._captured.ticks is not None
        return ready and (used < self._used or used >= self._next)  # fewer: the payload has been found again

    def tell(self, payload: Payload) -> None:
        """Tell it.

        Args:
            payload: as it is known now.
        """
        touch, ekf = self._captured, self._ekf
        assert touch is not None
        assert touch.ticks is not None
        known = [] if ekf.ticks_used < self._used else self._zeros
        self._used, self._next = ekf.ticks_used, _AGAIN * ekf.ticks_used
        if ekf.predictor.bends.size:
            self._told = None
            self._failure = "the joints are flexible: their encoders do not tell how the gripper moves"
            return
        if 0 in ekf.fusion.left_out:
            self._told, self._failure = None, f"{ekf.fusion.names[0]} is left out"
            return
        state, zeros = self._before(0.5 * (touch.from_s + touch.until_s))
        self._zeros = [min([zeros, *known], key=lambda one: float(np.diag(one.covariance).prod()))]
        try:
            between_s = touch.from_s, touch.until_s
            self._told = before_capture(ekf.predictor, state, touch.ticks, self._zeros[0], payload, between_s)
        except SignalError as error:
            self._told, self._failure = None, str(error)
            if isinstance(error, NoBodyError):
                self._next = 0.0

    def _before(self, at_s: float) -> tuple[FloatArray, Zeros]:
        """The state with nothing held, without biases, and the zeros of the base's IMU at the capture."""
        ekf, predictor = self._ekf, self._ekf.predictor
        assert ekf.state is not None
        assert self._recent is not None
        state, since_s = ekf.state.copy(), float(self._recent.time_s[-1]) - at_s
        covariance = predictor.aged(ekf.covariance, round(since_s / predictor.period_s))
        L, drifts = np.zeros((6, len(state))), dict(predictor.biases)
        own = [k for k in predictor.of_each[0].tolist() if "_bias_" in predictor.names[k]]
        for row, bias_at in zip(L, own if len(own) == len(L) else (), strict=False):
            row[bias_at] = 1.0
            if bias_at in drifts:
                row[drifts[bias_at]] = -since_s
        zeros = Zeros(L @ state, L @ covariance @ L.T)
        state[PAYLOAD] = 0.0
        state[np.flatnonzero(L.any(axis=0))] = 0.0
        return state, zeros


def _completed(touch: _Touch | None, recent: Ticks, margins_s: tuple[float, float]) -> _Touch | None:
    """With the ticks about it, once all have come."""
    if touch is None or touch.ticks is not None or recent.time_s[-1] < touch.until_s + margins_s[1]:
        return touch
    ends = touch.from_s - margins_s[0], touch.until_s + margins_s[1]
    return touch._replace(ticks=recent.part(slice(*np.searchsorted(recent.time_s, ends).tolist())))


def _unknown(why: str) -> tuple[QuantityEstimate, ...]:
    return tuple(_untold(name, unit, why) for name, unit in zip(NAMES, UNITS, strict=True))


def _untold(name: str, unit: str, why: str) -> QuantityEstimate:
    return QuantityEstimate(name, unit, np.nan, np.nan, np.nan, np.nan, False, note=why)
