"""Packets found in bytes that were damaged, and what the sequence counts say of it."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.config.telemetry import Telemetry
from onboard.telemetry.packets import ANSWER, COUNTS, HEADER_BYTES, KINDS, PHASE, Packet, encode
from onboard.telemetry.replay import packets_of
from onboard.telemetry.stream import Series, Splitter
from tests.flight.missions import Result
from tests.telemetry.test_packets import APIDS, AT_NS, made, sealed, some

SECOND_NS = 1_000_000_000


def series_of(count: int, session: int = 1, first: int = 0, at_ns: int = AT_NS) -> list[bytes]:
    """Packets of three kinds in turn, by their counts."""
    kinds = list(KINDS.values())[:3]
    return [
        encode(kind, APIDS[kind.name], first + n, session, at_ns + n * SECOND_NS, some(kind))
        for n in range(count)
        for kind in kinds
    ]


def fed(data: bytes, size: int) -> tuple[list[Packet], Splitter]:
    stream = Splitter(APIDS)
    found = [packet for at in range(0, len(data), size) for packet in stream.feed(data[at : at + size])]
    return found + stream.finish(), stream


@pytest.mark.parametrize("size", [1, 7, 4096])
def test_packets_are_found_however_their_bytes_come(size: int) -> None:
    sent = series_of(5)
    found, stream = fed(b"".join(sent), size)
    assert [(packet.kind.name, packet.count) for packet in found] == [
        (name, n) for n in range(5) for name in list(KINDS)[:3]
    ]
    assert stream.skipped == 0


@pytest.mark.parametrize("size", [1, 4096])
def test_junk_between_packets_is_counted(size: int) -> None:
    one, other = made(ANSWER), made(PHASE)
    junk = b"\x09\x01\xc0\x05\x00"  # begins like a packet
    found, stream = fed(junk + one + junk + other + one[:40], size)
    assert [packet.kind for packet in found] == [ANSWER, PHASE]
    assert stream.skipped == 2 * len(junk) + 40


def test_packets_behind_a_damaged_one_are_found_even_within_its_length() -> None:
    damaged = made(ANSWER)[:50]  # cut off: the next begins within its length
    found, stream = fed(damaged + made(PHASE), 4096)
    assert [packet.kind for packet in found] == [PHASE]
    assert stream.skipped == 50


def test_packets_of_other_definitions_are_refused_once_each() -> None:
    other = bytearray(made(PHASE))
    other[14] = 99
    found, stream = fed(sealed(bytes(other)) * 3 + made(PHASE), 10)
    assert len(found) == 1
    assert [(said[:32], n) for said, n in stream.refused.items()] == [("its definitions are number 99, t", 3)]
    assert stream.skipped == 0


def placed(sent: Sequence[bytes]) -> tuple[Series, list[tuple[bool, int]]]:
    series = Series()
    return series, [tuple(series.place(packet)) for packet in fed(b"".join(sent), 4096)[0]]


def phases(*counts: int, session: int = 1, at_s: float = 0.0) -> list[bytes]:
    return [encode(PHASE, 258, n, session, AT_NS + round((n + at_s) * 1e9), some(PHASE)) for n in counts]


def test_gaps_repeats_and_late_packets_are_told() -> None:
    series, places = placed(phases(0, 1, 4, 4, 2, 5, 2))
    assert places == [(True, 0), (True, 0), (True, 2), (False, 0), (True, 0), (True, 0), (False, 0)]
    assert (series.missing, series.repeated, series.unheard) == ({"phase": 1}, 2, 0)


def test_counts_go_round() -> None:
    series, places = placed(phases(COUNTS - 2, COUNTS - 1, COUNTS, COUNTS + 3))
    assert places == [(True, 0), (True, 0), (True, 0), (True, 2)]
    assert series.unheard == COUNTS - 2


def test_a_sender_that_begins_again_is_no_gap() -> None:
    series, places = placed([*phases(8000, 8001), *phases(0, 1, session=2)])
    assert [new for new, _ in places] == [True] * 4
    assert series.missing == {"phase": 0}


def test_after_a_long_silence_packets_are_new() -> None:
    """More than half of all counts were missed."""
    _, places = placed([*phases(0), *phases(9000)])
    assert places == [(True, 0), (True, 8999)]


JUNK = st.one_of(
    st.binary(max_size=40),
    st.builds(lambda data, size: data[:size], st.sampled_from(series_of(1)), st.integers(1, 80)),  # a packet cut off
)


@given(st.lists(st.one_of(JUNK, st.sampled_from(series_of(2)))), st.integers(1, 300))
def test_every_whole_packet_between_any_bytes_is_found(pieces: list[bytes], size: int) -> None:
    whole = set(series_of(2))
    found, stream = fed(b"".join(pieces), size)
    # each is a packet that was put in, or one that the junk makes up by itself: of its own bytes
    assert len(found) >= sum(piece in whole for piece in pieces)
    assert sum(packet.kind.length for packet in found) + stream.skipped == sum(map(len, pieces))


@given(st.lists(st.integers(0, 60), min_size=1, max_size=80), st.integers(0, COUNTS - 1))
def test_counts_in_any_order_are_placed_as_a_set_of_them_says(order: list[int], first: int) -> None:
    """Drops, repeats and late packets; what came before the first is not known to be missing."""
    order = [order[0], *(n for n in order if n >= order[0])]
    series = Series()
    packets = fed(b"".join(phases(*(first + n for n in order))), 4096)[0]
    seen: set[int] = set()
    for number, packet in zip(order, packets, strict=True):
        assert series.place(packet).new == (number not in seen)
        seen.add(number)
    assert series.missing["phase"] == max(seen) - min(seen) + 1 - len(seen)
    assert series.repeated == len(order) - len(seen)


def damaged(rng: np.random.Generator, sent: list[bytes]) -> tuple[bytes, set[int]]:
    """Drops, duplicates, truncation, thirty seconds of silence, then bit errors; and which packets came whole."""
    parts: list[bytes] = []
    kept: set[int] = set()
    for number, packet in enumerate(sent):
        if len(sent) // 3 <= number < len(sent) // 3 + 90 or rng.random() < 0.02:
            continue
        if rng.random() < 0.02:
            parts.append(packet[: rng.integers(1, len(packet))])
            continue
        parts += [packet] * (2 if rng.random() < 0.03 else 1)
        kept.add(number)
    bits = np.unpackbits(np.frombuffer(b"".join(parts), np.uint8))
    wrong = rng.random(len(bits)) < 1e-4
    return np.packbits(bits ^ wrong).tobytes(), kept


def test_no_wrong_number_is_shown_on_a_bad_line(rng: np.random.Generator) -> None:
    sent = series_of(700)
    of_sent = {(packet.kind.name, packet.count): packet for packet in fed(b"".join(sent), 4096)[0]}
    shown = unshown = 0
    for _ in range(5):
        data, kept = damaged(rng, sent)
        assert data != b"".join(sent[n] for n in sorted(kept))
        stream, series = Splitter(APIDS), Series()
        got = []
        for at in range(0, len(data), 61):
            got += [packet for packet in stream.feed(data[at : at + 61]) if series.place(packet).new]
        got += [packet for packet in stream.finish() if series.place(packet).new]
        assert all(of_sent[packet.kind.name, packet.count] == packet for packet in got)
        assert len({(packet.kind.name, packet.count) for packet in got}) == len(got)  # none twice
        assert len(kept) * 0.85 < len(got) <= len(kept)
        last = {kind: max(packet.count for packet in got if packet.kind is kind) for kind in {p.kind for p in got}}
        in_all = sum(last.values()) + len(last)
        assert len(got) + sum(series.missing.values()) + series.unheard == in_all
        shown, unshown = shown + len(got), unshown + sum(series.missing.values())
    assert shown > 8000
    assert unshown > 1000


def test_a_series_is_of_a_flight_too(short_mission: Result) -> None:
    sent = list(packets_of(short_mission.log, Telemetry()))
    assert [a.at_ns <= b.at_ns for a, b in pairwise(sent)].count(False) == 0
    series, places = placed([one.packet for one in sent])
    assert places == [(True, 0)] * len(sent)
    assert len(sent) > 40
    assert all(len(one.packet) > HEADER_BYTES for one in sent)
    assert set(series.missing.values()) == {0}
