"""Sensor models from true signals to counts, with errors drawn once per seed.

Every output is a pure function of mission time: noise is added on the plant's grid before the filters, so it does not
depend on when or how often a device is read. Between grid points a cubic through four of them is used (error below
2.5e-4 of a 100 Hz component on a 2 kHz grid).

Known limits: accelerometer non-linearity (0.5 % of full scale in the datasheet) and hysteresis of the load cell are
left out; a filter change takes effect at once, without the chip's transient.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_sim import filters
from hil_sim.arrays import Deviates, FloatArray, Track
from hil_sim.plants.motions.motion import STANDARD_GRAVITY
from hil_sim.plants.world import Plant
from hil_sim.scenario.sensor_tables import Axes, ClockTable, EncoderTable, ForceCellTable, ImuTable, LoadCellTable
from hil_sim.sensing.interpolation import interpolate, interpolate_column, interpolate_one
from hil_sim.sensing.triads import Triad, Wander, within_limits

Counts = NDArray[np.int16]
_LEAST_DELAY = 0.1  # of a load cell's nominal one
_BEYOND, _NEWTON = 2.1, 12  # right of the root, which is at 2.06 without a delay, the left side convex: never overshot


class LowPass(NamedTuple):
    """A digital low-pass with a known delay at low frequency: ``b``, ``a`` on the grid, then a pure delay."""

    b: FloatArray
    a: FloatArray
    pure_delay_s: float

    @property
    def section(self) -> filters.Section:
        """The filter without the delay."""
        return self.b, self.a


def low_pass(bandwidth_Hz: float, delay_s: float, step_s: float) -> LowPass:
    """Two poles with half power at ``bandwidth_Hz`` and low-frequency group delay ``delay_s``, on a grid of ``step_s``.

    A Butterworth pair delays by sqrt(2) / (2 pi bandwidth). For a longer delay in the table, the rest is pure delay;
    for a shorter one, the pair gets a real zero, and both conditions are solved together (with a peak in the pass band:
    12 % at 5 Hz, 27 % at 260 Hz). The bilinear transform keeps the group delay at zero frequency; the bandwidth is
    pre-warped.
    """
    edge = 2.0 / step_s * math.tan(math.pi * bandwidth_Hz * step_s)  # rad/s, warped
    damping = math.sqrt(0.5)
    pure_s = delay_s - 2.0 * damping / edge
    if pure_s >= 0.0:
        natural, zero_s = edge, 0.0
    else:
        # half power at the edge: 1 + x^4 = 2 (1 + (edge zero_s)^2), x = edge / natural, by Newton
        x, late = _BEYOND, edge * delay_s
        for _ in range(_NEWTON):
            zero = math.sqrt(2.0) * x - late
            x -= (x**4 - 1.0 - 2.0 * zero * zero) / (4.0 * x**3 - 4.0 * math.sqrt(2.0) * zero)
        natural = edge / x
        zero_s, pure_s = 2.0 * damping / natural - delay_s, 0.0
    b, a = filters.bilinear([zero_s, 1.0], [natural**-2, 2.0 * damping / natural, 1.0], 1.0 / step_s)
    return LowPass(b, a, pure_s)


class _Stream:
    """A filter applied incrementally to the rows computed so far."""

    def __init__(self, response: LowPass, rows: int, columns: int, first: int = 0) -> None:
        self.response = response
        self._track = Track(rows, columns)
        self.values = self._track.values
        self._state: FloatArray | None = None
        self._count = first

    def extend(self, truth: FloatArray) -> None:
        """Append filtered ``truth`` rows (m, columns); the filter starts settled on the first of them."""
        if self._state is None:
            self._state = filters.settled(self.response.section)[:, None] * truth[0]
        self.values[self._count : self._count + len(truth)] = filters.filtered(
            self.response.section, truth, self._state
        )
        self._count += len(truth)

    def forget(self, before: int) -> None:
        """Rows before ``before`` are not read any more."""
        self._track.forget(before)

    @property
    def count(self) -> int:
        return self._count


class ImuSensor:
    """The MPU-6050's analogue side: specific force and angular rate to filtered, quantised, saturated words."""

    def __init__(self, plant: Plant, table: ImuTable, rng: np.random.Generator, at: str = "") -> None:
        self._plant = plant
        self._truth = plant.inertial(at)
        self._table = table
        mounting = np.deg2rad(table.mounting_sigma_deg) * rng.standard_normal(3)
        self.accel = Triad.draw(table.accel_g, mounting, rng)
        self.gyro = Triad.draw(table.gyro_deg_s, mounting, rng)
        self.gyro_per_g = table.gyro_per_g_sigma_deg_s * within_limits(rng, (3, 3))
        # White noise of one-sided density D on a grid of rate f has rms D sqrt(f / 2).
        spread = np.sqrt(0.5 / plant.step_s)
        self._noise_scale = spread * np.repeat([table.accel_g.noise_density, table.gyro_deg_s.noise_density], 3)
        self._noise = Deviates(rng, plant.rows, 6)
        self._thermal_noise = Deviates(rng, plant.rows, 1)
        self._wander = [Wander(axes, plant.step_s, rng) for axes in (table.accel_g, table.gyro_deg_s)]
        self._streams: dict[tuple[str, int], _Stream] = {}
        self._forgotten = 0
        self._raw_track, self._thermal_track = Track(plant.rows, 6), Track(plant.rows)
        self._raw = self._raw_track.values  # g, deg/s, before the filter
        self._thermal = self._thermal_track.values  # counts
        self._raw_count = 0

    @property
    def known_s(self) -> float:
        """Up to when the plant is computed."""
        return (self._plant.count - 4) * self._plant.step_s

    def counts(self, times_s: FloatArray, accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int) -> Counts:
        """Words the chip latches at ``times_s`` (n,): int16 (n, 7) = accel x y z, TEMP_OUT, gyro x y z.

        Args:
            times_s: mission time of each sample, not beyond the plant's.
            accel_lsb_per_g: sensitivity of the selected range.
            gyro_lsb_per_dps: sensitivity of the selected range.
            dlpf_cfg: CONFIG[2:0]; accelerometer and gyro each get their own bandwidth and delay.
        """
        h = self._plant.step_s
        if len(times_s):
            self._plant.require(float(times_s[0]))
            self._plant.require(float(times_s[-1]))
        self._sense()
        accel = self._stream("accel", self._table.accel_g, dlpf_cfg, slice(0, 3))
        gyro = self._stream("gyro", self._table.gyro_deg_s, dlpf_cfg, slice(3, 6))
        words = np.empty((len(times_s), 7))
        words[:, 0:3] = accel_lsb_per_g * interpolate(accel.values, (times_s - accel.response.pure_delay_s) / h)
        at = (times_s - gyro.response.pure_delay_s) / h + self._truth.rate_late
        words[:, 4:7] = gyro_lsb_per_dps * interpolate(gyro.values, at)
        row = np.clip(times_s / h, 0, self._plant.rows - 1).astype(np.intp)
        words[:, 3] = 340.0 * (self.temperature_deg_c(times_s) - 36.53) + self._thermal[row]
        return np.clip(np.rint(words), -32768, 32767).astype(np.int16)

    def temperature_deg_c(self, times_s: FloatArray) -> FloatArray:
        """Die temperature: self-heating towards a plateau."""
        t = self._table
        settled = -np.expm1(-np.maximum(times_s, 0.0) / t.temperature_time_s)
        return t.temperature_start_degC + t.temperature_rise_K * settled

    def _sense(self) -> None:
        """Extend the unfiltered channels to the plant's rows: products in its chunks, for bit-identical results."""
        done, count, chunk = self._raw_count, self._plant.count, self._plant.chunk
        if done == count:
            return
        whole = count - (count - done) % chunk
        for first, last in ((done, whole), (whole, count)):
            if last > first:
                self._sense_rows(first, last, min(chunk, last - first))

    def _sense_rows(self, done: int, count: int, chunk: int) -> None:
        """Rows ``done..count``, a whole number of chunks."""
        rows = slice(done, count)
        force_g = self._truth.specific_force_m_s2[rows] / STANDARD_GRAVITY
        rate_deg_s = np.rad2deg(self._truth.rate_rad_s[rows])

        def turned(values: FloatArray, matrix: FloatArray) -> FloatArray:
            return (values.reshape(-1, chunk, 3) @ matrix.T).reshape(-1, 3)

        rise = (
            self.temperature_deg_c(self._plant.step_s * np.arange(done, count, dtype=np.float64))
            - self._table.temperature_start_degC
        )
        raw = self._raw[rows]
        raw[:, 0:3] = turned(force_g, self.accel.matrix) + self.accel.bias + rise[:, None] * self.accel.per_kelvin
        raw[:, 3:6] = turned(rate_deg_s, self.gyro.matrix) + self.gyro.bias + rise[:, None] * self.gyro.per_kelvin
        raw[:, 3:6] += turned(force_g, self.gyro_per_g)
        raw += self._noise_scale * self._noise.take(count - done)
        for columns, wander in zip((slice(0, 3), slice(3, 6)), self._wander, strict=True):
            wander.add_to(raw[:, columns])
        self._thermal[rows] = self._table.temperature_noise_counts * self._thermal_noise.take(count - done)[:, 0]
        self._raw_count = count

    def _stream(self, name: str, axes: Axes, dlpf_cfg: int, columns: slice) -> _Stream:
        key = (name, dlpf_cfg)
        if key not in self._streams:
            response = low_pass(*axes.filter(dlpf_cfg), self._plant.step_s)
            self._streams[key] = _Stream(response, self._plant.rows, 3, self._forgotten)
        stream = self._streams[key]
        if stream.count < self._raw_count:
            stream.extend(self._raw[stream.count : self._raw_count, columns])
        return stream

    def forget(self, before: int) -> None:
        """Rows before ``before`` are not read any more; a filter chosen later begins with what is kept."""
        self._forgotten = max(self._forgotten, before)
        self._raw_track.forget(before)
        self._thermal_track.forget(before)
        for stream in self._streams.values():
            stream.forget(before)

    def truth(self) -> dict[str, Any]:
        """The errors drawn: matrices act on the designed axes."""
        return {
            "accel_matrix": self.accel.matrix,
            "accel_bias_g": self.accel.bias,
            "accel_bias_g_per_K": self.accel.per_kelvin,
            "gyro_matrix": self.gyro.matrix,
            "gyro_bias_deg_s": self.gyro.bias,
            "gyro_bias_deg_s_per_K": self.gyro.per_kelvin,
            "gyro_deg_s_per_g": self.gyro_per_g,
        }


