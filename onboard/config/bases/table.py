"""``[planar]``: an air-bearing table and the base's pucks; ``[body]``: what floats there without an arm."""

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
    of the base where the run begins. ``sag``: logarithm of what all drags change by over the run, as the pressure of
    the pucks' supply sags.
    """

    tilt_sigma_m_s2: NotNegative
    velocity_sigma_m_s: Positive
    rate_sigma_rad_s: Positive
    sag_sigma: NotNegative = 0.0
    puck: list[Puck] = Field(default_factory=list)

    @model_validator(mode="after")
    def _each_frame_once(self) -> "Planar":
        frames = [puck.frame for puck in self.puck]
        if twice := [frame for frame in dict.fromkeys(frames) if frames.count(frame) > 1]:
            raise ValueError(f"two pucks are at {', '.join(twice)}; give each another frame")
        return self


class Body(Section):
    """A body without joints, moved by its thrusters and tracked: 1 sigma of what moves it besides, and of these.

    ``mass``: relative, of the URDF's mass or that of [link], where it was weighed; silent: nothing is known of it.
    ``common_force``: relative, of the force of all thrusters alike; silent: as much as that of each, the mean of these.
    ``tilt``: gravity along the table; ``uneven``, ``turning``: steady accelerations within each five seconds.
    ``drag``, ``spin_drag``: of the air, over mass and over moment of inertia. ``place``, ``turn``: of each thruster;
    ``leak``: the share of its force that it has while it is off. ``delay_ms``: from the command to the force, the least
    and the largest that are looked for; ``each_delay``: of one valve against the others; ``loss``: by how much longer a
    valve takes to open than to close.
    """

    mass_sigma: Positive | None = None
    common_force_sigma: NotNegative | None = None
    tilt_sigma_m_s2: NotNegative = 0.01
    uneven_sigma_m_s2: Positive = 5e-4
    turning_sigma_rad_s2: Positive = 1e-3
    drag_sigma_1_s: NotNegative = 0.01
    spin_drag_sigma_1_s: NotNegative = 0.01
    place_sigma_m: NotNegative = 2e-3
    turn_sigma_rad: NotNegative = 0.01
    leak_sigma: NotNegative = 2e-3
    delay_ms: tuple[float, float] = Field(default=(-100.0, 700.0))
    each_delay_sigma_ms: NotNegative = 3.0
    loss_sigma_ms: NotNegative = 30.0

    @model_validator(mode="after")
    def _is_a_range(self) -> "Body":
        if not -1e4 <= self.delay_ms[0] < self.delay_ms[1] <= 1e4:
            raise ValueError("delay_ms is the least and the largest delay that is looked for: two numbers that rise")
        return self
