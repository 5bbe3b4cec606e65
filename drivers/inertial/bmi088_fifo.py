"""FIFOs of a BMI088: frames of the accelerometer with its sensor time, samples of the gyroscope, paired into rows.

Source: data sheet BST-BMI088-DS001, and the frames' headers as Bosch publishes them (BMI08x_SensorAPI). Accelerometer:
1024 bytes of frames. Who reads beyond the last one gets a frame of the sensor time: its samples fall on multiples of
their period in it, so that each one's time is known, and a loss is counted to the sample. What was not lost goes on
where the last drain ended, since a sample and the sensor time may be told in either order. A frame that was cut comes
again, whole. Gyroscope: 100 samples without a time, of which the count says how many were made until it was read.

A row is of a sample of the accelerometer; its rates lie on the line between the gyroscope's two samples around it, and
before its first and behind its last one are those of that one.
Known limits: tags of the interrupt pins are not used. The gyroscope's overrun is cleared by a write that empties it.
"""

import errno
from collections import deque
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import FrameError
from drivers.i2c.sensor import MS, Watched
from drivers.inertial.bmi088 import FILTERS, TICK_NS, TICKS, Bmi088, Bmi088Config
from drivers.inertial.sample_clock import SampleClock
from drivers.ports import I2cPort
from drivers.records import IMU, Rows, SampleStatus, Severity

FIFO_LENGTH, FIFO_DATA, FIFO_DOWNS, FIFO_CONFIG_0, FIFO_CONFIG_1 = 0x24, 0x26, 0x45, 0x48, 0x49
GYRO_FIFO_STATUS, GYRO_FIFO_CONFIG_0, GYRO_FIFO_CONFIG_1, GYRO_FIFO_DATA = 0x10E, 0x13D, 0x13E, 0x13F
EVERY_FILTERED, STREAM, ACC_ON, GYRO_STREAM = 0x80, 0x02, 0x50, 0x80
FIFO_BYTES, GYRO_FRAMES, GYRO_FRAME_BYTES, OVERRUN = 1024, 100, 6, 0x80
ACC, TIME, SKIP, EMPTY, TAGS = 0x84, 0x44, 0x40, 0x80, 0x03
PAYLOADS = {ACC: 6, TIME: 3, SKIP: 1, 0x48: 1, 0x50: 1}  # the last two: of an input configuration, of a drop
BEYOND = 11  # bytes: a frame that was made meanwhile, and the sensor time
MOST_READS = 8  # until the sensor time is told
SILENCE_NS = 100 * MS
KEPT = 8  # samples of the gyroscope, until its period is known: the line may have to begin among them
EDGE = 2  # ticks about a sample in which sensor time and FIFO may not agree on it
READS, FEWEST, FEWEST_NS = 128, 32, 500 * MS  # for the length of a tick
TURNS = 3  # in which the least delayed readings are those of the slope that they give


ON = Watched(GYRO_FIFO_CONFIG_1, GYRO_STREAM, 0x00), Watched(FIFO_CONFIG_1, ACC_ON, 0x10)


class ForceFrames(NamedTuple):
    """Words (n, 3) of specific force, the sensor time behind them, None where the FIFO had more; samples skipped."""

    words: NDArray[np.int16]
    ticks: int | None
    skipped: bool


def decode_frames(data: bytes) -> ForceFrames:
    """ForceFrames of the accelerometer's FIFO; one that is cut at the end is left out, as are bytes behind the last.

    Raises:
        FrameError: A header that no frame has.
    """
    words, at, ticks, skipped = bytearray(), 0, None, False
    while at < len(data) and ticks is None:
        header = data[at] & ~TAGS
        if header == EMPTY:
            break
        size = PAYLOADS.get(header)
        if size is None:
            raise FrameError(f"{data[at]:02x}h is no header of a frame of a BMI088: check the bus")
        payload = data[at + 1 : at + 1 + size]
        if len(payload) < size:
            break
        if header == ACC:
            words += payload
        elif header == TIME:
            ticks = int.from_bytes(payload, "little")
        skipped = skipped or header == SKIP
        at += 1 + size
    return ForceFrames(np.frombuffer(bytes(words), "<i2").reshape(-1, 3), ticks, skipped)


