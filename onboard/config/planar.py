"""``[planar]``: a run on an air-bearing table, and the pucks that the base floats on."""

from pydantic import Field, model_validator

from onboard.section import NotNegative, Positive, Section


class Puck(Section):
    """A puck, at the origin of a frame that is fixed in the base, and how much it may drag, 1 sigma about none.

    ``viscous``: of the drag in proportion to the slip; ``coulomb``: of the drag that is the same at any slip.
    """

    frame: str
    viscous_sigma_N_s_m: Positive  # noqa: N815
    coulomb_sigma_N: Positive  # noqa: N815


class Planar(Section):
    """What is not known of a run, 1 sigma.

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
