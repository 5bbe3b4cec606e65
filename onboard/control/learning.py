"""Learning controllers (Limparis section 2.2.1; figures 2.15 to 2.17; Arimoto, Heinzinger and others, his [72], [75]).

The same motion is tried again and again; what was wrong in trial k changes the feed-forward of the next. With e the
error of position, ``e = q_d - q_k``,

    PD:          u_(k+1) = u_k + Phi de + Gamma dde
    PI:          u_(k+1) = u_k + Phi de + Psi e
    forgetting:  u_(k+1) = (1 - alpha) u_k + alpha u_0 + Phi de + Psi e

(proportional to the rate's error, and its derivative or its integral; the dissertation draws them and prints no
equations). Errors are low-passed without phase, so that nothing is learned from noise that the arm cannot follow.

Of a joint of inertia M with feedback ``K_p e + K_v de``, a trial multiplies the error at every frequency by ``1 - alpha
- L G``, with ``G = 1 / (M s^2 + K_v s + K_p)`` and ``L = Phi s + Gamma s^2`` or ``Phi s + Psi``. Without forgetting its
magnitude is below one at all frequencies exactly where

    PD:  Gamma < 2 M  and  2 K_p Gamma < Phi (2 K_v - Phi)
    PI:  Psi < 2 K_p  and  2 M Psi < Phi (2 K_v - Phi)

(squares of both sides, s = j w; derived here). The PD's depend on the inertia from one side only: a heavier payload
never makes it unstable. For an arm :func:`contraction` computes it with matrices.
"""

from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np

from onboard.control.drives import smoothed
from onboard.control.laws import AHEAD, DAMPING, Gains
from onboard.estimation.arrays import FloatArray

_OF_RATE: Final = 0.8  # Phi, of K_v
_OF_INERTIA: Final = 0.8  # Gamma, of the inertia without a payload
_HEAVIEST: Final = 8.0  # times that inertia is what Psi allows for
FORGETS: Final = 0.05  # alpha
LOW_PASS_HZ: Final = 5.0


class LearningLaw(StrEnum):
    """The three laws."""

    PD = "learning_pd"
    PI = "learning_pi"
    FORGETTING = "learning_forgetting"


class Learning(NamedTuple):
    """A law with its gains, (n,) each: of the rate (N m s/rad), its derivative (kg m^2), its integral (N m/rad)."""

    rate: FloatArray
    derivative: FloatArray
    integral: FloatArray
    forgetting: float = 0.0
    low_pass_hz: float = LOW_PASS_HZ

    @staticmethod
    def of(kind: LearningLaw, gains: Gains, inertia: FloatArray, factor: float = 1.0) -> "Learning":
        """The gains of a law: ``factor`` times those that are stable up to eight times the inertia.

        Args:
            kind: of the law.
            gains: of the feedback.
            inertia: of each joint by the model, the others free, (n,) kg m^2.
            factor: of all learning gains.
        """
        none = np.zeros(len(inertia))
        rate = factor * _OF_RATE * gains.rate
        if kind is LearningLaw.PD:
            return Learning(rate, factor * _OF_INERTIA * inertia, none)
        # 2 M Psi < Phi (2 K_v - Phi) at M = 8 times the inertia, and a fifth less
        most = _OF_RATE * (2.0 - _OF_RATE) * DAMPING**2 * 2.0 / _HEAVIEST
        return Learning(
            rate, none, factor * 0.8 * most * gains.position, FORGETS if kind is LearningLaw.FORGETTING else 0.0
        )

    def next(self, torques: FloatArray, first: FloatArray, error: FloatArray, period_s: float) -> FloatArray:
        """The feed-forward of the next trial, (m, n) N m.

        Args:
            torques: of this trial, (m, n); row i is in force about ``(i + 1.5) T``.
            first: of the first trial, (m, n).
            error: of position at the SYNCs of this trial, (m, n) rad.
            period_s: T.
        """
        e = smoothed(error, period_s, self.low_pass_hz)
        de = np.gradient(e, period_s, axis=0)
        change = self.rate * de + self.derivative * np.gradient(de, period_s, axis=0) + self.integral * e
        at = np.minimum(np.arange(len(error)) + AHEAD, len(error) - 1.0)
        low = np.floor(at).astype(np.intp)
        share = (at - low)[:, None]
        acting = (1.0 - share) * change[low] + share * change[np.minimum(low + 1, len(error) - 1)]
        kept = (1.0 - self.forgetting) * torques + self.forgetting * first
        return np.asarray(kept + acting, np.float64)


def contraction(
    learning: Learning, gains: Gains, inertia: FloatArray, viscous: FloatArray, frequency_hz: FloatArray
) -> FloatArray:
    """Spectral radius of what one trial does to the error at each frequency, (f,): below 1 it is learned.

    Args:
        learning: the law.
        gains: of the feedback.
        inertia: of the arm at a posture, (n, n) kg m^2, rotors included.
        viscous: of its joints, (n,) N m s/rad.
        frequency_hz: (f,).
    """
    s = (2j * np.pi * np.asarray(frequency_hz))[:, None, None]
    plant = s * s * inertia + s * np.diag(gains.rate + viscous) + np.diag(gains.position)
    low_passed = 1.0 / (1.0 + (np.abs(s) / (2.0 * np.pi * learning.low_pass_hz)) ** 4)  # Butterworth, there and back
    law = low_passed * (s * np.diag(learning.rate) + s * s * np.diag(learning.derivative) + np.diag(learning.integral))
    trial = (1.0 - learning.forgetting) * np.eye(len(inertia)) - np.linalg.solve(plant, law)
    return np.asarray(np.abs(np.linalg.eigvals(trial)).max(axis=1), np.float64)