class TickTime:
    """Host time as a function of the sensor time: a line through the least delayed of its last readings.

    Attributes:
        tick_ns: Length of a tick.
    """

    def __init__(self) -> None:
        self._read: deque[tuple[int, int]] = deque(maxlen=READS)
        self.tick_ns = TICK_NS
        self._late_ns = 0.0  # of the last reading

    def observe(self, ticks: int, host_ns: int) -> None:
        """The sensor time was ``ticks``, counted on, at ``host_ns`` or before."""
        self._read.append((ticks, host_ns))
        at, stamps = (np.array(self._read) - self._read[-1]).T  # (n,)
        if -stamps[0] > FEWEST_NS and len(at) >= FEWEST:
            third = len(at) // 3
            for _ in range(TURNS):
                late_ns = stamps - at * self.tick_ns
                first, last = np.argmin(late_ns[:third]), len(at) - third + np.argmin(late_ns[-third:])
                self.tick_ns = float(stamps[last] - stamps[first]) / float(at[last] - at[first])
        self._late_ns = -float((stamps - at * self.tick_ns).min())

    def host_ns(self, ticks: NDArray[np.int64]) -> NDArray[np.float64]:
        """When the sensor time was ``ticks`` (n,)."""
        last, last_ns = self._read[-1]
        return np.asarray(last_ns - self._late_ns + (ticks - last) * self.tick_ns, np.float64)


