"""Checkout before a flight (appendix A.1 of the dissertation): operator's steps and automatic checks, signed off.

The operator confirms power, moves each joint, unloads the cells and signs; the devices are read while that happens and
judged by the vehicle file and the URDF. An automatic check that fails can be repeated. A step that is left out is
recorded with the operator's reason: it does not pass, and a vehicle with a step that failed or was left out without a
reason is not ready. The record is written beside the flights.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drivers.records import Batch
from onboard import config
from onboard.devices import si
from onboard.devices.roles import JointRole, LoadCellKeys, LoadCellRole, Roles
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.acquire.devices import OpenDevices, open_devices
from onboard.flight.check.checkout_checks import CheckResult, judge_motion, judge_tare
from onboard.flight.check.preflight import Preflight, preflight, require_devices
from onboard.flight.clocks import sync_line
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.readings.roles import roles_of

_TARE_S = 2.0

_RANGE, _TARE = "range and sense of ", "tare of "  # names of steps, before the joint's and the cell's

PASSED, FAILED, LEFT_OUT = "passed", "failed", "left out"


class Operator(Protocol):
    """Who stands beside the vehicle."""

    def ask(self, text: str) -> str | None:
        """An answer; None: nobody answers any more."""

    def tell(self, text: str) -> None:
        """Say something."""


class CheckHost(NamedTuple):
    """What a checkout uses of the computer; a simulated clock stands here in tests."""

    clock: Callable[[], int]  # CLOCK_MONOTONIC, ns
    wait: Callable[[float], object]
    wall: Callable[[], datetime]
    run: Callable[[OpenDevices, float], list[Batch]]  # open devices, for so many seconds
    dry_run: Callable[[], CheckResult]  # of the whole app


class Lengths(NamedTuple):
    """Of what is waited for."""

    devices_s: float | None  # None: by their rates
    move_s: float  # of a joint
    flight_s: float


class CheckoutStep(NamedTuple):
    """One line of the list."""

    name: str
    by: str  # "operator" or "check"
    outcome: str  # PASSED, FAILED, LEFT_OUT
    found: str  # measured, and why it failed
    said: str  # by the operator
    at: str  # wall time, ISO 8601


class Record(NamedTuple):
    """A checkout."""

    vehicle: str
    vehicle_sha256: str  # of the vehicle file's text
    steps: tuple[CheckoutStep, ...]
    signed_by: str  # empty: nobody
    at: str  # wall time of the end

    @property
    def ready(self) -> bool:
        """Nothing failed, what was left out has a reason, and somebody signed."""
        open_steps = [s for s in self.steps if s.outcome == FAILED or (s.outcome == LEFT_OUT and not s.said)]
        return bool(self.signed_by) and bool(self.steps) and not open_steps

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        steps = [step._asdict() for step in self.steps]
        return self._asdict() | {"steps": steps, "ready": self.ready}


def checkout(
    vehicle: config.Vehicle, estimator: Estimator | None, bench: CheckHost, operator: Operator, lengths: Lengths
) -> Record:
    """Walk through the list.

    Args:
        vehicle: its file, the buses at the URLs to be used.
        estimator: that flies with it, and whose answers take room on the disk too.
        bench: clock, devices, dry run.
        operator: who answers the questions and reads the results.
        lengths: of what is waited for.

    Raises:
        ConfigError: a vehicle of recorded data, without a device on a bus.
    """
    require_devices(vehicle)
    steps = []
    for step in _steps(vehicle, estimator, bench, operator, lengths):
        operator.tell(f"{step.outcome}: {step.name}" + (f" - {step.found}" if step.found else ""))
        steps.append(step)
    signed = operator.ask("Signed off by (name; empty: not signed):") or ""
    digest = hashlib.sha256(vehicle.text.encode()).hexdigest()
    return Record(vehicle.file.vehicle.name, digest, tuple(steps), signed.strip(), _now(bench))


def _steps(
    vehicle: config.Vehicle, estimator: Estimator | None, bench: CheckHost, operator: Operator, lengths: Lengths
) -> Iterator[CheckoutStep]:
    yield _confirmed(
        bench, operator, "power", "Computers, devices, arm drives and cameras are on, and none reports a fault."
    )
    found: list[Preflight] = []

    def look() -> CheckResult:
        looked = preflight(
            *(vehicle, bench.clock, bench.wait, bench.run, lengths.devices_s, lengths.flight_s, estimator),
            bench.wall().timestamp(),
        )
        found.append(looked)
        bad = [f"{check.device}: {text}" for check in looked.checks for text in check.problems]
        others = [text for text in looked.problems if text not in looked.host.problems]
        seen = ", ".join(check.device for check in looked.checks if not check.problems)
        return CheckResult((*bad, *others), f"as the file says: {seen}" if seen else "")

    yield _checked(bench, operator, "devices", "Nothing touches the vehicle, and it is at rest.", look)
    if not found:
        return
    yield pulse(vehicle, bench, found[-1])
    host = found[-1].host
    hours = f"room for {host.free_bytes / host.bytes_per_s / 3600.0:.1f} h" if host.bytes_per_s else ""
    yield _judged(bench, "disk", CheckResult(host.problems, hours), "")
    roles, model = roles_of(vehicle), build_model(vehicle)
    for role in roles.joints:
        yield _moved(vehicle, bench, operator, lengths, roles, role, model)
    for cell in roles.cells:
        if isinstance(cell.keys, LoadCellKeys):
            yield _tared(vehicle, bench, operator, roles, cell, cell.keys)
    text = "The vehicle may move as in flight; the whole app flies and records for some seconds."
    yield _checked(bench, operator, "dry run", text, bench.dry_run)


def _now(bench: CheckHost) -> str:
    return bench.wall().isoformat(timespec="seconds")


_CHOICES = "[Enter: done; no WHY: it is not so; skip WHY: leave it out]"


def _answered(operator: Operator, name: str, text: str) -> tuple[str, str]:
    """``(outcome, words)``: PASSED to go on, FAILED or LEFT_OUT with the operator's words."""
    answer = operator.ask(f"{name}: {text} {_CHOICES}")
    if answer is None:
        return LEFT_OUT, ""
    word, _, rest = answer.partition(" ")
    outcome = {"no": FAILED, "n": FAILED, "skip": LEFT_OUT, "s": LEFT_OUT}.get(word.lower())
    return (PASSED, answer) if outcome is None else (outcome, rest.strip())


