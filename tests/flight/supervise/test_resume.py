"""Modes of a flight, and its checkpoint on disk: which flight a start goes on with, and what it refuses to believe."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from drivers.records import SCALAR, Severity
from onboard import config
from onboard.flight.estimate.phases import KnownPhases, PhaseTrack
from onboard.flight.supervise import resume
from onboard.flight.supervise.modes import KEEP_S, Mode, Modes
from onboard.flight.supervise.resume import FlightState, Keeper, ResumeError, digest, load, path_of, planned
from onboard.ring import RingWriter

NOW_NS = 1_800_000_000_000_000_000
PHASE_4 = KnownPhases(4, begun=True, taken=False, gone=False)


@pytest.fixture(scope="module")
def vehicle() -> config.Vehicle:
    return config.load(config.packaged("rocksat"))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "rocksat-007.mcap"


def kept(vehicle: config.Vehicle, log: Path, known: KnownPhases | None = PHASE_4, at_ns: int = NOW_NS) -> Path:
    """The checkpoint of a flight that was killed."""
    keeper = Keeper(planned(vehicle, log, at_ns, set()), lambda: at_ns)
    keeper.keep(Mode.RUN, known)
    keeper.close(ended=False)
    log.touch()
    return path_of(log)


def test_a_start_goes_on_with_the_flight_that_lost_its_power(vehicle: config.Vehicle, log: Path) -> None:
    path = kept(vehicle, log)
    assert path.stat().st_mode & 0o777 == 0o600
    plan = planned(vehicle, log.with_name("rocksat-008.mcap"), NOW_NS + 60_000_000_000, set())
    assert plan.before == load(path)
    assert (plan.log.name, plan.first) == ("rocksat-007-part2.mcap", "rocksat-007")
    resumed = plan.vehicle.file.estimation.phases
    assert resumed is not None
    assert resumed.resumed is not None
    assert resumed.resumed.log == log.name
    assert PhaseTrack(resumed).known == PHASE_4
    again = Keeper(plan, lambda: NOW_NS)  # its power is lost before it is armed: the first checkpoint still holds
    again.close(ended=False)
    plan.log.touch()
    assert planned(vehicle, log.with_name("rocksat-008.mcap"), NOW_NS, set()).log.name == "rocksat-007-part3.mcap"
    again = Keeper(plan, lambda: NOW_NS)
    again.keep(Mode.RUN, PHASE_4)
    again.close(ended=False)
    assert list(log.parent.glob("*.resume")) == [path_of(plan.log)]
    assert list(log.parent.glob("*.new")) == []
    third = planned(vehicle, log.with_name("rocksat-008.mcap"), NOW_NS, set())
    assert (third.log.name, third.first) == ("rocksat-007-part3.mcap", "rocksat-007")
    Keeper(third, lambda: NOW_NS).close(ended=True)
    assert list(log.parent.glob("*.resume")) == []


def test_what_is_no_reason_to_go_on_begins_a_new_flight(
    vehicle: config.Vehicle, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, new = kept(vehicle, log), log.with_name("rocksat-008.mcap")
    assert planned(vehicle, new, NOW_NS, {log.absolute()}).log == new  # that flight is under way
    fresh = planned(vehicle, new, NOW_NS, set(), fresh=True)
    assert (fresh.log, fresh.before, fresh.superseded) == (new, None, (path,))
    late = planned(vehicle, new, NOW_NS + 3601 * 10**9, set())
    assert late.log == new
    assert "3601 s ago" in late.why_not
    early = planned(vehicle, new, 0, set())  # a computer without a clock
    assert early.before is not None
    other = config.load(config.packaged("rocksat_mixed"))
    assert planned(other, log.with_name("rocksat_mixed-001.mcap"), NOW_NS, set()).why_not == ""
    monkeypatch.setattr(resume, "digest", lambda _: "0" * 64)
    changed = planned(vehicle, new, NOW_NS, set())
    assert (changed.log, changed.before) == (new, None)
    assert "another vehicle file" in changed.why_not


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-40]),
        lambda path: path.write_bytes(re.sub(rb'"phase": 4', b'"phase": 5', path.read_bytes())),
        lambda path: path.write_bytes(re.sub(rb'"log": "', b'"log": "../', path.read_bytes())),
        lambda path: path.write_bytes(b"[" * 60_000),
        lambda path: path.write_bytes(b"\xff\x00"),
        lambda path: path.write_bytes(b"7"),
        lambda path: path.write_bytes(path.read_bytes() + b" " * 65_536),
        lambda path: path.chmod(0o644),
        lambda path: (path.unlink(), os.mkfifo(path, 0o600)),
        lambda path: (path.rename(path.with_name("x")), path.symlink_to(path.with_name("x"))),
    ],
)
def test_a_checkpoint_that_is_not_as_written_is_refused_with_a_reason(
    vehicle: config.Vehicle, log: Path, spoil: object
) -> None:
    path = kept(vehicle, log)
    assert callable(spoil)
    spoil(path)
    with pytest.raises((ResumeError, OSError)):
        load(path)
    plan = planned(vehicle, log.with_name("rocksat-008.mcap"), NOW_NS, set())
    assert plan.before is None
    assert str(path) in plan.why_not
    assert plan.superseded == ()  # what it does not know it does not remove


def test_a_state_with_a_right_crc_is_still_checked() -> None:
    good = {"first": "a-001", "log": "a-001.mcap", "vehicle": "a", "digest": "0" * 64, "mode": "run", "phase": None}
    good |= {"begun": True, "taken": False, "gone": False, "wall_clock_ns": 1}
    whole = FlightState.model_validate(good)
    assert FlightState.from_bytes(whole.to_bytes()) == whole
    assert whole.phases is None
    for bad in ({"first": "../../x"}, {"mode": "safe"}, {"wall_clock_ns": 1 << 70}, {"phase": 1.5}, {"digest": "x"}):
        data = json.dumps({**json.loads(whole.to_bytes()), **bad}).encode()
        with pytest.raises(ResumeError):
            FlightState.from_bytes(data)


def test_a_disk_that_refuses_a_checkpoint_is_told_once(
    vehicle: config.Vehicle, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    keeper = Keeper(planned(vehicle, tmp_path / "none" / "a-001.mcap", NOW_NS, set()), lambda: NOW_NS)
    for _ in range(3):
        keeper.keep(Mode.RUN, None)
    keeper.close(ended=True)
    assert [record.getMessage().count("no checkpoint") for record in caplog.records] == [1]


class Kept:
    """Keeps in a list."""

    def __init__(self) -> None:
        self.states: list[tuple[Mode, KnownPhases | None]] = []
        self.ended: bool | None = None

    def keep(self, mode: Mode, known: KnownPhases | None) -> None:
        self.states.append((mode, known))

    def close(self, *, ended: bool) -> None:
        self.ended = ended


def test_modes_follow_devices_and_phases_and_each_change_is_an_event(vehicle: config.Vehicle, tmp_path: Path) -> None:
    ring = RingWriter(tmp_path / "arm_phase.ring", SCALAR, 100)
    said: list[tuple[Severity, str]] = []
    keeper = Kept()
    modes = Modes(vehicle, tmp_path, lambda severity, code, source, text: said.append((severity, text)), keeper)

    def phase(code: int) -> None:
        row = np.zeros(1, SCALAR)
        row["value_raw"] = code
        ring.push(row)

    devices = dict.fromkeys(("imu_base", "can_sync", "joint_1", "load_cell", "pulse"), 1)
    modes.step(0.0, {})
    assert modes.mode is Mode.BOOT
    modes.at_work(1.0)
    modes.step(2.0, devices | {"imu_base": 0})
    assert modes.mode is Mode.CHECKOUT
    phase(0)
    modes.step(3.0, devices)
    assert modes.mode is Mode.ARMED
    modes.step(3.0 + KEEP_S, devices)
    phase(3)
    modes.step(14.0, devices)
    phase(4)
    modes.step(15.0, devices)
    assert modes.mode is Mode.RUN
    phase(5)
    phase(5)
    modes.step(16.0, devices)
    modes.end("the mission's end phase")
    modes.step(17.0, devices)
    modes.stopped()
    modes.close()
    assert keeper.ended
    assert [text.partition(":")[0] for _, text in said] == [mode.value for mode in Mode]
    assert {severity for severity, _ in said} == {Severity.INFO}
    states = [(mode.value, known.phase, known.gone) for mode, known in keeper.states if known]
    assert states == [
        ("armed", 0, False), ("armed", 0, False), ("run", 3, False), ("run", 4, False), ("run", 5, True)
    ]  # fmt: skip


def test_a_checkout_does_not_wait_for_ever_and_an_error_is_no_end(vehicle: config.Vehicle, tmp_path: Path) -> None:
    RingWriter(tmp_path / "arm_phase.ring", SCALAR, 100)
    said: list[tuple[Severity, str]] = []
    keeper = Kept()
    modes = Modes(vehicle, tmp_path, lambda severity, code, source, text: said.append((severity, text)), keeper)
    modes.at_work(0.0)
    modes.step(9.9, {"imu_base": 5})
    assert modes.mode is Mode.CHECKOUT
    modes.step(10.0, {"imu_base": 5})
    assert modes.mode is Mode.ARMED
    assert said[-1][0] is Severity.WARNING
    assert "without" in said[-1][1]
    assert "joint_1" in said[-1][1]
    modes.end("")
    modes.close()
    assert said[-1][0] is Severity.ERROR
    assert keeper.ended is False


def test_the_digest_is_of_file_and_urdf(vehicle: config.Vehicle, tmp_path: Path) -> None:
    urdf = tmp_path / "other.urdf"
    urdf.write_text(vehicle.urdf_text + "\n", encoding="utf-8")
    assert digest(config.load(vehicle.path, urdf)) != digest(vehicle) == digest(config.load(vehicle.path))
