"""``heft identify --predict``: prediction of another log of the vehicle with the base parameters of the first log."""

from pathlib import Path

import numpy as np

from onboard import config
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.identify.kinds.identified import Identified
from onboard.ground.identify.replay.feed import feed_rows
from onboard.identification.rows.checks.prediction import HeldOutFit, prediction
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader


def predict(vehicle: config.Vehicle, found: Identified, other: Path) -> HeldOutFit:
    """How well the base parameters of one log explain the rows of another.

    Args:
        vehicle: of both; by rows.
        found: identification of the first log.
        other: log to predict; its rows are not used for the parameters.

    Raises:
        LogFormatError: a file that is no log.
        ChannelError: a log of another vehicle, or one without a row that could be used.
        ConfigError: the vehicle's method has no rows.
    """
    estimator = Estimator(vehicle, at_the_end=True)
    for _ in feed_rows(estimator, LogReader(other)):
        pass
    who = estimator.identifier
    values = {answer.name: answer.value for answer in found.answers}
    if not who.rows_used or not values:
        which = other if values else found.log
        raise ChannelError(f"{which} has no row that could be used; heft identify says why")
    return prediction(who.seen, who.model, who.base, np.array([values[name] for name in who.base.names]))
