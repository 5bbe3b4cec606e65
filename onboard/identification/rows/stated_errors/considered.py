"""Consider parameters (Schmidt): scales, zeros, drifts, biases, axes, delays of known sigma, which are not estimated.

They are part of the intervals. One of a load cell changes its reading. One of a joint's sensor or of the base's IMU
changes the regressor: its effect is linear in the estimate, ``d y / d c = D [chi 1]``. At what is known of chi when a
row comes the error would seem to change while the estimate is being learned, and its effect would be that of
a drift. So ``sum Y' D / sigma^2`` is kept, and the effect is computed at the estimate of all rows.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.estimation.arrays import BoolArray, FloatArray, cross
from onboard.estimation.policy import MOST_SHARE
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.whitening import NoisyRows
from onboard.regressor.rows import BaseMotion, RowFold, RowModel, base_motion
from onboard.regressor.signals import Signals

OfRow = Literal["scale", "held_scale", "delay", "drift"]
OfParameter = Literal["held_friction"]
OfJoint = Literal["joint_scale", "joint_zero", "joint_delay", "joint_cyclic"]
OfImu = Literal[
    "gyro_scale",
    "gyro_misalignment",
    "gyro_delay",
    "gyro_bias",
    "accelerometer_scale",
    "accelerometer_misalignment",
    "accelerometer_cross_axis",
    "accelerometer_delay",
    "accelerometer_bias",
]
Suspected = Literal["step", "level", "turned"]  # of a scale, the base, all cells at a frame: never considered
Effect = OfRow | OfParameter | OfJoint | OfImu | Suspected
OF_GAIN = ("scale", "held_scale")
HELD = ("held_scale", "held_friction")  # in the recording with the payload
OF_AXES = tuple(f"{sensor}_{of}" for sensor in ("gyro", "accelerometer") for of in ("scale", "misalignment"))
OF_AXES += ("accelerometer_cross_axis",)
_OF_ROW = (*OF_GAIN, "delay", "drift")
_OF_JOINT = ("joint_scale", "joint_zero", "joint_delay", "joint_cyclic")
_STEP = 1e-3  # relative, rad, rad/s or m/s^2: rows are quadratic in the rates at most
_STEP_S = 1e-4  # of a delay


class Considered(NamedTuple):
    """An error common to all readings of one instrument, with a known sigma.

    ``axis`` of a cyclic error is the number of the function in ``Signals.cyclic`` that it is a multiple of: a cosine,
    or its sine after it. That of friction is the number of its base parameter, which differs with the payload.
    """

    name: str
    row: str  # of a load cell; of a joint, its name; of the IMU, its frame; "" of a scale of all rows
    effect: Effect
    sigma: float  # relative for a scale, rad for a zero or misalignment, s for a delay, rad/s or m/s^2 for a bias, N/s
    key: str = ""  # of vehicle.toml that states it: ``load_cell scale_sigma``
    axis: int | None = None  # of the IMU: the one scaled, biased or turned about; a scale common to all where not given
    periods: float = 1.0  # of a cyclic error, in a turn
    is_stated: bool = True  # else no key says anything of it: next to none, unless the rows contradict that

    @property
    def is_common(self) -> bool:
        """Whether it is a scale of all rows, or of all with the payload."""
        return self.effect in OF_GAIN and not self.row

    @property
    def stated(self) -> str:
        """Its key and value: ``load_cell scale_sigma 0.25 %``."""
        if self.effect.endswith("delay"):
            value = f"{1e3 * self.sigma:.3g} ms"
        elif self.effect.endswith(("zero", "misalignment", "cyclic")):
            value = f"{1e3 * self.sigma:.3g} mrad"
        elif self.effect == "drift":
            value = f"{self.sigma:.3g} N/s"
        elif self.effect.endswith("bias"):
            value = f"{self.sigma:.3g} {'rad/s' if self.effect.startswith('gyro') else 'm/s^2'}"
        else:
            value = f"{100.0 * self.sigma:.3g} %"
        return f"{self.key or self.name} {value}"


def check(considered: Sequence[Considered], model: RowModel) -> None:
    """Checks that the model has each named row, joint or IMU.

    Raises:
        UnknownFrameError: it does not.
    """
    rows, joints = [row.name for row in model.rows], [joint.name for joint in model.vehicle.joints]
    for cause in considered:
        if cause.effect in _OF_ROW and cause.row not in rows and not cause.is_common:
            raise UnknownFrameError(f"considered {cause.name!r} names row {cause.row!r}; there are {rows}")
        if cause.effect in _OF_JOINT and cause.row not in joints:
            raise UnknownFrameError(f"considered {cause.name!r} names joint {cause.row!r}; there are {joints}")


def of_motion(considered: Sequence[Considered]) -> bool:
    """Whether any does to rows what depends on the estimate: of friction, a joint's sensor or the base's IMU."""
    return any(cause.sigma > 0.0 and cause.effect not in _OF_ROW for cause in considered)


def columns(
    considered: Sequence[Considered],
    model: RowModel,
    signals: Signals,
    at: NDArray[np.intp],
    use: BoolArray,
    attached: BoolArray,
    parameters: int,
    regressors: Callable[[Sequence[Signals]], FloatArray],
) -> FloatArray | None:
    """``d y / d c``, at the ticks ``at`` (t,), of the rows in use (t, rows); differences for joints and IMU.

    Args:
        considered: k causes.
        model: the rows.
        signals: all of them.
        at: ticks.
        use: which rows.
        attached: (n,) whether the payload is held.
        parameters: p.
        regressors: rows at these ticks, (s, t, rows, p + 1), of each of s signals; last what is known.

    Returns:
        (r, k, p + 1) factors of the parameters, and of 1.

    Raises:
        SignalError: a delay, and no rate of the measured rows; a cyclic error, and no function of it.
    """
    if not considered:
        return None
    names, read = [row.name for row in model.rows], cache(partial(_as_read, signals, model))
    D = np.zeros((*use.shape, len(considered), parameters + 1))
    misread: dict[int, tuple[Signals, float]] = {}  # by cause, with the size of the error
    changed = list[int]()  # causes that are of friction
    for k, cause in enumerate(considered):
        if cause.effect in OF_GAIN:
            rows = slice(None) if cause.is_common else [names.index(cause.row)]
            reads = signals.measured[at][:, rows]
            D[:, rows, k, -1] = reads if cause.effect == "scale" else np.where(attached[at, None], reads, 0.0)
        elif cause.effect == "drift":
            D[:, names.index(cause.row), k, -1] = signals.time_s[at]
        elif cause.effect == "delay":
            if signals.measured_rate is None:
                raise SignalError(f"{cause.name!r} is a delay; give the rate of the measured rows")
            D[:, names.index(cause.row), k, -1] = -signals.measured_rate[at, names.index(cause.row)]
        elif cause.effect == "held_friction":
            changed.append(k)
        else:
            step = _STEP_S if cause.effect.endswith("delay") else _STEP
            misread[k] = _misread(signals, cause, model, step, read), step
    if misread or changed:
        before, *after = regressors([signals, *(wrong for wrong, _ in misread.values())])
        for (k, (_, step)), wrongly in zip(misread.items(), after, strict=True):
            D[..., k, :] = (before - wrongly) / step
        for k in changed:
            D[..., k, considered[k].axis] = np.where(attached[at, None], before[..., considered[k].axis], 0.0)
    return D[use]


def _as_read(signals: Signals, model: RowModel, frame: str) -> list[FloatArray]:
    """Rate, angular acceleration and specific force as an IMU there reads them, (n, 3) each."""
    R, p = model.vehicle.pose_in_base(frame)
    w, dw, f = signals.motion
    return [w @ R, dw @ R, (f + cross(dw, p) + cross(w, cross(w, p))) @ R]


def _misread(
    signals: Signals, cause: Considered, model: RowModel, step: float, read: Callable[[str], list[FloatArray]]
) -> Signals:
    """The signals as they would be if one instrument read a little more, were turned a little, or a little late."""
    own = step * np.array([joint.name == cause.row for joint in model.vehicle.joints])
    q, dq, ddq = signals.q, signals.dq, signals.ddq
    if cause.effect == "joint_zero":
        return signals._replace(q=q + own)
    if cause.effect == "joint_scale":
        return signals._replace(q=q * (1.0 + own), dq=dq * (1.0 + own), ddq=ddq * (1.0 + own))
    if cause.effect == "joint_delay":
        return signals._replace(q=q - own * dq, dq=dq - own * ddq, ddq=ddq - own * rate_of(signals, ddq))
    if cause.effect == "joint_cyclic":
        if signals.cyclic is None:
            raise SignalError(f"{cause.name!r} is cyclic; give its function")
        of = signals.cyclic[:, :, [cause.axis or 0]]  # (n, 3, 1)
        return signals._replace(q=q + own * of[:, 0], dq=dq + own * of[:, 1], ddq=ddq + own * of[:, 2])
    parts = [*read(cause.row)]
    kind = cause.effect.removeprefix("gyro_").removeprefix("accelerometer_")
    for index in (0, 1) if cause.effect.startswith("gyro") else (2,):
        value = parts[index]
        if kind == "delay":
            parts[index] = value - step * (parts[1] if index == 0 else rate_of(signals, value))
        elif kind == "bias":
            parts[index] = value + step * (np.eye(3)[cause.axis or 0] if index != 1 else np.zeros(3))
        else:
            parts[index] = value + step * value @ error_of_axes(cause)
    return signals._replace(motion=base_motion(model.vehicle, cause.row, *parts))


def error_of_axes(cause: Considered) -> FloatArray:
    """What an error of one of an IMU's axes, a scale or an angle, adds to a reading v (3,): v @ this, (3, 3)."""
    axis = np.eye(3) if cause.axis is None else np.diag(np.eye(3)[cause.axis])
    if cause.effect.endswith("scale"):
        return axis
    turned = np.cross(np.eye(3), axis.sum(axis=0))
    return np.abs(turned) if cause.effect.endswith("cross_axis") else turned


