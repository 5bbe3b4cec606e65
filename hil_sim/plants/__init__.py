"""True motion: bodies simulated by MuJoCo, and the prescribed motion of joints and base."""
