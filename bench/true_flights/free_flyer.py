"""DYMAFLEX in free fall for tests and benches of estimators: true signals of its flights, without devices.

The vehicle is that of its URDF (Limparis section 4.3: 23.1 kg, a five-joint arm of 3.399 kg), flown by
:mod:`hil_sim.plants.vehicle_flight`. The joints follow a prescribed motion; a capture is plastic: the velocity that the
IMU gains in it is in the specific force of the next sample, as a mean over it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants import urdf_drawing
from hil_sim.plants.body import Solid
from hil_sim.plants.parts.exchange import Released
from hil_sim.plants.urdf_model import Places, Sensed, UrdfModel
from hil_sim.plants.vehicle_flight import FlownJoints, Rows, VehicleFlight
from hil_sim.scenario.bed import VEHICLES

Body = Solid
JOINTS, STEP_s = 5, 2e-3
COUNTS_PER_TURN = 500_000  # 1250 lines, four edges each, behind a gear of 100
PLACES = Places(("imu_base",), ("link_5",))
DRAWING = urdf_drawing.read((VEHICLES / "dymaflex" / "dymaflex.urdf").read_text(encoding="utf-8"), "dymaflex.urdf")
LINKS = tuple(f"link_{k}" for k in range(1, JOINTS + 1))
BASE, *_arm = UrdfModel(DRAWING, "free", (0.0, 0.0, 0.0), PLACES).drawn.values()
ARM = tuple(_arm)


@dataclass(frozen=True)
class JointMotion:
    """``q(t) = q_0 + sum_k a_k (sin(w_k t + p_k) - sin p_k)`` by joint; each array (joints, harmonics)."""

    start_rad: FloatArray  # (joints,)
    amplitude_rad: FloatArray
    rate_rad_s: FloatArray
    phase_rad: FloatArray

    @staticmethod
    def draw(rng: np.random.Generator, swing_rad: float = 0.35, harmonics: int = 3) -> "JointMotion":
        """Random exciting motion: all joints swing at once, at 0.1 to 0.6 Hz, each differently."""
        shape = (JOINTS, harmonics)
        amplitude = swing_rad / np.sqrt(harmonics) * rng.uniform(0.6, 1.2, shape)
        rate = 2.0 * np.pi * rng.uniform(0.1, 0.6, shape)
        start = np.array([0.0, 0.6, 0.0, 0.8, 0.0]) + rng.uniform(-0.3, 0.3, JOINTS)
        return JointMotion(start, amplitude, rate, rng.uniform(0.0, 2.0 * np.pi, shape))

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle, rate and acceleration at times (n,); (n, joints) each."""
        a, w, p = self.amplitude_rad, self.rate_rad_s, self.phase_rad
        turn = w * time_s[:, None, None] + p
        sine, cosine = np.sin(turn), np.cos(turn)
        q = self.start_rad + (a * (sine - np.sin(p))).sum(axis=2)
        return q, (a * w * cosine).sum(axis=2), -(a * w * w * sine).sum(axis=2)


class FreeFlightSignals(NamedTuple):
    """True signals on the grid of the samples."""

    time_s: FloatArray  # (n,)
    q_rad: FloatArray  # (n, 5)
    dq_rad_s: FloatArray  # (n, 5)
    rate_rad_s: FloatArray  # (n, 3) of the base, IMU axes
    specific_force_m_s2: FloatArray  # (n, 3) at the IMU, its axes: a - g, in free fall the acceleration itself
    wrist_force_n: FloatArray  # (n, 3) through the last joint's flange, on all beyond it, in the last link's axes
    wrist_moment_n_m: FloatArray  # (n, 3) about the flange's origin, the same
    torque_n_m: FloatArray  # (n, 5) of the joints' drives


def signals(model: UrdfModel, rows: Rows, first: int = 0) -> FreeFlightSignals:
    """Rows of a flight, the first of them the sample of this number."""

    def sensed(kind: Sensed, link: str) -> FloatArray:
        return rows.sensors[:, model.sensor(kind, link)]

    time_s = STEP_s * np.arange(first, first + len(rows.joints), dtype=np.float64)
    imu = sensed("gyro", "imu_base"), sensed("accelerometer", "imu_base")
    wrist = sensed("force", "link_5"), sensed("torque", "link_5")
    return FreeFlightSignals(time_s, rows.joints, rows.rates, *imu, *wrist, rows.torques)


