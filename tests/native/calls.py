"""Calls of all functions of the library with random arguments, and with wrong ones; run by itself it fuzzes a library.

python -m tests.native.calls LIBRARY SECONDS
"""

import sys
import time
from pathlib import Path

import numpy as np

from onboard.dynamics.air_bearing import predict_run
from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.free_flight import (
    Push,
    bodies_from_rate,
    predict_base_from_rate,
    rate_of_momentum,
    sensor_in_base,
)
from onboard.dynamics.joint_errors import EncoderReadings, ErrorsAlong
from onboard.dynamics.kinematics import Bodies, Frames, chain_motion
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.spatial import Columns
from onboard.estimation.errors import RowError
from onboard.estimation.smoothing import SmoothingWindow
from onboard.identification.evidence.bank import Bank, Changed
from onboard.identification.free_flyer.prediction.imu_errors import SIZE, ImuReading, gain_of, imu_reading, whitened
from onboard.identification.free_flyer.prediction.scaled import Scaled
from onboard.identification.free_flyer.prediction.ticks import TickPrediction
from onboard.native import library
from onboard.native.errors import ArrayError
from onboard.regressor.rows import BaseMotion, RowModel, base_force_rows, joint_torque_row
from onboard.timebase import polygon
from tests.native.vehicles import (
    PERIOD_s,
    lines_of_imu,
    on_table,
    predicted_from,
    random_case,
    random_predictor,
    random_suspects,
)

PREDICTORS = [random_predictor(seed) for seed in (1, 2, 3, 5)]
REFUSALS = ArrayError, RowError, SignalError, ValueError, IndexError, MemoryError


def outcomes(seed):
    """Arrays that the library's functions make of one random vehicle's flight."""
    rng, case = np.random.default_rng(seed), random_case(seed)
    chain, n = case.chain, len(case.readings.q)
    along = case.errors.along(chain, case.corrected.functions, len(case.errors.of_cyclic) // 2)
    base = predict_base_from_rate(
        chain.links, PERIOD_s, case.vehicle.chi, case.rate, Columns(case.free, case.bases), along, case.push
    )
    R, p = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    errors, flyer = 0.2 * rng.normal(size=SIZE), PREDICTORS[seed % len(PREDICTORS)]
    given = predicted_from(flyer, seed)
    predicted, sigma = flyer.predict(*given), rng.uniform(0.0, 1.0, (len(given[0]), 2, given[0].shape[1]))
    noise, x = flyer.joint_noise(given[0], sigma, given[3]), given[3]
    later = flyer.carried(predicted, x, x, np.eye(len(x)))
    read = imu_reading(*rng.normal(size=(2, n, 6)), np.arange(float(n)), errors)
    joint, cyclic = case.vehicle.joints[-1].name, case.errors.of_cyclic.tolist()
    cut = CutWrench(case.vehicle, joint, rng.normal(size=6), case.free, cyclic).predict(base)
    bodies = Bodies.of(chain.links, case.vehicle.chi, *rng.normal(size=(2, n, 6)))
    inverse, (still, start) = np.eye(3) + 0.1 * rng.normal(size=(n, 3, 3)), rng.normal(size=(2, n, 3))
    momentum = rate_of_momentum(inverse, still, start[0], PERIOD_s)
    linear = Scaled(np.arange(10), rng.normal(size=(1, 10))).linear(rng.normal(size=12))
    own = RowModel(
        case.vehicle, [*base_force_rows(case.vehicle), joint_torque_row(case.vehicle, joint, friction=False)]
    )
    rows = own.regressor(*case.corrected[:3], BaseMotion(*rng.normal(size=(3, n, 3))))
    corners = polygon.moved(polygon.box(-3.0, 5.0, 2.0, 4.0), (0.3, 0.1), rng.normal(size=(2, 2)), [(1.0, 0.2, 4.0)])
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 40))
    wide = polygon.widen(np.stack([5.0 * np.cos(angles), np.sin(angles)], axis=1), 1e-3, 1e-3)
    table = predict_run(*on_table(case, seed))
    window = SmoothingWindow(np.cumsum(rng.uniform(0.5, 1.5, 60)), rng.uniform(0.0, 60.0, 9), 20.0)
    suspects, sigma, known = random_suspects(seed)
    bank, m = Bank(suspects, sigma), sum(one.along.shape[1] for one in suspects)
    alone, seen = bank.alone(known), rng.normal(size=(30, m))
    steps = Changed(np.zeros((1, m)), rng.normal(size=m), seen.T @ seen, np.zeros((1, 0)))
    weighed = alone.out, bank.alone(known, 0, alone.of(0)).out, *steps.evidence(suspects)
    slid = table.velocity, table.base.specific_force, table.base.along
    parts = (*chain[0], *chain[1], *chain[2:], *base[:8], *sensor_in_base(base, R, p), *predicted, noise, *later, *read)
    return [
        *parts,
        gain_of(errors),
        *whitened(*lines_of_imu(seed, slice(seed % 3, None, 1 + seed % 2))),
        *cut,
        *slid,
        bodies.parts,
        *momentum,
        linear,
        rows,
        corners,
        wide,
        *polygon.moments(wide),
        *weighed,
        *window.stacked(np.arange(120.0).reshape(60, 2), range(3)),
    ]


