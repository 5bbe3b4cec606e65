"""Measurement rows ``y = Y chi``, linear in the inertial parameters: columns, base parameters, friction, noise.

Stands on ``onboard.dynamics`` and ``onboard.estimation``. Columns are ordered by link, ten a link (``STANDARD``).
"""