def world(
    payload: Body | None,
    base: Body = BASE,
    arm: Sequence[Body] = ARM,
    offsets_m: FloatArray | None = None,
    kind: str = "free",
    gravity_m_s2: Sequence[float] = (0.0, 0.0, 0.0),
) -> UrdfModel:
    """The vehicle with bodies as built, joints so far off the drawing (5, 3), and a payload in the grasp frame."""
    model = UrdfModel(DRAWING, kind, gravity_m_s2, PLACES)
    model.build(dict(zip(("base", *LINKS), (base, *arm), strict=True)))
    if offsets_m is not None:
        model.move(dict(zip(LINKS, offsets_m, strict=True)))
    model.hold("payload", payload)
    return model


def flight_of(model: UrdfModel, motion: FlownJoints, rate_rad_s: Sequence[float] | FloatArray) -> VehicleFlight:
    """A flight that begins with a rate of the base, (3,) base axes, and then moves the arm."""
    return VehicleFlight(model, motion, PLACES, "payload", STEP_s, np.concatenate([np.zeros(3), rate_rad_s]))


def fly(
    model: UrdfModel, motion: FlownJoints, rate_rad_s: Sequence[float] | FloatArray, duration_s: float
) -> FreeFlightSignals:
    """A whole flight of a vehicle of :func:`world`; ``rate_rad_s``: of the base at the start, base axes, (3,)."""
    return signals(model, flight_of(model, motion, rate_rad_s).advance(round(duration_s / STEP_s)))


class FreeFlight:
    """A flight computed in chunks, with capture and release of a payload.

    Args:
        motion: of the joints, in the time of the flight.
        rate_rad_s: of the base at the start, base axes, (3,).
        payload: held from the start, if any.
        base: of the vehicle.
        arm: its five links.

    Attributes:
        flight: what computes it.
        impulse_m_s: velocity that the IMU gained in a capture since the newest sample, IMU axes (3,).
    """

    step_s = STEP_s

    def __init__(
        self,
        motion: FlownJoints,
        rate_rad_s: Sequence[float] | FloatArray,
        payload: Body | None = None,
        base: Body = BASE,
        arm: Sequence[Body] = ARM,
    ) -> None:
        self.flight = flight_of(world(payload, base, arm), motion, rate_rad_s)
        self.impulse_m_s = np.zeros(3)
        self._held = payload
        self._flown: list[FreeFlightSignals] = []

    @property
    def time_s(self) -> float:
        """Of the next sample."""
        return self.flight.count * STEP_s

    @property
    def history(self) -> FreeFlightSignals:
        """All samples so far."""
        return FreeFlightSignals(*(np.concatenate(parts) for parts in zip(*self._flown, strict=True)))

    def advance(self, samples: int) -> FreeFlightSignals:
        """The next ``samples`` samples, one or more."""
        first = self.flight.count
        flown = signals(self.flight.vehicle, self.flight.advance(samples), first)
        flown.specific_force_m_s2[0] += self.impulse_m_s / STEP_s
        self.impulse_m_s = np.zeros(3)
        self._flown.append(flown)
        return flown

    def capture(
        self, payload: Body, velocity_m_s: Sequence[float] | FloatArray, rate_rad_s: Sequence[float] | FloatArray
    ) -> None:
        """Capture a payload, in the grasp frame; its velocity and rate just before against the gripper's, base axes."""
        self.flight.show()
        R_WB = self.flight.data.body(f"{urdf_drawing.PREFIX}base").xmat.reshape(3, 3)
        R_GB = self.flight.grip()[0].T @ R_WB
        came = Released(payload, R_GB @ np.asarray(velocity_m_s), R_GB @ np.asarray(rate_rad_s))
        jolt, self._held = self.flight.exchange(came, None), payload
        self.impulse_m_s = jolt.sensors[self.flight.vehicle.sensor("accelerometer", "imu_base")].copy()

    def release(self) -> None:
        """Release the payload without an impulse."""
        assert self._held is not None
        self.flight.exchange(None, Released(self._held, np.zeros(3), np.zeros(3)))
        self._held = None


class Capture(NamedTuple):
    """A payload captured in flight and its relative motion; see :meth:`FreeFlight.capture`."""

    payload: Body
    time_s: float
    velocity_m_s: FloatArray  # (3,) relative to the gripper, base axes
    rate_rad_s: FloatArray  # (3,)


def fly_with_capture(flight: FreeFlight, capture: Capture, duration_s: float) -> FreeFlightSignals:
    """Complete a flight to ``duration_s``; the payload is held from the first sample at or after the capture time."""
    flight.advance(int(np.ceil((capture.time_s - flight.time_s) / STEP_s - 1e-9)))
    flight.capture(capture.payload, capture.velocity_m_s, capture.rate_rad_s)
    flight.advance(round((duration_s - flight.time_s) / STEP_s))
    return flight.history