def _spoiled(rng, array):
    """An array as it is, of another shape, empty, with what is no number, or enormous."""
    array = np.array(array, np.float64)
    which = rng.integers(0, 9)
    if which < 4 or not array.size:
        return array
    if which == 4:
        return array[: rng.integers(0, len(array))] if array.ndim else array
    if which == 5:
        return np.zeros(rng.integers(0, 4, size=rng.integers(1, 4)))
    if which == 6:
        return array.swapaxes(0, -1)
    array.flat[rng.integers(0, array.size)] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e300, 1e-320])
    return array


def fuzz_once(seed):
    """One round of wrong arguments for everything; only the errors that are said may come of it."""
    rng, case = np.random.default_rng(seed), random_case(seed % 40)

    def spoiled(array):
        return _spoiled(rng, array)

    def attempt(function, *arguments):
        try:
            return function(*arguments)
        except REFUSALS:
            return None

    chi, other = case.vehicle.chi, random_case((seed + 1) % 40)
    read = EncoderReadings(*map(spoiled, case.readings[:3]), PERIOD_s, spoiled(case.readings.cyclic))
    attempt(
        read.corrected, spoiled(case.of_joints), spoiled(case.multiples), case.errors.of_cyclic + rng.integers(-1, 2)
    )
    motion = [spoiled(part) for part in case.readings[:3]]
    attempt(chain_motion, case.vehicle, *motion, spoiled(case.of_joints[:, :3]))
    attempt(RowModel(case.vehicle, base_force_rows(case.vehicle)).regressor, *motion, BaseMotion(*map(spoiled, motion)))
    chain = case.chain
    frames = Frames(*map(spoiled, chain.links))
    attempt(lambda: Bodies.of(frames, spoiled(chi), spoiled(np.ones((len(motion[0]), 6))), None))
    attempt(lambda: Bodies.of(chain.links, chi).sums(spoiled(np.ones((2, len(case.vehicle.links))))))
    push = Push(spoiled(case.push.of_each), spoiled(case.push.gain))
    attempt(bodies_from_rate, frames, PERIOD_s, spoiled(chi), spoiled(case.rate), push)
    functions = spoiled(case.corrected.functions)
    errors = other.errors if rng.random() < 0.3 else case.errors
    along = ErrorsAlong(errors, chain, functions, int(rng.integers(-1, 3)))
    free = Columns(tuple(rng.integers(-1, 9, size=len(case.free)).tolist()) if rng.random() < 0.3 else case.free)
    given = frames, PERIOD_s, spoiled(chi), spoiled(case.rate), free, along, push
    base = attempt(predict_base_from_rate, *given)
    if base is None:
        base = predict_base_from_rate(chain.links, PERIOD_s, chi, case.rate, case.free, None, case.push)
    base = base._replace(along=spoiled(base.along), by_rate=spoiled(base.by_rate))
    R, p, own = spoiled(np.eye(3)), spoiled(np.ones(3)), spoiled(np.zeros(SIZE))
    attempt(sensor_in_base, base, R, p)
    lines = spoiled(np.zeros((len(base.rate), 6, base.along.shape[-1])))
    flyer, wrong = (
        PREDICTORS[seed % len(PREDICTORS)],
        predicted_from(PREDICTORS[(seed + seed // 9) % len(PREDICTORS)], seed),
    )
    attempt(flyer.predict, *(None if part is None else spoiled(part) for part in wrong))
    attempt(flyer.joint_noise, spoiled(wrong[0]), spoiled(np.ones((len(wrong[0]), 2, 5))), spoiled(wrong[3]))
    parts = [spoiled(np.ones(shape)) for shape in ((2, 13), (2, 13, 200), 200, (len(flyer.changing), 200), 200)]
    told, state = TickPrediction(*parts[:4]), np.ones(len(flyer.names))
    attempt(flyer.carried, told, state, parts[4], spoiled(np.eye(len(state))))
    attempt(flyer._core.begin_from, base, PERIOD_s, [spoiled(part) for part in wrong[:3]], spoiled(wrong[3]))
    attempt(imu_reading, lines[..., :1], lines[..., :1], np.ones(3), own)
    attempt(imu_reading, *(spoiled(np.ones((5, 6))) for _ in range(2)), spoiled(np.ones(5)), own)
    attempt(gain_of, own)
    shown, _, of_motion, samples, told, (places, use) = lines_of_imu(seed, slice(0, None, int(rng.integers(1, 4))))
    which = places + rng.integers(-1, 2), use[: rng.integers(0, len(use) + 1)] if rng.random() < 0.3 else use
    shown, of_motion, told = ImuReading(*map(spoiled, shown)), tuple(map(spoiled, of_motion)), tuple(map(spoiled, told))
    attempt(whitened, shown, own, of_motion, samples, told, which)
    times = spoiled(np.cumsum(rng.uniform(0.5, 1.5, 60)))
    attempt(lambda: SmoothingWindow(times, spoiled(np.linspace(0.0, 60.0, 9)), 20.0).apply(spoiled(times), 2))
    source = other if rng.random() < 0.3 else case
    cut = CutWrench(
        source.vehicle, source.vehicle.joints[-1].name, np.ones(6), source.free, source.errors.of_cyclic.tolist()
    )
    attempt(cut.predict, base)
    attempt(rate_of_momentum, spoiled(np.ones((6, 3, 3))), spoiled(np.ones((6, 3))), spoiled(np.ones(3)), PERIOD_s)
    attempt(Scaled(rng.integers(0, 14, 10), np.ones((1, 10))).linear, spoiled(np.ones(12)))
    corners = spoiled(rng.normal(size=(int(rng.integers(0, 60)), 2)))
    segments, cuts = (
        rng.normal(size=(int(rng.integers(0, 4)), 2)),
        spoiled(rng.normal(size=(int(rng.integers(0, 3)), 3))),
    )
    attempt(
        lambda: polygon.moments(
            polygon.moved(corners, (np.nan, 1.0) if rng.random() < 0.1 else (0.1, 0.2), segments, cuts)
        )
    )
    suspects, sigma, known = random_suspects(seed)
    bank, m = Bank(suspects, sigma), sum(one.along.shape[1] for one in suspects)
    attempt(bank.weigh, tuple(map(spoiled, known)))
    attempt(Changed(np.zeros((1, m)), spoiled(np.ones(m)), spoiled(np.eye(m)), np.zeros((1, 0))).evidence, suspects)
    run, start, chi, drag, tilt, unknown = on_table(case, seed)
    wrong = drag._replace(viscous=spoiled(drag.viscous), place=spoiled(drag.place))
    attempt(predict_run, run, spoiled(start), chi, wrong, spoiled(tilt), unknown)


def main(path, seconds):
    library.LIBRARY = library.open_library(Path(path))
    end, seed = time.monotonic() + seconds, 0
    while time.monotonic() < end or seed < 40:
        if seed < 20:
            outcomes(seed)
        with np.errstate(all="ignore"):
            fuzz_once(seed)
        seed += 1
    sys.stdout.write(f"{seed} rounds\n")


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
