"""Arms the drives of a flight: by the operator at its start, or by the phase that ``[drive]`` names.

Once a flight: an acquisition process that was started again, or a flight that goes on after a loss of power, does not
move the arm again.
"""

import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from drivers.device import Device
from drivers.play.master import DriveMaster
from drivers.play.player import Player
from drivers.records import Batch, SampleStatus, Severity, event
from onboard import config
from onboard.channels import Act
from onboard.ring import RingReader

MARK = "drive_armed"
REQUESTS = "request.ring"  # of the estimation process
HEAR_NS = 20_000_000  # between two looks at it
LATE_NS = 2_000_000_000  # a request so old is not played any more


class Arming:
    """Of one acquisition process.

    Args:
        vehicle: what flies.
        directory: of the flight, where it is marked that it was armed; None: it cannot be started again.
    """

    def __init__(self, vehicle: config.Vehicle, directory: Path | None = None) -> None:
        drive, phases = vehicle.file.drive, vehicle.file.estimation.phases
        self._at_once = vehicle.arm
        self._phase = None if drive is None else drive.phase
        self._channel = None if phases is None else phases.channel
        self._mark = None if directory is None else directory / MARK
        self._spent = self._mark is not None and self._mark.exists()
        self._players: list[DriveMaster[Any]] = []
        self._lock = threading.Lock()
        asks = directory is not None and vehicle.file.mission is not None
        self._asked_at = directory / REQUESTS if directory is not None and asks else None
        self._asked: RingReader | None = None
        self._hear_ns = 0

    def started(self, device: Device, now_ns: int) -> list[Batch]:
        """A device was started: its player is armed where the operator has armed; an event where it is not any more."""
        player: DriveMaster[Any] | None = getattr(device, "player", None)
        if player is None:
            return []
        if self._spent:
            text = "the arm was driven in this flight before acquisition was started again: it is not driven again"
            return [event(now_ns, Severity.ERROR, "drive_not_rearmed", device.name, text)]
        with self._lock:
            self._players.append(player)
        if self._at_once:
            self._arm()
        return []

    def see(self, batches: Iterable[Batch]) -> None:
        """Rows were read: the phase that arms may be among them."""
        if self._phase is None or self._channel is None or not self._players:
            return
        for channel, rows in batches:
            if channel == self._channel and len(rows):
                valid = ~(rows["status"] & SampleStatus.NOT_VALID).astype(bool)
                if (rows["value_raw"][valid] == self._phase).any():
                    self._arm()

    def hear(self, device: Device, now_ns: int) -> list[Batch]:
        """Pass on segments that the estimation asks for to the device's player; an event for each that comes late."""
        player = getattr(device, "player", None) if self._asked_at is not None else None
        if not isinstance(player, Player) or not player.is_active or now_ns < self._hear_ns:
            return []
        self._hear_ns = now_ns + HEAR_NS
        said = []
        for row in self._requests():
            name, late_ns = row["segment"].decode("ascii", "replace"), now_ns - int(row["host_ns"])
            if row["act"] == Act.SEGMENT and late_ns <= LATE_NS:
                player.request(name)
            elif row["act"] == Act.SEGMENT:
                text = f"{name} was asked for {1e-9 * late_ns:.1f} s ago: it is not played"
                said.append(event(now_ns, Severity.WARNING, "segment_late", device.name, text))
        return said

    def _requests(self) -> Iterable[np.void]:
        """Rows that were not read before; none as long as there is no ring."""
        assert self._asked_at is not None
        if self._asked is None:
            try:
                self._asked = RingReader(self._asked_at)
            except (OSError, ValueError):  # not there, or being made
                return ()
        rows: Iterable[np.void] = self._asked.read()[0]
        return rows

    def _arm(self) -> None:
        with self._lock:
            players, self._players = self._players, []
        if players and self._mark is not None:
            self._mark.touch()
        for player in players:
            player.arm()
