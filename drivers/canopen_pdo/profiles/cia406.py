"""CiA 406 encoder: position 6004h, unwrapped, on every SYNC."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.profiles.channel import ProcessData, Sample, Samples, position_sample, position_samples
from drivers.canopen_pdo.sdo import SdoData, SdoRead, SdoWrite, Setup, attempt, ensure_tpdo, read_unsigned
from drivers.errors import ConfigurationError, FrameError, SdoAbortError
from drivers.position import Position

POSITION_MAPPING = 0x6004_0020
CYCLIC_TPDO, SYNC_TPDO = 1, 2  # CiA 406: TPDO1 by the cyclic timer, TPDO2 by SYNC
SCALING_ENABLED = 1 << 2  # 6000h


@dataclass(frozen=True)
class Cia406Config:
    """An encoder.

    Attributes:
        name: Channel.
        node: Node number.
        counts_per_revolution: Counts in a revolution of the joint (gear and quadrature included); checked at the node.
        zero_count: What it reads at joint angle zero, counts.
    """

    name: str
    node: int
    counts_per_revolution: int
    zero_count: int = 0

    def __post_init__(self) -> None:
        if self.counts_per_revolution < 1:
            raise ConfigurationError(f"{self.name}: counts_per_revolution = {self.counts_per_revolution}: 1 or more")

    def process_data(self) -> "list[Encoder]":
        """Its one channel."""
        return [Encoder(self)]


class Encoder(ProcessData):
    """Joint position, counts; 2 pi / ``counts_per_revolution`` rad a count.

    6004h is an unsigned 32-bit counter and wraps; ``value_raw`` is unwrapped. A step that ``Position`` rejects is
    NOT_VALID.
    """

    profile = 0x0196
    unit = "rad"

    def __init__(self, config: Cia406Config) -> None:
        super().__init__(config.name, config.node, frame.TPDO[SYNC_TPDO] + config.node)
        self.scale = 2.0 * math.pi / config.counts_per_revolution
        self._counts = config.counts_per_revolution
        self._position = Position(config.counts_per_revolution, config.zero_count)

    def setup(self) -> Setup:
        """Check the resolution, disable the event TPDO, map the position to the SYNC TPDO.

        Raises:
            ConfigurationError: The resolution differs from the configuration, or the event TPDO cannot be disabled.
        """
        counts = yield from self._resolution()
        if counts != self._counts:
            raise ConfigurationError(
                f"encoder has {counts} counts/rev, configured {self._counts}: correct counts_per_revolution, or 6001h"
            )
        cyclic = 0x1800 + CYCLIC_TPDO - 1
        timer_off = yield from attempt(0x6200, 0, 0, 2)
        cob_id = yield from read_unsigned(cyclic, 1)
        pdo_off = yield from attempt(cyclic, 1, cob_id | frame.NOT_VALID, 4)
        if not timer_off and not pdo_off:
            raise ConfigurationError(
                "event TPDO1 of the encoder cannot be switched off (6200h, 1800h): use the manufacturer's tool"
            )
        yield from ensure_tpdo(SYNC_TPDO, self.cob_id, 1, (POSITION_MAPPING,))

    def decode(self, data: bytes) -> Sample:
        """Position as sent, unwrapped. Raises FrameError."""
        if len(data) != 4:
            raise FrameError(f"{self.name}: TPDO of {len(data)} bytes, 6004h has 4: check the mapping 1A01h")
        return position_sample(self._position, int.from_bytes(data, "little"))

    def decode_many(self, words: NDArray[np.uint8]) -> Samples | None:
        """See ``ProcessData``."""
        if words.shape[1] != 4:
            return None
        return position_samples(self._position, words.view("<u4")[:, 0].astype(np.int64))

    def _resolution(self) -> Generator[SdoRead | SdoWrite, SdoData, int]:
        """Counts per revolution: 6001h if scaling is enabled (6000h bit 2), else the physical resolution 6501h."""
        try:
            scaling = (yield from read_unsigned(0x6000)) & SCALING_ENABLED
        except SdoAbortError:
            scaling = 0
        if not scaling:
            try:
                return (yield from read_unsigned(0x6501))
            except SdoAbortError:
                pass
        return (yield from read_unsigned(0x6001))
