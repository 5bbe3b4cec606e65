"""Inertial chips with a FIFO: what they share (packets, draining, numbers of samples), and drivers of a single file."""