class EncoderSensor:
    """A motor-side encoder behind a gear: joint angle with errors of its zero and two cyclic ones, in whole counts."""

    def __init__(self, plant: Plant, table: EncoderTable, rng: np.random.Generator, at: str = "") -> None:
        self.counts_per_revolution = table.counts_per_revolution
        self._plant = plant
        self._angle_rad = plant.angle_rad(at)
        self._gear_ratio = table.gear_ratio
        self._once_urad, self._twice_urad = table.eccentricity_urad, table.transmission_error_urad
        self._phase: list[float] = rng.uniform(0.0, 2.0 * np.pi, 2).tolist()
        self.zero_rad = 1e-3 * table.zero_sigma_mrad * float(rng.standard_normal())

    def value(self, time_s: float) -> float:
        """Angle at ``time_s`` [rad], a whole number of counts from joint zero: the last one passed."""
        step = 2.0 * math.pi / self.counts_per_revolution
        return math.floor(self.analog_rad(time_s) / step) * step

    def values(self, times_s: FloatArray) -> FloatArray:
        """``value`` at each of ``times_s`` (n,), in order."""
        if len(times_s):
            self._plant.require(float(times_s[0]))
            self._plant.require(float(times_s[-1]))
        angle = interpolate_column(self._angle_rad, times_s / self._plant.step_s)
        turn = self._gear_ratio * angle
        # not by np.sin, which may differ in the last bit
        once = self._once_urad * np.array([math.sin(one) for one in (turn + self._phase[0]).tolist()])
        twice = self._twice_urad * np.array([math.sin(two) for two in (2.0 * turn + self._phase[1]).tolist()])
        step = 2.0 * math.pi / self.counts_per_revolution
        whole: FloatArray = np.floor((angle + self.zero_rad + 1e-6 * (once + twice)) / step) * step
        return whole

    def analog_rad(self, time_s: float) -> float:
        """Angle before quantisation [rad]."""
        self._plant.require(time_s)
        angle = interpolate_one(self._angle_rad, time_s / self._plant.step_s)
        turn = self._gear_ratio * angle
        once = self._once_urad * math.sin(turn + self._phase[0])  # per motor turn
        twice = self._twice_urad * math.sin(2.0 * turn + self._phase[1])  # two lobes
        return angle + self.zero_rad + 1e-6 * (once + twice)

    def truth(self) -> dict[str, Any]:
        """Error of the zero, phases of the cyclic errors."""
        return {
            "zero_rad": self.zero_rad,
            "eccentricity_phase_rad": self._phase[0],
            "transmission_error_phase_rad": self._phase[1],
        }


