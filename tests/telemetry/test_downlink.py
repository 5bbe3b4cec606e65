"""Which packet is sent next: priorities, budget, what is counted as not sent."""

import math
from collections import Counter
from collections.abc import Callable, Iterable

import numpy as np
import pytest

from drivers.records import Batch, Severity
from onboard.flight.health.status import NO_HEALTH
from onboard.telemetry.downlink import Downlink
from onboard.telemetry.packets import KINDS, LONGEST, Packet
from tests.telemetry.rows import FLIGHT, NAMES, SECOND_NS, START_NS, downlink, estimates, health, said, sent

STEP_NS = 50_000_000


def flown(link: Downlink, seconds: float, feed: Callable[[int], Iterable[Batch]]) -> list[tuple[int, Packet]]:
    """Packets of so many seconds; ``feed(now_ns)`` gives the rows of each step."""
    found = []
    for now_ns in range(START_NS, START_NS + round(seconds * SECOND_NS), STEP_NS):
        for batch in feed(now_ns):
            link.add(batch)
        found += [(now_ns, packet) for packet in sent(link, now_ns)]
    return found


def kinds(packets: list[tuple[int, Packet]]) -> Counter[str]:
    return Counter(packet.kind.name for _, packet in packets)


def flood(now_ns: int) -> list[Batch]:
    """Events without end, some severe, phases that change, answers with reasons that change: every 50 ms."""
    changes = [said(now_ns, f"phase {now_ns // STEP_NS % 5}", code="phase")]
    events = [said(now_ns, f"{now_ns} {n}", Severity(n % 3)) for n in range(20)]
    reasons = estimates(now_ns, why=f"weak by {now_ns}", level=1)
    return [health(now_ns), reasons, *changes, *events]


@pytest.mark.parametrize(
    "bytes_s",
    [100, pytest.param(400, marks=pytest.mark.campaign), 1200, pytest.param(10_000, marks=pytest.mark.campaign)],
)  # between the others, and more than enough
def test_status_and_answers_never_starve(bytes_s: int) -> None:
    link = downlink(bytes_s=bytes_s)
    packets = flown(link, 60.0, flood)
    taken = sum(packet.kind.length for _, packet in packets)
    assert 0.9 * 60 * bytes_s < taken <= 60 * bytes_s + max(LONGEST, bytes_s / 2)
    of = kinds(packets)
    assert set(of) >= set(KINDS) - {"reason", "report", "failure"}
    each = Counter(packet.values["quantity"] for _, packet in packets if packet.kind.name == "answer")
    assert len(each) == len(NAMES)
    assert max(each.values()) - min(each.values()) <= 1
    if bytes_s >= 1200:
        assert of["status"] >= 59
        assert min(each.values()) >= 29
        assert link.unsent.overdue == 0
    else:
        assert of["status"] * KINDS["status"].length >= 0.3 * 60 * min(bytes_s, 200)
        assert of["answer"] * KINDS["answer"].length >= 0.1 * 60 * bytes_s
        assert link.unsent.overdue > 0


def test_what_was_not_sent_is_what_is_missing() -> None:
    link = downlink(bytes_s=400)
    packets = flown(link, 60.0, flood)
    of, unsent, steps = kinds(packets), link.unsent, 60 * 20
    assert 0 <= len(NAMES) * steps - of["answer"] - unsent.answers <= len(NAMES)
    assert 0 <= 21 * steps - of["event"] - unsent.events <= link.waiting
    assert steps - (of["phase"] + unsent.phases) in range(-12, 2)  # every fifth second one without a change
    last = [packet for _, packet in packets if packet.kind.name == "status"][-1]
    assert 0 < last.values["unsent_answers"] <= unsent.answers
    assert 0 < last.values["unsent_events"] <= unsent.events
    assert last.values["overdue"] <= unsent.overdue


def test_changes_that_come_too_fast_are_counted() -> None:
    link = downlink()
    codes = iter(range(1000))
    packets = flown(link, 10.0, lambda now_ns: [said(now_ns, f"phase {next(codes)}", code="phase")])
    told = {packet.values["phase"] for _, packet in packets if packet.kind.name == "phase"} - {-1}
    assert 40 <= len(told) <= 51
    assert len(told) + link.unsent.phases == 200 - (199 not in told)


def test_severe_events_come_first_and_the_least_are_left_out() -> None:
    link = downlink(bytes_s=2000)
    for number in range(300):
        link.add(said(START_NS, f"note {number}"))
    link.add(said(START_NS, "it is broken", Severity.ERROR))
    link.add(said(START_NS, "it is strange", Severity.WARNING))
    packets = flown(link, 1.0, lambda now_ns: [])
    events = [packet.values["text"] for _, packet in packets if packet.kind.name == "event"]
    assert events[:2] == ["it is broken", "it is strange"]
    assert events[2] == "note 46"  # the oldest of the least serious made way
    assert link.unsent.events == 46