def _confirmed(bench: CheckHost, operator: Operator, name: str, text: str) -> CheckoutStep:
    outcome, said = _answered(operator, name, text)
    return CheckoutStep(name, "operator", outcome, "", said, _now(bench))


def _judged(bench: CheckHost, name: str, outcome: CheckResult, said: str) -> CheckoutStep:
    told = "; ".join([*outcome.problems, *([outcome.found] if outcome.found else [])])
    return CheckoutStep(name, "check", FAILED if outcome.problems else PASSED, told, said, _now(bench))


def _checked(
    bench: CheckHost, operator: Operator, name: str, text: str, check: Callable[[], CheckResult]
) -> CheckoutStep:
    """A check that begins when the operator says so, and is repeated where it fails and the operator wants it."""
    while True:
        answer, said = _answered(operator, name, text)
        if answer != PASSED:
            return CheckoutStep(name, "check", answer, "", said, _now(bench))
        step = _judged(bench, name, check(), said)
        if step.outcome == PASSED:
            return step
        operator.tell(f"{name}: {step.found}")
        again = operator.ask("[Enter: repeat; keep: it stays failed; skip WHY: leave it out]")
        word, _, rest = (again or "keep").partition(" ")
        if word.lower() in ("skip", "s"):
            return step._replace(outcome=LEFT_OUT, said=rest.strip())
        if again is None or word.lower() in ("keep", "k", "no", "n"):
            return step._replace(said=rest.strip())


def pulse(vehicle: config.Vehicle, bench: CheckHost, looked: Preflight) -> CheckoutStep:
    """Whether every recorder that can mark the sync pulse has."""
    line = sync_line(vehicle)
    if line is None or not line.coded:
        found = "the file has no coded pulse line: times come from arrival (heft checkout --without pulse)"
        return CheckoutStep("pulse", "check", LEFT_OUT, found, "none is wired", _now(bench))
    marks = {check.device: check.marks for check in looked.checks if check.marks is not None}
    unseen = [f"{device} marked no pulse: check the sync line to it" for device, count in marks.items() if not count]
    if not marks:
        unseen = ["no recorder was read that could mark a pulse: check power and wiring of the devices"]
    seen = ", ".join(f"{device} {count}" for device, count in marks.items() if count)
    return _judged(bench, "pulse", CheckResult(tuple(unseen), f"marked: {seen}" if seen else ""), "")


