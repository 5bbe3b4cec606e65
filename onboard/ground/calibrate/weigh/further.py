"""Which further poses would tell most: where gravity should point in the sensor's axes."""

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from onboard.estimation.arrays import FloatArray
from onboard.estimation.calibration import wrist, wrist_model
from onboard.ground.calibrate.weigh.weigh import Answer, body_gradient

_COUNT = 3
_DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_WORTH = 0.01  # of a sigma: a pose that tells less is not worth turning the wrist


class Pose(NamedTuple):
    """One more pose."""

    down: FloatArray  # (3,) gravity in the sensor's axes, unit
    mass_sigma_kg: float  # with it, and those before
    centre_sigma_m: float  # the largest, with it, and those before

    @property
    def text(self) -> str:
        """``sensor axis -x down``, ``halfway between x and z down``."""
        axes = [f"{'-' if part < 0.0 else ''}{'xyz'[k]}" for k, part in enumerate(self.down) if abs(part) > 1e-9]
        return f"sensor axis {axes[0]} down" if len(axes) == 1 else f"halfway between {' and '.join(axes)} down"


def further(answer: Answer) -> tuple[Pose, ...]:
    """The poses, one after the other, that shrink the sigmas of mass and centre of mass most; none if none does."""
    prior, one = answer.known.prior, answer.weighing.best
    noise = np.hypot(one.noise.sigma, one.noise.walk)
    wide = wrist.prior_sigmas(answer.poses.wrench, prior, one.noise.cross)
    J = wrist_model.jacobian(answer.poses.R, one.state, prior)
    H = np.diag(np.concatenate([wide**-2.0, np.full(6, 1e-12)]))
    H += sum((_information(each, noise) for each in J), np.zeros_like(H))
    G = np.hstack([body_gradient(one.state), np.zeros((4, 6))])
    down = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
    gravity = prior.gravity_m_s2 / np.linalg.norm(prior.gravity_m_s2)
    R = np.array([_turn(one.state.mounting.T @ each, gravity) for each in down])
    more = [_information(each, noise) for each in wrist_model.jacobian(R, one.state, prior)]
    before, found = _volume(H, G), list[Pose]()
    for _ in range(_COUNT):
        volumes = [_volume(H + each, G) for each in more]
        best = int(np.argmin(volumes))
        if before - volumes[best] < 8.0 * _WORTH:  # of four sigmas, squared
            break
        H, before = H + more[best], volumes[best]
        sigma = np.sqrt(np.diag(G @ _inverse(H) @ G.T))
        found.append(Pose(down[best], float(sigma[0]), float(sigma[1:].max())))
    return tuple(found)


def _turn(own: FloatArray, down: FloatArray) -> FloatArray:
    """A rotation that turns ``own`` to ``down``."""
    return Rotation.align_vectors(down[None], own[None])[0].as_matrix()


def _information(J: FloatArray, noise: FloatArray) -> FloatArray:
    """Of one pose on the unknowns and the zeros."""
    rows = np.hstack([J, np.eye(6)]) / noise[:, None]
    return np.asarray(rows.T @ rows, np.float64)


def _inverse(H: FloatArray) -> FloatArray:
    unit = 1.0 / np.sqrt(np.diag(H))
    return np.asarray(np.linalg.inv(H * np.outer(unit, unit)) * np.outer(unit, unit), np.float64)


def _volume(H: FloatArray, G: FloatArray) -> float:
    """Sum of the logarithms of the variances of mass and centre."""
    return float(np.log(np.diag(G @ _inverse(H) @ G.T)).sum())
