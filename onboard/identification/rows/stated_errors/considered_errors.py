"""What considered errors do to rows, and to an estimate of them.

An error of a joint's sensor or of the base's IMU changes the regressor: ``d y / d c = D [chi 1]``. At what is known of
chi when a row comes the error would seem to change while the estimate is being learned, and its effect would be that of
a drift. So ``sum Y' D / sigma^2`` is kept, and the effect is computed at the estimate of all rows.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import MOST_SHARE
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import Considered, columns, misread_noise
from onboard.identification.rows.stated_errors.whitening import NoisyRows
from onboard.regressor.rows import BaseMotion, RowFold, RowModel
from onboard.regressor.signals import Signals


class Start(NamedTuple):
    """Estimate of another estimator of the same vehicle, for a warm start in place of the prior."""

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    sensitivity: FloatArray  # (p, k) to the considered parameters, which the covariance does not include


Ticks = tuple[Signals, NDArray[np.intp], BoolArray, BoolArray]  # signals, which of theirs, rows in use, payload held


class ConsideredErrors:
    """Considered errors of a model's rows.

    Args:
        considered: k of them.
        model: the rows.
        fold: their base columns, and what is known last.
        parameters: p.
    """

    def __init__(self, considered: Sequence[Considered], model: RowModel, fold: RowFold, parameters: int) -> None:
        self._considered, self._model, self._fold, self._p = tuple(considered), model, fold, parameters
        self._sums: FloatArray | None = None  # (k, p, p + 1)
        self._joints = [joint.name for joint in model.vehicle.joints]
        misread = misread_noise(considered, self._joints)
        self._noisy = np.nonzero(misread.any(axis=2))  # errors, and signals of which their columns have noise
        self._misread = misread[self._noisy].T  # (s, such pairs)

    def remember(self, start: Start | None) -> None:
        """Keep what all rows from now on have, for :meth:`restate`.

        Args:
            start: that is gone on from.
        """
        self._sums = np.zeros((len(self._considered), self._p, self._p + 1))
        if start is not None:
            self._sums[:, :, -1] = np.linalg.solve(start.covariance, start.sensitivity).T

    def factors(self, signals: Signals, at: NDArray[np.intp], use: BoolArray, attached: BoolArray) -> FloatArray | None:
        """D of the rows in use (t, rows) at some ticks (t,), (r, k (p + 1)); None where nothing is considered.

        Raises:
            SignalError: a delay, and no rate of the measured rows.
        """
        asked = self._considered, self._model, signals, at, use, attached, self._p
        D = columns(*asked, lambda each: self.regressors(each, at, attached))
        return None if D is None else D.reshape(len(D), -1)

    def biased(
        self, rows: FloatArray, names: Sequence[str], of: Ticks, mean: FloatArray | None, rls: SquareRootRls
    ) -> FloatArray:
        """Rows (r, p) whose columns of a constant error of the specific force are of a body with parameters (p,).

        The model's are of the body that is drawn, and stay where none is given but for an arm that stands: of that
        they are as estimated so far, with what it holds. ``names``: of the columns; ``of``: as of :meth:`factors`.
        """
        axes = [axis for axis in range(3) if f"zero_force_{'xyz'[axis]}" in names]
        if axes and mean is None and not self._model.vehicle.spec.base.moves:
            mean = rls.solve().mean
        if mean is None or not axes:
            return rows
        errors = [Considered("", self._model.vehicle.spec.base_link, "accelerometer_bias", 1.0, axis=k) for k in axes]
        _, at, _, attached = of
        D = columns(errors, self._model, *of, self._p, lambda each: self.regressors(each, at, attached))
        assert D is not None
        rows[:, [names.index(f"zero_force_{'xyz'[axis]}") for axis in axes]] = D @ [*mean, 1.0]
        return rows

    def at(self, rows: NoisyRows, mean: FloatArray) -> NoisyRows:
        """Rows with their D, (r, k (p + 1)), with ``d y / d c`` at an estimate in its place, (r, k)."""
        if rows.C is None:
            return rows
        D = rows.C.reshape(len(rows.y), len(self._considered), -1)
        if self._sums is not None:
            weighted = (rows.Y / (rows.sigma * rows.sigma)[:, None]).T  # (p, r)
            added = (weighted @ rows.C).reshape(self._p, *D.shape[1:])  # (p, k, p + 1)
            self._sums += added.transpose(1, 0, 2)
        return rows._replace(C=D @ [*mean, 1.0])

    def noise(
        self, signals: Signals, at: NDArray[np.intp], motion: FloatArray | None, mean: FloatArray
    ) -> FloatArray | None:
        """Noise of ``d y / d c``, by that of the motion, see :func:`misread_noise`; cyclic errors have it, too.

        Args:
            signals: of all ticks.
            at: tick of each row, (r,).
            motion: what a sigma of each signal does to a row, (r, s, p + 1); None where none is known.
            mean: the estimate, (p,).

        Returns:
            (r, s, k); none of a base that falls, whose rows keep no such columns.
        """
        if motion is None or self._model.vehicle.spec.base.falls:
            return None
        effect = motion @ [*mean, -1.0]
        made = np.zeros((*effect.shape, len(self._considered)))
        of, by = self._noisy
        made[:, by, of] = effect @ self._misread
        for k, cause in enumerate(self._considered):
            if cause.effect == "joint_cyclic" and signals.cyclic is not None:
                function = cause.axis or 0
                partner = signals.cyclic[at, 0, function ^ 1]  # of a cosine the sine, which is minus its slope
                slope = cause.periods * (partner if function % 2 else -partner)
                own = self._joints.index(cause.row) + len(self._joints) * np.arange(3)
                made[:, own, k] = -slope[:, None] * effect[:, own]
        return made

    def settled_s(self, seen: RowBlocks, mean: FloatArray) -> float:
        """Since when the errors did to the rows what they do at an estimate, but for a tenth.

        Effects on parameters are added up in units of what the rows alone tell of each.

        Args:
            seen: the rows.
            mean: the estimate, (p,).
        """
        estimates = seen.estimates
        if self._sums is None or not estimates:
            return -np.inf
        scale = 1.0 / np.sqrt(np.maximum(np.diag(seen.total())[:-2], np.finfo(np.float64).tiny))
        sigma = np.array([cause.sigma for cause in self._considered])
        sums = self._sums * (sigma[:, None, None] * scale[:, None])  # (k, p, p + 1)
        now = float(np.linalg.norm(sums @ [*mean, 1.0]))
        moved = np.array([one - mean for _, one in estimates])  # (e, p)
        off = np.linalg.norm(np.einsum("kpq,eq->ekp", sums[..., :-1], moved), axis=(1, 2)) > (1.0 - MOST_SHARE) * now
        settled = 1 + int(np.flatnonzero(off).max(initial=-1))
        return estimates[settled][0] if settled < len(estimates) else np.inf

    def restate(self, rls: SquareRootRls) -> None:
        """Give the recursion what the errors do to all of its rows at its estimate."""
        if self._sums is not None:
            rls.consider(np.asarray((self._sums @ [*rls.solve().mean, 1.0]).T, np.float64))

    def regressors(self, each: Sequence[Signals], at: NDArray[np.intp], attached: BoolArray) -> FloatArray:
        """Rows of some ticks, (s, t, rows, p + 1), for each of s signals; last what is known."""
        parts = zip(*((one.q, one.dq, one.ddq, *one.motion) for one in each), strict=True)
        q, dq, ddq, *motion = (np.concatenate([one.take(at, axis=0) for one in part]) for part in parts)  # (s t, ...)
        none = np.zeros((len(q), len(self._model.rows)))
        held, z = np.tile(attached[at], len(each)), each[0].friction  # whose sign no small error changes
        friction = None if z is None else np.tile(z[at], (len(each), 1))
        about = BaseMotion(*motion), held, True, none, self._fold, friction
        Y = self._model.regressor(q, dq, ddq, *about)
        return np.asarray(Y, np.float64).reshape(len(each), at.size, *Y.shape[1:])
