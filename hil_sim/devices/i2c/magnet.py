"""What simulated angle sensors above a magnet on a joint's axis have in common."""

from collections.abc import Mapping
from typing import Any, ClassVar, Final

from pydantic import PositiveFloat

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.i2c.twin import POWER_KINDS, I2cTwin
from hil_sim.faults import ENCODER_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyScalar
from hil_sim.scenario.sheets import Sheets
from hil_sim.scenario.tables import ScenarioError
from hil_sim.sensing.analog import ScalarAnalog
from hil_sim.sensing.sensors import EncoderSensor

WEAK, STRONG, NONE = 0.5, 1.5, 0.1  # of the nominal field: our choice
_POWER_UP_NS: Final = 10_000_000


class MagnetTwin(I2cTwin):
    """One chip; it samples when it is asked.

    Args:
        analog: Angle of the joint, rad.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        address: 7-bit address.
        turns: Of the magnet in one of the joint; negative: the other way.
        zero_count: What it reads at joint angle zero.
        seed: Of its noise.
        faults: What breaks.
        kinds: Faults of its bus and supply that it can have.

    Raises:
        FaultError: a fault that it cannot have.
    """

    registers: ClassVar[int]

    def __init__(
        self,
        analog: ScalarAnalog,
        start_ns: int,
        *,
        address: int,
        turns: float = 1.0,
        zero_count: int = 0,
        seed: int = 0,
        faults: DeviceFaults = NO_FAULTS,
        kinds: tuple[FaultKind, ...] = POWER_KINDS,
    ) -> None:
        super().__init__(address, start_ns, faults, (*kinds, *ENCODER_KINDS, FaultKind.FIELD))
        self._joint = FaultyScalar(analog, faults, start_ns)
        self._turns, self._zero, self._seed = turns, zero_count, seed
        self.answered = 0  # readings of an angle
        self._power_up(start_ns)

    def _power_up(self, now_ns: int) -> None:
        self._reg = bytearray(self.registers)
        self._ready_ns = now_ns + _POWER_UP_NS

    def _run(self, until_ns: int) -> None:
        """It is asked."""

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """See ``I2cTwin``."""
        self._settle(now_ns)
        if read_count:
            self._look(now_ns)
        answer = super().transfer(address, write, read_count, now_ns)
        self.answered += self._is_reading(write, read_count)
        return answer

    def _look(self, now_ns: int) -> None:
        """Its output registers hold what it measures now, if it has started."""
        if now_ns >= self._ready_ns:
            window = self._faults.active(FaultKind.FIELD, now_ns)
            self._sense(1.0 + (window.value if window is not None else 0.0), (now_ns - self._start_ns) * 1e-9)

    def _sense(self, field: float, time_s: float) -> None:
        """Output registers in a field, in shares of the nominal one, at a mission time."""
        raise NotImplementedError

    def _is_reading(self, write: bytes, read_count: int) -> bool:
        """Whether a transfer reads an angle."""
        raise NotImplementedError


class MagnetTable(MeasuringEmulator):
    """A chip on a joint; ``turns``: of its magnet in one of the joint, ``zero_count``: at joint angle zero."""

    full: ClassVar[int]  # counts of a turn of the magnet
    finer: ClassVar[int]  # steps of the sensor in a count: the chip rounds, after its noise
    eccentricity_rad: ClassVar[float]  # where the file does not say it

    needs = "i2c"
    has_clock = False
    quantities = ("joint_angle",)

    turns: PositiveFloat = 1.0
    zero_count: int = 0

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: a magnet a little beside the axis, by what the file says of its eccentricity."""
        counts = said.get("counts_per_revolution", cls.full)
        if counts <= 0:
            raise ScenarioError(f"device.{name}: {counts} counts a revolution; rehearse it with the count's size")
        table = {key: said[key] for key in ("address", "zero_count") if key in said}
        table |= {"measures": name, "at": said["joint"], "turns": counts / cls.full}
        own = {"eccentricity_rad": cls.eccentricity_rad, **said, "counts_per_revolution": counts * cls.finer}
        return Equivalent(table, {name: sheets.encoder(name, own)}, {})

    def chip(self, analog: ScalarAnalog, start_ns: int, **options: Any) -> MagnetTwin:
        """The chip."""
        raise NotImplementedError

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        twin = self.chip(
            bench.sensor(EncoderSensor),
            bench.start_ns,
            turns=self.turns,
            zero_count=self.zero_count,
            seed=bench.seed,
            faults=bench.faults,
        )
        return Twin(twin, lambda: twin.answered, (bench.name,))
