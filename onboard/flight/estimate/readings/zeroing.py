"""Estimates the accelerometer's offset in flight while the vehicle coasts at rest, and follows it with temperature.

In free fall an accelerometer at rest near the centre of mass reads almost only its offset (datasheet: up to 50 mg).
Uncorrected, the offset acts on the payload's first moment like gravity, with a dependence on the joint angle similar to
the inertia torque of a sweep. The remaining specific force while coasting (spin, nutation) is a small constant, for
which the rows have nuisance columns.

The offset changes with the chip's temperature (MPU-6050: up to 0.9 mg/K). It is a straight line over the temperature,
fitted to all ticks at rest so far; its slope has a prior of zero with ``drift_sigma_m_s2_k``. A tick that the line does
not explain is left out: in thin air the rocket is slowed down even where the arm rests.
"""

from collections.abc import Callable, Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.records import Batch, Rows, SampleStatus, Severity, event
from onboard import config
from onboard.devices.roles import ImuRole
from onboard.estimation.arrays import TINY, FloatArray
from onboard.estimation.policy import READING, sigmas
from onboard.identification.quantities import Estimate, Findings

_STEPS = 64  # temperatures kept: of some seconds
_PLAUSIBLE_K = 100.0  # from the first temperature: data sheets of the chips span 125 K, -40 to 85 degrees Celsius
_WARMER_K = 5.0  # more than a chip warms by itself after power-up


class Temperatures:
    """Temperature of an IMU over time, in kelvin above the first; 0 where its samples do not carry it.

    Args:
        imu: whose.
    """

    def __init__(self, imu: ImuRole | None) -> None:
        self._channel, self._kelvin_per_count = (imu.channels[0], imu.kelvin_per_count) if imu else ("", 0.0)
        self._first: float | None = None
        self._times_ns = np.zeros(0)
        self._values = np.zeros(0)

    def append(self, batches: Mapping[str, Rows], times_ns: Callable[[str, Rows], NDArray[np.int64] | None]) -> None:
        """Takes the median of a step's samples: it changes within seconds, and single words may be damaged.

        Args:
            batches: rows by channel.
            times_ns: vehicle time of a channel's rows, (n,); None while it is not known: they are left out.
        """
        rows = batches.get(self._channel)
        if rows is None or not self._kelvin_per_count or "temperature_raw" not in (rows.dtype.names or ()):
            return
        good = rows[(rows["status"] & SampleStatus.NOT_VALID) == 0]
        if not len(good):
            return
        taken_ns = times_ns(self._channel, good)
        if taken_ns is None:
            return
        kelvin = self._kelvin_per_count * _median(good["temperature_raw"])
        self._first = kelvin if self._first is None else self._first
        if abs(kelvin - self._first) < _PLAUSIBLE_K:
            self._times_ns = np.append(self._times_ns, _median(taken_ns))[-_STEPS:]
            self._values = np.append(self._values, kelvin - self._first)[-_STEPS:]

    def noted(self, findings: Findings) -> Findings:
        """Findings, with how much warmer the IMU has become before what speaks against all answers, if it is much."""
        if not findings.against or not len(self._values) or abs(self._values[-1]) < _WARMER_K:
            return findings
        said = f"{self._channel} is {abs(self._values[-1]):.0f} K {'warmer' if self._values[-1] > 0.0 else 'colder'}"
        return findings._replace(against=(f"{said} than at first", *findings.against))

    def at(self, at_ns: NDArray[np.int64]) -> FloatArray:
        """At each tick, (n,)."""
        if not len(self._values):
            return np.zeros(len(at_ns))
        return np.asarray(np.interp(at_ns.astype(np.float64), self._times_ns, self._values), np.float64)


