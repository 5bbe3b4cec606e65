"""Prescribed motion of the five joints: holds and multi-tone swings as a function of mission time."""

from typing import NamedTuple

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.motion import PhaseSpan, Program
from hil_sim.scenario.free_flyer_tables import JOINTS, FreeFlyerScenario, Swing


class Swinging(NamedTuple):
    """One swing: its span, its ramp, and its tones, (joints, tones) each."""

    start_s: float
    end_s: float
    ramp_s: float
    amplitude_rad: FloatArray
    rate_rad_s: FloatArray
    phase_rad: FloatArray

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Sum of the tones without the envelope at times (n,), and its derivatives; (n, joints) each."""
        w = self.rate_rad_s
        turn = (time_s[:, None, None] - self.start_s) * w + self.phase_rad  # (n, joints, tones)
        sine, cosine = self.amplitude_rad * np.sin(turn), self.amplitude_rad * w * np.cos(turn)
        return sine.sum(axis=2), cosine.sum(axis=2), -(sine * w * w).sum(axis=2)


class ArmSwings(Program):
    """Joint motion of the sequence table: sums of tones under an envelope, about one posture.

    Args:
        scenario: its ``[arm]`` and ``[[sequence]]``.
        rng: draws posture and tones, in the order of the sequence.
    """

    def __init__(self, scenario: FreeFlyerScenario, rng: np.random.Generator) -> None:
        spread = scenario.arm.posture_spread_deg * rng.uniform(-1.0, 1.0, JOINTS)
        self.posture_rad = np.deg2rad(np.asarray(scenario.arm.posture_deg) + spread)
        self._swings: list[Swinging] = []
        spans: list[PhaseSpan] = []
        now_s = 0.0
        for step in scenario.sequence:
            end_s = round(now_s + step.duration_s, 9)
            if isinstance(step, Swing):
                self._swings.append(_draw(step, now_s, end_s, rng))
            spans.append(PhaseSpan(step.phase, step.action, now_s, end_s))
            now_s = end_s
        self.spans = tuple(spans)

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle, rate and acceleration at times (n,); (n, joints) each."""
        q = np.tile(self.posture_rad, (len(time_s), 1))
        dq, ddq = np.zeros_like(q), np.zeros_like(q)
        for swing in self._swings:
            rows = (time_s > swing.start_s) & (time_s < swing.end_s)
            e, de, dde = (part[:, None] for part in envelope(time_s[rows], swing))
            s, ds, dds = swing.at(time_s[rows])
            q[rows] += e * s
            dq[rows] = de * s + e * ds
            ddq[rows] = dde * s + 2.0 * de * ds + e * dds
        return q, dq, ddq


def _draw(step: Swing, start_s: float, end_s: float, rng: np.random.Generator) -> Swinging:
    shape = (JOINTS, step.tones)
    amplitude = np.deg2rad(step.swing_deg) / np.sqrt(step.tones) * rng.uniform(0.6, 1.2, shape)
    rate = 2.0 * np.pi * rng.uniform(*step.band_Hz, shape)
    return Swinging(start_s, end_s, step.ramp_s, amplitude, rate, rng.uniform(0.0, 2.0 * np.pi, shape))


def envelope(time_s: FloatArray, swing: Swinging) -> tuple[FloatArray, FloatArray, FloatArray]:
    """From 0 to 1 and back by quintics of zero end rates and accelerations; value, rate, acceleration, (n,) each."""
    rising = time_s - swing.start_s < swing.end_s - time_s
    side = np.where(rising, 1.0, -1.0) / swing.ramp_s
    s = np.clip(np.minimum(time_s - swing.start_s, swing.end_s - time_s) / swing.ramp_s, 0.0, 1.0)
    value = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
    return value, side * 30.0 * (s * (1.0 - s)) ** 2, side**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
