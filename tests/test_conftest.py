"""The shared fixtures: what is seeded, what moves, what is skipped."""

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import SEED, VirtualClock, locate_datasets


def test_every_test_draws_the_same_numbers(rng: np.random.Generator) -> None:
    assert rng.bytes(16) == np.random.default_rng(SEED).bytes(16)


def test_the_clock_moves_when_told_and_never_back(clock: VirtualClock) -> None:
    start_ns = clock()
    assert clock() == start_ns
    assert clock.advance(5_000_000) == clock() == start_ns + 5_000_000
    with pytest.raises(ValueError, match="never goes back"):
        clock.advance(-1)


def test_data_sets_are_those_named_or_those_beside_the_checkout(tmp_path: Path) -> None:
    beside, named = tmp_path / "beside", tmp_path / "named"
    assert locate_datasets(None, beside) is None
    beside.mkdir()
    assert locate_datasets(None, beside) == beside
    assert locate_datasets("", beside) == beside
    with pytest.raises(NotADirectoryError, match="HEFT_DATASETS"):
        locate_datasets(str(named), beside)
    named.mkdir()
    assert locate_datasets(str(named), beside) == named


def test_a_test_that_asks_for_data_is_marked(datasets: Path, request: pytest.FixtureRequest) -> None:
    assert datasets.is_dir()
    assert request.node.get_closest_marker("realdata") is not None
