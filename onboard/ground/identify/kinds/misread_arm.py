"""What columns of a recorded arm may be taken for, where its answer is refused: signs, places, order, units.

Each way to read the angles and torques competes with the file as stated by what the rows leave that are linear in the
parameters, which cost as much as the vehicle file says that they are known (ridge regression about the drawing).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.estimation.arrays import BoolArray, FloatArray, finite
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.identification import build_identifier
from onboard.ground.identify.kinds.identified import Identified
from onboard.ground.identify.kinds.tick_recorder import TickRecorder
from onboard.ground.identify.replay.feed import AT_ONCE_s, fed
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.misread import JointReading, exchanged, score, turned
from onboard.identification.rows.checks.agreement import MOST_UNEXPLAINED
from onboard.identification.rows.checks.remade import MOST_TICKS
from onboard.identification.standing import Level
from onboard.identification.windows import SHORTEST
from onboard.recording.reader import LogReader
from onboard.regressor.rows import RowModel, standing


class ArmReading(NamedTuple):
    """A way to read angles and torques."""

    said: str  # what is otherwise than stated
    angles: JointReading
    torque_order: tuple[int, ...]  # of each torque
    torque_factor: FloatArray  # (joints,) of these
    mistakes: int
    held_before: bool = False  # the payload is held in the recording that is said to be without it


def with_mistake(vehicle: config.Vehicle, log: LogReader, found: Identified) -> Identified:
    """A result; where it is *do not use*, with what :func:`misread_arm` says as the first reason of its verdict."""
    judged = found.verdict
    said = misread_arm(vehicle, log) if judged.level is Level.DO_NOT_USE else ""
    return replace(found, verdict=judged._replace(reasons=(said, *judged.reasons))) if said else found


def misread_arm(vehicle: config.Vehicle, log: LogReader) -> str:
    """As what the columns of an arm on a fixed base are to be read that leaves much less; empty: none, or another base.

    Args:
        vehicle: whose file is that of the recording.
        log: a recording of angles and torques of all joints.
    """
    if vehicle.file.vehicle.base_kind.moves or not vehicle.is_recorded:
        return ""
    identifier, model = build_identifier(vehicle)
    rows, joints = identifier.model, [joint.name for joint in model.joints]
    if [row.friction_joint for row in rows.rows] != joints:
        return ""
    recorder = TickRecorder("payload", len(joints), rows=tuple(row.name for row in rows.rows))
    fed(Estimator(vehicle, recorder), log, AT_ONCE_s)
    ticks, held = Ticks.joined(recorder.ticks), np.concatenate(recorder.attached)
    whole = np.flatnonzero(finite([ticks.q, ticks.dq, ticks.ddq, ticks.measured]))
    some = whole[:: max(1, len(whole) // MOST_TICKS)]
    recording = _ArmRecording(rows, identifier.taken.prior_root, ticks.part(some), held[some])
    n = len(joints)
    stated = ArmReading("", JointReading.stated(n), tuple(range(n)), np.ones(n), 0)
    if recording.ticks < SHORTEST:
        return ""
    least = recording.left(stated)
    ways = [
        (score(recording.left(way), way.mistakes), way)
        for way in _others(stated, joints)
        if not way.held_before or recording.both
    ]
    best, best_way = min(ways, key=lambda one: one[0])
    if best >= least:
        return ""
    what = "merge them in their order" if best_way.held_before else "correct the mapping, or the URDF"
    return f"much less would be left over if {best_way.said}: {what}"


class _ArmRecording:
    """Some ticks of a recording."""

    def __init__(self, rows: RowModel, prior_root: FloatArray, ticks: Ticks, held: BoolArray) -> None:
        self._rows, self._root, self._held = rows, prior_root[:, prior_root.any(axis=0)], held
        self._joints, self._measured = (ticks.q, ticks.dq, ticks.ddq), ticks.measured
        self.ticks = len(held)
        self.both = bool(self._held.any() and not self._held.all())  # with the payload and without

    def left(self, way: ArmReading) -> float:
        """Squares that are left over, of each torque as a share that is refused, and of what is stated, in sigmas."""
        motion, n = way.angles.joints(*self._joints), self.ticks
        measured = way.torque_factor * self._measured[:, list(way.torque_order)]
        held = np.asarray(self._held != way.held_before, np.bool_)
        Y = self._rows.regressor(*motion, standing(self._rows.vehicle, n), held)
        size = measured.std(axis=0)
        weight = 1.0 / (MOST_UNEXPLAINED * np.where(size > 0.0, size, np.inf))
        J = (Y @ self._root * weight[:, None]).reshape(n * len(size), -1)
        aim = ((measured - Y @ self._rows.chi) * weight).ravel()
        information = J.T @ J + np.eye(J.shape[1])
        z = np.linalg.solve(information, J.T @ aim)
        return float(((aim - J @ z) ** 2).sum() + z @ z)


def _others(stated: ArmReading, names: Sequence[str]) -> Iterator[ArmReading]:
    """With a mistake."""
    n, stated = len(names), stated._replace(mistakes=1)
    yield stated._replace(said="what is held is in the recording before, and not in the other one", held_before=True)
    angles = stated.angles
    for name, factor in zip(names, turned(n), strict=True):
        other = angles._replace(factor=factor)
        yield stated._replace(said=f"the angle of {name} counts the other way", angles=other)
        yield stated._replace(said=f"the torque of {name} counts the other way", torque_factor=factor)
        both = f"angle and torque of {name} count the other way"
        yield stated._replace(said=both, angles=other, torque_factor=factor)
    for said, other in angles.from_other_zeros(names):
        yield stated._replace(said=said, angles=other, mistakes=2)
    for pair, order in exchanged(angles.order, names):
        other = angles._replace(order=order)
        yield stated._replace(said=f"the angles of {pair} are exchanged", angles=other)
        yield stated._replace(said=f"the torques of {pair} are exchanged", torque_order=order)
        yield stated._replace(said=f"{pair} are exchanged", angles=other, torque_order=order)
    # bodies of negative mass explain it as well, and cost little where masses are hardly known: no price of a mistake
    yield stated._replace(said="all torques count the other way", torque_factor=-np.ones(n), mistakes=0)
    for size, said in ((1e-3, "thousandths of"), (1e3, "a thousand times")):
        yield stated._replace(said=f"all torques are {said} what they are read as", torque_factor=np.full(n, size))
    for said, other in angles.in_other_units():
        yield stated._replace(said=said, angles=other)
