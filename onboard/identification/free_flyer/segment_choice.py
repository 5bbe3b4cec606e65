"""Which motion to fly next: the one after which the weakest of what is asked is known best, for its time.

With P the covariance of all unknowns now and H the whitened derivatives of the readings along a segment, the
covariance afterwards is ``P - P H' (I + H P H')^-1 H P``; only its payload block is computed, so that what biases,
links and joints take away is taken away.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from onboard.estimation.arrays import FloatArray, IndexArray, eigen
from onboard.estimation.policy import AGAIN
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD

REPEATED = 100.0  # times that each motion is repeated, for what is left in the end
LEAST = (AGAIN - 1.0) / REPEATED  # information that counts then, in units of what is known before the flight


class Asked(NamedTuple):
    """What is asked of the payload."""

    jacobian: FloatArray  # (a, 10) of the asked quantities by the standard parameters
    targets: FloatArray  # (a,) standard deviations that are enough, in the units of the quantities

    def ratio(self, covariance: FloatArray) -> float:
        """The weakest direction's standard deviation over what is enough, of the payload's covariance (10, 10)."""
        scaled = self.jacobian / self.targets[:, None]
        return float(np.sqrt(max(np.linalg.eigvalsh(scaled @ covariance @ scaled.T)[-1], 0.0)))


class Choice(NamedTuple):
    """The motion chosen."""

    segment: int
    ratio: float  # of the weakest asked direction afterwards


def after(covariance: FloatArray, root: FloatArray) -> FloatArray:
    """Covariance of the payload after a motion, (10, 10).

    Args:
        covariance: of all unknowns before, (p, p).
        root: whitened derivatives, (r, p).
    """
    HP = root @ covariance
    S = HP @ root.T
    S[np.diag_indices_from(S)] += 1.0
    L = np.linalg.cholesky(S)
    G = solve_triangular(L, HP[:, PAYLOAD], lower=True, check_finite=False)
    return np.asarray(covariance[PAYLOAD, PAYLOAD] - G.T @ G, np.float64)


def choose(
    covariance: FloatArray, roots: Sequence[FloatArray], durations_s: FloatArray, asked: Asked, allowed: IndexArray
) -> Choice:
    """The allowed segment that shrinks the weakest asked direction most in its time.

    Args:
        covariance: of all unknowns, (p, p).
        roots: of each segment, (r, p) each.
        durations_s: of each.
        asked: what is wanted.
        allowed: segments that limits allow; one at least.
    """
    now = asked.ratio(covariance[PAYLOAD, PAYLOAD])
    found = [Choice(int(k), asked.ratio(after(covariance, roots[k]))) for k in allowed]
    return max(found, key=lambda one: np.log(max(now, 1e-300) / max(one.ratio, 1e-300)) / durations_s[one.segment])


def reduced(whitened: FloatArray, sigma: FloatArray) -> FloatArray:
    """Whitened derivatives, (r, p), in as few rows as say more than is known before the flight.

    Args:
        whitened: of all readings, (readings, p).
        sigma: of the unknowns before the flight, (p,).
    """
    scaled = whitened * sigma
    values, vectors = eigen(scaled.T @ scaled)
    kept = values > LEAST
    return np.asarray(np.sqrt(values[kept])[:, None] * vectors[:, kept].T / sigma, np.float64)


def in_the_end(covariance: FloatArray, roots: Sequence[FloatArray], repeated: IndexArray) -> FloatArray:
    """Covariance of all unknowns, (p, p), after many repetitions of the given segments."""
    scale = np.sqrt(np.diag(covariance))
    information = np.linalg.inv(covariance / np.outer(scale, scale))
    for k in repeated:
        root = roots[k] * scale
        information += REPEATED * root.T @ root
    found = cho_solve(cho_factor(0.5 * (information + information.T)), np.eye(len(covariance)))
    return np.asarray(found * np.outer(scale, scale), np.float64)


def shares(covariance: FloatArray, asked: Asked, names: Sequence[str]) -> list[tuple[str, float]]:
    """Unknowns beside the payload, in words, and how much of the weakest direction's variance each would take away.

    Args:
        covariance: of all unknowns, (p, p).
        asked: what is wanted.
        names: of the unknowns.

    Returns:
        Falling. If a group of unknowns were known exactly, its share would be gone; shares overlap.
    """
    scaled = asked.jacobian / asked.targets[:, None]
    values, vectors = eigen(scaled @ covariance[PAYLOAD, PAYLOAD] @ scaled.T)
    with_each = vectors[:, -1] @ scaled @ covariance[PAYLOAD]
    groups: dict[str, list[int]] = {}
    for k in range(PAYLOAD.stop, len(names)):
        groups.setdefault(_in_words(names[k]), []).append(k)
    found = []
    for name, own in groups.items():
        taken = with_each[own] @ np.linalg.solve(covariance[np.ix_(own, own)], with_each[own])
        found.append((name, float(taken / values[-1])))
    return sorted(found, key=lambda one: -one[1])


def _in_words(name: str) -> str:
    """What an unknown is of: all three axes of an error, all of a link's tolerances, are one."""
    if of_link := re.fullmatch(r"(.+)_inertial_\d+", name):
        return f"tolerances of {of_link[1]}"
    if of_gear := re.fullmatch(r"cyclic_\d+_(?:cos|sin)_(.+)", name):
        return f"cyclic errors of {of_gear[1]}"
    return re.sub(r"_[xyz](?=_|$)", "", name, count=1)
