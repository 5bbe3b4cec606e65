"""One tick of the linear estimators, from kinematics to estimate and covariance, beside other people's; in one run.

Run ``python -m bench.estimators``: a free base with five joints and a payload, ten parameters unknown, six zero-wrench
rows a tick. The other programs get their rows from the textbook recursion in NumPy. The C reference is the update alone
(Givens rotations and back substitution), compiled here with the machine's ``cc``. padasip comes with the extra "bench".
Every number is the median of batches of calls, in the thread's own CPU time: others on the machine do not count.
"""

import argparse
import ctypes
import importlib.util
import os
import platform
import resource
import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from filterpy.kalman import FadingKalmanFilter, KalmanFilter, SquareRootKalmanFilter
from numpy.typing import NDArray

from bench.identification.free_flyer import PAYLOAD_SIGMA, vehicle
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.gates import ResidualGate
from onboard.estimation.recursive.instrumental import RecursiveInstrumental
from onboard.estimation.recursive.memory import Memory, RecursiveLeastSquares
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.rows.predicted_motion import PredictedMotion
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.rows import BaseMotion, RowModel, base_force_rows, base_moment_rows, joint_torque_row

Floats = NDArray[np.float64]

P, M = 10, 6
HOUR_TICKS = 3600 * 200
GIVENS = r"""
#include <math.h>
/* R: upper triangle of [R z], p rows of p + 1; rows: m of p + 1, used up; x: p. */
void update(double *R, double *rows, int m, int p, double *x) {
    int w = p + 1;
    for (int k = 0; k < m; k++) {
        double *r = rows + k * w;
        for (int i = 0; i < p; i++) {
            double *t = R + i * w, b = r[i];
            if (b == 0.0) continue;
            double h = sqrt(t[i] * t[i] + b * b), c = t[i] / h, s = b / h;
            for (int j = i; j < w; j++) {
                double u = t[j], v = r[j];
                t[j] = c * u + s * v;
                r[j] = c * v - s * u;
            }
        }
    }
    for (int i = p - 1; i >= 0; i--) {
        double v = R[i * w + p];
        for (int j = i + 1; j < p; j++) v -= R[i * w + j] * x[j];
        x[i] = v / R[i * w + i];
    }
}
"""


class Ticks:
    """Random motion of the free-flyer, and its rows."""

    def __init__(self, model: VehicleModel, n: int, rng: np.random.Generator) -> None:
        self.q, self.dq, self.ddq = (rng.normal(size=(n, len(model.joints))) for _ in range(3))
        self.motion = BaseMotion(*(rng.normal(size=(n, 3)) for _ in range(3)))
        self.held = np.ones(n, bool)
        self.time_s: Floats = np.arange(n, dtype=np.float64) * 0.01


class TextbookRegressor:
    """Newton and Euler link by link in NumPy: six rows of the payload's ten columns, and the known links' wrench."""

    def __init__(self, model: VehicleModel) -> None:
        pinocchio = model.model
        self._joints = [
            (
                np.array(joint.axis),
                np.array(pinocchio.jointPlacements[k].rotation),
                np.array(pinocchio.jointPlacements[k].translation),
            )
            for k, joint in enumerate(model.joints, 2)
        ]
        tip = pinocchio.frames[model.frame_id("payload")].placement
        self._tip = np.array(tip.rotation), np.array(tip.translation)
        self._chi = model.chi.reshape(-1, 10)[:-1]

    def __call__(self, ticks: Ticks, k: int) -> tuple[Floats, Floats]:
        """Y (6, 10) and y (6,), about the base's origin."""
        R, p = np.eye(3), np.zeros(3)
        w, dw, a = (part[k] for part in ticks.motion)
        known = self._wrench(R, p, w, dw, a) @ self._chi[0]
        for link, (axis, turn, offset) in enumerate(self._joints, 1):
            arm = R @ offset
            a = a + np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
            p, R = p + arm, R @ turn
            q, dq, ddq = ticks.q[k, link - 1], ticks.dq[k, link - 1], ticks.ddq[k, link - 1]
            K = self._hat(axis)
            R = R @ (np.eye(3) + np.sin(q) * K + (1.0 - np.cos(q)) * K @ K)
            about = R @ axis
            dw = dw + about * ddq + np.cross(w, about * dq)
            w = w + about * dq
            known = known + self._wrench(R, p, w, dw, a) @ self._chi[link]
        arm = R @ self._tip[1]
        a = a + np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
        return self._wrench(R @ self._tip[0], p + arm, w, dw, a), -known

    @staticmethod
    def _hat(v: Floats) -> Floats:
        return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])

    def _wrench(self, R: Floats, p: Floats, w: Floats, dw: Floats, a: Floats) -> Floats:
        own, spin, force = R.T @ w, R.T @ dw, R.T @ a
        W = np.zeros((6, 10))
        W[:3, 0], W[:3, 1:4] = force, self._hat(spin) + self._hat(own) @ self._hat(own)
        W[3:, 1:4] = -self._hat(force)
        L = [
            np.array([[x[0], x[1], 0, x[2], 0, 0], [0, x[0], x[1], 0, x[2], 0], [0, 0, 0, x[0], x[1], x[2]]])
            for x in (spin, own)
        ]
        W[3:, 4:] = L[0] + self._hat(own) @ L[1]
        W[:3], W[3:] = R @ W[:3], R @ W[3:]
        W[3:] += self._hat(p) @ W[:3]
        return W


