"""A recording that several tests weigh, and what leaves out the rivals of its fit."""

import numpy as np
import pytest

from onboard.estimation.calibration import wrist
from onboard.ground.calibrate.weigh import weigh
from tests.ground.calibrate.weigh.wrist_bench import record


@pytest.fixture(scope="session")
def one():
    return record(6)


@pytest.fixture
def axes_as_they_are(monkeypatch):
    """One fit of each meaning of a table; none of axes turned or exchanged, none of other scales."""

    def alone(R, _wrench, _prior, first):
        return wrist.Weighing(first, np.ones(1), (first,), 6.0 * (len(R) - 1) - 9.0, np.ones((1, 6)))

    monkeypatch.setattr(weigh, "_wrong_axes", lambda *_: None)
    monkeypatch.setattr(wrist, "weigh", alone)
