"""What a free-flyer's unknowns and instruments are for the compiled core, and a prediction that it makes.

One call makes motion and lines of a vehicle with stiff joints; of flexible ones, whose bends are iterated, the motion
is given. What trackers and bends add is put in between; one call more makes means over ticks of what is known at
instants. Computed in ``onboard/native/src/prediction.c``.
"""

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from onboard.dynamics.compliance import Bend, BentVehicle
from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.free_flight import BasePrediction, Push, base_of, bodies_from_rate, predict_base_from_rate
from onboard.dynamics.joint_errors import PER_JOINT, EncoderReadings, JointErrors
from onboard.dynamics.kinematics import chain_motion, chain_of, motion_size
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import Columns
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.identification.free_flyer.prediction.further import FurtherCell, PlacedImu, Thruster
from onboard.identification.free_flyer.prediction.imu_errors import SIZE, weight_of
from onboard.identification.free_flyer.prediction.parameters import FlexibleJoints, Own, UncertainLinks, UnknownLayout
from onboard.identification.free_flyer.prediction.scaled import Scaled
from onboard.native import library, structures

_CELL = 7  # errors of a load cell, and friction of a joint's torque


class Changing(NamedTuple):
    """Places in the state of what changes from tick to tick, and of what pushes the base unknown."""

    every: IndexArray  # (c,) the rate first, then what drifts
    drifting: IndexArray  # (d,)
    by: IndexArray  # (d,) the rate of change of each
    pushes: IndexArray  # (k,)


class PredictionBegun(NamedTuple):
    """A prediction of n ticks that is under way; its arrays are parts of ``out``."""

    values: FloatArray  # (n - 2, m)
    jacobian: FloatArray  # (n - 2, m, p)
    carried: FloatArray  # (p,) without what pushes
    transition: FloatArray  # (c, p)
    by_motion: FloatArray  # (n, m, columns) at instants
    out: FloatArray
    motion: FloatArray  # of chain and base, empty where that was given


