"""Gravity of the place where a bench stands."""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.vehicle import STANDARD_GRAVITY_M_S2

ANYWHERE_m_s2 = 0.015  # on the ground it is between 9.78 and 9.83
ANOMALY_m_s2 = 5e-4  # of the ground below, 50 mGal
_PER_METRE = 3.086e-6


class Gravity(NamedTuple):
    """Gravity and how well it is known."""

    gravity_m_s2: float
    sigma_m_s2: float


def place(latitude_deg: float | None, height_m: float = 0.0) -> Gravity:
    """Normal gravity (WGS 84, Somigliana's formula) less that of the height; the standard value where not known.

    Raises:
        ValueError: no latitude or height on Earth.
    """
    if latitude_deg is None:
        return Gravity(STANDARD_GRAVITY_M_S2, ANYWHERE_m_s2)
    if not (abs(latitude_deg) <= 90.0 and -500.0 <= height_m <= 9000.0):
        raise ValueError(f"latitude {latitude_deg:g} deg, height {height_m:g} m: no place on Earth; correct them")
    square = np.sin(np.deg2rad(latitude_deg)) ** 2
    normal = 9.7803253359 * (1.0 + 1.93185265241e-3 * square) / np.sqrt(1.0 - 6.69437999013e-3 * square)
    return Gravity(float(normal - _PER_METRE * height_m), ANOMALY_m_s2)
