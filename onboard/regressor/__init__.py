"""Measurement rows ``y = Y chi``, linear in the inertial parameters: columns, base parameters, friction, noise.

Uses ``onboard.dynamics`` and ``onboard.estimation``. Columns are ordered by link, ten per link (``STANDARD``).
"""
