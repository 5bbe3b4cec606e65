"""Parts of a vehicle's world that any scenario can name: servos and stops of joints, the motion of what carries a base.

``vehicle_tables`` has the scenario that they belong to, and says which base can have which.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

from typing import Literal

from pydantic import PositiveFloat, model_validator

from hil_sim.scenario.sensor_tables import Fraction, NonNegative, Table, Vector


class ServoTable(Table):
    """``[servo.JOINT]``, ``[servo.default]``: the joint is driven by a position loop instead of moving as commanded.

    ``stiffness``, ``damping``: of the loop; without, those of ``bandwidth_Hz`` and a damping ratio of 0.8 with what the
    joint turns at the start. ``torque_limit``: the URDF's effort where not given. It feeds forward what its model of
    the vehicle asks for, and ``friction_feedforward`` of the Coulomb friction.

    ``coulomb``, ``viscous``, ``rotor``: of the drive, on its side of a load cell; drawn by ``[friction]`` where not
    given. ``ripple``: torque of the gear, so many cycles a revolution of the joint.
    """

    bandwidth_Hz: PositiveFloat = 8.0
    stiffness_N_m_rad: PositiveFloat | None = None
    damping_N_m_s_rad: PositiveFloat | None = None
    torque_limit_N_m: PositiveFloat | None = None
    friction_feedforward: Fraction = 0.9
    coulomb_N_m: NonNegative | None = None
    viscous_N_m_s_rad: NonNegative | None = None
    rotor_kg_m2: PositiveFloat | None = None
    ripple_N_m: NonNegative = 0.0
    ripple_cycles_per_rev: PositiveFloat = 200.0


class StopTable(Table):
    """``[[stop]]``: a boss on the link beyond a joint meets a block on the link before it, beyond any load cell.

    ``end``: the side on which the joint comes to it. Stiffness and damping are those at the boss, ``radius_mm`` from
    the joint's axis. The joint needs a servo: one that moves as commanded goes through it.
    """

    joint: str
    end: Literal["upper", "lower"]
    at_deg: float
    radius_mm: PositiveFloat = 50.0
    stiffness_N_mm: PositiveFloat = 400.0
    damping_N_s_mm: PositiveFloat = 0.8


class ConingTable(Table):
    """``[coning]``: what carries a prescribed base is a free axisymmetric body, its axis the base's z axis.

    ``nutation_rate_rad_s``: transverse rate of the cone; its phase is drawn.
    """

    spin_rad_s: float = 0.0
    nutation_rate_rad_s: NonNegative = 0.0
    roll_to_pitch_inertia: PositiveFloat = 0.06
    residual_rate_rad_s: Vector = (0.0, 0.0, 0.0)
    centre_of_mass_to_base_m: Vector = (0.0, 0.0, 0.0)


class StructuralMode(Table):
    """A structural mode: lightly damped, driven by noise; ``rms`` by axis, in the unit of its list."""

    frequency_Hz: PositiveFloat
    damping_ratio: PositiveFloat
    rms: Vector


class Vibration(Table):
    """``[vibration]``: what the structure adds to the rigid motion of a prescribed base, by its axes."""

    broadband_mg: Vector = (0.0, 0.0, 0.0)
    broadband_band_Hz: tuple[PositiveFloat, PositiveFloat] = (5.0, 150.0)
    linear_mode_mg: tuple[StructuralMode, ...] = ()
    angular_mode_mrad_s: tuple[StructuralMode, ...] = ()

    @property
    def highest_Hz(self) -> float:  # noqa: N802
        """The highest frequency in it."""
        modes = (*self.linear_mode_mg, *self.angular_mode_mrad_s)
        return max([self.broadband_band_Hz[1], *(mode.frequency_Hz for mode in modes)])

    @model_validator(mode="after")
    def _band_rises(self) -> "Vibration":
        if self.broadband_band_Hz[0] >= self.broadband_band_Hz[1]:
            raise ValueError("broadband_band_Hz must rise")
        return self


class AirTable(Table):
    """``[air]``: dynamic pressure that grows exponentially about a reference time, with gusts; the base is prescribed.

    ``pressure_Pa``: at ``reference_s``. The wind blows along a direction that turns against the ``spin_rad_s`` of
    ``[coning]``, from an azimuth that is drawn, ``wind_elevation_deg`` out of the plane of the base's x and y axes.

    ``carrier_area_over_mass_m2_kg``: by which it brakes what carries the base, and with it the base;
    ``pitch_moment``, ``roll_moment``: angular acceleration per that deceleration, across the wind and about z.
    """

    reference_s: float = 0.0
    pressure_Pa: NonNegative
    growth_time_s: PositiveFloat
    wind_elevation_deg: float = 0.0
    carrier_area_over_mass_m2_kg: NonNegative = 0.0
    pitch_moment_rad_s2_per_m_s2: float = 0.0
    roll_moment_rad_s2_per_m_s2: float = 0.0
    gust_fraction: NonNegative = 0.0
    gust_time_s: PositiveFloat = 0.25


class DragTable(Table):
    """``[[drag]]``: the air of ``[air]`` pushes a link at a place of its frame, by area times drag coefficient."""

    link: str
    area_m2: NonNegative
    centre_of_pressure_mm: Vector
