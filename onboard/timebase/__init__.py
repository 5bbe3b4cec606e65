"""Conversion of device clocks to vehicle time (the flight computer's CLOCK_MONOTONIC, ns), from sync pulses."""
