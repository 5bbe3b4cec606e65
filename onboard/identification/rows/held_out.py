"""Prediction of motion that was not used: each half of the rows identified alone, the other half predicted from it.

A fit shows the agreement of rows with parameters chosen for them. Whether the parameters are the body's or
compensate for another error (a flexible joint, a wrong sensor scale) shows on other motion. The rows are kept as normal
equations per block of time, in constant memory, and afterwards divided into an earlier and a later half, separately
with and without the payload.

A half that hardly tells a direction predicts anything along it, which is no error of the parameters. So the misfit of a
prediction is the least of ``left(t) + (t - m)' H (t - m)``, m and H the first half's estimate and information:
``r' (1 + Y H^-1 Y')^-1 r`` of the prediction's residual r (Woodbury's identity).
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray, eigen
from onboard.identification.rows.checks.prediction import HeldOutFit, predicted, reference_of
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.row_blocks import RowBlocks


class HeldOut(NamedTuple):
    """Prediction of each half from the other, and of all rows from all."""

    later: HeldOutFit  # from the earlier half
    earlier: HeldOutFit  # from the later half
    fit: HeldOutFit  # nothing held out: residual of the estimate of all rows

    @property
    def worst(self) -> HeldOutFit:
        """The worse of the two predictions."""
        return max(self.later, self.earlier)


def held_out(identifier: Identifier) -> HeldOut | None:
    """Two-fold cross-validation of its rows by halves of time; None with too few blocks to halve."""
    found = halves(identifier)
    if found is None:
        return None
    earlier, later = found
    # without what an answer by hypotheses gives to errors of instruments, which is in no sum of `predicted`
    everything = identifier.block_jackknife(exact=True).mean
    both = earlier.normal + later.normal
    reference = reference_of(identifier.model, identifier.base, both)
    return HeldOut(
        earlier.predicting(later, reference),
        later.predicting(earlier, reference),
        predicted(both, everything, reference),
    )


class Half(NamedTuple):
    """Half of the rows."""

    normal: FloatArray  # equations with the noise of the regressor in them, (p + 2, p + 2)
    mean: FloatArray  # base parameters by these rows and the prior, (p,)
    information: FloatArray  # of both on these, (p, p)

    def predicting(self, other: "Half", reference: FloatArray) -> HeldOutFit:
        """Prediction error of the other half; ``reference``: as of :func:`predicted`."""
        H, G = self.information, other.information
        moved = np.linalg.solve(H + G, G @ (other.mean - self.mean))
        beyond = predicted(other.normal, self.mean + moved, reference).misfit
        beyond += float(moved @ H @ moved / other.normal[-1, -1])
        return predicted(other.normal, self.mean, reference)._replace(misfit=beyond)


def halves(identifier: Identifier) -> tuple[Half, Half] | None:
    """The earlier and the later half of its rows; None with too few blocks to halve."""
    parts = [_half(identifier.seen, later) for later in (False, True)]
    earlier, later = (None if part is None else Half(part[0], *_solved(*part, identifier)) for part in parts)
    return None if earlier is None or later is None else (earlier, later)


def _half(blocks: RowBlocks, later: bool) -> tuple[FloatArray, FloatArray] | None:
    """Normal equations of a half with the noise of their regressor in them, (p + 2, p + 2), and that noise."""
    found: tuple[FloatArray, FloatArray] | None = None
    for part in blocks.parts:
        own, noise = blocks.of(*part)
        if len(own) < 2:  # cannot be halved
            continue
        rows = np.cumsum(own[:, -1, -1])
        middle = max(1, int(np.searchsorted(rows, 0.5 * rows[-1])))
        mine = slice(middle, None) if later else slice(0, middle)
        sums = own[mine].sum(axis=0), noise[mine].sum(axis=0)
        found = sums if found is None else (found[0] + sums[0], found[1] + sums[1])
    return found


def _solved(normal: FloatArray, noise: FloatArray, identifier: Identifier) -> tuple[FloatArray, FloatArray]:
    """Base parameters of these rows and the prior, (p,), and information, the noise of the regressor taken out of them.

    In units of the prior; a direction whose information is all noise stays at the prior.
    """
    information, right = identifier.taken.rls.prior_equations()
    root = np.linalg.inv(np.linalg.cholesky(information)).T  # prior covariance = root root'
    center = np.linalg.solve(information, right)
    clean = normal - noise
    H = root.T @ clean[:-2, :-2] @ root
    g = root.T @ (clean[:-2, -2] - clean[:-2, :-2] @ center)
    values, vectors = eigen(H)
    told = 1.0 + np.maximum(values, 0.0)
    step = np.where(values > 0.0, vectors.T @ g / told, 0.0)
    unit = np.linalg.solve(root.T, vectors)
    return np.asarray(center + root @ vectors @ step, np.float64), np.asarray(unit * told @ unit.T, np.float64)
