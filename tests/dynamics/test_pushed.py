"""A known wrench on a free-floating base: against MuJoCo, and its derivatives against differences."""

from typing import NamedTuple

import numpy as np

from bench.true_flights import free_flyer
from hil_sim.plants.vehicle_flight import VehicleFlight
from onboard.dynamics.free_flight import Push, predict_base_from_rate, sensor_in_base
from onboard.dynamics.kinematics import chain_motion
from tests.dynamics.derivatives import FIELDS, derivative
from tests.dynamics.free_flyer_twin import twin

STEP_s, EVERY = 2e-3, 5
PERIOD_s = EVERY * STEP_s


class Pulse(NamedTuple):
    """A force at a place of the base, base axes, that begins and ends at once."""

    from_s: float
    to_s: float
    force_n: np.ndarray
    position_m: np.ndarray


PULSES = (
    Pulse(0.6, 1.3, np.array([0.4, -0.2, 0.1]), np.array([0.0, 0.2, 0.05])),
    Pulse(1.0, 1.8, np.array([0.0, 0.0, -0.5]), np.array([0.25, -0.1, 0.0])),
)


class Thrusters:
    """As ``Jets`` push: force in world axes, moment in the base's."""

    any = True

    def push(self, time_s, turn):
        out = np.zeros(6)
        for pulse in PULSES:
            if pulse.from_s <= time_s < pulse.to_s:
                out += np.concatenate([turn @ pulse.force_n, np.cross(pulse.position_m, pulse.force_n)])
        return out


def wrenches(time_s):
    """Means over the ticks, (n, 6, 2)."""
    each = np.zeros((len(time_s), 6, 2))
    for k, pulse in enumerate(PULSES):
        on = np.clip(np.minimum(time_s - pulse.from_s, pulse.to_s - time_s) / PERIOD_s + 0.5, 0.0, 1.0)
        each[..., k] = on[:, None] * np.concatenate([pulse.force_n, np.cross(pulse.position_m, pulse.force_n)])
    return each


def test_thrusters_are_predicted_as_mujoco_moves_the_base():
    known = twin(0.1)
    model, velocity = free_flyer.world(None), np.array([0.0, 0.0, 0.0, 0.05, -0.04, 0.03])
    flight = VehicleFlight(model, known.motion, free_flyer.PLACES, None, STEP_s, velocity, jets=Thrusters())
    seen, chi = free_flyer.signals(model, flight.advance(round(3.0 / STEP_s))), known.chi.copy()
    chi[known.vehicle.payload_columns()] = 0.0
    ticks = slice(None, None, EVERY)
    chain = chain_motion(known.vehicle, *known.motion.at(seen.time_s[ticks]))
    R, p = known.vehicle.pose_in_base("imu_base")
    rate, push = seen.rate_rad_s[ticks], Push(wrenches(seen.time_s[ticks]), np.ones(2))
    told, without = (
        predict_base_from_rate(chain.links, PERIOD_s, chi, R @ rate[0], (), push=one) for one in (push, None)
    )
    edges = [round(at / PERIOD_s) for pulse in PULSES for at in (pulse.from_s, pulse.to_s)]
    whole = ~np.isin(np.arange(len(rate)), [edge + near for edge in edges for near in (-1, 0, 1)])
    a_fiftieth_of_the_gyros_noise, a_hundredth_of_the_accelerometers = 4e-5, 1e-4
    assert np.abs(told.rate @ R - rate)[whole].max() < a_fiftieth_of_the_gyros_noise
    assert np.abs(told.rate @ R - rate).max() < 10.0 * a_fiftieth_of_the_gyros_noise  # half a tick at an edge
    assert np.abs(without.rate @ R - rate).max() > 1000.0 * a_fiftieth_of_the_gyros_noise
    force = sensor_in_base(told, R, p).values[:, 3:]
    assert np.abs(force - seen.specific_force_m_s2[ticks])[whole].max() < a_hundredth_of_the_accelerometers


def test_derivatives_with_thrusters_are_finite_differences():
    known = twin(0.1)
    time_s = 0.9 + PERIOD_s * np.arange(60)
    chain = chain_motion(known.vehicle, *known.motion.at(time_s))
    last, rate, gain = len(known.vehicle.links) - 1, np.array([0.05, -0.04, 0.03]), np.array([1.1, 0.9])

    def predicted(chi, start, gains):
        push = Push(wrenches(time_s), gains)
        return predict_base_from_rate(chain.links, PERIOD_s, chi, start, (last, 0), push=push)

    base = predicted(known.chi, rate, gain)
    steps = [(k, np.zeros(70), unit, np.zeros(2)) for k, unit in enumerate(np.eye(3))]
    steps += [
        (3 + 10 * of + k, np.eye(70)[10 * link + k], np.zeros(3), np.zeros(2))
        for of, link in enumerate((last, 0))
        for k in range(10)
    ]
    steps += [(23 + k, np.zeros(70), np.zeros(3), unit) for k, unit in enumerate(np.eye(2))]
    for column, *moved in steps:
        up, down = (
            predicted(*(at + 1e-5 * sign * by for at, by in zip((known.chi, rate, gain), moved, strict=True)))
            for sign in (1, -1)
        )
        for field in FIELDS:
            slope = (getattr(up, field) - getattr(down, field)) / 2e-5
            ours = derivative(base, field)[:, :, column]
            assert np.abs(ours - slope).max() < 2e-4 * np.abs(slope).max() + 1e-9, (column, field)
