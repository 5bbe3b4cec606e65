"""A recorder with rings made by hand, stepped by the test."""

import numpy as np

from drivers.records import Severity
from onboard.recording.reader import LogReader
from onboard.recording.recorder import EVENT_CHANNEL, GAP_CHANNEL, Recorder
from onboard.recording.writer import LogWriter
from tests.recording.logs import READING, FailingSink

STEP_NS = 50_000_000


class FakeRing:
    """Hands out the rows that the test gives it, as a ring would."""

    def __init__(self, name, dtype=READING):
        self.name, self.dtype, self.capacity = name, dtype, 10**9
        self.next = []

    @property
    def backlog(self):
        return sum(len(rows) + lost for rows, lost in self.next)

    def read(self, limit=None):
        return self.next.pop(0) if self.next else (np.empty(0, self.dtype), 0)


class Bench:
    """A recorder on a disk that fails on demand."""

    def __init__(self, path, *rings, space=None):
        self.sink = FailingSink(path)
        self.path = path
        self.writer = LogWriter(self.sink)
        self.recorder = Recorder(self.writer, rings, space=space)
        self.now_ns = 0

    def step(self):
        self.now_ns += STEP_NS
        return self.recorder.step(self.now_ns)

    def log(self):
        assert not self.recorder.close(self.now_ns + STEP_NS).failing
        log = LogReader(self.path)
        assert log.complete
        return log


def gaps(log):
    return [(row["channel"], int(row["first_missing"]), int(row["last_missing"])) for row in log.read(GAP_CHANNEL)]


def events(log):
    return [(Severity(row["severity"]).name, row["code"].decode()) for row in log.read(EVENT_CHANNEL)]
