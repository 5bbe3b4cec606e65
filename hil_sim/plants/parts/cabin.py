"""An aircraft that flies parabolas, and the hands that carry, let go, push and catch a free-flyer in its cabin.

Everything is in the axes of a frame that falls freely and does not turn, z up at the start: gravity is in none of the
numbers, and the cabin accelerates upwards by what an accelerometer on its floor would show. While a vehicle is held,
its base follows the cabin with the unrest of the hands; the hands' grip grows and goes within ``GRIP_s``, during which
the base's acceleration is a mean of the free and the held one.
"""

from typing import Any, NamedTuple

import numpy as np

from hil_sim import filters
from hil_sim.arrays import FloatArray
from hil_sim.scenario.parabolic_tables import Parabolas, ParabolicRuns

GRIP_s = 0.12
_FOLLOWS_s, _STRAPPED_s = 0.12, 0.03  # time constant with which a held base follows
_RIGHTING_1_s, _FASTEST_rad_s = 0.8, 0.7  # hands turn it upright, by its angle, at most so fast
_BUMP_s = 0.06  # contact time
_ARM_m = 0.2  # of a bump about the base's origin
_AWAY_s = 0.7  # of a bump from release, catch and other bumps
_VIBRATION_Hz, _TREMOR_Hz, _SLOW_Hz = (5.0, 40.0), (6.0, 11.0), (0.2, 1.5)


class Bump(NamedTuple):
    """A short contact in free flight."""

    at_s: float
    impulse_N_s: FloatArray  # (3,) world axes # noqa: N815
    moment_N_m_s: FloatArray  # (3,) about the base's origin, base axes # noqa: N815


class Release(NamedTuple):
    """A run: from the hands into the hands."""

    parabola: int
    flown: ParabolicRuns
    release_s: float
    catch_s: float
    bumps: tuple[Bump, ...]

    def as_truth(self) -> dict[str, Any]:
        """For the truth of a flight."""
        return {
            "parabola": self.parabola,
            "flown": self.flown.label,
            "release_s": self.release_s,
            "catch_s": self.catch_s,
            "bumps_s": [bump.at_s for bump in self.bumps],
            "bumps_N_s": [float(np.linalg.norm(bump.impulse_N_s)) for bump in self.bumps],
        }


