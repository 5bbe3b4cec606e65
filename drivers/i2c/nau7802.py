"""Nuvoton NAU7802: 24-bit converter for one load cell bridge, on I2C at 2Ah.

Source: data sheet revision 1.7. Set-up: RR, PUD, wait for PUR, the settings, PUA, offset calibration inside (input
shorted, CALMOD 0). Its result (OCAL1) is written back after a brown-out, so that the cell's zero stays where it was.
The chip converts at a rate of its own RC oscillator; CR says that a conversion has ended since the last reading.

The chip does not number its conversions: ``drivers.conversions`` does. Known limits: channel 1 only; the length of the
digital filter is not in the data sheet that this was written from, see ``onboard.devices.bridge``.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from drivers.conversions import ConvertedForce
from drivers.errors import ConfigurationError, FrameError, WrongDeviceError
from drivers.i2c.sensor import MS, I2cSensor, Watched
from drivers.ports import I2cPort
from drivers.records import SampleStatus, Severity

IDENTITY = 0x0F  # low half of REVISION
PU_CTRL, CTRL1, CTRL2, OCAL1, GCAL1, ADCO, ADC, PGA, PWR_CTRL, REVISION = 0, 1, 2, 3, 6, 0x12, 0x15, 0x1B, 0x1C, 0x1F
RR, PUD, PUA, PUR, CS, CR, AVDDS = (1 << bit for bit in (0, 1, 2, 3, 4, 5, 7))  # PU_CTRL
CALS, CAL_ERR = 1 << 2, 1 << 3  # CTRL2
RATE_CODE = {10: 0, 20: 1, 40: 2, 80: 3, 320: 7}  # CTRL2, CRS
SUPPLY_CODE = {4.5: 0, 4.2: 1, 3.9: 2, 3.6: 3, 3.3: 4, 3.0: 5, 2.7: 6, 2.4: 7}  # CTRL1, VLDO
CHOPPER_OFF = 0x30  # ADC, REG_CHPS: "Turned off high"
CAPACITOR = 0x80  # PWR_CTRL, PGA_CAP_EN: on the pins of channel 2, for channel 1 alone
UNIT_GAIN = (0x00, 0x80, 0x00, 0x00)  # GCAL1 after a reset: 1
HIGHEST, LOWEST = (1 << 23) - 1, -(1 << 23)

RESET_NS, READY_NS, READY_LIMIT_NS = 10 * MS, 1 * MS, 400 * MS
ANALOG_NS = 200 * MS  # of the regulator and the reference
CALIBRATION_LOOK_NS, CALIBRATION_LIMIT = 20 * MS, 100  # looks
SETTLING = 4  # conversions, after which the filter has forgotten what was before
OSCILLATOR = 0.03  # relative bound of its period
SILENCE_PERIODS = 8
MOST_EARLY = 8


@dataclass(frozen=True)
class Nau7802Config:
    """Settings.

    Attributes:
        sample_rate_hz: Nominal: 10, 20, 40, 80 or 320.
        amplifier: Gain of its amplifier: 1, 2, 4 ... 128.
        supply_V: Of the bridge, from its own regulator (VLDO), 2.4 to 4.5; 0: AVDD is fed from outside.
        scale: N per count.
        poll_period_ms: Time between two looks at the data-ready bit while a conversion is due.
    """

    sample_rate_hz: Literal[10, 20, 40, 80, 320] = 80
    amplifier: int = 128
    supply_V: float = 3.0  # noqa: N815  (the volt's letter)
    scale: float = 1.0
    poll_period_ms: float = 1.0

    def __post_init__(self) -> None:
        if self.sample_rate_hz not in RATE_CODE or self.amplifier not in {1 << n for n in range(8)}:
            raise ConfigurationError(
                f"{self.sample_rate_hz} samples/s, gain {self.amplifier}: it has {', '.join(map(str, RATE_CODE))}"
                " and 1, 2, 4 ... 128; correct them"
            )
        if self.supply_V and self.supply_V not in SUPPLY_CODE:
            raise ConfigurationError(f"supply_V {self.supply_V:g}: it makes {', '.join(map(str, SUPPLY_CODE))}; or 0")
        if not 0.0 < self.poll_period_ms <= 500.0 / self.sample_rate_hz:
            raise ConfigurationError(
                f"poll_period_ms {self.poll_period_ms:g}: half a conversion at the most, or it loses samples"
            )

    @property
    def period_ns(self) -> float:
        """Nominal, of its conversions."""
        return 1e9 / self.sample_rate_hz


def decode_sample(data: bytes, offset: bytes = bytes(3)) -> tuple[int, int]:
    """ADCO (12h to 14h): counts, and their ``SampleStatus``, SATURATED at either end of the range.

    Args:
        data: Three bytes.
        offset: OCAL1 (03h to 05h), sign and magnitude: it is taken off what the converter says, whose ends are off by
            as much.

    Raises:
        FrameError: Not three bytes.
    """
    if len(data) != 3:
        raise FrameError(f"{len(data)} bytes are no sample of an NAU7802: read three from register 0x12")
    counts = int.from_bytes(data, "big", signed=True)
    taken = int.from_bytes(offset, "big") & HIGHEST
    below, above = (0, taken) if offset[0] & 0x80 else (taken, 0)
    at_end = not LOWEST + above < counts < HIGHEST - below
    return counts, int(SampleStatus.SATURATED if at_end else SampleStatus.OK)


def identify(port: I2cPort, address: int) -> str | None:
    """Name of the chip by its revision, which is all that is read; None: another one.

    Raises:
        OSError: The transfer failed.
    """
    return "NAU7802" if port.write_read(address, bytes([REVISION]), 1).data[0] & 0x0F == IDENTITY else None


class Nau7802(I2cSensor):
    """An NAU7802 on an ``I2cPort``, as SCALAR rows in N on the channel of its name.

    ``sequence`` and ``tick``: number of the conversion since the first start, missed ones included. ``host_ns``: of the
        look that found it.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        config: Settings.
    """

    ADDRESS = 0x2A

    def __init__(self, name: str, port: I2cPort, config: Nau7802Config | None = None) -> None:
        self.config = config or Nau7802Config()
        super().__init__(name, port, self.ADDRESS, round(self.config.poll_period_ms * MS))
        self._offset: bytes | None = None  # OCAL1, as calibrated
        self._count = ConvertedForce(self._report, self.config.scale, self.config.period_ns, OSCILLATOR)
        self._skip = SETTLING  # rows that are not valid yet
        self._looked_ns = 0  # the last look, which found nothing or took what it found
        self._sampled_ns = 0
        self._early = 0  # conversions found too soon to be such, in a row
        supply = self.config.supply_V
        self._power = PUD | PUA | CS | (AVDDS if supply else 0)
        self._gain = (SUPPLY_CODE[supply] << 3 if supply else 0) | self.config.amplifier.bit_length() - 1
        self._rate = RATE_CODE[self.config.sample_rate_hz] << 4

    @property
    def within_ns(self) -> int:
        """See ``drivers.device.Hurried``: between two looks no more than one conversion may end."""
        return max(int(0.45 * self.config.period_ns) // self._poll_ns, 1) * self._poll_ns

    def _watched(self) -> list[Watched]:
        offset = self._offset or bytes(3)
        return [
            Watched(PU_CTRL, self._power, 0, PUD | PUA | AVDDS | RR),
            Watched(CTRL1, self._gain, 0),
            Watched(CTRL2, self._rate, 0, 0xF7 ^ CALS),
            *(Watched(OCAL1 + place, byte, 0) for place, byte in enumerate(offset)),
            *(Watched(GCAL1 + place, byte, byte) for place, byte in enumerate(UNIT_GAIN)),
            Watched(PWR_CTRL, CAPACITOR, 0),
        ]

    def _set_up(self) -> Iterator[int]:
        revision = self._bus.byte(REVISION)
        if revision & 0x0F != IDENTITY:
            raise WrongDeviceError(
                f"{self.name}: I2C {self._address:#x} has revision {revision:#04x}, NAU7802 has 0x0f: correct the bus"
            )
        self._bus.write(PU_CTRL, RR)
        yield RESET_NS
        self._bus.write(PU_CTRL, PUD)
        for _ in range(READY_LIMIT_NS // READY_NS):
            yield READY_NS
            if self._bus.byte(PU_CTRL) & PUR:
                break
        else:
            raise ConfigurationError(f"{self.name}: it does not become ready (PUR): check its supply, power-cycle it")
        for register, value in ((CTRL1, self._gain), (CTRL2, self._rate), (PWR_CTRL, CAPACITOR)):
            self._write(register, value)
        self._bus.write(ADC, CHOPPER_OFF)
        self._write(PU_CTRL, self._power & ~CS, PUD | PUA | AVDDS)
        yield ANALOG_NS
        if self._offset is None:
            yield from self._calibrate()
        else:
            for place, byte in enumerate(self._offset):
                self._write(OCAL1 + place, byte)
        self._bus.write(PU_CTRL, self._power)

    def _calibrate(self) -> Iterator[int]:
        self._bus.write(CTRL2, self._rate | CALS)
        for _ in range(CALIBRATION_LIMIT):
            yield CALIBRATION_LOOK_NS
            state = self._bus.byte(CTRL2)
            if not state & CALS:
                break
        if state & (CALS | CAL_ERR):
            raise ConfigurationError(
                f"{self.name}: its offset calibration fails ({state:#04x}): check supply and bridge"
            )
        self._offset = self._bus.read(OCAL1, 3).data

    def _begin(self, now_ns: int, anew: bool) -> str:
        self._sampled_ns = now_ns
        self._early = 0
        if anew:
            self._skip = SETTLING
            self._looked_ns = now_ns
            self._count.anew()
        rate, gain = self.config.sample_rate_hz, self.config.amplifier
        return f"NAU7802 runs: {rate} samples/s, gain {gain}, offset calibration {(self._offset or b'').hex()}"

    def _take(self, now_ns: int) -> None:
        look = self._bus.read(PU_CTRL)
        looked_ns = min(now_ns, look.host_ns)
        self._wait_ns = self._poll_ns
        if not look.data[0] & CR:
            self._looked_ns, self._early = looked_ns, 0
            if now_ns - self._sampled_ns > SILENCE_PERIODS * self.config.period_ns:
                self._sort_out_silence(now_ns)
            elif self._count.number >= 0:
                self._wait_ns = self._count.next_look_ns(now_ns, self._poll_ns, self.within_ns)
            return
        counts, status = decode_sample(self._bus.read(ADCO, 3).data, self._offset or bytes(3))
        not_before_ns, self._looked_ns = self._looked_ns, looked_ns
        if self._count.is_early(looked_ns):
            self._doubt(now_ns)
            return
        self._sampled_ns = now_ns
        if self._skip:
            self._skip -= 1
            status |= SampleStatus.NOT_VALID
        self._cause = self._count.hand_over(not_before_ns, look.host_ns, counts, status, self._cause)
        self._wait_ns = self._count.next_look_ns(now_ns, self._poll_ns, self.within_ns)

    def _doubt(self, now_ns: int) -> None:
        """A conversion that cannot have ended yet: the data-ready bit hangs."""
        self._early += 1
        if self._early >= MOST_EARLY:
            self._not_converting(now_ns, "its data-ready bit (CR) stays set")

    def _sort_out_silence(self, now_ns: int) -> None:
        lost = next(self._differing(), None)
        if lost is not None:
            self._lose_configuration(now_ns, *lost)
        else:
            self._not_converting(now_ns, "no conversions although powered and configured")

    def _not_converting(self, now_ns: int, why: str) -> None:
        self._report.event(now_ns, Severity.ERROR, "no_samples", f"{why}: the chip is reset; replace it if this stays")
        self._set_up_again(now_ns, "no_samples")

    def _sleep(self, now_ns: int) -> None:
        self._bus.write(PU_CTRL, 0)

    def _finish(self, now_ns: int) -> str:
        self._count.finish(now_ns, self._cause)
        self._cause, self._offset = "", None
        return f"{self._count.number + 1} samples"
