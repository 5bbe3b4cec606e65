"""Events that do not flood, and nothing dropped in silence."""

from drivers.records import Severity
from drivers.reporter import REPEAT_NS, Reporter
from tests.drivers.batches import codes, of, texts


def test_a_repeated_event_is_held_back_and_counted():
    reporter = Reporter("imu")
    for place in range(10):
        reporter.event(place, Severity.WARNING, "bad", "again")
    reporter.event(REPEAT_NS, Severity.WARNING, "bad", "again")
    reporter.event(REPEAT_NS + 1, Severity.WARNING, "bad", "again")
    batches = reporter.take()
    assert texts(batches, "bad") == ["again", "(+9 before) again"]
    reporter.flush(REPEAT_NS + 2)
    assert texts(reporter.take(), "bad") == ["1 more of this event since it was last reported"]
    assert reporter.take() == []


def test_events_of_other_codes_and_sources_are_not_held_back():
    reporter = Reporter("bus")
    reporter.event(0, Severity.INFO, "a", "1")
    reporter.event(0, Severity.INFO, "b", "2")
    reporter.event(0, Severity.INFO, "a", "3", source="node")
    batches = reporter.take()
    assert codes(batches) == ["a", "b", "a"]
    assert of(batches, "event")["source"].tolist() == [b"bus", b"bus", b"node"]


def test_gaps_are_never_held_back_and_no_rows_are_no_batch():
    reporter = Reporter("bus")
    for place in range(3):
        reporter.gap(place, "imu", place, place, 5, "lost")
    reporter.rows("imu", of([], "imu"))
    batches = reporter.take()
    assert [batch.channel for batch in batches] == ["gap"] * 3
