"""What every room's tests share: a seeded generator, a clock that the test advances, the recorded data sets."""

import gc
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy loads: results do not hang on the core count

import shutil
import signal
from pathlib import Path

import hypothesis
import numpy as np
import pytest

from onboard.native import library

SEED = 20190812  # the day RockSat-X 2019 flew
DATASETS_BESIDE_THE_CHECKOUT = Path(__file__).resolve().parents[2] / "shared" / "datasets"

gc.disable()  # while tests are collected nothing dies, and looking for it is a quarter of the time

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # of a shell's background, and what a test starts inherits it
    signal.signal(signal.SIGINT, signal.default_int_handler)

hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None)
hypothesis.settings.load_profile("repeatable")


def with_library(cache: Path) -> Path:
    """A cache with the compiled core in it: processes of tests do not compile it again, 4 s each."""
    (cache / "heft").mkdir(mode=0o700)
    shutil.copy(library.LIBRARY._name, cache / "heft")
    return cache


@pytest.fixture(scope="session", autouse=True)
def _cache_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> None:
    """No test reads or writes the user's cache."""
    os.environ["XDG_CACHE_HOME"] = str(with_library(tmp_path_factory.mktemp("cache")))


class VirtualClock:
    """Stands where ``time.monotonic_ns`` is expected, and moves only when the test advances it."""

    def __init__(self, now_ns: int = 1_000_000_000) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        return self.now_ns

    def advance(self, duration_ns: int) -> int:
        """Let ``duration_ns`` pass; the new time."""
        if duration_ns < 0:
            raise ValueError(f"CLOCK_MONOTONIC never goes back: {duration_ns} ns")
        self.now_ns += duration_ns
        return self.now_ns


def is_alive(pid: int) -> bool:
    """Whether a process has not ended; one that has may still wait for its parent to collect it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def locate_datasets(environment: str | None, beside_the_checkout: Path) -> Path | None:
    """The data sets' folder; ``None`` where this machine has none. A HEFT_DATASETS that is no folder is an error."""
    if environment:
        folder = Path(environment).expanduser()
        if not folder.is_dir():
            raise NotADirectoryError(f"HEFT_DATASETS={environment} is no folder. Correct it, or unset it.")
        return folder
    return beside_the_checkout if beside_the_checkout.is_dir() else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A test that asks for the data sets is a ``realdata`` test without having to say so."""
    for item in items:
        if "datasets" in getattr(item, "fixturenames", ()):
            item.add_marker("realdata")


def pytest_collection_finish() -> None:
    """From here on garbage is looked for among what the tests make."""
    gc.freeze()
    gc.enable()


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with the same seed in every test and every run."""
    return np.random.default_rng(SEED)


@pytest.fixture
def clock() -> VirtualClock:
    """A clock of the test's own."""
    return VirtualClock()


@pytest.fixture(scope="session")
def datasets() -> Path:
    """The folder of recorded data sets."""
    folder = locate_datasets(os.environ.get("HEFT_DATASETS"), DATASETS_BESIDE_THE_CHECKOUT)
    if folder is None:
        pytest.skip("no recorded data sets: neither $HEFT_DATASETS nor ../shared/datasets is there")
    return folder
