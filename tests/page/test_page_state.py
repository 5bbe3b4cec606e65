"""The page is sent what the rows say, of a log and of rings."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers import records
from drivers.records import Batch
from onboard import channels
from onboard.flight.health.status import Status
from onboard.flight.store import manifest
from onboard.identification import quantities, standing
from onboard.page import state as states
from onboard.page.follow import Followed, LogFrames, packed, payload_of
from onboard.page.state import PageState
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.page.made import MARKUP, SECOND, START, Rings, flight
from tests.recording.logs import make_log


def whole(*, live: bool = False) -> PageState:
    state = PageState("made", "payload", live=live)
    for channel, rows in flight():
        for first in range(0, len(rows), 100):
            state.add(Batch(channel, rows[first : first + 100]))
    return state


def by_name(found: list[dict]) -> dict[str, dict]:
    return {one["name"]: one for one in found}


def test_its_levels_and_the_body_are_those_of_the_estimator() -> None:
    assert tuple(str(level) for level in standing.LEVELS) == states.LEVELS
    assert states.BODY == quantities.BODY
    assert set(states.KINDS) == set(quantities.BODY_UNITS)


def test_numbers_of_a_frame_are_those_of_the_log_to_the_last_bit(made_log: Path) -> None:
    found, log = LogFrames(LogReader(made_log)), LogReader(made_log)
    quantity, joint, row = log.read("quantity"), log.read("joint_1"), log.read("row")
    frames = [json.loads(found.frame(number)) for number in range(len(found))]
    assert len(frames) == 100
    assert [frame["t"] for frame in frames] == found.about()["steps"]
    compared = 0
    for frame in frames:
        now_ns = START + round(frame["t"] * SECOND)
        rows = quantity[quantity["host_ns"] <= now_ns]
        for name, shown in by_name(frame["held"]).items():
            last = rows[rows["name"] == name.encode()][-1]
            for key in ("value", "low", "high", "low_999", "high_999"):
                assert shown[key] == last[key]
            assert (shown["supported"], shown["level"]) == (bool(last["supported"]), states.LEVELS[last["level"]])
            compared += 1
        [device] = frame["devices"]
        came = joint["host_ns"][joint["host_ns"] <= now_ns]
        assert (device["rows"], device["age_s"]) == (len(came), pytest.approx((now_ns - came[-1]) * 1e-9))
        measured = row[(row["host_ns"] <= now_ns) & np.isfinite(row["joint_rad"][:, 0])]
        assert frame["joints"] == pytest.approx(measured[-1]["joint_rad"].tolist(), abs=1e-5)
    assert compared >= 3 * 15
    assert frames[-1]["t"] == 10.0


def test_a_device_has_its_rate_gaps_clock_and_age() -> None:
    [device] = whole().frame()["devices"]
    assert device["rate_hz"] == pytest.approx(100.0)  # rows that came, not their numbers
    assert (device["nominal_hz"], device["gaps"], device["missing"], device["clock"]) == (100.0, 1, 7, "locked")
    assert device["sigma_us"] == pytest.approx(8.7)
    assert device["age_s"] == pytest.approx(0.01)
    [silent] = whole().frame(START + 20 * SECOND)["devices"]
    assert (silent["rate_hz"], silent["age_s"]) == (0.0, pytest.approx(10.01))


def test_processes_computer_and_what_is_not_known() -> None:
    frame = whole().frame()
    acquisition = by_name(frame["processes"])["acquisition"]
    assert acquisition == {"name": "acquisition", "cpu_percent": 12.5, "pss_mb": 17.0}
    assert frame["computer"]["temperature_deg_c"] is None
    assert (frame["mode"], frame["phase"]) == ("run", "phase <b>1</b>")
    assert "NaN" not in packed(frame)


class TestGo:
    def word(self, state: PageState, **more: object) -> tuple[str, list[str]]:
        go = state.frame(**more)["go"]  # type: ignore[arg-type]
        return go["word"], [f"{one['kind']}: {one['text']}" for one in go["reasons"]]

    def test_all_good_and_nothing_fails(self) -> None:
        assert self.word(whole()) == ("GO", ["note: all numbers of what is held are good, and nothing fails"])

    def test_before_an_estimate(self) -> None:
        state = PageState("made", live=True)
        assert self.word(state)[0] == "NO-GO"
        state.add(flight()[0])
        assert "open: nothing is estimated yet" in self.word(state)[1]

    def test_a_weak_answer_names_itself_and_its_reason(self) -> None:
        state = whole()
        rows = flight()[2].rows[:3].copy()
        rows["level"] = [1, 2, 2]
        rows["why"] = [b"its interval contains zero", b"no payload explains the motion", b""]
        state.add(Batch("quantity", rows))
        word, reasons = self.word(state)
        assert word == "NO-GO"
        assert reasons == [
            "open: m_payload: weak: its interval contains zero",
            "against: c_x_payload: do not use: no payload explains the motion",
        ]  # and not the instrument's

    def test_no_value_of_an_answer_that_is_withdrawn_is_told(self) -> None:
        state = PageState("made", live=False)
        rows = flight()[2].rows[-3:].copy()
        rows["supported"], rows["level"] = 1, [2, 0, 0]
        state.add(Batch("quantity", rows))
        held = by_name(state.frame()["held"])
        assert [held[name]["supported"] for name in ("m_payload", "c_x_payload")] == [False, True]
        assert [len(state.history()[name]) for name in ("m_payload", "c_x_payload")] == [0, 1]

    def test_of_ten_numbers_those_of_the_payload_count_alone(self) -> None:
        rows = np.zeros(11, channels.QUANTITY)
        rows["host_ns"], rows["supported"] = START, 1
        rows["name"] = [f"{kind}_payload".encode() for kind in quantities.BODY] + [b"m_link_1"]
        rows["unit"] = [unit.encode() for unit in quantities.BODY_UNITS] + [b"kg"]
        rows["level"][-1] = 2
        state = PageState("made", "payload", live=False)
        state.add(Batch("quantity", rows))
        assert self.word(state)[0] == "GO"
        other = PageState("made", "", live=False)
        other.add(Batch("quantity", rows))
        assert self.word(other)[0] == "NO-GO"

    @pytest.mark.parametrize("bit", list(Status))
    def test_a_bit_of_the_status_is_a_reason_or_a_note(self, bit: Status) -> None:
        state = whole()
        health = flight()[3].rows[-1:].copy()
        health["status_word"] = health["status_latched"] = int(bit)
        state.add(Batch("health", health))
        word, [reason] = self.word(state)
        assert word == ("GO" if bit in states.CAUTION else "NO-GO")
        assert reason.startswith("note: " if bit in states.CAUTION else "against: ")

    def test_a_flight_whose_supervisor_is_silent(self) -> None:
        word, [reason] = self.word(whole(live=True), now_ns=START + 15 * SECOND)
        assert (word, reason.startswith("against: no health record for 5 s")) == ("NO-GO", True)
        assert self.word(whole(live=True), now_ns=START + 12 * SECOND)[0] == "GO"
        word, [reason] = self.word(whole(live=True), now_ns=START + 99 * SECOND, ended=True)
        assert (word, reason) == ("GO", "note: the flight has ended: these are its last numbers")


def test_a_long_flight_keeps_so_many_points_and_events() -> None:
    state = PageState("long", live=True)
    row, event = flight()[2].rows[-3:-2].copy(), np.zeros(1, records.EVENT)
    for step in range(20_000):
        row["host_ns"] = event["host_ns"] = START + step * SECOND
        state.add(Batch("quantity", row))
        state.add(Batch("event", event))
    points = state.history()["m_payload"]
    assert states.POINTS // 2 <= len(points) <= states.POINTS
    assert points[0][0] == 0.0
    assert points[-1][0] > 19_900
    assert (len(state.events()), state.event_count) == (states.EVENTS, 20_000)
    assert [one["n"] for one in state.events(19_998)] == [19_998, 19_999]


@pytest.mark.realtime
def test_rings_say_what_the_log_says(rings: Rings) -> None:
    followed = Followed(rings.log)
    followed.look()
    assert followed.about()["live"]
    rings.push(flight())
    followed.look()
    shown, logged = followed.state.frame(START + 10 * SECOND), whole(live=True).frame(START + 10 * SECOND)
    assert shown["title"] == "made: made.mcap"
    for key in ("held", "processes", "computer", "mode", "phase", "event_count", "go", "t", "joints"):
        assert shown[key] == logged[key]
    [mine], [theirs] = shown["devices"], logged["devices"]
    assert {key: mine[key] for key in ("rows", "missing", "age_s")} == {
        key: theirs[key] for key in ("rows", "missing", "age_s")
    }
    followed.close()


def test_a_flight_of_another_version_beside_it_does_not_end_the_page(rings: Rings, tmp_path: Path) -> None:
    with manifest.new_flight(tmp_path / "aaa.mcap", "other") as directory:
        (directory / "manifest.json").write_text("{}")
        followed = Followed(rings.log)
        followed.look()
        assert followed.state.title == "made.mcap"
        (directory / "manifest.json").unlink()
        followed.look()
        assert followed.state.title == "made: made.mcap"
    followed.close()


def test_rows_overwritten_before_they_are_read_are_counted(rings: Rings) -> None:
    followed = Followed(rings.log)
    followed.look()
    events = np.zeros(1500, records.EVENT)
    for _ in range(2):
        rings.writers["event"].push(events)
    followed.look()
    assert followed.state.lost == 3000 - 2048
    followed.close()


@pytest.mark.parametrize(
    "text", [b"", b"\xff", b"vehicle = 3", b"[vehicle]\npayload_link = 3", b"[vehicle", b"[vehicle]\nname = 'x'"]
)
def test_a_vehicle_file_that_names_no_payload(text: bytes) -> None:
    assert payload_of({}, {"vehicle.toml": text}) == ""
    assert payload_of({}, {}) == ""


def test_texts_come_as_they_are_and_controls_as_escapes() -> None:
    state = whole()
    assert state.events()[2]["text"] == MARKUP.decode()
    events = np.zeros(1, records.EVENT)
    events["text"] = b"a\x1b[31m\xff\nb"
    state.add(Batch("event", events))
    assert state.events()[-1]["text"] == "a\\x1b[31m\\xff\\nb"


def test_numbers_that_are_none_and_levels_of_another_version() -> None:
    rows = np.zeros(1, channels.QUANTITY)
    rows["name"], rows["unit"], rows["supported"], rows["level"] = b"m_payload", b"kg", 1, 77
    rows["value"], rows["low"], rows["high"] = np.nan, -np.inf, np.inf
    state = PageState("made", live=False)
    state.add(Batch("quantity", rows))
    clock = np.zeros(1, channels.CLOCK)
    clock["state"], clock["sigma_ns"], clock["channel"] = 99, np.inf, b"joint_1"
    state.add(Batch("clock", clock))
    [held] = json.loads(packed(state.frame()))["held"]
    assert (held["value"], held["low"], held["high"], held["level"]) == (None, None, None, "do not use")
    assert state.history() == {"m_payload": []}


def test_a_log_from_time_zero_and_one_without_rows(tmp_path: Path) -> None:
    rows = np.zeros(50, records.IMU)
    rows["sequence"], rows["host_ns"] = range(50), np.arange(50) * 10_000_000
    make_log(tmp_path / "bare.mcap", {"imu_0": rows})
    found = LogFrames(LogReader(tmp_path / "bare.mcap"))
    assert found.about()["steps"][-1] == pytest.approx(0.49)
    with LogWriter.create(tmp_path / "empty.mcap", durable=False) as writer:
        writer.register("imu_0", records.IMU)
    with pytest.raises(ValueError, match="has no rows"):
        LogFrames(LogReader(tmp_path / "empty.mcap"))


def test_frames_of_a_long_log_are_thinned(monkeypatch: pytest.MonkeyPatch, made_log: Path) -> None:
    monkeypatch.setattr("onboard.page.follow.FRAMES", 8)
    found = LogFrames(LogReader(made_log))
    assert 4 <= len(found) <= 9
    assert found.about()["steps"][-1] == 10.0
