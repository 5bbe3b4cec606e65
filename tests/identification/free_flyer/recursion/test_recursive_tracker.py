"""A tracker whose pose is frozen under its noise: it agrees with a vehicle that hardly turns, and then never again."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard.dynamics.tracked_pose import LINES
from onboard.identification.free_flyer.fusion import Fusion
from onboard.identification.free_flyer.prediction.further import FurtherPose, PosePrior
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.prediction.parameters import EXACT_GEOMETRY
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS
from onboard.identification.free_flyer.recursion.recursive import MotionFilter
from onboard.identification.free_flyer.recursion.solved import HeldPayload
from onboard.identification.free_flyer.recursion.trials import CellTrials, WindowFits, WindowProblem, trials_of
from tests.dynamics.free_flyer_twin import BOX
from tests.identification.free_flyer.recorded_flights import BIASES, WIDE, online, recorded, ticks_of

PRIOR = PosePrior(1e-3, 0.02, 3e-3, 0.03, 1e-3)
POSITION_M, ATTITUDE_RAD = 2.5e-4, 1.75e-3  # of a mean of four samples
STILL_s, SLOW_s, CAPTURE_s, END_s = 3.0, 4.0, 8.0, 15.0


class Resting(NamedTuple):
    """Joints that are still for a while, and come to their pace slowly."""

    motion: free_flyer.JointMotion
    still_s: float = STILL_s

    def at(self, time_s):
        since = np.maximum(time_s - self.still_s, 0.0)
        slow = since < SLOW_s
        at_s, pace, change = (
            np.where(slow, *both)
            for both in (
                (since**2 / (2.0 * SLOW_s), since - SLOW_s / 2.0),
                (since / SLOW_s, 1.0),
                (np.where(since > 0.0, 1.0 / SLOW_s, 0.0), 0.0),
            )
        )
        q, dq, ddq = self.motion.at(at_s)
        return q, dq * pace[:, None], ddq * pace[:, None] ** 2 + dq * change[:, None]


@pytest.fixture(scope="module")
def caught():
    """A base that turns by 2 deg/s at rest, a capture on the move."""
    rng = np.random.default_rng(7)
    motion = replace(free_flyer.JointMotion.draw(rng), phase_rad=np.full((5, 3), np.pi / 2))
    flight = free_flyer.FreeFlight(Resting(motion), np.array([0.02, -0.02, 0.02]))
    capture = free_flyer.Capture(BOX, CAPTURE_s, 0.02 * rng.normal(size=3), 0.02 * rng.normal(size=3))
    free_flyer.fly_with_capture(flight, capture, END_s)
    return recorded(flight.history, rng)


def with_a_frozen_tracker(signals, seed=1, held=False):
    """The ticks of a flight, every fourth with a pose; an estimator of them, and one without them."""
    rng, bare = np.random.default_rng(seed), online(signals, held)
    own = bare.predictor
    tracker = FurtherPose("tracker", "imu_base", PRIOR)
    samples = signals.period_s, signals.samples
    predictor = ImuPredictor(own.vehicle, "imu_base", *samples, {}, BIASES, EXACT_GEOMETRY, (tracker,))
    ticks = ticks_of(signals)
    n = len(ticks.time_s)
    noise = np.tile([0.5 * ATTITUDE_RAD] * 4 + [POSITION_M] * 3, (n, 1))
    poses = np.full((n, LINES), np.nan)
    poses[2::4] = np.array([0.6, -0.3, 0.7, 0.245, 1.0, 2.0, 3.0])
    poses += noise * rng.standard_normal((n, LINES))
    measured = np.hstack([ticks.measured, poses])
    sigma = np.hstack([ticks.sigma, noise])
    return ticks._replace(measured=measured, sigma=sigma), MotionFilter(predictor, WIDE, held), bare


def test_it_is_named_and_nothing_that_it_told_is_kept(caught):
    ticks, recursive, bare = with_a_frozen_tracker(caught)
    bare.update(ticks_of(caught))
    for first in range(0, len(ticks.time_s), BATCH_TICKS):  # as in flight, where the work of a call is bounded
        recursive.update(ticks.part(slice(first, first + BATCH_TICKS)))
    assert recursive.fusion.contradicting == ("tracker",)
    assert recursive.changes[-1].kind == bare.changes[-1].kind == "capture"
    assert not recursive.exchanged
    assert recursive.unexplained.count == 0
    found, expected = recursive.estimate(), bare.estimate()
    assert expected is not None
    assert found is not None
    sigma = np.sqrt(expected.covariance[0, 0])
    assert abs(found.body.mass_kg - expected.body.mass_kg) < 0.5 * sigma
    assert np.sqrt(found.covariance[0, 0]) < 1.2 * sigma


@pytest.mark.campaign  # of another window: above; which problem is solved without it: below
def test_one_that_shows_in_the_second_window_of_a_payload_is_left_out_with_that_window():
    """What was known before is given up; the next window has all ticks of this one, and is due at once."""
    rng = np.random.default_rng(7)
    motion = replace(free_flyer.JointMotion.draw(rng), phase_rad=np.full((5, 3), np.pi / 2))
    moving = Resting(motion, still_s=1.0)
    signals = recorded(free_flyer.fly(free_flyer.world(BOX), moving, np.zeros(3), 7.0), rng)
    ticks, recursive, bare = with_a_frozen_tracker(signals, held=True)
    ticks.measured[130:, -3:] += 0.3
    recursive.update(ticks)
    recursive.finish()  # was endless
    bare.update(ticks_of(signals))
    bare.finish()
    assert recursive.fusion.contradicting == ("tracker",)
    found, expected = recursive.estimate(), bare.estimate()
    assert expected is not None
    assert found is not None
    assert abs(found.body.mass_kg - expected.body.mass_kg) < 0.5 * np.sqrt(expected.covariance[0, 0])
    assert recursive.ticks_used >= bare.ticks_used


def test_the_window_without_it_is_solved_with_nothing_known_of_before():
    fusion = Fusion(("imu", "cell", "tracker"), (slice(0, 6), slice(6, 7), slice(7, 14)))
    known = HeldPayload.SAME, HeldPayload.NOTHING
    anew = WindowProblem((HeldPayload.NEW, HeldPayload.NOTHING), without=(2,), anew=True)
    accused = trials_of(fusion, known, 2, 1, 4)  # at once, whatever the payload does
    assert isinstance(accused, WindowFits)
    assert accused.next() == anew
    accused.take(None)
    assert accused.next() is None
    assert trials_of(fusion, known, None, 0, 4).next() == anew
    cell = trials_of(fusion, known, 1, 1, 4)
    assert isinstance(cell, CellTrials)
    assert cell.next() == WindowProblem(known, without=(1,))
