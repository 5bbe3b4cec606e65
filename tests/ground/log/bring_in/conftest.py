"""A directory with a CSV recording and its mapping."""

import pytest

from tests.ground.log.bring_in.recordings import CSV_MAPPING, CSV_TEXT


@pytest.fixture
def bench(tmp_path):
    (tmp_path / "bench.toml").write_text(CSV_MAPPING)
    (tmp_path / "run.csv").write_text(CSV_TEXT)
    return tmp_path