class PredictionCore:
    """The unknowns and instruments of one vehicle.

    Args:
        vehicle: the model.
        layout: of all unknowns.
        columns: of payload and uncertain links.
        scaled: these, by their errors in the drawing.
        errors: of the joints; None: they have none.
        thrusters: whose forces are known.
        imus: fixed in the base.
        cells: of the arm.
        own: where the errors of each of these stand.
        lines: of all instruments.
        samples: in a tick's mean of each line, (lines,).
        of_motion: places in the state, and among the columns of the base's motion, (k,) each.
        changing: what changes.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        layout: UnknownLayout,
        columns: Columns,
        scaled: Scaled,
        errors: JointErrors | None,
        thrusters: Sequence[Thruster],
        imus: Sequence[PlacedImu],
        cells: Sequence[tuple[FurtherCell, CutWrench]],
        own: Sequence[Own],
        samples: IndexArray,
        of_motion: Sequence[IndexArray],
        changing: Changing,
    ) -> None:
        joints, links, p = len(vehicle.joints), len(vehicle.links), len(layout.names)
        self._cuts, self._errors, self._thrusters = [cut for _, cut in cells], errors, len(thrusters)
        self._functions = 0 if errors is None else len(errors.of_cyclic)
        disturbed = layout.estimated("disturbance").size > 0
        self._pushes = self._thrusters + 12 * disturbed
        self._joints, self._links, self._size, self._lines = joints, links, p, len(samples)
        self._width = 3 + 10 * len(columns.links) + (0 if errors is None else errors.columns) + self._pushes
        self._changing = len(changing.every)
        instruments = self._instruments(layout, imus, cells)
        own_lists = self._own(own[: len(imus) + len(cells)], len(imus), p)
        runs = _runs(library.indices(of_motion[0], p), np.ascontiguousarray(of_motion[1], np.int64))
        counts = len(imus), len(cells), len(samples), len(runs), self._changing, len(changing.drifting)
        places = [layout[name].start for name in ("links", "joints", "cyclic", "thrusters")]
        wrenches: FloatArray = np.ascontiguousarray(np.array([one.wrench for one in thrusters]).reshape(-1, 6).T)
        self.compiled = structures.PredictorStruct(
            *(p, layout.size, joints, links, self._thrusters, int(disturbed), *counts, len(changing.pushes), *places),
            *(vehicle.tree.compiled, columns.compiled(links), None if errors is None else errors.compiled),
            *(library.indices(layout.kept, layout.size), library.indices(scaled.at, p)),
            *(library.given(vehicle.chi, 10 * links), *scaled.drawn, wrenches, *instruments, *own_lists, runs),
            library.given(weight_of(samples), len(samples)),
            *(library.indices(part, p) for part in changing),
        )

    @staticmethod
    def _instruments(
        layout: UnknownLayout, imus: Sequence[PlacedImu], cells: Sequence[tuple[FurtherCell, CutWrench]]
    ) -> tuple[FloatArray, IndexArray, IndexArray]:
        """Frames of IMUs, (k, 12); errors, place and samples of each; of cells errors, joint and samples."""
        frames = np.array([np.append(one.R_BS, one.p_BoSo_B) for one in imus], np.float64)
        numbers = np.array([(one.errors.start, one.place.start, one.samples) for one in imus], np.int64)
        of_cells = [
            (layout[one.name].start, -1 if one.friction is None else one.friction.joint, one.samples)
            for one, _ in cells
        ]
        return frames, numbers, np.array(of_cells, np.int64).reshape(-1, 3)

    @staticmethod
    def _own(own: Sequence[Own], imus: int, size: int) -> tuple[IndexArray, IndexArray, IndexArray]:
        """How many errors of each instrument are estimated, their places in the state, and among its errors."""
        here, there = list[IndexArray](), list[IndexArray]()
        for k, one in enumerate(own):
            parts = (one.errors, one.of_errors, SIZE), (one.place, one.of_place, 3)
            for first, (at, of, most) in zip((0, SIZE), parts, strict=True):
                here.append(np.arange(size)[at])
                there.append(first + np.arange(most if k < imus else _CELL)[of])
        counts = np.array([len(a) + len(b) for a, b in zip(here[::2], here[1::2], strict=True)], np.int64)
        return counts, library.indices(np.concatenate(here), size), library.indices(np.concatenate(there), SIZE + 3)

    def begin(
        self, n: int, period_s: float, readings: tuple[FloatArray | None, ...], state: FloatArray
    ) -> PredictionBegun:
        """Of a vehicle with stiff joints, from a state, (p,), at the first of n ticks.

        Args:
            n: four or more.
            period_s: between ticks.
            readings: positions, rates and accelerations of the joints, (n, joints); functions of cyclic errors,
                (n, 3, m), forces of thrusters, (n, k) N, None for zero.
            state: that.

        Raises:
            ArrayError: shapes that do not fit.
        """
        *joints, cyclic, thrust = readings
        functions = np.zeros((n, 3, self._functions)) if cyclic is None else cyclic
        given = [*joints, functions if self._errors is not None else None, thrust if self._thrusters else None]
        nj, nl = self._joints, self._links
        chain = n * (24 * nl + 30 * nj + 12 * (nj + 1))
        corrected = 0 if self._errors is None else 3 * n * (3 * nj + self._functions)
        screws = 0 if self._errors is None else 72 * nj
        base = motion_size(n, nl) + n * (12 * self._width + 54 + screws)
        made = self._empty(n, self._width, chain + corrected + base)
        (pointers, _kept), state = self._pointers(n, given), library.given(state, self._size)
        of = ctypes.byref(self.compiled), *self._of_cuts(errors=self._errors is not None)
        library.call("heft_predict", *of, n, period_s, pointers, library.address(state), out=made.out)
        return made

    def begin_from(
        self, base: BasePrediction, period_s: float, joints: Sequence[FloatArray], state: FloatArray
    ) -> PredictionBegun:
        """As :meth:`begin`, where the base moves so; joints: rates and accelerations after positions."""
        n, total = len(base.rate), base.along.shape[2]
        compiled, moving = base.compiled(), [cut.moving(base) for cut in self._cuts]
        made = self._empty(n, total, 0)
        (pointers, _kept), state = self._pointers(n, [*joints, None, None]), library.given(state, self._size)
        cuts, errors = self._of_cuts(errors=base.displaced is not None)
        motion = ctypes.byref(compiled), ctypes.byref(moving[0]) if moving else None
        arguments = cuts, errors, period_s, pointers, library.address(state)
        library.call("heft_shown", ctypes.byref(self.compiled), *motion, *arguments, out=made.out)
        return made

    def end(self, made: PredictionBegun, state: FloatArray) -> None:
        """Means over ticks of what is known at instants, derivatives by the state's own, what pushes: in place."""
        n, _, total = made.by_motion.shape
        given = library.given(state, self._size)
        numbers = n, total, library.address(given)
        library.call("heft_linked", ctypes.byref(self.compiled), *numbers, out=made.out)

    def base(self, made: PredictionBegun) -> BasePrediction:
        """The motion that was made at :meth:`begin`."""
        n, nj, nl = len(made.by_motion), self._joints, self._links
        size = n * (24 * nl + 30 * nj + 12 * (nj + 1))
        frames, functions, rest = chain_of(made.motion[:size], n, nl, nj).links, None, made.motion[size:]
        if self._errors is not None:
            first, size = 3 * n * nj, 3 * n * (3 * nj + self._functions)
            functions, rest = rest[first:size].reshape(n, 3, -1), rest[size:]
        joints = 0 if self._errors is None else nj
        return base_of(frames, functions, rest, joints, self._width, slice(0, 0))

    def _empty(self, n: int, total: int, motion: int) -> PredictionBegun:
        b, m, p, c = n - 2, self._lines, self._size, self._changing
        shapes = (b, m), (b, m, p), (p,), (c, p), (n, m, total)
        size = b * m * (1 + p) + p * (1 + c) + n * m * total
        out = np.empty(size + motion)
        values, jacobian, carried, transition, lines = library.carved(out, shapes)
        return PredictionBegun(values, jacobian, carried, transition, lines, out, out[size:])

    def _pointers(self, n: int, readings: Sequence[FloatArray | None]) -> tuple[Any, list[FloatArray | None]]:
        """Addresses of readings, and these."""
        nj = self._joints
        shapes = (n, nj), (n, nj), (n, nj), (n, 3, self._functions), (n, self._thrusters)
        each = zip(readings, shapes, strict=True)
        given = [None if part is None else library.given(part, *shape) for part, shape in each]
        return library.pointers(given), given

    def _of_cuts(self, *, errors: bool) -> tuple[Any, Any]:
        """Addresses of the cells' cuts, and of the errors of joints beyond them, which the vehicle has or not."""
        cuts = library.pointers([cut.compiled for cut in self._cuts])
        return cuts, library.pointers([cut.errors.compiled for cut in self._cuts]) if errors else None


