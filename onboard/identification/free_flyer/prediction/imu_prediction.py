"""Predicts base IMU and further instruments over a batch of ticks from a state propagated between batches.

The state has the unknowns of a free flight: current rate of the base, payload, current IMU biases and their drifts,
scale, misalignment and delay, uncertain links, the IMU's place, errors of the joints' places and encoders, and the
errors of further IMUs and load cells (:mod:`onboard.identification.free_flyer.prediction.further`). All but the rate
(:mod:`onboard.dynamics.free_flight`) and the biases are constant.

Cyclic errors of an encoder behind a gear are functions of its angle (eccentricity, transmission error); as noise they
would make the payload too light (errors in variables). Their functions come through the same smoothing as the joints.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np

from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.joint_errors import EncoderReadings, JointErrors
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.tracked_pose import MOTION, predict_pose, quaternion_of
from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.identification.free_flyer.prediction.core import Changing, PredictionBegun, PredictionCore
from onboard.identification.free_flyer.prediction.further import (
    DisturbancePrior,
    Further,
    FurtherCell,
    FurtherImu,
    FurtherPose,
    PlacedImu,
    PlacedPose,
    Thruster,
    cuts_of,
    left_of,
)
from onboard.identification.free_flyer.prediction.imu_errors import SIZE, ImuPrior, drift_of, imu_blocks, weight_of
from onboard.identification.free_flyer.prediction.joint_noise import JointNoise, sigma_of
from onboard.identification.free_flyer.prediction.parameters import (
    EXACT_GEOMETRY,
    FlexibleJoints,
    GeometryPrior,
    Own,
    UncertainLinks,
    UnknownLayout,
    Unknowns,
    kept_of,
    named,
    together,
)
from onboard.identification.free_flyer.prediction.scaled import Scaled
from onboard.identification.free_flyer.prediction.ticks import TickPrediction, Ticks
from onboard.native import library

UNDISTURBED = DisturbancePrior()
RATE, PAYLOAD = slice(0, 3), slice(3, 13)  # of the state: unknown, so always estimated
PIECE = 80  # ticks predicted at once, about: fewer cost more each, more take longer
DRIFT_MEMORY_s = 20.0  # correlation time of a bias drift: that of a chip that warms up


class ImuPredictor:
    """Predicts the instruments of a vehicle, the first of them its base IMU.

    Args:
        vehicle: with a payload link; its standard parameters are the prior of all other links.
        imu_frame: the first IMU's frame S, fixed in the base B.
        period_s: between ticks.
        samples: of that IMU in each tick's mean.
        link_covariance: see :class:`onboard.identification.free_flyer.prediction.parameters.UncertainLinks`.
        imu_prior: on instrument errors; the clock rate error is taken for none.
        geometry: prior on places of IMU and joints, and on encoder errors.
        further: instruments besides that IMU.
        name: of that IMU.
        thrusters: whose forces are known.
        disturbance: prior on what pushes the base unknown.
        key_of: what states the sigma of a parameter, by the parameter's name; empty for nothing.

    Attributes:
        names: of the p parameters.
        sigma: (p,) before the flight; NaN for rate and payload, of which nothing is known.
        biases: where each bias stands in the state, and where its drift.
        further: instruments besides the first IMU.
        instruments: names of all, the first IMU first, load cells last.
        imu_frames: of the IMUs, by their numbers among the instruments.
        lines: of what is predicted by instrument, the first IMU first.
        of_each: where the errors of each instrument stand in the state.
        of_bodies: where deviations of links, errors of joints and thrusters, and the disturbance stand in the state.
        of_further: the same of each further instrument, of a cell its scale alone.
        drawn: of each uncertain link by name, where its deviations from the drawing stand in the state, (10,), and what
            one sigma of each does to its standard parameters, (10, 10).
        stated: (p,) as ``sigma``, of biases as they may be after their drift.
        constant: (p,) as ``sigma``, NaN for what changes or wanders: of its value now nothing was stated.
        lasting: (p,) zero for what changes or wanders, one for the others.
        wandering: where delays and the disturbance stand, which wander, and the correlation time of each.
        changing: where rate and biases stand, the only elements of the state that change from tick to tick; with a
            tracker also the base's attitude, and place and velocity of the centre of mass.
        moving: where these last stand; empty without a tracker.
        bends: where the bends of flexible joints and their rates stand, which change, too.
        anew_at: ``moving`` and ``bends``: what a window knows nothing of.
        cyclic_slopes: see :meth:`GeometryPrior.cyclic_slopes`.
        layout, links, joint_errors, columns: of the state, and of what its elements do to the vehicle.
        in_links, in_joints, drifting: where deviations of links, errors of joints, and what drifts and its drift stand.
        imus, cells, own, weight: instruments in the base, elements of the state that are errors of each, and the weight
            of a line's neighbouring ticks in the mean of its samples.
        of_motion: places in the state, and among what the base's motion depends on.

    Raises:
        UnknownFrameError: no payload link, or a name that the URDF does not have.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        imu_frame: str,
        period_s: float,
        samples: int,
        link_covariance: Mapping[str, FloatArray],
        imu_prior: ImuPrior,
        geometry: GeometryPrior = EXACT_GEOMETRY,
        further: Sequence[Further] = (),
        name: str = "imu",
        thrusters: Sequence[Thruster] = (),
        disturbance: DisturbancePrior = UNDISTURBED,
        key_of: Callable[[str], str] = str,
    ) -> None:
        self.vehicle, self.period_s, self.thrusters = vehicle, period_s, tuple(thrusters)
        self.key_of = key_of
        self.further = tuple(sorted(further, key=lambda one: (FurtherImu, FurtherCell, FurtherPose).index(type(one))))
        self.instruments = (name, *(one.name for one in self.further))
        self.imu_frames = imu_frame, *(one.frame for one in self.further if isinstance(one, FurtherImu))
        self.links = UncertainLinks(vehicle, link_covariance)
        halves, r = self.links.halves, len(self.links.basis)
        self._flexible = FlexibleJoints.of(vehicle, geometry, self.links.indices)
        blocks = {
            "start": Unknowns(tuple(f"rate_{axis}" for axis in "xyz"), np.full(3, np.nan)),
            "payload": Unknowns(self.links.payload_names, np.full(10, np.nan)),
            **imu_blocks(imu_prior._replace(clock_rate_error=0.0)),
            "links": Unknowns(self.links.inertial_names, np.ones(r)),
            **geometry.blocks(vehicle),
            **({} if self._flexible is None else self._flexible.blocks()),
            "thrusters": Thruster.block(thrusters),
            "disturbance": disturbance.block(),
        }
        for one in self.further:
            blocks |= one.blocks()
        self.layout = layout = UnknownLayout(blocks)
        self.names, self.sigma = layout.names, layout.sigma
        self._in_push = layout.estimated("disturbance")
        self.pushes: list[tuple[int, int]] = list(zip(*self._in_push.reshape(2, -1).tolist(), strict=True))
        self.fading = [one for at, of in self.pushes for one in ((at, disturbance.memory_s), (of, DRIFT_MEMORY_s))]
        self.cyclic_slopes = geometry.cyclic_slopes(vehicle)
        of_functions = geometry.cyclic_joints(vehicle) if self._flexible is None else self._flexible.placed(layout)
        errors = slice(PAYLOAD.stop, PAYLOAD.stop + SIZE)
        self.imus = [PlacedImu(*vehicle.pose_in_base(imu_frame), samples, errors, layout["imu_place"])]
        self.imus += [self._further_imu(one) for one in self.further if isinstance(one, FurtherImu)]
        self.cells = cuts_of(vehicle, self.further, self.links.indices, of_functions)
        self._poses = [self._pose(one) for one in self.further if isinstance(one, FurtherPose)]
        self.wandering = [
            (at, one.delay_memory_s)
            for one in self.further
            if isinstance(one, FurtherImu) and np.isfinite(one.delay_memory_s)
            for at in layout.estimated(f"delay_s {one.name}").tolist()
        ] + self.fading
        self.moving: IndexArray = np.array(
            [at for one in self._poses for at in range(one.motion.start, one.motion.stop)], np.intp
        )
        self.bends, in_springs = (self.moving[:0],) * 2 if self._flexible is None else self._flexible.places
        self.anew_at: IndexArray = np.concatenate([self.moving, self.bends])
        self.of_each = [
            layout.estimated(*imu_blocks(imu_prior), "imu_place"),
            *(np.setdiff1d(named(layout, f"_{one.name}"), self.moving) for one in self.further),
        ]
        self.of_further = [
            named(layout, f"scale_{one.name}") if isinstance(one, FurtherCell) else own
            for one, own in zip(self.further, self.of_each[1:], strict=True)
        ]
        self.lines = tuple(
            slice(*ends) for ends in pairwise(accumulate((6, *(f.width for f in self.further)), initial=0))
        )
        self.joint_errors, self.columns = JointErrors(vehicle, of_functions), self.links.columns
        self._noise = JointNoise(vehicle, self.joint_errors, self.imus, [cut for _, cut in self.cells], self.lines)
        self.in_links, self.in_joints = layout.estimated("links"), layout.estimated("joints", "cyclic")
        self.drawn = dict(zip(self.links.drawn, zip(self.in_links.reshape(-1, 10), halves, strict=True), strict=True))
        self._scaled = Scaled(self.in_links, self.links.whole)
        in_thrusters = layout.estimated("thrusters", "disturbance")
        self.of_bodies = np.concatenate([self.in_links, self.in_joints, in_springs, in_thrusters])
        of_joints = 13 + r + layout.kept[self.in_joints] - layout["joints"].start
        moved = self.joint_errors if self.in_joints.size or self._flexible else None
        columns = 13 + r + (0 if moved is None else moved.columns)
        of_thrusters = columns + layout.kept[in_thrusters] - layout["thrusters"].start
        self.of_motion = [
            (slice(0, PAYLOAD.stop), slice(0, PAYLOAD.stop)),
            (together(self.in_links), slice(13, 13 + r)),
            (together(self.in_joints), together(of_joints)),
            (together(in_thrusters), together(of_thrusters)),
        ]
        self._of_poses = slice(len(self.imus) + len(self.cells), None)
        self.own = [Own(*kept_of(layout, one.errors), *kept_of(layout, one.place)) for one in self.imus]
        self.own += [Own(*kept_of(layout, layout[cell.name])) for cell, _ in self.cells]
        self.own += [Own(*kept_of(layout, one.unknown)) for one in self._poses]
        samples_of = np.repeat([samples, *(one.samples for one in self.further)], [6, *(f.width for f in self.further)])
        self.weight = weight_of(samples_of)
        self._set_changing()
        self._core = self._core_of(samples_of, moved)

    def _core_of(self, samples: IndexArray, moved: JointErrors | None) -> PredictionCore:
        """The same for the compiled core; samples in a tick's mean of each line, errors of the joints if they move."""
        if self._flexible is not None:
            from onboard.identification.free_flyer.prediction.core import MovingBase  # noqa: PLC0415 - few have them

            parts = self.links, self.columns, self.joint_errors, self._flexible, self.thrusters
            self._base = MovingBase(self.vehicle, self.layout, *parts)
        every = np.arange(self.layout.size + len(self.names))
        both = [(every[here], every[there]) for here, there in self.of_motion]
        of_motion = [np.concatenate(one) for one in zip(*both, strict=True)]
        bodies = self.columns, self._scaled, moved, self.thrusters
        instruments = self.imus, self.cells, self.own, samples
        drifting, by = self.drifting
        changing = Changing(self.changing, drifting, by, self._in_push)
        return PredictionCore(self.vehicle, self.layout, *bodies, *instruments, of_motion, changing)

    def _set_changing(self) -> None:
        """What of the state changes from tick to tick, and how."""
        self.biases = [
            (at, self.names.index(of)) for at, name in enumerate(self.names) if (of := drift_of(name)) in self.names
        ]
        drifting, by = self.drifting = np.array([*self.biases, *self.pushes], np.intp).reshape(-1, 2).T
        self.changing = np.concatenate([np.arange(3), drifting, self.anew_at])
        self._changes = self.changing.astype(np.int64)
        self.stated = self.sigma.copy()
        self.stated[drifting] = np.hypot(self.sigma[drifting], DRIFT_MEMORY_s * self.sigma[by])
        self.stated[self.anew_at] = np.nan
        walks = [*((of, DRIFT_MEMORY_s) for _, of in self.biases), *self.wandering]
        self._walking = np.array([of for of, _ in walks], np.intp)
        self.lasting = np.ones(len(self.names))
        self.lasting[np.concatenate([self.changing, self._walking])] = 0.0
        self.constant = np.where(self.lasting > 0.0, self.sigma, np.nan)
        self._walked = 2.0 / np.array([memory_s for _, memory_s in walks]) * self.sigma[self._walking] ** 2  # 1/s

    def _further_imu(self, one: FurtherImu) -> PlacedImu:
        at = self.layout[f"gyro_bias_rad_s {one.name}"].start
        errors, place = slice(at, at + SIZE), self.layout[f"place {one.name}"]
        return PlacedImu(*self.vehicle.pose_in_base(one.frame), one.samples, errors, place)

    def _pose(self, one: FurtherPose) -> PlacedPose:
        layout, (R_BM, p_BoMo_B) = self.layout, self.vehicle.pose_in_base(one.frame)
        own = slice(layout[f"attitude {one.name}"].start, layout[f"delay_s {one.name}"].stop)
        begin = int(layout.estimated(f"attitude {one.name}")[0])
        return PlacedPose((quaternion_of(R_BM), p_BoMo_B), own, slice(begin, begin + MOTION.stop))

    @cached_property
    def of_poses(self) -> BoolArray:
        """Lines of trackers, (m,)."""
        return np.arange(self.lines[-1].stop) >= min((own.start for own in self.lines[self._of_poses]), default=np.inf)

    @cached_property
    def of_delays(self) -> IndexArray:
        """Places of delays in the state."""
        return np.flatnonzero(["delay" in name for name in self.names])

    @property
    def no_ticks(self) -> Ticks:
        """None of this vehicle's."""
        return Ticks.none(len(self.vehicle.joints), self.lines[-1].stop, len(self.thrusters))

    def joint_noise(self, q: FloatArray, joint_sigma: FloatArray, state: FloatArray) -> FloatArray:
        """Effect of the joints' noise on the prediction, one sigma, (n, m).

        Args:
            q: joint positions, (n, joints).
            joint_sigma: of joint rates and accelerations, (n, 2, joints).
            state: (p,).
        """
        return sigma_of(self.joint_noises(q, state, joint_sigma)[0])

    def rippled(self, ticks: Ticks, wrong: IndexArray) -> FloatArray:
        """The joints' noise at some ticks, (n, 2, joints), where some constants may be far off, by their places.

        Cyclic errors are functions of the angle. With a wrong scale they turn at another rate than these, which do not
        fit them, and all of them is noise.
        """
        noise, off = ticks.joint_sigma, {self.names[at] for at in wrong}
        if not any(name.startswith("scale_") for name in off):
            return noise
        every = [name for name in self.layout.every if name.startswith("cyclic_")]
        for k, joint in enumerate(self.vehicle.joints):
            ends = tuple(f"_{wave}_{joint.name}" for wave in ("cos", "sin"))
            own = [name for name in every if name.endswith(ends) and name in self.names]
            if own and f"scale_{joint.name}" in off:
                functions = ticks.cyclic[:, 1:, [every.index(name) for name in own]]
                sigma = self.sigma[[self.names.index(name) for name in own]]
                noise = noise.copy()
                noise[:, :, k] = np.hypot(noise[:, :, k], np.linalg.norm(sigma * functions, axis=2))
        return noise

    def joint_noises(self, q: FloatArray, state: FloatArray, *joint_sigma: FloatArray) -> list[FloatArray]:
        """What one sigma of each joint's rate and acceleration does, (n, 2 joints, m), for each of some sigmas."""
        return self._noise.by_joint(q, self.chi(state), *joint_sigma)

    def predict(
        self,
        q: FloatArray,
        dq: FloatArray,
        ddq: FloatArray,
        state: FloatArray,
        cyclic: FloatArray | None = None,
        thrust: FloatArray | None = None,
    ) -> TickPrediction:
        """From a state at the first of b + 2 ticks, bodies by :mod:`.scaled`, linear in what pushes the base.

        What a push does goes with it over all masses, so that twice both move alike. About a push that changes, that
        direction would change, and what is known of a push at one time would tell all masses at another.

        Args:
            q: joint positions at these ticks as read, (b + 2, joints).
            dq: joint rates.
            ddq: joint accelerations.
            state: (p,) at the first of them.
            cyclic: functions of the joints' cyclic errors and their derivatives, (b + 2, 3, m); None: zero.
            thrust: forces of the thrusters, means over the ticks, (b + 2, k) N; None: zero.

        Raises:
            SignalError: fewer than four ticks.
        """
        n = len(q)
        if n < 4:
            raise SignalError(f"{n} ticks; predict four or more")
        bent = None
        if self._flexible is None:
            made = self._core.begin(n, self.period_s, (q, dq, ddq, cyclic, thrust), state)
        else:
            x, functions = self._unpushed(state), self._base.functions(n, cyclic)
            base, bend = self._base.predict(
                EncoderReadings(q, dq, ddq, self.period_s, functions), x, self.period_s, thrust
            )
            if not np.isfinite(bend.b).all():
                return TickPrediction.none(n - 2, self.lines[-1].stop, len(state), len(self.changing))
            made = self._core.begin_from(base, self.period_s, (q, dq, ddq), state)
            bent = self._flexible.along(base, bend, x, self.period_s, self.of_motion, len(state))
        if self._poses:
            self._track(made, base if bent else self._core.base(made), self._unpushed(state))
        if bent is not None:
            more, weight = bent.added(made.by_motion), self.weight[:, None]
            made.jacobian[:] += (more[2:] + more[:-2]) * weight + (1.0 - 2.0 * weight) * more[1:-1]
            bent.carry(made.transition, made.carried)
        self._core.end(made, state)
        return TickPrediction(*made[:4])

    def _unpushed(self, state: FloatArray) -> FloatArray:
        """All unknowns without what pushes."""
        linear = self._scaled.linear(state)
        linear[self._in_push] = 0.0
        return self.layout.whole(linear)

    def _track(self, made: PredictionBegun, base: BasePrediction, x: FloatArray) -> None:
        """Lines of the trackers, and what these add to what is carried on."""
        first = 3 + len(self.drifting[0])
        for pose, own, kept in zip(self._poses, self.lines[self._of_poses], self.own[self._of_poses], strict=True):
            at_joints = self.joint_errors if self.in_joints.size else None
            shown = predict_pose(base, self.period_s, pose.mount, x[pose.unknown], self.columns, at_joints)
            made.values[:, own], made.by_motion[:, own] = shown.values[1:-1], shown.by_motion
            made.jacobian[:, own, kept.errors] = shown.d_own[1:-1][:, :, kept.of_errors]
            rows = slice(first, first + MOTION.stop)
            made.carried[pose.motion], made.transition[rows] = shown.carried, 0.0
            made.transition[rows, kept.errors] = shown.carried_by_own[:, kept.of_errors]
            for here, there in self.of_motion:
                made.transition[rows, here] = shown.carried_by_motion[:, there]
            first = rows.stop

    def carried(
        self,
        predicted: TickPrediction,
        start: FloatArray,
        state: FloatArray,
        covariance: FloatArray,
        joint_sigma: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """State, (p,), and covariance, (p, p), exactly symmetric, at the last predicted tick.

        Args:
            predicted: the batch.
            start: the state that it was predicted from, (p,).
            state: as the batch's measurements have corrected it at the first tick, (p,).
            covariance: of that, (p, p).
            joint_sigma: of the batch's joint rates and accelerations, (b + 2, 2, joints): bends are driven by the
                latter as they are read; None: they are exact.
        """
        c, F, p = self.changing, predicted.transition, len(state)
        carried, ticks, more = predicted.state + (state - start), len(predicted.values), np.zeros(p)
        carried[c] = predicted.state[c] + F @ (state - start)
        left = left_of(self.fading, ticks * self.period_s, p)
        if self._flexible is not None and joint_sigma is not None:
            rates = self.bends[self._flexible.compliance.count :]
            more[rates] = self._flexible.driven(joint_sigma[1:-1], self.period_s)
        more[self._walking] += ticks * self.period_s * self._walked
        given = library.given(F, len(c), p), library.given(covariance, p, p), left, more
        pointers = (library.address(part) for part in (self._changes, *given))
        return carried * left, library.call("heft_carried", p, len(c), *pointers, out=np.empty((p, p)))

    def anew(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A mean, (p,), and covariance, (p, p), with nothing known of a tracker's pose and of bends."""
        if not (at := self.anew_at).size:
            return mean, covariance
        mean, covariance = mean.copy(), covariance.copy()
        mean[at], covariance[at], covariance[:, at] = 0.0, 0.0, 0.0
        covariance[at, at] = self.sigma[at] ** 2
        return mean, covariance

    def aged(self, covariance: FloatArray, ticks: int) -> FloatArray:
        """The state's covariance, (p, p), after so many ticks' noise of drifts, clocks' times and pushes."""
        P = covariance.copy()
        P[self._walking, self._walking] += ticks * self.period_s * self._walked
        return P

    def chi(self, state: FloatArray) -> FloatArray:
        """Standard parameters of all links, (10 x links,)."""
        return self.links.chi(state[PAYLOAD], self.links.basis @ self._scaled.linear(state)[self.in_links])
