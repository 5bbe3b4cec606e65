"""A recording that several tests weigh."""

import pytest

from tests.ground.calibrate.weigh.wrist_bench import record


@pytest.fixture(scope="session")
def one():
    return record(6)
