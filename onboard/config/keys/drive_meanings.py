"""What the keys of ``[drive]`` and ``[mission]`` mean, and when to change them; see ``meanings``."""

DRIVE: dict[str, tuple[str, ...]] = {
    "armed": ("Whether drives with `driven = true` may be driven at all.", "the arm is to move"),
    "motion": ("CSV of the motion, relative to this file: `time_s` and each driven joint, rad.",),
    "phase": ("Code of the phase that arms the drives; without it the operator does, by `heft fly --arm`.",),
    "mode": ('"cyclic": a target each SYNC; "profile": rows are way points.', "a drive lacks mode 8"),
    "margin_rad": ("Kept from both ends of the URDF's range.", "the drives stop sooner, or later"),
    "rate_rad_s": ("Largest rate; the URDF's where that is less.", "the arm is to move slowly"),
    "acceleration_rad_s2": ("Largest acceleration of a motion; that of a profile.", "the arm bears more or less"),
    "quick_stop_rad_s2": ("Deceleration of a quick stop (6085h).", "the arm bears more or less"),
    "following_error_rad": ("Largest distance from the target.", "the drives lag more"),
    "start_within_rad": ("How far the arm may stand from the motion's start.",),
    "heartbeat_ms": ("How long the drives do without our heartbeat (1016h).", "this computer is often late"),
    "sync_limit_ms": ("Longest time without SYNC, answers or targets.", "SYNCs are rare, or the bus is full"),
    "master_node": ("Our node number, of the heartbeat.", "a node has it"),
    "after_stop": ('"release": to the brake after a quick stop; "hold": current stays on.', "it has no brake"),
}

MISSION: dict[str, tuple[str, ...]] = {
    "until": ('Half of the 95 % intervals that are enough, e.g. `"mass 1 %, centre 5 mm"`.',),
    "segments": ("File of motions that the flight may ask for, relative to this file (`heft plan --segments`).",),
    "give_up_s": ("Longest time with a payload held.", "the arm may move for longer"),
    "probe_s": (
        "A flight that begins with nothing held asks for a small motion after so long a rest, 5 times at most; 0: no.",
        "0: the arm must not move before a capture is seen",
    ),
}
