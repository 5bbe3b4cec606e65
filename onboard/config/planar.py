"""``[planar]``: an air-bearing table and the base's pucks."""

from pydantic import Field, model_validator

from onboard.section import NotNegative, Positive, Section


class Puck(Section):
    """A puck at the origin of a frame fixed in the base, with the sigmas of its drag coefficients about zero.

    ``viscous``: drag proportional to the slip; ``coulomb``: drag independent of the slip.
    """

    frame: str
    viscous_sigma_N_s_m: Positive  # noqa: N815
    coulomb_sigma_N: Positive  # noqa: N815


class Planar(Section):
    """Sigmas of the unknowns of a run.

    ``tilt``: gravity along the table, by axis; a milliradian is 0.01 m/s^2. ``velocity`` (by axis) and ``rate`` (yaw)
    of the base where the run begins.
    """

    tilt_sigma_m_s2: NotNegative
    velocity_sigma_m_s: Positive
    rate_sigma_rad_s: Positive
    puck: list[Puck] = Field(default_factory=list)

    @model_validator(mode="after")
    def _each_frame_once(self) -> "Planar":
        frames = [puck.frame for puck in self.puck]
        if twice := [frame for frame in dict.fromkeys(frames) if frames.count(frame) > 1]:
            raise ValueError(f"two pucks are at {', '.join(twice)}; give each its own frame")
        return self
