"""``[pivot]``: a spherical air bearing, and the masses that balance the base on it."""

from pydantic import Field, model_validator

from onboard.section import Direction, NotNegative, Positive, Section


class Balance(Section):
    """A mass on a threaded rod of the base, along an axis of the base."""

    name: str
    mass_kg: Positive
    axis: Direction


class Pivot(Section):
    """What turns the base besides gravity, 1 sigma about none, and the masses that balance it.

    ``drag``: of the air, in proportion to the rate. ``jets``: of the bearing's jets, about the vertical.
    ``gyro_per_g``: each element of what 1 g adds to the gyro's readings. ``proof``: relative, of the payload link, a
    known mass that is attached for a part of the run.
    """

    drag_sigma_N_m_s: NotNegative = 1e-3  # noqa: N815
    jets_sigma_N_m: NotNegative = 1e-4  # noqa: N815
    gyro_per_g_sigma_rad_s: NotNegative = 1e-3
    proof_sigma: NotNegative = 0.002
    balance: list[Balance] = Field(default_factory=list)

    @model_validator(mode="after")
    def _each_name_once(self) -> "Pivot":
        names = [one.name for one in self.balance]
        if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
            raise ValueError(f"two balance masses are called {', '.join(twice)}; give each another name")
        return self