class LoadCellSensor:
    """A force along an axis, or a moment over a lever, through a bridge and a transmitter.

    Errors: scale, zero, creep, delay, filter, noise. ``lever_m`` is None where the force itself is measured.
    """

    def __init__(
        self, plant: Plant, table: LoadCellTable | ForceCellTable, rng: np.random.Generator, at: str = ""
    ) -> None:
        self.capacity_N = table.capacity_N
        self._plant = plant
        self._table = table
        h = plant.step_s
        self.lever_m: float | None = None
        self._axis = np.ones(1)
        if isinstance(table, LoadCellTable):
            self.lever_m = 1e-3 * (table.lever_mm + table.lever_sigma_mm * rng.standard_normal())
            self._load = plant.moment_n_m(at, table.axis)[:, None]
        else:
            self._load = plant.force_n(at)
            self._axis = np.asarray(table.axis) / np.linalg.norm(table.axis)
        self.gain = 1.0 + table.scale_sigma * rng.standard_normal()
        self.nonlinearity = table.nonlinearity_of_rated_output * rng.uniform(-1.0, 1.0)
        self.zero_N = table.zero_sigma_N * rng.standard_normal()
        self.drift_N_s = table.zero_drift_sigma_N_s * rng.standard_normal()
        self._walk = Deviates(rng, plant.rows, 1)
        self._walked = 0.0  # their sum
        late_ms = table.delay_sigma_ms * rng.spawn(1)[0].standard_normal()
        self.delay_s = 1e-3 * max(table.delay_ms + late_ms, _LEAST_DELAY * table.delay_ms)
        response = low_pass(np.sqrt(2.0) / (2.0 * np.pi * self.delay_s), self.delay_s, h)
        self._noise_scale = table.noise_rms_N / filters.rms_gain([response.section], 4000)
        self._noise = Deviates(rng, plant.rows, 1)
        self._stream = _Stream(response, plant.rows, 1)
        self._filtered_N = self._stream.values[:, 0]
        self._full_scale_s = tuple(table.full_scale_readings_s)
        self._full_scale_window_s = 1e-3 * table.full_scale_window_ms
        self._creep_keep = math.exp(-h / table.creep_time_s)
        self._crept = np.zeros(1)

    def value(self, time_s: float) -> float:
        """Force at ``time_s`` [N], filtered and clipped at the capacity; the recorded full-scale samples included."""
        for start_s in self._full_scale_s:
            if 0.0 <= time_s - start_s < self._full_scale_window_s:
                return self.capacity_N
        self._plant.require(time_s)
        if self._stream.count < self._plant.count:
            self._sense()
        position = (time_s - self._stream.response.pure_delay_s) / self._plant.step_s
        force = interpolate_one(self._filtered_N, position)
        return min(max(force, -self.capacity_N), self.capacity_N)

    def values(self, times_s: FloatArray) -> FloatArray:
        """``value`` at each of ``times_s`` (n,), in order."""
        if len(times_s):
            self._plant.require(float(times_s[0]))
            self._plant.require(float(times_s[-1]))
        if self._stream.count < self._plant.count:
            self._sense()
        position = (times_s - self._stream.response.pure_delay_s) / self._plant.step_s
        force: FloatArray = np.clip(interpolate_column(self._filtered_N, position), -self.capacity_N, self.capacity_N)
        for start_s in self._full_scale_s:
            force[(times_s - start_s >= 0.0) & (times_s - start_s < self._full_scale_window_s)] = self.capacity_N
        return force

    def _sense(self) -> None:
        rows = slice(self._stream.count, self._plant.count)
        force = self._load[rows] @ self._axis
        if self.lever_m is not None:
            force = force / self.lever_m
        creeping = filters.remembered(self._creep_keep, (1.0 - self._creep_keep) * force[:, None], self._crept)
        self._crept, crept = creeping[-1], creeping[:, 0]
        capacity = self._table.capacity_N
        bridge = force + self._table.creep_fraction * crept + self.nonlinearity * capacity * (force / capacity) ** 3
        noise = self._noise_scale * self._noise.take(len(bridge))[:, 0]
        self._stream.extend((self.gain * bridge + self._zero(rows) + noise)[:, None])

    def _zero(self, rows: slice) -> FloatArray:
        """Of the next rows: drift, and a random walk."""
        h, steps = self._plant.step_s, self._walk.take(rows.stop - rows.start)[:, 0]
        walked = np.cumsum(np.concatenate([[self._walked], steps]))[1:]
        self._walked = float(walked[-1])
        drifted = self.zero_N + self.drift_N_s * h * np.arange(rows.start, rows.stop)
        return np.asarray(drifted + self._table.zero_walk_N_sqrt_s * np.sqrt(h) * walked)

    def forget(self, before: int) -> None:
        """Rows before ``before`` are not read any more."""
        self._stream.forget(before)

    def truth(self) -> dict[str, Any]:
        """The errors drawn; ``moment_Nm_per_N`` is the factor that turns a small reading into the true moment."""
        lever = {} if self.lever_m is None else {"lever_m": self.lever_m, "moment_Nm_per_N": self.lever_m / self.gain}
        return lever | {
            "gain": self.gain,
            "nonlinearity_of_rated_output": self.nonlinearity,
            "zero_N": self.zero_N,
            "drift_N_s": self.drift_N_s,
            "delay_s": self.delay_s,
        }


