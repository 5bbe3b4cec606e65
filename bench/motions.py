"""What a payload is known to after a motion, by the way the motion was found, at equal limits.

    python -m bench.motions [--vehicle dymaflex] [--seconds 20] [--rate 0.4] [--mass 5] [--seeds 5]

On a free-flyer with the payload held. Each motion begins and ends at rest, and is as large as the limits allow (the
URDF's, ``--rate`` of the base): the dissertation's (first and second joint, yaw and pitch, together there and back,
table 4.4), the swings of a rehearsal (multi-sine, ``--seeds`` draws), splines drawn at random (the best of as many as
the plan looked at), splines with the smallest condition number of the payload's regressor, its columns scaled (as
FIGAROH and others choose), and ``heft plan``. The last two use the same splines, search and number of steps.

Printed: expected half intervals (95 %) of the mass in per cent and of the inertia in per cent of half its trace (rms of
six), by the filter's bound with all nuisances; and after which share of the time the motion knows each as well as the
median multi-sine does at its end. A last line plans a motion of half the time.
"""

import argparse
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hil_sim.devices.vehicle_file import rehearsal
from hil_sim.plants import urdf_drawing
from hil_sim.plants.motions.joint_swings import JointSwings
from hil_sim.plants.planned import default_plan, planned, room_for_motion
from onboard import config
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.problem.identification import build_model
from onboard.ground.before.foresee.plan import plan_of
from onboard.ground.before.planning.bound import TICK_HZ, FreeBound, MotionBound
from onboard.ground.before.planning.criteria import Criterion
from onboard.ground.before.planning.limits import Limits, LimitsFile
from onboard.ground.before.planning.planning import PIECE_s, ticks_of
from onboard.ground.before.planning.search import FINE_HZ, Search, search
from onboard.ground.before.planning.splines import Splines
from onboard.identification.exiddm.prediction.imu_prediction import PAYLOAD

HALF = 1.959964  # of a 95 % interval, in standard deviations
SWEEP_s = 10.0  # of the dissertation's motions: 10 to 15 s
Moved = Callable[[FloatArray], FloatArray]  # angle, rate, acceleration, (3, n, joints), about zero, at times (n,)


class Bench(NamedTuple):
    """Where motions are compared."""

    bound: FreeBound
    limits: Limits
    posture: FloatArray
    seconds: float

    def at(self, rate_Hz: float) -> FloatArray:
        """Times of the motion."""
        return np.arange(round(self.seconds * rate_Hz)) / rate_Hz

    def scaled(self, motion: Moved) -> Moved:
        """A motion as large as the limits allow."""
        low, high = self.limits.room(self.posture)
        moved = motion(self.at(FINE_HZ))

        def keeps(size: float) -> bool:
            own = size * moved
            if (own[0] < low).any() or (own[0] > high).any():
                return False
            own[0] += self.posture
            return bool((self.limits.excess(own, self.bound.base(own, 1.0 / FINE_HZ), 1.0 / FINE_HZ) <= 0.0).all())

        least, most = 0.0, 10.0
        for _ in range(20):
            middle = 0.5 * (least + most)
            least, most = (middle, most) if keeps(middle) else (least, middle)
        return lambda time_s: least * motion(time_s)

    def known(self, motion: Moved) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times, (m,), and half intervals of mass and inertia when the motion ended there, (m,) each, in per cent."""
        moved = motion(self.at(TICK_HZ))
        moved[0] += self.posture
        ticks, sigma = self.bound.along(moved)
        share = 100.0 * HALF * sigma / self.bound.scales
        return ticks / TICK_HZ, share[:, 0], np.sqrt(np.mean(share[:, 4:] ** 2, axis=1))


class Conditioned(FreeBound):
    """Knows no noise, no nuisances and no sizes: a motion counts by its regressor's condition number."""

    def of(self, moved: FloatArray) -> MotionBound:
        """A covariance whose longest axis, in the quantities' scales, is the condition number."""
        W = self.whitened(moved)[:, PAYLOAD] * self.noise(moved)[0].reshape(-1, 1)
        W = W / np.maximum(np.linalg.norm(W, axis=0), 1e-300)
        values = np.linalg.svd(W, compute_uv=False)
        condition = values[0] / max(values[-1], 1e-12)
        return MotionBound(np.diag((condition * self.scales) ** 2), self.base(moved, self._predictor.period_s))


def bench_of(
    vehicle: config.Vehicle,
    over: str | None,
    mass_kg: float,
    seconds: float,
    rate: float,
    kind: type[FreeBound] = FreeBound,
) -> Bench:
    """A vehicle with a payload held, in the longest swing of its rehearsal."""
    room = room_for_motion(rehearsal(vehicle.path, over), seconds)
    coarse = vehicle.with_row_rate(TICK_HZ)
    plan = plan_of(coarse, default_plan(room.scenario, 1.0 / TICK_HZ))
    assert plan.payload is not None
    by = mass_kg / plan.payload.mass_kg
    body = plan.payload._replace(mass_kg=mass_kg, inertia_kg_m2=plan.payload.inertia_kg_m2 * by)
    plan = plan._replace(payload=body)
    first = ticks_of(plan, room.start_s, room.end_s).start
    said = LimitsFile(base_rate_rad_s=rate)
    bound = kind(coarse, plan, first, still=True)
    return Bench(bound, Limits(build_model(vehicle), said, body), plan.q[first], seconds)


