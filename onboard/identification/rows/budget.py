"""What the width of each answer by rows is made of, largest first."""

from collections.abc import Mapping

import numpy as np

from onboard.identification.quantities import Contribution, by_size
from onboard.identification.rows.identifier import Identifier

ROWS = "scatter of the rows: noise, gears, what the model leaves"
STATED = "prior: what is stated of bodies, friction and offsets"
REGRESSOR = "noise_rad of the angles: how well the noise of the motion is known"


def budget(identifier: Identifier) -> Mapping[str, tuple[Contribution, ...]]:
    """Contributions to the sigma of each quantity, by its name; empty for one without a value."""
    jackknife, names = identifier.block_jackknife(), identifier.quantity_names
    weights = [quantity.weights for quantity in identifier.quantities]
    if identifier.payload is not None:
        weights += list(identifier.payload.weights(jackknife))
    if not weights:
        return {}
    w = np.vstack(weights)
    if (by := identifier.by_errors) is not None:
        sigma = jackknife.combination(w).sigma
        return dict(zip(names, by.causes.budget(by.causes.effects(w @ by.along), sigma), strict=True))
    parts = dict(zip((ROWS, STATED, REGRESSOR), jackknife.parts(w), strict=True))
    causes = jackknife.causes(w)
    for cause, effect in zip(identifier.considered, causes.T, strict=True):
        parts[cause.key or cause.name] = np.hypot(parts.get(cause.key or cause.name, 0.0), effect)
    for fit in identifier.fits():
        for tested, what in ((fit.step, "a step"), (fit.gain, "an error")):
            if tested is not None:
                parts[f"{fit.instrument}: {what} of its gain"] = np.abs(w @ tested.suspected)
    return {name: by_size({cause: float(one[k]) for cause, one in parts.items()}) for k, name in enumerate(names)}
