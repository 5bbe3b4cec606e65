"""Fits the payload so that the predicted base IMU signals match the measured ones (non-linear ExIDDM)."""
