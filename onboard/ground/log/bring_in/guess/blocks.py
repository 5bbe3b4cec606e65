"""Columns without names: a block of columns, and the block of its derivatives: angles of joints and their rates."""

import numpy as np

from onboard.ground.log.bring_in.guess import magnitudes
from onboard.ground.log.bring_in.guess.groups import Column, Group, Table

_MOST_JOINTS = 8
_TIMES = (0.8, 1.25)  # the derivative over the rate, in one unit of angles and any of time


def recognised(table: Table) -> Table:
    """A table whose columns are numbered, with the groups that its numbers show."""
    columns = sorted(
        (*table.rest, *(c for g in table.groups for c in g.columns.values())), key=lambda one: int(one.name)
    )
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
                return _named(table, blocks)
    return table


def _named(table: Table, blocks: list[list[Column]]) -> Table:
    kinds = ["angle", "rate", *["torque"] * (len(blocks) > 2)]
    more = ", ".join(f"{block[0].name} to {block[-1].name}" for block in blocks[3:])
    doubt = "it follows the rates: N m, or A of the motors' currents" + (f"; or columns {more}" if more else "")
    groups = [
        Group(kind, (kind,), "", {str(k + 1): one for k, one in enumerate(block)}, False, doubt * (kind == "torque"))
        for kind, block in zip(kinds, blocks, strict=False)
    ]
    used = {one.name for block in blocks[: len(kinds)] for one in block}
    rest = [
        one for one in (*table.rest, *(c for g in table.groups for c in g.columns.values())) if one.name not in used
    ]
    return table._replace(groups=tuple(groups), rest=tuple(rest))