def _read(vehicle: config.Vehicle, bench: CheckHost, seconds: float) -> dict[str, list[Any]]:
    """Rows by channel of devices that ran for some seconds."""
    opened = open_devices(vehicle, bench.clock)
    try:
        batches = [*opened.problems, *bench.run(opened, seconds)]
    finally:
        opened.close()
    rows: dict[str, list[Any]] = {}
    for channel, some in batches:
        rows.setdefault(channel, []).append(some)
    return rows


def _values(rows: dict[str, list[Any]], roles: Roles, channel: str) -> FloatArray:
    """Usable values of a channel, SI, (n,)."""
    if channel not in rows:
        return np.zeros(0)
    every, signal = np.concatenate(rows[channel]), roles.signals[channel]
    every = every[si.usable(every)]
    return np.asarray(si.scalar(every, signal) * si.factors(every, signal), np.float64)


def _moved(
    vehicle: config.Vehicle,
    bench: CheckHost,
    operator: Operator,
    lengths: Lengths,
    roles: Roles,
    role: JointRole,
    model: VehicleModel,
) -> CheckoutStep:
    joint = model.joint(role.joint)
    axis = ", ".join(f"{part:g}" for part in joint.axis)
    sense = f"by the right hand about ({axis})" if joint.revolute else f"along ({axis})"
    text = (
        f"After Enter, within {lengths.move_s:g} s: turn {joint.name} first {sense}, then from stop to stop and back."
    )

    def check() -> CheckResult:
        rows = _read(vehicle, bench, lengths.move_s)
        swings = {
            other.joint: float(np.ptp(values)) if (values := _values(rows, roles, other.channel)).size else 0.0
            for other in roles.joints
            if other is not role and not other.is_rate
        }
        return judge_motion(joint, _values(rows, roles, role.channel), swings, is_rate=role.is_rate)

    return _checked(bench, operator, f"{_RANGE}{joint.name}", text, check)


def _tared(
    vehicle: config.Vehicle, bench: CheckHost, operator: Operator, roles: Roles, cell: LoadCellRole, keys: LoadCellKeys
) -> CheckoutStep:
    text = f"Nothing touches what is beyond {keys.frame}, and it is at rest."

    def check() -> CheckResult:
        return judge_tare(_values(_read(vehicle, bench, _TARE_S), roles, cell.channel), keys)

    return _checked(bench, operator, f"{_TARE}{cell.name}", text, check)


def write(record: Record, directory: Path) -> Path:
    """Write the record as ``NAME-checkout-NNN.json`` into the directory of flights; never over another."""
    directory.mkdir(parents=True, exist_ok=True)
    text = json.dumps(record.as_json(), indent=1) + "\n"
    number = 1
    while True:
        path = directory / f"{record.vehicle}-checkout-{number:03d}.json"
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except FileExistsError:
            number += 1
            continue
        return path


def render(record: Record) -> RenderableType:
    """The list as a table, and whether the vehicle is ready."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("step", "", "result", "operator"):
        table.add_column(heading)
    colours = {PASSED: "green", FAILED: "red", LEFT_OUT: "yellow"}
    for step in record.steps:
        table.add_row(step.name, Text(step.outcome, colours[step.outcome]), Text(step.found), Text(step.said))
    open_steps = [step.name for step in record.steps if step.outcome != PASSED]
    lost = [name.removeprefix(_RANGE).removeprefix(_TARE) for name in open_steps if name.startswith((_RANGE, _TARE))]
    lost += [name for name in open_steps if name == "pulse"]
    options = " ".join(f"--without {name}" for name in lost)
    hint = [Text(f"what stays identifiable: heft checkout {record.vehicle} {options}")] if lost else []
    signed = f"signed off by {record.signed_by}, {record.at}" if record.signed_by else "not signed off"
    verdict = Text("ready", "green") if record.ready else Text("not ready", "red")
    return Group(table, *hint, Text(signed), verdict)
