"""Every error the estimators raise on purpose."""

import numpy as np


class EstimationError(Exception):
    """Base of them all. The message is a sentence that ends with the remedy."""


class RowError(EstimationError, ValueError):
    """Rows, priors or signals that cannot be used: a wrong shape, not finite, or a sigma that is not positive."""


class SingularError(EstimationError, np.linalg.LinAlgError):
    """The rows so far do not determine every parameter, and no prior stands in for those they do not."""


class ConvergenceError(EstimationError, ArithmeticError):
    """An iteration that did not arrive."""
