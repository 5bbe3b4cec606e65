"""The search of ``heft plan`` beside constrained solvers: the same starts, the same number of steps.

    python -m bench.plan_solvers [--vehicle dymaflex] [--seconds 12] [--rate 0.4] [--starts 3] [--iterations 15]

Solvers: scipy's SLSQP with limits as constraints, which ``heft plan`` uses; IPOPT with the same constraints; IPOPT and
scipy's L-BFGS-B with limits as penalties. IPOPT (by CasADi, ``pip install casadi``) approximates its Hessian from
gradients (limited memory). All derivatives are the same forward differences. Each result is shrunk until it keeps all
limits on fine ticks, as ``heft plan`` does.

Printed for each start: the cost (mean log of the expected sigmas over the quantities' sizes; 0.1 less: sigmas 10 %
narrower), evaluations and processor time; then the median of each over that of ``heft plan``.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import minimize

from bench.motions import bench_of
from onboard import config
from onboard.estimation.arrays import FloatArray
from onboard.ground.before.planning.criteria import Criterion
from onboard.ground.before.planning.planning import PIECE_s
from onboard.ground.before.planning.search import Problem, Search, descend
from onboard.ground.before.planning.splines import Splines

STEP = 1e-4  # of the way to a joint's limit, as in the search
PENALTY = 100.0  # times the mean square excess of each limit
Solver = Callable[[Problem, FloatArray, int], FloatArray]


class Penalised:
    """Cost and a penalty for broken limits in place of constraints."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    def value(self, x: FloatArray) -> float:
        """Cost with penalty."""
        return float(self.values(x)[0])

    def values(self, x: FloatArray) -> FloatArray:
        """The same, (1,)."""
        own, excess = self._problem.cost_and_excess(x)
        return np.array([own + PENALTY * float(np.mean(np.maximum(excess, 0.0) ** 2, axis=0).sum())])

    def slopes(self, x: FloatArray) -> FloatArray:
        """Its derivatives by forward differences, (1, n)."""
        here, columns = self.values(x), []
        for k in range(len(x)):
            step = STEP if x[k] + STEP <= self._problem.high[k] else -STEP
            moved = x.copy()
            moved[k] += step
            columns.append((self.values(moved) - here) / step)
        return np.stack(columns, axis=1)


def l_bfgs_b(problem: Problem, x: FloatArray, iterations: int) -> FloatArray:
    """Scipy's L-BFGS-B with the penalty."""
    own = Penalised(problem)
    how: Any = {
        "jac": lambda at: own.slopes(at)[0],
        "method": "L-BFGS-B",
        "bounds": list(zip(problem.low.tolist(), problem.high.tolist(), strict=True)),
        "options": {"maxiter": iterations, "maxfun": 10**9},
    }
    return np.asarray(minimize(own.value, x, **how).x, np.float64)


def planned(problem: Problem, x: FloatArray, iterations: int) -> FloatArray:
    """As ``heft plan``."""
    return descend(problem, x, iterations, lambda _: None)


def ipopt(problem: Problem, x: FloatArray, iterations: int) -> FloatArray:
    """IPOPT with constraints."""
    return by_casadi(problem, problem, x, iterations)


def ipopt_penalised(problem: Problem, x: FloatArray, iterations: int) -> FloatArray:
    """IPOPT with the penalty."""
    return by_casadi(problem, Penalised(problem), x, iterations)


