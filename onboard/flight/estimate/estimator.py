"""Estimator as a function of records: input records of a step in, clock solutions, rows and estimates out.

It owns no ring, log or clock, so the flight (:mod:`onboard.flight.estimate.estimation`), the replay and ``heft
identify`` all run the same code. Rows are made at whole multiples of the row period in vehicle time, with a fixed lag.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Batch, Rows, Severity, event
from onboard import channels, config
from onboard.devices.roles import TorqueKeys
from onboard.dynamics.model.errors import UnknownFrameError
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason, magnitude_gate, phase_gate, range_gate, reasons
from onboard.estimation.smoothing import correlation_inflation
from onboard.flight.clocks import timebase_of
from onboard.flight.estimate.answers import Answers, change_event, innovation_rows, useful_of
from onboard.flight.estimate.asking import Asking
from onboard.flight.estimate.phases import PhaseTrack
from onboard.flight.estimate.problem.identification import build_online, channels_of, with_hypotheses
from onboard.flight.estimate.readings.at_ticks import side_by_side
from onboard.flight.estimate.readings.joint_signals import JointSignals
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import SignalSmoother, kernel_of
from onboard.flight.estimate.readings.torques import TorqueLines
from onboard.flight.estimate.readings.tracked import TrackedTicks
from onboard.flight.estimate.readings.witness import RateWitness
from onboard.flight.estimate.readings.zeroing import Temperatures, Zeroing
from onboard.identification.free_flyer.online import MotionIdentifier, TickIdentifier
from onboard.identification.online import OnlineIdentifier
from onboard.identification.rows.hypotheses import Hypotheses
from onboard.identification.rows.identifier import Identifier
from onboard.regressor.friction import CoulombFriction
from onboard.regressor.rows import BaseMotion, base_motion, standing
from onboard.regressor.signals import OfSamples, SignalNoise, Signals, noise_of_joints

_ANSWERED_NS = 75_000_000  # since the last answers: at 10 Hz in steps of 50 ms, at each of 100 ms that comes early


class _Base(NamedTuple):
    """What is known of the base at n ticks."""

    motion: BaseMotion
    sensed_m_s2: FloatArray  # (n, 3) specific force at the IMU, its axes
    sigma: tuple[FloatArray, FloatArray, FloatArray]  # (n, 3) of rate, its derivative, specific force; IMU axes
    refused: NDArray[np.int64]  # (n,)
    of_samples: FloatArray  # (n, 9) share of the variances of these


class Estimator:
    """Identifies one vehicle from its records.

    Args:
        vehicle: its file.
        identifier: goes on with what another estimator of the same vehicle has learned, from another log say; a fresh
            one where not given.
        at_the_end: answers are made of the last step alone. Making them teaches nothing: the last are the same.

    Attributes:
        online: what has been learned.
        inflation: of the sigmas of rows, for the correlation of neighbouring ones.
        inputs: channels it consumes, in the order that TICK records count them.
        outputs: dtype of every channel it makes.
    """

    def __init__(
        self, vehicle: config.Vehicle, identifier: OnlineIdentifier | None = None, *, at_the_end: bool = False
    ) -> None:
        self.vehicle, self._at_the_end = vehicle, at_the_end
        settings = vehicle.file.estimation
        self.inputs = tuple(vehicle.channels)
        fresh, self.model = build_online(vehicle)
        self.online: OnlineIdentifier = with_hypotheses(vehicle, fresh) if identifier is None else identifier
        self._timebase = timebase_of(vehicle)
        self._phases = PhaseTrack(settings.phases)
        moving = settings.phases.identify if settings.phases else ()
        self._zeroing = Zeroing(settings.zero, settings.smoothing_ms * 1e-3 * settings.row_rate_hz, moving)
        self._slow_force = np.zeros(3)
        self._period_ns = round(1e9 / settings.row_rate_hz)
        self._lag_ns = round(settings.lag_ms * 1e6)
        self._next_ns: int | None = None
        self._now_ns = 0
        self._in_use = False  # any row
        self._told_ns = 0  # when the last answers were made
        self.left_out_ns: list[tuple[int, int]] = []  # where no rows are made
        self.inflation = correlation_inflation(
            settings.smoothing_ms * 1e-3, 1.0 / settings.row_rate_hz, kernel_of(vehicle)
        )
        roles = roles_of(vehicle)
        self._imu = roles.imu if roles.imus else None  # a fixed base needs none
        self._temperatures = Temperatures(self._imu)
        further = self.online.further if isinstance(self.online, TickIdentifier) else ()
        follows = isinstance(self.online, TickIdentifier) and self.online.follows_jumps
        seen = [one for one in roles.trackers if one.channel in {own.name for own in further}]
        self._signals = SignalSmoother(vehicle, trackers=seen, follows_jumps=follows)
        self._further, self._tracked = channels_of(roles, further), [TrackedTicks(one, self._period_ns) for one in seen]
        self._torques = TorqueLines.of(roles, self.model, self.online.row_names)
        self._witness: RateWitness | None = None
        try:
            if len(roles.imus) > 1 and roles.imus[1].channels not in self._further:
                self._witness = RateWitness(self.model, (roles.imus[0], roles.imus[1]), settings.imu_prior.gyro_scale)
        except UnknownFrameError as error:
            raise config.ConfigError(f"{vehicle.label}: the IMU of {roles.imus[1].channels[0]}: {error}") from error
        self._at_joints = JointSignals(roles, self.model)
        self._cells = {cell.name: cell for cell in roles.cells}
        self._thrusters = [thruster.channel for thruster in roles.thrusters]
        motors = self.online.model.motors if isinstance(self.online, Identifier) else ()
        names = [joint.name for joint in self.model.joints]
        self._friction = CoulombFriction(motors, names) if motors else None
        self._turning = {name: [k for k, motor in enumerate(motors) if name in dict(motor.ratios)] for name in names}
        size = len(self.online.triangle())
        self.outputs: dict[str, np.dtype[np.void]] = {
            "clock": channels.CLOCK,
            "row": channels.row_dtype(len(self.online.row_names), len(self.model.joints)),
            "estimate": channels.estimate_dtype(len(self.online.parameter_names), size),
            "quantity": channels.QUANTITY,
        }
        self._asking = None if vehicle.segments is None else Asking(vehicle, vehicle.segments, self.online, self.model)
        if isinstance(self.online, MotionIdentifier):
            self.outputs["innovation"] = channels.INNOVATION
        if self._asking is not None:
            self.outputs["request"] = channels.REQUEST
        self._answers = Answers(self.outputs["estimate"], settings.nuisance, useful_of(vehicle))
        self._sequence = dict.fromkeys(self.outputs, 0)

    @property
    def identifier(self) -> Identifier:
        """What has been learned from rows.

        Raises:
            ConfigError: the vehicle's method has none.
        """
        if isinstance(self.online, Hypotheses):
            return self.online.chosen
        if isinstance(self.online, Identifier):
            return self.online
        label, method = self.vehicle.label, self.vehicle.file.estimation.method
        raise config.ConfigError(f'{label}: this needs rows; the method is "{method}"')

    def phase_at(self, at_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """The phase at each time, (n,); -1 where it is not known."""
        return self._phases.at(at_ns)

    def go_on_from(self, sequences: Mapping[str, int]) -> None:
        """Number the rows of each output from here on: another estimator's came before."""
        self._sequence |= sequences

    def process(
        self, now_ns: int, batches: Mapping[str, Rows], lag_ns: int | None = None, skipped_ns: int = 0
    ) -> list[Batch]:
        """One step: take in ``batches`` by channel, make the rows that are due, answer.

        Args:
            now_ns: time of the step; rows up to ``now_ns - lag`` are made.
            batches: what has arrived since the last step.
            lag_ns: another lag than the vehicle's: it is the last step, and nothing more arrives.
            skipped_ns: no records of so much time after the last step were taken: no rows are made of it.
        """
        made: list[Batch] = []
        if skipped_ns:
            self.left_out_ns.append((self._now_ns, self._now_ns + skipped_ns))
        self._now_ns = now_ns
        clocks = self._timebase.update(now_ns, dict(batches))
        if len(clocks):
            made.append(self._numbered("clock", clocks))
        for channel, said in self._signals.append(batches, self._timebase.time_ns, in_use=self._in_use):
            made.append(event(now_ns, said.severity, said.code, channel, said.text))
        made += [event(now_ns, Severity.INFO, "phase", "estimation", text) for text in self._phases.update(batches)]
        self._temperatures.append(batches, self._timebase.time_ns)
        at_ns = self.due(now_ns - (self._lag_ns if lag_ns is None else lag_ns))
        if len(at_ns):
            made += self._rows(now_ns, at_ns, final=lag_ns is not None)
        return made

    def due(self, until_ns: int) -> NDArray[np.int64]:
        """Ticks up to ``until_ns``; the first lies at the first whole period after the first step."""
        if self._next_ns is None:
            self._next_ns = -(-until_ns // self._period_ns) * self._period_ns
        parts: list[NDArray[np.int64]] = []
        next_ns, period_ns = self._next_ns, self._period_ns
        for first_ns, last_ns in sorted(self.left_out_ns):
            parts.append(np.arange(next_ns, min(first_ns, until_ns + 1), period_ns, dtype=np.int64))
            next_ns = max(next_ns, self._next_ns + -((self._next_ns - last_ns - 1) // period_ns) * period_ns)
        parts.append(np.arange(next_ns, until_ns + 1, period_ns, dtype=np.int64))
        self._next_ns += max(0, (until_ns - self._next_ns) // period_ns + 1) * period_ns
        self.left_out_ns = [one for one in self.left_out_ns if one[1] >= self._next_ns]
        return np.concatenate(parts)

    def _rows(self, now_ns: int, at_ns: NDArray[np.int64], *, final: bool) -> list[Batch]:
        made: list[Batch] = []
        joints, spread, refused, cyclic, of_joints = self._at_joints.at(self._signals, self._timebase, at_ns)
        (q, dq, ddq), time_s = joints, (at_ns * 1e-9).astype(np.float64)
        if self._imu is not None and self.vehicle.file.estimation.how.tick_means:
            measured, sigma, of_rows = self._means(at_ns)
            self._torques.state(dq, sigma, of_rows, self.inflation)
            thrust = self._signals.means(self._thrusters, self._timebase, at_ns, self._period_ns)
            refused |= thrust.refused
            joints[:, thrust.refused != 0] = np.nan  # nothing is predicted without
            refused |= self._gates(at_ns, joints, measured[:, 3:6])
            refused |= of_rows[:, 0] * (not self._further)
            motion = BaseMotion(*np.full((3, len(at_ns), 3), np.nan))  # predicted, not measured
            own = OfSamples(np.hstack([*of_joints, np.zeros((len(at_ns), 9))]), self._at_joints.orders)
            noise = SignalNoise(spread[0], spread[1], spread[2], *motion, self.inflation, own)
            more = of_rows, cyclic, np.nan_to_num(thrust.derivatives[0]), self._at_joints.jumps(self._signals, at_ns)
            signals = Signals(time_s, q, dq, ddq, motion, measured, sigma, None, noise, None, *more)
        else:
            base, said = self._base(now_ns, at_ns)
            made += said
            friction = None if self._friction is None else self._friction.follow(q, dq)
            measured, measured_rate, sigma, of_rows = self._measured(at_ns, dq, friction)
            refused |= base.refused | self._gates(at_ns, joints, base.sensed_m_s2)
            own = OfSamples(np.hstack([*of_joints, base.of_samples]), self._at_joints.orders)
            noise = SignalNoise(*noise_of_joints(spread, dq, ddq), *base.sigma, self.inflation, own)
            friction = None if friction is None else np.nan_to_num(friction)
            rest = measured_rate, noise, friction, of_rows if of_rows.any() else None, cyclic
            signals = Signals(time_s, q, dq, ddq, base.motion, measured, sigma, *rest)
        if self._witness is not None and self._witness.check(self._signals, self._timebase, at_ns, self._period_ns):
            made.append(event(now_ns, Severity.ERROR, "contradiction", "estimation", self._witness.contradiction))
        found = self._update(signals, at_ns, refused)
        self._in_use |= bool((found == 0).any())
        if final:
            self.online.finish()
        made.append(self._row_batch(now_ns, at_ns, signals, found))
        if isinstance(self.online, MotionIdentifier) and (errors := self.online.prediction_errors()):
            made.append(self._numbered("innovation", innovation_rows(now_ns, errors)))
        for change in self.online.news():
            if change.kind == "release_contradicted":
                self._phases.reject_release()
            made.append(change_event(now_ns, change))
        told = self.online.rows_used or self._sequence["quantity"]  # an answer that no longer holds does not stand
        if told and (final or not (self._at_the_end or now_ns < self._told_ns + _ANSWERED_NS)):
            self._told_ns = now_ns
            made += self._answered(now_ns, int(at_ns[-1]))
        if self._asking is not None:
            said = self._asking.step(now_ns, float(time_s[-1]), joints[:2, -1], measured[-1, :3], self.online)
            made += [self._numbered(one.channel, one.rows) if one.channel == "request" else one for one in said]
        return made

    def _means(self, at_ns: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """Means over the ticks of the IMU and further instruments, their sigmas, and reasons, (n, rows) each."""
        assert self._imu is not None
        own = (self._imu.channels, *self._further)
        each = [self._signals.means(names, self._timebase, at_ns, self._period_ns) for names in own]
        each += [one.at(self._signals, self._timebase, at_ns) for one in self._tracked]
        values, sigmas = [one.derivatives[0] for one in each], [one.sigma[0] for one in each]
        refused = [np.repeat(one.refused[:, None], one.derivatives[0].shape[1], axis=1) for one in each]
        return np.hstack(values), np.hstack(sigmas), np.hstack(refused)

    def _update(self, signals: Signals, at_ns: NDArray[np.int64], refused: NDArray[np.int64]) -> NDArray[np.int64]:
        attached = self._phases.attached(at_ns)
        if isinstance(self.online, Hypotheses):
            return self.online.update(signals, attached, refused, self._phases.attached(at_ns, but_first=True))
        return self.online.update(signals, attached, refused)

    def _base(self, now_ns: int, at_ns: NDArray[np.int64]) -> tuple[_Base, list[Batch]]:
        """The base's motion by its IMU, zeroed where it is due; without one it stands."""
        if self._imu is None:
            n = len(at_ns)
            motion, still = standing(self.model, n), np.zeros((n, 3))
            none = np.zeros(n, np.int64), np.zeros((n, 9))
            return _Base(motion, motion.specific_force_m_s2, (still, still, still), *none), []
        imu = side_by_side(self._signals.each(self._imu.channels, self._timebase, at_ns, 1))
        values, rates = imu.derivatives
        rest = self._phases.at(at_ns), imu.refused == 0, self._temperatures.at(at_ns)
        specific_force = self._zeroing.apply(values[:, 3:], *rest)
        said = self._zeroing.news(now_ns, self._imu.channels[0])
        motion = base_motion(self.model, self._imu.frame, values[:, :3], rates[:, :3], specific_force)
        sigma = imu.sigma[0][:, :3], imu.sigma[1][:, :3], imu.sigma[0][:, 3:]
        share = np.hstack([imu.of_samples[0][:, :3], imu.of_samples[1][:, :3], imu.of_samples[0][:, 3:]])
        return _Base(motion, specific_force, sigma, imu.refused, share), said

    def _measured(
        self, at_ns: NDArray[np.int64], dq: FloatArray, friction: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
        """Left-hand sides of the rows, their rates, their sigmas, and reasons, (n, rows) each."""
        rows = self.online.row_names
        settings, n = self.vehicle.file.estimation, len(at_ns)
        measured, rate, sigma = np.zeros((n, len(rows))), np.zeros((n, len(rows))), np.zeros((n, len(rows)))
        refused = np.zeros((n, len(rows)), np.int64)
        for column, row in enumerate(rows):
            if row in self._cells:
                keys = self._cells[row].keys
                cell = self._signals.at(self._cells[row].channel, self._timebase, at_ns, 1)
                measured[:, column], rate[:, column] = cell.derivatives[0][:, 0], cell.derivatives[1][:, 0]
                sigma[:, column] = cell.sigma[0][:, 0]
                if isinstance(keys, TorqueKeys) and friction is not None:
                    unknown = np.isnan(friction[:, self._turning[keys.joint]]).any(axis=1)
                    refused[:, column] |= reasons(unknown, GateReason.STILL)
                refused[:, column] |= cell.refused
            else:  # a base wrench that is zero within its stated sigma
                force = row.startswith("base_force")
                sigma[:, column] = settings.base_force_sigma_N if force else settings.base_moment_sigma_N_m
        self._torques.state(dq, sigma, refused)
        return measured, rate, sigma * self.inflation, refused

    def _gates(self, at_ns: NDArray[np.int64], joints: FloatArray, specific_force: FloatArray) -> NDArray[np.int64]:
        settings = self.vehicle.file.estimation
        refused = np.zeros(len(at_ns), np.int64)
        if settings.phases:
            changes_ns, codes = self._phases.changes
            settle_s, kernel_s = settings.phases.settle_ms * 1e-3, 0.5 * settings.smoothing_ms * 1e-3
            known = changes_ns * 1e-9, codes, settings.phases.identify
            refused |= phase_gate(at_ns * 1e-9, *known, settle_s, kernel_s)
        if settings.gates.joint_limits_deg:
            low, high = np.radians(settings.gates.joint_limits_deg)
            refused |= range_gate(joints[0], low, high, GateReason.CONTACT)
        if settings.gates.joint_rate_min_rad_s:
            refused |= range_gate(np.abs(joints[1]), settings.gates.joint_rate_min_rad_s, np.inf, GateReason.PHASE)
        if settings.gates.specific_force_m_s2:
            refused |= magnitude_gate(self._slow(specific_force), settings.gates.specific_force_m_s2, GateReason.DRAG)
        return refused

    def _slow(self, specific_force: FloatArray) -> FloatArray:
        """Running mean of the specific force, (n, 3): drag grows slowly, and vibration is none of it."""
        weight = self._period_ns * 1e-6 / self.vehicle.file.estimation.gates.specific_force_window_ms
        means = np.full_like(specific_force, np.nan)
        for tick in np.flatnonzero(np.isfinite(specific_force).all(axis=1)):
            self._slow_force += min(weight, 1.0) * (specific_force[tick] - self._slow_force)
            means[tick] = self._slow_force
        return means

    def _row_batch(self, now_ns: int, at_ns: NDArray[np.int64], signals: Signals, found: NDArray[np.int64]) -> Batch:
        made = np.zeros(len(at_ns), self.outputs["row"])
        innovation = self.online.innovation if isinstance(self.online, Identifier | Hypotheses) else np.nan
        joints = signals.q, signals.dq, signals.ddq
        fields = (now_ns, at_ns, *joints, signals.measured, signals.sigma, found, innovation)
        for field, values in zip((made.dtype.names or ())[1:], fields, strict=True):
            made[field] = values
        return self._numbered("row", made)

    def _answered(self, now_ns: int, vehicle_ns: int) -> list[Batch]:
        online, findings = self.online, self._temperatures.noted(self.online.findings())
        contradiction = "" if self._witness is None else self._witness.contradiction
        findings = findings.plus(filter(None, [contradiction]), filter(None, [self._signals.jumped]))
        estimate = self._zeroing.noted(online.estimate(), 1e-9 * self._period_ns)
        state, answers, said = self._answers.rows(now_ns, vehicle_ns, estimate, findings, online.triangle())
        return [self._numbered("estimate", state), self._numbered("quantity", answers), *said]

    def _numbered(self, channel: str, rows: Rows) -> Batch:
        first = self._sequence[channel]
        rows["sequence"] = np.arange(first, first + len(rows), dtype=np.uint64)
        self._sequence[channel] = first + len(rows)
        return Batch(channel, rows)
