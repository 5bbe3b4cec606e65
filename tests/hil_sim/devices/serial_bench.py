"""A serial twin on its wire in these tests: virtual time by hand, or a thread that keeps it in step with the real."""

import threading
import time

from hil_sim.devices.serial_wire import SerialWire
from tests.hil_sim.devices.twin_bench import MS, START_NS


class Line:
    """A twin on a wire, and a host that has its port open in ``line`` (None: in the twin's own format)."""

    def __init__(self, device, line=None, now_ns=START_NS):
        self.device = device
        self.wire = SerialWire(device)
        self.wire.host = line or device.line
        self.now_ns = now_ns
        self.ends_ns = []  # of the characters that the last run received

    def run(self, ms):
        """Let time pass; returns what was received in it."""
        self.now_ns += round(ms * MS)
        received = self.wire.advance(self.now_ns)
        self.ends_ns = received.ends_ns
        return received.data

    def send(self, data):
        self.wire.send(data, self.now_ns)

    def ask(self, data, ms=60):
        self.send(data)
        return self.run(ms)


class RealTime:
    """Keeps a bus in step with ``CLOCK_MONOTONIC`` in a thread of its own, as a context."""

    def __init__(self, bus):
        self.bus = bus
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()

    def _run(self):
        while not self._stop.is_set():
            self.bus.advance(time.monotonic_ns())
            time.sleep(0.0002)