class Bmi088Fifo(Bmi088):
    """A BMI088 drained from its FIFOs. See ``Bmi088``.

    ``tick``: the sensor time of the sample, counted on beyond its 24 bits. ``host_ns``: the stamp of the reading of the
    sensor time, less what the sample was old then.
    """

    def __init__(self, name: str, port: I2cPort, config: Bmi088Config | None = None, bus: str = "I2C") -> None:
        super().__init__(name, port, config, bus)
        codes = FILTERS[self.config.filter_code]
        self._period = round(1e9 / codes.accel_rate_hz / TICK_NS)  # ticks
        self._gyro_period_ns = round(1e9 / codes.gyro_rate_hz)
        self._wide: tuple[int, int, int] | None = None  # sensor time as it was read, counted on, and its stamp
        self._row_tick: int | None = None  # of the last row
        self._row_ns = self._sampled_ns = 0
        self._fills = False  # samples go into the FIFOs
        self._following = 0  # number of the gyroscope's next sample
        self._restarted = self._is_anew = True  # the latter: no sample is recorded since
        self._forget()

    def _forget(self) -> None:
        """What was taken of the FIFOs is not continued."""
        self._gyro_lost = self._lost = True
        self._undated = np.zeros((0, 3), np.int16)
        self._forces = np.zeros((0, 3), np.int16), np.zeros(0, np.int64), np.zeros(0, np.int64)  # words, ticks, host_ns
        self._rates = np.zeros((0, 3), np.int16), np.zeros(0, np.int64)  # words, numbers

    def _watched(self) -> list[Watched]:
        return [
            *super()._watched(),
            Watched(GYRO_FIFO_CONFIG_0, 0x00, 0x00),
            Watched(FIFO_DOWNS, EVERY_FILTERED, 0x80),
            Watched(FIFO_CONFIG_0, STREAM, 0x02),
            *(ON if self._fills else ()),
        ]

    def _set_up(self) -> Iterator[int]:
        self._fills = False
        yield from super()._set_up()

    def _begin(self, now_ns: int, anew: bool) -> str:
        said = super()._begin(now_ns, anew)
        if not self._fills:
            for one in ON:
                self._bus.write(one.register, one.value)
            self._fills = True
            self._restarted = self._is_anew = True
            self._following = 0
            self._ticks, self._clock = TickTime(), SampleClock(self._gyro_period_ns)
        self._forget()
        self._sampled_ns = now_ns
        return said.replace("a reading", "its FIFOs are drained")

    def _interrupt(self, cause: str) -> None:
        super()._interrupt(cause)
        self._forget()

    def _take(self, now_ns: int) -> None:
        self._warm(now_ns)
        if not self._take_forces(now_ns):
            return
        self._take_rates(now_ns)
        self._pair(now_ns)
        if now_ns - self._sampled_ns > SILENCE_NS:
            text = "no samples of both its dies although configured: the chip is reset"
            self._report.event(now_ns, Severity.ERROR, "no_samples", text)
            self._set_up_again(now_ns, "no_samples")

    def _take_forces(self, now_ns: int) -> bool:
        """Drain the accelerometer; False: its sensor time did not go on, and it is set up again. Raises OSError."""
        reply = self._bus.read(FIFO_LENGTH, 2)
        count, asked_ns = int.from_bytes(reply.data, "little"), min(now_ns, reply.host_ns)
        if count > FIFO_BYTES:
            raise OSError(errno.EBADMSG, f"FIFO counts {count} bytes")
        left, more = count + BEYOND, BEYOND
        most = FIFO_BYTES // self.config.max_transfer_bytes + MOST_READS
        for number in range(most):
            data, host_ns = self._bus.pop(FIFO_DATA, min(max(left, more), self.config.max_transfer_bytes))
            more *= 2  # while it was read, others were made
            try:
                frames = decode_frames(data)
            except FrameError as error:
                raise OSError(errno.EBADMSG, str(error)) from error
            self._undated = np.concatenate((self._undated, frames.words))
            self._lost = self._lost or frames.skipped
            left -= 7 * len(frames.words)
            is_sure = frames.ticks is not None and EDGE <= frames.ticks % self._period < self._period - EDGE
            if frames.ticks is not None and (is_sure or not self._lost or number == most - 1):
                if not self._goes_on(frames.ticks, min(asked_ns, host_ns), host_ns):
                    self._stands_still(now_ns)
                    return False
                self._seen = frames.ticks, min(asked_ns, host_ns), host_ns
                self._date(frames.ticks, host_ns)
                return True
            asked_ns = host_ns
        return True

    def _date(self, ticks: int, host_ns: int) -> None:
        """Give the frames that were read their times: the newest is of the last multiple of a period."""
        wide = ticks
        if self._wide is not None:
            before, counted, before_ns = self._wide
            due = round((host_ns - before_ns) / TICK_NS)
            went = (ticks - before) % TICKS
            wide = counted + (due if self._restarted else went + TICKS * round((due - went) / TICKS))
        self._wide, self._restarted = (ticks, wide, host_ns), False
        self._ticks.observe(wide, host_ns)
        count = len(self._undated)
        at = wide - ticks % self._period - self._period * np.arange(count - 1, -1, -1)
        known = self._forces[1][-1] if len(self._forces[1]) else self._row_tick
        if count and known is not None:
            off = at[0] - known - self._period
            if off < -self._period:
                raise OSError(errno.EBADMSG, "FIFO holds more frames than were made")
            if not self._lost and off <= self._period:
                at -= off
        self._lost = self._lost and not count
        stamps = np.rint(host_ns - (wide - at) * self._ticks.tick_ns).astype(np.int64)
        words, ats, hosts = self._forces
        self._forces = np.concatenate((words, self._undated)), np.append(ats, at), np.append(hosts, stamps)
        self._undated = self._undated[:0]

    def _take_rates(self, now_ns: int) -> None:
        """Drain the gyroscope. Raises OSError."""
        status, host_ns = self._bus.read(GYRO_FIFO_STATUS)
        asked_ns = min(self._seen[2] if self._seen else now_ns, host_ns)
        count = status[0] & ~OVERRUN
        if count > GYRO_FRAMES:
            raise OSError(errno.EBADMSG, f"FIFO counts {count} samples")
        if self._clock and (self._gyro_lost or status[0] & OVERRUN):
            self._following = max(self._following, self._clock.produced(host_ns) - count)
        self._clock.observe(host_ns, self._following + count, asked_ns)
        read = np.arange(self._following, self._following + count)
        data, self._gyro_lost = b"", True
        longest = self.config.max_transfer_bytes // GYRO_FRAME_BYTES * GYRO_FRAME_BYTES
        while len(data) < count * GYRO_FRAME_BYTES:
            data += self._bus.pop(GYRO_FIFO_DATA, min(count * GYRO_FRAME_BYTES - len(data), longest)).data
        self._following += count
        words, numbers = self._rates
        self._rates = np.concatenate((words, np.frombuffer(data, "<i2").reshape(-1, 3))), np.append(numbers, read)
        if status[0] & OVERRUN:
            self._bus.write(GYRO_FIFO_CONFIG_1, GYRO_STREAM)
            self._cause = self._cause or "fifo_overflow"
        else:
            self._gyro_lost = False

    def _pair(self, now_ns: int, is_end: bool = False) -> None:
        """Rows of the samples of the accelerometer between two of the gyroscope; at the end of those behind, too."""
        (forces, ticks, stamps), (rates, numbers) = self._forces, self._rates
        if not len(ticks) or len(numbers) < 2:
            return
        times, made = self._ticks.host_ns(ticks), self._clock.made_ns(numbers + 1)
        slack_ns = 2 * self._gyro_period_ns
        due = times <= made[-1] + slack_ns * is_end
        after = np.searchsorted(made, times[due], "left").clip(1, len(made) - 1)
        if due.any():
            before = after - 1
            share = (times[due] - made[before]) / (made[after] - made[before])  # (n,)
            is_first = (numbers[before] == 0) & (times[due] > made[0] - slack_ns)
            share = np.where(is_first, np.maximum(share, 0.0), share)
            share = np.minimum(share, 1.0) if is_end else share
            is_paired = (numbers[after] - numbers[before] == 1) & (share >= 0.0) & (share <= 1.0)
            between = rates[before] + share[:, None] * (rates[after].astype(float) - rates[before])
            own = _at_ends(rates[before]) | _at_ends(rates[after]) | _at_ends(forces[due])
            rows = self._rows(forces[due], np.rint(between), own)
            rows["tick"], rows["host_ns"] = ticks[due], stamps[due]
            self._hand_over(now_ns, rows[is_paired])
        self._forces = forces[~due], ticks[~due], stamps[~due]
        kept = slice(max(int(np.searchsorted(made, times[-1])) - KEPT, 0), None)  # the next forces follow on the last
        self._rates = rates[kept], numbers[kept]

    def _rows(self, forces: NDArray[np.int16], rates: NDArray[np.float64], at_ends: NDArray[np.bool_]) -> Rows:
        rows = np.zeros(len(forces), IMU)
        rows["accel_scale_m_s2"], rows["gyro_scale_rad_s"] = self.config.accel_scale_m_s2, self.config.gyro_scale_rad_s
        rows["accel_raw"], rows["gyro_raw"], rows["temperature_raw"] = forces, rates, self._temperature
        rows["filter_code"] = self.config.filter_code
        rows["status"] = at_ends * np.uint8(SampleStatus.SATURATED)
        return rows

    def _hand_over(self, now_ns: int, rows: Rows) -> None:
        """Number the rows by their ticks; record those that are missing between them."""
        if not len(rows):
            return
        ticks = rows["tick"].astype(np.int64)
        first = ticks[0] - self._period if self._row_tick is None else self._row_tick
        steps = np.maximum(np.rint(np.diff(ticks, prepend=first) / self._period).astype(np.int64), 1)
        numbers = self._next - 1 + np.cumsum(steps)
        rows["sequence"] = numbers
        rows["host_ns"] = np.maximum.accumulate(np.maximum(rows["host_ns"], self._row_ns))
        rows["status"][0] |= self._first
        begins = [*np.flatnonzero(steps > 1).tolist(), len(rows)]
        if begins[0]:
            self._report.rows(self.name, rows[: begins[0]])
        for begin, end in pairwise(begins):
            lost, last = int(steps[begin]) - 1, int(numbers[begin]) - 1
            cause = self._cause or "fifo_overflow"
            took_ns = round(lost * self._period * TICK_NS)
            self._report.gap(now_ns, self.name, last - lost + 1, last, took_ns, cause, counted=not self._is_anew)
            self._cause = ""
            self._report.rows(self.name, rows[begin:end])
        self._cause, self._first, self._is_anew = "", SampleStatus.OK, False
        self._next, self._row_tick, self._row_ns = int(numbers[-1]) + 1, int(ticks[-1]), int(rows["host_ns"][-1])
        self._sampled_ns = now_ns

    def _sleep(self, now_ns: int) -> None:
        self._pair(now_ns, is_end=True)
        super()._sleep(now_ns)

    def _finish(self, now_ns: int) -> str:
        self._row_tick = self._wide = None
        return f"{self._next} samples"


def _at_ends(words: NDArray[np.int16]) -> NDArray[np.bool_]:
    """Which of the samples (n, 3) have a word at an end of its range."""
    return np.asarray(((words == 32767) | (words == -32768)).any(axis=1))
