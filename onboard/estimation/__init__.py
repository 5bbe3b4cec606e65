"""Estimation on arrays: smoothing, gates, square-root RLS, and intervals that cover.

The rule of the room: NumPy, SciPy and filterpy only, nothing of ours, no clock, no file. Times are seconds on whatever
axis the caller keeps; every error out of here is an :class:`~onboard.estimation.errors.EstimationError`.
"""
