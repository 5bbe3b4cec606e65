"""What a drive's frames say of its rate, whenever they are read."""

import pytest

from drivers.canopen_pdo.play.drive_axis import CYCLIC, Cia402AxisConfig, DriveAxis
from drivers.canopen_pdo.profiles.cia402 import POSITION, Cia402Config
from drivers.canopen_pdo.sync import SyncCounter
from drivers.reporter import Reporter

MS = 1_000_000
PERIOD_MS = 5
RATE = 10_000.0  # counts/s


@pytest.fixture
def told():
    """What is wrong with a drive at a rate, after each of its answers, read when a function of the time says."""

    def of(rate, read_ms):
        sync = SyncCounter(PERIOD_MS * MS)
        config = Cia402Config(1, 100_000, position="a", status="a_status")
        limits = Cia402AxisConfig(config, "a_sent", -1_000_000, 1_000_000, RATE, 1e6, 1e6, 1000, 1000)
        axis = DriveAxis(limits, CYCLIC, sync, 100, lambda cob_id, data: None, Reporter("can_0"))
        axis.started()
        found = []
        for k in range(80):
            now_ns = read_ms(PERIOD_MS * k) * MS
            sync.advance(k + 1, now_ns)
            place = config.place(POSITION)
            data = bytearray(place.length)
            data[place.start : place.start + 4] = round(rate * 1e-3 * PERIOD_MS * k).to_bytes(4, "little", signed=True)
            for cob_id in axis.cob_ids:
                axis.on_tpdo(cob_id, now_ns, bytes(data))
            found.append(axis.unwell(now_ns, 1_000 * MS))
        return found

    return of


def late_by(late_ms, pace):
    """A reader that stands still at 150 ms, and is in time again after ``late_ms / pace``."""
    return lambda ms: round(ms + max(0.0, late_ms - pace * (ms - 150))) if ms > 150 else ms


@pytest.mark.parametrize("pace", [1.0, 0.5])
@pytest.mark.parametrize("late_ms", [0, 20, 60])
def test_frames_that_are_read_late_are_no_higher_rate(told, late_ms, pace):
    assert set(told(0.9 * RATE, late_by(late_ms, pace))) == {""}


@pytest.mark.parametrize("late_ms", [0, 60])
def test_a_drive_beyond_its_limit_is_named(told, late_ms):
    said = told(1.5 * RATE, late_by(late_ms, 1.0))
    assert said[3] == ""
    assert set(said[8:]) == {"moves at 54.0 deg/s, faster than its limit"}


@pytest.mark.parametrize(("counts", "sent"), [(-700, -500), (-500, -500), (3, 3), (800, 800), (801, 800)])
def test_a_target_beyond_the_limits_is_cut_to_them(counts, sent):
    frames = []
    config = Cia402Config(1, 100_000, position="a", status="a_status")
    limits = Cia402AxisConfig(config, "a_sent", -500, 800, RATE, 1e6, 1e6, 1000, 1000)
    sync = SyncCounter(PERIOD_MS * MS)
    DriveAxis(limits, CYCLIC, sync, 100, lambda *frame: frames.append(frame), Reporter("can_0")).target(counts)
    assert frames == [(0x301, sent.to_bytes(4, "little", signed=True))]
