import pytest

from tests.recording.logs import write_small


@pytest.fixture
def small(tmp_path):
    """The small log of :mod:`tests.recording.logs`."""
    return write_small(tmp_path / "small.mcap")
