"""What rows of an arm are beyond linear in errors of its angles, and of the level, and what that does to an estimate.

Sums over all rows are linear in these errors, about the motion as it was read: ``y = Y beta + C c``, C made at an
estimate of before. An encoder's scale 10 % off, or gravity turned by 50 mrad, leaves over

    rho = f(beta, c) - Y beta - C c.

Kept ticks show it, as their rows can be made again about any error; noise of the motion, which is the same on both
sides, is in it to second order only. The estimate by all rows less the fit of rho by these ticks,

    z = z_0 - off,   off = (J'WJ + S^-1)^-1 J'W rho(z),

is that of all rows as they are (derived here: a defect correction, Stetter 1978). Kept ticks are neither whitened nor
all rows, so a doubt of :data:`.NOISE_SIGMA` of the correction of the base parameters stays. Its direction is not known:
the covariance P is multiplied by ``1 + NOISE_SIGMA^2 off' P^-1 off / d``, of their parts of off and of P; d is how many
directions of theirs the rows tell, ``tr(1 - P)``.
"""

from collections.abc import Sequence

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.identification.evidence.bank import Suspect
from onboard.identification.evidence.mixture import Known
from onboard.identification.rows.checks.remade import MOVING, RowsRemade
from onboard.identification.rows.checks.tick_rows import TickRows
from onboard.identification.rows.stated_errors.all_rows import ROUNDS, SETTLED
from onboard.identification.rows.stated_errors.considered import Considered


class BeyondLinear:
    """Kept ticks of one arm, beside the sums over its rows.

    Args:
        remade: their rows, about errors of instruments.
        errors: these, e.
        kept: the ticks.
        made_at: base parameters at which C was made, (p,).
    """

    def __init__(self, remade: RowsRemade, errors: Sequence[Considered], kept: TickRows, made_at: FloatArray) -> None:
        self._remade, self._kept, self._made_at = remade, kept, made_at
        self._moves = np.array([one.effect in MOVING for one in errors])
        as_read = remade.at(kept.ticks, made_at, np.zeros(len(errors)))
        self._read, self._Y, self._C = as_read.reading, *np.split(as_read.slope, [len(made_at)], axis=2)

    def of(self, known: Known, suspect: Suspect | None) -> Known:
        """Mean and covariance of the state by rows as they are, of those by rows that are linear, under a hypothesis.

        Args:
            known: mean, (n + e,), and covariance, by all rows.
            suspect: what may be wrong; None: all is as stated.
        """
        (x, P), n = known, self._kept.half.shape[1]
        S = np.eye(len(x))
        if suspect is not None:
            S[np.ix_(suspect.at, suspect.at)] += suspect.along @ suspect.along.T
        J = self._kept.about(x)[1].reshape(-1, len(x))
        weighted = (J * self._kept.ticks.weight.reshape(-1, 1)).T
        gain, off = np.linalg.solve(weighted @ J + np.linalg.inv(S), weighted), np.zeros(len(x))
        for _ in range(ROUNDS):
            before, off = off, gain @ self._rho(x - off).ravel()
            if (np.abs(off - before) < SETTLED * np.sqrt(np.diag(P))).all():
                break
        own, bodies = off[:n], P[:n, :n]
        length = float(own @ np.linalg.solve(bodies, own)) / max(len(own) - float(np.trace(bodies)), 1.0)
        return x - off, P * (1.0 + NOISE_SIGMA**2 * length)

    def _rho(self, x: FloatArray) -> FloatArray:
        """What rows are beyond linear in errors of the motion, (t, m)."""
        beta, errors = self._kept.parts(x)
        moved = np.where(self._moves, errors, 0.0)
        linear = self._read + self._Y @ (beta - self._made_at) + self._C @ moved
        return self._remade.moved(self._kept.ticks, beta, moved) - linear
