"""Trials of a controller on CiA 402 drives in mode 10: the arm repeats one motion, and each trial has its own law.

The first trial is flown with nothing in the gripper, on what the URDF says and friction as a share of effort; it tells
what the drives add (``onboard.control.drives``). Then the bench captures the payload, and the trials of the controller
follow. Nothing but PDOs goes to the drives; positions come with the SYNCs that they were sampled at.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

import numpy as np

from drivers.canopen_pdo.bus import CanopenBus
from drivers.canopen_pdo.play.drive_axis import Cia402AxisConfig, DriveAxis
from drivers.canopen_pdo.play.torque_master import TorqueConfig, TorqueMaster
from drivers.canopen_pdo.profiles.cia402 import Cia402Config
from drivers.canopen_pdo.sync import SyncConfig
from drivers.records import EVENT, Batch, Severity
from drivers.transports import open_can
from onboard.control.laws import SLOW_RAD_S, WINDOW, Gains, Law, SyncedMotion
from onboard.control.motion import JointLimits
from onboard.control.watch import astray
from onboard.estimation.arrays import FloatArray

PERIOD_MS: Final = 4.0
_STEP_NS: Final = 1_000_000
_QUICK_STOP_RAD_S2: Final = 10.0
_SLACK_RAD: Final = 0.02
_ENABLED_S: Final = 15.0  # until then the drives have to be enabled
_SETTLED_S: Final = 0.5  # held before the first trial
_TWO_PI: Final = 2.0 * np.pi


class Wire(NamedTuple):
    """A drive: its name, the joint that it moves, and how it counts.

    Attributes:
        name: Of its channel.
        joint: That it moves.
        node: On the bus.
        counts: In a revolution of the joint.
        zero: Counts at joint angle zero.
        reversed_count: It counts against the joint.
        gear_ratio: Revolutions of the motor in one of the joint, for the torque.
    """

    name: str
    joint: str
    node: int
    counts: int
    zero: int = 0
    reversed_count: bool = False
    gear_ratio: float = 1.0

    @property
    def per_rad(self) -> float:
        """Counts in a radian."""
        return (-1.0 if self.reversed_count else 1.0) * self.counts / _TWO_PI


class ArmOnBus(Protocol):
    """The arm on its bus, on a clock that the caller advances."""

    @property
    def now_ns(self) -> int:
        """CLOCK_MONOTONIC."""

    @property
    def url(self) -> str:
        """Of the bus."""

    def advance(self, now_ns: int) -> None:
        """Everything that happens up to ``now_ns``."""

    def capture(self) -> None:
        """The gripper closes about the payload."""


class FlownTrial(NamedTuple):
    """One trial; m SYNCs, n joints.

    Attributes:
        error: reference less measured position at the SYNCs, (m, n) rad; of a trial that was stopped up to then.
        measured: positions, (m, n) rad.
        torques: as sent, row i in force about ``(i + 1.5) T``, (m, n) N m.
        saturated: share of torques that were at the joint's effort.
        missed: SYNCs without torques of their own.
        stopped: why it was stopped; empty where it was not.
    """

    error: FloatArray
    measured: FloatArray
    torques: FloatArray
    saturated: float
    missed: int
    stopped: str

    @property
    def rms_rad(self) -> float:
        """Of the errors of all joints; NaN of a trial that was stopped before it began."""
        return float(np.sqrt(np.mean(self.error**2))) if len(self.error) else float("nan")


@dataclass
class _Running:
    """A trial that is being flown."""

    law: Law
    reference: SyncedMotion
    first: int | None = None
    error: list[FloatArray] = field(default_factory=list)
    measured: list[FloatArray] = field(default_factory=list)
    torques: list[FloatArray] = field(default_factory=list)
    saturated: int = 0
    missed: int = 0


class Trials:
    """The arm of a bench under control. A context manager: its drives are stopped at the end.

    Args:
        bench: the arm.
        wires: its drives, in the order of the model's joints.
        limits: of the joints.
        inertia: gives that of the arm with its drives, (n, n) kg m^2, for a posture, (n,).
        at_rest: gives the torques, (n,) N m, that hold a posture.
        record: called with all that the bus says.

    Raises:
        RuntimeError: the drives cannot be enabled.
    """

    def __init__(
        self,
        bench: ArmOnBus,
        wires: Sequence[Wire],
        limits: JointLimits,
        inertia: Callable[[FloatArray], FloatArray],
        at_rest: Callable[[FloatArray], FloatArray],
        record: Callable[[Sequence[Batch]], None] = lambda _: None,
    ) -> None:
        self._bench, self._wires, self._limits, self._record = bench, tuple(wires), limits, record
        self._inertia, self._at_rest = inertia, at_rest
        self._per_rad = np.array([wire.per_rad for wire in wires])
        self._zero = np.array([wire.zero for wire in wires], np.float64)
        self.gains: Gains | None = None
        self._hold: FloatArray | None = None
        self._errors: list[FloatArray] = []  # of the last SYNCs
        self._running: _Running | None = None
        self.warnings: list[str] = []
        configs = tuple(self._axis(k) for k in range(len(wires)))
        self._port = open_can(bench.url, lambda: bench.now_ns)
        torque = TorqueConfig(configs, self._torques)
        sync = SyncConfig(period_ms=PERIOD_MS)
        self._bus = CanopenBus(self._port, [axis.drive for axis in configs], sync, "arm", play=torque)
        master = self._bus.player
        assert isinstance(master, TorqueMaster)
        self._master: TorqueMaster = master
        self._keep(self._bus.start(bench.now_ns))
        self._master.arm()
        self._go_on(lambda: self._hold is not None, _ENABLED_S)
        if self._hold is None:
            why = self._master.stopped_by or ", ".join(self.warnings) or "they do not answer"
            self.close()
            raise RuntimeError(f"the drives cannot be enabled: {why}")
        self._go_on(lambda: False, _SETTLED_S)

    @property
    def posture(self) -> FloatArray:
        """Where the arm is held between trials, (n,) rad."""
        assert self._hold is not None
        return self._hold

    def fly(self, law: Law, reference: SyncedMotion) -> FlownTrial:
        """One trial, from the posture back to it."""
        trial = self._running = _Running(law, reference)
        steps = len(reference.q)
        self._go_on(lambda: self._running is None, 2.0 * steps * PERIOD_MS * 1e-3 + 1.0)
        self._running = None
        shape = (-1, len(self._wires))
        error, measured, torques = (np.reshape(rows, shape) for rows in (trial.error, trial.measured, trial.torques))
        share = trial.saturated / max(torques.size, 1)
        return FlownTrial(error, measured, torques, share, trial.missed, self._master.stopped_by)

    def close(self) -> None:
        """Stop the drives and leave the bus."""
        self._master.stop("the trials are over")
        self._go_on(lambda: self._master.has_stopped, 5.0)
        self._keep(self._bus.stop(self._bench.now_ns))
        self._port.close()

    def __enter__(self) -> "Trials":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # The bus

    def _axis(self, k: int) -> Cia402AxisConfig:
        wire, limits = self._wires[k], self._limits
        drive = Cia402Config(wire.node, wire.counts, wire.zero, wire.name, status=f"{wire.name}_status")
        ends = self._zero[k] + self._per_rad[k] * np.array([limits.low[k], limits.high[k]])
        per_rad = abs(float(self._per_rad[k]))
        return Cia402AxisConfig(
            drive,
            f"{wire.name}_sent",
            round(float(ends.min())),
            round(float(ends.max())),
            rate=float(limits.speed[k]) * per_rad,
            acceleration=_QUICK_STOP_RAD_S2 * per_rad,
            quick_stop=_QUICK_STOP_RAD_S2 * per_rad,
            following_error=round(_SLACK_RAD * per_rad),
            start_within=round(_SLACK_RAD * per_rad),
        )

    def _go_on(self, done: Callable[[], bool], seconds: float) -> None:
        """Let time pass until something is done, the drives were stopped, or it is too late."""
        end_ns = self._bench.now_ns + round(seconds * 1e9)
        while self._bench.now_ns < end_ns and not done() and not (self._master.has_stopped):
            self._bench.advance(self._bench.now_ns + _STEP_NS)
            self._keep(self._bus.pump(self._bench.now_ns))

    def _keep(self, batches: Sequence[Batch]) -> None:
        self._record(batches)
        for batch in batches:
            if batch.rows.dtype == EVENT:
                grave = batch.rows[batch.rows["severity"] >= Severity.WARNING]
                self.warnings += [row["text"].decode() for row in grave]

    # The law of every SYNC

    def _torques(self, tick: int, counts: Sequence[int]) -> list[int] | str:
        q = (np.asarray(counts) - self._zero) / self._per_rad
        if self._hold is None:
            self._hold = q
        trial = self._running
        if self.gains is None:
            self.gains = Gains.of(self._inertia(q), SLOW_RAD_S)
        wanted, step = self._hold, 0
        if trial is not None:
            trial.first = tick if trial.first is None else trial.first
            step = tick - trial.first
            if step >= len(trial.reference.q):
                self._running = trial = None
            else:
                wanted = trial.reference.q[step]
        error = wanted - q
        self._errors = [*self._errors[-WINDOW:], error]
        rate = (error - self._errors[0]) / (max(len(self._errors) - 1, 1) * PERIOD_MS * 1e-3)
        if why := astray(error, [wire.joint for wire in self._wires]):
            return why
        if trial is None:
            torque = self._at_rest(q) + self.gains.position * error + self.gains.rate * rate
        else:
            torque = trial.law.torque(step, error, rate)
        if not np.isfinite(torque).all():
            return "the control law gives no number"
        sent, raw = self._limited(torque)
        if trial is not None:
            self._note(trial, step, q, error, sent, torque)
        return raw

    def _limited(self, torque: FloatArray) -> tuple[FloatArray, list[int]]:
        """Torques as the drives have them: within the joints' effort, in thousandths of the rated one."""
        per_mille = np.array([self._per_mille(axis, wire) for axis, wire in zip(self._axes, self._wires, strict=True)])
        raw = np.round(np.clip(torque, -self._limits.effort, self._limits.effort) / per_mille).astype(np.int64)
        return raw * per_mille, raw.tolist()

    @property
    def _axes(self) -> Sequence[DriveAxis]:
        return self._master.axes

    @staticmethod
    def _per_mille(axis: DriveAxis, wire: Wire) -> float:
        sense = -1.0 if wire.reversed_count else 1.0
        return sense * axis.rated_torque_mNm * 1e-6 * wire.gear_ratio

    def _note(
        self, trial: _Running, step: int, q: FloatArray, error: FloatArray, sent: FloatArray, wanted: FloatArray
    ) -> None:
        lost = step - len(trial.error)
        for _ in range(lost + 1):  # a SYNC that was lost had the torques of the one before
            trial.error.append(error)
            trial.measured.append(q)
            trial.torques.append(sent)
        trial.missed += lost
        trial.saturated += int((np.abs(wanted) > self._limits.effort).sum())