class Zeroing:
    """Mean specific force over the resting phases; known when one of them ends and enough has been seen.

    Args:
        settings: phases and the prior of the drift; the offset is zero where not given.
        together: neighbouring ticks that say the same: the smoothing kernel's width in ticks.
        moving: phases whose ticks make rows.

    Attributes:
        offset_m_s2: (3,) offset at the last tick; None while unknown, when the base's motion is unknown too.
        ticks: number of ticks averaged.
        lost: number of ticks of motion without an offset, which make no rows.
    """

    def __init__(self, settings: config.Zero | None, together: float = 1.0, moving: Collection[int] = ()) -> None:
        self._settings = settings
        self._together = together
        self._moving = moving
        self.ticks = self.lost = 0
        self._told = self._warned = False  # by events
        self._sums = np.zeros((2, 4))  # of 1 and T times [1, 3 components]; T T beside
        self._temperature_square, self._force_square = 0.0, np.zeros(3)
        self._fitted: tuple[float, FloatArray, FloatArray, FloatArray, FloatArray] | None = None  # by these
        self.offset_m_s2: FloatArray | None = np.zeros(3) if settings is None else None

    def apply(
        self,
        specific_force: FloatArray,
        codes: NDArray[np.int64],
        usable: NDArray[np.bool_],
        temperature_k: FloatArray | None = None,
    ) -> FloatArray:
        """Specific force less its offset, (n, 3); NaN where the offset is not known yet.

        Args:
            specific_force: (n, 3), sensor axes.
            codes: (n,) phase of each tick, -1 if unknown.
            usable: (n,) whether the tick may be used.
            temperature_k: (n,) of the chip, from any origin; constant where not given.
        """
        if self._settings is None:
            return specific_force.copy()
        out = np.full_like(specific_force, np.nan)
        warm = np.zeros(len(codes)) if temperature_k is None else temperature_k
        for tick, code in enumerate(codes):
            force, kelvin = specific_force[tick], float(warm[tick])
            if code in self._settings.phases:
                if usable[tick] and np.isfinite(force).all() and self._explains(force, kelvin):
                    self._add(force, kelvin)
            elif self.offset_m_s2 is None and self.ticks >= self._settings.ticks:
                self.offset_m_s2 = self._line(kelvin)[0]
            self.lost += self.offset_m_s2 is None and code in self._moving
            if self.offset_m_s2 is not None:
                self.offset_m_s2 = self._line(kelvin)[0]
                out[tick] = force - self.offset_m_s2
        return out

    def news(self, now_ns: int, channel: str) -> list[Batch]:
        """An event once when motion begins without an offset, and once when it is known."""
        if self._settings is None or self._told:
            return []
        if self.offset_m_s2 is not None:
            self._told = True
            offset = " ".join(f"{value:+.4f}" for value in self.offset_m_s2)
            text = f"accelerometer offset {offset} m/s^2, from {self.ticks} ticks at rest"
            return [event(now_ns, Severity.INFO, "zeroed", channel, text)]
        if not self.lost or self._warned:
            return []
        self._warned = True
        phases = ", ".join(str(phase) for phase in self._settings.phases)
        missing = f"{self.ticks} of {self._settings.ticks} ticks at rest in phases {phases}"
        text = f"no rows until the accelerometer's zero is known: {missing}"
        return [event(now_ns, Severity.WARNING, "not_zeroed", channel, text)]

    def noted(self, estimate: Estimate, period_s: float) -> Estimate:
        """The estimate with the lost motion in the notes of quantities that are not determined."""
        if not self.lost:
            return estimate
        why = f"; no rows of {period_s * self.lost:.1f} s of motion before the accelerometer's zero was known"
        told = (one if one.supported else one._replace(note=one.note + why) for one in estimate.quantities)
        return estimate._replace(quantities=tuple(told))

    def _add(self, force: FloatArray, kelvin: float) -> None:
        self._sums += np.outer([1.0, kelvin], [1.0, *force])
        self._temperature_square += kelvin * kelvin
        self._force_square += force * force
        self.ticks, self._fitted = self.ticks + 1, None

    def _explains(self, force: FloatArray, kelvin: float) -> bool:
        """Whether a tick at rest lies near the line; all do before it is known."""
        if self.offset_m_s2 is None:
            return True
        expected, sigma = self._line(kelvin)
        return bool((np.abs(force - expected) <= sigmas(READING) * sigma).all())

    def _line(self, kelvin: float) -> tuple[FloatArray, FloatArray]:
        """Offset at a temperature, (3,), and the sigma of one tick there, (3,)."""
        assert self._settings is not None
        self._fitted = self._fitted or self._fit()
        mean_k, mean, slope, scatter, unsure = self._fitted
        if not self._settings.drift_sigma_m_s2_k:
            return mean, np.sqrt(scatter)
        away_k = kelvin - mean_k
        return mean + slope * away_k, np.sqrt(scatter + unsure * away_k**2)

    def _fit(self) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Of all ticks at rest: mean temperature and offset there, slope, variance of a tick, that by temperature."""
        assert self._settings is not None
        n, mean_k = self.ticks, self._sums[1, 0] / self.ticks
        mean = self._sums[0, 1:] / n
        spread_k = max(self._temperature_square - n * mean_k * mean_k, TINY)
        together = self._sums[1, 1:] - mean_k * self._sums[0, 1:]
        left = self._force_square - n * mean * mean - together * together / spread_k
        scatter = np.maximum(left / n, TINY)  # (3,) of a tick about the line of least squares
        prior = self._settings.drift_sigma_m_s2_k
        ridge = scatter * self._together / prior**2 if prior else np.zeros(3)  # (3,) K^2
        slope = together / (spread_k + ridge)
        unsure = scatter * self._together / (spread_k + ridge)
        return mean_k, mean, slope, scatter, unsure


def _median(values: NDArray[np.integer]) -> float:
    """Median of some, (n,); NumPy's takes ten times as long for a hundred."""
    ordered = np.sort(values)
    return 0.5 * (float(ordered[(len(ordered) - 1) // 2]) + float(ordered[len(ordered) // 2]))
