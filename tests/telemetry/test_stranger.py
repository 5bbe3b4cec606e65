"""An independent XTCE reader decodes the packets of a flight by our mission database, to the numbers of its log."""

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from space_packet_parser.generators.ccsds import ccsds_generator
from space_packet_parser.xtce.definitions import XtcePacketDefinition
from space_packet_parser.xtce.validation import validate_xtce

from drivers.records import EVENT as EVENT_ROW
from onboard import channels
from onboard.config.telemetry import Telemetry
from onboard.recording.format.texts import printable
from onboard.telemetry import xtce
from onboard.telemetry.packets import KINDS
from onboard.telemetry.replay import packets_of
from tests.flight.missions import Result
from tests.telemetry.rows import FLIGHT, START_NS, downlink, estimates, health, said
from tests.telemetry.test_packets import made

NUMBERS = ("value", "low", "high", "low_999", "high_999", "sigma")
QUANTITIES = ("m_arm", "m_arm+m_tip_mass", "ZZ_joint_1_R_held")  # of RockSat's five


def definition(tmp_path: Path, quantities: tuple[str, ...] = (), name: str = "rocksat") -> XtcePacketDefinition:
    path = tmp_path / "heft.xml"
    path.write_text(xtce.database(name, Telemetry().apids, quantities), encoding="utf-8")
    assert validate_xtce(path, level="all").valid
    return XtcePacketDefinition.from_xtce(path, root_container_name=xtce.ROOT)


def read(what: XtcePacketDefinition, data: bytes) -> list[dict[str, Any]]:
    return [dict(what.parse_bytes(packet)) for packet in ccsds_generator(data)]


def same(a: float, b: float) -> bool:
    return a == b or (math.isnan(a) and math.isnan(b))


@pytest.fixture(scope="module")
def sent(short_mission: Result) -> bytes:
    return b"".join(one.packet for one in packets_of(short_mission.log, Telemetry(answers_hz=5, bytes_s=10_000), 9))


@pytest.mark.parametrize("quantities", [(), QUANTITIES])
def test_answers_are_those_of_the_log(
    sent: bytes, short_mission: Result, tmp_path: Path, quantities: tuple[str, ...]
) -> None:
    logged = {
        (printable(row["name"]), int(row["host_ns"])): row
        for batch in short_mission.log.batches()
        if channels.is_quantity(batch.rows.dtype)
        for row in batch.rows
    }
    times = np.array(sorted({at_ns for _, at_ns in logged}))
    seen: Counter[str] = Counter()
    for packet in read(definition(tmp_path, quantities), sent):
        if packet["apid"] != 257:
            continue
        name = str(packet["answer_quantity"])
        at_ns = int(times[np.argmin(np.abs(times * 1e-9 - packet["time"]))])
        assert abs(packet["time"] - at_ns * 1e-9) < 1e-7
        row = logged[name, at_ns]
        assert packet["answer_supported"] == ("yes" if row["supported"] else "no")
        assert packet["answer_level"] == ("good", "weak", "do not use")[row["level"]]
        prefix = "answer" if name not in quantities else name.replace("+", "_")
        for number in NUMBERS:
            wanted = float(np.float32(row[number])) if row["supported"] else math.nan
            assert same(packet[f"{prefix}_{number}"], wanted)
        seen[name] += 1 + int(row["supported"]) * 1000
    assert len(seen) == 5
    assert all(count > 5000 for count in seen.values())


def test_events_are_those_of_the_log(sent: bytes, short_mission: Result, tmp_path: Path) -> None:
    logged = [row for batch in short_mission.log.batches() if batch.rows.dtype == EVENT_ROW for row in batch.rows]
    told = Counter(
        (str(packet["event_severity"]), *(str(packet[f"event_{key}"]) for key in ("code", "source", "text")))
        for packet in read(definition(tmp_path), sent)
        if packet["apid"] == 259
    )
    words = ("info", "warning", "error")
    assert told == Counter(
        (words[row["severity"]], *(printable(row[key]) for key in ("code", "source", "text"))) for row in logged
    )
    assert len(told) > 10


def test_every_packet_of_every_kind_is_decoded_and_its_counts_follow(sent: bytes, tmp_path: Path) -> None:
    packets = read(definition(tmp_path, QUANTITIES), sent)
    assert sum(packet["packet_data_length"] + 7 for packet in packets) == len(sent)
    assert {packet["apid"] for packet in packets} == set(range(256, 262))  # no command, no report
    for apid in Telemetry().apids.values():
        counts = [packet["sequence_count"] for packet in packets if packet["apid"] == apid]
        assert counts == list(range(len(counts)))
    assert {packet["session"] for packet in packets} == {9}


def test_the_status_is_that_of_the_health_record(tmp_path: Path) -> None:
    link = downlink()
    row = health(START_NS, status_latched=1 << 18, status_word=3, rows=2**40, gaps=7, missing=9, disk_free_mb=1234.5)
    link.add(row)
    link.add(said(START_NS, "armed: every device answers", code="mode"))
    link.add(estimates(START_NS))
    status, flight, *_ = read(definition(tmp_path), b"".join(link.packets(START_NS + 250_000_000)))
    record = row.rows[0]
    wanted = {"rows": "rows", "gaps": "gaps", "missing": "missing", "latched": "status_latched", "word": "status_word"}
    wanted |= {"disk_free": "disk_free_mb", "temperature": "temperature_deg_c", "rows_hz": "rows_hz"}
    assert all(same(status[f"status_{name}"], record[field].item()) for name, field in wanted.items())
    assert (status["status_mode"], status["status_phase"], status["status_health_age"]) == ("armed", -1, 0.25)
    assert flight["flight_wall_clock"] == FLIGHT.wall_clock_ns
    assert (flight["flight_flight"], flight["flight_vehicle"]) == (FLIGHT.flight, FLIGHT.vehicle)


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_where_the_database_says(kind: str, tmp_path: Path) -> None:
    fields, lead = ([f.name for f in these if not f.is_text and not f.choices] for these in KINDS[kind][2:4])
    given = {name: 100 + n for n, name in enumerate((*lead, *fields))}
    [packet] = read(definition(tmp_path), made(KINDS[kind], **given))
    assert {f"{kind}_{name}": given[name] for name in fields}.items() <= packet.items()
    assert {f"pus_{name.removeprefix('pus_')}": given[name] for name in lead}.items() <= packet.items()
    assert {f"{kind}_{field.name}" for field in KINDS[kind].fields} < set(packet)


def test_names_that_xtce_does_not_allow(tmp_path: Path) -> None:
    names = ("m[arm]", "m.arm", "m arm", 'a"<&>b', "other", "größe")
    what = definition(tmp_path, names, name="rock/sat [2] <b>")
    found = []
    for name in (*names, "m_new"):
        [packet] = read(what, made(KINDS["answer"], quantity=name, value=3.5))
        found += [(name, key) for key, value in packet.items() if key.endswith("_value") and value == 3.5]
    assert [name for name, _ in found] == [*names, "m_new"]
    assert len({key for _, key in found}) == len(names) + 1
    assert found[-1][1] == "answer_value"


def test_one_known_quantity(tmp_path: Path) -> None:
    what = definition(tmp_path, ("m",))
    [own], [other] = (read(what, made(KINDS["answer"], quantity=name, value=2.0)) for name in ("m", "n"))
    assert (own["m_value"], other["answer_value"]) == (2.0, 2.0)
