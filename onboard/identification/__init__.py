"""Identification of inertial parameters: by regression rows (``rows/``) and by IMU prediction (``free_flyer/``).

Common to both: the interface of an online identifier, quantities, the verdict, observability. Uses
``onboard.regressor`` and the packages below it.
"""
