"""Inertial parameters from measured motion: by rows (``rows/``), and by predicting the IMU (``exiddm/``).

What both share stands here: the interface of an online identifier, quantities, the verdict, observability. Stands on
``onboard.regressor`` and what that stands on.
"""
