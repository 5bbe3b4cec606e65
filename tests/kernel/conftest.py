"""Tests that run inside the guest of ``deploy/kernel_bench.sh`` and nowhere else: they need its kernel."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from smbus2 import SMBus

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "deploy" / "kernel"))  # the guest's own helpers: network


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Everything here is marked ``kernel``; outside the guest it is deselected."""
    ours = [item for item in items if HERE in item.path.parents]
    for item in ours:
        item.add_marker("kernel")
    if os.environ.get("HEFT_KERNEL_GUEST") != "1":
        config.hook.pytest_deselected(items=ours)
        items[:] = [item for item in items if item not in set(ours)]


class Served:
    """Twins in a process of their own, reachable at ``urls``."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.kernel.devices", json.dumps(settings)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._node = Path("/dev", settings["i2c"])
        self.urls: dict[str, Any] = {}

    def wait_ready(self) -> None:
        """Until everything can be opened."""
        line = self._line()
        assert line, "the twins did not start; their message stands above"
        self.urls = json.loads(line)
        _wait_for(self._node.exists, 5.0)

    @property
    def age_s(self) -> float:
        """Mission time now."""
        return (time.monotonic_ns() - int(self.urls["start_ns"])) * 1e-9

    def end(self) -> dict[str, Any]:
        """Stop them; what they made."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        done = json.loads(self._line())
        assert self.process.wait(10) == 0
        return dict(done)

    def kill(self) -> None:
        """Take them away, as a crash would."""
        if self.process.returncode is None:
            self.process.kill()
            self.process.wait()
            _wait_for(lambda: not self._node.exists(), 5.0)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()


def _wait_for(condition: Callable[[], bool], limit_s: float) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, f"not in {limit_s} s"
        time.sleep(0.005)


@pytest.fixture
def serve() -> Iterator[Callable[..., Served]]:
    """Starts twins with settings of ``tests.kernel.devices``, on /dev/i2c-10 and vcan0; they end with the test."""
    started: list[Served] = []

    def start(**settings: Any) -> Served:
        started.append(Served({"i2c": "i2c-10", "can": "vcan0", **settings}))
        started[-1].wait_ready()
        return started[-1]

    yield start
    for served in started:
        served.kill()


@pytest.fixture(scope="session")
def healthy_chip() -> Iterator[Served]:
    served = Served({"i2c": "i2c-9", "can": "vcan1"})
    try:
        served.wait_ready()
        yield served
    finally:
        served.kill()


@pytest.fixture
def chip(healthy_chip: Served) -> Served:
    """A healthy chip at 0x68 of /dev/i2c-9, just powered up."""
    with SMBus(9) as bus:
        bus.write_byte_data(0x68, 0x6B, 0x80)  # PWR_MGMT_1: DEVICE_RESET
        while bus.read_byte_data(0x68, 0x6B) != 0x40:
            pass
    return healthy_chip


@pytest.fixture
def run() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs another program to its end."""

    def run_it(*command: str, **options: Any) -> subprocess.CompletedProcess[str]:
        return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False, **options)

    return run_it
