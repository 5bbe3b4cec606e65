"""A run on a table, flown once for each file of tests."""

import pytest

from tests.identification.table.bed_run import Run, fly


@pytest.fixture(scope="module")
def run() -> Run:
    return fly(0.6)