class Cabin:
    """The cabin during a whole mission, on a grid of half steps.

    Args:
        table: the parabolas.
        step_s: of the grid.
        count: of its rows.
        rng: draws everything.

    Attributes:
        runs: what was drawn, in the order of the parabolas.
    """

    def __init__(self, table: Parabolas, step_s: float, count: int, rng: np.random.Generator) -> None:
        time_s = np.asarray(step_s * np.arange(count), np.float64)
        self._step_s = step_s
        self.runs = tuple(_runs(table, rng))
        self._lift, self._pitch, self._pitch_rate = _aircraft(table, time_s)
        strapped_s = table.period_s if table.strapped else 0.0
        self._tied = time_s < strapped_s
        self._grip = np.ones(count)
        for run in self.runs:
            held_again_s = run.catch_s + GRIP_s
            away = _between(time_s, run.release_s - GRIP_s, run.release_s, run.catch_s, held_again_s)
            self._grip *= 1.0 - away
        felt = np.where(self._tied, 1.0, 0.2)[:, None]  # hands pass on a part of it
        unrest = table.jitter_m_s2 * _noise(_SLOW_Hz, step_s, count, rng)
        unrest += table.vibration_m_s2 * _noise(_VIBRATION_Hz, step_s, count, rng) * felt
        hands = table.hand_m_s2 * _noise(_SLOW_Hz, step_s, count, rng)
        hands += table.tremor_m_s2 * _noise(_TREMOR_Hz, step_s, count, rng)
        self._unrest = unrest + np.where(self._tied[:, None], 0.0, hands)
        self._rate_unrest = np.where(self._tied[:, None], 0.02, 0.1) * _noise(_SLOW_Hz, step_s, count, rng)
        self._launch = np.zeros((count, 6))  # velocity and rate against the cabin that the hands give
        for run in self.runs:
            given = np.concatenate(
                [table.launch_velocity_m_s * rng.standard_normal(3), table.launch_rate_rad_s * rng.standard_normal(3)]
            )
            rows = (time_s > run.release_s - 1.0) & (time_s < run.release_s + GRIP_s)
            self._launch[rows] = given
        self._velocity = np.zeros((count, 3))  # of the cabin
        self._velocity[1:] = np.cumsum(0.5 * step_s * (self._cabin_acceleration[1:] + self._cabin_acceleration[:-1]), 0)
        self._bumps = [bump for run in self.runs for bump in run.bumps]

    @property
    def _cabin_acceleration(self) -> FloatArray:
        """(n, 3) of the floor, world axes, without unrest."""
        up = np.column_stack([np.sin(self._pitch), np.zeros_like(self._pitch), np.cos(self._pitch)])
        return np.asarray(self._lift[:, None] * up, np.float64)

    def start(self) -> tuple[FloatArray, FloatArray]:
        """Pose and velocity of a base that stands on the floor at the start, MuJoCo's numbers of a free joint."""
        p = self._pitch[0]
        pose = np.array([0.0, 0.0, 0.0, np.cos(0.5 * p), 0.0, np.sin(0.5 * p), 0.0])
        return pose, np.array([*self._velocity[0], 0.0, self._pitch_rate[0], 0.0])

    def held(self, stage: int) -> bool:
        """Whether the base's motion is wholly that of the hands at a half step."""
        return bool(self._grip[min(stage, len(self._grip) - 1)] >= 1.0)

    def push(self, stage: int) -> FloatArray:
        """Force on the base's origin, world axes, and moment about it, base axes, at a half step, (6,)."""
        out, at_s = np.zeros(6), stage * self._step_s
        for bump in self._bumps:
            s = (at_s - bump.at_s) / _BUMP_s
            if 0.0 < s < 1.0:  # sin^2, of which the integral is half
                out += 2.0 / _BUMP_s * np.sin(np.pi * s) ** 2 * np.concatenate([bump.impulse_N_s, bump.moment_N_m_s])
        return out

    def acceleration(self, stage: int, pose: FloatArray, velocity: FloatArray, free: FloatArray) -> FloatArray:
        """Of the base at a half step, MuJoCo's numbers, (6,).

        Args:
            stage: number of the half step.
            pose: of the base.
            velocity: of the base.
            free: its acceleration if nothing held it.
        """
        k = min(stage, len(self._grip) - 1)
        grip = self._grip[k]
        if grip == 0.0:
            return free
        follows_s = _STRAPPED_s if self._tied[k] else _FOLLOWS_s
        q = pose[3:] * np.sign(pose[3])
        up = np.array([np.cos(0.5 * self._pitch[k]), 0.0, np.sin(0.5 * self._pitch[k]), 0.0])
        away = _rotation_between(q, up)  # in the base's axes
        target = _RIGHTING_1_s * away / max(1.0, _RIGHTING_1_s * float(np.linalg.norm(away)) / _FASTEST_rad_s)
        if self._launch[k].any():
            target = np.zeros(3)  # it is steadied before it is let go
        rate = target + self._launch[k, 3:] + self._rate_unrest[k] + [0.0, self._pitch_rate[k], 0.0]
        linear = self._cabin_acceleration_at(k) + self._unrest[k]
        linear = linear + (self._velocity[k] + self._launch[k, :3] - velocity[:3]) / (3.0 * follows_s)
        held = np.concatenate([linear, (rate - velocity[3:]) / follows_s])
        return np.asarray(grip * held + (1.0 - grip) * free, np.float64)

    def _cabin_acceleration_at(self, k: int) -> FloatArray:
        up = np.array([np.sin(self._pitch[k]), 0.0, np.cos(self._pitch[k])])
        return np.asarray(self._lift[k] * up, np.float64)