def multi_sine(vehicle: config.Vehicle, over: str | None, seconds: float, seed: int) -> Moved:
    """The longest swing of the rehearsal, as a seed draws it."""
    room = room_for_motion(rehearsal(vehicle.path, over), seconds)
    drawing = urdf_drawing.read(room.scenario.vehicle.urdf, room.scenario.vehicle.label).joints
    program = JointSwings(room.scenario, tuple(drawing.values()), np.random.default_rng(seed))
    made = plan_of(vehicle, planned(room.scenario, program, tuple(drawing), 1.0 / FINE_HZ))
    order = [list(drawing).index(joint.name) for joint in build_model(vehicle).joints]

    def moved(time_s: FloatArray) -> FloatArray:
        found = np.stack(program.at(room.start_s + time_s))[:, :, order]
        found[0] -= made.q[0]
        return found

    return moved


def there_and_back(joints: int, chosen: tuple[int, ...]) -> Moved:
    """Some joints together from rest to rest and back, each sweep of :data:`SWEEP_s`, again and again."""

    def moved(time_s: FloatArray) -> FloatArray:
        w = 2.0 * np.pi / SWEEP_s
        out = np.zeros((3, len(time_s), joints))
        c, s = np.cos(w * time_s), np.sin(w * time_s)
        for column in chosen:
            out[:, :, column] = 0.5 * (1.0 - c), 0.5 * w * s, 0.5 * w**2 * c
        return out

    return moved


def spline(splines: Splines, coefficients: FloatArray) -> Moved:
    """A spline about its posture."""

    def moved(time_s: FloatArray) -> FloatArray:
        found = splines.move(splines.basis(time_s), coefficients)
        found[0] -= splines.posture
        return found

    return moved


def searched(own: Bench, bound: FreeBound, steps: tuple[int, int], criterion: Criterion) -> tuple[Moved, int]:
    """The motion that the planner's search finds for a bound, and what it looked at."""
    splines = Splines(own.posture, own.seconds, max(6, round(own.seconds / PIECE_s)))
    over = Search(bound, own.limits, splines, tuple(range(10)), criterion)
    found = search(over, *steps, np.random.default_rng(1), lambda _: None)
    return spline(splines, found.coefficients), found.evaluations


def drawn(own: Bench, count: int) -> Moved:
    """The best of many random splines, by the plan's criterion."""
    splines = Splines(own.posture, own.seconds, max(6, round(own.seconds / PIECE_s)))
    over = Search(own.bound, own.limits, splines, tuple(range(10)))
    return spline(splines, search(over, count, 0, np.random.default_rng(2), lambda _: None).coefficients)


def share(known: tuple[FloatArray, FloatArray, FloatArray], column: int, wanted: float, seconds: float) -> float:
    """Of the time after which a motion knows as much as wanted; inf: never."""
    fine = np.flatnonzero(known[column] <= wanted)
    return float(known[0][fine[0]] / seconds) if fine.size else np.inf


def run() -> None:
    """Compare, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", default="dymaflex", help="packaged, or a vehicle.toml of a free base")
    parser.add_argument("--scenario", help="of its rehearsal")
    parser.add_argument("--mass", type=float, default=5.0, help="of the payload, kg")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=0.4, help="limit of the base's rate, rad/s")
    parser.add_argument("--seeds", type=int, default=5, help="draws of the multi-sine")
    parser.add_argument("--starts", type=int, default=64)
    parser.add_argument("--iterations", type=int, default=15)
    asked = parser.parse_args()
    vehicle = config.named(asked.vehicle)
    given = vehicle, asked.scenario, asked.mass
    own = bench_of(*given, asked.seconds, asked.rate)
    steps = asked.starts, asked.iterations
    swings = [
        own.known(own.scaled(multi_sine(vehicle, asked.scenario, asked.seconds, k + 1))) for k in range(asked.seeds)
    ]
    wanted = [float(np.median([one[k][-1] for one in swings])) for k in (1, 2)]
    middle = sorted(swings, key=lambda one: one[1][-1])[len(swings) // 2]
    _show("multi-sine, median", middle, wanted, asked.seconds)
    _show("multi-sine, best", min(swings, key=lambda one: one[1][-1]), wanted, asked.seconds)
    both = there_and_back(len(own.posture), (0, 1))
    _show("yaw and pitch", own.known(own.scaled(both)), wanted, asked.seconds)
    best, evaluations = searched(own, own.bound, steps, Criterion.D)
    _show("heft plan", own.known(best), wanted, asked.seconds)
    _show("heft plan, at its limits", own.known(own.scaled(best)), wanted, asked.seconds)
    half = bench_of(*given, 0.5 * asked.seconds, asked.rate)
    short, _ = searched(half, half.bound, steps, Criterion.D)
    _show("heft plan of half the time", half.known(short), wanted, asked.seconds)
    _show("best of random splines", own.known(drawn(own, evaluations)), wanted, asked.seconds)
    conditioned = bench_of(*given, asked.seconds, asked.rate, Conditioned).bound
    flat, _ = searched(own, conditioned, steps, Criterion.WORST)
    _show("condition number", own.known(own.scaled(flat)), wanted, asked.seconds)
    print(f"{evaluations} motions looked at")


def _show(name: str, known: tuple[FloatArray, FloatArray, FloatArray], wanted: list[float], seconds: float) -> None:
    mass, inertia = (share(known, k, wanted[k - 1], seconds) for k in (1, 2))
    print(
        f"{name:28s} mass {known[1][-1]:7.3f} %  inertia {known[2][-1]:7.2f} %   "
        f"as the multi-sine after {mass:.2f}, {inertia:.2f} of its time",
        flush=True,
    )


if __name__ == "__main__":
    run()
