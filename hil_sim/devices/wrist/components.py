"""What simulated wrist sensors have in common: tables of components, and the twin of those on a serial line."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import Field

from hil_sim.devices.emulator import FORCES, Equivalent, MeasuringEmulator
from hil_sim.devices.powered import Latency
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import CLOCK_KINDS, INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyClock
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ScalarAnalog


class ComponentsTwin(SerialTwin):
    """One sensor on a serial line.

    Args:
        inputs: What it measures and its range or rating, by component from 0, N and N m; others are 0.
        clock: Its oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        line: Speed and format; None: as it comes.
        latency_ns: From a sample to the first bit of its message.
        jitter_ns: Mean of an exponential time more.
        seed: Of the jitter.
        faults: What breaks.

    Raises:
        FaultError: a fault that it cannot have.
    """

    comes_with: ClassVar[LineFormat]
    draws: ClassVar[int]  # beside the seed
    clock_kinds: ClassVar[tuple[FaultKind, ...]] = CLOCK_KINDS

    def __init__(
        self,
        inputs: Mapping[int, tuple[ScalarAnalog, float]],
        clock: ChipClock,
        start_ns: int,
        *,
        line: LineFormat | None = None,
        latency_ns: int = 400_000,
        jitter_ns: int = 50_000,
        seed: int = 0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        kinds = (FaultKind.SATURATED, *INPUT_KINDS, *self.clock_kinds)
        super().__init__(line or self.comes_with, start_ns, faults, kinds)
        self.samples = 0  # that a client asked for
        self.leader = self
        self._inputs = dict(inputs)
        self._clock = FaultyClock(clock, faults)
        self._latency = Latency(latency_ns, jitter_ns, seed, self.draws)
        self._heard, self._runs = b"", False

    @property
    def produced(self) -> int:
        """Samples that it had to send to a client who asked for them."""
        return self.leader.samples

    def join(self, other: "ComponentsTwin") -> None:
        """Take over the inputs and faults of another table of the same device."""
        other.leader = self
        self._inputs |= other._inputs
        self._take_over(other)


class ComponentEmulator(MeasuringEmulator):
    """A component of a sensor; a bus has one twin."""

    quantities = FORCES
    where = "component {component}"

    component: Annotated[int, Field(ge=1, le=6)] = 1

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {"component": said["component"], "measures": name, "at": said["frame"], **cls.further(said)}
        return Equivalent(table, {name: sheets.load_cell(said)}, {name: "crystal"})

    @classmethod
    def further(cls, said: Mapping[str, Any]) -> dict[str, Any]:
        """Further keys, by a table of a vehicle file."""
        return {"range": said["capacity_N"]}