@dataclass(frozen=True)
class DriftingClock:
    """A chip's clock: it runs ``1 + rate_error + drift_per_s * t`` chip seconds a second, from 0 at ``start_ns``."""

    start_ns: int
    rate_error: float
    drift_per_s: float

    @staticmethod
    def draw(table: ClockTable, rng: np.random.Generator) -> "DriftingClock":
        """Rate and drift of one clock, not yet started (``start_ns`` 0)."""
        rate = float(np.clip(table.rate_sigma * rng.standard_normal(), -table.rate_limit, table.rate_limit))
        return DriftingClock(0, rate, float(table.drift_sigma_per_s * rng.standard_normal()))

    def chip_ns(self, time_ns: int) -> int:
        """What the chip's clock shows at true ``time_ns``."""
        t = time_ns - self.start_ns
        return t + round(t * (self.rate_error + 0.5e-9 * self.drift_per_s * t))

    def time_ns(self, chip_ns: int) -> int:
        """True time at which the chip's clock shows ``chip_ns``; to the nanosecond."""
        c, one = 1e-9 * float(chip_ns), 1.0 + self.rate_error  # as in ``times_s``
        return self.start_ns + round(1e9 * (2.0 * c / (one + math.sqrt(one * one + 2.0 * self.drift_per_s * c))))

    def times_s(self, chip_ns: FloatArray) -> FloatArray:
        """Mission seconds at which the chip's clock shows ``chip_ns`` (n,).

        The stable root of ``drift/2 t^2 + (1 + rate) t = c``.
        """
        c = 1e-9 * np.asarray(chip_ns, dtype=np.float64)
        one = 1.0 + self.rate_error
        return 2.0 * c / (one + np.sqrt(one * one + 2.0 * self.drift_per_s * c))