def _runs(table: Parabolas, rng: np.random.Generator) -> list[Release]:
    """Releases, catches and bumps."""
    found = []
    for number, (begin_s, flown) in enumerate(zip(table.starts_s, table.flown, strict=True)):
        drawn = rng.uniform(size=4)
        catch = rng.uniform(*table.catch_s)
        early = rng.uniform(table.motion_at_s + 0.3 * table.motion_s, table.motion_at_s + 0.8 * table.motion_s)
        force, turn = rng.standard_normal(3), rng.standard_normal(3)
        if flown is None:
            continue
        release_s = begin_s + table.release_s[0] + drawn[0] * (table.release_s[1] - table.release_s[0])
        catch_s = begin_s + float(early if drawn[1] < table.early else catch)
        bumps: tuple[Bump, ...] = ()
        if drawn[2] < table.bumps:
            size = table.bump_N_s[0] + rng.uniform() * (table.bump_N_s[1] - table.bump_N_s[0])
            at_s = release_s + _AWAY_s + drawn[3] * (catch_s - release_s - 2.0 * _AWAY_s)
            impulse = size * force / np.linalg.norm(force)
            arm = _ARM_m * turn / np.linalg.norm(turn)
            bumps = (Bump(float(at_s), impulse, np.cross(arm, impulse)),)
        found.append(Release(number, flown, float(release_s), catch_s, bumps))
    return found


def _aircraft(table: Parabolas, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What an accelerometer on the floor shows along its up axis, and the aircraft's pitch and its rate, (n,) each."""
    low = np.zeros_like(time_s)
    for begin_s in table.starts_s:
        end_s = begin_s + table.low_s
        low += _between(time_s, begin_s - table.change_s, begin_s, end_s, end_s + table.change_s)
    lift = table.pull_m_s2 * (1.0 - low)
    # nose down through free fall, and up again in the pull, so that each parabola ends as it began
    up = table.pitch_rad_s * (table.low_s + table.change_s) / (table.pull_s + table.change_s)
    rate = np.where(time_s < table.pull_s + table.change_s, 0.0, table.pitch_rad_s * low - up * (1.0 - low))
    step_s = time_s[1] - time_s[0]
    pitch = np.concatenate([[0.0], np.cumsum(0.5 * step_s * (rate[1:] + rate[:-1]))])
    return lift, pitch, rate


def _between(time_s: FloatArray, a: float, b: float, c: float, d: float) -> FloatArray:
    """0 up to a, 1 from b to c, 0 from d, smooth between; (n,)."""
    s = np.clip(np.minimum((time_s - a) / (b - a), (d - time_s) / (d - c)), 0.0, 1.0)
    return np.asarray(s**3 * (10.0 + s * (-15.0 + 6.0 * s)), np.float64)


def _noise(band_Hz: tuple[float, float], step_s: float, count: int, rng: np.random.Generator) -> FloatArray:
    """Noise of rms 1 by axis in a band, (n, 3)."""
    every = max(1, int(0.1 / (band_Hz[1] * step_s)))  # slow noise is made on a coarser grid
    few = count // every + 4
    rows = filters.passed(filters.band_pass(band_Hz, 1.0 / (every * step_s)), rng.standard_normal((few, 3)))
    at, coarse = np.arange(count) / every, np.arange(few)
    rows = np.column_stack([np.interp(at, coarse, axis) for axis in rows.T])
    return np.asarray(rows / rows.std(), np.float64)


def _rotation_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Rotation vector from attitude a to b, axes of a; unit quaternions w x y z."""
    w = float(a @ b)
    vector = a[0] * b[1:] - b[0] * a[1:] - np.cross(a[1:], b[1:])
    vector = vector * (1.0 if w >= 0.0 else -1.0)
    sine = float(np.linalg.norm(vector))
    return vector if sine < 1e-9 else np.asarray(2.0 * np.arctan2(sine, abs(w)) / sine * vector, np.float64)
