"""What keys of the sections of a single kind of base mean; when to change them."""

PARABOLA: dict[str, tuple[str, ...]] = {
    "low_m_s2": ("Below this specific force of the base's IMU the aircraft flies a parabola.",),
    "free_m_s2": (
        "Below this value nothing may hold the vehicle; roughness beyond the IMU's noise says that something does.",
        "a fast arm shakes a light base by more",
    ),
    "settle_s": ("Left out after a release, before a catch and about a bump.", "hands let go slowly"),
    "shortest_s": ("Free flight that is a run.",),
}

PLANAR: dict[str, tuple[str, ...]] = {
    "tilt_sigma_m_s2": ("Gravity along the table, 1 sigma by axis; a milliradian is 0.01 m/s^2.", "the table is level"),
    "velocity_sigma_m_s": ("Velocity of the base where a run begins, 1 sigma by axis.", "runs begin in motion"),
    "rate_sigma_rad_s": ("The same of its yaw rate.", "as above"),
    "sag_sigma": (
        "Logarithm of what all drags change by over a run, 1 sigma; 0: they do not.",
        "the pressure of the pucks' supply sags during a run: 1",
    ),
    "puck": ("Tables: the pucks that the base floats on.",),
}

PUCK: dict[str, tuple[str, ...]] = {
    "frame": ("Frame of the URDF, fixed in the base, whose origin the puck is at.",),
    "viscous_sigma_N_s_m": ("Drag in proportion to the slip, 1 sigma about none.", "a puck is worn or dry"),
    "coulomb_sigma_N": ("Drag that is the same at any slip, 1 sigma about none.", "as above"),
}

PIVOT: dict[str, tuple[str, ...]] = {
    "drag_sigma_N_m_s": ("Drag of the air, in proportion to the rate, 1 sigma about none.", "the body is large"),
    "jets_sigma_N_m": (
        "What the bearing's jets turn the base by, about the vertical, 1 sigma about none.",
        "the data sheet of the bearing states it",
    ),
    "gyro_per_g_sigma_rad_s": (
        "Each element of what 1 g adds to the gyro's readings, 1 sigma.",
        "the gyro's data sheet states it: linear acceleration sensitivity",
    ),
    "proof_sigma": (
        "Relative, of mass times lever of payload_link: a known mass that is on the base for a part of the run.",
        "it was weighed and measured better",
    ),
    "balance": ("Tables: the masses that balance the base.",),
}

BODY: dict[str, tuple[str, ...]] = {
    "mass_sigma": ("Relative, of the mass as drawn or weighed; silent: unknown.", "the body was weighed: give it"),
    "common_force_sigma": (
        "Relative, of the force of all thrusters alike, beside `scale_sigma` of each; silent: the mean of these.",
        "the pressure of their supply was measured, or falls",
    ),
    "tilt_sigma_m_s2": ("Gravity along the table, 1 sigma by axis; a milliradian is 0.01 m/s^2.",),
    "uneven_sigma_m_s2": ("Steady acceleration in each five seconds by axis, 1 sigma.", "the table is uneven"),
    "turning_sigma_rad_s2": ("Steady angular acceleration in each five seconds, 1 sigma.", "a draught turns it"),
    "drag_sigma_1_s": ("Drag in proportion to the speed, over the mass, 1 sigma.",),
    "spin_drag_sigma_1_s": ("Drag in proportion to the rate, over the moment of inertia, 1 sigma.",),
    "place_sigma_m": ("Lever of each thruster's force, 1 sigma.", "the thrusters' places were measured"),
    "turn_sigma_rad": ("Direction of each thruster's force, 1 sigma.",),
    "leak_sigma": ("Share of its force that a thruster has while it is off, 1 sigma.",),
    "delay_ms": (
        "Least and largest delay from the command to the force, which is fitted between them.",
        "poses or commands are later than this",
    ),
    "each_delay_sigma_ms": ("Delay of a valve against the others, 1 sigma.",),
    "loss_sigma_ms": ("By how much longer a valve takes to open than to close, 1 sigma.",),
}

BALANCE: dict[str, tuple[str, ...]] = {
    "name": ("Its name: the answer is move_NAME.",),
    "mass_kg": ("Weighed.",),
    "axis": ("Direction in which it can be moved, base axes.",),
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
        "Of that spring. Without: 2 % of the critical damping of the joint's swing alone, nothing held.",
        "a swing was seen to die away",
    ),
    "damping_relative": ("How well that is known, relative, 1 sigma.", "it was measured"),
}

FREE_BODY: dict[str, tuple[str, ...]] = {
    "rotor_sigma": ("Relative sigma of the rotors' inertia in the URDF, which all inertias scale with.",),
    "carrier": ("Table: the device itself, without a load.",),
    "load": ("Tables: what it carries in which logs.",),
}

CARRIER: dict[str, tuple[str, ...]] = {
    "mass_kg": ("Mass of the device itself.",),
    "centre_of_mass_m": ("Its centre of mass, base axes.",),
    "centre_of_mass_sigma_m": ("How well that is known, 1 sigma by axis.",),
    "inertia_kg_m2": ("XX, XY, YY, XZ, YZ, ZZ about its centre of mass, base axes.",),
    "inertia_sigma_kg_m2": ("How well these are known, 1 sigma.",),
}

LOAD: dict[str, tuple[str, ...]] = {
    "name": ("Name of the load.",),
    "logs": ("Pattern of the names of its logs.",),
    "role": ('"carrier": the device alone; "proof": a known body; these two calibrate. "load": to be estimated.',),
    "mass_kg": ("Weighed.",),
    "truth_kg_m2": ("Known moments of inertia, to compare with or to calibrate by.",),
    "truth_source": ("Where they are from.",),
    "bars_percent": ("Mean and worst error that are accepted.",),
}