def test_an_answer_is_the_newest_and_its_time_that_of_its_row() -> None:
    link = downlink(answers_hz=1.0)
    packets = flown(link, 5.0, lambda now_ns: [estimates(now_ns - 1000)])
    answers = [(now, packet) for now, packet in packets if packet.kind.name == "answer"]
    assert len(answers) == 5 * len(NAMES)
    for now_ns, packet in answers:
        number = NAMES.index(packet.values["quantity"])
        assert packet.values["value"] == np.float32((now_ns - 1000) * 1e-9 + number)
        assert abs(packet.at_ns - (now_ns - 1000 - FLIGHT.monotonic_ns + FLIGHT.wall_clock_ns)) <= 60
        assert (packet.values["supported"], packet.values["level"], packet.values["unit"]) == ("yes", "good", "kg")


def test_an_answer_that_does_not_come_is_not_late() -> None:
    link = downlink()
    packets = flown(
        link, 60.0, lambda now_ns: [estimates(now_ns)] if now_ns in (START_NS, START_NS + 50 * SECOND_NS) else []
    )
    assert kinds(packets)["answer"] == 2 * len(NAMES)
    assert link.unsent.overdue == 0
    assert link.unsent.answers == 0


def test_what_is_not_to_be_used_has_no_numbers() -> None:
    link = downlink()
    link.add(estimates(START_NS, supported=0, level=2, why=b"signs"))
    packets = sent(link, START_NS)
    answers = [packet.values for packet in packets if packet.kind.name == "answer"]
    assert len(answers) == 2  # as far as the budget goes
    for values in answers:
        assert (values["supported"], values["level"]) == ("no", "do not use")
        assert all(math.isnan(values[name]) for name in ("value", "low", "high", "low_999", "high_999", "sigma"))


def test_parameters_of_the_regression_are_not_sent() -> None:
    link = downlink()
    packets = flown(link, 10.0, lambda now_ns: [estimates(now_ns, unit=b"")])
    assert kinds(packets)["answer"] == 0


def test_reasons_come_when_they_change_and_not_at_every_change() -> None:
    link = downlink()

    def feed(now_ns: int) -> list[Batch]:
        why = f"leans on {now_ns // STEP_NS % 7} %"
        return [estimates(now_ns, ("m",), why=why, level=int(now_ns > START_NS + 9e9))]

    packets = flown(link, 20.0, feed)
    reasons = [(now, packet.values["level"]) for now, packet in packets if packet.kind.name == "reason"]
    assert [level for _, level in reasons] == ["good", "good", "weak", "weak", "weak"]
    assert reasons[2][0] - START_NS - 9 * SECOND_NS <= 2 * STEP_NS
    assert link.unsent.reasons > 100


def test_the_status_says_how_the_flight_stands() -> None:
    link = downlink()
    link.add(said(START_NS - SECOND_NS, "run: every device answers", code="mode"))
    link.add(said(START_NS, "phase 4", code="phase"))
    link.add(
        health(START_NS, status_latched=5, status_word=4, rows=10**12, rows_hz=5e3, clocks_locked=3, clocks_invalid=1)
    )
    status, flight, phase, *_ = sent(link, START_NS + SECOND_NS // 2)
    values = status.values
    assert next(iter(values)) == "latched"
    assert (values["latched"], values["word"], values["mode"], values["phase"]) == (5, 4, "run", 4)
    assert (values["rows"], values["rows_hz"], values["health_age"]) == (10**12, 5e3, 0.5)
    assert (values["clocks_locked"], values["clocks_not_locked"]) == (3, 1)
    assert math.isnan(values["temperature"])
    assert flight.values["wall_clock"] == FLIGHT.wall_clock_ns
    assert (phase.values["mode"], phase.values["phase"], phase.values["age"]) == ("run", 4, 0.5)


def test_a_status_without_health_is_never_a_go() -> None:
    link = downlink()

    def word(now_ns: int) -> tuple[int, int]:
        status = next(packet for packet in sent(link, now_ns) if packet.kind.name == "status")
        return status.values["latched"], status.values["word"]

    assert word(START_NS) == (NO_HEALTH, NO_HEALTH)
    link.add(health(START_NS + SECOND_NS))
    assert word(START_NS + 2 * SECOND_NS) == (0, 0)
    assert word(START_NS + 5 * SECOND_NS) == (NO_HEALTH, NO_HEALTH)  # the supervisor is silent
    link.add(health(START_NS + 6 * SECOND_NS, status_latched=2, status_word=2))
    assert word(START_NS + 7 * SECOND_NS) == (NO_HEALTH | 2, 2)
