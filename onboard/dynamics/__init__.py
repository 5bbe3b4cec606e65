"""Rigid-body model of the vehicle and the measurement rows it gives, ``y = Y chi``, linear in the inertial parameters.

The rules of the room: SI units, float64; every frame and every axis is named; gravity is zero and the base's measured
specific force stands in its place, so that the attitude never matters. Imports ``onboard.estimation`` and nothing else
of ours.
"""