def misread_noise(considered: Sequence[Considered], joints: Sequence[str]) -> FloatArray:
    """By how much noise in each signal is noise in what an error does to a row: d y / d c scales or turns the signal.

    Args:
        considered: k causes.
        joints: of the model, in its order.

    Returns:
        (k, s, s) noise of ``d y / d c`` by each of s signals of :class:`onboard.regressor.noise.RowNoise` (angles,
        rates, accelerations of the joints; rate, angular acceleration and specific force in axes of the IMU), on what
        one sigma of each does to the row, without products of two signals. Three axes of one kind are taken as equally
        noisy. None of biases and zeros, which are constant; none of delays, which the fit leaves as stated, or of
        errors of a row's own reading.
    """
    own = len(joints)
    made = np.zeros((len(considered), 3 * own + 9, 3 * own + 9))
    for k, cause in enumerate(considered):
        if cause.effect == "joint_scale":
            at = joints.index(cause.row) + own * np.arange(3)
            made[k, at, at] = -1.0
        gyro = cause.effect.startswith("gyro")
        for first in 3 * own + (np.array([0, 3]) if gyro else np.array([6])):
            at = first + np.arange(3)
            if cause.effect in OF_AXES:
                made[k, at[:, None], at] = -error_of_axes(cause)
    return made


