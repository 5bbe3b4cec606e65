"""Puts logs of several recorders on one clock and in one file (``heft resync``, ``heft merge``)."""
