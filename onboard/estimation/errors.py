"""Error tree of the estimators."""

import numpy as np


class EstimationError(Exception):
    """Base of all estimation errors. The message ends with the remedy."""


class RowError(EstimationError, ValueError):
    """Rows, priors or signals that cannot be used: a wrong shape, not finite, or a sigma that is not positive."""


class SingularError(EstimationError, np.linalg.LinAlgError):
    """Rows and prior do not determine every parameter."""


class ConvergenceError(EstimationError, ArithmeticError):
    """An iteration that did not converge."""


class CalibrationError(EstimationError, ValueError):
    """A calibration run that does not determine what it should, or contradicts itself; it says what to repeat."""