def by_casadi(problem: Problem, own: Problem | Penalised, x: FloatArray, iterations: int) -> FloatArray:  # noqa: C901
    """IPOPT by CasADi: the first of ``own.values`` is the cost, the others constraints."""
    import casadi  # noqa: PLC0415 - of this bench alone

    size, rows = len(x), len(own.values(x))
    dense = casadi.Sparsity.dense

    class Slopes(casadi.Callback):  # type: ignore[misc]
        def __init__(self, name: str, names_in: list[str], names_out: list[str], options: dict[str, Any]) -> None:
            casadi.Callback.__init__(self)
            self._names = names_in, names_out
            self.construct(name, options)

        def get_n_in(self) -> int:
            return len(self._names[0])

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, k: int) -> str:
            return self._names[0][k]

        def get_name_out(self, k: int) -> str:
            return self._names[1][k]

        def get_sparsity_in(self, k: int) -> Any:
            return dense((size, rows)[k], 1)

        def get_sparsity_out(self, k: int) -> Any:
            del k
            return dense(rows, size)

        def eval(self, given: Any) -> list[Any]:
            return [casadi.DM(own.slopes(given[0].full().ravel()))]

    class Values(casadi.Callback):  # type: ignore[misc]
        def __init__(self) -> None:
            casadi.Callback.__init__(self)
            self.construct("values", {})

        def get_n_in(self) -> int:
            return 1

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, k: int) -> Any:
            del k
            return dense(size, 1)

        def get_sparsity_out(self, k: int) -> Any:
            del k
            return dense(rows, 1)

        def eval(self, given: Any) -> list[Any]:
            return [casadi.DM(own.values(given[0].full().ravel()))]

        def has_jacobian(self) -> bool:
            return True

        def get_jacobian(self, name: str, names_in: list[str], names_out: list[str], options: dict[str, Any]) -> Any:
            self._slopes = Slopes(name, names_in, names_out, options)
            return self._slopes

    values, at = Values(), casadi.MX.sym("x", size)
    made = values(at)
    options = {
        "ipopt.hessian_approximation": "limited-memory",
        "ipopt.max_iter": iterations,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": False,
    }
    solver = casadi.nlpsol("solver", "ipopt", {"x": at, "f": made[0], "g": made[1:]}, options)
    found = solver(x0=x, lbx=problem.low, ubx=problem.high, lbg=-np.inf, ubg=0.0)
    return np.clip(np.asarray(found["x"].full(), np.float64).ravel(), problem.low, problem.high)


PLAN = "SLSQP, constraints"
SOLVERS: dict[str, Solver] = {
    PLAN: planned,
    "IPOPT, constraints": ipopt,
    "IPOPT, penalty": ipopt_penalised,
    "L-BFGS-B, penalty": l_bfgs_b,
}


def main() -> None:
    """Compare, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", default="dymaflex", help="packaged, or a vehicle.toml of a free base")
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--rate", type=float, default=0.4, help="limit of the base's rate, rad/s")
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--iterations", type=int, default=15)
    parser.add_argument("--criterion", type=Criterion, choices=list(Criterion), default=Criterion.D)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    own = bench_of(config.named(asked.vehicle), None, 5.0, asked.seconds, asked.rate)
    splines = Splines(own.posture, asked.seconds, max(6, round(asked.seconds / PIECE_s)))
    problem = Problem(Search(own.bound, own.limits, splines, tuple(range(10)), asked.criterion))
    rng = np.random.default_rng(asked.seed)
    results: dict[str, list[tuple[float, int, float]]] = {name: [] for name in SOLVERS}
    for start in range(asked.starts):
        drawn = min((problem.kept(problem.draw(rng), coarse=True) for _ in range(16)), key=problem.value)
        print(f"start {start + 1}: cost {problem.value(drawn):.3f}, {len(drawn)} coefficients", flush=True)
        for name, solve in SOLVERS.items():
            before, began_s = problem.evaluations, time.process_time()
            kept = problem.kept(solve(problem, drawn, asked.iterations))
            took_s = time.process_time() - began_s
            looked_at = problem.evaluations - before
            results[name].append((problem.value(kept), looked_at, took_s))
            print(f"  {name:20} {problem.value(kept):8.3f} {looked_at:6d} {took_s:7.1f} s", flush=True)
    base = np.array(results[PLAN])
    for name, rows in results.items():
        less = np.median(np.array(rows)[:, 0] - base[:, 0])
        dearer = np.median(np.array(rows)[:, 1:] / base[:, 1:], axis=0)
        print(f"{name:20} cost {less:+.3f}, evaluations x {dearer[0]:.2f}, processor time x {dearer[1]:.2f}")


if __name__ == "__main__":
    main()
