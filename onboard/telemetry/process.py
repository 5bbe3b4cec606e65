"""Process that sends a flight's packets, and its start by the command line.

When the flight is over it sends what waits, for :data:`END_S` at most. A link that fails in flight is tried again every
second, and said once.
"""

import contextlib
import json
import secrets
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.records import EVENT, Batch
from onboard import channels
from onboard.flight.store import manifest
from onboard.flight.supervise.companion import beside, ready, settle
from onboard.ring import RingReader
from onboard.telemetry.commanding import Commanding
from onboard.telemetry.downlink import Downlink, TelemetrySettings
from onboard.telemetry.link import Address, Sink, parse, sink
from onboard.telemetry.replay import STEP_NS, flight_of
from onboard.telemetry.uplink import Uplink

if TYPE_CHECKING:
    from onboard.config.telemetry import Telemetry

END_S = 2.0
_ASK_NS, _AGAIN_NS = 500_000_000, 1_000_000_000  # between two looks for the flight, and two tries of a link
_MOST_ROWS = 4096  # of a ring in a step


@contextlib.contextmanager
def sending(log: Path, link: str, settings: "Telemetry") -> Iterator[None]:
    """Run a process that sends the flight recorded to ``log`` while the context lasts.

    Args:
        log: of the flight.
        link: URL; see :mod:`onboard.telemetry.link`.
        settings: of the vehicle file.

    Raises:
        ValueError: the link cannot be used; the message gives the reason.
    """
    given = json.dumps(TelemetrySettings.of(settings)._asdict())
    with beside("onboard.telemetry", [str(log), parse(link).text, given], f"--telemetry {link}"):
        yield


def main(arguments: Sequence[str]) -> int:
    """Body of the process; ``arguments`` are the log's path, the link and the settings as JSON."""
    log, address = Path(arguments[0]).absolute(), parse(arguments[1])
    settings = TelemetrySettings(**json.loads(arguments[2]))
    asked: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))
    left = settle()
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text("heft-telemetry", encoding="ascii")  # as ps shows it
    try:
        opened = sink(address)
    except OSError as error:
        sys.stdout.write(f"{error.strerror or error}; give another link, or make this link usable\n")
        return 2
    ready()
    _Sender(log, address, opened, settings).run(lambda: bool(asked) or left())
    return 0


class _Sender:
    """Reads the rings of a flight and sends its packets."""

    def __init__(self, log: Path, address: Address, opened: Sink, settings: TelemetrySettings) -> None:
        self._log, self._address, self._settings = log, address, settings
        self._sink: Sink | None = opened
        self._again_ns, self._failed = 0, False
        self._downlink: Downlink | None = None
        self._uplink: Uplink | None = None
        self._commanding: Commanding | None = None
        self._rings: dict[str, RingReader] = {}
        self._others: set[str] = set()

    def run(self, over: Callable[[], bool]) -> None:
        """Until the flight is over, and what waits then is sent."""
        ask_ns, directory = 0, None
        while not over():
            now_ns = time.monotonic_ns()
            if now_ns >= ask_ns:
                ask_ns = now_ns + _ASK_NS
                try:
                    running = next((flight for flight in manifest.running() if flight.log == self._log), None)
                except (OSError, ValueError):
                    continue  # of another flight, which is just being made or removed: looked for again
                if running is None and directory is not None:
                    break
                if running is not None and directory is None:
                    directory = running.directory
                    self._begin(running.preamble.metadata, running.preamble.flight, now_ns)
                if directory is not None:
                    self._discover(directory)
            self._step(now_ns)
            time.sleep(STEP_NS * 1e-9)
        if self._downlink is not None:
            self._finish(self._downlink)
        if self._commanding is not None:
            self._commanding.close()
        if self._sink is not None:
            self._sink.close()

    def _finish(self, downlink: Downlink) -> None:
        now_ns = time.monotonic_ns()
        end_ns = now_ns + round(END_S * 1e9)
        self._read(downlink)
        downlink.finish(now_ns)
        while downlink.waiting and now_ns < end_ns:
            self._step(now_ns)
            time.sleep(STEP_NS * 1e-9)
            now_ns = time.monotonic_ns()
        self._send(downlink.last(now_ns), now_ns)

    def _begin(self, metadata: Mapping[str, Mapping[str, str]], flight: str, now_ns: int) -> None:
        which = flight_of(metadata, flight, self._log.name)
        session = 1 + secrets.randbelow((1 << 16) - 1)
        self._downlink = Downlink(self._settings, session, which, now_ns, self._address.bytes_s)
        if self._settings.commands:
            self._uplink = Uplink(self._settings.command_apid, session, self._settings.commands, which)

    def _discover(self, directory: Path) -> None:
        """Open the rings that packets are made of, and those of commands, as they appear."""
        if self._uplink is not None and self._commanding is None and self._downlink is not None:
            with contextlib.suppress(OSError, ValueError):  # under construction: retried
                to = self._uplink, self._downlink, self._settings.answers_hz
                self._commanding = Commanding(directory, self._log, *to)
        for path in directory.glob("*.ring"):
            if path.name in self._rings or path.name in self._others:
                continue
            try:
                ring = RingReader(path)
            except (OSError, ValueError):
                continue  # under construction: retried
            if ring.dtype in (EVENT, channels.HEALTH) or channels.is_quantity(ring.dtype):
                self._rings[path.name] = ring
            else:
                self._others.add(path.name)
                ring.close()

    def _step(self, now_ns: int) -> None:
        if self._downlink is not None:
            self._read(self._downlink)
            if self._commanding is not None:
                self._commanding.step(*self._received(), now_ns)
            self._send(self._downlink.packets(now_ns), now_ns)

    def _received(self) -> tuple[bytes, str]:
        try:
            return (b"", "") if self._sink is None else self._sink.receive()
        except OSError:
            return b"", ""  # sending says it

    def _read(self, downlink: Downlink) -> None:
        for ring in self._rings.values():
            rows, lost = ring.read(_MOST_ROWS)
            downlink.unread += lost
            if len(rows):
                downlink.add(Batch(ring.name, rows))

    def _send(self, packets: Iterator[bytes], now_ns: int) -> None:
        try:
            if self._sink is None and now_ns >= self._again_ns:
                self._sink = sink(self._address)
            if self._sink is not None and self._sink.ready():
                for packet in packets:
                    self._sink.send(packet)
                    if self._failed:
                        self._failed = False
                        self._say("works again")
                    if not self._sink.ready():
                        break
        except OSError as error:
            if not self._failed:
                self._failed = True
                self._say(f"{error.strerror or error}; it is tried again every second, the flight goes on")
            if self._sink is not None:
                with contextlib.suppress(OSError):
                    self._sink.close()
            self._sink, self._again_ns = None, now_ns + _AGAIN_NS

    def _say(self, text: str) -> None:
        sys.stderr.write(f"heft: --telemetry {self._address.text}: {text}\n")
        sys.stderr.flush()
