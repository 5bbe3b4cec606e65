"""What the flight computer says of itself: CPU time and memory of processes, idle time, temperature, throttling.

Read from ``/proc`` and ``/sys``; what is not there is unknown: NaN, or -1 for bits. No program is run, no file system
that may hang is looked at.
"""

import contextlib
import math
import os
from pathlib import Path
from typing import NamedTuple

UNDERVOLTAGE, CAPPED, THROTTLED, SOFT_LIMIT = 1, 2, 4, 8  # bits of the Raspberry Pi's get_throttled
_FIRMWARE = "sys/devices/platform/soc/soc:firmware/get_throttled"


class Computer(NamedTuple):
    """Of the whole computer.

    Attributes:
        idle: fraction of all cores' time since the last call.
        memory_free_mb: available to programs.
        memory_free: as a fraction of all.
        temperature_deg_c: the hottest thermal zone.
        throttled: bits as in ``vcgencmd get_throttled``; -1 where neither the firmware nor the CPU says.
    """

    idle: float
    memory_free_mb: float
    memory_free: float
    temperature_deg_c: float
    throttled: int


class ComputerReader:
    """Reads :class:`Computer` once in a while.

    Args:
        root: of the file system.
    """

    def __init__(self, root: Path = Path("/")) -> None:
        self._root = root
        self._zones = sorted(root.glob("sys/class/thermal/thermal_zone*/temp"))
        self._firmware = root / _FIRMWARE if (root / _FIRMWARE).exists() else None
        self._counts = sorted(root.glob("sys/devices/system/cpu/cpu[0-9]*/thermal_throttle/core_throttle_count"))
        self._times: tuple[int, int] | None = None
        self._count = self._throttles()

    def read(self) -> Computer:
        """Now."""
        free_kb, all_kb = self._memory()
        return Computer(
            self._idle(),
            free_kb / 1024.0,
            free_kb / all_kb if all_kb else math.nan,
            self._temperature(),
            self._throttled(),
        )

    def _idle(self) -> float:
        """Idle and waiting for the disk, of all time in ``/proc/stat``."""
        with contextlib.suppress(OSError, ValueError), (self._root / "proc/stat").open(encoding="ascii") as file:
            fields = [int(field) for field in file.readline().split()[1:9]]
            before, self._times = self._times, (fields[3] + fields[4], sum(fields))
            if before is not None and self._times[1] > before[1]:
                return (self._times[0] - before[0]) / (self._times[1] - before[1])
        return math.nan

    def _memory(self) -> tuple[float, float]:
        """Available and all memory [kB]; NaN where unknown."""
        found = {"MemAvailable": math.nan, "MemTotal": math.nan}
        with contextlib.suppress(OSError, ValueError, IndexError):
            for line in (self._root / "proc/meminfo").read_text(encoding="ascii").splitlines()[:3]:
                name, _, rest = line.partition(":")
                if name in found:
                    found[name] = float(rest.split()[0])
        return found["MemAvailable"], found["MemTotal"]

    def _temperature(self) -> float:
        hottest = math.nan
        for zone in self._zones:
            with contextlib.suppress(OSError, ValueError):  # a zone whose sensor is switched off
                hottest = max(
                    int(zone.read_text(encoding="ascii")) / 1000.0, -math.inf if math.isnan(hottest) else hottest
                )
        return hottest

    def _throttled(self) -> int:
        if self._firmware is not None:
            with contextlib.suppress(OSError, ValueError):
                return int(self._firmware.read_text(encoding="ascii").strip(), 16)
            return -1
        if not self._counts:
            return -1
        before, self._count = self._count, self._throttles()
        return THROTTLED if self._count > before else 0

    def _throttles(self) -> int:
        """How often the cores were throttled, in all."""
        total = 0
        for path in self._counts:
            with contextlib.suppress(OSError, ValueError):
                total += int(path.read_text(encoding="ascii"))
        return total


class ProcessReader:
    """CPU use and memory of processes.

    Memory (PSS: what a process shares counts in parts) costs the kernel some milliseconds, so one process is looked at
    with each call of :meth:`look_at_next`.

    Args:
        proc: where the kernel tells of processes.
    """

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self._proc, self._tick_s = proc, 1.0 / os.sysconf("SC_CLK_TCK")
        self._cpu_s: dict[int, float] = {}
        self._pss_mb: dict[int, float] = {}

    def children(self, pid: int) -> list[int]:
        """Processes whose parent is ``pid``."""
        with contextlib.suppress(OSError, ValueError):
            return [int(one) for one in (self._proc / f"{pid}/task/{pid}/children").read_text("ascii").split()]
        return []

    def cpu_s(self, pid: int) -> float:
        """CPU time since the last call for this process; NaN at the first, and where it is gone."""
        before = self._cpu_s.pop(pid, math.nan)
        with contextlib.suppress(OSError, ValueError, IndexError):
            text = (self._proc / f"{pid}/stat").read_text(encoding="ascii", errors="replace")
            fields = text.rpartition(")")[2].split()
            self._cpu_s[pid] = (int(fields[11]) + int(fields[12])) * self._tick_s
            return self._cpu_s[pid] - before
        return math.nan

    def look_at_next(self, pids: list[int]) -> None:
        """Measure the memory of the one among ``pids`` that was measured longest ago; forget all others."""
        order = [pid for pid in pids if pid not in self._pss_mb] + [pid for pid in self._pss_mb if pid in pids]
        self._pss_mb = {pid: self._pss_mb[pid] for pid in self._pss_mb if pid in pids}
        if order:
            self._pss_mb.pop(order[0], None)
            self._pss_mb[order[0]] = self._pss(order[0])

    def pss_mb(self, pid: int) -> float:
        """Memory as last measured [MB]; NaN where it never was."""
        return self._pss_mb.get(pid, math.nan)

    def _pss(self, pid: int) -> float:
        with contextlib.suppress(OSError, ValueError, IndexError):
            text = (self._proc / f"{pid}/smaps_rollup").read_text(encoding="ascii", errors="replace")
            return int(text.partition("\nPss:")[2].split()[0]) * 1.024e-3
        return math.nan
