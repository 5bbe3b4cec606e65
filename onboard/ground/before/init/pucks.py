"""Pucks of a new vehicle on an air-bearing table: where they are drawn, or where they can do for any."""

import json
from collections.abc import Iterable

from onboard.ground.before.init.drawing import DrawnUrdf

_RADIUS_m = 0.2  # of the sketched base
_SIN_60 = 0.5 * 3.0**0.5
_TABLE = """
[planar]                       # 1 sigma
tilt_sigma_m_s2 = 0.002        # as the table was levelled
velocity_sigma_m_s = 0.02      # as the base is let go
rate_sigma_rad_s = 1.0
sag_sigma = 1.0                # drag of all pucks may grow so as their supply sags
"""


def places(drawn: DrawnUrdf | None) -> dict[str, str]:
    """Frames and their places in the base: as drawn, or one in the middle and three around it.

    These four drag like pucks anywhere among them, where nobody says where they are: their sum, its centre and what it
    is about the vertical are free.
    """
    if drawn and drawn.pucks:
        return dict.fromkeys(drawn.pucks, "")
    x = drawn.radius_m if drawn else _RADIUS_m
    around = (0.0, 0.0), (x, 0.0), (-0.5 * x, _SIN_60 * x), (-0.5 * x, -_SIN_60 * x)
    return {f"puck_{k}": f"{at[0]:.4g} {at[1]:.4g} 0" for k, at in enumerate(around, 1)}


def note(drawn: DrawnUrdf) -> str:
    """Where they are taken to be."""
    if drawn.pucks:
        return f"the pucks are at {', '.join(drawn.pucks)}"
    return (
        f"four pucks are put in, in the middle and {drawn.radius_m:.2g} m around it: put in the places of yours, "
        "or call links of the URDF puck_1, puck_2 .. there"
    )


def tables(frames: Iterable[str]) -> str:
    """Of the vehicle file: the section of the table, and a table of each puck."""
    return _TABLE + "".join(
        f"""
[[planar.puck]]
frame = {json.dumps(frame)}
viscous_sigma_N_s_m = 5.0      # how much it may drag
coulomb_sigma_N = 0.5
"""
        for frame in frames
    )