def _runs(here: IndexArray, there: IndexArray) -> IndexArray:
    """Places that follow on each other in both, (k, 3): the first of each run in both, and its length."""
    first = np.flatnonzero(np.append(True, (np.diff(here) != 1) | (np.diff(there) != 1)))
    lengths = np.diff(np.append(first, len(here)))
    return np.ascontiguousarray(np.stack([here[first], there[first], lengths], axis=1), np.int64)


class MovingBase:
    """Predicts the base.

    Args:
        vehicle: the model.
        layout: of all unknowns.
        links: the uncertain ones.
        columns: of payload and links.
        joint_errors: of the joints.
        flexible: joints that give way.
        thrusters: whose forces are known.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        layout: UnknownLayout,
        links: UncertainLinks,
        columns: Columns,
        joint_errors: JointErrors,
        flexible: FlexibleJoints,
        thrusters: Sequence[Thruster],
    ) -> None:
        self._vehicle, self._layout, self._links = vehicle, layout, links
        self._columns, self._joint_errors, self._flexible = columns, joint_errors, flexible
        self._disturbed = layout.estimated("disturbance").size > 0
        self._wrenches = np.array([one.wrench for one in thrusters]).reshape(-1, 6).T  # (6, k)

    def predict(
        self, readings: EncoderReadings, x: FloatArray, period_s: float, thrust: FloatArray | None = None
    ) -> tuple[BasePrediction, Bend]:
        """With all unknowns (every one, :meth:`Layout.whole`) as they are estimated; and bends of the joints.

        Args:
            readings: of the encoders, with the functions of :meth:`functions`.
            x: all unknowns.
            period_s: between ticks.
            thrust: forces of the thrusters, (n, k) N; None: zero.
        """
        vehicle, at, flexible = self._vehicle, self._layout, self._flexible
        rate, push = x[at["start"]], None
        if self._wrenches.size:
            forces = np.zeros((len(readings.q), self._wrenches.shape[1])) if thrust is None else thrust
            push = Push(forces[:, None] * self._wrenches, 1.0 + x[at["thrusters"]])
        if self._disturbed:
            unknown = Push(_steady_and_growing(len(readings.q), period_s), x[at["disturbance"]])
            push = unknown if push is None else push.and_too(unknown)
        chi = self._links.chi(x[at["payload"]], self._links.basis @ x[at["links"]])
        own = x[at["joints"]].reshape(-1, PER_JOINT)
        told = readings.corrected(own, x[at["cyclic"]], self._joint_errors.of_cyclic)

        def bent(bend: Bend) -> BentVehicle:
            chain = chain_motion(vehicle, *flexible.compliance.added(told[:3], bend), own[:, :3])
            return BentVehicle(bodies_from_rate(chain.links, period_s, chi, rate, push), chain.screws)

        bend = flexible.compliance.follow(x[at["bends"]], flexible.springs(x), period_s, len(readings.q), bent)
        corrected = flexible.compliance.added(told[:3], bend)
        chain = chain_motion(vehicle, *corrected, own[:, :3])
        errors = self._joint_errors.along(chain, told.functions, len(flexible.compliance.functions))
        return predict_base_from_rate(chain.links, period_s, chi, rate, self._columns, errors, push), bend

    def functions(self, ticks: int, cyclic: FloatArray | None) -> FloatArray:
        """Of the joints' errors that vary in time, (n, 3, m): cyclic ones, zero for None, then those of bends."""
        count = len(self._joint_errors.of_cyclic)
        own = self._flexible.compliance.unit_functions(ticks)
        plain = np.zeros((ticks, 3, count - own.shape[2])) if cyclic is None else cyclic
        return np.concatenate([plain, own], axis=2)


@lru_cache(maxsize=16)
def _steady_and_growing(ticks: int, period_s: float) -> FloatArray:
    """A unit of each component of a wrench, constant, then growing from the first tick on, (n, 6, 12)."""
    growth = np.ones((ticks, 1, 2, 1))
    growth[:, 0, 1, 0] = period_s * np.arange(ticks)
    found = np.asarray(growth * np.eye(6)[:, None], np.float64).reshape(ticks, 6, 12)
    found.setflags(write=False)
    return found
