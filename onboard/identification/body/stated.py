"""What is stated of a body without joints: its thrusters, 1 sigma of what moves it, and its tracker."""

from typing import NamedTuple

from onboard.estimation.arrays import FloatArray
from onboard.identification.body.valves import Valve


class Thrusters(NamedTuple):
    """j thrusters, in the base's axes and on the table."""

    names: tuple[str, ...]
    force_N: FloatArray  # (j,) at level 1  # noqa: N815
    place_m: FloatArray  # (j, 2)
    direction: FloatArray  # (j,) angle of the force from x, rad
    scale_sigma: FloatArray  # (j,)
    common_sigma: float  # relative, of the force of all alike
    valves: tuple[Valve, ...]


class BodySigmas(NamedTuple):
    """1 sigma of what moves the body besides its thrusters' scales, and of what is known of these; as the keys say."""

    mass_sigma: float | None  # relative; None: nothing is known of it
    tilt_sigma_m_s2: float
    uneven_sigma_m_s2: float  # steady in a window
    turning_sigma_rad_s2: float
    drag_sigma_1_s: float
    spin_drag_sigma_1_s: float
    place_sigma_m: float  # of each thruster's lever
    turn_sigma_rad: float
    leak_sigma: float  # share of the force while it is off
    delay_ms: tuple[float, float]  # least and largest
    each_delay_sigma_ms: float
    loss_sigma_ms: float

    @property
    def delay_s(self) -> tuple[float, float]:
        """Least and largest delay."""
        low, high = self.delay_ms
        return 1e-3 * low, 1e-3 * high


class Tracker(NamedTuple):
    """Where the tracked frame is in the base, and 1 sigma of what is known of it."""

    place_m: FloatArray  # (2,)
    yaw_rad: float
    turn_sigma_rad: float
    place_sigma_m: float
    scale_sigma: float
    noise: FloatArray  # (3,) of one pose: m, m, rad
