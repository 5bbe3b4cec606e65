"""Share of an HX711's readings that a scheduler breaks: pulses of a clock line that last longer than 50 us.

    python -m bench.gpio_pulses [--url 'gpio-pair:///dev/gpiochip0?data=5&clock=6'] [--busy 2] [--fifo] [--seconds 60]

Without ``--url`` each call of libgpiod is one system call on a pipe in its place: the scheduler is this computer's, the
GPIO hardware's own time is not in it.
"""

import argparse
import array
import fcntl
import multiprocessing
import os
import sys
import termios
import time

import gpiod
from gpiod.line import Value

from drivers.hx711 import LONGEST_HIGH_NS, PULSES
from drivers.ports import ClockedPort
from drivers.transports import open_pair
from drivers.transports.gpio_pair import GpiodPair

PERIOD_S = 1.0 / 80


class Pipe:
    """A request of two lines, each call of which is a system call."""

    def __init__(self) -> None:
        self._end = os.pipe()[0]
        self._count = array.array("i", [0])

    def set_value(self, line: int, value: Value) -> None:
        """As libgpiod's."""
        del line, value
        fcntl.ioctl(self._end, termios.FIONREAD, self._count, True)

    def get_value(self, line: int) -> Value:
        """As libgpiod's."""
        self.set_value(line, Value.ACTIVE)
        return Value.ACTIVE


def _port(url: str | None) -> ClockedPort:
    if url is not None:
        return open_pair(url, time.monotonic_ns)
    request: gpiod.LineRequest = Pipe()  # type: ignore[assignment]
    return GpiodPair(request, 5, 6, time.monotonic_ns)


def _spin() -> None:
    while True:
        pass


def main() -> int:
    """Read 80 times a second, and print how long pulses lasted."""
    parser = argparse.ArgumentParser(prog="python -m bench.gpio_pulses", description=__doc__.splitlines()[0])
    parser.add_argument("--url", help="two lines of a GPIO chip; nothing has to be on them")
    parser.add_argument("--busy", type=int, default=0, help="processes that compute meanwhile (default 0)")
    parser.add_argument("--fifo", action="store_true", help="real-time priority, as a flight asks for")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long (default 60)")
    asked = parser.parse_args()
    port = _port(asked.url)
    others = [multiprocessing.Process(target=_spin, daemon=True) for _ in range(asked.busy)]
    for other in others:
        other.start()
    if asked.fifo:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    longest, took = [], []
    until_ns = time.monotonic_ns() + round(asked.seconds * 1e9)
    while (began_ns := time.monotonic_ns()) < until_ns:
        reading = port.clock_out(PULSES[128])
        longest.append(reading.high_ns)
        took.append(reading.host_ns - began_ns)
        time.sleep(PERIOD_S)
    for other in others:
        other.terminate()
    broken, middle = sum(one > LONGEST_HIGH_NS for one in longest), len(longest) // 2
    said = f"{broken} of {len(longest)} readings broken ({broken / len(longest):.2%})"
    said += (
        f"; longest pulse of a reading: median {sorted(longest)[middle] / 1e3:.1f} us, most {max(longest) / 1e3:.0f} us"
    )
    sys.stdout.write(f"{said}; a reading: {sorted(took)[middle] / 1e3:.0f} us\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
