"""Shared-memory broadcast ring: one writer, any number of readers, without locks.

A ring is one file (in ``/dev/shm`` in flight), so it outlives the processes that map it. The writer is independent of
readers; a reader that is too slow gets the number of rows it lost. Rows are stored as their own bytes, padding
included.

Publication is a two-counter protocol. ``claimed`` is advanced before the rows are written, ``published`` after. A
reader copies published rows, then reads ``claimed`` again: rows that the writer may have begun to overwrite meanwhile
are discarded and counted. A 32-bit multilinear check of row and position detects stores seen out of order by another
core (ARM) and a damaged ring: such a row is counted as lost and not returned.

A per-row CRC in a Python loop costs 0.3 us a row; the check is one matrix product for the whole batch.
"""

import json
import mmap
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows

_MAGIC = b"heftring1\0"
_HEADER_BYTES = 4096
_COUNTERS_AT = 64  # claimed, published: two u64
_DESCRIPTION_AT = 128
_STEP = 2654435761  # 2^32 over the golden ratio: increment of a row's check per position


class RingError(Exception):
    """Base of the ring's errors."""


class RingFormatError(RingError, ValueError):
    """The file is not a ring, or a ring of another kind of record."""


def _describe(dtype: np.dtype[np.void]) -> list[tuple[str, str, list[int]]]:
    fields = dtype.fields
    if not fields or dtype.names is None:
        raise RingFormatError(f"a ring stores structured records, not {dtype}; use a dtype of drivers.records")
    return [(name, fields[name][0].base.str, list(fields[name][0].shape)) for name in dtype.names]


def _rebuild(description: list[tuple[str, str, list[int]]]) -> np.dtype[np.void]:
    return np.dtype([(name, kind, tuple(shape)) for name, kind, shape in description], align=True)


class _Ring:
    """Memory mapping common to both ends."""

    def __init__(self, path: Path, dtype: np.dtype[np.void], capacity: int, file_descriptor: int, name: str) -> None:
        self.path, self.dtype, self.capacity, self.name = path, dtype, capacity, name
        if dtype.itemsize % 4:
            raise RingFormatError(f"{name}: record size {dtype.itemsize} is no multiple of 4; build it with align=True")
        size = _HEADER_BYTES + capacity * (dtype.itemsize + 4)
        self._map = mmap.mmap(file_descriptor, size)
        self.counters: NDArray[np.uint64] = np.frombuffer(self._map, np.uint64, 2, _COUNTERS_AT)
        words = dtype.itemsize // 4
        self.data: NDArray[np.uint32] = np.frombuffer(self._map, np.uint32, capacity * words, _HEADER_BYTES).reshape(
            capacity, words
        )
        self._checks: NDArray[np.uint32] = np.frombuffer(
            self._map, np.uint32, capacity, _HEADER_BYTES + capacity * dtype.itemsize
        )
        # odd coefficients: a change of any single word always changes the sum
        generator = np.random.Generator(np.random.PCG64(0x68656674))
        self._coefficients = generator.integers(0, 2**32, words, np.uint32) | np.uint32(1)
        self._ramp = np.arange(capacity, dtype=np.uint32) * np.uint32(_STEP)  # the share of a row's position

    @property
    def published(self) -> int:
        """Rows ever pushed."""
        return int(self.counters[1])

    def _check(self, raw: NDArray[np.uint32], first_position: int) -> NDArray[np.uint32]:
        """Check words of rows ``raw`` (n, words), the first of them at ``first_position``."""
        check: NDArray[np.uint32] = raw.dot(self._coefficients)  # faster than matmul where there is no BLAS
        check += self._ramp[: len(raw)]
        check += np.uint32(first_position * _STEP % 2**32)
        return check

    def _slots(self, first_position: int, count: int) -> list[slice]:
        """The one or two stretches of slots that positions ``first_position ..`` occupy."""
        start = first_position % self.capacity
        head = min(count, self.capacity - start)
        return [slice(start, start + head)] + ([slice(0, count - head)] if count > head else [])

    def close(self) -> None:
        """Unmap. The file stays."""
        del self.counters, self.data, self._checks
        self._map.close()


