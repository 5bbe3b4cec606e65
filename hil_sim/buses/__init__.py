"""Simulated buses between twins and flight computer, with ends in process (T0) or on ptys and sockets (T1)."""
