"""Errors of weighing; each message ends with the remedy."""


class PosesError(ValueError):
    """A table of poses that cannot be used as it is."""