class RingWriter(_Ring):
    """The one writing end of a ring.

    Args:
        path: file to create, or an existing ring of the same record to continue.
        dtype: record, built with ``align=True``.
        capacity: rows kept.

    Raises:
        RingFormatError: the file exists and is a ring of another record or capacity.
        OSError: not enough space.
    """

    def __init__(self, path: Path, dtype: np.dtype[np.void], capacity: int) -> None:
        description = json.dumps({"capacity": capacity, "fields": _describe(dtype), "name": path.stem}).encode()
        if len(description) > _HEADER_BYTES - _DESCRIPTION_AT:
            raise RingFormatError(f"{path.stem}: the record has too many fields to describe in a ring's header")
        size = _HEADER_BYTES + capacity * (dtype.itemsize + 4)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fresh = os.fstat(descriptor).st_size == 0
            if fresh:
                try:
                    os.posix_fallocate(descriptor, 0, size)  # missing memory is an OSError here, not a SIGBUS later
                except OSError as error:
                    raise OSError(error.errno, error.strerror, str(path)) from error
            elif os.pread(descriptor, _HEADER_BYTES, 0)[_DESCRIPTION_AT:].rstrip(b"\0") != description:
                raise RingFormatError(
                    f"{path} is a ring of another record or size: remove it, or start in a new directory"
                )
            super().__init__(path, dtype, capacity, descriptor, path.stem)
        finally:
            os.close(descriptor)
        if fresh:
            self._map[_DESCRIPTION_AT : _DESCRIPTION_AT + len(description)] = description
            self._map[: len(_MAGIC)] = _MAGIC

    def newest(self) -> Rows:
        """The rows in the ring, oldest first; for a writer that continues after another died."""
        reader = RingReader(self.path)
        try:
            return reader.read()[0]
        finally:
            reader.close()

    def push(self, rows: Rows) -> int:
        """Append ``rows`` (n,); returns the position of the first. Never waits."""
        if rows.dtype is not self.dtype and rows.dtype != self.dtype:
            raise RingFormatError(f"{self.name}: rows of {rows.dtype.names} pushed into a ring of {self.dtype.names}")
        first = self.published
        count = len(rows)
        if not count:
            return first
        raw = np.ascontiguousarray(rows).view(np.uint32).reshape(count, -1)
        self.counters[0] = first + count
        slot = first % self.capacity
        if slot + count <= self.capacity:
            self.data[slot : slot + count] = raw
            self._checks[slot : slot + count] = self._check(raw, first)
            self.counters[1] = first + count
            return first
        skipped = max(0, count - self.capacity)
        raw, position = raw[skipped:], first + skipped
        checks = self._check(raw, position)
        done = 0
        for slots in self._slots(position, len(raw)):
            n = slots.stop - slots.start
            self.data[slots] = raw[done : done + n]
            self._checks[slots] = checks[done : done + n]
            done += n
        self.counters[1] = first + count
        return first


class RingReader(_Ring):
    """A reading end. Any number may exist, in any process.

    Args:
        path: an existing ring.

    Raises:
        RingFormatError: the file is not a ring.
        FileNotFoundError: there is none.
    """

    def __init__(self, path: Path) -> None:
        descriptor = os.open(path, os.O_RDWR)
        try:
            header = os.pread(descriptor, _HEADER_BYTES, 0)
            if not header.startswith(_MAGIC):
                raise RingFormatError(f"{path} is not a ring; was its writer started?")
            about = json.loads(header[_DESCRIPTION_AT:].rstrip(b"\0"))
            super().__init__(path, _rebuild(about["fields"]), about["capacity"], descriptor, about["name"])
        finally:
            os.close(descriptor)
        self.position = 0  # first row to read; rows older than the ring holds are reported as lost

    @property
    def backlog(self) -> int:
        """Number of rows pushed and not yet read."""
        return self.published - self.position

    def seek_after(self, sequence: int) -> bool:
        """Continue after the row with ``sequence`` (ascending in the ring); counts nothing as lost.

        Returns:
            Whether that row, or the one after it, was still there: nothing between is lost.
        """
        self.position = oldest = max(0, self.published - self.capacity)
        raw, good, overwritten = self._copy(oldest, self.published - oldest)
        numbers = raw[good].reshape(-1).view(self.dtype)["sequence"]
        if not len(numbers):
            return oldest == 0
        after = int(np.searchsorted(numbers, np.uint64(sequence), side="right"))
        if after:
            self.position = oldest + overwritten + int(np.flatnonzero(good)[after - 1]) + 1
        return oldest == 0 or int(numbers[0]) <= sequence + 1

    def read(self, limit: int | None = None) -> tuple[Rows, int]:
        """Unread rows (oldest first, at most ``limit``), and the number lost since the last call.

        Lost rows lie before or among those returned, as their ``sequence`` numbers show.
        """
        published = self.published
        first = max(self.position, published - self.capacity)
        count = published - first if limit is None else min(limit, published - first)
        if count <= 0:
            lost, self.position = first - self.position, first
            return np.empty(0, self.dtype), lost
        raw, good, overwritten = self._copy(first, count)
        damaged = len(good) - int(np.count_nonzero(good))
        lost = first - self.position + overwritten + damaged
        self.position = first + count
        kept = raw[good] if damaged else raw
        return kept.reshape(-1).view(self.dtype), lost

    def _copy(self, first: int, count: int) -> tuple[NDArray[np.uint32], NDArray[np.bool_], int]:
        """Rows (n, words) from position ``first`` on, whether each is good (n,), and ``count - n``: overwritten."""
        slots = self._slots(first, count)
        if len(slots) == 1:
            raw, checks = self.data[slots[0]].copy(), self._checks[slots[0]].copy()
        else:
            raw, checks = (np.concatenate([of[part] for part in slots]) for of in (self.data, self._checks))
        # rows that the writer may have begun to overwrite during the copy
        overwritten = min(count, max(0, int(self.counters[0]) - self.capacity - first))
        raw, checks = raw[overwritten:], checks[overwritten:]
        return raw, checks == self._check(raw, first + overwritten), overwritten
