"""What the keys of ``[planar]`` and ``[parabola]`` mean, and when to change them; see ``meanings``."""

PARABOLA: dict[str, tuple[str, ...]] = {
    "low_m_s2": ("Below this specific force of the base's IMU the aircraft flies a parabola.",),
    "free_m_s2": (
        "Below this one nothing may hold the vehicle; roughness beyond the IMU's noise says that something does.",
        "a fast arm shakes a light base by more",
    ),
    "settle_s": ("Left out after a release, before a catch and about a bump.", "hands let go slowly"),
    "shortest_s": ("Free flight that is a run.",),
}

PLANAR: dict[str, tuple[str, ...]] = {
    "tilt_sigma_m_s2": (
        "Gravity along the table, 1 sigma by axis; a milliradian is 0.01 m/s^2.",
        "the table is level",
    ),
    "velocity_sigma_m_s": ("Velocity of the base where a run begins, 1 sigma by axis.", "runs begin in motion"),
    "rate_sigma_rad_s": ("The same of its yaw rate.", "as above"),
    "puck": ("Tables: the pucks that the base floats on.",),
}

PUCK: dict[str, tuple[str, ...]] = {
    "frame": ("Frame of the URDF, fixed in the base, whose origin the puck is at.",),
    "viscous_sigma_N_s_m": ("Drag in proportion to the slip, 1 sigma about none.", "a puck is worn or dry"),
    "coulomb_sigma_N": ("Drag that is the same at any slip, 1 sigma about none.", "as above"),
}

JOINT = {
    "position_m": ("Place of the joint in the drawing, 1 sigma by coordinate.", "the arm was measured"),
    "zero_rad": ("Zero of its encoder (m for a sliding joint), 1 sigma.", "the zero was calibrated, or never"),
    "scale": ("Scale of its encoder, relative, 1 sigma.", "it is not an encoder's count"),
    "delay_s": ("Of its samples, beyond what is known and taken off, 1 sigma.", "its filter was not measured"),
    "stiffness_N_m_rad": (
        "Torsional stiffness between its encoder, which is on the drive, and its link; stiff without. Known to the "
        'method "exiddm" of a free base alone.',
        "arm or payload swing on the drives",
    ),
    "stiffness_relative": ("How well that is known, relative, 1 sigma.", "it was measured, or guessed"),
    "damping_N_m_s_rad": (
        "Of that spring. Without: 2 % of the critical one of the joint's swing alone, nothing held.",
        "a swing was seen to die away",
    ),
    "damping_relative": ("How well that is known, relative, 1 sigma.", "it was measured"),
}
