"""Prescribed motion: what an arm's controller commands, how what carries a base moves, the air.

Everything is a function of mission time on the plant's grid ``t_k = k h``. What carries the base is prescribed (a
rocket's 180 kg against an arm's 0.3 kg). Its angular rate is kept on the half steps ``t_k - h/2``: the difference of
two of them over ``h`` is the angular acceleration at ``t_k`` exactly, which is the leapfrog the plant integrates with.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hil_sim import filters
from hil_sim.arrays import Deviates, FloatArray
from hil_sim.scenario.part_tables import AirTable, ConingTable, StructuralMode, Vibration

STANDARD_GRAVITY = 9.80665  # m/s^2, exact by definition
_SCALE_HEIGHT_m, _DENSITY_kg_m3 = 7000.0, 1.225  # of the air; of that at the ground
_IMPULSE = 20_000  # samples of a response


class PhaseSpan(NamedTuple):
    """One step of the sequence: its phase code and its interval of mission time."""

    code: int
    action: str
    start_s: float
    end_s: float


class Reference(NamedTuple):
    """Commanded motion of a joint, each (n,), or of several, (n, joints)."""

    angle_rad: FloatArray
    rate_rad_s: FloatArray
    accel_rad_s2: FloatArray


class Program:
    """Timing of a sequence.

    Attributes:
        spans: the steps in order, without gaps.
    """

    spans: tuple[PhaseSpan, ...]

    @property
    def duration_s(self) -> float:
        """End of the last step."""
        return self.spans[-1].end_s

    @property
    def phase_changes(self) -> tuple[tuple[float, int], ...]:
        """(mission time [s], phase code) of every change, the first at 0."""
        first = [(self.spans[0].start_s, self.spans[0].code)]
        return tuple(first + [(b.start_s, b.code) for a, b in pairwise(self.spans) if a.code != b.code])


def minimum_jerk(knots_s: FloatArray, angles: FloatArray, times_s: FloatArray) -> Reference:
    """Quintics of zero end rates and accelerations from knot to knot, at times (n,); (n, joints) each.

    Args:
        knots_s: rising, (k,).
        angles: at the knots, (k, joints); those of the last hold after it.
        times_s: not before the first knot.
    """
    i = np.clip(np.searchsorted(knots_s, times_s, side="right") - 1, 0, len(knots_s) - 2)
    T = (knots_s[i + 1] - knots_s[i])[:, None]
    rise = angles[i + 1] - angles[i]
    s = np.clip((times_s - knots_s[i])[:, None] / T, 0.0, 1.0)
    return Reference(
        angles[i] + rise * s**3 * (10.0 + s * (-15.0 + 6.0 * s)),
        rise / T * 30.0 * (s * (1.0 - s)) ** 2,
        rise / T**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )


def coning(rocket: ConingTable, phase_rad: float, times_s: FloatArray) -> FloatArray:
    """Angular acceleration of a torque-free axisymmetric body at times (n,), (n, 3).

    The transverse rate turns in body axes at (I_roll/I_pitch - 1) spin.
    """
    turn = (rocket.roll_to_pitch_inertia - 1.0) * rocket.spin_rad_s
    angle = turn * times_s + phase_rad
    accel = np.zeros((len(times_s), 3))
    accel[:, 0] = -rocket.nutation_rate_rad_s * turn * np.sin(angle)
    accel[:, 1] = rocket.nutation_rate_rad_s * turn * np.cos(angle)
    return accel


def rate_before(rocket: ConingTable, phase_rad: float, step_s: float) -> FloatArray:
    """Angular rate of that body half a step before time 0, (3,)."""
    turn = (rocket.roll_to_pitch_inertia - 1.0) * rocket.spin_rad_s
    before = phase_rad - 0.5 * turn * step_s
    cone = rocket.nutation_rate_rad_s * np.array([np.cos(before), np.sin(before), 0.0])
    return np.asarray(cone + np.asarray(rocket.residual_rate_rad_s) + [0.0, 0.0, rocket.spin_rad_s])


class _Band:
    """Noise of a band, by axis."""

    def __init__(self, sections: Sequence[filters.Section], unit: float, rms: Sequence[float], noise: Deviates) -> None:
        self._passing, self._noise = filters.Passing(sections, 3), noise
        self._scale = unit * np.asarray(rms) / filters.rms_gain(sections, _IMPULSE)

    def take(self, rows: int) -> FloatArray:
        made = self._passing.take(self._noise.take(rows))
        made *= self._scale
        return made


class Shaking:
    """Vibration of a structure, none at zero frequency, in chunks of whole blocks of the filters.

    Args:
        table: of it.
        step_s: between rows.
        count: of all rows.
        rng: draws the noise of each band in turn.
    """

    def __init__(self, table: Vibration, step_s: float, count: int, rng: np.random.Generator) -> None:
        rate_Hz = 1.0 / step_s
        milli_g = 1e-3 * STANDARD_GRAVITY

        def mode(one: StructuralMode, unit: float) -> _Band:
            section = filters.peak(one.frequency_Hz, 0.5 / one.damping_ratio, rate_Hz)
            return _Band([section], unit, one.rms, Deviates(rng, count, 3))

        band = filters.band_pass(table.broadband_band_Hz, rate_Hz)
        self._linear = [_Band(band, milli_g, table.broadband_mg, Deviates(rng, count, 3))]
        self._linear += [mode(one, milli_g) for one in table.linear_mode_mg]
        # A narrow mode: rms acceleration = 2 pi f x rms rate.
        self._angular = [mode(one, 2e-3 * np.pi * one.frequency_Hz) for one in table.angular_mode_mrad_s]

    def linear(self, rows: int) -> FloatArray:
        """Acceleration at the next rows, (rows, 3), m/s^2."""
        made = self._linear[0].take(rows)
        for band in self._linear[1:]:
            made += band.take(rows)
        return made

    def angular(self, rows: int) -> FloatArray:
        """Angular acceleration at the next rows, (rows, 3), rad/s^2."""
        made = np.zeros((rows, 3))
        for band in self._angular:
            made += band.take(rows)
        return made


class Gusts:
    """First-order Gauss-Markov, of rms 1, in chunks.

    Args:
        air: that they are of.
        step_s: between rows.
        count: of all rows.
        rng: draws them.
    """

    def __init__(self, air: AirTable, step_s: float, count: int, rng: np.random.Generator) -> None:
        self._keep, self._noise, self._last = math.exp(-step_s / air.gust_time_s), Deviates(rng, count, 1), np.zeros(1)

    def take(self, rows: int) -> FloatArray:
        """Of the next rows, (rows,)."""
        steps = math.sqrt(1.0 - self._keep**2) * self._noise.take(rows)
        found = filters.remembered(self._keep, steps, self._last)
        self._last = found[-1]
        return np.asarray(found[:, 0])


def dynamic_pressure(air: AirTable, times_s: FloatArray, gusts: FloatArray) -> FloatArray:
    """Exponential growth with gusts (n,) of rms 1, at times (n,), Pa.

    It grows up to the greatest deceleration of a steep ballistic entry, ``H / (2 e T^2)`` for the scale height H and
    the growth time T (Allen and Eggers, NACA TR 1381, 1958), and then falls as fast to what carries the weight at
    terminal speed: without that an hour's mission has no finite numbers.
    """
    at_reference_pa = air.pressure_Pa
    greatest = weight = 0.5 * _DENSITY_kg_m3 * (_SCALE_HEIGHT_m / air.growth_time_s) ** 2  # where nothing is braked
    if (area := air.carrier_area_over_mass_m2_kg) > 0.0:
        greatest, weight = _SCALE_HEIGHT_m / (2.0 * np.e * air.growth_time_s**2) / area, STANDARD_GRAVITY / area
    growths = (times_s - air.reference_s) / air.growth_time_s
    peak = np.log(greatest / at_reference_pa) if at_reference_pa else 0.0
    rising = at_reference_pa * np.exp(np.minimum(growths, peak))
    falling = weight + (greatest - weight) * np.exp(-np.maximum(growths - peak, 0.0))
    mean_pressure = np.where(growths <= peak, rising, falling) if at_reference_pa else 0.0 * growths
    return np.asarray(mean_pressure * np.maximum(0.0, 1.0 + air.gust_fraction * gusts))


def wind_direction(air: AirTable, spin_rad_s: float, times_s: FloatArray, from_rad: float) -> FloatArray:
    """The wind's direction in the base's axes turns against the spin; (n, 3)."""
    azimuth = from_rad - spin_rad_s * (times_s - air.reference_s)
    elevation = np.deg2rad(air.wind_elevation_deg)
    level = np.cos(elevation)
    return np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), np.full_like(azimuth, np.sin(elevation))], axis=1
    )