def median_us(call: Callable[[], object], calls: int = 200, batches: int = 25) -> float:
    """Of batches of so many calls, per call."""
    times = []
    for _ in range(batches):
        start = time.thread_time()
        for _ in range(calls):
            call()
        times.append((time.thread_time() - start) / calls)
    return 1e6 * float(np.median(times))


def line(name: str, value_us: float, bar: str = "") -> None:
    """One row of the table."""
    print(f"  {name:66}{value_us:9.1f} us {bar}")


class Ours:
    """The estimator's tick in pieces."""

    def __init__(self, model: VehicleModel, ticks: Ticks) -> None:
        self.ticks = ticks
        self.rows = RowModel(model, [*base_force_rows(model), *base_moment_rows(model)])
        columns = model.payload_columns()
        mix = np.zeros((len(self.rows.names), P + 1))
        mix[columns, :P] = np.eye(P)
        mix[: columns.start, P] = self.rows.chi[: columns.start]
        self.fold = self.rows.fold(mix)
        self.rls = SquareRootRls(P)
        self.rls.prior(np.zeros(P), PAYLOAD_SIGMA)
        self.gate = ResidualGate(1e6)  # looks at all, keeps all: these rows are no one body's
        self.predicted = PredictedMotion(model, 0.1)
        self.instrumental = RecursiveInstrumental(P, 0, 1.0)
        self.instrumental.rls.prior(np.zeros(P), PAYLOAD_SIGMA)
        self.sigma = np.ones(M * len(ticks.held))
        self.row_times = np.repeat(ticks.time_s, M)

    def regressor(self, motion: BaseMotion) -> tuple[Floats, Floats]:
        """Rows of all ticks."""
        t = self.ticks
        Y = self.rows.regressor(t.q, t.dq, t.ddq, motion, t.held, fold=self.fold)
        return Y[..., :P].reshape(-1, P), -Y[..., P].ravel()

    def gates_and_update(self, Y: Floats, y: Floats) -> None:
        """Rows in, where the gate lets them."""
        kept = self.gate.check(*self.rls.innovation(Y, y, self.sigma)) == 0
        if kept.all():
            self.rls.update(Y, y, self.sigma)

    def tick(self) -> None:
        """Regressor, gates, update."""
        self.gates_and_update(*self.regressor(self.ticks.motion))

    def tick_and_solve(self) -> None:
        """And the estimate with its covariance."""
        self.tick()
        self.rls.solve()

    def instrumental_tick(self) -> None:
        """The same with instruments, to the estimate."""
        t = self.ticks
        Y, y = self.regressor(t.motion)
        self.gates_and_update(Y, y)
        Z, _ = self.regressor(self.predicted.predict(t.time_s, t.q, t.dq, t.ddq, t.motion.rate_rad_s, t.held))
        self.instrumental.add_instruments(self.row_times, Y, y, self.sigma, Z)
        _ = self.instrumental.mean