def rate_of(signals: Signals, values: FloatArray) -> FloatArray:
    """Rate of change from tick to tick, (n, columns); zero where a neighbour is missing."""
    if len(values) < 2:
        return np.zeros_like(values)
    return np.nan_to_num(np.gradient(values, signals.time_s, axis=0))


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
        self._sums: FloatArray | None = None  # (2, k, p, p + 1), of rows without the payload and with it
        self._joints = [joint.name for joint in model.vehicle.joints]
        misread = misread_noise(considered, self._joints)
        self._noisy = np.nonzero(misread.any(axis=2))  # errors, and signals of which their columns have noise
        self._misread = misread[self._noisy].T  # (s, such pairs)

    def remember(self, start: Start | None) -> None:
        """Keep what all rows from now on have, for :meth:`restate`.

        Args:
            start: that is gone on from.
        """
        self._sums = np.zeros((2, len(self._considered), self._p, self._p + 1))
        if start is not None:
            self._sums[0, :, :, -1] = np.linalg.solve(start.covariance, start.sensitivity).T

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

    def at(self, rows: NoisyRows, held: BoolArray, mean: FloatArray) -> NoisyRows:
        """Rows with their D, (r, k (p + 1)), with ``d y / d c`` at an estimate in its place, (r, k); ``held``: (r,)."""
        if rows.C is None:
            return rows
        D = rows.C.reshape(len(rows.y), len(self._considered), -1)
        if self._sums is not None:
            weighted = (rows.Y / (rows.sigma * rows.sigma)[:, None]).T  # (p, r)
            for part, mine in enumerate((~held, held)):
                added = (weighted[:, mine] @ rows.C[mine]).reshape(self._p, *D.shape[1:])  # (p, k, p + 1)
                self._sums[part] += added.transpose(1, 0, 2)
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

    def settled_s(self, seen: RowBlocks, mean: FloatArray, *, suspected: bool = False) -> tuple[float, float]:
        """Since when errors did to rows without the payload, and with it, what they do at an estimate, but for a tenth.

        Effects on parameters are added up in units of what the rows alone tell of each.

        Args:
            seen: the rows.
            mean: the estimate, (p,).
            suspected: those that are not stated count, too: as stated they are next to none.
        """
        estimates = seen.estimates
        if self._sums is None or not estimates:
            return -np.inf, -np.inf
        scale = 1.0 / np.sqrt(np.maximum(np.diag(seen.total())[:-2], np.finfo(np.float64).tiny))
        of_columns = [  # of friction none is used
            cause.effect != "held_friction" and (suspected or cause.is_stated) for cause in self._considered
        ]
        sigma = np.array([cause.sigma for cause in self._considered]) * of_columns
        moved, since_s = np.array([one - mean for _, one in estimates]), [*(at_s for at_s, _ in estimates), np.inf]

        def since(sums: FloatArray) -> float:
            now = float(np.linalg.norm(sums @ [*mean, 1.0]))
            off = np.linalg.norm(np.einsum("kpq,eq->ekp", sums[..., :-1], moved), axis=(1, 2))
            return since_s[1 + int(np.flatnonzero(off > (1.0 - MOST_SHARE) * now).max(initial=-1))]

        without, held = self._sums * (sigma[:, None, None] * scale[:, None])
        return since(without), since(held)

    def restate(self, rls: SquareRootRls) -> None:
        """Give the recursion what the errors do to all of its rows at its estimate."""
        if self._sums is not None:
            rls.consider(np.asarray((self._sums.sum(axis=0) @ [*rls.solve().mean, 1.0]).T, np.float64))

    def regressors(self, each: Sequence[Signals], at: NDArray[np.intp], attached: BoolArray) -> FloatArray:
        """Rows of some ticks, (s, t, rows, p + 1), for each of s signals; last what is known."""
        parts = zip(*((one.q, one.dq, one.ddq, *one.motion) for one in each), strict=True)
        q, dq, ddq, *motion = (np.concatenate([one.take(at, axis=0) for one in part]) for part in parts)  # (s t, ...)
        held, z = np.tile(attached[at], len(each)), each[0].friction  # whose sign no small error changes
        friction = None if z is None else np.tile(z[at], (len(each), 1))
        about = BaseMotion(*motion), held, True, self._fold, friction
        Y = self._model.regressor(q, dq, ddq, *about)
        return np.asarray(Y, np.float64).reshape(len(each), at.size, *Y.shape[1:])
