"""Columns without names: a block of columns, and the block of its derivatives: angles of joints and their rates.

Where no block is the derivative of another, the number of a vehicle's joints says how long a block is. Six columns, and
the temperature between them, are an IMU's where three of them have the size of gravity at rest.
"""

import numpy as np

from onboard.ground.log.bring_in.guess import magnitudes
from onboard.ground.log.bring_in.guess.groups import ColumnGroup, Group, NumberColumn
from onboard.ground.log.bring_in.guess.magnitudes import FloatArray

_MOST_JOINTS = 8


def recognised(table: ColumnGroup, vehicle_joints: int = 0) -> ColumnGroup:
    """A table whose columns are numbered, with the groups that its numbers show.

    Args:
        table: of numbered columns.
        vehicle_joints: that are measured; 0: not known.
    """
    columns = sorted(table.columns, key=lambda one: int(one.name))
    clock = table.clock
    if clock is None or len(clock.seconds) < 50:
        return table
    values = np.column_stack([one.values for one in columns]).astype(np.float64)
    for joints in range(min(_MOST_JOINTS, len(columns) // 2), 1, -1):
        for first in range(len(columns) - 2 * joints + 1):
            angles, rates = values[:, first : first + joints], values[:, first + joints : first + 2 * joints]
            ratio = magnitudes.slope(angles, rates, clock.seconds)
            if ratio is not None and any(abs(ratio * size - 1.0) < 0.2 for size in (1.0, 1e3, 1e-3, 1e6, 1e9)):
                blocks = [columns[k : k + joints] for k in range(first, len(columns) - joints + 1, joints)]
                kinds = ["angle", "rate", *["torque"] * (len(blocks) > 2)]
                return _named(table, blocks, kinds, ["", "", "it follows the rates"])
    if vehicle_joints and len(columns) in (vehicle_joints, 2 * vehicle_joints):
        blocks = [columns[k : k + vehicle_joints] for k in range(0, len(columns), vehicle_joints)]
        why = f"by its place: the vehicle file has {vehicle_joints} joints"
        return _named(table, blocks, ["angle", "torque"][: len(blocks)], [why, why])
    return _imu(table, columns, values)


def _imu(table: ColumnGroup, columns: list[NumberColumn], values: FloatArray) -> ColumnGroup:
    """With gyro and accelerometer, where three columns of six, or of seven, are as large as gravity at rest."""
    if len(columns) not in (6, 7):
        return table
    blocks = [columns[:3], columns[-3:]]
    at_rest = [magnitudes.of_accelerations(one, "").why.endswith("at rest") for one in (values[:, :3], values[:, -3:])]
    if at_rest.count(True) != 1:
        return table
    kinds = ["accel", "gyro"] if at_rest[0] else ["gyro", "accel"]
    why = ["its size at rest is gravity's" if kind == "accel" else "it stands beside accelerations" for kind in kinds]
    return _named(table, blocks, kinds, why, "xyz")


def _named(
    table: ColumnGroup, blocks: list[list[NumberColumn]], kinds: list[str], why: list[str], labels: str = "12345678"
) -> ColumnGroup:
    more = ", ".join(f"{block[0].name} to {block[-1].name}" for block in blocks[len(kinds) :])
    unit = ": N m, or A of the motors' currents" + (f"; or columns {more}" if more else "")
    groups = [
        Group(kind, (kind,), "", dict(zip(labels, block, strict=False)), False, own and own + unit * (kind == "torque"))
        for kind, own, block in zip(kinds, why, blocks, strict=False)
    ]
    used = {one.name for block in blocks[: len(kinds)] for one in block}
    rest = tuple(one for one in table.columns if one.name not in used)
    return table._replace(groups=tuple(groups), rest=rest)
