"""Normal equations of parts of a flight, by instrument; a fit (:mod:`~onboard.identification.whole_flight.fit`)."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.payload import BodyEstimate
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import Fit, Normal
from onboard.estimation.policy import MISFIT_REFUSED
from onboard.identification.free_flyer.innovation import beyond_chance
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded, NoiseCorrection
from onboard.identification.free_flyer.prediction.ticks import TickPrediction
from onboard.identification.windows import summed

INSTRUMENTS = ("gyro", "accelerometer")  # of the first IMU
_PATIENCE = 6  # predictions by whose gain the rest is judged


class Instrument(NamedTuple):
    """Lines whose residuals are judged together."""

    name: str
    device: int  # its number among the predictor's instruments, 0: the first IMU
    lines: slice


def instruments_of(predictor: ImuPredictor) -> list[Instrument]:
    """Gyro and accelerometer of the first IMU, and the further ones."""
    first = [Instrument(name, 0, slice(3 * k, 3 * k + 3)) for k, name in enumerate(INSTRUMENTS)]
    further = zip(predictor.further, predictor.lines[1:], strict=True)
    return [*first, *(Instrument(one.name, device, own) for device, (one, own) in enumerate(further, 1))]


class Along(NamedTuple):
    """Prediction of b ticks of a segment."""

    ticks: slice
    values: FloatArray  # (b, lines)
    predicted: TickPrediction  # without the biases
    state: FloatArray  # (predictor's p,) there
    d_rate: FloatArray  # (3, predictor's p) of the rate there by the state at the segment's start
    lines: FloatArray  # (b, 2 + kinks)


class BlockNoise(NamedTuple):
    """What noise of the joints' samples adds to a block, at an estimate."""

    of_constants: NoiseAdded  # of the predictor, (c,)
    by_x: FloatArray  # (c, p) these by the parameters

    def at(self, by: FloatArray) -> FloatArray:
        """To the gradient at parameters that are so far from the estimate, (p,)."""
        gradient, information = self.of_constants[:2]
        return np.asarray((gradient + information @ (self.by_x @ by)) @ self.by_x, np.float64)


def sum_of(noise: Sequence[BlockNoise], parameters: int, instruments: int) -> NoiseAdded:
    """What noise adds to all blocks together, of so many instruments."""
    found = NoiseAdded(np.zeros(parameters), np.zeros((parameters, parameters)))
    for of_constants, by_x in noise:
        found.gradient[:] += of_constants.gradient @ by_x
        found.information[:] += by_x.T @ of_constants.information @ by_x
    scatter, ticks = sum(one.of_constants.scatter for one in noise), sum(one.of_constants.ticks for one in noise)
    return found._replace(scatter=scatter, ticks=-(-ticks // instruments))


class NormalEquations(NamedTuple):
    """Normal equations of some ticks of one instrument at an estimate."""

    normal: Normal  # by the parameters in ``columns``
    columns: IndexArray
    rows: int
    instrument: str
    held: bool
    middle_s: float
    noise: FloatArray  # (k,) of the joints' samples: the gradient is without what it added

    def without(self, noise: FloatArray) -> "NormalEquations":
        """Without what noise of the joints' samples added to the gradient, (p,), in place of what it is without now."""
        own, normal = noise[self.columns], self.normal
        gradient = normal.gradient + self.noise - own
        return self._replace(normal=Normal(normal.information, gradient, normal.squares), noise=own)

    def moved(self, by: FloatArray) -> "NormalEquations":
        """At parameters that are so far from the estimate, (p,), as the normal equations tell it."""
        d, normal = by[self.columns], self.normal
        change = normal.information @ d
        squares = normal.squares + float(d @ (2.0 * normal.gradient + change))
        return self._replace(normal=Normal(normal.information, normal.gradient + change, max(0.0, squares)))


class FlightFit(NamedTuple):
    """The maximum likelihood estimate of a whole flight."""

    payload: BodyEstimate  # in the payload link's frame
    fit: Fit
    names: tuple[str, ...]  # of the parameters fitted
    chi: FloatArray  # (10,) standard parameters of the payload
    chi_covariance: FloatArray  # (10, 10)
    correction: NoiseCorrection  # of all parameters, for noise of the joints, which is in them
    blocks: tuple[NormalEquations, ...]  # at the estimate
    misfit: float  # residual sum over its degrees of freedom
    by_instrument: dict[str, float]  # the same of each instrument: the larger of all its rows and its worst part
    residuals: FloatArray  # (n, lines) whitened, predicted less measured, of all segments; NaN where not used
    glitches: int  # lines left out
    outer: FloatArray | None = None  # (2, 10) ends of 99.9 % intervals of the payload's numbers about their means


def total_of(blocks: Sequence[NormalEquations], parameters: int) -> Normal:
    """Normal equations of all blocks together."""
    return summed(((block.columns, block.normal) for block in blocks), parameters)


def misfit_by_instrument(blocks: Sequence[NormalEquations]) -> dict[str, float]:
    """Residual sum over the number of rows, of all rows or of the part in which it is largest beyond chance."""
    misfit = {}
    for instrument in dict.fromkeys(block.instrument for block in blocks):
        sums = [(block.normal.squares, block.rows) for block in blocks if block.instrument == instrument and block.rows]
        mean = sum(squares for squares, _ in sums) / max(1, sum(rows for _, rows in sums))
        misfit[instrument] = max([mean, *(beyond_chance(*of) for of in sums)])
    return misfit


def apart(effect: FloatArray, stretch: IndexArray) -> Callable[[FloatArray], FloatArray]:
    """Multiplication of rows, (u, k), by ``(1 + d d')^(-1/2)``, d the effect, (u,), in each stretch of them."""
    count = int(stretch[-1]) + 1
    squares = np.bincount(stretch, effect**2, count)
    share = np.where(squares > 0.0, (1.0 - (1.0 + squares) ** -0.5) / np.maximum(squares, 1e-300), 0.0)
    there, starts = np.unique(stretch, return_index=True)

    def apply(rows: FloatArray) -> FloatArray:
        moved, along = effect[:, None] * rows, np.zeros((count, rows.shape[1]))
        along[there] = np.add.reduceat(moved, starts)
        along *= share[:, None]
        np.multiply(effect[:, None], along[stretch], out=moved)
        return np.subtract(rows, moved, out=moved)

    return apply


def give_up(bests: Sequence[float], rows: int, evaluations: int) -> None:
    """Stop a fit that will not come near the readings if it goes on as in the last predictions.

    Args:
        bests: the least residual sum after each prediction.
        rows: number of residuals.
        evaluations: predictions, at most.

    Raises:
        ConvergenceError: it is such a fit.
    """
    misfit = bests[-1] / max(rows, 1)
    if len(bests) <= _PATIENCE or misfit < MISFIT_REFUSED:
        return
    gain = bests[-1] / bests[-1 - _PATIENCE]
    if misfit * gain ** ((evaluations - len(bests)) / _PATIENCE) > MISFIT_REFUSED:
        said = f"residuals stay at {misfit**0.5:.3g} times the noise"
        raise ConvergenceError(f"no payload explains the readings: {said}; check ranges, axes and clocks of all")
