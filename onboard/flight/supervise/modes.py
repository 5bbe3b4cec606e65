"""Modes of a real flight, in this order: boot, checkout, armed, run, safe, stopped. Each change is an event ``mode``.

- boot: the workers are being started.
- checkout: they are at work; every device that has a rate is awaited, for :data:`CHECKOUT_S` at most.
- armed: what came is at work; the mission has not reached a phase in which rows are identified.
- run: it has. A vehicle without phases runs as soon as it is armed. It stays in this mode between such phases.
- safe: the mission's end phase, the end of the stated duration, a signal, or an error ended it: devices are stopped,
  what was under way is finished, and the log is being closed.
- stopped: acquisition and estimation have ended; the recorder closes the log with this event as its last.
"""

import math
from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path
from typing import Protocol

from drivers.records import Severity
from onboard import config
from onboard.devices.base import BusDevice
from onboard.flight.estimate.phases import KnownPhases, PhaseTrack
from onboard.ring import RingReader

CHECKOUT_S = 10.0
KEEP_S = 10.0  # between two checkpoints of a flight in which nothing changes
_NAMED = 5  # channels in a line


class Mode(Enum):
    """Mode of a flight."""

    BOOT = "boot"
    CHECKOUT = "checkout"
    ARMED = "armed"
    RUN = "run"
    SAFE = "safe"
    STOPPED = "stopped"


class Keeps(Protocol):
    """Keeps the state of a flight where a loss of power does not reach it."""

    def keep(self, mode: Mode, known: KnownPhases | None) -> None:
        """Keep this."""

    def close(self, *, ended: bool) -> None:
        """End; a flight that ``ended`` is not gone on with."""


class Modes:
    """Mode of one flight, from what its devices say.

    Args:
        vehicle: what flies.
        directory: of its rings.
        tell: publishes an event: severity, code, source, text.
        keeper: called with mode and phases when either changes, and every :data:`KEEP_S`, while armed or running.

    Attributes:
        mode: as it stands.
    """

    def __init__(
        self,
        vehicle: config.Vehicle,
        directory: Path,
        tell: Callable[[Severity, str, str, str], None],
        keeper: Keeps | None = None,
    ) -> None:
        self.mode = Mode.BOOT
        self._phases, self._tell, self._keeper = vehicle.file.estimation.phases, tell, keeper
        self._track = PhaseTrack(self._phases)
        self._reader = RingReader(directory / f"{self._phases.channel}.ring") if self._phases else None
        self._awaited = [
            next(iter(device.channels(name)))
            for name, device in vehicle.file.device.items()
            if isinstance(device, BusDevice) and not device.tells_changes and device.channels(name)
        ]
        self._checkout_s, self._kept_s = math.inf, -math.inf
        self._ended = False
        self._kept: tuple[Mode, KnownPhases | None] | None = None
        if self._track.known is not None:
            tell(Severity.INFO, "phase", "flight", f"phase {self._track.known.phase}, from before the restart")
        tell(Severity.INFO, "mode", "flight", "boot: the workers are being started")

    def at_work(self, now_s: float) -> None:
        """Every worker is at work."""
        self._checkout_s = now_s + CHECKOUT_S
        self._enter(Mode.CHECKOUT, f"waits for {len(self._awaited)} devices, {CHECKOUT_S:g} s at most")

    def step(self, now_s: float, rows: Mapping[str, int]) -> None:
        """Go on; ``rows`` of each device channel, in all."""
        if self._reader is not None and self._phases is not None:
            self._track.update({self._phases.channel: self._reader.read()[0]})
        if self.mode is Mode.CHECKOUT:
            missing = [name for name in self._awaited if not rows.get(name)]
            if not missing:
                self._enter(Mode.ARMED, "every device answers")
            elif now_s >= self._checkout_s:
                more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
                self._enter(Mode.ARMED, f"without {', '.join(missing[:_NAMED])}{more}", Severity.WARNING)
        known = self._track.known
        if self.mode is Mode.ARMED:
            if self._phases is None:
                self._enter(Mode.RUN, "the vehicle has no phases")
            elif known is not None and known.begun:
                self._enter(Mode.RUN, f"phase {known.phase}")
        if self.mode in (Mode.ARMED, Mode.RUN):
            now = self.mode, known
            if now != self._kept or now_s - self._kept_s >= KEEP_S:
                self._kept, self._kept_s = now, now_s
                if self._keeper is not None:
                    self._keeper.keep(*now)

    def end(self, why: str) -> None:
        """The flight is being ended; ``why`` is empty for an error."""
        self._ended = bool(why)
        severity = Severity.INFO if why else Severity.ERROR
        self._enter(Mode.SAFE, f"{why or 'an error'}; devices are stopped, the log is closed", severity)

    def stopped(self) -> None:
        """Acquisition and estimation have ended."""
        self._enter(Mode.STOPPED, "acquisition and estimation have ended")

    def close(self) -> None:
        """The log is closed."""
        if self._keeper is not None:
            self._keeper.close(ended=self._ended)

    def _enter(self, mode: Mode, why: str, severity: Severity = Severity.INFO) -> None:
        self.mode = mode
        self._tell(severity, "mode", "flight", f"{mode.value}: {why}")
