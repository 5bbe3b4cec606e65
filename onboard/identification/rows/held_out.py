"""Prediction of motion that was not used: each half of the rows identified alone, the other half predicted from it.

A fit shows the agreement of rows with parameters chosen for them. Whether the parameters are the body's own or
compensate for another error (a flexible joint, a wrong sensor scale) shows on other motion. The rows are kept as normal
equations per block of time, in constant memory, and afterwards divided into an earlier and a later half, separately
with and without the payload.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.consistency import BlockScores
from onboard.identification.rows.identifier import Identifier

_FEWEST_BLOCKS = 2  # of a kind of rows; fewer cannot be halved


class HeldOutFit(NamedTuple):
    """Prediction error of one half with parameters of the other."""

    relative_error: float  # weighted norm of the residual over that of the measured side
    misfit: float  # whitened residual sum over the number of rows


class HeldOut(NamedTuple):
    """Prediction of each half from the other, and of all rows from all."""

    later: HeldOutFit  # from the earlier half
    earlier: HeldOutFit  # from the later half
    fit: HeldOutFit  # nothing held out: residual of the estimate of all rows

    @property
    def worst(self) -> HeldOutFit:
        """The worse of the two predictions."""
        return max(self.later, self.earlier)


class RowBlocks:
    """Collects the rows that an identifier uses, as its ``observer``.

    Args:
        parameters: p.
        block_s: first length of a block.
    """

    def __init__(self, parameters: int, block_s: float) -> None:
        self._blocks = {held: BlockScores(parameters + 2, block_s) for held in (True, False)}

    def __call__(
        self,
        times_s: FloatArray,
        held: BoolArray,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        noise: FloatArray | None,
    ) -> None:
        """Takes rows in; see :class:`onboard.identification.rows.identifier.RowObserver`."""
        rows = np.column_stack([Y, y, sigma])  # whitened, the last is one: it counts
        wider = None if noise is None else np.pad(noise, ((0, 0), (0, 0), (0, rows.shape[1] - noise.shape[2])))
        for kind, blocks in self._blocks.items():
            mine = held == kind
            own = None if wider is None else wider[mine]
            blocks.add(times_s[mine], rows[mine], np.zeros(int(mine.sum())), sigma[mine], own)

    def held_out(self, identifier: Identifier) -> HeldOut | None:
        """The predictions; None where there is not enough to be halved.

        Args:
            identifier: that used the rows: its prior, and its estimate of all of them.
        """
        halves = [self._half(later) for later in (False, True)]
        if any(half is None for half in halves):
            return None
        (earlier, early_noise), (later, late_noise) = (half for half in halves if half is not None)
        reference = _without_the_unknown(identifier) if later[-2, -2] + earlier[-2, -2] == 0.0 else None
        first, second = (_solved(*half, identifier) for half in ((earlier, early_noise), (later, late_noise)))
        everything = identifier.block_jackknife().mean
        return HeldOut(
            _prediction(later, first, reference),
            _prediction(earlier, second, reference),
            _prediction(earlier + later, everything, reference),
        )

    def prediction(self, identifier: Identifier, mean: FloatArray) -> HeldOutFit:
        """What base parameters from elsewhere, (p,), leave of all these rows; ``identifier`` used them."""
        everything = sum(blocks.normal.sum(axis=0) + blocks.noise for blocks in self._blocks.values())
        normal = np.asarray(everything, np.float64)
        return _prediction(normal, mean, _without_the_unknown(identifier) if normal[-2, -2] == 0.0 else None)

    def _half(self, later: bool) -> tuple[FloatArray, FloatArray] | None:
        """Normal equations of a half with the noise of their regressor in them, (p + 2, p + 2), and that noise."""
        size = next(iter(self._blocks.values())).noise.shape[0]
        total, noise = np.zeros((size, size)), np.zeros((size, size))
        cut = 0
        for blocks in self._blocks.values():
            if blocks.count < _FEWEST_BLOCKS:
                continue
            N = blocks.noise_by_block
            own = blocks.normal + N
            rows = np.cumsum(own[:, -1, -1])
            middle = max(1, int(np.searchsorted(rows, 0.5 * rows[-1])))
            part = slice(middle, None) if later else slice(0, middle)
            total, noise, cut = total + own[part].sum(axis=0), noise + N[part].sum(axis=0), cut + 1
        return (total, noise) if cut else None


def _solved(normal: FloatArray, noise: FloatArray, identifier: Identifier) -> FloatArray:
    """Base parameters of these rows and the prior, (p,), the noise of the regressor taken out of the rows.

    In units of the prior; a direction whose information is all noise stays at the prior.
    """
    information, right = identifier.rls.prior_equations()
    root = np.linalg.inv(np.linalg.cholesky(information)).T  # prior covariance = root root'
    center = np.linalg.solve(information, right)
    clean = normal - noise
    H = root.T @ clean[:-2, :-2] @ root
    g = root.T @ (clean[:-2, -2] - clean[:-2, :-2] @ center)
    values, vectors = np.linalg.eigh(H)
    step = np.where(values > 0.0, vectors.T @ g / (1.0 + np.maximum(values, 0.0)), 0.0)
    return np.asarray(center + root @ vectors @ step, np.float64)


def _prediction(normal: FloatArray, chi: FloatArray, reference: FloatArray | None) -> HeldOutFit:
    left = _residual_sum(normal, chi)
    whole = _residual_sum(normal, np.zeros_like(chi) if reference is None else reference)
    return HeldOutFit(float(np.sqrt(left / whole)), left / float(normal[-1, -1]))


def _residual_sum(normal: FloatArray, chi: FloatArray) -> float:
    v = np.concatenate([chi, [-1.0, 0.0]])
    return max(float(v @ normal @ v), 0.0)


def _without_the_unknown(identifier: Identifier) -> FloatArray:
    """Base parameters of the vehicle as drawn without the payload, or without its base where it has no payload.

    Where all rows are of wrenches that are zero, there is nothing measured to compare an error with; it is compared
    with what the unknown body takes part in.
    """
    model = identifier.model
    vehicle, chi = model.vehicle, model.chi.copy()
    unknown = vehicle.payload_columns()
    if unknown.stop == 0:
        unknown = slice(*(10 * vehicle.links.index(vehicle.spec.base_link) + np.array([0, 10])))
    chi[unknown] = 0.0
    return identifier.base.value(chi)
