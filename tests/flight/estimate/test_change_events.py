"""Changes of the payload as events of a log, and read from them again."""

import numpy as np
import pytest

from drivers.records import Severity, event
from onboard.flight.estimate.answers import PAYLOAD_CHANGES, change_event, change_of
from onboard.identification.online import Change


@pytest.mark.parametrize("kind", PAYLOAD_CHANGES)
@pytest.mark.parametrize(("since_s", "score"), [(116.013, 5.0), (116.3, np.nan)])
def test_a_change_is_read_from_its_event(kind: str, since_s: float, score: float) -> None:
    found = change_of(change_event(117_300_000_000, Change(kind, 116.3, since_s, score)).rows[0])
    assert found is not None
    ten_ms = 0.0101
    assert (found.kind, found.time_s, found.since_s) == (
        kind,
        pytest.approx(116.3, abs=ten_ms),
        pytest.approx(since_s, abs=ten_ms),
    )


@pytest.mark.parametrize("kind", ["release_contradicted", "capture_contradicted"])
def test_a_rejected_announcement_is_read_at_the_time_of_its_event(kind: str) -> None:
    found = change_of(change_event(10**9, Change(kind, 0.9, 0.9, np.nan, "x")).rows[0])
    assert found is not None
    assert (found.kind, found.time_s, found.since_s) == (kind, 1.0, 1.0)


@pytest.mark.parametrize("kind", ["left_out", "taken_back"])
def test_an_instrument_left_out_or_taken_back_is_read_from_its_event(kind: str) -> None:
    found = change_of(change_event(10**9, Change(kind, 0.9, 0.9, np.nan, "imu_2")).rows[0])
    assert found is not None
    assert (found.kind, found.what, found.time_s) == (kind, "imu_2", 1.0)
    other = change_of(change_event(10**9, Change("capture", 0.9, 0.9, np.nan, "imu_2")).rows[0])
    assert other is not None
    assert (other.kind, other.what) == ("capture", "")


def test_other_events_are_no_changes() -> None:
    others = [
        change_event(10**9, Change("absent", 0.5, 0.5, np.nan, "x")),
        event(10**9, Severity.INFO, "phase", "estimation", "phase 1, 0.50 s ago"),
    ]
    others += [event(10**9, Severity.INFO, "capture", "arm", "capture 0.50 s ago")]
    others += [event(10**9, Severity.INFO, "capture", "estimation", "capture")]
    assert [change_of(one.rows[0]) for one in others] == [None] * 4
