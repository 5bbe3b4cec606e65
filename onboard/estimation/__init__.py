"""Estimation on arrays: smoothing, gates, square-root RLS, change detection, jackknife intervals.

Uses NumPy, SciPy and filterpy only; no clock, no files. Times are seconds on the caller's time axis. Every error raised
here is an :class:`~onboard.estimation.errors.EstimationError`.
"""
