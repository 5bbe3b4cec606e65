"""What one call of the mechanics costs at five joints, beside the same result in plain NumPy; medians.

Then the block system beside MuJoCo: the same chain of ball joints, the same steps. Run ``python bench/mechanics.py
[--calls N] [--block-seconds S]`` from a checkout.
"""

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from bench.block_system import BlockRace, BlockSystem
from onboard.cli.common import load_vehicle
from onboard.dynamics.mechanics import barycentric, virtual_manipulator
from onboard.dynamics.mechanics.chain import chain_of, rotations
from onboard.dynamics.mechanics.reaction import reaction
from onboard.ground.before.mechanics.analysis import arm_of

LIMIT_US = 50.0


def median_us(call: Callable[[], object], calls: int) -> float:
    """Median over batches of ten."""
    batches = []
    for _ in range(max(calls // 10, 1)):
        start = time.perf_counter()
        for _ in range(10):
            call()
        batches.append((time.perf_counter() - start) / 10 * 1e6)
    return statistics.median(batches)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=2000)
    parser.add_argument("--block-seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    calls = arguments.calls
    arm = arm_of(load_vehicle("dymaflex"), None)
    chain, rng = chain_of(arm), np.random.default_rng(1)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, arm.joints))
    system, R = BlockSystem(chain), rotations(chain, q)
    rate, torque = rng.normal(size=(len(R), 3)), np.zeros((len(R) - 1, 3))
    rows: list[tuple[str, Callable[[], object], Callable[[], object] | None]] = [
        ("momentum map", lambda: arm.momentum_map(q), None),
        (
            "generalized Jacobian (linear part in NumPy)",
            lambda: arm.generalized_jacobian(q),
            lambda: virtual_manipulator.virtual_jacobian(chain, q, barycentric.body_rates(chain, q)),
        ),
        ("motion of the base", lambda: arm.base_motion(q, dq), None),
        ("reduced inertia", lambda: arm.reduced_inertia(q), lambda: barycentric.reduced_inertia(chain, q)),
        (
            "tip from the centre of mass",
            lambda: arm.tip_pose(q)[1] - arm.centre_of_mass(q),
            lambda: virtual_manipulator.virtual_tip(chain, q),
        ),
        ("reaction moment", lambda: reaction(arm, q, dq, ddq), None),
        ("attitude hold", lambda: arm.attitude_hold_momentum(q, dq), None),
        ("block system, accelerations", lambda: system.accelerations(R, rate, torque), None),
    ]
    print(f"{'us a call, n = 5':46}{'Pinocchio':>12}{'NumPy':>10}{'ratio':>8}   (bar {LIMIT_US:g} us)")
    for name, ours, peer in rows:
        mine = median_us(ours, calls)
        other = median_us(peer, max(calls // 10, 10)) if peer else 0.0
        print(f"{name:46}{mine:12.1f}" + (f"{other:10.1f}{other / mine:8.1f}" if peer else ""))
    seconds, step_s = arguments.block_seconds, 1e-3
    print(f"\nblock system of {len(chain.mass)} bodies, rates 0.1 rad/s: {seconds:g} s in steps of {1e3 * step_s:g} ms")
    race = BlockRace(chain, np.random.default_rng(1).normal(0.0, 0.1, (len(chain.mass), 3)), step_s)
    race.run(seconds)
    steps = seconds / step_s * 1e-6
    print(
        f"rates within {race.relative_error():.1e} of MuJoCo's, relative; "
        f"{race.ours_s / steps:.0f} us a step, MuJoCo {race.theirs_s / steps:.0f} us"
    )


if __name__ == "__main__":
    main()
