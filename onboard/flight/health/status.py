"""The status word of a flight: which bits it has, and how they read."""

from enum import IntFlag


class Status(IntFlag):
    """Bits of ``HEALTH``: ``status_word`` those of the last second, ``status_latched`` all since the start."""

    STREAM_SILENT = 1 << 0
    STREAM_SLOW = 1 << 1
    ROWS_MISSING = 1 << 2
    RECORDER_BEHIND = 1 << 3
    ROWS_NOT_RECORDED = 1 << 4
    ESTIMATOR_LATE = 1 << 5
    ESTIMATOR_SKIPS = 1 << 6
    WORKER_DOWN = 1 << 7
    TICKS_MISSED = 1 << 8
    CLOCK_FLYWHEEL = 1 << 9
    CLOCK_INVALID = 1 << 10
    DISK_REFUSES = 1 << 11
    DISK_LOW = 1 << 12
    MEMORY_LOW = 1 << 13
    CPU_BUSY = 1 << 14
    HOT = 1 << 15
    THROTTLED = 1 << 16
    UNDERVOLTAGE = 1 << 17
    NOT_REALTIME = 1 << 18


NO_HEALTH = 1 << 31  # in the words of a downlink: no health record for three seconds, what they say is old
CAUTION = (  # shown, and no reason against going on: the numbers of the flight are not touched by them
    Status.ROWS_MISSING
    | Status.RECORDER_BEHIND
    | Status.TICKS_MISSED
    | Status.CLOCK_FLYWHEEL
    | Status.MEMORY_LOW
    | Status.CPU_BUSY
    | Status.HOT
    | Status.THROTTLED
    | Status.NOT_REALTIME
)
SILENT_S = 5.0  # after the start: a device may take so long to be set up
SLOW = 0.9  # of the nominal rate
BACKLOG = 0.5  # of a ring
LATE_S = 1.0
HOT_DEG_C = 80.0
LITTLE_MEMORY, LITTLE_IDLE = 0.05, 0.05

MEANINGS = {
    Status.STREAM_SILENT: (
        f"a channel with a rate brought no row for a second and five periods, from {SILENT_S:g} s after the start on"
    ),
    Status.STREAM_SLOW: f"a device channel came at less than {100 * SLOW:g} % of its nominal rate",
    Status.ROWS_MISSING: "a gap record was written",
    Status.RECORDER_BEHIND: f"a ring is filled to {100 * BACKLOG:g} % with rows that are not in the log",
    Status.ROWS_NOT_RECORDED: "the recorder lost rows; `recorder_gap` names them",
    Status.ESTIMATOR_LATE: f"the estimator is more than {LATE_S:g} s behind the devices",
    Status.ESTIMATOR_SKIPS: "the estimator left rows out to catch up",
    Status.WORKER_DOWN: "a worker died, was started again, or does not answer",
    Status.TICKS_MISSED: "a worker's tick came while its step before still ran",
    Status.CLOCK_FLYWHEEL: "a device's clock is extrapolated: its marks stopped or contradict it",
    Status.CLOCK_INVALID: "a device's clock is not valid",
    Status.DISK_REFUSES: "a write to the log failed, and none has succeeded since",
    Status.DISK_LOW: "the disk is nearly full: only events and gaps are recorded",
    Status.MEMORY_LOW: f"less than {100 * LITTLE_MEMORY:g} % of the memory is available",
    Status.CPU_BUSY: f"less than {100 * LITTLE_IDLE:g} % of the cores' time was idle",
    Status.HOT: f"a thermal zone is at {HOT_DEG_C:g} deg C or above",
    Status.THROTTLED: "the computer runs slower than it could: too hot, or too little voltage",
    Status.UNDERVOLTAGE: "the supply voltage is too low",
    Status.NOT_REALTIME: "a setting of `[realtime]` was refused by the system",
}


def words(word: int) -> str:
    """The bits of a status word in words; ``ok`` for none."""
    word = int(word)  # rows hold unsigned ones
    known = [str(bit.name).lower().replace("_", " ") for bit in Status if bit & word]
    other = word & ~sum(Status) & ~NO_HEALTH
    known += ["health not known"] if word & NO_HEALTH else []
    return ", ".join([*known, *([f"bits 0x{other:x}"] if other else [])]) or "ok"


def standing(word: int, latched: int) -> str:
    """Both words in one line: ``status ok (before: rows missing)``."""
    before = latched & ~word
    return f"status {words(word)}" + (f" (before: {words(before)})" if before else "")
