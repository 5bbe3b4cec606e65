"""Predicts the motion of a free base with the current estimate, for the instruments of the recursive estimator.

From joints and momentum alone (:mod:`onboard.dynamics.free_flight` has the equations), one tick at a time:

    M_bb [v; w] = [0; eta] - M_bj dq,     M_bb [f; dw] = -(M_bj ddq + bias),     d eta / dt = eta x w

with M the joint-space inertia matrix, split into base and joints, and eta the angular momentum in base axes. Only the
momentum is measured, by the gyro, and a slow observer uses it with a lag *longer* than the smoothing kernel. The
prediction at a tick therefore shares no noise with the measurement at it.

A wrong estimate gives a weak instrument, not a bias.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import FREE_FLYER_NQ, FREE_FLYER_NV, VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.regressor.columns import body_parameters
from onboard.regressor.rows import BaseMotion

_MEMORY_S = 2.0  # of the momentum's observer


class _Tick(NamedTuple):
    time_s: float
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    rate: FloatArray
    held: bool


class PredictedMotion:
    """Predicts the base of a free vehicle, ticks in their order.

    Args:
        vehicle: with a free base.
        lag_s: the momentum is corrected so long after the tick that shows it; the smoothing kernel's width or more.

    Raises:
        SignalError: a lag that is not positive.
    """

    def __init__(self, vehicle: VehicleModel, lag_s: float) -> None:
        if not lag_s > 0.0:
            raise SignalError(f"the lag is {lag_s} s; give the smoothing kernel's width")
        self._lag_s = lag_s
        self._bodies = body_parameters(vehicle)
        self._payload = vehicle.payload_columns()
        self._turning = [joint.q_size == 2 for joint in vehicle.joints]
        self._models = {held: vehicle.model.copy() for held in (True, False)}
        self._data = vehicle.model.createData()
        self._axes: FloatArray = np.eye(3)
        self._momentum: FloatArray = np.zeros(3)  # in those axes
        self._seen_s: float | None = None  # of flight in it
        self._time_s = 0.0
        self._spin = self._spin_up = np.zeros(3)
        self._late: deque[tuple[float, FloatArray]] = deque()
        self._recent: deque[_Tick] = deque()
        self._state, self._v, self._a = (
            np.zeros(vehicle.model.nq),
            np.zeros(vehicle.model.nv),
            np.zeros(vehicle.model.nv),
        )
        self._state[FREE_FLYER_NQ - 1] = 1.0
        self._right = np.zeros(FREE_FLYER_NV)
        self.set(vehicle.chi)

    def set(self, chi: FloatArray) -> bool:
        """Predicts with these parameters from now on, if a vehicle can have them; with those before, if not.

        What was seen of the momentum in the last seconds is seen anew with them.

        Args:
            chi: standard parameters of all links, (10 x links,).

        Returns:
            Whether they were taken.
        """
        models = {}
        for held, model in self._models.items():
            own = chi.copy()
            if not held:
                own[self._payload] = 0.0
            changed = model.copy()
            for joint, ten in enumerate((self._bodies @ own).reshape(-1, 10), 1):
                if not ten[0] > 0.0:
                    return False
                changed.inertias[joint] = pin.Inertia.FromDynamicParameters(ten)
            neutral = pin.crba(changed, self._data, pin.neutral(changed))[:FREE_FLYER_NV, :FREE_FLYER_NV]
            if lapack.dpotrf(neutral)[1] != 0:
                return False
            models[held] = changed
        self._models, self._seen_s = models, None
        for tick in self._recent:
            self._predict(*tick)
        return True

    def forget(self) -> None:
        """Forgets the ticks before: they are predicted anew, or others come first."""
        self._recent.clear()

    def predict(
        self, times_s: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, rate: FloatArray, held: BoolArray
    ) -> BaseMotion:
        """Motion of the base frame at n ticks, none of it measured there.

        Args:
            times_s: (n,) increasing, going on from the ticks before; after a gap of more than the observer's memory,
                or where time goes back, the momentum is taken from the first tick.
            q: joint positions, (n, joints).
            dq: joint rates, (n, joints).
            ddq: joint accelerations, (n, joints).
            rate: measured angular rate of the base, base axes, (n, 3); shows the momentum, to later ticks.
            held: (n,) whether the payload is.
        """
        motion = np.empty((3, len(q), 3))
        for tick in range(len(q)):
            given = _Tick(float(times_s[tick]), q[tick], dq[tick], ddq[tick], rate[tick], bool(held[tick]))
            motion[:, tick] = self._predict(*given)
            self._recent.append(given)
            while self._recent[0].time_s < given.time_s - _MEMORY_S - self._lag_s:
                self._recent.popleft()
        return BaseMotion(*motion)

    def _predict(
        self, time_s: float, q: FloatArray, dq: FloatArray, ddq: FloatArray, rate: FloatArray, held: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        model, state, v, a, right = self._models[held], self._state, self._v, self._a, self._right
        self._place(state, q)
        M = pin.crba(model, self._data, state)
        base, of_joints = M[:FREE_FLYER_NV, :FREE_FLYER_NV], M[:FREE_FLYER_NV, FREE_FLYER_NV:] @ dq  # momentum
        eta = self._advance(time_s, self._shown(base, of_joints, rate))
        factor, _ = lapack.dpotrf(base)
        right[:3], right[3:] = -of_joints[:3], eta - of_joints[3:]
        w = lapack.dpotrs(factor, right)[0][3:]
        v[3:FREE_FLYER_NV], v[FREE_FLYER_NV:], a[FREE_FLYER_NV:] = w, dq, ddq
        thrust = -lapack.dpotrs(factor, pin.rnea(model, self._data, state, v, a)[:FREE_FLYER_NV])[0]
        self._spin, self._spin_up = w, thrust[3:]
        return w, thrust[3:], thrust[:3]

    def _place(self, state: FloatArray, q: FloatArray) -> None:
        if not any(self._turning):
            state[FREE_FLYER_NQ:] = q
            return
        at = FREE_FLYER_NQ
        for value, turning in zip(q, self._turning, strict=True):
            state[at : at + 1 + turning] = (np.cos(value), np.sin(value)) if turning else (value,)
            at += 1 + turning

    @staticmethod
    def _shown(base: FloatArray, of_joints: FloatArray, rate: FloatArray) -> FloatArray:
        """Angular momentum by the measured rate, the linear one being zero."""
        linear = -(base[:3, 3:] @ rate + of_joints[:3]) / base[0, 0]
        return np.asarray(base[3:, :3] @ linear + base[3:, 3:] @ rate + of_joints[3:], np.float64)

    def _advance(self, now_s: float, shown: FloatArray) -> FloatArray:
        """The momentum now, base axes: a fading mean in axes that do not turn, of what was seen a lag ago and before.

        Axes are carried on by the predicted rates; what they drift by within the mean's memory is no matter.
        """
        step = now_s - self._time_s
        if self._seen_s is None or not 0.0 < step < _MEMORY_S:
            self._axes, self._momentum, self._seen_s = np.eye(3), shown.copy(), 0.0
            self._late.clear()
        else:
            self._axes = self._axes @ pin.exp3((self._spin + 0.5 * step * self._spin_up) * step)
        while self._late and self._late[0][0] <= now_s - self._lag_s:
            self._seen_s = min(self._seen_s + step, _MEMORY_S)
            self._momentum = self._momentum + min(step / self._seen_s, 1.0) * (self._late.popleft()[1] - self._momentum)
        self._late.append((now_s, self._axes @ shown))
        self._time_s = now_s
        return np.asarray(self._axes.T @ self._momentum, np.float64)
