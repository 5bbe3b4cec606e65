"""Sync pulse generator: pulses of the published code on an output line, and CANopen SYNC messages.

The schedule gives the nominal time of pulse n and of SYNC k. The device records when each was really sent; use that
record, not the schedule, as the time of an edge. An edge or a SYNC overdue by a whole SYNC period would be mistaken for
the next one: it is skipped and recorded as a gap.

Known limit: Linux without PREEMPT_RT wakes a process 50 us to some milliseconds late. ``onboard.timebase`` rejects an
edge more than 0.2 ms off its place; if that happens often, use a timer peripheral or a microcontroller.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from drivers.errors import ConfigurationError
from drivers.ports import CanPort, PulseOutputPort
from drivers.records import CAN_SYNC, PULSE, Batch, Severity
from drivers.reporter import Reporter
from drivers.sync_pulse.code import CODE_LENGTH, cycle_sync_periods, dither_ns, sync_numbers

SYNC_COB_ID = 0x080  # CiA 301, 7.2.5
SYNC_ROUND = 240  # 1019h
LEAD_SYNC_PERIODS = 4  # from the start to pulse 0
MOST_IN_ONE_PUMP = 1024
_NEVER = 1 << 63


class ScheduledPulse(NamedTuple):
    """Pulse ``number`` (from 0, not modulo the code) rises at ``rise_ns``, in the period of SYNC ``sync_number``."""

    number: int
    sync_number: int
    rise_ns: int


class PulseSchedule:
    """Nominal times of the pulses and SYNCs.

    Args:
        start_ns: When SYNC 0 is sent and pulse 0 rises, CLOCK_MONOTONIC.
        sync_period_ns: SYNC period.
    """

    def __init__(self, start_ns: int, sync_period_ns: int) -> None:
        self.start_ns = start_ns
        self.sync_period_ns = sync_period_ns

    def sync_ns(self, number: int) -> int:
        """Nominal time of SYNC ``number``, ns."""
        return self.start_ns + number * self.sync_period_ns

    def pulse(self, number: int) -> ScheduledPulse:
        """Pulse ``number``; the code repeats after 32768 pulses, the number does not."""
        cycle, place = divmod(number, CODE_LENGTH)
        sync_number = cycle * cycle_sync_periods() + int(sync_numbers()[place])
        return ScheduledPulse(number, sync_number, self.sync_ns(sync_number) + int(dither_ns()[place]))


@dataclass(frozen=True)
class PulseGeneratorConfig:
    """Configuration of the pulses.

    Attributes:
        sync_period_ms: SYNC period, ms: above the dither of 1 ms.
        width_ms: Pulse width: below the sample period of every recorder on the line, so that it marks one sample, and
            above the time constants of their input filters.
        sync_name: Channel of the SYNCs sent, if there is a CAN port.
    """

    sync_period_ms: float = 5.0
    width_ms: float = 0.5
    sync_name: str = "sync_sent"

    def __post_init__(self) -> None:
        if not self.sync_period_ms > 1.0:
            raise ConfigurationError(f"sync_period_ms = {self.sync_period_ms}: give more than the dither of 1 ms")
        if not 0.0 < self.width_ms < self.sync_period_ms:
            raise ConfigurationError(f"width_ms = {self.width_ms}: above 0, below the SYNC period")

    @property
    def sync_period_ns(self) -> int:
        """SYNC period, ns."""
        return round(self.sync_period_ms * 1e6)

    @property
    def width_ns(self) -> int:
        """Length of a pulse, ns."""
        return round(self.width_ms * 1e6)


class _Output:
    """Rows of one output, numbered as scheduled; numbers that were not sent become gaps."""

    def __init__(self, channel: str, dtype: DTypeLike, report: Reporter) -> None:
        self._channel = channel
        self._dtype = dtype
        self._report = report
        self._rows: list[tuple[int, ...]] = []
        self._lost: tuple[int, str, int] | None = None  # first number, cause, since when
        self.next = 0
        self.sent = 0
        self.latest_ns = 0

    def went_out(self, late_ns: int, *row: int) -> None:
        """``next`` was sent ``late_ns`` after its nominal time; ``row`` lacks its sequence."""
        self.close(row[0])
        self._rows.append((self.next, *row))
        self.next += 1
        self.sent += 1
        self.latest_ns = max(self.latest_ns, late_ns)

    def failed(self, now_ns: int, cause: str, count: int = 1) -> None:
        """``count`` numbers from ``next`` on are not sent."""
        if self._lost is None:
            self._lost = self.next, cause, now_ns
        self.next += count

    def close(self, now_ns: int) -> None:
        """Record the numbers not sent as a gap."""
        if self._lost is not None:
            first, cause, since_ns = self._lost
            span_ns = max(now_ns - since_ns, 0)
            self._report.gap(now_ns, self._channel, first, self.next - 1, span_ns, cause, counted=True)
            self._lost = None

    def hand_over(self) -> None:
        """Pass the rows to the reporter."""
        if self._rows:
            rows = np.zeros(len(self._rows), self._dtype)
            rows[:] = self._rows
            self._rows.clear()
            self._report.rows(self._channel, rows)


class PulseGenerator:
    """Drives the sync line, and sends SYNC with counter where it is given a CAN port; a ``drivers.device.Device``.

    A PULSE row per pulse, on the channel of its name: ``sequence`` and ``line_sequence`` are the pulse's number, the
    line was set between ``edge_ns`` and ``host_ns``. A CAN_SYNC row per SYNC: ``tick`` is its number, ``host_ns`` the
    stamp after it was queued. Gap causes: ``host_late``, ``bus_error``.

    Args:
        name: Channel, and source of its events.
        line: The output; its ``wait_until`` paces the pulses.
        clock: CLOCK_MONOTONIC, ns.
        config: The pulses.
        can: Port that sends SYNC; a dedicated one, frames it receives are discarded.
    """

    def __init__(
        self,
        name: str,
        line: PulseOutputPort,
        clock: Callable[[], int],
        config: PulseGeneratorConfig | None = None,
        can: CanPort | None = None,
    ) -> None:
        self.name = name
        self.config = PulseGeneratorConfig() if config is None else config
        self.schedule: PulseSchedule | None = None
        self._line = line
        self._clock = clock
        self._can = can
        self._report = Reporter(name)
        self._begin()

    def _begin(self) -> None:
        self._pulses = _Output(self.name, PULSE, self._report)
        self._syncs = _Output(self.config.sync_name, CAN_SYNC, self._report)
        self._rose_ns = 0
        self._fall_due_ns: int | None = None
        self._failing: set[str] = set()

    @property
    def period_ns(self) -> int:
        """0: ``pump`` waits for the next pulse or SYNC."""
        return 0

    def start(self, now_ns: int) -> list[Batch]:
        """Schedule pulse 0 and SYNC 0 a few SYNC periods from now. Every start restarts the code."""
        self._begin()
        start_ns = now_ns + LEAD_SYNC_PERIODS * self.config.sync_period_ns
        self.schedule = PulseSchedule(start_ns, self.config.sync_period_ns)
        text = f"pulse 0 and SYNC 0 are due at {start_ns} ns, SYNC every {self.config.sync_period_ms} ms"
        self._report.event(now_ns, Severity.INFO, "started", text)
        return self._report.take()

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Send the pulses and SYNCs due up to ``timeout_s`` from now, each at its time."""
        schedule = self.schedule
        if schedule is None:
            return []
        until_ns = now_ns + round(timeout_s * 1e9)
        for _ in range(MOST_IN_ONE_PUMP):
            fall_ns = _NEVER if self._fall_due_ns is None else self._fall_due_ns
            pulse = schedule.pulse(self._pulses.next)
            sync_ns = _NEVER if self._can is None else schedule.sync_ns(self._syncs.next)
            due_ns = min(fall_ns, pulse.rise_ns, sync_ns)
            if due_ns > until_ns:
                if timeout_s > 0.0:
                    self._line.wait_until(until_ns)
                break
            self._line.wait_until(due_ns)
            if due_ns == fall_ns:
                self._fall()
            elif due_ns == pulse.rise_ns:
                self._rise(pulse)
            else:
                self._send_sync(schedule)
        self._discard_received()
        self._pulses.hand_over()
        self._syncs.hand_over()
        return self._report.take()

    def stop(self, now_ns: int) -> list[Batch]:
        """Set the line low; report the largest delays."""
        if self.schedule is not None:
            if self._fall_due_ns is not None:
                self._fall()
            self.schedule = None
            for output in (self._pulses, self._syncs):
                output.close(now_ns)
                output.hand_over()
            text = (
                f"stopped after {self._pulses.sent} pulses, the latest {self._pulses.latest_ns // 1000} us late, "
                f"and {self._syncs.sent} SYNCs, the latest {self._syncs.latest_ns // 1000} us"
            )
            self._report.event(now_ns, Severity.INFO, "stopped", text)
        self._report.flush(now_ns)
        return self._report.take()

    def _rise(self, pulse: ScheduledPulse) -> None:
        now_ns = self._clock()
        if now_ns - pulse.rise_ns >= self.config.sync_period_ns:
            self._late(now_ns, self._pulses, 1, f"pulse {pulse.number}", pulse.rise_ns)
            return
        try:
            driven = self._line.drive(True)
        except OSError as error:
            self._failed(now_ns, self._pulses, f"sync line cannot be driven ({error}): check its chip and line number")
            return
        self._works(driven.after_ns, "sync line")
        late_ns = driven.before_ns - pulse.rise_ns
        self._pulses.went_out(late_ns, driven.after_ns, driven.before_ns, pulse.number % (1 << 32))
        self._rose_ns = driven.before_ns
        self._fall_due_ns = driven.after_ns + self.config.width_ns

    def _fall(self) -> None:
        self._fall_due_ns = None
        try:
            driven = self._line.drive(False)
        except OSError as error:
            now_ns = self._clock()
            text = f"sync line cannot be driven low ({error}): its next edge will be missing"
            self._report.event(now_ns, Severity.ERROR, "bus_error", text)
            return
        high_ns = driven.after_ns - self._rose_ns
        if high_ns > 2 * self.config.width_ns:
            text = f"pulse {self._pulses.next - 1} was high for {high_ns // 1000} us: it may mark two samples"
            self._report.event(driven.after_ns, Severity.WARNING, "pulse_wide", text)

    def _send_sync(self, schedule: PulseSchedule) -> None:
        number = self._syncs.next
        now_ns = self._clock()
        late_ns = now_ns - schedule.sync_ns(number)
        overdue = late_ns // self.config.sync_period_ns
        if overdue > 0:
            self._late(now_ns, self._syncs, overdue, f"{overdue} SYNCs from {number}", schedule.sync_ns(number))
            return
        counter = number % SYNC_ROUND + 1
        try:
            if self._can is not None:
                self._can.send(SYNC_COB_ID, bytes((counter,)))
        except OSError as error:
            self._failed(now_ns, self._syncs, f"SYNC cannot be sent ({error}): check that the interface is up")
            return
        host_ns = self._clock()
        self._works(host_ns, "CAN bus")
        self._syncs.went_out(late_ns, host_ns, number, counter)

    def _late(self, now_ns: int, output: _Output, count: int, what: str, due_ns: int) -> None:
        output.failed(now_ns, "host_late", count)
        text = f"{what} not sent, {(now_ns - due_ns) // 1000} us late: give this process a real-time priority"
        self._report.event(now_ns, Severity.WARNING, "host_late", text)

    def _failed(self, now_ns: int, output: _Output, text: str) -> None:
        where = "sync line" if output is self._pulses else "CAN bus"
        output.failed(now_ns, "bus_error")
        if where not in self._failing:
            self._failing.add(where)
            self._report.event(now_ns, Severity.ERROR, "bus_error", text)

    def _works(self, now_ns: int, where: str) -> None:
        if where in self._failing:
            self._failing.remove(where)
            self._report.event(now_ns, Severity.INFO, "bus_recovered", f"{where} works again")

    def _discard_received(self) -> None:
        """Discard frames of other nodes. A failing port is reported when SYNC is sent."""
        if self._can is not None:
            try:
                self._can.receive(0.0)
            except OSError as error:
                if "CAN bus" not in self._failing:
                    self._failing.add("CAN bus")
                    self._report.event(self._clock(), Severity.ERROR, "bus_error", f"CAN bus fails ({error}): check it")