def c_reference(Y: Floats, y: Floats) -> float:
    """Of the update and the estimate, no covariance."""
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder) / "givens.c", Path(folder) / "givens.so"
        source.write_text(GIVENS, encoding="ascii")
        subprocess.run(["cc", "-O3", "-march=native", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True)
        update = ctypes.CDLL(str(library)).update
        R, rows, x = np.zeros((P, P + 1)), np.column_stack([Y, y]), np.zeros(P)
        np.fill_diagonal(R, 1.0)
        own = rows.copy()
        arguments = (own.ctypes.data_as(ctypes.c_void_p), M, P, x.ctypes.data_as(ctypes.c_void_p))
        triangle = R.ctypes.data_as(ctypes.c_void_p)

        def call() -> None:
            np.copyto(own, rows)
            update(triangle, *arguments)

        return median_us(call)


def peers(model: VehicleModel, ticks: Ticks) -> None:
    """Whole ticks and updates of other programs."""
    textbook = TextbookRegressor(model)
    Y, y = textbook(ticks, 0)
    own, right = Ours(model, ticks).regressor(ticks.motion)
    np.testing.assert_allclose(own[:M], Y, atol=1e-9)
    np.testing.assert_allclose(right[:M], y, atol=1e-9)
    filters = {}
    for kind in (KalmanFilter, SquareRootKalmanFilter):
        one = kind(dim_x=P, dim_z=M)
        one.F, one.R, one.Q = np.eye(P), np.eye(M), np.eye(P) * 1e-12
        filters[kind.__name__] = one
    fading = FadingKalmanFilter(1.001, dim_x=P, dim_z=M)
    fading.F, fading.R, fading.Q = np.eye(P), np.eye(M), np.zeros((P, P))
    filters["FadingKalmanFilter"] = fading

    def kalman(one: KalmanFilter, H: Floats, z: Floats) -> None:
        one.H = H
        one.update(z[:, None])

    def by_rows(adaptive: Any) -> None:
        with np.errstate(all="ignore"):  # it winds up and overflows, at the same pace
            for row, value in zip(Y, y, strict=True):
                adaptive.adapt(value, row)

    print("peers, whole tick")
    line("NumPy textbook regressor", median_us(lambda: textbook(ticks, 0), 20))
    whole = median_us(lambda: kalman(filters["KalmanFilter"], *textbook(ticks, 0)), 20)
    line("NumPy textbook regressor + filterpy KalmanFilter", whole, "(about 500)")
    print("update of 10 parameters by 6 rows alone")
    for name, one in filters.items():
        line(f"filterpy {name}, update", median_us(partial(kalman, one, Y, y)))
    if importlib.util.find_spec("padasip") is None:
        print("  padasip is not installed: pip install 'heft-flight[bench]'")
    else:
        adaptive = importlib.import_module("padasip").filters.FilterRLS(n=P, mu=0.999)
        line("padasip FilterRLS, six single rows", median_us(partial(by_rows, adaptive)))
    many = np.tile(Y, (1000, 1)), np.tile(y, 1000)
    line("numpy lstsq of all rows of 10 s so far", median_us(lambda: np.linalg.lstsq(*many), 3))
    line("C: Givens, estimate, no covariance; by ctypes", c_reference(Y, y))


def ours(model: VehicleModel, rng: np.random.Generator) -> None:
    """The tick alone, and in the batches that a flight's step makes."""
    for n in (1, 5, 25):
        one = Ours(model, Ticks(model, n, rng))
        rows = one.regressor(one.ticks.motion)
        calls = max(200 // n, 10)
        print(f"ours, {n} tick{'s' if n > 1 else ''} at once, per tick")
        line("regressor", median_us(partial(one.regressor, one.ticks.motion), calls) / n)
        line("gates, update", median_us(partial(one.gates_and_update, *rows), calls) / n)
        line("regressor, gates, update", median_us(one.tick, calls) / n, "bar 30")
        line("and estimate with covariance", median_us(one.tick_and_solve, calls) / n)
        line("with instrumental variables, to the estimate", median_us(one.instrumental_tick, calls) / n, "bar 100")
    Y, y = rows[0][:M], rows[1][:M]
    for name, rls in (("growing", SquareRootRls(P)), ("forgetting", SquareRootRls(P, forgetting=0.999))):
        rls.prior(np.zeros(P), PAYLOAD_SIGMA)
        line(f"update alone, {name}", median_us(partial(rls.update, Y, y, np.ones(M))))
    window = RecursiveLeastSquares(P, 0, 0.5, Memory(window_s=20.0))
    window.rls.prior(np.zeros(P), PAYLOAD_SIGMA)
    clock = iter(range(10**9))
    add = median_us(lambda: window.add(np.full(M, next(clock) * 0.01), Y, y, np.ones(M)))
    line("update of a window of 20 s and of its blocks", add)


def all_links(model: VehicleModel, rng: np.random.Generator) -> None:
    """Every link unknown, with joint torques: all base parameters."""
    torques = [joint_torque_row(model, joint.name) for joint in model.joints]
    rows = RowModel(model, [*base_force_rows(model), *base_moment_rows(model), *torques])
    base = base_parameters(rows, rng)
    p, m = len(base.names), len(rows.rows)
    fold = rows.fold(np.eye(len(rows.names))[:, base.independent])
    wide = 83
    print(f"all links free: {p} base parameters of {len(rows.names)}, made up to the bar's {wide}; {m} rows a tick")

    def tick(t: Ticks, rls: SquareRootRls, gate: ResidualGate, extra: Floats) -> None:
        Y = rows.regressor(t.q, t.dq, t.ddq, t.motion, t.held, fold=fold).reshape(-1, p)
        Y, y, sigma = np.concatenate([Y, extra], axis=1), np.zeros(len(Y)), np.ones(len(Y))
        gate.check(*rls.innovation(Y, y, sigma))
        rls.update(Y, y, sigma)

    for n in (1, 5):
        rls = SquareRootRls(wide)
        rls.prior(np.zeros(wide), np.ones(wide))
        call = partial(tick, Ticks(model, n, rng), rls, ResidualGate(1e6), rng.normal(size=(n * m, wide - p)))
        line(f"regressor, gates, update; {n} at once, per tick", median_us(call, 40) / n, "bar 120")


def an_hour(model: VehicleModel, rng: np.random.Generator) -> None:
    """720,000 ticks offline, from kinematics to estimate; then what a million ticks leave behind."""
    chunk = Ours(model, Ticks(model, 600, rng))
    recursion = RecursiveLeastSquares(P, 0, 1.0)
    recursion.rls.prior(np.zeros(P), PAYLOAD_SIGMA)
    start = time.perf_counter()
    for first in range(0, HOUR_TICKS, 600):
        Y, y = chunk.regressor(chunk.ticks.motion)
        recursion.add(np.repeat(first / 200 + np.arange(600) / 200, M), Y, y, chunk.sigma)
    recursion.block_jackknife()
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"one hour at 200 Hz offline: {seconds:.1f} s (bar 20), peak memory of this process {peak:.0f} MB (bar 300)")
    one, before = Ours(model, Ticks(model, 1, rng)), 0
    for tick in range(1_000_000):
        one.tick()
        if tick == 10_000:
            before = _resident_kb()
    print(f"a million ticks one by one: memory grew by {_resident_kb() - before} kB after the first 10,000")


def a_long_window(rng: np.random.Generator) -> None:
    """A million updates through a window, now and then a thousandfold row, against the batch of what is left in it."""
    window = RecursiveLeastSquares(P, 0, 0.5, Memory(window_s=2.0))
    rows = rng.normal(size=(1000, M, P + 1))
    rows[::100] *= 1e3
    before = 0
    for k in range(1_000_000):
        own = rows[k % 1000]
        window.add(np.full(M, k * 0.01), own[:, :P], own[:, P], np.ones(M))
        if k == 10_000:
            before = _resident_kb()
    left = [rows[k % 1000] for k in range(1_000_000) if k * 0.01 // 0.5 >= 999_999 * 0.01 // 0.5 - 4]
    batch = SquareRootRls(P)
    for own in left:
        batch.update(own[:, :P], own[:, P], np.ones(M))
    found, wanted = window.rls.solve(), batch.solve()
    error = np.abs(found.mean / wanted.mean - 1.0).max(), np.abs(found.covariance / wanted.covariance - 1.0).max()
    print(
        f"a window of 2 s after a million updates: within {error[0]:.1e} of the batch, covariance {error[1]:.1e}; "
        f"memory grew by {_resident_kb() - before} kB"
    )


def _resident_kb() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() // 1024


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="without the hour and the million ticks")
    arguments = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}")
    print(f"load average at the start: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    rng, model = np.random.default_rng(1), vehicle()
    ours(model, rng)
    all_links(model, rng)
    peers(model, Ticks(model, 1, rng))
    if not arguments.quick:
        an_hour(model, rng)
        a_long_window(rng)


if __name__ == "__main__":
    main()
