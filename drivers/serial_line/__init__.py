"""Devices on a serial line or in a stream of bytes: the port and its faults, polls, frames, streams of numbers."""
