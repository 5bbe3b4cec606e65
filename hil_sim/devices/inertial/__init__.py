"""Simulated inertial chips: what they share (samples made lazily, FSYNC latch, FIFO), and those of a single file."""
