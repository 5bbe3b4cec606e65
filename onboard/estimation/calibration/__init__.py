"""Calibration from measurements on the bench: pure numbers in, values with sigmas out.

Every function refuses a run that does not determine what it is asked for, or whose residual contradicts the stated
accuracy, with a :class:`~onboard.estimation.errors.CalibrationError` that says what to repeat.
"""
