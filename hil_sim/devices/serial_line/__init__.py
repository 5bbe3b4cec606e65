"""Simulated devices at the end of a serial line, and the line."""
