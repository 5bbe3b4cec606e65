"""One flight of the vehicle with a device of every kind, and when its twins took their samples, for many tests."""

from collections import defaultdict
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.records import Rows
from hil_sim.devices.hx711 import Hx711Twin
from hil_sim.devices.i2c.nau7802 import Nau7802Twin
from hil_sim.devices.inertial.icm20948 import Icm20948Twin
from hil_sim.devices.network.ur_controller import UrController
from hil_sim.devices.serial_line.dynamixel import DynamixelTwin
from onboard import config
from tests.flight.mixed import MixedWorld, vehicle
from tests.hil_sim.devices.twin_bench import START_NS

MIXED_s: Final = 4.0


class MixedFlight(NamedTuple):
    """What the drivers of :mod:`tests.flight.mixed` handed over in :data:`MIXED_s`, and what was true."""

    rows: dict[str, Rows]
    taken_ns: dict[str, NDArray[np.float64]]  # when the twins took, converted or stored samples, mission time

    def vehicle(self, directory: Path) -> config.Vehicle:
        """Its vehicle, of buses that are elsewhere."""
        return vehicle(directory, {})

    def late_ns(self, twin: str, times_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """How late times are after the nearest sample of a twin, both of the mission, (n,)."""
        truth_ns = self.taken_ns[twin]
        return np.array([float(t - truth_ns[np.abs(truth_ns - t).argmin()]) for t in times_ns])


def fly_mixed(directory: Path) -> MixedFlight:
    """Fly it; the twins are watched at work, and change nothing."""
    taken: dict[str, list[float]] = defaultdict(list)
    with pytest.MonkeyPatch.context() as patch, MixedWorld(directory) as world:
        _watch(patch, taken)
        flying = vehicle(directory, world.urls)
        heard = world.fly(world.open(flying), MIXED_s)
    rows = {channel: np.concatenate(parts) for channel, parts in heard.items()}
    return MixedFlight(rows, {twin: np.array(times) for twin, times in taken.items()})


def _watch(patch: pytest.MonkeyPatch, taken: dict[str, list[float]]) -> None:
    def conversions(twin: Any, name: str) -> None:
        convert = twin._convert

        def converted(self: Any, *arguments: Any) -> Any:
            word = convert(self, *arguments)
            taken[name].append(1e9 * self.conversions.last_s)
            return word

        patch.setattr(twin, "_convert", converted)

    conversions(Nau7802Twin, "bridge")
    conversions(Hx711Twin, "wing")
    store, measure, sample = Icm20948Twin._store, DynamixelTwin.measure, UrController._sample

    def stored(self: Any, counts: Any, times_s: Any) -> None:
        taken["imu_elbow"].extend(1e9 * np.asarray(times_s))
        store(self, counts, times_s)

    def measured(self: Any, now_ns: int) -> None:
        taken[f"servo {self.memory[7]}"].append(now_ns - START_NS)
        measure(self, now_ns)

    def sampled(self: Any, now_ns: int) -> None:
        taken["robot_8"].append(now_ns - START_NS)
        sample(self, now_ns)

    patch.setattr(Icm20948Twin, "_store", stored)
    patch.setattr(DynamixelTwin, "measure", measured)
    patch.setattr(UrController, "_sample", sampled)
