"""Error of rows predicted with given base parameters, from their normal equations."""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import RowModel


class HeldOutFit(NamedTuple):
    """Prediction error of one half with parameters of the other."""

    relative_error: float  # weighted norm of the residual over that of the measured side
    misfit: float  # whitened residual sum over the number of rows; of a half, beyond what the other leaves open


def prediction(blocks: RowBlocks, model: RowModel, base: BaseParameters, mean: FloatArray) -> HeldOutFit:
    """Prediction error of all these rows with given base parameters (p,); ``model`` made the rows."""
    normal = blocks.total()
    return predicted(normal, mean, reference_of(model, base, normal))


def predicted(normal: FloatArray, mean: FloatArray, reference: FloatArray) -> HeldOutFit:
    """How far rows are from their prediction.

    Args:
        normal: sums of ``[Y, y, 1]`` over the rows, whitened, (p + 2, p + 2).
        mean: base parameters, (p,).
        reference: base parameters by :func:`reference_of`, (p,).
    """
    left, whole = _residual_sum(normal, mean), _residual_sum(normal, reference)
    return HeldOutFit(float(np.sqrt(left / whole)), left / float(normal[-1, -1]))


def reference_of(model: RowModel, base: BaseParameters, normal: FloatArray) -> FloatArray:
    """Base parameters (p,) whose residual is what an error is compared with: zeros, for what was measured itself.

    Where all rows are of wrenches that are zero, nothing was measured; an error is compared with what the unknown body
    takes part in: the residual of the vehicle as drawn without the payload, or without its base if it has no payload.
    """
    return np.zeros(len(base.names)) if normal[-2, -2] > 0.0 else without_unknown(model, base)


def without_unknown(model: RowModel, base: BaseParameters) -> FloatArray:
    """Base parameters of the vehicle as drawn without the payload, or without its base if it has no payload, (p,)."""
    vehicle, chi = model.vehicle, model.chi.copy()
    unknown = vehicle.payload_columns()
    if unknown.stop == 0:
        unknown = slice(*(10 * vehicle.links.index(vehicle.base_body()) + np.array([0, 10])))
    chi[unknown] = 0.0
    return base.value(chi)


def _residual_sum(normal: FloatArray, mean: FloatArray) -> float:
    v = np.concatenate([mean, [-1.0, 0.0]])
    return max(float(v @ normal @ v), 0.0)
